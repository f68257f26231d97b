"""Interpolation of a smooth function of axis positions along a path of many short blocks.

The function is evaluated at a few nodes, first far apart. Where the axes between two nodes leave the straight line, or the function is
not linear within `ACCURACY`, the interval is halved, down to single blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

FEW: Final = 2048
"""Up to this number of points the function is evaluated at each."""
LONGEST: Final = 256
"""Points per interval at the start."""
ACCURACY: Final = 0.01
"""Largest deviation from linearity in the middle of an interval, relative to the largest value of its group. The middle then becomes
a node, which reduces the remaining error to a quarter.
"""


def interpolated(values: Callable[[np.ndarray], np.ndarray], places: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """Return a function's values along a path, evaluated at some points and interpolated linearly between them.

    Args:
        values: function of (k,) distinct indices of points that returns (k, groups, m) values; those of a group have one unit.
        places: (n, axes) points along a path, n > 0.
        straight: (axes,) deviation from the straight line between two points up to which the path counts as straight.

    Returns:
        (n, groups, m) values.
    """
    count = len(places)
    if count <= FEW:
        return values(np.arange(count))
    nodes = np.append(np.arange(0, count - 1, LONGEST), count - 1)
    at_nodes = values(nodes)
    found = np.empty((count, *at_nodes.shape[1:]))
    found[nodes] = at_nodes
    scaled = places / straight
    way = np.cumsum(np.abs(np.diff(scaled, axis=0, prepend=scaled[:1])).max(axis=1))
    begin, end = nodes[:-1], nodes[1:]
    while True:
        several = end - begin > 1
        begin, end = begin[several], end[several]
        if not begin.size:
            return found
        middle = (begin + end) // 2
        found[middle] = values(middle)
        guess = _on_line(found, way, middle, begin, end)
        allowed = ACCURACY * np.abs(found[middle]).max(axis=2, keepdims=True)
        good = _straight(scaled, way, begin, end) & (np.abs(guess - found[middle]) <= allowed).all(axis=(1, 2))
        for first, last in ((begin[good], middle[good]), (middle[good], end[good])):
            of, between = _between(first, last)
            found[between] = _on_line(found, way, between, first[of], last[of])
        begin, end = (
            np.concatenate([begin[~good], middle[~good]]),
            np.concatenate([middle[~good], end[~good]]),
        )


def _between(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all points inside intervals: the interval each is in, and its index."""
    inside = end - begin - 1
    of = np.repeat(np.arange(len(begin)), inside)
    return of, np.arange(len(of)) + np.repeat(begin + 1 - np.cumsum(inside) + inside, inside)


def _on_line(values: np.ndarray, way: np.ndarray, at: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return values at points, interpolated linearly between two others by the distance travelled."""
    length = way[end] - way[begin]
    share = (way[at] - way[begin]) / np.where(length > 0.0, length, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[begin] + share * (values[end] - values[begin]))


def _straight(scaled: np.ndarray, way: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return (intervals,) whether all points inside (at least one) lie within one unit of the line between the end points."""
    of, between = _between(begin, end)
    off = np.abs(_on_line(scaled, way, between, begin[of], end[of]) - scaled[between]).max(axis=1)
    return np.maximum.reduceat(off, np.searchsorted(of, np.arange(len(begin)))) <= 1.0
