"""Corrections of the three linear axes at the points of a spatial grid, with trilinear interpolation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin.machine.control.correction import Correction, TableSummary
from twin.machine.control.curve import ControlCurve
from twin.machine.machine import Machine

EXACT_UM: Final = 0.005
"""Largest difference between the expression of a grid and its points, far below the resolution of a machine."""


@final
@dataclass(frozen=True, eq=False)
class CorrectionGrid(Correction):
    """Corrections at the points of a spatial grid.

    Attributes:
        machine: a machine with three linear axes.
        at: positions of each linear axis in command order, mm, increasing.
        values: (nodes of the first, of the second, of the third, 3) µm.
    """

    machine: Machine
    at: tuple[tuple[float, ...], ...]
    values: np.ndarray

    def __post_init__(self) -> None:
        read_only(self.values)

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`: the three linear axes."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        table = self.values[..., self.axes.index(axis)]
        q = [positions[name] for name in self.axes]
        if any(isinstance(value, ca.SX) for value in q):
            return self._expression(self.axes.index(axis), q)
        q = [np.asarray(value, dtype=float) for value in np.broadcast_arrays(*q)]
        found: Any = np.zeros(q[0].shape)
        places = [_place(nodes, one) for nodes, one in zip(self.at, q, strict=True)]
        for corner in np.ndindex(2, 2, 2):
            weight: Any = 1.0
            index = []
            for (start, part), far in zip(places, corner, strict=True):
                weight = weight * (part if far else 1.0 - part)
                index.append(start + far)
            found = found + weight * table[tuple(index)]
        return found

    def contents(self) -> tuple[TableSummary, ...]:
        """See `Correction.contents`."""
        peaks = np.abs(self.values).max(axis=(0, 1, 2))
        return tuple(
            TableSummary.over(f"d{name} over the box", nodes, float(peak), "um")
            for name, nodes, peak in zip(self.axes, self.at, peaks, strict=True)
        )

    def plus(self, old: CorrectionGrid) -> CorrectionGrid:
        """Add the values at the same nodes; see `Correction.plus`."""
        return replace(self, values=old.values + self.values)

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return 1

    def _expression(self, output: int, q: Sequence[Any]) -> Any:
        """Return the same correction within `EXACT_UM` as a sum of products of curves of one axis each."""
        cores, shapes = self._products
        factors = [
            [ControlCurve(name, nodes, tuple(column)).along(one) for column in shape.T.tolist()]
            for name, nodes, shape, one in zip(self.axes, self.at, shapes, q, strict=True)
        ]
        total: Any = 0.0
        for i, first in enumerate(factors[0]):
            middle: Any = 0.0
            for j, second in enumerate(factors[1]):
                inner: Any = 0.0
                for k, third in enumerate(factors[2]):
                    inner = inner + third * float(cores[i, j, k, output])
                middle = middle + second * inner
            total = total + first * middle
        return total

    @cached_property
    def _products(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Tucker decomposition of the grid: cores (r, s, t, 3), and for every axis a matrix with one column per curve.

        The correction of a machine consists of a few curves times straight lines: some ten products replace all points of the grid.
        Between the points both are weighted means of their values at the points, so that the tolerance holds everywhere.
        """
        spectra = []
        for i in range(3):
            flat = np.moveaxis(self.values, i, 0).reshape(len(self.at[i]), -1)
            u, s, _ = np.linalg.svd(flat, full_matrices=False)
            spectra.append((u, s))
        limit = 1.0
        while True:
            shapes = tuple(u[:, : max(1, int(np.sum(s > limit)))] for u, s in spectra)
            cores = np.einsum("xyzo,xi,yj,zk->ijko", self.values, *shapes, optimize=True)
            again = np.einsum("ijko,xi,yj,zk->xyzo", cores, *shapes, optimize=True)
            if np.abs(again - self.values).max() <= EXACT_UM or limit < 1e-12:
                return cores, shapes
            limit *= 0.5


def _place(nodes: tuple[float, ...], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the node before, and the position between it and the next, from 0 to 1."""
    at = np.array(nodes)
    inside = np.clip(q, at[0], at[-1])
    start = np.clip(np.searchsorted(at, inside, side="right") - 1, 0, len(at) - 2)
    return start, (inside - at[start]) / (at[start + 1] - at[start])
