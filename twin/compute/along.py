"""A CasADi function at points along many straight lines, of which only the largest values or totals are kept.

A CasADi function evaluated over many rows at once, mapped and called through its buffers instead of a Python loop over rows.

Calls with very many rows use a faster evaluation whose results may differ in the last digits.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, TypeVar, final

import casadi as ca
import numpy as np

from twin._common.arrays import distinct
from twin.compute.native import ROUNDING, CompiledAlong, RowFunction, Totals, worth_compiling

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


# --- A CasADi function at points along many straight lines, of which only the largest values or totals are kept

AT_ONCE: Final = 100_000
"""Points evaluated at once without compiled code, to bound the memory."""
TRIED: Final = 64
"""Lines on which compiled code must agree with the evaluation point by point before it is used."""

Found = TypeVar("Found", np.ndarray, Totals)


@final
class AlongFunction:
    """A function at points spread evenly along lines: at fractions (k + ½)/n of each.

    Args:
        function: dense inputs, of which the last is the fraction; scalar outputs.
    """

    def __init__(self, function: ca.Function) -> None:
        self._rows = BatchFunction(function)
        self._compiled = CompiledAlong(function)
        self._confirmed = False

    def largest(self, inputs: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
        """Return (lines,) the largest value, at least 0, of a function with one output on each line.

        Args:
            inputs: (lines, entries) each, or (entries,) for one value shared by all lines.
            points: (lines,) number of points on each line.
        """
        compiled = self._compiled.largest
        return self._chosen(inputs, points, compiled, self._largest, lambda found: found)

    def totals(self, inputs: tuple[np.ndarray, ...], points: np.ndarray, slack: float) -> Totals:
        """Return the totals of all outputs but the last, over the points at which the last is at most ``slack``.

        Points at which the first output is not finite do not count either. Arguments as for `largest`.
        """

        def compiled(inputs: tuple[np.ndarray, ...], points: np.ndarray) -> Totals | None:
            return self._compiled.totals(inputs, points, slack)

        def plain(inputs: tuple[np.ndarray, ...], points: np.ndarray) -> Totals:
            return self._totals(inputs, points, slack)

        return self._chosen(inputs, points, compiled, plain, _means)

    def _chosen(
        self,
        inputs: tuple[np.ndarray, ...],
        points: np.ndarray,
        compiled: Callable[[tuple[np.ndarray, ...], np.ndarray], Found | None],
        plain: Callable[[tuple[np.ndarray, ...], np.ndarray], Found],
        numbers: Callable[[Found], np.ndarray],
    ) -> Found:
        """Return the result of compiled code, if it is worth its time and agrees on the first lines; else that of all points."""
        rows = len(points)
        arrays = tuple(np.broadcast_to(np.asarray(array, dtype=float), (rows, np.shape(array)[-1])) for array in inputs)
        if worth_compiling(int(points.sum())) and self._compiled.usable:
            if not self._confirmed:
                some, few = tuple(array[:TRIED] for array in arrays), points[:TRIED]
                tried = compiled(some, few)
                self._confirmed = tried is not None and _alike(numbers(tried), numbers(plain(some, few)))
                if tried is not None and not self._confirmed:
                    self._compiled.refuse()
            chosen = compiled(arrays, points) if self._confirmed else None
            if chosen is not None:
                return chosen
        return plain(arrays, points)

    def _largest(self, inputs: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
        largest = np.zeros(len(points))
        for part, (values,) in self._expanded(inputs, points):
            there = np.flatnonzero(points[part] > 0)
            first = (np.cumsum(points[part]) - points[part])[there]
            if there.size:
                largest[part.start + there] = np.maximum(np.maximum.reduceat(values[:, 0], first), 0.0)
        return largest

    def _totals(self, inputs: tuple[np.ndarray, ...], points: np.ndarray, slack: float) -> Totals:
        total = Totals.none(len(self._rows.widths_out) - 1)
        for part, outputs in self._expanded(inputs, points):
            *columns, beyond = (output[:, 0] for output in outputs)
            known = np.isfinite(columns[0]) & (beyond <= slack)
            line = np.repeat(np.arange(len(points[part])), points[part])[known]
            values = np.stack(columns)[:, known]
            if line.size:
                at = np.argmax(values, axis=1)
                squares = np.einsum("ij,ij->i", values, values)
                total = total.joined(Totals(line.size, squares, values[:, at].T, line[at]), part.start)
        return total

    def _expanded(
        self, inputs: tuple[np.ndarray, ...], points: np.ndarray
    ) -> Iterator[tuple[slice, tuple[np.ndarray, ...]]]:
        """Yield portions of the lines with the outputs at all of their points."""
        total = np.cumsum(points)
        cuts = distinct(np.searchsorted(total, np.arange(AT_ONCE, total[-1], AT_ONCE))) if len(total) else []
        for first, last in pairwise([0, *cuts, len(points)]):
            count = points[first:last]
            number = np.repeat(np.arange(first, last), count)
            if number.size:
                yield (
                    slice(first, last),
                    self._rows(*(array.take(number, axis=0) for array in inputs), fractions(count)[:, None]),
                )


def fractions(points: np.ndarray) -> np.ndarray:
    """Return (n,) the fractions of all points of lines with these numbers of points: (k + ½)/n."""
    number = np.arange(points.sum()) - np.repeat(np.cumsum(points) - points, points)
    return (number + 0.5) / np.repeat(points, points)


def _means(found: Totals) -> np.ndarray:
    """Return number of points and root mean squares."""
    return np.append(np.sqrt(found.squares / max(found.count, 1)), found.count)


def _alike(found: np.ndarray, plain: np.ndarray) -> bool:
    """Return whether two results agree to rounding, relative to the value or to one."""
    return bool(np.allclose(found, plain, rtol=ROUNDING, atol=ROUNDING, equal_nan=True))
