"""Correction tables active in the control, as part of the model: the control shifts its own commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from twin.controls import ControlSection, Correction, read_tables
from twin.controls.kinematics import kinematics_named
from twin.controls.kinematics.format import KinematicCorrection
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import Effect, Frame, Parameter, along

PREFIX: Final = "control:"
SAMPLES: Final = 401
"""Number of positions at which the two directions of a table are compared."""


@final
class ControlCorrection(Effect):
    """A correction table of the control, of a format (``kind``), that moves one axis and corrects some ISO/TR 16907 classes.

    The axis is sent to q + c(q). A shift along its own travel is the same before and after the axis's motion, so it is placed in the
    error frame. Error motions are evaluated at q instead of q + c(q): 100 µm of correction times a slope of 100 µm/m makes 10 nm.
    """

    def __init__(self, axis: Axis, correction: Correction, kind: str, classes: tuple[str, ...]) -> None:
        self.name = f"{PREFIX}{kind} {axis.name}"
        self.axis = axis
        self.frame = Frame(axis.name, "motion")
        self.correction = correction
        self.kind = kind
        self.classes = classes

    def with_tool(self, tool_length_mm: float) -> ControlCorrection:
        """Return the same correction for a tool of the given length."""
        correction = self.correction.with_tool(tool_length_mm)
        same = correction is self.correction
        return self if same else ControlCorrection(self.axis, correction, self.kind, self.classes)

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return along(self.axis, self.correction.shift(self.axis.name, positions))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Empty: the values of a table are not estimated."""
        return ()

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """Empty: there are no parameters."""
        return ()

    def reversal_range(self, ranges: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
        """Return the smallest and largest difference over the range between the two directions of approach, + minus −, µm or µrad.

        The other axes are held at the middle of their ranges.
        """
        middle = {name: np.full(SAMPLES, 0.5 * (low + high)) for name, (low, high) in ranges.items()}
        state: dict[str, Any] = middle | {self.axis.name: np.linspace(*ranges[self.axis.name], SAMPLES)}
        sides = [state | {f"approach_{name}": np.full(SAMPLES, side) for name in ranges} for side in (1.0, -1.0)]
        up, down = (np.broadcast_to(self.correction.shift(self.axis.name, side), SAMPLES) for side in sides)
        return float(np.min(up - down)), float(np.max(up - down))


def tables_of(control: ControlSection, machine: Machine) -> tuple[ControlCorrection, ...]:
    """Return the corrections by the tables of a control; none if the errors were measured with the tables active."""
    corrections: list[ControlCorrection] = []
    for kind in control.formats if control.errors_are == "uncorrected" else ():
        entries = control.of(kind)
        for entry in entries:
            entry.check()
        classes = tuple(dict.fromkeys(name for entry in entries for name in entry.classes))
        table = read_tables(kind, [entry.file for entry in entries], machine)
        corrections += [ControlCorrection(machine.by_name[axis], table, kind, classes) for axis in table.axes]
    return tuple(corrections)


def kinematics_of(control: ControlSection, machine: Machine) -> tuple[ControlCorrection, ...]:
    """Return the corrections by the kinematics of a control, which act in tool centre point mode only."""
    corrections: list[ControlCorrection] = []
    for entry in control.kinematics:
        entry.check()
        geometry = kinematics_named(entry.format).read(entry.file, machine)
        held = KinematicCorrection(machine, geometry, machine.tool_length_mm)
        corrections += [
            ControlCorrection(machine.by_name[axis], held, entry.format, entry.classes) for axis in held.axes
        ]
    return tuple(corrections)
