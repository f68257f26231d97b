"""What every kind of compensation in a control is: a shift of the commanded positions, worked out from them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self, final

from twin.machine.machine import Machine

BasicClass = Literal["L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS", "R-RAX", "R-POR", "R-ANG"]
"""The classes of ISO/TR 16907 that every error motion belongs to exactly one of."""


@final
@dataclass(frozen=True)
class Content:
    """One table of a control: its nodes (mm, degrees), and the largest value in ``unit`` (``um``, ``urad``)."""

    name: str
    low: float
    high: float
    nodes: int
    step: float
    largest: float
    unit: str

    @classmethod
    def over(cls, name: str, at: Sequence[float], largest: float, unit: str) -> Content:
        """The content of a table with nodes at some positions."""
        step = at[1] - at[0] if len(at) > 1 else 0.0
        return cls(name, at[0], at[-1], len(at), step, largest, unit)


class Correction(ABC):
    """What a control adds to the commands of its axes, before they move, as its tables say.

    The machine then goes to q + c(q). A table that corrects a positioning error E_XX of +5 µm has c = −5 µm, whatever sign its own
    format writes.

    Attributes:
        machine: whose axes it moves.
    """

    machine: Machine

    @property
    @abstractmethod
    def axes(self) -> tuple[str, ...]:
        """Names of the axes it moves, in the machine's command order."""

    def with_tool(self, tool_length_mm: float) -> Correction:
        """What it does with a tool of another length: the same, unless the control counts the tool in."""
        return self

    @abstractmethod
    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """What is added to the command of one axis: µm for a linear axis, µrad for a rotary one.

        Interpolated as the control interpolates it; beyond the ends of a table as the control goes on there.

        Args:
            axis: one of ``axes``.
            positions: commanded position of every axis by name, mm or degrees: arrays or CasADi (SX) expressions alike, of one shape;
                where a table differs by direction also ``approach_<axis>`` (+1, −1, 0 unknown: the mean of the two).
        """

    @abstractmethod
    def contents(self) -> tuple[Content, ...]:
        """Every table it is made of."""

    @abstractmethod
    def plus(self, old: Self) -> Self:
        """The tables that do what these and older ones do together, on the nodes of the older ones."""

    @abstractmethod
    def rounded(self, axis: str) -> int:
        """How many rounded values at most are added up in what moves an axis."""
