"""Environmental temperature variation error: the machine at rest, readings over hours."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.planning.drift.specification import READ_S, DriftSchedule, DriftSequence, DriftTask

DAY_MINUTES: Final = 24.0 * 60.0


def _schedule(task: DriftTask) -> DriftSchedule:
    time = task.reading_times(READ_S)
    notices = ["drives and cooling stay on, the spindle stands still; record the ambient temperature near the machine"]
    if task.instrument == "probe":
        notices.append("probing moves the axes: they warm a little at every reading, which sensors avoid")
    if task.base.minutes < DAY_MINUTES:
        notices.append("less than 24 h: the daily change of the environment is not complete")
    return DriftSchedule(
        time, np.zeros(len(time)), np.zeros(len(time), dtype=int), np.zeros(len(time), dtype=bool), tuple(notices)
    )


ENVIRONMENT: Final = DriftSequence(
    name="environment",
    title="environmental temperature variation error (ETVE): machine at rest",
    minutes=DAY_MINUTES,
    targets=1,
    limits="It shows one pose on one day; a change that the ambient sensor does not feel (sun, a door) looks like drift.",
    make=_schedule,
)
