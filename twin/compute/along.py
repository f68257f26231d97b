"""CasADi functions over very many rows, and at points along many straight lines of which only the largest values or totals are kept.

Rows are mapped and passed through buffers instead of a Python loop. Calls with very many rows use a faster evaluation, compiled or by
NumPy (`twin.compute.native.tape`), whose results may differ in the last digits.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, TypeVar, final

import casadi as ca
import numpy as np

from twin._common.arrays import distinct
from twin.compute.native import compiler
from twin.compute.native.compiler import LARGEST_ANGLE, ROUNDING, CompiledRoutine, worth_compiling
from twin.compute.native.tape import Tape

TRIED_ROWS: Final = 256
"""Number of rows on which compiled code must agree with NumPy before it is used."""


class _RowsJob(ctypes.Structure):
    """`Rows` of rows.cpp, field by field."""

    _fields_ = (
        ("rows", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("in", "in_step", "out", "out_step", "k")),
        ("far", ctypes.c_double),
    )


@final
class RowFunction:
    """A function from columns to rows, dense, evaluated by compiled code or NumPy; the results agree to rounding."""

    def __init__(self, function: ca.Function) -> None:
        self._routine = CompiledRoutine(function, "rows.cpp")
        self._library: ctypes.CDLL | None = None

    def __call__(self, inputs: Sequence[np.ndarray], outputs: tuple[np.ndarray, ...]) -> bool:
        """Fill the outputs, C-contiguous (rows, entries) each; return False, and do nothing, for an unsupported operation.

        Inputs are (rows, entries) doubles of any strides; a number shared by all rows has stride 0.
        """
        tape = self._routine.tape
        if tape is None:
            return False
        columns = [one[:, k] for one in inputs for k in range(one.shape[1])]
        found = [array[:, k] for array in outputs for k in range(array.shape[1])]
        wanted = worth_compiling(len(outputs[0]))
        if wanted and self._library is None:
            self._library = self._confirmed(tape, columns)
        # Angles too large for the C++, and infinity, are left to NumPy.
        if self._library is None or not wanted or not self._compiled(self._library, columns, found):
            for column, values in zip(found, tape(columns), strict=True):
                column[:] = values
        return True

    def _confirmed(self, tape: Tape, columns: list[np.ndarray]) -> ctypes.CDLL | None:
        """Return the library if NumPy gives the same results for the first rows."""
        library = self._routine.library("run")
        if library is None:
            return None
        some = [column[:TRIED_ROWS] for column in columns]
        plain = tape(some)
        fast = np.empty_like(plain)
        if not self._compiled(library, some, list(fast)):
            return library
        there = np.isfinite(plain)
        if np.all(np.abs(fast - plain)[there] <= ROUNDING * np.maximum(1.0, np.abs(plain[there]))):
            return library
        self._routine.refuse()
        return None

    def _compiled(self, library: ctypes.CDLL, columns: list[np.ndarray], found: list[np.ndarray]) -> bool:
        """Fill the results; return False if an angle is too large."""
        starts = [np.array([column.ctypes.data for column in some]) for some in (columns, found)]
        steps = [
            np.array([column.strides[0] // column.itemsize for column in some], dtype=np.int64)
            for some in (columns, found)
        ]

        def part(rows: slice) -> int:
            given, out = (start + 8 * rows.start * step for start, step in zip(starts, steps, strict=True))
            job = _RowsJob(rows.stop - rows.start, far=LARGEST_ANGLE)
            arrays = {"in": given, "in_step": steps[0], "out": out, "out_step": steps[1], "k": self._routine.constants}
            compiler.point_to(job, arrays)
            return int(library.run(ctypes.byref(job)))

        return not any(compiler.map_row_chunks(len(found[0]), part))


# --- A function at points along many straight lines by compiled code (`along.cpp`), which keeps no value of a single point

POINTS: Final = 4 * compiler.PORTION
"""Points per chunk of a thread; they take a quarter of the time of a solved pose."""


class _AlongJob(ctypes.Structure):
    """`Along` of along.cpp, field by field."""

    _fields_ = (
        ("lines", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("in", "in_step", "points", "k")),
        *((name, ctypes.c_double) for name in ("far", "slack")),
        ("worst", ctypes.c_void_p),
        ("count", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("squares", "largest", "line")),
    )


@final
@dataclass(frozen=True)
class Totals:
    """Sums and largest values of q quantities at many points.

    Attributes:
        count: number of points at which the values are known.
        squares: (q,) sums of squares over these.
        largest: (q, q) all values at the point at which each is largest; 0 if there is none.
        line: (q,) line of that point.
    """

    count: int
    squares: np.ndarray
    largest: np.ndarray
    line: np.ndarray

    @classmethod
    def none(cls, quantities: int) -> Totals:
        """Return the totals of no point."""
        square = np.zeros((quantities, quantities))
        return cls(0, np.zeros(quantities), square, np.zeros(quantities, dtype=np.int64))

    def joined(self, other: Totals, first: int = 0) -> Totals:
        """Return the totals of these points and of later ones; ``first``: number of the first of their lines."""
        if not (self.count and other.count):
            return self if self.count else Totals(other.count, other.squares, other.largest, other.line + first)
        larger = np.diagonal(other.largest) > np.diagonal(self.largest)
        return Totals(
            self.count + other.count,
            self.squares + other.squares,
            np.where(larger[:, None], other.largest, self.largest),
            np.where(larger, other.line + first, self.line),
        )


@final
class CompiledAlong:
    """A function along lines: its last input is the fraction of a line, the others are one number for each line."""

    def __init__(self, function: ca.Function) -> None:
        self._routine = CompiledRoutine(function, "along.cpp")

    @property
    def usable(self) -> bool:
        """Whether compiled code can evaluate the function."""
        return self._routine.library("along") is not None

    def refuse(self) -> None:
        """Stop using the compiled code, whose results are wrong."""
        self._routine.refuse()

    def largest(self, inputs: Sequence[np.ndarray], points: np.ndarray) -> np.ndarray | None:
        """Return (lines,) the largest value, at least 0, on each line; None if an angle is too large for the C++.

        Inputs are (lines, entries) doubles of any strides; ``points``: (lines,) number of points of each line.
        """
        worst = np.zeros(len(points))
        parts = self._parts(inputs, points, np.inf, lambda part, job: setattr(job, "worst", worst[part].ctypes.data))
        return worst if parts is not None else None

    def totals(self, inputs: Sequence[np.ndarray], points: np.ndarray, slack: float) -> Totals | None:
        """Return the totals of all outputs but the last, over the points at which the last is at most ``slack``; or None, as above."""
        tape = self._routine.tape
        found: dict[int, Totals] = {}

        def room(part: slice, job: _AlongJob) -> None:
            mine = found[part.start] = Totals.none(tape.outputs - 1 if tape is not None else 0)
            for name in ("squares", "largest", "line"):
                setattr(job, name, getattr(mine, name).ctypes.data)

        parts = self._parts(inputs, points, slack, room)
        if parts is None:
            return None
        total = Totals.none(tape.outputs - 1 if tape is not None else 0)
        for start, count in parts:
            mine = found[start]
            total = total.joined(Totals(count, mine.squares, mine.largest, mine.line), start)
        return total

    def _parts(
        self, inputs: Sequence[np.ndarray], points: np.ndarray, slack: float, room: Callable[[slice, _AlongJob], None]
    ) -> list[tuple[int, int]] | None:
        """Evaluate parts of the lines in threads; return first line and number of known points of each."""
        library = self._routine.library("along")
        columns = [array[:, k] for array in inputs for k in range(array.shape[1])]
        steps = np.array([column.strides[0] // column.itemsize for column in columns], dtype=np.int64)
        starts = np.array([column.ctypes.data for column in columns])
        points = np.ascontiguousarray(points, dtype=np.int64)

        def part(lines: slice) -> tuple[int, int, int]:
            values = starts + 8 * lines.start * steps
            job = _AlongJob(lines.stop - lines.start, far=LARGEST_ANGLE, slack=slack)
            given = {"in": values, "in_step": steps, "points": points[lines], "k": self._routine.constants}
            compiler.point_to(job, given)
            room(lines, job)
            status = library.along(ctypes.byref(job)) if library is not None else 1
            return status, lines.start, job.count

        found = compiler.map_parts(_even(points), part)
        return None if any(status for status, _, _ in found) else [(start, count) for _, start, count in found]


def _even(points: np.ndarray) -> list[slice]:
    """Return parts of the lines with about `POINTS` points each; they do not depend on the number of processors."""
    total = np.cumsum(points)
    count = -(-int(total[-1]) // POINTS)
    cuts = distinct(np.searchsorted(total, total[-1] * np.arange(1, count) / count))
    return [slice(first, last) for first, last in pairwise([0, *cuts, len(points)]) if last > first]


# --- A function over many rows --------------------------------------------------------------------

MANY: Final = 4096
"""Number of rows in a call from which `RowFunction` is faster than CasADi's own evaluation."""
CHUNK = 1024
"""Rows per call of CasADi: enough to make the cost of a call negligible, few enough to fit in cache."""
SMALL_CHUNK = 128
"""Rows per call for the remaining rows, so that little of the call is padding."""


