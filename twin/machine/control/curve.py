"""What the tables of a control are made of: values at nodes, straight lines between them, and products of such curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, final

import casadi as ca
import numpy as np

from twin.machine.control.base import Correction
from twin.machine.machine import Machine
from twin.numerics.elementary import floor, fmax

Direction = Literal[-1, 0, 1]
UP: Direction = 1
BOTH: Direction = 0
DOWN: Direction = -1


@final
@dataclass(frozen=True)
class Curve:
    """Values at positions of one axis, straight lines between them, the end values beyond the ends.

    Attributes:
        of: the axis it is a function of.
        at: nodes, mm or degrees, rising; at least one.
        values: at the nodes.
        period: of an axis that turns without end: positions are wrapped into one period from the first node on; None: they are not.
        direction: +1, −1: in use only where the axis is coming from below, from above; 0: always. Where the side is not known each
            counts half.
    """

    of: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    period: float | None = None
    direction: Direction = 0

    def __call__(self, positions: Mapping[str, Any]) -> Any:
        """The value at positions of the machine, as of `Correction.shift`."""
        value = self.along(positions[self.of])
        if self.direction == 0:
            return value
        name = f"approach_{self.of}"
        side = positions[name] if name in positions else 0.0
        return 0.5 * (1.0 + self.direction * side) * value

    def along(self, q: Any) -> Any:
        """The value at positions of its own axis, whatever the side."""
        if self.period is not None:
            q = q - self.period * floor((q - self.at[0]) / self.period)
        if not isinstance(q, ca.SX):
            return np.interp(q, self.at, self.values)
        # Branch-free: a constant and a hinge at every node where the slope changes.
        slopes = np.diff(self.values) / np.diff(self.at)
        bends = np.diff(slopes, prepend=0.0, append=0.0) if len(slopes) else np.zeros(len(self.at))
        value: Any = ca.SX(self.values[0])
        for node, bend in zip(self.at, bends, strict=True):
            if bend != 0.0:
                value = value + float(bend) * fmax(q - node, 0.0)
        return value

    @property
    def step(self) -> float:
        """Distance of its first two nodes; 0 of a single one."""
        return self.at[1] - self.at[0] if len(self.at) > 1 else 0.0


@final
@dataclass(frozen=True)
class Term:
    """One table, or the product of two.

    Attributes:
        axis: the axis it moves.
        factors: of the product; values of the first in µm or µrad, of others without a unit.
    """

    axis: str
    factors: tuple[Curve, ...]

    def __call__(self, positions: Mapping[str, Any]) -> Any:
        """What it adds to the command of its axis, µm or µrad, as of `Correction.shift`."""
        value = self.factors[0](positions)
        for factor in self.factors[1:]:
            value = value * factor(positions)
        return value


@final
class Terms(Correction):
    """Tables of one axis each, and products of them, that add up.

    Args:
        terms: the tables.
        machine: whose axes they name.
    """

    def __init__(self, terms: Sequence[Term], machine: Machine) -> None:
        self.terms = tuple(terms)
        moved = {term.axis for term in self.terms}
        self._axes = tuple(name for name in machine.names if name in moved)

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        return self._axes

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        total: Any = 0.0
        for term in self.terms:
            if term.axis == axis:
                total = total + term(positions)
        return total
