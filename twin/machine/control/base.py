"""What every kind of compensation in a control is: a shift of the commanded positions, worked out from them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any


class Correction(ABC):
    """What a control adds to the commands of its axes, before they move, as its tables say.

    The machine then goes to q + c(q). A table that corrects a positioning error E_XX of +5 µm has c = −5 µm, whatever sign its own
    format writes.
    """

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
