"""Functions of the machine's state at the measured points, evaluated on demand.

A search uses thousands of them; their values at all points would take many times the memory of the data.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, TypeVar, final

import numpy as np
import scipy

PIECE: Final = 1024
"""Points processed at a time."""

T = TypeVar("T")
Rows = np.ndarray | slice
"""A selection of points: their indices, or a slice."""


@final
@dataclass(frozen=True)
class Interpolation:
    """Functions as sums of a few functions of narrow support, for sums over very many points.

    Attributes:
        weights: (points, nodes) sparse matrix.
        table: (nodes, count) coefficients; the values are ``weights @ table``.
    """

    weights: scipy.sparse.csr_matrix
    table: np.ndarray


@final
class Functions:
    """Several functions of the state.

    Args:
        points: number of points.
        count: number of functions.
        values: function from a selection of points to values (rows, count).
        where: (points,) whether any function is not zero there; anywhere if None.
        bound: upper bound of their magnitude; if None, the largest magnitude at the points is computed.
        interpolate: function that makes an interpolation with the values' rounding error; None if there is none.
        tabulated: whether the values are looked up, not computed.
    """

    def __init__(
        self,
        points: int,
        count: int,
        values: Callable[[Rows], np.ndarray],
        where: np.ndarray | None = None,
        bound: float | None = None,
        interpolate: Callable[[], Interpolation] | None = None,
        *,
        tabulated: bool = False,
    ) -> None:
        self.points = points
        self.count = count
        self.values = values
        self.where = where
        self.tabulated = tabulated
        self._bound = bound
        self._interpolate = interpolate

    @cached_property
    def interpolation(self) -> Interpolation | None:
        """Return the interpolation; None if there is none."""
        return None if self._interpolate is None else self._interpolate()

    @cached_property
    def largest(self) -> np.ndarray:
        """(count,) largest magnitude over all points, or the bound."""
        if self._bound is not None:
            return np.full(self.count, self._bound)
        found = np.zeros(self.count)
        for rows in pieces(self.points):
            np.maximum(found, np.abs(self.values(rows)).max(axis=0, initial=0.0), out=found)
        return found


def pieces(points: int, size: int = PIECE) -> list[slice]:
    """Return slices of at most ``size`` points that cover all points."""
    return [slice(start, min(start + size, points)) for start in range(0, points, size)]


def count_of(rows: Rows, points: int) -> int:
    """Return the number of points in a selection."""
    return len(range(points)[rows]) if isinstance(rows, slice) else len(rows)


def tabulated(values: np.ndarray) -> Functions:
    """Return functions given by a table of values (n, count)."""
    return Functions(len(values), values.shape[1], lambda rows: np.asarray(values[rows]), tabulated=True)


@final
class CachingState(dict[str, Any]):
    """State of the readings with a cache for quantities that several effects derive from it (`cached_in_state`)."""

    def __init__(self, state: Mapping[str, Any]) -> None:
        super().__init__(state)
        self.known: dict[Hashable, Any] = {}


def cached_in_state(state: Mapping[str, Any], key: Hashable, make: Callable[[], T]) -> T:
    """Return a quantity derived from a state, cached if the state is a `CachingState`.

    Args:
        state: state of the readings.
        key: cache key.
        make: function that computes the quantity.
    """
    if not isinstance(state, CachingState):
        return make()
    if key not in state.known:
        state.known[key] = make()
    found: T = state.known[key]
    return found


@final
class _StateSubset(Mapping[str, Any]):
    """The state at a selection of points; columns are selected on access."""

    def __init__(self, state: Mapping[str, Any], rows: Rows) -> None:
        self._state = state
        self._rows = rows

    def __getitem__(self, name: str) -> Any:
        return self._state[name][self._rows]

    def __iter__(self) -> Iterator[str]:
        return iter(self._state)

    def __len__(self) -> int:
        return len(self._state)


def functions_of_state(
    state: Mapping[str, Any], shapes: Callable[[Mapping[str, Any]], Sequence[Mapping[int, Any]]], *, whole: bool = False
) -> tuple[Functions, list[list[tuple[int, int]]]]:
    """Return the functions that an effect's formula gives: one for every component of every shape.

    Args:
        state: positions and channels of all points, (n,) each.
        shapes: formula: from the state at some points to the values of each shape, by component; always the same components.
        whole: whether the formula needs all points at once.

    Returns:
        The functions, and for each shape its components, each with the index of its function.
    """
    points = len(next(iter(state.values())))
    first = shapes(state if whole else _StateSubset(state, slice(0, 1)))
    order = [(k, i) for k, shape in enumerate(first) for i in shape]
    own = [[(i, n) for n, (of, i) in enumerate(order) if of == k] for k in range(len(first))]
    if whole:
        return tabulated(np.stack([np.broadcast_to(first[k][i], points) for k, i in order], axis=1)), own

    def values(rows: Rows) -> np.ndarray:
        shape_values = shapes(_StateSubset(state, rows))
        found = np.empty((count_of(rows, points), len(order)))
        for column, (k, i) in enumerate(order):
            found[:, column] = shape_values[k][i]
        return found

    return Functions(points, len(order), values), own
