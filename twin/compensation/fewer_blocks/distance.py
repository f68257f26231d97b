"""How far apart two polylines are, both ways, at places that belong together."""

from __future__ import annotations

from typing import Final

import numpy as np

WINDOWS: Final = (1, 4, 16, 64, 256)
"""Segments looked at on either side of where a point belongs; the wider ones only for points still too far off."""
HOPELESS: Final = (16, 0.1)
"""Where, this window looked through, more than this share of the points is too far off, the lines are not alike."""
MOST_PAIRS: Final = 500_000
"""Pairs of points and segments looked at together: some 50 MB."""
TINY: Final = 1e-30
"""Squared length of a segment that is a point."""


def lengths(points: np.ndarray) -> np.ndarray:
    """(n,) way along (n, d) points, from 0, in their unit."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def to_line(
    points: np.ndarray, at: np.ndarray, line: np.ndarray, line_at: np.ndarray, near: float, limit: float
) -> np.ndarray:
    """(n,) distance of points from a polyline, looked for near where each belongs: never too small.

    Args:
        points: (n, d).
        at: (n,) where on the line each belongs, in the parameter of ``line_at``.
        line: (m, d) vertices, m ≥ 2.
        line_at: (m,) their parameters, not decreasing.
        near: a distance close enough that a smaller one does not matter.
        limit: what the distances are held against: where many are larger, the others are not looked for further.
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
            found[some] = _apart(points[some, None, :], start[segment], way[segment], square[segment]).min(axis=1)
    return found


def to_any(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(n,) distance of points from a polyline, wherever on it the nearest place is."""
    start, way = line[:-1], np.diff(line, axis=0)
    square = np.maximum(np.einsum("ij,ij->i", way, way), TINY)
    found = np.empty(len(points))
    step = max(1, MOST_PAIRS // len(way))
    for first in range(0, len(points), step):
        some = slice(first, first + step)
        found[some] = _apart(points[some, None, :], start[None], way[None], square[None]).min(axis=1)
    return found


def _apart(points: np.ndarray, start: np.ndarray, way: np.ndarray, square: np.ndarray) -> np.ndarray:
    """(n, m) distances of points (n, 1, d) from segments (n or 1, m, d), ``square`` the squares of their lengths."""
    gap = points - start
    share = np.einsum("...i,...i->...", gap, way) / square
    np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
    gap -= share[..., None] * way
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", gap, gap)))


def apart(
    one: np.ndarray,
    one_at: np.ndarray,
    other: np.ndarray,
    other_at: np.ndarray,
    near: float,
    limit: float,
    *,
    anywhere: bool = False,
) -> float:
    """The largest distance between two polylines, from the vertices of either to the other: dense vertices are the caller's.

    Args:
        one: (n, d) vertices, n ≥ 2.
        one_at: (n,) their parameters.
        other: (m, d) vertices, m ≥ 2.
        other_at: (m,) their parameters; alike where the lines belong together.
        near: as of `to_line`.
        limit: as of `to_line`.
        anywhere: whether what is still beyond the limit is looked for all over the other line; else it may stop at a distance beyond
            the limit.
    """
    worst = 0.0
    for points, at, line, line_at in ((one, one_at, other, other_at), (other, other_at, one, one_at)):
        found = to_line(points, at, line, line_at, near, limit)
        far = np.flatnonzero(found > limit)
        if anywhere and far.size:
            found[far] = to_any(points[far], line)
        worst = max(worst, float(found.max()))
        if worst > limit and not anywhere:
            break
    return worst
