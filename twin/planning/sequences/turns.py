"""Turns: each rotary axis alone, with the sphere or the ball near the rim of the table."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.planning.sequences.specification import MeasuringSequence, SequencePoints, SequenceTask

STEPS: Final = 7
"""Number of positions of a rotary axis in one run."""
OTHER_DEG: Final = 90.0
"""Position of the other rotary axes in the second run of an axis, or the end of their range nearest to it."""


def _points(task: SequenceTask) -> SequencePoints:
    if not task.rotary:
        raise InputError(
            "the machine has no rotary axis", expected="a machine with a rotary axis", value=task.machine.name
        )
    low, high = task.kit.ranges.T
    rest, runs = task.rest(), []
    for name in task.places_mm:
        for axis in task.rotary:
            others = [i for i in task.rotary if i != axis]
            second = np.array(rest)
            second[others] = np.clip(OTHER_DEG, low[others], high[others])
            for fixed in (rest, second) if others else (rest,):
                run = np.tile(fixed, (STEPS, 1))
                run[:, axis] = np.linspace(low[axis], high[axis], STEPS)
                runs.append((name, run))
    return SequencePoints.at_places(
        np.concatenate([run for _, run in runs]),
        np.repeat(np.array([name for name, _ in runs], dtype=object), STEPS),
        np.repeat(np.arange(1, len(runs) + 1), STEPS),
    )


TURNS: Final = MeasuringSequence(
    name="turns",
    title="each rotary axis alone over its range, the other at zero and at one other angle",
    source="after the description of touch probe cycle 451 (MEASURE KINEMATICS) in the HEIDENHAIN TNC 640 and TNC7 manuals",
    instruments=("probe", "r-test"),
    unverified="The cycle chooses its own contacts and corrects the control's kinematics; this sequence only has such poses.",
    limits="Every axis turns in one direction only, so reversal errors do not show.",
    make=_points,
)
