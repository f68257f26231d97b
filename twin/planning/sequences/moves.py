"""The measuring sequences: best poses, turns, interpolated motions of ISO 10791-6, circles. To add one, add it here.

In the kinematic tests in the manner of ISO 10791-6 the ball in the spindle stays at one place on the table. The text of the standard
was not read. Its public scope names neither tests nor axes. Florussen, Houben, Spaan and Spaan-Burke (Automating Accuracy Evaluation of
5-Axis Machine Tools, 2020, abstract) use BK1 and BK2 on machines with a trunnion or swivel table, for the average line of each rotary
axis, with one ball; in BK4 all five axes move. AK1, AK2 and AK4 are the same motions with both rotary axes on the spindle side, by
analogy. No public description was found that says which axes move in tests 3, or in CK (one rotary axis on each side); these are
refused (`NOT_DESCRIBED`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.messages import Message
from twin.identification.unidentified import constant_rows, without_setup
from twin.measurement.instruments import StationInstruments
from twin.measurement.set_up import StationsAndTargets
from twin.planning.design import Exchange
from twin.planning.sequences.contacts import reach
from twin.planning.sequences.specification import (
    SET_UPS,
    MeasuringSequence,
    SequencePoints,
    SequenceTask,
    minutes_of,
    seconds_of,
    sequence_table,
    with_nominal_readings,
)
from twin.planning.task import LinearAim

BEST_STEP_DEG: Final = 15.0
"""Largest step of the grid of candidate positions of a rotary axis."""
MOST_CANDIDATES: Final = 1500
"""Number of candidates above which a random selection is taken."""
MOST_POSES: Final = 20_000
"""Size of the grid above which its poses are drawn at random."""
FEWEST: Final = 6
"""Fewest poses of a design."""
MOST: Final = 400
"""Most poses of a design."""
ATTEMPTS: Final = 4
"""Number of corrections of the number of poses for the duration of the ordered design."""


def _best_points(task: SequenceTask) -> SequencePoints:
    reached = reach(task, grid(task))
    candidates = _with_time(task, reached.points)
    if len(candidates) < FEWEST:
        why = ", ".join(f"{name}: {count}" for name, count in reached.dropped.items())
        raise InputError(
            f"too few poses are reached with clearance ({why})",
            expected=f"at least {FEWEST}: other places on the table, another tool length or smaller sizes",
            value=len(candidates),
        )
    rows, prior, aim = _problem(task, candidates)
    rng = np.random.default_rng(task.seed)
    cost = np.ones(len(candidates))
    exchange = Exchange(prior, rows, cost, aim, most=1, among=len(candidates))
    count = min(len(candidates), MOST)
    mean = minutes_of(task.machine, task.kit, sequence_table(task, candidates)) / len(candidates)
    count = int(np.clip(task.minutes / mean, FEWEST, count))
    for _ in range(ATTEMPTS):
        chosen = exchange.choose(count, rng.permutation(len(candidates)), min(FEWEST, count))
        taken = ordered(task, candidates.select(chosen))
        needed = minutes_of(task.machine, task.kit, sequence_table(task, taken))
        set_up = len(set(taken.place)) * task.words.set_up_s / 60.0
        each = (needed - set_up) / count
        fitting = int(np.clip((task.minutes - set_up) / each, 0, min(len(candidates), MOST)))
        if needed <= task.minutes and fitting <= count:
            return taken
        count = fitting if fitting != count else count - 1
        if count < FEWEST:
            break
    while needed > task.minutes and len(taken) > FEWEST:
        taken = taken.select(np.arange(len(taken) - 1))
        needed = minutes_of(task.machine, task.kit, sequence_table(task, taken))
    if needed > task.minutes:
        raise InputError(
            "time budget is too short for a measurement",
            expected=f"at least {np.ceil(needed):.0f} minutes, set-up included",
            value=task.minutes,
        )
    return taken


def _with_time(task: SequenceTask, points: SequencePoints) -> SequencePoints:
    """Return the points at as many of the places as the time allows to set up with the fewest poses, in their order."""
    if not len(points):
        return points
    names = [name for name in task.places_mm if np.any(points.place == name)]
    each = float(seconds_of(task.machine, task.kit, sequence_table(task, points)).mean())
    affordable = int((60.0 * task.minutes - FEWEST * each) / task.words.set_up_s)
    return points.select(np.isin(points.place, names[: max(affordable, 1)]))


def grid(task: SequenceTask) -> SequencePoints:
    """Return the poses of a grid of the rotary axes, for every place on the table; linear positions not yet computed."""
    if not task.rotary:
        raise InputError(
            "the machine has no rotary axis", expected="a machine with a rotary axis", value=task.machine.name
        )
    grids = []
    for i in task.rotary:
        low, high = task.kit.ranges[i]
        count = int(np.ceil((high - low) / BEST_STEP_DEG)) + 1
        steps = np.linspace(low, high, count)
        grids.append(steps[:-1] if task.machine.axes[i].lower is None else steps)
    if np.prod([float(len(grid)) for grid in grids]) <= MOST_POSES:
        poses = np.array(list(product(*grids)))
    else:
        draw = np.random.default_rng(task.seed)
        poses = np.stack([draw.choice(steps, MOST_CANDIDATES) for steps in grids], axis=1)
    names = list(task.places_mm)
    positions = np.tile(task.rest(), (len(poses) * len(names), 1))
    positions[:, list(task.rotary)] = np.tile(poses, (len(names), 1))
    place = np.repeat(np.array(names, dtype=object), len(poses))
    points = SequencePoints.at_places(positions, place, np.ones(len(positions), dtype=int))
    if len(points) > MOST_CANDIDATES:
        some = np.random.default_rng(task.seed).permutation(len(points))[:MOST_CANDIDATES]
        points = points.select(np.sort(some))
    return points


def _problem(task: SequenceTask, candidates: SequencePoints) -> tuple[np.ndarray, np.ndarray, LinearAim]:
    """Return derivatives (n, 3, f), prior precision (f, f) and A-optimality over what the candidates determine, set-up unknown."""
    table = with_nominal_readings(task.machine, sequence_table(task, candidates), task.instrument)
    instruments = StationInstruments.same(task.instrument, table.station)
    setup = StationsAndTargets.from_table(table, instruments)
    unknown = replace(
        setup,
        station_known=np.zeros(len(setup.stations), dtype=bool),
        target_known=np.zeros(len(setup.targets), dtype=bool),
    )
    found = constant_rows(task.machine, table, instruments, unknown)
    if found is None:
        raise InputError("no axis with constant errors moves", expected="poses that differ")
    unknowns, rows = found
    own, size = len(unknowns), rows.shape[-1]
    strength, directions = without_setup(rows, own)
    seen = np.zeros((int(np.sum(strength > 1.0)), size))
    seen[:, :own] = directions[strength > 1.0]
    return rows, np.eye(size), LinearAim(seen[None], "constant errors", "of the plausible size")


def ordered(task: SequenceTask, points: SequencePoints) -> SequencePoints:
    """Return the points place by place, each time continuing with the pose that is reached first."""
    order: list[int] = []
    here = points.positions[0]
    for name in task.places_mm:
        remaining = np.flatnonzero(points.place == name).tolist()
        while remaining:
            away = np.abs(points.positions[remaining] - here) / task.kit.speeds
            taken = remaining.pop(int(np.argmin(away.max(axis=1))))
            here = points.positions[taken]
            order.append(taken)
    return points.select(np.array(order, dtype=int))


BEST: Final = MeasuringSequence(
    name="best",
    title=Message("poses chosen for the smallest uncertainty of the constant errors in the time given"),
    source=Message(
        "A-optimal design by exchange (Fedorov 1972; Atkinson, Donev and Tobias 2007) over a grid of the rotary axes"
    ),
    instruments=("probe", "r-test"),
    unverified=Message(""),
    limits=Message("Error motions that depend on the position are not part of the criterion."),
    make=_best_points,
)

# --- Circular tests with a ball bar in the planes XY, YZ and ZX, in both directions ---------------

STEP_DEG: Final = 5.0
FULL_DEG: Final = (0.0, 360.0)
ARC_DEG: Final = (-20.0, 200.0)
"""Arc of the vertical planes: the ball cannot go below the pivot, which stands on the table."""
PLANES: Final = ((0, 1), (1, 2), (2, 0))
"""Base directions of the planes XY, YZ and ZX; the angle counts from the first of them towards the second."""


def _points(task: SequenceTask) -> SequencePoints:
    runs: list[np.ndarray] = []
    places: list[str] = []
    for name in task.places_mm:
        for first, second in PLANES:
            arc = FULL_DEG if 2 not in (first, second) else ARC_DEG
            count = round((arc[1] - arc[0]) / STEP_DEG) + 1
            # The arc is centred on the upward direction of a vertical plane.
            start = -90.0 if first == 2 else 0.0
            angle = np.radians(np.linspace(*arc, count) + start)
            circle = np.zeros((count, 3))
            circle[:, first], circle[:, second] = np.cos(angle), np.sin(angle)
            runs += [task.sizes.bar_mm * circle, task.sizes.bar_mm * circle[::-1]]
            places += [name, name]
    size = [len(run) for run in runs]
    return SequencePoints(
        np.tile(task.rest(), (sum(size), 1)),
        np.repeat(np.array(places, dtype=object), size),
        np.concatenate(runs),
        np.repeat(np.arange(1, len(runs) + 1), size),
    )


CIRCLES: Final = MeasuringSequence(
    name="circles",
    title=Message("circles in XY and arcs of 220° in YZ and ZX, in both directions, rotary axes at rest"),
    source=Message("ISO 230-4:2022, circular tests"),
    instruments=("ball-bar",),
    unverified=Message(
        "The text of the standard was not available; the number of points is a choice. Arcs of 220° replace the circles of the "
        "vertical planes, as is usual with a pivot on the table. The bar itself is not checked for collisions."
    ),
    limits=Message(
        "Rotary axes do not move, so their errors do not show. Scales rest on the calibrated length of the bar."
    ),
    make=_points,
)

# --- Kinematic tests in the manner of ISO 10791-6: X, Y and Z follow one or both rotary axes ------

DESCRIBED: Final = Message("the abstract of Florussen et al. 2020 (R-test on trunnion machines)")
ANALOGY: Final = Message("the analogous test of trunnion machines")
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
INTERPOLATION_STEPS: Final = 37
"""Number of points of a run."""


def _interpolation_points(task: SequenceTask, side: Literal["tool", "work"], number: int) -> SequencePoints:
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
        run = np.tile(task.rest(), (INTERPOLATION_STEPS, 1))
        for axis in moving:
            run[:, axis] = np.linspace(low[axis], high[axis], INTERPOLATION_STEPS)
        runs += [run, run[::-1]]
    return SequencePoints.at_places(
        np.concatenate(runs),
        np.repeat(np.array(names, dtype=object), 2 * INTERPOLATION_STEPS),
        np.repeat(np.arange(1, len(runs) + 1), INTERPOLATION_STEPS),
    )


def _test(side: Literal["tool", "work"], number: int) -> MeasuringSequence:
    letter = "A" if side == "tool" else "B"
    moving = {
        1: Message("the first rotary axis"),
        2: Message("the second rotary axis"),
        4: Message("both rotary axes"),
    }[number]
    where = Message("spindle") if side == "tool" else Message("table")
    return MeasuringSequence(
        name=f"{letter.lower()}k{number}",
        title=Message(
            "{letter}K{number}: {moving} with X, Y and Z, forwards and backwards; rotary axes on the {where} side",
            letter=letter,
            number=number,
            moving=moving,
            where=where,
        ),
        source=Message(
            "ISO 10791-6:2014, kinematic test {letter}K{number}, after {source}",
            letter=letter,
            number=number,
            source=DESCRIBED if side == "work" else ANALOGY,
        ),
        instruments=("r-test",),
        unverified=Message(
            "The text of the standard was not available: which test has which axes, the ranges, the number of points, the place of the "
            "ball, the feed and the evaluation are not verified."
        ),
        limits=Message("Points are stationary: dynamic deviations of the interpolation do not show."),
        make=partial(_interpolation_points, side=side, number=number),
    )


_SIDES: Final[tuple[Literal["tool", "work"], ...]] = ("tool", "work")
INTERPOLATION: Final = tuple(_test(side, number) for side in _SIDES for number in (1, 2, 4))

# --- Turns: each rotary axis alone, with the sphere or the ball near the rim of the table ---------

STEPS: Final = 7
"""Number of positions of a rotary axis in one run."""
OTHER_DEG: Final = 90.0
"""Position of the other rotary axes in the second run of an axis, or the end of their range nearest to it."""


def _turns_points(task: SequenceTask) -> SequencePoints:
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
    title=Message("each rotary axis alone over its range, the other at zero and at one other angle"),
    source=Message(
        "after the description of touch probe cycle 451 (MEASURE KINEMATICS) in the HEIDENHAIN TNC 640 and TNC7 manuals"
    ),
    instruments=("probe", "r-test"),
    unverified=Message(
        "The cycle chooses its own contacts and corrects the control's kinematics; this sequence only has such poses."
    ),
    limits=Message("Every axis turns in one direction only, so reversal errors do not show."),
    make=_turns_points,
)

# --- All sequences --------------------------------------------------------------------------------

SEQUENCES: Final = (BEST, TURNS, *INTERPOLATION, CIRCLES)
"""The first for an instrument is its default; their names are `twin._common.families.SEQUENCES`."""


def sequence_named(name: str | None, instrument: str) -> MeasuringSequence:
    """Return the sequence of a name for an instrument, the default one if None; `InputError` if it has none of this name."""
    known = [sequence for sequence in SEQUENCES if instrument in sequence.instruments]
    names = [one.name for one in known]
    if name is None and known:
        return known[0]
    if name is not None and name.lower() in NOT_DESCRIBED:
        raise InputError(
            f"test {name.upper()} of ISO 10791-6 is not included: no public description says {NOT_DESCRIBED[name.lower()]}",
            expected=f"one of {', '.join(names)}" if names else f"an instrument among {', '.join(SET_UPS)}",
        )
    if name not in names:
        raise InputError(
            f"no such sequence for instrument {instrument}",
            expected=f"one of {', '.join(names)}" if names else f"an instrument among {', '.join(SET_UPS)}",
            value=name,
            nearest=closest_name(str(name), names),
        )
    return known[names.index(name)]
