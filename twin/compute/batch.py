"""A CasADi function evaluated over many rows at once, mapped and called through its buffers instead of a Python loop over rows.

Calls with very many rows use a faster evaluation whose results may differ in the last digits.
"""

from __future__ import annotations

import os
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin.compute.native import RowFunction, worth_compiling

MANY: Final = 4096
"""Number of rows in a call from which `twin.compute.native.rows` is faster than CasADi's own evaluation."""
CHUNK = 1024
"""Rows per call of CasADi: enough to make the cost of a call negligible, few enough to fit in cache."""
SMALL_CHUNK = 128
"""Rows per call for the remaining rows, so that little of the call is padding."""


@final
class BatchFunction:
    """A function of arrays with one row per pose.

    Args:
        function: a CasADi function with dense inputs; each input and output becomes an array of shape (rows, entries), entries
            column-major.

    Attributes:
        widths_out: number of entries of each output.
    """

    def __init__(self, function: ca.Function) -> None:
        self._widths_in = [function.numel_in(i) for i in range(function.n_in())]
        self.widths_out = [function.numel_out(i) for i in range(function.n_out())]
        dense = (
            function if all(function.sparsity_out(i).is_dense() for i in range(function.n_out())) else _dense(function)
        )
        self._function = dense
        self._mapped: dict[tuple[int, bool], ca.Function] = {}

    @cached_property
    def _row_function(self) -> RowFunction:
        return RowFunction(self._function)

    def __call__(self, *inputs: np.ndarray) -> tuple[np.ndarray, ...]:
        """Evaluate all rows.

        Args:
            inputs: (rows, entries) each, or (entries,) for one value shared by all rows.

        Returns:
            One (rows, entries) array per output.
        """
        rows = max((array.shape[0] for array in inputs if len(array.shape) == 2), default=1)
        arrays = [
            np.broadcast_to(np.asarray(array, dtype=float), (rows, width))
            for array, width in zip(inputs, self._widths_in, strict=True)
        ]
        outputs = tuple(np.empty((rows, width)) for width in self.widths_out)
        if (rows >= MANY or worth_compiling(rows)) and self._row_function(arrays, outputs):
            return outputs
        columns = [np.ascontiguousarray(array) for array in arrays]
        start = 0
        while start < rows:
            left = rows - start
            if rows <= 4:
                size = 1
            else:
                size = CHUNK if left >= CHUNK else SMALL_CHUNK
            # Calls of one size share one buffer.
            end = start + max(left // size, 1) * size
            self._run(
                self._mapped_over(size, many=rows >= MANY), size, range(start, min(end, rows), size), columns, outputs
            )
            start = end
        return outputs

    def _mapped_over(self, size: int, *, many: bool) -> ca.Function:
        """Return the function of ``size`` rows at once, built when it is first needed; on all cores if there are many rows.

        For few rows, starting the threads takes as long as the work, and on a busy computer much longer.
        """
        if (size, many) not in self._mapped:
            cores = os.cpu_count() or 1
            self._mapped[size, many] = self._function.map(size, *(("thread", cores) if many and cores > 1 else ()))
        return self._mapped[size, many]

    @staticmethod
    def _run(
        function: ca.Function,
        size: int,
        starts: range,
        columns: list[np.ndarray],
        outputs: tuple[np.ndarray, ...],
    ) -> None:
        buffer: Any
        buffer, trigger = function.buffer()
        for start in starts:
            part = slice(start, start + size)
            count = min(size, len(columns[0]) - start)
            complete = count == size
            arrays = [column[part] if complete else _padded(column[part], size) for column in columns]
            results = [output[part] if complete else np.empty((size, output.shape[1])) for output in outputs]
            for i, array in enumerate(arrays):
                buffer.set_arg(i, _view(array))
            for i, array in enumerate(results):
                buffer.set_res(i, _view(array))
            trigger()
            if not complete:
                for output, result in zip(outputs, results, strict=True):
                    output[part] = result[:count]


def _view(array: np.ndarray) -> Any:
    # CasADi's stubs know the (pointer, size) form only; it takes a buffer.
    return memoryview(array)  # type: ignore[arg-type, unused-ignore]


def _padded(rows: np.ndarray, size: int) -> np.ndarray:
    """Return the rows with the last one repeated up to ``size`` rows; padding must be a valid pose."""
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)])


def _dense(function: ca.Function) -> ca.Function:
    symbols = [ca.SX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    results = function.call(symbols)
    return ca.Function(function.name(), symbols, [ca.densify(result) for result in results])
