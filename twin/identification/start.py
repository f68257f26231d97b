"""Where the stations stand, to begin with: from the machine as drawn, by a loss that a few wrong rows cannot pull.

A tracker's reading y of a target at place t, carried to b + A·t, stands at station (R, o): R·y + o − A·t = b. That is linear in the
nine entries of R, in o and in t; the nearest rotation is taken, and the estimate proper does the rest. A tracking interferometer's
lengths (eq. 26 of the thesis, multilateration) are linear in the station once squared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import locked
from twin._common.units import MM
from twin.identification.setup import SetUp
from twin.machine.machine import Machine
from twin.measurement.observation import CarriedTargets, Observation
from twin.measurement.table import Measurements
from twin.numerics.spatial import cross_matrix, rotation_exp

FLOOR: Final = 1e-4
"""m: misfits below it weigh alike; the machine's own errors are that large."""
FITS: Final = 5e-3
"""m: a command that misses the measured motion by more does not belong to it: no machine tool errs by that."""
ALIKE: Final = 1e-3
"""Relative size of a direction below which the readings do not determine it."""
SWEEPS: Final = 60
LARGEST_TURN: Final = 0.5
"""rad a step."""
STILL: Final = 1e-10


class FirstSetUp(NamedTuple):
    """Stations and targets from the machine as drawn, and (n,) how far each reading is from them, metres."""

    setup: SetUp
    miss: np.ndarray


def first_setup(machine: Machine, data: Measurements, *, lengths_only: bool) -> FirstSetUp:
    """Stations and targets from the machine as drawn.

    Args:
        machine: the machine.
        data: the measurements.
        lengths_only: whether only lengths from an unknown zero were read.

    Raises:
        InputError: a station with fewer than three points, or one that sees the machine as in a mirror.
    """
    told = SetUp.told(data, lengths_only=lengths_only)
    carried = nominal(machine, data)
    station = np.array([told.stations.index(name) for name in data.station])
    target = np.array([told.targets.index(name) for name in data.target])
    if lengths_only:
        length = np.where(np.isfinite(data.point_mm[:, 0]), data.point_mm[:, 0], 0.0) * MM
        return _by_lengths(told, _Lengths(carried.points, carried.rotation, length, station, target))
    return _by_points(told, carried, data, station, target)


def nominal(machine: Machine, data: Measurements) -> CarriedTargets:
    """Return the origin of each row's carrier as the machine is drawn, and how the carrier is turned; metres.

    In the frame that the row's station rides on.
    """
    q = np.asarray(data.positions) * machine.scale
    errors, places = np.zeros((len(q), 6 * len(machine.frames))), np.zeros((len(q), 3))
    return _observation(machine).carried(q, errors, data.carrier, places, data.station_carrier)


@lru_cache(maxsize=2)
def _observation(machine: Machine) -> Observation:
    """The same for all calls: building its graph takes longer than a set-up of some hundred rows."""
    return Observation(machine)


