"""Base class of the compensations in a control: shifts of the commanded positions as a function of these positions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self, final

import casadi as ca
import numpy as np

from twin._common.units import TURN
from twin.machine.machine import Axis, Machine
from twin.numerics.functions import floor, fmax

"""Basic classes of ISO/TR 16907: every error motion belongs to exactly one of them."""


@final
@dataclass(frozen=True)
class TableSummary:
    """Summary of one table of a control: its nodes (mm, degrees) and its largest value in ``unit`` (``um``, ``urad``)."""

    name: str
    low: float
    high: float
    nodes: int
    step: float
    largest: float
    unit: str

    @classmethod
    def over(cls, name: str, at: Sequence[float], largest: float, unit: str) -> TableSummary:
        """Return the summary of a table with nodes at the positions ``at``."""
        step = at[1] - at[0] if len(at) > 1 else 0.0
        return cls(name, at[0], at[-1], len(at), step, largest, unit)


class Correction(ABC):
    """Correction that a control adds to the commanded positions of its axes, according to its tables.

    The machine then moves to q + c(q). A table that corrects a positioning error E_XX of +5 µm has c = −5 µm; the sign in the file
    depends on the format.

    Attributes:
        machine: the machine whose axes it moves.
    """

    machine: Machine

    @property
    @abstractmethod
    def axes(self) -> tuple[str, ...]:
        """Names of the axes it moves, in the machine's command order."""

    def with_tool(self, tool_length_mm: float) -> Correction:
        """Return the correction for another tool length: the same, unless the control uses the length of the active tool."""
        return self

    @abstractmethod
    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """Return the value added to the command of one axis: µm for a linear axis, µrad for a rotary one.

        It is interpolated, and continued beyond the ends of a table, in the same way as in the control.

        Args:
            axis: one of ``axes``.
            positions: commanded position of every axis by name, mm or degrees: arrays or CasADi (SX) expressions, of one shape; for
                tables that depend on the direction of approach also ``approach_<axis>`` (+1, −1; 0 if unknown, which gives the mean).
        """

    @abstractmethod
    def contents(self) -> tuple[TableSummary, ...]:
        """Return the summaries of all its tables."""

    @abstractmethod
    def plus(self, old: Self) -> Self:
        """Return tables with the sum of these and older corrections, on the nodes of the older ones."""

    @abstractmethod
    def rounded(self, axis: str) -> int:
        """Return the largest number of rounded values that are added in the correction of an axis."""


# --- Curves of a control's tables: values at nodes with linear interpolation, and products of such curves

Direction = Literal[-1, 0, 1]
UP: Direction = 1
BOTH: Direction = 0
DOWN: Direction = -1


@final
@dataclass(frozen=True)
class ControlCurve:
    """Values at positions of one axis, with linear interpolation and constant continuation beyond the ends.

    Attributes:
        argument: name of the axis of which it is a function.
        at: nodes, mm or degrees, increasing; at least one.
        values: values at the nodes.
        period: period of an unlimited rotary axis, into which positions are wrapped from the first node on; None for no wrapping.
        direction: +1 or −1: applies only to that direction of approach; 0: always. If the direction of approach is unknown, both
            directions have weight one half.
    """

    argument: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    period: float | None = None
    direction: Direction = 0

    def __call__(self, positions: Mapping[str, Any]) -> Any:
        """Return the value at positions of the machine; see `Correction.shift`."""
        value = self.along(positions[self.argument])
        if self.direction == 0:
            return value
        name = f"approach_{self.argument}"
        side = positions[name] if name in positions else 0.0
        return 0.5 * (1.0 + self.direction * side) * value

    def along(self, q: Any) -> Any:
        """Return the value at positions of its axis, independent of the direction of approach."""
        if self.period is not None:
            q = q - self.period * floor((q - self.at[0]) / self.period)
        if not isinstance(q, ca.SX):
            return np.interp(q, self.at, self.values)
        # Without branches: a constant and a hinge function at every node where the slope changes.
        slopes = np.diff(self.values) / np.diff(self.at)
        bends = np.diff(slopes, prepend=0.0, append=0.0) if len(slopes) else np.zeros(len(self.at))
        value: Any = ca.SX(self.values[0])
        for node, bend in zip(self.at, bends, strict=True):
            if bend != 0.0:
                value = value + float(bend) * fmax(q - node, 0.0)
        return value

    @property
    def peak(self) -> float:
        """Largest absolute value."""
        return max(abs(value) for value in self.values)

    def scaled(self, by: float) -> ControlCurve:
        """Return the curve times a number."""
        return replace(self, values=tuple(value * by for value in self.values))


