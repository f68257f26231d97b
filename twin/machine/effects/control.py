"""What a control corrects by itself, as part of the model: it shifts its own commands, and the machine goes where they then are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from twin.machine.control import Correction
from twin.machine.effects.base import Effect, Frame, Parameter, along
from twin.machine.machine import Axis

PREFIX: Final = "control:"
PLACES: Final = 401
"""Positions of an axis at which the two directions of a table are compared."""


@final
class ControlCorrection(Effect):
    """A table of the control that moves one axis.

    The axis is sent to q + c(q). A shift along its own travel comes to the same before and after the axis's motion, so it stands in its
    error frame; error motions are read at q and not at q + c(q): 100 µm of correction times a slope of 100 µm/m are 10 nm.

    Args:
        axis: the axis that is moved.
        correction: the tables.
        kind: their format.
        classes: classes of ISO/TR 16907 they take out.
    """

    def __init__(self, axis: Axis, correction: Correction, kind: str, classes: tuple[str, ...]) -> None:
        self.name = f"{PREFIX}{kind} {axis.name}"
        self.axis = axis
        self.frame = Frame(axis.name, "motion")
        self.correction = correction
        self.kind = kind
        self.classes = classes

    def with_tool(self, tool_length_mm: float) -> ControlCorrection:
        """The same table with a tool of that length in the spindle."""
        correction = self.correction.with_tool(tool_length_mm)
        same = correction is self.correction
        return self if same else ControlCorrection(self.axis, correction, self.kind, self.classes)

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return along(self.axis, self.correction.shift(self.axis.name, positions))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """None: the numbers of a table are what they are, not estimates."""
        return ()

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """None."""
        return ()

    def lost_motion(self, ranges: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
        """What it adds coming from below less what it adds coming from above, µm or µrad: the smallest and the largest over the range.

        Args:
            ranges: of every axis, mm or degrees; the other axes stand in the middle of theirs.
        """
        middle = {name: np.full(PLACES, 0.5 * (low + high)) for name, (low, high) in ranges.items()}
        state: dict[str, Any] = middle | {self.axis.name: np.linspace(*ranges[self.axis.name], PLACES)}
        sides = [state | {f"approach_{name}": np.full(PLACES, side) for name in ranges} for side in (1.0, -1.0)]
        up, down = (np.broadcast_to(self.correction.shift(self.axis.name, one), PLACES) for one in sides)
        return float(np.min(up - down)), float(np.max(up - down))
