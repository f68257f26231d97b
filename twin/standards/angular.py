"""Angular error motions of a linear axis by ISO 230-1, from the angles that a level or an autocollimator reads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import scipy

from twin._common.units import DEG, MM, UM
from twin.machine.machine import Machine
from twin.measurement.evaluation import angular_error
from twin.standards.readings import SAME_AS_MACHINE, NotPossible, carried_sides
from twin.standards.result import StandardTest, StandardValue
from twin.standards.runs import DECIMALS, MeasuredRun, directions
from twin.standards.words import place_of

ANGULAR: Final = "ISO 230-1:2012, 3.4.16 and 8.4"
NOT_VERIFIED: Final = (
    "the angular error is the largest minus the smallest deviation over both directions, without removing a slope; the text of the "
    "standard was not available to check this"
)
BLIND: Final = 1e-6
"""Share of the rotation about the station's z, which is not read, up to which a direction counts as read."""


def angular_tests(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> Iterator[StandardTest]:
    """Yield the angular error of a linear axis about each direction that was read.

    Args:
        run: a run of one axis, with angles.
        machine: the machine.
        u_mm: (n, 3) standard uncertainties of its readings, mm at 1 m.

    Raises:
        NotPossible: a rotary axis, an axis that moves both target and station or neither, an angle that was not read in every row, a
            direction of approach that is unknown, or a station of which no horizontal axis is parallel to the machine's.
    """
    axis = machine.axes[run.axes[0]]
    target, station = carried_sides(run, axis)
    if not axis.linear or target == station:
        raise NotPossible(
            f"the angles do not show {axis.name}" if axis.linear else "angular errors are those of linear axes"
        )
    if not run.read[:2].all():
        raise NotPossible("one of the two angles was not read in every row")
    approach, derived = directions(run)
    if not np.all(approach):
        raise NotPossible(f"the direction of approach of {axis.name} is unknown in some rows")
    found = {f"E_{letter}{axis.name}": angle for letter, angle in _about_machine_axes(run).items()}
    if not found:
        raise NotPossible("the station's pose has no axis of rotation parallel to an axis of the machine")
    known = "as given by the station's pose" if np.isfinite(run.data.station_pose[0]).all() else SAME_AS_MACHINE
    u = float(np.sqrt(np.nanmean(u_mm[:, :2] ** 2))) * (MM / UM) if np.isfinite(u_mm).any() else float("nan")
    position = np.round(run.positions[:, 0], DECIMALS)
    visits = np.unique(np.stack([position, approach]), axis=1, return_counts=True)[1]
    range_u = float(np.sqrt(2.0 / visits.min())) * u
    for name, angle in found.items():
        error = angular_error(position, angle if target else -angle, approach, name=name)
        rows = (
            ("", "", error.value_urad, "angular error, both directions"),
            ("↑", "_forward", error.forward_value_urad, "range of the angular deviation, positive approach"),
            ("↓", "_backward", error.backward_value_urad, "range of the angular deviation, negative approach"),
            (" reversal", "_reversal", error.reversal_urad, "largest difference of the two directions"),
        )
        values = tuple(
            StandardValue(f"{name}{sign}", f"{name}{key}", value, "urad", words, range_u)
            for sign, key, value, words in rows
            if value is not None
        )
        remarks = [NOT_VERIFIED, f"directions {known}", *(f"not a full test: {text}" for text in error.shortfalls)]
        remarks += ["direction of approach from the order of the readings"] if derived else []
        yield StandardTest("angular error", name, ANGULAR, (axis.name,), place_of(run), values, tuple(remarks), error)


def _about_machine_axes(run: MeasuredRun) -> dict[str, np.ndarray]:
    """Return the rotations (n,) of the target relative to the station, µrad, about the machine's axes: ``A``, ``B``, ``C``."""
    pose = run.data.station_pose[0]
    turn = (
        scipy.spatial.transform.Rotation.from_rotvec(pose[3:] * DEG).as_matrix()
        if np.isfinite(pose).all()
        else np.eye(3)
    )
    # A reading is the shift (b, −a) of the end of a line of 1 m.
    read = np.column_stack([-run.data.point_mm[:, 1], run.data.point_mm[:, 0]]) * (MM / UM)
    angles = read @ turn[:, :2].T
    return {letter: angles[:, k] for k, letter in enumerate("ABC") if abs(turn[k, 2]) < BLIND}
