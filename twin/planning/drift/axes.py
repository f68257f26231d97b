"""Moving linear or rotary axis: motion to and fro, readings at two target positions or at several angles, then rest."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.planning.drift.specification import PROBE_EVERY_S, READ_S, DriftSchedule, DriftSequence, DriftTask
from twin.planning.sequences.expectation import CONTACT_S, CONTACTS, POINT_S, RETRACT_MM

RUNNING_SHARE: Final = 0.8
"""Share of the time in which the axis moves; it rests in the remaining time."""
ALONG: Final = 0.5
"""Direction cosine with the spindle above which an axis moves along it."""


def _schedule(task: DriftTask) -> DriftSchedule:
    return _linear(task) if task.moved.linear else _rotary(task)


def _linear(task: DriftTask) -> DriftSchedule:
    places = np.array(list(task.base.places_mm.values()))
    stroke = float(np.linalg.norm(places[1] - places[0]))
    name = task.moved.name
    notice = "readings at the two target positions; between them, strokes of {name} between the two target positions at {feed:g} mm/min"
    notices = [notice.format(name=name, feed=task.feed)]
    if abs(task.moved.machine_direction[2]) > ALONG:
        notices.append(
            f"{name} needs places at two levels: the upper part stands on a riser beside the lower one, because the tool comes from "
            "above; the change of the distance contains the riser's own expansion (iron: 12 µm per metre and kelvin); the width of "
            "the riser is not checked"
        )
    return _repeated(task, np.array([stroke]), stroke, notices)


def _rotary(task: DriftTask) -> DriftSchedule:
    angles = np.array(task.angles_deg)
    low, high = task.base.kit.ranges[task.axis]
    name, listed = task.moved.name, ", ".join(f"{angle:g}" for angle in angles)
    notices = [
        f"readings at {name} {listed} degrees in every cycle; between the cycles, turns of {name} between {low:g} and {high:g} degrees "
        f"at {task.feed:g} degrees/min; the default is the assumed fastest feed of the kit: state that of the machine",
        "the spindle and the linear axes drift too: run the test of the environment before, at one of these poses",
        "the test of rotary axes has a name in the public scope of the standard; its positions and times are choices of twin",
    ]
    return _repeated(task, np.diff(angles), float(high - low), notices)


def _repeated(task: DriftTask, steps: np.ndarray, stroke: float, notices: list[str]) -> DriftSchedule:
    """Return cycles of readings, one at each pose, with motion of the axis between the cycles.

    Args:
        task: the task.
        steps: (poses - 1,) travel of the axis from pose to pose, mm or degrees.
        stroke: its travel to one side between the cycles.
        notices: the notices of the axis.

    Raises:
        InputError: the readings leave less than half of the time for the motion.
    """
    probing = task.instrument == "probe"
    every = PROBE_EVERY_S if probing else READ_S
    speed = float(task.base.kit.speeds[list(task.base.machine.linear)].min())
    slow = 2.0 * RETRACT_MM / speed + (CONTACTS * CONTACT_S if probing else POINT_S)
    offset = np.r_[0.0, np.cumsum(slow + 60.0 * steps / task.feed)]
    whole = offset[-1] + slow + 60.0 * float(np.sum(steps)) / task.feed
    if whole > every / 2.0:
        least = 120.0 * float(np.sum(steps)) / max(every / 2.0 - slow * (len(steps) + 1), 1.0)
        raise InputError(
            "the feed leaves no time to heat the axis between readings",
            expected=f"at least {least:.0f} per minute for {np.sum(steps):.0f} mm or degrees",
            value=task.feed,
        )
    start = task.reading_times(every)[:-1]
    time = (start[:, None] + offset).reshape(-1)
    running = RUNNING_SHARE * task.seconds
    last = np.arange(len(time)) % len(offset) == len(offset) - 1
    found = [
        *notices,
        f"the axis moves up to {running / 60.0:.0f} min, some {int((every - whole) // (120.0 * stroke / task.feed))} times to and fro "
        "after each cycle of readings; then it rests between the readings",
        f"readings take {whole / every:.0%} of the time, in which the axis does not heat up as between them",
    ]
    if probing:
        found.append("probing moves all linear axes: they warm a little at every reading")
    pose = np.tile(np.arange(len(offset)), len(start))
    return DriftSchedule(time, np.zeros(len(time)), pose, last & (time < running), tuple(found))


AXES: Final = DriftSequence(
    name="axes",
    title="thermal distortion caused by a moving axis: motion to and fro, cycles of readings, then rest",
    minutes=240.0,
    targets=2,
    limits="It shows one axis, at the positions of the readings only: let the machine cool before the next axis.",
    make=_schedule,
)
