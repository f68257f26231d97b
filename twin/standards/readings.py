"""Runs in a measurement table, and what their readings show: along and across an axis, with standard uncertainty and orientation.

A run is consecutive rows of one target, read from one station, between which the same axes move. The order is that of ``time_s`` where
every row has it, else that of the rows. A run ends where the round changes.

The orientation of a station is unknown unless the table gives its pose. It is estimated from the directions in which the readings
move with two or more linear axes; with one, the frame is taken as parallel to the machine's if the direction fits within
`LARGEST_ANGLE_DEG`. Squareness and straightness do not depend on it, only their names do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.messages import Message
from twin._common.units import DEG, MM, UM
from twin.machine.machine import Axis, Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.numerics.spatial import algebraic_sphere, rotation_exp

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
    """Rows in which only some axes move."""

    data: Measurements  # the rows, in the order of the run; parts at the same place are joined
    axes: tuple[int, ...]  # indices of the axes that move
    part: np.ndarray  # (n,) number of the consecutive part to which each row belongs
    where: Mapping[str, float]  # positions of the other axes, by name

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
    """All runs of a table, by kind."""

    single: tuple[MeasuredRun, ...]  # runs of one axis
    circles: tuple[MeasuredRun, ...]  # runs of two linear axes on a circle
    mixed: tuple[MeasuredRun, ...]  # runs in which linear and rotary axes move together
    ordered_by_time: bool  # whether ``time_s`` gives the order


def find_runs(data: Measurements, machine: Machine) -> TableRuns:
    """Return the runs of a table."""
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
    centre, radius = algebraic_sphere(q)
    return bool(radius < LARGEST_RADIUS_MM and np.abs(np.hypot(*(q - centre).T) - radius).max() < CIRCLE_MM)


def _joined(circles: Sequence[MeasuredRun], machine: Machine) -> tuple[MeasuredRun, ...]:
    """Return the circles with those of the same station, target, axes, place, radius and feed joined; a feed of 0 is unknown."""
    groups: dict[tuple[Any, ...], list[MeasuredRun]] = {}
    for run in circles:
        centre, radius = algebraic_sphere(run.positions)
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


def directions(run: MeasuredRun) -> tuple[np.ndarray, bool]:
    """Return (n,) the direction of approach of a run of one axis, and whether it was derived from the order of the rows.

    The column of the table is used where it has a value in any row; rows without one are 0, unknown. Else the direction is that of the
    last move of the axis. The first rows of a part, approached from outside the run, have the direction of the first move. At a turning
    point with twice as many readings as elsewhere, the second half has the direction of the next move.
    """
    (axis,) = run.axes
    given = run.data.approach[:, axis]
    if np.any(given):
        return np.asarray(given), False
    signs = np.zeros(len(run.part))
    for number in np.unique(run.part):
        rows = np.flatnonzero(run.part == number)
        signs[rows] = _from_order(run.data.positions[rows, axis])
    return signs, True


def _from_order(q: np.ndarray) -> np.ndarray:
    starts = np.flatnonzero(np.concatenate([[True], np.abs(np.diff(q)) > MOVED]))
    sizes = np.diff(np.append(starts, len(q)))
    step = np.sign(np.diff(q[starts]))
    if not len(step):
        return np.zeros(len(q))
    before, after = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    usual = np.median(sizes[before == after])
    direction = np.repeat(before, sizes)
    for start, size, turn in zip(starts, sizes, np.where(before != after, after, 0.0), strict=True):
        if turn and size >= 2 * usual:
            direction[start + size // 2 : start + size] = turn
    return direction


# --- Readings of a run: along and across an axis, their standard uncertainty, and the orientation of a station's frame

LARGEST_ANGLE_DEG: Final = 10.0
SLOPE_TOLERANCE: Final = 0.01
"""Difference from 1 mm per mm up to which a length is along the axis."""
AS_GIVEN: Final = Message("directions as given by the station's pose")
FROM_AXES: Final = Message("directions parallel to the machine's axes, found from the runs of two or more of them")
SAME_AS_MACHINE: Final = Message("directions of the station's frame, taken as parallel to the machine's")


class NotPossible(Exception):
    """The readings of a run do not allow an evaluation."""

    def __init__(self, why: Message) -> None:
        super().__init__(why)
        self.why = why


def reading_uncertainty_mm(data: Measurements, instrument: Instrument | None) -> np.ndarray:
    """Return (n, 3) standard uncertainties of the readings, mm: the table's, else the instrument's noise model; NaN if unknown."""
    if instrument is None:
        return np.asarray(data.u_mm)
    points = np.nan_to_num(np.asarray(data.point_mm)) * MM
    far = np.linalg.norm(points, axis=1) > 0.0
    model = np.full(points.shape, np.nan)
    if far.any():
        covariance = instrument.covariance(points[far])
        model[far] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) / MM
    return np.where(np.isfinite(data.u_mm), data.u_mm, np.where(np.isfinite(data.point_mm), model, np.nan))


def rms_um(u_mm: np.ndarray) -> float:
    """Return the RMS of standard uncertainties in mm, µm; NaN if none is known."""
    return float(np.sqrt(np.nanmean(u_mm**2))) * (MM / UM) if np.isfinite(u_mm).any() else float("nan")


@final
@dataclass(frozen=True)
class StationFrame:
    """Orientation of a station's frame in the machine frame."""

    rotation: np.ndarray  # (3, 3) turns readings into directions parallel to the machine's axes
    known: Message | None  # how it is known; None if it is unknown


