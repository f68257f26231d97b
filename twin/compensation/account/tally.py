"""Running root mean squares and maxima over a program, stretch by stretch."""

from __future__ import annotations

from typing import final

import numpy as np


@final
class CompensationTally:
    """Running sums of squares, and the place at which each quantity is largest.

    Args:
        quantities: number of quantities.
        squares: number of sums of squares.

    Attributes:
        count: number of places added.
        largest: (quantities, quantities) all quantities at the place where each is largest; 0 if nothing was added.
        lines: (quantities,) program line of that place.
    """

    def __init__(self, quantities: int, squares: int) -> None:
        self.count = 0
        self.largest = np.zeros((quantities, quantities))
        self.lines = np.zeros(quantities, dtype=int)
        self._squares = np.zeros(squares)

    def add(self, values: np.ndarray, squares: np.ndarray, lines: np.ndarray, count: int | None = None) -> None:
        """Add places.

        Args:
            values: (quantities, n) values at each place, or only at those at which one of them is largest.
            squares: (squares,) sums of squares over all places.
            lines: (n,) program line of each place.
            count: number of all places; n if None.
        """
        if not lines.size:
            return
        at = np.argmax(values, axis=1)
        larger = np.diagonal(values[:, at]) > np.diagonal(self.largest) if self.count else np.full(len(at), True)
        self.largest[larger] = values[:, at[larger]].T
        self.lines[larger] = lines[at[larger]]
        self.count += len(lines) if count is None else count
        self._squares += squares

    @property
    def rms(self) -> list[float]:
        """Root mean squares over all places."""
        return np.sqrt(self._squares / max(self.count, 1)).tolist()
