"""Base class of the compensations in a control: shifts of the commanded positions as a function of these positions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, final

from twin.machine.machine import Machine

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
