"""Arrays that leave a room do so read-only; and what is asked of long ones."""

from __future__ import annotations

import numpy as np


def locked(array: np.ndarray) -> np.ndarray:
    """The same array, no longer writeable."""
    array.flags.writeable = False
    return array


def every(good: np.ndarray) -> np.ndarray:
    """(n,) whether a row of (n, k) booleans is true throughout; quick where all of them are, which is nearly always."""
    return np.ones(len(good), dtype=bool) if good.all() else np.asarray(good.all(axis=1))


def lengths(vectors: np.ndarray) -> np.ndarray:
    """(n,) lengths of (n, 3) vectors; `numpy.linalg.norm` goes through them row by row."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))
