"""Where the stations stand, to begin with: from the machine as drawn, by a loss that a few wrong rows cannot pull.

A tracker's reading y of a target at place t, carried to b + A·t, stands at station (R, o): R·y + o − A·t = b. That is linear in the
nine entries of R, in o and in t; the nearest rotation is taken, and the estimate proper does the rest. A tracking interferometer's
lengths (eq. 26 of the thesis, multilateration) are linear in the station once squared.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.setup import SetUp
from twin.machine.machine import Machine
from twin.measurement.observation import Carried, Observation
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


def first_setup(machine: Machine, data: Measurements, *, lengths_only: bool) -> tuple[SetUp, np.ndarray]:
    """Stations and targets from the machine as drawn.

    Args:
        machine: the machine.
        data: the measurements.
        lengths_only: whether only lengths from an unknown zero were read.

    Returns:
        The set-up, and (n,) how far each reading is from it, metres.
    """
    told = SetUp.told(data, lengths_only=lengths_only)
    carried = nominal(machine, data)
    station = np.array([told.stations.index(name) for name in data.station])
    target = np.array([told.targets.index(name) for name in data.target])
    readings = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    if lengths_only:
        return _by_lengths(told, carried.points, carried.rotation, readings[:, 0], station, target)
    return _by_points(told, carried.points, carried.rotation, data, station, target)


def nominal(machine: Machine, data: Measurements) -> Carried:
    """Return the origin of each row's carrier as the machine is drawn, and how the carrier is turned; base frame, metres."""
    q = np.asarray(data.positions) * machine.scale
    return _observation(machine).carried(
        q, np.zeros((len(q), 6 * len(machine.frames))), data.carrier, np.zeros((len(q), 3))
    )


@lru_cache(maxsize=2)
def _observation(machine: Machine) -> Observation:
    """The same for all calls: building its graph takes longer than a set-up of some hundred rows."""
    return Observation(machine)


def _by_points(
    told: SetUp, base: np.ndarray, turn: np.ndarray, data: Measurements, station: np.ndarray, target: np.ndarray
) -> tuple[SetUp, np.ndarray]:
    point = _filled(told, data.point_mm, station)
    whole = np.isfinite(point).all(axis=1)
    for i, name in enumerate(told.stations):
        if not told.station_known[i] and np.count_nonzero(whole & (station == i)) < 3:
            raise InputError(
                f"station {name} has fewer than 3 points with all three coordinates, or with the same two",
                expected="points to place it by, or its pose in the station columns",
                file=data.source,
                line=int(data.lines[np.flatnonzero(station == i)[0]]),
            )
    y, b, a = np.where(whole[:, None], point, 0.0) * MM, base, turn
    n, stations, targets = len(y), len(told.stations), len(told.targets)
    # From each station's mean: in points of one plane or line where they lie must not pass for how the station is turned.
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
            matrix[rows, i, 12 * stations + 3 * target + j] = -a[:, i, j]
        matrix[rows, i, 12 * station + 9 + i] = 1.0
    known = np.zeros(matrix.shape[2], dtype=bool)
    values = np.zeros(matrix.shape[2])
    for i in range(stations):
        if told.station_known[i]:
            known[12 * i : 12 * i + 12] = True
            values[12 * i : 12 * i + 12] = np.concatenate(
                [told.rotation[i].ravel(), told.origin[i] + told.rotation[i] @ centre[i]]
            )
    for i in range(targets):
        if told.target_known[i]:
            at = slice(12 * stations + 3 * i, 12 * stations + 3 * i + 3)
            known[at], values[at] = True, told.place[i]
    right = b - matrix @ values
    weight = whole.astype(float)
    found = values
    for _ in range(SWEEPS):
        root = np.sqrt(weight)[:, None]
        flat = (matrix[:, :, ~known] * root[:, :, None]).reshape(3 * n, -1)
        size = np.zeros(matrix.shape[2])
        size[~known] = np.linalg.norm(flat, axis=0)
        # A turn's entries alike: across a plane of points there is only their scatter, which says nothing of it.
        for i in range(stations):
            size[12 * i : 12 * i + 9] = size[12 * i : 12 * i + 9].max()
        size = size[~known]
        scale = np.where(size > 0.0, size, 1.0)
        # A motion along one line leaves directions that nothing determines: the smallest answer is as good as any.
        strength, way = np.linalg.eigh((flat.T @ flat) / np.outer(scale, scale))
        told_apart = strength > ALIKE**2 * strength[-1:]
        way = way[:, told_apart]
        solved = way @ ((way.T @ (flat.T @ (right * root).ravel() / scale)) / strength[told_apart]) / scale
        found = np.array(values)
        found[~known] = solved
        misfit = np.linalg.norm(b - matrix @ found, axis=1)
        fresh = np.where(whole, 1.0 / np.maximum(misfit, FLOOR), 0.0) * FLOOR
        if np.allclose(fresh, weight, atol=1e-3):
            break
        weight = fresh
    rotation = np.empty((stations, 3, 3))
    for i in range(stations):
        raw = found[12 * i : 12 * i + 9].reshape(3, 3)
        if told.station_known[i]:
            rotation[i] = told.rotation[i]
            continue
        u, s, v = np.linalg.svd(raw)
        if np.linalg.det(raw) < 0.0 and s[2] > 0.5:
            raise InputError(
                f"station {told.stations[i]} sees the machine as in a mirror",
                expected="a right-handed x_mm, y_mm, z_mm: two of the columns may be swapped, or one has the wrong sign",
                file=data.source,
                line=int(data.lines[np.flatnonzero(station == i)[0]]),
            )
        rotation[i] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    # The nearest turn was not quite what fitted, and nowhere near where a motion along one line left it open: it is fitted as a turn,
    # origins and places with it.
    keep = np.array([k % 12 >= 9 or k >= 12 * stations for k in range(matrix.shape[2])]) & ~known
    fixed = np.array(values)
    fixed[[k for k in range(12 * stations) if k % 12 < 9]] = 0.0
    free = np.flatnonzero(~told.station_known)
    stand = np.concatenate([np.ones(3 * len(free), dtype=bool), np.flatnonzero(keep) < 12 * stations])
    for _ in range(SWEEPS):
        seen = np.einsum("nij,nj->ni", rotation[station], y)
        right = b - seen - matrix @ np.where(keep, 0.0, fixed)
        by_turn = np.zeros((n, 3, 3 * len(free)))
        for k, i in enumerate(free.tolist()):
            of = station == i
            by_turn[of, :, 3 * k : 3 * k + 3] = -rotation[i] @ cross_matrix(y[of])
        root = np.sqrt(weight)[:, None]
        flat = (np.concatenate([by_turn, matrix[:, :, keep]], axis=2) * root[:, :, None]).reshape(3 * n, -1)
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
        weight = np.where(whole, FLOOR / np.maximum(misfit, FLOOR), 0.0)
        if np.abs(turned).max(initial=0.0) < STILL:
            break
    full = np.where(keep, 0.0, fixed)
    full[keep] = solved
    origin = np.array([full[12 * i + 9 : 12 * i + 12] - rotation[i] @ centre[i] for i in range(stations)])
    origin[told.station_known] = told.origin[told.station_known]
    place = full[12 * stations :].reshape(-1, 3)
    setup = replace(told, rotation=locked(rotation), origin=locked(origin), place=locked(np.array(place)))
    return setup, np.where(whole, misfit, 0.0)