def station_rotation(pose: np.ndarray) -> np.ndarray:
    """Return (3, 3) the rotation of a row of `Measurements.station_pose`; the identity if the pose is unknown."""
    return np.asarray(rotation_exp(pose[3:] * DEG)) if np.isfinite(pose).all() else np.eye(3)


def relative_direction(run: MeasuredRun, machine: Machine) -> np.ndarray:
    """Return (3,) the nominal direction, in the machine frame, in which the readings move with a linear axis; zero if they do not."""
    axis = machine.axes[run.axes[0]]
    target, station = carried_sides(run, axis)
    return (float(target) - float(station)) * axis.machine_direction


def carried_sides(run: MeasuredRun, axis: Axis) -> tuple[bool, bool]:
    """Return whether the axis carries the target, and whether it carries the station."""
    return axis.side in ("both", run.data.carrier[0]), axis.side in ("both", run.data.station_carrier[0])


def station_frame(runs: Sequence[MeasuredRun], machine: Machine) -> StationFrame:
    """Return the orientation of a station from its runs of one linear axis, of which those with three coordinates are used."""
    pairs = [
        (measured_direction(run), relative_direction(run, machine))
        for run in runs
        if run.read.all() and len(run.data) > 1
    ]
    pairs = [(d / np.linalg.norm(d), e) for d, e in pairs if abs(np.linalg.norm(d) - 1.0) < SLOPE_TOLERANCE and e.any()]
    pose = runs[0].data.station_pose[0] if runs else np.full(6, np.nan)
    base = station_rotation(pose)
    if not pairs:
        return StationFrame(base, SAME_AS_MACHINE)
    measured, nominal = (np.array(side) for side in zip(*pairs, strict=True))
    if np.linalg.matrix_rank(nominal, tol=0.5) >= 2:
        turned, _ = scipy.spatial.transform.Rotation.align_vectors(nominal, measured)
        off = np.arccos(np.clip(np.sum(turned.apply(measured) * nominal, axis=1), -1.0, 1.0)).max() / DEG
        return StationFrame(turned.as_matrix(), FROM_AXES if off < LARGEST_ANGLE_DEG else None)
    off = np.arccos(np.clip(base @ measured[0] @ nominal[0], -1.0, 1.0)) / DEG
    words = AS_GIVEN if np.isfinite(pose).all() else SAME_AS_MACHINE
    return StationFrame(base, words if off < LARGEST_ANGLE_DEG else None)


