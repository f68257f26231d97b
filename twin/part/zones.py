"""Deviations of a part's features judged as ISO 1101 does: association of datums, and the size of the smallest tolerance zone.

All deviations are small against the features: a rigid motion of the part is a shift and a small rotation, and the deviation of a
surface along its normal is linear in them. A feature is given by points on its nominal surface, or on its nominal axis with two
directions across it, and by the deviations there of many machines at once, µm.

References:
    - ISO 1101:2017, clauses 14 to 17 (zones of form, orientation, location, and profile).
    - ISO 5459:2011, clause 7 (datum systems, primary, secondary, tertiary: each takes the freedoms that those before leave).
    - P. Bourdet, L. Mathieu, C. Lartigue, A. Ballu: The concept of the small displacement torsor in metrology, in: Advanced
      Mathematical Tools in Metrology II, World Scientific (1996) 110-122.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only

RANK: Final = 1e-6
"""Singular value, as a share of the largest, below which a motion of the part does not change a feature."""
CLOSE_ENOUGH: Final = 1e-9
"""Share of a minimum zone by which a point may still lie outside the one found."""
MOST_EXCHANGES: Final = 500
FARTHEST: Final = 1e6
"""Largest step of a free motion, as a multiple of the largest deviation."""
MOST_CENTRES: Final = 12
"""Points of an axis whose enclosing circle is found exactly, by pairs and triples."""
DIRECTIONS: Final = 16
Association = Literal["least-squares", "minimum-zone"]


@final
@dataclass(frozen=True, eq=False)
class FeaturePoints:
    """Points of a feature with their deviations.

    Attributes:
        place_mm: (n, 3) points on the nominal feature, in the part's frame.
        normal: (n, 3) directions of the deviations: from the material outwards; across an axis, two for each of its points.
        deviation_um: (n, machines) deviations of the real surface from the nominal one, positive where material is left.
        sized: whether a size of the feature, which no tolerance here judges, shifts all deviations alike (a cylinder's radius).
        axis: whether the points are those of an axis, two rows for each.
    """

    place_mm: np.ndarray
    normal: np.ndarray
    deviation_um: np.ndarray
    sized: bool = False
    axis: bool = False

    @cached_property
    def motion(self) -> np.ndarray:
        """(n, 6) deviations, µm, by a shift of the part (µm) and its rotation about the origin (mrad)."""
        return np.hstack([self.normal, np.cross(self.place_mm, self.normal)])

    def with_deviation(self, deviation_um: np.ndarray) -> FeaturePoints:
        """Return the same points with other deviations."""
        return FeaturePoints(self.place_mm, self.normal, deviation_um, self.sized, self.axis)

    @staticmethod
    def joined(parts: Sequence[FeaturePoints]) -> FeaturePoints:
        """Return the points of several features of one kind."""
        return FeaturePoints(
            np.concatenate([one.place_mm for one in parts]),
            np.concatenate([one.normal for one in parts]),
            np.concatenate([one.deviation_um for one in parts]),
            parts[0].sized,
            parts[0].axis,
        )


@final
@dataclass(frozen=True, eq=False)
class Aligned:
    """The part aligned to datums.

    Attributes:
        motion: (6, machines) shift (µm) and rotation (mrad) that the datums require, about the origin of the part's frame.
        free: (6, f) motions that the datums leave.
    """

    motion: np.ndarray
    free: np.ndarray

    def seen(self, points: FeaturePoints) -> FeaturePoints:
        """Return a feature with its deviations from the place that the datums give it."""
        return points.with_deviation(points.deviation_um - points.motion @ self.motion)

    def free_columns(self, points: FeaturePoints) -> np.ndarray:
        """Return (n, r) deviations of a feature that the free motions cause, as independent columns."""
        return independent(points.motion @ self.free)


def align(datums: Sequence[FeaturePoints], machines: int) -> Aligned:
    """Return the alignment to datums in their order; each decides what those before it leave free.

    A datum is the least-squares feature in these freedoms; a plane is then shifted along its normal until it touches the material from
    outside. (Planes of the smallest zone are not unique for points on a grid.)
    """
    motion, free = np.zeros((6, machines)), np.eye(6)
    for points in datums:
        columns = points.motion @ free
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        size = np.ones((len(columns), 1)) if points.sized else np.zeros((len(columns), 0))
        # Motions that only change the size of a sized feature are not decided by it.
        across = columns / scale - size @ (size.T @ (columns / scale)) / max(len(columns), 1)
        _, values, directions = np.linalg.svd(across)
        rank = int(np.count_nonzero(values > RANK * max(values.max(initial=0.0), 1e-12)))
        decided, left = directions[:rank].T / scale[:, None], directions[rank:].T / scale[:, None]
        rows = np.hstack([columns @ decided, size])
        seen = points.deviation_um - points.motion @ motion
        steps = np.linalg.lstsq(rows, seen, rcond=None)[0]
        if not points.sized and not points.axis:
            outwards = np.linalg.lstsq(rows, np.ones((len(rows), 1)), rcond=None)[0]
            steps = steps + outwards * (seen - rows @ steps).max(axis=0)
        motion = motion + free @ decided @ steps[:rank]
        free = free @ left
        free = free / np.maximum(np.linalg.norm(free, axis=0), 1e-12)
    return Aligned(read_only(motion), read_only(free))


def independent(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (n, r) of the span of columns; none if all are zero."""
    if not columns.size:
        return np.zeros((len(columns), 0))
    scale = np.linalg.norm(columns, axis=0)
    kept = columns[:, scale > RANK * max(scale.max(), 1.0)]
    if not kept.size:
        return np.zeros((len(columns), 0))
    left, values, _ = np.linalg.svd(kept / np.linalg.norm(kept, axis=0), full_matrices=False)
    return np.asarray(left[:, values > RANK * values[0]])


# --- The size of the smallest zone ---------------------------------------------------------------------------------------


def band_um(points: FeaturePoints, columns: np.ndarray, association: Association = "minimum-zone") -> np.ndarray:
    """Return (machines,) the width of the zone, between two parallel surfaces, that the deviations need; columns (n, k) are free."""
    if association == "minimum-zone":
        return 2.0 * chebyshev(columns, points.deviation_um)[1]
    left = points.deviation_um
    if columns.shape[1]:
        left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
    return np.asarray(left.max(axis=0) - left.min(axis=0))


def both_sides_um(points: FeaturePoints, columns: np.ndarray) -> np.ndarray:
    """Return (machines,) the width of the zone, equal on both sides of the nominal place: twice the largest deviation."""
    return np.asarray(2.0 * chebyshev(columns, points.deviation_um)[1])


def around_axis_um(points: FeaturePoints, columns: np.ndarray, *, placed: bool) -> np.ndarray:
    """Return (machines,) the diameter of the cylinder that the points of axes need.

    ``placed``: it is about the nominal axis (location); otherwise it may be shifted (orientation). Columns (n, k) are free motions.
    """
    left = points.deviation_um
    if placed and columns.shape[1]:
        left = left - columns @ smallest_circle_steps(columns, left)
    across = left.reshape(-1, 2, left.shape[1])
    if placed:
        return np.asarray(2.0 * np.linalg.norm(across, axis=1).max(axis=0))
    shift = np.tile(np.eye(2), (len(across), 1))
    turning = independent(columns - shift @ (shift.T @ columns) / len(across)) if columns.size else columns
    if turning.shape[1]:
        both = np.hstack([shift, turning])
        left = left - both @ smallest_circle_steps(both, left)
        return np.asarray(2.0 * np.linalg.norm(left.reshape(-1, 2, left.shape[1]), axis=1).max(axis=0))
    return 2.0 * enclosing_radius(across)


def enclosing_radius(across: np.ndarray) -> np.ndarray:
    """Return (machines,) the radius of the smallest circle around points (p, 2, machines).

    It is that of two of the points as a diameter, or of three of them (Welzl 1991), whichever encloses all. Of more than `MOST_CENTRES`
    points, the outermost in `DIRECTIONS` directions are tried: the circle encloses all, and is up to 1 % larger than the smallest.
    """
    machines = across.shape[2]
    best = np.full(machines, np.inf)
    if len(across) == 1:
        return np.zeros(machines)
    outermost = across
    if len(across) > MOST_CENTRES:
        angle = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
        along = np.einsum("ds,psm->dpm", np.stack([np.cos(angle), np.sin(angle)], axis=1), across)
        outermost = np.take_along_axis(across, along.argmax(axis=1)[:, None, :], axis=0)

    def encloses(centre: np.ndarray) -> None:
        nonlocal best
        best = np.minimum(best, np.linalg.norm(across - centre, axis=1).max(axis=0))

    tried = range(len(outermost))
    for i, j in combinations(tried, 2):
        encloses((outermost[i] + outermost[j]) / 2.0)
    for i, j, k in combinations(tried, 3):
        a, b = outermost[j] - outermost[i], outermost[k] - outermost[i]
        twice = 2.0 * (a[0] * b[1] - a[1] * b[0])
        flat = np.abs(twice) < 1e-9 * np.maximum((a**2).sum(axis=0) + (b**2).sum(axis=0), 1e-30)
        aa, bb = (a**2).sum(axis=0), (b**2).sum(axis=0)
        safe = np.where(flat, 1.0, twice)
        centre = np.array([b[1] * aa - a[1] * bb, a[0] * bb - b[0] * aa]) / safe
        encloses(outermost[i] + np.where(flat, 0.0, centre))
    return best


def best_place(points: FeaturePoints, free: np.ndarray) -> np.ndarray:
    """Return (k, machines) the free motions, along columns (n, k), that make the largest deviation small."""
    return smallest_circle_steps(free, points.deviation_um) if points.axis else chebyshev(free, points.deviation_um)[0]


SIDES: Final = 32
"""Sides of the regular polygon that stands for a circle."""


def smallest_circle_steps(columns: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return (k, machines) free motions that make the largest distance across the axes small: at most 0.5 % above the least one.

    It is least for the polygon around each circle, by a linear programme.
    """
    angle = np.arange(SIDES // 2) * (2.0 * np.pi / SIDES)
    sides = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def towards(rows: np.ndarray) -> np.ndarray:
        return np.einsum("ds,psm->pdm", sides, rows.reshape(-1, 2, rows.shape[1])).reshape(-1, rows.shape[1])

    return chebyshev(towards(columns), towards(left))[0]


def chebyshev(columns: np.ndarray, deviation_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (k, machines) the steps along columns (n, k) that leave the smallest largest deviation, and (machines,) that deviation.

    The linear programme of each machine (Cheney and Goldstein 1959) is solved by the simplex method on its dual, all machines at once:
    the point farthest outside enters, until none lies outside.
    """
    machines = deviation_um.shape[1]
    if not columns.shape[1]:
        return np.zeros((0, machines)), np.asarray(np.abs(deviation_um).max(axis=0))
    columns, back = _conditioned(columns)
    k = columns.shape[1]
    scale = max(float(np.abs(deviation_um).max()), 1e-12)
    sizes = np.abs(columns).max()
    rows, goal = columns / sizes, deviation_um.T / scale
    # Columns of the basis: limits of the steps, and one point. Each is (sign · row, 1) with its value as cost.
    start = np.abs(goal).argmax(axis=1)
    sign = np.where(goal[np.arange(machines), start] < 0.0, -1.0, 1.0)
    basis = np.zeros((machines, k + 1, k + 1))
    basis[:, :k, k], basis[:, k, k] = sign[:, None] * rows[start], 1.0
    basis[:, np.arange(k), np.arange(k)] = np.where(basis[:, :k, k] > 0.0, -1.0, 1.0)
    cost = np.full((machines, k + 1), -FARTHEST)
    cost[:, k] = np.abs(goal).max(axis=1)
    unit = np.append(np.zeros(k), 1.0)
    prices, active = np.zeros((machines, k + 1)), np.arange(machines)
    for _ in range(MOST_EXCHANGES):
        prices[active] = np.linalg.solve(basis[active].transpose(0, 2, 1), cost[active][:, :, None])[:, :, 0]
        left = goal[active] - prices[active, :k] @ rows.T
        worst = np.abs(left).argmax(axis=1)
        value = left[np.arange(len(active)), worst]
        outside = np.abs(value) > prices[active, k] * (1.0 + CLOSE_ENOUGH) + 1e-12
        active, worst, value = active[outside], worst[outside], value[outside]
        if not len(active):
            break
        sign = np.sign(value)
        entering = np.column_stack([sign[:, None] * rows[worst], np.ones(len(active))])
        both = np.linalg.solve(basis[active], np.stack([entering, np.broadcast_to(unit, entering.shape)], axis=2))
        ratio = np.where(
            both[:, :, 0] > 1e-12, np.maximum(both[:, :, 1], 0.0) / np.maximum(both[:, :, 0], 1e-12), np.inf
        )
        leaving = ratio.argmin(axis=1)
        basis[active, :, leaving] = entering
        cost[active, leaving] = sign * goal[active, worst]
    steps = prices[:, :k].T / sizes * scale
    return back @ steps, np.asarray(np.abs(deviation_um - columns @ steps).max(axis=0))


def _conditioned(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis of columns, and the steps along the columns for one along each of the basis."""
    left, values, right = np.linalg.svd(columns, full_matrices=False)
    kept = values > RANK * values[0]
    return left[:, kept], right[kept].T / values[kept]