@final
@dataclass(frozen=True)
class _Equations:
    """R·y + o − A·t = b for every row, linear in the unknowns of the set-up: for each station R and o, for each target t.

    Attributes:
        told: what is known.
        y: (n, 3) readings from the mean of their station, metres; zero where not whole.
        centre: (stations, 3) these means. In points of one plane or line where they lie must not pass for how the station is turned.
        b: (n, 3) origins of the carriers.
        matrix: (n, 3, unknowns).
        known: (unknowns,) which have a value.
        values: (unknowns,) the values; zero for the others.
        whole: (n,) rows with every coordinate.
        station: (n,) index.
    """

    told: SetUp
    y: np.ndarray
    centre: np.ndarray
    b: np.ndarray
    matrix: np.ndarray
    known: np.ndarray
    values: np.ndarray
    whole: np.ndarray
    station: np.ndarray

    @property
    def of_stations(self) -> int:
        """How many unknowns belong to stations: twelve each."""
        return 12 * len(self.told.stations)

    def solve(self) -> tuple[np.ndarray, np.ndarray]:
        """(unknowns,) robust linear estimate, entries of R free of each other, and (n,) the weights."""
        weight, found = self.whole.astype(float), self.values
        for _ in range(SWEEPS):
            found = self._weighted(weight)
            misfit = np.linalg.norm(self.b - self.matrix @ found, axis=1)
            fresh = np.where(self.whole, 1.0 / np.maximum(misfit, FLOOR), 0.0) * FLOOR
            if np.allclose(fresh, weight, atol=1e-3):
                break
            weight = fresh
        return found, weight

    def _weighted(self, weight: np.ndarray) -> np.ndarray:
        root, unknown = np.sqrt(weight)[:, None], ~self.known
        flat = (self.matrix[:, :, unknown] * root[:, :, None]).reshape(3 * len(self.y), -1)
        size = np.zeros(len(self.known))
        size[unknown] = np.linalg.norm(flat, axis=0)
        # A turn's entries alike: across a plane of points there is only their scatter, which says nothing of it.
        for i in range(0, self.of_stations, 12):
            size[i : i + 9] = size[i : i + 9].max()
        size = size[unknown]
        scale = np.where(size > 0.0, size, 1.0)
        # A motion along one line leaves directions that nothing determines: the smallest answer is as good as any.
        strength, way = np.linalg.eigh((flat.T @ flat) / np.outer(scale, scale))
        seen = strength > ALIKE**2 * strength[-1:]
        way = way[:, seen]
        right = ((self.b - self.matrix @ self.values) * root).ravel()
        found = np.array(self.values)
        found[unknown] = way @ ((way.T @ (flat.T @ right / scale)) / strength[seen]) / scale
        return found


def _by_points(
    told: SetUp, carried: CarriedTargets, data: Measurements, station: np.ndarray, target: np.ndarray
) -> FirstSetUp:
    point = _filled(told, data.point_mm, station)
    whole = np.isfinite(point).all(axis=1)
    for i, name in enumerate(told.stations):
        if not told.station_known[i] and np.count_nonzero(whole & (station == i)) < 3:
            raise data.error(
                f"station {name} has fewer than 3 points with all three coordinates, or with the same two",
                expected="points to place it by, or its pose in the station columns",
                row=int(np.flatnonzero(station == i)[0]),
            )
    equations = _equations(told, np.where(whole[:, None], point, 0.0) * MM, whole, carried, station, target)
    found, weight = equations.solve()
    rotation = _nearest_rotations(told, found, data, station)
    return _turned(equations, rotation, weight)


def _equations(
    told: SetUp, y: np.ndarray, whole: np.ndarray, carried: CarriedTargets, station: np.ndarray, target: np.ndarray
) -> _Equations:
    n, stations, targets = len(y), len(told.stations), len(told.targets)
    centre = np.zeros((stations, 3))
    for i in range(stations):
        of = whole & (station == i)
        centre[i] = y[of].mean(axis=0) if np.any(of) else 0.0
    y = np.where(whole[:, None], y - centre[station], 0.0)
    matrix = np.zeros((n, 3, 12 * stations + 3 * targets))
    rows = np.arange(n)
    for i in range(3):
        for j in range(3):
            matrix[rows, i, 12 * station + 3 * i + j] = y[:, j]
            matrix[rows, i, 12 * stations + 3 * target + j] = -carried.rotation[:, i, j]
        matrix[rows, i, 12 * station + 9 + i] = 1.0
    known = np.concatenate([np.repeat(told.station_known, 12), np.repeat(told.target_known, 3)])
    origin = told.origin + _each(told.rotation, centre)
    placed = np.concatenate([told.rotation.reshape(stations, 9), origin], axis=1)
    values = np.where(known, np.concatenate([placed.ravel(), told.place.ravel()]), 0.0)
    return _Equations(told, y, centre, carried.points, matrix, known, values, whole, station)


