"""Largest distance between two polylines with corresponding parameters, in both directions."""

from __future__ import annotations

from typing import Final

import numpy as np

WINDOWS: Final = (1, 4, 16, 64, 256)
"""Segments searched on either side of a point's parameter; the wider windows only for points still too far away."""
HOPELESS: Final = (16, 0.1)
"""If more than this share of the points is too far away after this window, the lines differ and the search ends."""
MOST_PAIRS: Final = 500_000
"""Pairs of points and segments evaluated at once: about 50 MB."""
TINY: Final = 1e-30
"""Least squared length of a segment, for segments of length zero."""


def lengths(points: np.ndarray) -> np.ndarray:
    """Return (n,) the distance along (n, d) points, from 0, in their unit."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def distances_near(
    points: np.ndarray, at: np.ndarray, line: np.ndarray, line_at: np.ndarray, near: float, limit: float
) -> np.ndarray:
    """Return (n,) distances of points from a polyline, searched near each point's parameter; never too small.

    Args:
        points: (n, d).
        at: (n,) parameter of each point, as in ``line_at``.
        line: (m, d) vertices, m ≥ 2.
        line_at: (m,) their parameters, not decreasing.
        near: distance below which no closer point is searched for.
        limit: distance with which the results are compared; if many are larger, the search ends.
    """
    here = np.clip(np.searchsorted(line_at, at, side="right") - 1, 0, len(line) - 2)
    found = np.full(len(points), np.inf)
    start, way = line[:-1], np.diff(line, axis=0)
    square = np.maximum(np.einsum("ij,ij->i", way, way), TINY)
    for window in WINDOWS:
        far = np.flatnonzero(found > near)
        beyond = np.count_nonzero(found > limit)
        if not far.size or (window > HOPELESS[0] and beyond > max(HOPELESS[1] * len(points), 1.0)):
            break
        step = max(1, MOST_PAIRS // (2 * window + 1))
        for first in range(0, far.size, step):
            some = far[first : first + step]
            segment = here[some, None] + np.arange(-window, window + 1)
            np.minimum(np.maximum(segment, 0, out=segment), len(way) - 1, out=segment)
            found[some] = _distances(points[some, None, :], start[segment], way[segment], square[segment]).min(axis=1)
    return found


def distances_anywhere(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return (n,) distances of points from the nearest point anywhere on a polyline."""
    start, way = line[:-1], np.diff(line, axis=0)
    square = np.maximum(np.einsum("ij,ij->i", way, way), TINY)
    found = np.empty(len(points))
    step = max(1, MOST_PAIRS // len(way))
    for first in range(0, len(points), step):
        some = slice(first, first + step)
        found[some] = _distances(points[some, None, :], start[None], way[None], square[None]).min(axis=1)
    return found


def _distances(points: np.ndarray, start: np.ndarray, way: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Return (n, m) distances of points (n, 1, d) from segments (n or 1, m, d); ``square``: squared lengths of the segments."""
    gap = points - start
    share = np.einsum("...i,...i->...", gap, way) / square
    np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
    gap -= share[..., None] * way
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", gap, gap)))


def largest_distance(
    one: np.ndarray,
    one_at: np.ndarray,
    other: np.ndarray,
    other_at: np.ndarray,
    near: float,
    limit: float,
    *,
    anywhere: bool = False,
) -> float:
    """Return the largest distance between two polylines, from the vertices of each to the other; the caller provides dense vertices.

    Args:
        one: (n, d) vertices, n ≥ 2.
        one_at: (n,) their parameters.
        other: (m, d) vertices, m ≥ 2.
        other_at: (m,) their parameters; equal at corresponding points.
        near: as for `distances_near`.
        limit: as for `distances_near`.
        anywhere: whether points still beyond the limit are compared with the whole other line; otherwise the search may end at a
            distance beyond the limit.
    """
    worst = 0.0
    for points, at, line, line_at in ((one, one_at, other, other_at), (other, other_at, one, one_at)):
        found = distances_near(points, at, line, line_at, near, limit)
        far = np.flatnonzero(found > limit)
        if anywhere and far.size:
            found[far] = distances_anywhere(points[far], line)
        worst = max(worst, float(found.max()))
        if worst > limit and not anywhere:
            break
    return worst
