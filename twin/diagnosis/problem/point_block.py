"""Derivatives and functions of the state at a block of points."""

from __future__ import annotations

from collections.abc import Collection
from typing import final

import numpy as np
import scipy

from twin.diagnosis.candidates.signatures import Freedom, ReadingDerivatives
from twin.identification.network import LinearisedReadings
from twin.numerics.functions import Functions, Interpolation, Rows


@final
class PointBlock:
    """Derivatives and functions of the state at a block of points, each computed once.

    Args:
        view: linearisation at some or all points of the data.
        rows: the block's rows in the view.
        kept: values of functions that are kept for further passes, and the functions to keep; none if None.
    """

    def __init__(
        self,
        view: LinearisedReadings,
        rows: Rows,
        kept: tuple[dict[Functions, np.ndarray | None], Collection[Functions]] | None = None,
    ) -> None:
        self.rows = rows
        self._points = view.rows[rows]
        self.derivatives = ReadingDerivatives(view, rows)
        self._values: dict[Functions, np.ndarray | None] = {}
        self._acts: dict[str, np.ndarray] = {}
        self._weights: dict[Functions, scipy.sparse.csr_matrix] = {}
        self._kept, self._keep = ({}, ()) if kept is None else kept

    def acts(self, freedom: Freedom) -> bool:
        """Return whether any of the readings depends on a degree of freedom."""
        name, direction = freedom
        if name not in self._acts:
            self._acts[name] = np.any(self.derivatives.of(name) != 0.0, axis=(0, 1))
        return bool(self._acts[name][direction])

    def values(self, functions: Functions) -> np.ndarray | None:
        """Return the functions' values (points, count), or None if all are zero."""
        # The values of a table are no faster to look up in a copy.
        values = self._kept if functions in self._keep and not functions.tabulated else self._values
        if functions not in values:
            values[functions] = None if self.is_zero(functions) else functions.values(self._points)
        return values[functions]

    def is_zero(self, functions: Functions) -> bool:
        """Return whether all functions are zero at these points."""
        return functions.where is not None and not functions.where[self._points].any()

    def weights(self, functions: Functions, interpolation: Interpolation) -> scipy.sparse.csr_matrix:
        """Return the weights (points, nodes) of the interpolation of some functions."""
        if functions not in self._weights:
            self._weights[functions] = interpolation.weights[self._points]
        return self._weights[functions]
