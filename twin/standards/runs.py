"""Runs in a measurement table: consecutive rows of one target, read from one station, between which the same axes move.

The order is that of ``time_s`` where every row has it, else that of the rows. A run ends where the round changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

MOVED: Final = 1e-6
"""Difference of two commands, mm or degrees, above which an axis has moved."""
DECIMALS: Final = 4
"""Decimals of the positions by which runs at the same place are joined."""
FEWEST_TARGETS: Final = 3
"""Number of target positions of a run of one axis that is not repeated."""
FEWEST_ROWS: Final = 8
"""Number of rows of a circle, and of an interpolated motion of linear and rotary axes."""
LASTING: Final = 0.8
"""Share of the moves up to which the same rotary axes must move for a division of an interpolated motion."""
LARGEST_RADIUS_MM: Final = 10_000.0
"""Radius above which an arc counts as a line."""
SAME_FEED: Final = 0.05
"""Relative difference up to which two feeds are the same: a ball bar reports the feed that it measured in each run."""
CIRCLE_MM: Final = 0.02
"""Distance of the commands from a circle, mm, up to which a path of two axes is a circle."""


@final
@dataclass(frozen=True)
class MeasuredRun:
    """Rows in which only some axes move.

    Attributes:
        data: the rows, in the order of the run; parts at the same place are joined.
        axes: indices of the axes that move.
        part: (n,) number of the consecutive part to which each row belongs.
        where: positions of the other axes, by name.
    """

    data: Measurements
    axes: tuple[int, ...]
    part: np.ndarray
    where: Mapping[str, float]

    @property
    def station(self) -> str:
        """Name of the station."""
        return str(self.data.station[0])

    @property
    def target(self) -> str:
        """Name of the target."""
        return str(self.data.target[0])

    @property
    def positions(self) -> np.ndarray:
        """(n, axes that move) commanded positions, mm and degrees."""
        return np.asarray(self.data.positions[:, self.axes])

    @property
    def read(self) -> np.ndarray:
        """(3,) whether a coordinate was read in every row."""
        return np.isfinite(self.data.point_mm).all(axis=0)


@final
@dataclass(frozen=True)
class TableRuns:
    """All runs of a table, by kind.

    Attributes:
        single: runs of one axis.
        circles: runs of two linear axes on a circle.
        mixed: runs in which linear and rotary axes move together.
        ordered_by_time: whether ``time_s`` gives the order.
    """

    single: tuple[MeasuredRun, ...]
    circles: tuple[MeasuredRun, ...]
    mixed: tuple[MeasuredRun, ...]
    ordered_by_time: bool


def find_runs(data: Measurements, machine: Machine) -> TableRuns:
    """Return the runs of a table.

    Args:
        data: the measured points.
        machine: the machine that was measured.
    """
    by_time = bool(np.isfinite(data.time_s).all())
    single: list[MeasuredRun] = []
    circles: list[MeasuredRun] = []
    mixed: list[MeasuredRun] = []
    for rows in _series(data, by_time=by_time):
        part = data.select(rows)
        moved = np.abs(np.diff(part.positions, axis=0)) > MOVED
        ends = part.round[1:] != part.round[:-1]
        used = np.zeros(len(part), dtype=bool)
        for kind, found in ((mixed, _mixed(moved, ends, machine)), (circles, _circles(part, moved, ends, machine))):
            for axes, stretch in found:
                used[stretch] = True
                kind.append(_run(part, machine, axes, [stretch]))
        single += _single(part, moved, ends, used, machine)
    return TableRuns(tuple(single), _joined(circles, machine), tuple(mixed), by_time)


def _series(data: Measurements, *, by_time: bool) -> Iterator[np.ndarray]:
    """Yield the rows of every pair of station and target, in order."""
    key = np.array([f"{station}\0{target}" for station, target in zip(data.station, data.target, strict=True)])
    for name in dict.fromkeys(key):
        rows = np.flatnonzero(key == name)
        yield rows[np.argsort(data.time_s[rows], kind="stable")] if by_time else rows


def _stretches(good: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each longest stretch of transitions that are good."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [np.arange(first, last + 1) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def _run(part: Measurements, machine: Machine, axes: tuple[int, ...], stretches: Sequence[np.ndarray]) -> MeasuredRun:
    rows = np.concatenate(stretches)
    where = {axis.name: float(part.positions[rows[0], i]) for i, axis in enumerate(machine.axes) if i not in axes}
    numbers = np.concatenate([np.full(len(stretch), k) for k, stretch in enumerate(stretches)])
    return MeasuredRun(part.select(rows), axes, read_only(numbers), MappingProxyType(where))


def _single(
    part: Measurements, moved: np.ndarray, ends: np.ndarray, used: np.ndarray, machine: Machine
) -> Iterator[MeasuredRun]:
    """Yield the runs of one axis; parts with the other axes at the same positions are joined."""
    for i in range(len(machine.axes)):
        alone = ~np.delete(moved, i, axis=1).any(axis=1) & ~ends
        places: dict[bytes, list[np.ndarray]] = {}
        for stretch in _stretches(alone):
            if moved[stretch[:-1], i].any() and not used[stretch].all():
                others = np.round(np.delete(part.positions[stretch[0]], i), DECIMALS) + 0.0
                places.setdefault(others.tobytes(), []).append(stretch)
        for stretches in places.values():
            rows = np.concatenate(stretches)
            targets, visits = np.unique(np.round(part.positions[rows, i], DECIMALS), return_counts=True)
            if visits.max() == 1 and used[rows].any():
                continue  # a move to or from a circle
            if len(targets) >= FEWEST_TARGETS or visits.min() >= 2:
                yield _run(part, machine, (i,), stretches)


def _mixed(moved: np.ndarray, ends: np.ndarray, machine: Machine) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Yield the stretches in which linear and rotary axes move together, divided where another set of rotary axes moves.

    Repeated readings at one position belong to the stretch.
    """
    linear = np.asarray(moved[:, machine.linear].any(axis=1))
    turning = np.asarray(moved[:, machine.rotary])
    together = (linear == turning.any(axis=1)) & ~ends
    for whole in _stretches(together):
        steps = np.flatnonzero(linear[whole[:-1]])
        if len(steps) + 1 < FEWEST_ROWS:
            continue
        sets = turning[whole[steps]].astype(int)
        cuts = np.flatnonzero((np.diff(sets, axis=0) != 0).any(axis=1)) + 1
        pieces = [piece for piece in np.split(steps, cuts) if len(piece) + 1 >= FEWEST_ROWS]
        if sum(map(len, pieces)) < LASTING * len(steps):  # no set of rotary axes lasts: one motion of all of them
            pieces = [steps]
        for piece in pieces:
            first, last = piece[0], piece[-1] + 1
            while first > 0 and not moved[whole[first - 1]].any():
                first -= 1
            while last + 1 < len(whole) and not moved[whole[last]].any():
                last += 1
            stretch = whole[first : last + 1]
            yield tuple(int(i) for i in np.flatnonzero(moved[stretch[:-1]].any(axis=0))), stretch