def _filled(told: SetUp, point_mm: np.ndarray, station: np.ndarray) -> np.ndarray:
    """(n, 3) points, mm, with zero for the coordinates a station never read: it read a plane or a line, and stands in it."""
    point = np.array(point_mm)
    for i in np.flatnonzero(~told.station_known):
        of = np.flatnonzero(station == i)
        never = ~np.isfinite(point[of]).any(axis=0)
        point[np.ix_(of, np.flatnonzero(never))] = 0.0
    return point


def _by_lengths(
    told: SetUp, base: np.ndarray, turn: np.ndarray, length: np.ndarray, station: np.ndarray, target: np.ndarray
) -> tuple[SetUp, np.ndarray]:
    origin, dead, place = np.array(told.origin), np.array(told.dead), np.array(told.place)
    at = base + np.einsum("nij,nj->ni", turn, place[target])
    for i in range(len(told.stations)):
        of = np.flatnonzero(station == i)
        p, l = at[of], length[of]
        if told.station_known[i]:
            dead[i] = np.median(np.linalg.norm(p - origin[i], axis=1) - l)
            continue
        # (l + d)² = |p − o|², so l² + 2·l·d = |p|² − 2 p·o + (|o|² − d²): linear in o, d and the last bracket. By one target, so that
        # on the tool side its unknown place only shifts o.
        mine = target[of] == np.bincount(target[of]).argmax()
        p, l = p[mine], l[mine]
        matrix = np.concatenate([2.0 * p, 2.0 * l[:, None], -np.ones((len(p), 1))], axis=1)
        right = np.sum(p * p, axis=1) - l * l
        weight = np.ones(len(p))
        for _ in range(SWEEPS):
            root = np.sqrt(weight)
            solved = np.linalg.lstsq(matrix * root[:, None], right * root, rcond=1e-12)[0]
            misfit = np.abs(right - matrix @ solved)
            weight = FLOOR / np.maximum(misfit, FLOOR)
        origin[i], dead[i] = solved[:3], solved[3]
    setup = replace(told, origin=locked(origin), dead=locked(dead))
    for _ in range(60):
        setup, change, misfit = _length_step(setup, base, turn, length, station, target)
        if change < 1e-9:
            break
    return setup, misfit


def _length_step(
    setup: SetUp, base: np.ndarray, turn: np.ndarray, length: np.ndarray, station: np.ndarray, target: np.ndarray
) -> tuple[SetUp, float, np.ndarray]:
    """One damped, robust Gauss-Newton step of the whole set-up on lengths."""
    points = base + np.einsum("nij,nj->ni", turn, setup.place[target])
    beam = points - setup.origin[station]
    far = np.linalg.norm(beam, axis=1)
    unit = beam / far[:, None]
    misfit = length - (far - setup.dead[station])
    weight = np.sqrt(FLOOR / np.maximum(np.abs(misfit), FLOOR))
    jacobian = np.zeros((len(length), len(setup)))
    stations, targets = setup.slots()
    for i, (_, shift, path) in enumerate(stations):
        of = station == i
        if shift.stop > shift.start:
            jacobian[of, shift] = -unit[of]
        if path.stop > path.start:
            jacobian[of, path] = -1.0
    along = np.einsum("ni,nij->nj", unit, turn)
    for i, where in enumerate(targets):
        if where.stop > where.start:
            jacobian[target == i, where] = along[target == i]
    scale = setup.plausible
    damped = np.concatenate([jacobian * weight[:, None] * scale, 1e-6 * np.eye(len(setup))])
    step = np.linalg.lstsq(damped, np.concatenate([misfit * weight, np.zeros(len(setup))]), rcond=None)[0] * scale
    return setup.moved(step), float(np.abs(step).max(initial=0.0)), np.abs(misfit)
