"""Helpers for NumPy arrays."""

from __future__ import annotations

import numpy as np


def read_only(array: np.ndarray) -> np.ndarray:
    """Make an array read-only and return it."""
    array.flags.writeable = False
    return array


def rows_all_true(good: np.ndarray) -> np.ndarray:
    """Return (n,) whether each row of (n, k) booleans is true throughout; fast where all are, which is the usual case."""
    return np.ones(len(good), dtype=bool) if good.all() else np.asarray(good.all(axis=1))


def row_lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the (n,) lengths of (n, 3) vectors; `numpy.linalg.norm` along an axis is slower."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))