def _circles(
    part: Measurements, moved: np.ndarray, ends: np.ndarray, machine: Machine
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """Yield the stretches in which two linear axes move along a circle, without moves to and from it."""
    linear = machine.linear
    for a, b in ((a, b) for a in linear for b in linear if a < b):
        rest = np.delete(moved, (a, b), axis=1).any(axis=1)
        for stretch in _stretches(~rest & ~ends):
            steps = moved[stretch[:-1]]
            if len(stretch) < FEWEST_ROWS or not (steps[:, a].any() and steps[:, b].any()):
                continue
            feed = part.feed_mm_min[stretch]
            changes = np.flatnonzero((feed[1:] != feed[:-1]) & np.isfinite(feed[1:]) & np.isfinite(feed[:-1])) + 1
            for piece in np.split(stretch, changes):
                for first, last in _arcs(part.positions[piece][:, (a, b)]):
                    yield (a, b), piece[first:last]


def _arcs(q: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield first row and end of each part of (n, 2) consecutive positions that is on one circle."""
    first = 0
    while first + FEWEST_ROWS <= len(q):
        good = first + FEWEST_ROWS
        if not _on_circle(q[first:good]):
            first += 1
            continue
        while good < len(q) and _on_circle(q[first : min(2 * good - first, len(q))]):
            good = min(2 * good - first, len(q))
        bad = min(2 * good - first, len(q)) + 1
        while bad - good > 1:  # the last position on the circle is between the two
            middle = (good + bad) // 2
            good, bad = (middle, bad) if _on_circle(q[first:middle]) else (good, middle)
        yield first, good
        first = good


def _on_circle(q: np.ndarray) -> bool:
    """Return whether positions are on a circle, and not on a line."""
    centre, radius = fit_circle(q)
    return bool(radius < LARGEST_RADIUS_MM and np.abs(np.hypot(*(q - centre).T) - radius).max() < CIRCLE_MM)


def _joined(circles: Sequence[MeasuredRun], machine: Machine) -> tuple[MeasuredRun, ...]:
    """Return the circles with those of the same station, target, axes, place, radius and feed joined; a feed of 0 is unknown."""
    groups: dict[tuple[Any, ...], list[MeasuredRun]] = {}
    for run in circles:
        centre, radius = fit_circle(run.positions)
        feed = float(np.median(run.data.feed_mm_min)) if np.isfinite(run.data.feed_mm_min).all() else 0.0
        key = (
            run.station,
            run.target,
            run.axes,
            tuple(np.round([*run.where.values()], DECIMALS)),
            tuple(np.round([*centre, radius], 1)),
        )
        alike = [
            own for own in groups if own[:-1] == key and (own[-1] == feed or abs(own[-1] - feed) < SAME_FEED * feed)
        ]
        groups.setdefault(alike[0] if alike else (*key, feed), []).append(run)
    joined = []
    for runs in groups.values():
        data = Measurements.join([run.data for run in runs])
        numbers = np.concatenate([np.full(len(run.data), k) for k, run in enumerate(runs)])
        joined.append(MeasuredRun(data, runs[0].axes, read_only(numbers), runs[0].where))
    return tuple(joined)


def fit_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre (2,) and radius of the circle through (n, 2) points by algebraic least squares; infinite for a line."""
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    columns = np.column_stack([2.0 * x, 2.0 * y, np.ones(len(x))])
    solution, _, rank, _ = np.linalg.lstsq(columns, x**2 + y**2, rcond=1e-9)
    if rank < 3:
        return middle, float("inf")
    centre = solution[:2]
    return middle + centre, float(np.sqrt(max(solution[2] + centre @ centre, 0.0)))


def directions(run: MeasuredRun) -> tuple[np.ndarray, bool]:
    """Return (n,) the direction of approach of a run of one axis, and whether it was derived from the order of the rows.

    The column of the table is used where it has a value in any row; rows without one are 0, unknown. Else the direction is that of the
    last move of the axis. The first rows of a part, approached from outside the run, have the direction of the first move. At a turning
    point with twice as many readings as elsewhere, the second half has the direction of the next move.

    Args:
        run: a run of one axis.
    """
    (axis,) = run.axes
    given = run.data.approach[:, axis]
    if np.any(given):
        return np.asarray(given), False
    found = np.zeros(len(run.part))
    for number in np.unique(run.part):
        rows = np.flatnonzero(run.part == number)
        found[rows] = _from_order(run.data.positions[rows, axis])
    return found, True


def _from_order(q: np.ndarray) -> np.ndarray:
    starts = np.flatnonzero(np.concatenate([[True], np.abs(np.diff(q)) > MOVED]))
    sizes = np.diff(np.append(starts, len(q)))
    step = np.sign(np.diff(q[starts]))
    if not len(step):
        return np.zeros(len(q))
    before, after = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    usual = np.median(sizes[before == after])
    found = np.repeat(before, sizes)
    for start, size, turn in zip(starts, sizes, np.where(before != after, after, 0.0), strict=True):
        if turn and size >= 2 * usual:
            found[start + size // 2 : start + size] = turn
    return found
