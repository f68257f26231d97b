"""Smooth functions of where the axes stand, at the ends of very many short blocks: evaluated at some, interpolated between these.

What is known of it where the axes stand one block further is nearly what is known here. So the path is taken in stretches of many
blocks; where axes leave the straight line between the ends of one, or the function does, it is halved, down to single blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

FEW: Final = 2048
"""Places up to which each is evaluated."""
LONGEST: Final = 256
"""Places a stretch to begin with."""
ACCURACY: Final = 0.01
"""Of the largest of the numbers that belong together: by how much a value in the middle of a stretch may miss the line between its
ends. It becomes an end itself, which leaves a quarter of that."""


def interpolated(values: Callable[[np.ndarray], np.ndarray], places: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """A function along a path.

    Args:
        values: of (k,) indices of places, different ones, the (k, groups, m) values; those of a group have one unit.
        places: (n, axes) along a path, n > 0.
        straight: (axes,) how far from the straight line between two places those between them may be for it to be one.

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
    """Of stretches all places inside: which stretch each is in, and its index."""
    inside = end - begin - 1
    of = np.repeat(np.arange(len(begin)), inside)
    return of, np.arange(len(of)) + np.repeat(begin + 1 - np.cumsum(inside) + inside, inside)


def _on_line(values: np.ndarray, way: np.ndarray, at: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Values at places by the straight line between two others, at the share of the way there."""
    length = way[end] - way[begin]
    share = (way[at] - way[begin]) / np.where(length > 0.0, length, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[begin] + share * (values[end] - values[begin]))


def _straight(scaled: np.ndarray, way: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(stretches,) whether all places inside (there are some) lie within one of the line between the ends."""
    of, between = _between(begin, end)
    off = np.abs(_on_line(scaled, way, between, begin[of], end[of]) - scaled[between]).max(axis=1)
    return np.maximum.reduceat(off, np.searchsorted(of, np.arange(len(begin)))) <= 1.0