def _nearest_rotations(told: SetUp, found: np.ndarray, data: Measurements, station: np.ndarray) -> np.ndarray:
    """(stations, 3, 3) rotations nearest to the entries found; those known as they are.

    Raises:
        InputError: a station that sees the machine as in a mirror.
    """
    rotation = np.array(told.rotation)
    for i in np.flatnonzero(~told.station_known):
        raw = found[12 * i : 12 * i + 9].reshape(3, 3)
        u, s, v = np.linalg.svd(raw)
        if np.linalg.det(raw) < 0.0 and s[2] > 0.5:
            raise data.error(
                f"station {told.stations[i]} sees the machine as in a mirror",
                expected="a right-handed x_mm, y_mm, z_mm: two of the columns may be swapped, or one has the wrong sign",
                row=int(np.flatnonzero(station == i)[0]),
            )
        rotation[i] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rotation


def _turned(equations: _Equations, rotation: np.ndarray, weight: np.ndarray) -> FirstSetUp:
    """The set-up with turns that are turns.

    The nearest rotation was not quite what fitted, and nowhere near where a motion along one line left it open: it is fitted as a
    rotation, origins and places with it.
    """
    told, matrix, y, station = equations.told, equations.matrix, equations.y, equations.station
    index = np.arange(matrix.shape[2])
    entry = (index < equations.of_stations) & (index % 12 < 9)
    keep = ~entry & ~equations.known
    fixed = np.where(entry | keep, 0.0, equations.values)
    free = np.flatnonzero(~told.station_known)
    stand = np.concatenate([np.ones(3 * len(free), dtype=bool), np.flatnonzero(keep) < equations.of_stations])
    for _ in range(SWEEPS):
        right = equations.b - np.einsum("nij,nj->ni", rotation[station], y) - matrix @ fixed
        by_turn = np.zeros((len(y), 3, 3 * len(free)))
        for k, i in enumerate(free.tolist()):
            of = station == i
            by_turn[of, :, 3 * k : 3 * k + 3] = -rotation[i] @ cross_matrix(y[of])
        root = np.sqrt(weight)[:, None]
        flat = (np.concatenate([by_turn, matrix[:, :, keep]], axis=2) * root[:, :, None]).reshape(3 * len(y), -1)
        scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
        # What only their sum shows is the station's: a place that no turn of its carrier shows is no lever for one.
        solved = np.zeros(flat.shape[1])
        for part in (stand, np.ones_like(stand)):
            left = (right * root).ravel() - flat @ solved
            solved[part] += np.linalg.lstsq(flat[:, part] / scale[part], left, rcond=1e-9)[0] / scale[part]
        turned, solved = solved[: 3 * len(free)].reshape(-1, 3), solved[3 * len(free) :]
        turned *= min(1.0, LARGEST_TURN / max(float(np.abs(turned).max(initial=0.0)), 1e-12))
        for i, part in zip(free.tolist(), turned, strict=True):
            rotation[i] = rotation[i] @ rotation_exp(part)
        misfit = np.linalg.norm(right - matrix[:, :, keep] @ solved, axis=1)
        weight = np.where(equations.whole, FLOOR / np.maximum(misfit, FLOOR), 0.0)
        if np.abs(turned).max(initial=0.0) < STILL:
            break
    full = fixed
    full[keep] = solved
    stood, place = np.split(full, [equations.of_stations])
    origin = stood.reshape(-1, 12)[:, 9:] - _each(rotation, equations.centre)
    origin = np.where(told.station_known[:, None], told.origin, origin)
    setup = replace(told, rotation=locked(rotation), origin=locked(origin), place=locked(place.reshape(-1, 3)))
    return FirstSetUp(setup, np.where(equations.whole, misfit, 0.0))


