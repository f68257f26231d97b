"""Helpers for NumPy arrays."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Final, TypeVar, overload

import numpy as np

Item = TypeVar("Item")


class MadeOnAccess(Sequence[Item]):
    """A sequence whose items are made from arrays when they are accessed."""

    @abstractmethod
    def item(self, index: int) -> Item:
        """Return the item of an index from 0 on."""

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        """Return one item, or a list of items."""
        which = range(len(self))[index]
        return self.item(which) if isinstance(which, int) else [self.item(i) for i in which]


EQUAL: Final = 1e-9
"""Relative difference up to which two computed values count as equal where the larger one is chosen: rounding, which differs from one
processor to another, is a thousandth of it."""
WIDE: Final = 64
"""Rows of a narrow array that NumPy's operations take as one: fifteen times as fast for (n, 5) values as `min(axis=0)`."""


def read_only(array: np.ndarray) -> np.ndarray:
    """Make an array read-only and return it."""
    array.flags.writeable = False
    return array


def first_largest(values: np.ndarray) -> int:
    """Return the index of the first of (n,) values that equals the largest up to rounding; `numpy.argmax` depends on the processor."""
    largest = float(np.max(values))
    return int(np.argmax(values >= largest - EQUAL * abs(largest))) if np.isfinite(largest) else int(np.argmax(values))


def largest_first(values: np.ndarray) -> np.ndarray:
    """Return the indices of (n,) values in descending order; those that are equal up to rounding in ascending order of their index."""
    order = np.argsort(-values, kind="stable")
    ranked = values[order]
    with np.errstate(invalid="ignore"):
        lower = ranked[:-1] - ranked[1:] > EQUAL * np.abs(ranked[:-1])
    lower |= np.isinf(ranked[:-1]) & (ranked[:-1] != ranked[1:])
    return order[np.lexsort((order, np.concatenate([[0], np.cumsum(lower)])))] if len(order) else order


def rows_all_true(good: np.ndarray) -> np.ndarray:
    """Return (n,) whether each row of (n, k) booleans is true throughout; fast where all are, which is the usual case."""
    return np.ones(len(good), dtype=bool) if good.all() else np.asarray(good.all(axis=1))


def all_within(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Return whether all of (n, k) values, none of them NaN, lie within the (k,) bounds; fast, because `WIDE` rows are taken as one."""
    even = len(values) // WIDE * WIDE
    for part, repeated in ((values[:even].reshape(even // WIDE, WIDE * values.shape[1]), WIDE), (values[even:], 1)):
        if len(part) and not (
            (part.min(axis=0).reshape(repeated, -1) >= lower).all()
            and (part.max(axis=0).reshape(repeated, -1) <= upper).all()
        ):
            return False
    return True


def outside_bounds(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return (n, k) which values lie outside the (k,) bounds of their columns; fast where none does, which is the usual case."""
    if all_within(values, lower, upper):
        return np.zeros(values.shape, dtype=bool)
    return np.asarray((values < lower) | (values > upper))


def distinct(numbers: np.ndarray) -> list[int]:
    """Return the different ones of (n,) whole numbers in ascending order, without the import of `numpy.ma` by `numpy.unique`."""
    return sorted(set(numbers.tolist()))
