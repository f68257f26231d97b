"""Functions of the machine's state at the measured points, worked out where they are asked for.

A search tries thousands of them: held for all points, they would be many times the data.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Final, TypeVar, final

import numpy as np

PIECE: Final = 1024
"""Points worked on at a time."""

T = TypeVar("T")
Rows = np.ndarray | slice
"""Some of the points: their numbers, or a run of them."""


@final
class Functions:
    """Several functions of the state.

    Args:
        points: how many points there are.
        count: how many functions.
        values: rows → (rows, count).
        where: (points,) where they are not all zero; anywhere if None.
        most: the largest magnitude they can have; what they have at the points is worked out if None.
    """

    def __init__(
        self,
        points: int,
        count: int,
        values: Callable[[Rows], np.ndarray],
        where: np.ndarray | None = None,
        most: float | None = None,
    ) -> None:
        self.points = points
        self.count = count
        self.values = values
        self.where = where
        self._most = most

    @cached_property
    def largest(self) -> np.ndarray:
        """(count,) largest magnitude over all points."""
        if self._most is not None:
            return np.full(self.count, self._most)
        found = np.zeros(self.count)
        for rows in pieces(self.points):
            np.maximum(found, np.abs(self.values(rows)).max(axis=0, initial=0.0), out=found)
        return found


def pieces(points: int, size: int = PIECE) -> list[slice]:
    """Runs of at most ``size`` points that are all of them."""
    return [slice(start, min(start + size, points)) for start in range(0, points, size)]


def given(values: np.ndarray) -> Functions:
    """Functions that are known: (n, count) values."""
    return Functions(len(values), values.shape[1], lambda rows: np.asarray(values[rows]))


@final
class Remembering(dict[str, Any]):
    """A state of readings that keeps what was worked out of it: what several effects need is worked out once (`once`)."""

    def __init__(self, state: Mapping[str, Any]) -> None:
        super().__init__(state)
        self.known: dict[Hashable, Any] = {}


def once(state: Mapping[str, Any], key: Hashable, make: Callable[[], T]) -> T:
    """Something that is worked out of a state, once where the state remembers.

    Args:
        state: of the readings.
        key: what it is.
        make: works it out.
    """
    if not isinstance(state, Remembering):
        return make()
    if key not in state.known:
        state.known[key] = make()
    found: T = state.known[key]
    return found


@final
class _At(Mapping[str, Any]):
    """The state at some points, of which a formula takes what it needs."""

    def __init__(self, state: Mapping[str, Any], rows: Rows) -> None:
        self._state = state
        self._rows = rows

    def __getitem__(self, name: str) -> Any:
        return self._state[name][self._rows]

    def __iter__(self) -> Iterator[str]:
        return iter(self._state)

    def __len__(self) -> int:
        return len(self._state)


def of_state(
    state: Mapping[str, Any], shapes: Callable[[Mapping[str, Any]], Sequence[Mapping[int, Any]]], *, whole: bool = False
) -> tuple[Functions, list[list[tuple[int, int]]]]:
    """What an effect's formula gives: one function for every component of every shape.

    Args:
        state: positions and channels of all points, (n,) each.
        shapes: part of the state → component → values, of each shape; the same components wherever it is asked.
        whole: whether the formula needs all points at once.

    Returns:
        The functions, and of each shape its components, each with the number of its function.
    """
    points = len(next(iter(state.values())))
    everywhere = np.arange(points)

    first = shapes(state if whole else _At(state, slice(0, 1)))
    order = [(k, i) for k, shape in enumerate(first) for i in shape]
    own = [[(i, n) for n, (of, i) in enumerate(order) if of == k] for k in range(len(first))]
    if whole:
        return given(np.stack([np.broadcast_to(first[k][i], points) for k, i in order], axis=1)), own

    def values(rows: Rows) -> np.ndarray:
        made = shapes(_At(state, rows))
        found = np.empty((len(everywhere[rows]), len(order)))
        for column, (k, i) in enumerate(order):
            found[:, column] = made[k][i]
        return found

    return Functions(points, len(order), values), own
