"""Moving linear axis: traverses between two target positions, readings at both, then rest."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.planning.drift.specification import PROBE_EVERY_S, READ_S, DriftSchedule, DriftSequence, DriftTask
from twin.planning.sequences.expectation import CONTACT_S, CONTACTS, POINT_S, RETRACT_MM

RUNNING_SHARE: Final = 0.8
"""Share of the time in which the axis moves; it rests in the remaining time."""


def _schedule(task: DriftTask) -> DriftSchedule:
    places = np.array(list(task.base.places_mm.values()))
    distance = float(np.linalg.norm(places[1] - places[0]))
    stroke = 60.0 * distance / task.feed_mm_min
    probing = task.instrument == "probe"
    every = PROBE_EVERY_S if probing else READ_S
    slow = 60.0 * 2.0 * RETRACT_MM / task.feed_mm_min + CONTACTS * CONTACT_S if probing else POINT_S
    between = slow + stroke
    if 2.0 * between > every / 2.0:
        raise InputError(
            "the feed leaves no time to heat the axis between readings",
            expected=f"at least {60.0 * distance / max(every / 4.0 - slow, 1.0):.0f} mm/min for {distance:.0f} mm",
            value=task.feed_mm_min,
        )
    start = task.reading_times(every)[:-1]
    time = np.column_stack([start, start + between]).reshape(-1)
    running = RUNNING_SHARE * task.seconds
    double_strokes = int((every - 2.0 * between) // (2.0 * stroke))
    name = task.base.machine.axes[task.axis].name
    notices = [
        f"up to {running / 60.0:.0f} min: after each pair of readings {double_strokes} double strokes of {name} between the two target "
        f"positions at {task.feed_mm_min:g} mm/min; then the axis rests between the readings",
        f"readings take {2.0 * between / every:.0%} of the time, in which the axis does not heat up as between them",
    ]
    if probing:
        notices.append("probing moves all linear axes: they warm a little at every reading")
    return DriftSchedule(time, np.zeros(len(time)), np.tile([0, 1], len(start)), tuple(notices))


AXES: Final = DriftSequence(
    name="axes",
    title="thermal distortion caused by a moving linear axis: traverses between two target positions",
    minutes=240.0,
    targets=2,
    limits="It shows two positions of one axis: let the machine cool before the next axis. Where the screw is heated unevenly, "
    "the error between them is not known.",
    make=_schedule,
)
