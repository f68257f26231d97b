"""Kinematic tests in the manner of ISO 10791-6: X, Y and Z follow one or both rotary axes.

The ball in the spindle stays at one place on the table.
"""

from __future__ import annotations

from functools import partial
from typing import Final, Literal

import numpy as np

from twin._common.errors import InputError
from twin.planning.sequences.specification import MeasuringSequence, SequencePoints, SequenceTask

STEPS: Final = 37
"""Number of points of a run."""


def _points(task: SequenceTask, side: Literal["tool", "work"], number: int) -> SequencePoints:
    """Return the points of test 1 (first rotary axis), 2 (second rotary axis) or 4 (both), forwards and backwards."""
    machine = task.machine
    own = [i for i in task.rotary if machine.axes[i].side == side]
    if len(own) != 2 or len(task.rotary) != 2:
        raise InputError(
            f"this test is for machines with both rotary axes on the {'spindle' if side == 'tool' else 'table'} side",
            expected="another sequence",
            value=f"{machine.name}: {', '.join(f'{machine.axes[i].name} on the {machine.axes[i].side} side' for i in task.rotary)}",
        )
    low, high = task.kit.ranges.T
    moving = {1: own[:1], 2: own[1:], 4: own}[number]
    runs, names = [], list(task.places_mm)
    for _ in names:
        run = np.tile(task.rest(), (STEPS, 1))
        for axis in moving:
            run[:, axis] = np.linspace(low[axis], high[axis], STEPS)
        runs += [run, run[::-1]]
    return SequencePoints.at_places(
        np.concatenate(runs),
        np.repeat(np.array(names, dtype=object), 2 * STEPS),
        np.repeat(np.arange(1, len(runs) + 1), STEPS),
    )


def _test(side: Literal["tool", "work"], number: int) -> MeasuringSequence:
    letter = "A" if side == "tool" else "B"
    moving = {1: "the first rotary axis", 2: "the second rotary axis", 4: "both rotary axes"}[number]
    where = "spindle" if side == "tool" else "table"
    return MeasuringSequence(
        name=f"{letter.lower()}k{number}",
        title=f"{letter}K{number}: {moving} with X, Y and Z, forwards and backwards; rotary axes on the {where} side",
        source=f"ISO 10791-6:2014, kinematic test {letter}K{number}, from public descriptions",
        instruments=("r-test",),
        unverified=(
            "The text of the standard was not available: which test has which axes, the ranges, the number of points, the place of the "
            "ball, the feed and the evaluation are not verified. Tests 3 and CK are not included."
        ),
        limits="Points are stationary: dynamic deviations of the interpolation do not show.",
        make=partial(_points, side=side, number=number),
    )


_SIDES: Final[tuple[Literal["tool", "work"], ...]] = ("tool", "work")
INTERPOLATION: Final = tuple(_test(side, number) for side in _SIDES for number in (1, 2, 4))
