"""Rotating spindle: speed steps or a spectrum of speeds, then rest."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.planning.drift.specification import PROBE_EVERY_S, READ_S, DriftSchedule, DriftSequence, DriftTask
from twin.planning.sequences.expectation import CONTACT_S, CONTACTS

STEPS: Final = (0.25, 0.5, 0.75, 1.0)
"""Speeds of the steps as shares of the highest one."""
RUNNING_SHARE: Final = 0.8
"""Share of the time in which the spindle runs; it rests in the remaining time."""
SEGMENT_S: Final = 600.0
"""Time at one speed of a spectrum, s."""
STOP_S: Final = 60.0
"""Seconds assumed to stop the spindle, put the probe in, and put the test tool back."""


def _schedule(task: DriftTask) -> DriftSchedule:
    if task.highest_rpm is None:
        raise InputError("no highest spindle speed", expected="the highest speed to run, 1/min")
    probing = task.instrument == "probe"
    time = task.reading_times(PROBE_EVERY_S if probing else READ_S)
    running = RUNNING_SHARE * task.seconds
    middle = np.r_[0.0, (time[1:] + time[:-1]) / 2.0]  # a speed is that of the interval before its reading
    if task.spectrum:
        shares = np.random.default_rng(task.base.seed).choice((0.0, *STEPS), size=int(running // SEGMENT_S) + 1)
        shares[0] = STEPS[1]
        share = shares[np.minimum(middle // SEGMENT_S, len(shares) - 1).astype(int)]
    else:
        share = np.array(STEPS)[np.minimum(middle // (running / len(STEPS)), len(STEPS) - 1).astype(int)]
    speed = np.where((middle > 0.0) & (middle < running), np.round(share * task.highest_rpm), 0.0)
    notices = ["spindle_rpm is the speed from the reading before to this one; the first reading is of the cold machine"]
    if probing:
        stopped = STOP_S + CONTACTS * CONTACT_S
        notices += [
            f"a probe needs the spindle stopped: about {stopped:.0f} s at every reading (assumed), "
            f"{stopped / PROBE_EVERY_S:.0%} of the time; spindle nose and bearings cool meanwhile, so that less growth shows than in "
            "steady running",
            f"growth with a time constant of less than {stopped / 60.0:.1f} min and shifts with the speed at once do not show; "
            "the repeatability of the tool change is in every reading",
        ]
    elif task.instrument == "r-test":
        notices.append(
            "only a nest with non-contact sensors reads while the ball rotates; stop the spindle for a contacting one"
        )
    else:
        notices.append("run-out and expansion of the mandrel are in the readings: average over whole turns")
    return DriftSchedule(time, speed, np.zeros(len(time), dtype=int), np.zeros(len(time), dtype=bool), tuple(notices))


SPINDLE: Final = DriftSequence(
    name="spindle",
    title="thermal distortion caused by a rotating spindle: speeds, then rest",
    minutes=300.0,
    targets=1,
    limits="It shows one pose without cutting load. Steps separate speed from time only if each lasts longer than "
    "the spindle's time constant, or by a spectrum.",
    make=_schedule,
)
