"""The design that determines the constant errors best in the time given: poses chosen among many by exchange."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.identification.constant_errors import constant_rows
from twin.identification.setup import SetUp
from twin.measurement.instruments import StationInstruments
from twin.planning.aims import LinearAim
from twin.planning.design import Exchange
from twin.planning.sequences.expectation import minutes_of, seconds_of, sequence_table, with_nominal_readings
from twin.planning.sequences.reach import reach
from twin.planning.sequences.specification import MeasuringSequence, SequencePoints, SequenceTask

STEP_DEG: Final = 15.0
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


def _points(task: SequenceTask) -> SequencePoints:
    reached = reach(task, _grid(task))
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
        ordered = _ordered(task, candidates.select(chosen))
        needed = minutes_of(task.machine, task.kit, sequence_table(task, ordered))
        set_up = len(set(ordered.place)) * task.words.set_up_s / 60.0
        each = (needed - set_up) / count
        fitting = int(np.clip((task.minutes - set_up) / each, 0, min(len(candidates), MOST)))
        if needed <= task.minutes and fitting <= count:
            return ordered
        count = fitting if fitting != count else count - 1
        if count < FEWEST:
            break
    while needed > task.minutes and len(ordered) > FEWEST:
        ordered = ordered.select(np.arange(len(ordered) - 1))
        needed = minutes_of(task.machine, task.kit, sequence_table(task, ordered))
    if needed > task.minutes:
        raise InputError(
            "time budget is too short for a measurement",
            expected=f"at least {np.ceil(needed):.0f} minutes, set-up included",
            value=task.minutes,
        )
    return ordered


def _with_time(task: SequenceTask, points: SequencePoints) -> SequencePoints:
    """Return the points at as many of the places as the time allows to set up with the fewest poses, in their order."""
    if not len(points):
        return points
    names = [name for name in task.places_mm if np.any(points.place == name)]
    each = float(seconds_of(task.machine, task.kit, sequence_table(task, points)).mean())
    affordable = int((60.0 * task.minutes - FEWEST * each) / task.words.set_up_s)
    return points.select(np.isin(points.place, names[: max(affordable, 1)]))


def _grid(task: SequenceTask) -> SequencePoints:
    """Return the poses of a grid of the rotary axes, for every place on the table; linear positions not yet computed."""
    if not task.rotary:
        raise InputError(
            "the machine has no rotary axis", expected="a machine with a rotary axis", value=task.machine.name
        )
    grids = []
    for i in task.rotary:
        low, high = task.kit.ranges[i]
        count = int(np.ceil((high - low) / STEP_DEG)) + 1
        grid = np.linspace(low, high, count)
        grids.append(grid[:-1] if task.machine.axes[i].lower is None else grid)
    if np.prod([float(len(grid)) for grid in grids]) <= MOST_POSES:
        poses = np.array(list(product(*grids)))
    else:
        draw = np.random.default_rng(task.seed)
        poses = np.stack([draw.choice(grid, MOST_CANDIDATES) for grid in grids], axis=1)
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
    """Return the derivatives (n, 3, f), the prior precision (f, f) and the criterion, with the set-up unknown.

    The criterion is the sum of the relative variances of all combinations of constant errors that the candidates determine (A-optimal).
    """
    table = with_nominal_readings(task.machine, sequence_table(task, candidates), task.instrument)
    instruments = StationInstruments.same(task.instrument, table.station)
    setup = SetUp.from_table(table, instruments)
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
    flat = rows.reshape(-1, size)
    whole = np.concatenate([np.concatenate([flat[:, own:], flat[:, :own]], axis=1), np.eye(size - own, size)])
    triangle = np.asarray(np.linalg.qr(whole, mode="r"))[size - own :, size - own :]
    _, strength, directions = np.linalg.svd(triangle)
    seen = np.zeros((int(np.sum(strength > 1.0)), size))
    seen[:, :own] = directions[strength > 1.0]
    return rows, np.eye(size), LinearAim(seen[None], "constant errors", "of the plausible size")


def _ordered(task: SequenceTask, points: SequencePoints) -> SequencePoints:
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
    title="poses chosen for the smallest uncertainty of the constant errors in the time given",
    source="A-optimal design by exchange (Fedorov 1972; Atkinson, Donev and Tobias 2007) over a grid of the rotary axes",
    instruments=("probe", "r-test"),
    unverified="",
    limits="Error motions that depend on the position are not part of the criterion.",
    make=_points,
)