@final
class BatchFunction:
    """A dense function of arrays with one row per pose: (rows, entries) for each input and output, entries column-major."""

    def __init__(self, function: ca.Function) -> None:
        self._widths_in = [function.numel_in(i) for i in range(function.n_in())]
        self.widths_out = [function.numel_out(i) for i in range(function.n_out())]
        dense = all(function.sparsity_out(i).is_dense() for i in range(function.n_out()))
        self._function = function if dense else _dense(function)
        self._mapped: dict[tuple[int, bool], ca.Function] = {}

    @cached_property
    def _row_function(self) -> RowFunction:
        return RowFunction(self._function)

    def __call__(self, *inputs: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return one (rows, entries) array per output; inputs: (rows, entries) each, or (entries,) for one value shared by all rows."""
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
            size = 1 if rows <= 4 else CHUNK if left >= CHUNK else SMALL_CHUNK
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
        function: ca.Function, size: int, starts: range, columns: list[np.ndarray], outputs: tuple[np.ndarray, ...]
    ) -> None:
        buffer: Any
        buffer, trigger = function.buffer()
        for start in starts:
            part = slice(start, start + size)
            count = min(size, len(columns[0]) - start)
            complete = count == size
            arrays = [column[part] for column in columns]
            if not complete:  # the last row is repeated: padding must be a valid pose
                arrays = [np.concatenate([rows, np.repeat(rows[-1:], size - count, axis=0)]) for rows in arrays]
            results = [output[part] if complete else np.empty((size, output.shape[1])) for output in outputs]
            for put, group in ((buffer.set_arg, arrays), (buffer.set_res, results)):
                for i, array in enumerate(group):
                    put(i, memoryview(array))  # type: ignore[arg-type, unused-ignore]  # of its stubs; it is a buffer
            trigger()
            if not complete:
                for output, result in zip(outputs, results, strict=True):
                    output[part] = result[:count]


def _dense(function: ca.Function) -> ca.Function:
    symbols = [ca.SX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    results = function.call(symbols)
    return ca.Function(function.name(), symbols, [ca.densify(result) for result in results])


AT_ONCE: Final = 100_000
"""Points evaluated at once without compiled code, to bound the memory."""
TRIED_LINES: Final = 64
"""Lines on which compiled code must agree with the evaluation point by point before it is used."""

Found = TypeVar("Found", np.ndarray, Totals)


@final
class AlongFunction:
    """A function of dense inputs, the last of them fractions (k + ½)/n of a line, at points along lines; scalar outputs."""

    def __init__(self, function: ca.Function) -> None:
        self._rows = BatchFunction(function)
        self._compiled = CompiledAlong(function)
        self._confirmed = False

    def largest(self, inputs: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
        """Return (lines,) the largest value, at least 0, of a function with one output on each line.

        Inputs are (lines, entries) each, or (entries,) for one value shared by all lines; ``points``: (lines,) their points.
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
                some, few = tuple(array[:TRIED_LINES] for array in arrays), points[:TRIED_LINES]
                tried = compiled(some, few)
                self._confirmed = tried is not None and np.allclose(
                    numbers(tried), numbers(plain(some, few)), rtol=ROUNDING, atol=ROUNDING, equal_nan=True
                )
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
