"""Kinematics of the control's transformation from the constant errors of a calibration: the lines of its rotary axes.

The location errors (``E_X0C`` …) give the lines of the rotary axes and the place of the workpiece exactly. A format that holds only
some of them gets the values for which the remaining displacement of the functional point, over the volume and with this tool, is least
in the sum of squares. Squareness errors are not part of it: they also act without a transformation, and are left to tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.calibration import Calibration
from twin.machine.control.kinematics import (
    KinematicsFormat,
    TableGeometry,
    kinematics_named,
    linear_shift,
    table_geometry,
)
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.uncertainty.budget import volume

ITERATIONS: Final = 3
STEP: Final = 1e-4
"""Step of the derivatives, mm, degrees or of a direction."""
NEGLIGIBLE: Final = 1e-6
"""Relative singular value of combinations of parameters that do not move the point, such as a shift along an axis."""
ROUND_TRIP_UM: Final = 0.1


@final
@dataclass(frozen=True)
class ConstantKinematics:
    """Kinematics of a control, as a file and as read back from it.

    Attributes:
        form: the format.
        machine: the machine.
        text: text of the file.
        geometry: the geometry read back.
        displaced_rms_um, displaced_max_um: displacement of the functional point by the location errors over the volume.
        left_rms_um, left_max_um: displacement that remains with the file, because the format cannot hold it.
        round_trip_um: largest displacement of the functional point by rounding in the file.
    """

    form: KinematicsFormat
    machine: Machine
    text: str
    geometry: TableGeometry
    displaced_rms_um: float
    displaced_max_um: float
    left_rms_um: float
    left_max_um: float
    round_trip_um: float

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        if self.round_trip_um <= ROUND_TRIP_UM:
            return ()
        return (
            f"{self.form.file}: read back, the point deviates by {self.round_trip_um:.3f} um, more than {ROUND_TRIP_UM} um",
        )


def real_geometry(calibration: Calibration) -> TableGeometry:
    """Return the geometry of the table with the location errors of a calibration.

    Raises:
        InputError: the machine does not have a table with two rotary axes.
    """
    machine = calibration.machine
    errors = np.zeros(6 * len(machine.frames))
    for name, value in calibration.location.items():
        component, _, axis = split_name(name)
        frame = next(i for i, one in enumerate(machine.frames) if (one.axis, one.role) == (axis, "location"))
        errors[6 * frame + component] += 1e-6 * value
    return table_geometry(machine, errors)


def make_kinematics(
    calibration: Calibration, kind: str, tool_length_mm: float | None = None, notes: Sequence[str] = ()
) -> ConstantKinematics:
    """Return the kinematics of a control for the location errors of a calibration, as a file and as read back.

    Args:
        calibration: the errors.
        kind: name of a format of `twin.machine.control.kinematics`.
        tool_length_mm: tool length of the functional point; None: that of the machine file.
        notes: lines for comments.

    Raises:
        InputError: an unknown format; the transformation cannot represent the machine; there are no location errors.
    """
    machine, form = calibration.machine, kinematics_named(kind)
    nominal = form.nominal(machine)
    if not any(calibration.location.values()):
        raise InputError(
            "no location errors of rotary axes: the kinematics of the control need no correction",
            expected="a calibration with `location:`",
            file=calibration.path,
        )
    length = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
    q, names = volume(machine), list(nominal)
    goal = linear_shift(machine, real_geometry(calibration), q, length)

    def shift(vector: np.ndarray) -> np.ndarray:
        geometry = form.geometry(dict(zip(names, vector.tolist(), strict=True)), machine)
        return linear_shift(machine, geometry, q, length)

    vector = np.array(list(nominal.values()))
    # The errors are small: the derivatives at the nominal machine serve all iterations.
    steps = STEP * np.eye(len(names))
    by = np.stack([(shift(vector + h) - shift(vector - h)).ravel() / (2.0 * STEP) for h in steps], axis=1)
    back_to = np.linalg.pinv(by, rcond=NEGLIGIBLE)
    for _ in range(ITERATIONS):
        vector = vector + back_to @ (goal - shift(vector)).ravel()
    text = form.write(dict(zip(names, vector.tolist(), strict=True)), machine, notes)
    back = form.read_back(text, machine)
    read = linear_shift(machine, back, q, length)
    left, rounded = np.linalg.norm(goal - read, axis=1), np.linalg.norm(read - shift(vector), axis=1)
    displaced = np.linalg.norm(goal, axis=1)
    rms = [float(np.sqrt(np.mean(one**2))) for one in (displaced, left)]
    return ConstantKinematics(
        form, machine, text, back, rms[0], float(displaced.max()), rms[1], float(left.max()), float(rounded.max())
    )


def read_kinematics(kind: str, path: Path, machine: Machine) -> TableGeometry:
    """Return the geometry in a control's file.

    Raises:
        InputError: there is no such format, or the file is invalid.
    """
    return kinematics_named(kind).read(path, machine)