def period_of(axis: Axis) -> float | None:
    """Return one turn in degrees for an unlimited axis, None for others."""
    return TURN if axis.lower is None else None


@final
@dataclass(frozen=True)
class ControlTerm:
    """One table, or the product of two.

    Attributes:
        axis: the axis that it moves.
        factors: factors of the product; values of the first in µm or µrad, of the others without unit.
    """

    axis: str
    factors: tuple[ControlCurve, ...]

    def __call__(self, positions: Mapping[str, Any]) -> Any:
        """Return the value added to the command of its axis, µm or µrad; see `Correction.shift`."""
        value = self.factors[0](positions)
        for factor in self.factors[1:]:
            value = value * factor(positions)
        return value

    @property
    def peak(self) -> float:
        """Upper bound of the absolute value, µm or µrad."""
        return float(np.prod([factor.peak for factor in self.factors]))

    @property
    def key(self) -> tuple[object, ...]:
        """Identity of the table: the axis moved, and axis and direction of every factor."""
        return (self.axis, *((curve.argument, curve.direction) for curve in self.factors))

    @property
    def name(self) -> str:
        """``Y by X``, ``X by X times Z``, ``X by X, X moving up``."""
        first = self.factors[0]
        side = {0: "", 1: f", {first.argument} moving up", -1: f", {first.argument} moving down"}[first.direction]
        return (
            f"{self.axis} by {first.argument}{''.join(f' times {other.argument}' for other in self.factors[1:])}{side}"
        )


@final
@dataclass(frozen=True, eq=False)
class TableSum(Correction):
    """Sum of tables of one axis each, and of products of such tables.

    Attributes:
        terms: the tables.
        machine: the machine whose axes they name.
    """

    terms: tuple[ControlTerm, ...]
    machine: Machine

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        moved = {term.axis for term in self.terms}
        return tuple(name for name in self.machine.names if name in moved)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        total: Any = 0.0
        for term in self.terms:
            if term.axis == axis:
                total = total + term(positions)
        return total

    def contents(self) -> tuple[TableSummary, ...]:
        """See `Correction.contents`."""
        units = {axis.name: "um" if axis.linear else "urad" for axis in self.machine.axes}
        return tuple(
            TableSummary.over(term.name, term.factors[0].at, term.peak, units[term.axis]) for term in self.terms
        )

    def plus(self, old: TableSum) -> TableSum:
        """Add values to a table that exists already, append other tables; see `Correction.plus`."""
        singles: dict[tuple[str, str], list[ControlTerm]] = {}
        products: list[ControlTerm] = []
        for term in (*old.terms, *self.terms):
            alike = (
                singles.setdefault((term.axis, term.factors[0].argument), []) if len(term.factors) == 1 else products
            )
            alike.append(term)
        found: list[ControlTerm] = []
        for terms in singles.values():
            curves = [term.factors[0] for term in terms]
            sides: tuple[Direction, ...] = (BOTH,) if all(curve.direction == 0 for curve in curves) else (UP, DOWN)
            for side in sides:
                values = np.sum([curve.values for curve in curves if curve.direction in (0, side)], axis=0)
                whole = replace(curves[0], values=tuple(values.tolist()), direction=side)
                found.append(ControlTerm(terms[0].axis, (whole,)))
        return TableSum((*found, *products), self.machine)

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return sum(term.axis == axis for term in self.terms)