def measured_direction(run: MeasuredRun) -> np.ndarray:
    """Return (3,) the change of the readings, mm per mm or per degree of the axis, by least squares; NaN where nothing was read."""
    q = run.positions[:, 0] - run.positions[:, 0].mean()
    return np.asarray(q @ (run.data.point_mm - run.data.point_mm.mean(axis=0)) / (q @ q))


def along_axis_mm(run: MeasuredRun, axis: Axis, u_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the measured position along a linear axis, mm, its standard uncertainty (n,), and whether its zero is the axis's own.

    A length counts as along the axis if it changes by 1 mm per mm, with either sign. From three coordinates it is the component along
    the least-squares line of the points. The standard uncertainties ``u_mm`` of the readings are (n, 3).
    """
    slope = measured_direction(run)
    read = np.flatnonzero(run.read)
    if len(read) == 3:
        length = float(np.linalg.norm(slope))
        direction = slope / length if length > 0.0 else slope
    else:
        lengths = np.abs(slope[read]) if len(read) else np.zeros(1)
        length = float(lengths.max())
        direction = np.zeros(3)
        if len(read):
            column = int(read[int(np.argmax(lengths))])
            direction[column] = np.sign(slope[column])
    if abs(length - 1.0) > SLOPE_TOLERANCE:
        raise NotPossible(
            Message(
                "the readings change by {length:.3g} mm per mm of {name}: they are not along the axis",
                length=length,
                name=axis.name,
            )
        )
    used = direction != 0.0
    position = run.data.point_mm[:, used] @ direction[used]
    u = np.sqrt(np.sum((u_mm[:, used] * direction[used]) ** 2, axis=1))
    own_zero = len(read) < 3 and float(np.abs(position - run.positions[:, 0]).max()) < 0.5
    return np.asarray(position), np.asarray(u), own_zero


def across_axis_um(run: MeasuredRun, frame: StationFrame, machine: Machine) -> dict[str, np.ndarray]:
    """Return the readings across a linear axis, µm, by the ISO 230-1 name of the error motion (``E_YX``)."""
    axis, direction = machine.axes[run.axes[0]], relative_direction(run, machine)
    along = int(np.argmax(np.abs(direction)))
    if abs(direction[along]) < 1.0 - SLOPE_TOLERANCE:
        raise NotPossible(
            Message(
                "{name} is not parallel to an axis of the machine frame, or does not move the readings", name=axis.name
            )
        )
    sign = 1.0 if axis.machine_direction @ direction > 0.0 else -1.0  # of the moved side's error in the readings
    points = run.data.point_mm
    if run.read.all():
        if not frame.known:
            raise NotPossible(
                Message("the orientation of the station is unknown: measure a second linear axis, or give its pose")
            )
        points = points @ frame.rotation.T
    lateral = [k for k in range(3) if k != along and np.isfinite(points[:, k]).all()]
    if not run.read.all():
        slopes = np.abs(measured_direction(run))
        lateral = [k for k in lateral if slopes[k] < SLOPE_TOLERANCE]
    if not lateral:
        raise NotPossible(Message("no coordinate across the travel was read"))
    return {f"E_{'XYZ'[k]}{axis.name}": sign * (points[:, k] - points[0, k]) * (MM / UM) for k in lateral}


def place_of(run: MeasuredRun) -> Message:
    """Return the positions of the axes that stand still, with target and station: ``at Y 225, Z −200; target K, station 1``."""
    rest = ", ".join(f"{name} {value:g}".replace("-", "−") for name, value in run.where.items())
    if not rest:
        return Message("target {target}, station {station}", target=run.target, station=run.station)
    return Message("at {rest}; target {target}, station {station}", rest=rest, target=run.target, station=run.station)
