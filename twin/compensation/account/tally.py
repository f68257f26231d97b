"""Root mean squares and largest values over a program, stretch by stretch."""

from __future__ import annotations

from typing import final

import numpy as np


@final
class CompensationTally:
    """Sums of squares, and where each of some quantities is largest.

    Args:
        quantities: how many.
        squares: of how many numbers squares are summed.

    Attributes:
        count: how many places were added.
        largest: (quantities, quantities) all of them at the place where each is largest; 0 of nothing.
        lines: (quantities,) the program line of that place.
    """

    def __init__(self, quantities: int, squares: int) -> None:
        self.count = 0
        self.largest = np.zeros((quantities, quantities))
        self.lines = np.zeros(quantities, dtype=int)
        self._squares = np.zeros(squares)

    def add(self, values: np.ndarray, squares: np.ndarray, lines: np.ndarray) -> None:
        """Take some places.

        Args:
            values: (quantities, n) at each.
            squares: (squares,) the sums over them.
            lines: (n,) the program line each belongs to.
        """
        if not lines.size:
            return
        at = np.argmax(values, axis=1)
        larger = np.diagonal(values[:, at]) > np.diagonal(self.largest) if self.count else np.full(len(at), True)
        self.largest[larger] = values[:, at[larger]].T
        self.lines[larger] = lines[at[larger]]
        self.count += len(lines)
        self._squares += squares

    @property
    def rms(self) -> list[float]:
        """Root mean squares."""
        return np.sqrt(self._squares / max(self.count, 1)).tolist()