def _each(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.array([turn @ vector for turn, vector in zip(rotation, vectors, strict=True)])


def _filled(told: SetUp, point_mm: np.ndarray, station: np.ndarray) -> np.ndarray:
    """(n, 3) points, mm, with zero for the coordinates a station never read: it read a plane or a line, and stands in it."""
    point = np.array(point_mm)
    for i in np.flatnonzero(~told.station_known):
        of = np.flatnonzero(station == i)
        never = ~np.isfinite(point[of]).any(axis=0)
        point[np.ix_(of, np.flatnonzero(never))] = 0.0
    return point


@final
@dataclass(frozen=True)
class _Lengths:
    """Lengths of n rows: (n, 3) origin and (n, 3, 3) rotation of the carrier, (n,) length in metres, station and target indices."""

    base: np.ndarray
    rotation: np.ndarray
    length: np.ndarray
    station: np.ndarray
    target: np.ndarray

    def points(self, setup: SetUp) -> np.ndarray:
        """(n, 3) the targets."""
        return np.asarray(self.base + np.einsum("nij,nj->ni", self.rotation, setup.place[self.target]))

    def step(self, setup: SetUp) -> tuple[SetUp, float, np.ndarray]:
        """One damped, robust Gauss-Newton step of the whole set-up; its largest change, and (n,) how far the readings were off."""
        beam = self.points(setup) - setup.origin[self.station]
        far = np.linalg.norm(beam, axis=1)
        unit = beam / far[:, None]
        misfit = self.length - (far - setup.dead[self.station])
        weight = np.sqrt(FLOOR / np.maximum(np.abs(misfit), FLOOR))
        along = np.einsum("ni,nij->nj", unit, self.rotation)
        derivative = {"origin": -unit, "dead path": -np.ones((len(unit), 1)), "place": along}
        jacobian = np.zeros((len(self.length), len(setup)))
        for kind, i, at in setup.slots:
            of = (self.target if kind == "place" else self.station) == i
            jacobian[of, at] = derivative[kind][of]
        scale = setup.plausible
        damped = np.concatenate([jacobian * weight[:, None] * scale, 1e-6 * np.eye(len(setup))])
        step = np.linalg.lstsq(damped, np.concatenate([misfit * weight, np.zeros(len(setup))]), rcond=None)[0] * scale
        return setup.moved(step), float(np.abs(step).max(initial=0.0)), np.abs(misfit)


def _by_lengths(told: SetUp, lengths: _Lengths) -> FirstSetUp:
    origin, dead, points = np.array(told.origin), np.array(told.dead), lengths.points(told)
    for i in range(len(told.stations)):
        of = np.flatnonzero(lengths.station == i)
        if told.station_known[i]:
            dead[i] = np.median(np.linalg.norm(points[of] - origin[i], axis=1) - lengths.length[of])
            continue
        # By one target, so that on the tool side its unknown place only shifts the station.
        of = of[lengths.target[of] == np.bincount(lengths.target[of]).argmax()]
        origin[i], dead[i] = _multilateration(points[of], lengths.length[of])
    setup = replace(told, origin=locked(origin), dead=locked(dead))
    for _ in range(SWEEPS):
        setup, change, misfit = lengths.step(setup)
        if change < 1e-9:
            break
    return FirstSetUp(replace(setup, shift=None), misfit)


def _multilateration(p: np.ndarray, l: np.ndarray) -> tuple[np.ndarray, float]:
    """The station and its dead path from (n, 3) points and (n,) lengths, metres.

    (l + d)² = |p − o|², so l² + 2·l·d = |p|² − 2 p·o + (|o|² − d²): linear in o, d and the last bracket.
    """
    matrix = np.concatenate([2.0 * p, 2.0 * l[:, None], -np.ones((len(p), 1))], axis=1)
    right = np.sum(p * p, axis=1) - l * l
    weight = np.ones(len(p))
    for _ in range(SWEEPS):
        root = np.sqrt(weight)
        solved = np.linalg.lstsq(matrix * root[:, None], right * root, rcond=1e-12)[0]
        weight = FLOOR / np.maximum(np.abs(right - matrix @ solved), FLOOR)
    return solved[:3], float(solved[3])
