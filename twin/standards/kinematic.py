"""Kinematic tests with linear and rotary axes after ISO 10791-6: deviations while the nominal point of contact stands still.

A run counts as such a test if the nominal machine, for some place of the target, keeps the target at one point of the frame on which
the station rides (R-test, ball bar, touch probe and sphere). Names follow the machine: A where both rotary axes carry the tool, B where
both carry the work, C for one of each; 1 and 2 for a single rotary axis, counted from the base, and 4 for both together. The exact
content of the standard's clauses was not available: names and quantities are not verified against its text.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.units import MM, UM
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.observation import Observation
from twin.standards.readings import NotPossible
from twin.standards.result import StandardTest, StandardValue
from twin.standards.runs import MeasuredRun
from twin.standards.words import place_of

KINEMATIC: Final = "after ISO 10791-6:2014 (not verified)"
STANDS_STILL_MM: Final = 1.0
"""Motion of the nominal point, mm, up to which it counts as standing still."""
LEAST_TURN_DEG: Final = 5.0


def kinematic_test(run: MeasuredRun, observation: Observation, u_mm: np.ndarray) -> StandardTest | None:
    """Evaluate an interpolated motion of linear and rotary axes; None if the nominal point does not stand still.

    Args:
        run: a run in which linear and rotary axes move.
        observation: the nominal positions of the targets.
        u_mm: (n, 3) standard uncertainties of its readings.

    Raises:
        NotPossible: no coordinate was read in every row.
    """
    machine, data = observation.machine, run.data
    turning = [i for i in run.axes if not machine.axes[i].linear]
    if max(float(np.ptp(data.positions[:, i])) for i in turning) < LEAST_TURN_DEG:
        return None
    nominal, free = _nominal_motion(run, observation)
    if float(np.abs(nominal).max()) > STANDS_STILL_MM:
        return None
    if not run.read.any():
        raise NotPossible("no coordinate was read in every row")
    constant = bool(np.ptp(data.point_mm[:, run.read], axis=0).max() == 0.0)
    length_only = run.read.tolist() == [True, False, False]
    readings = data.point_mm - data.point_mm.mean(axis=0)
    if not length_only:
        readings = readings - nominal
    deviation = np.where(run.read, readings, np.nan) * (MM / UM)
    remarks = [
        "what was evaluated: the range (largest minus smallest) of the deviation in each direction of the station's frame; the name of "
        "the test and the quantity are not verified against the text of the standard",
        "the directions are those of the station's frame; the zero of the readings and the place of the target have no influence"
        if free is None
        else free,
    ]
    if constant:
        remarks.append(
            "the readings are constant: the deviations are those of the recorded axis positions (touch probe)"
        )
    columns = ("length",) if length_only else ("x", "y", "z")
    values = []
    for k, name in enumerate(columns):
        if run.read[k]:
            u = u_mm[:, k]
            u_um = float(np.sqrt(np.mean(u**2))) * (MM / UM)
            words = f"range of the deviation, {'length' if length_only else f'{name} of the station'}"
            values.append(
                StandardValue(f"range {name}", f"range_{name}", float(np.ptp(deviation[:, k])), "um", words, float(np.sqrt(2.0) * u_um))
            )  # fmt: skip
    names = tuple(machine.axes[i].name for i in run.axes)
    return StandardTest(
        kind="kinematic",
        name=f"{_name(machine, turning)} ({''.join(names)})",
        standard=KINEMATIC,
        axes=names,
        place=place_of(run),
        values=tuple(values),
        remarks=tuple(remarks),
        detail=deviation,
    )


def _nominal_motion(run: MeasuredRun, observation: Observation) -> tuple[np.ndarray, str | None]:
    """Return the motion (n, 3) of the nominal point, mm, and a remark if the target's place was fitted to the positions."""
    machine, data = observation.machine, run.data
    zero = Calibration.zero(machine)
    errors = observation.errors(zero, data, check=False)
    q = np.asarray(data.positions) * machine.scale
    known = bool(np.isfinite(data.place_mm).all())
    place = data.place_mm * MM if known else np.zeros((len(q), 3))
    carried = observation.carried(q, errors, data.carrier, place, data.station_carrier)
    points = carried.points / MM
    if known:
        return points - points.mean(axis=0), None
    turned = carried.rotation - carried.rotation.mean(axis=0)
    centred = points - points.mean(axis=0)
    fitted, *_ = np.linalg.lstsq(turned.reshape(-1, 3), -centred.reshape(-1), rcond=1e-9)
    return (
        centred + turned @ fitted,
        "the place of the target is the one that keeps the nominal point most nearly at rest",
    )


def _name(machine: Machine, turning: list[int]) -> str:
    """Return the name of the test by the sides that the rotary axes carry."""
    rotary = machine.rotary
    sides = {machine.axes[i].side for i in rotary}
    if len(rotary) != 2 or not sides <= {"tool", "work"}:
        return "kinematic"
    letter = "C" if len(sides) == 2 else "A" if sides == {"tool"} else "B"
    if len(turning) == 2:
        return f"{letter}K4"
    # Of two axes on one side, the one nearer the base carries the other.
    order = sorted(rotary, key=lambda i: machine.axis_joints[i])
    return f"{letter}K{order.index(turning[0]) + 1}"
