"""Kinematic tests in the manner of ISO 10791-6: X, Y and Z follow one or both rotary axes.

The ball in the spindle stays at one place on the table. The text of the standard was not read. Its public scope names neither tests nor
axes. Florussen, Houben, Spaan and Spaan-Burke (Automating Accuracy Evaluation of 5-Axis Machine Tools, 2020, abstract) use BK1 and BK2
on machines with a trunnion or swivel table, for the average line of each rotary axis, with one ball; in BK4 all five axes move. AK1,
AK2 and AK4 are the same motions with both rotary axes on the spindle side, by analogy. No public description was found that says which
axes move in tests 3, or in CK (one rotary axis on each side); these are refused (`NOT_DESCRIBED`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from twin._common.errors import InputError
from twin.planning.sequences.specification import MeasuringSequence, SequencePoints, SequenceTask

DESCRIBED: Final = "the abstract of Florussen et al. 2020 (R-test on trunnion machines)"
ANALOGY: Final = "the analogous test of trunnion machines"
NOT_DESCRIBED: Final[Mapping[str, str]] = MappingProxyType(
    {
        **dict.fromkeys(("ak3", "bk3"), "which axes move in test 3, and where the sensor is"),
        **{
            f"ck{number}": "which axes move in the CK tests, over which ranges, and where the sensor is"
            for number in (1, 2, 3, 4)
        },
    }
)
"""Tests of ISO 10791-6 that cannot be planned, and what no public description says about them."""
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
        source=f"ISO 10791-6:2014, kinematic test {letter}K{number}, after {DESCRIBED if side == 'work' else ANALOGY}",
        instruments=("r-test",),
        unverified=(
            "The text of the standard was not available: which test has which axes, the ranges, the number of points, the place of the "
            "ball, the feed and the evaluation are not verified."
        ),
        limits="Points are stationary: dynamic deviations of the interpolation do not show.",
        make=partial(_points, side=side, number=number),
    )


_SIDES: Final[tuple[Literal["tool", "work"], ...]] = ("tool", "work")
INTERPOLATION: Final = tuple(_test(side, number) for side in _SIDES for number in (1, 2, 4))
