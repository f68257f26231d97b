"""A CasADi function over very many rows: compiled if that pays, else evaluated by NumPy (`twin.compute.native.tape`)."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import distinct
from twin.compute.native import compiler
from twin.compute.native.compiler import LARGEST_ANGLE, ROUNDING, CompiledRoutine
from twin.compute.native.tape import Tape

TRIED: Final = 256
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
    """A function from columns to rows, evaluated by compiled code or NumPy; the results agree to rounding.

    Args:
        function: dense inputs and outputs.
    """

    def __init__(self, function: ca.Function) -> None:
        self._routine = CompiledRoutine(function, "rows.cpp")
        self._library: ctypes.CDLL | None = None

    def __call__(self, inputs: Sequence[np.ndarray], outputs: tuple[np.ndarray, ...]) -> bool:
        """Fill the outputs.

        Args:
            inputs: (rows, entries) doubles of any strides; a number shared by all rows has stride 0.
            outputs: (rows, entries) each, C-contiguous.

        Returns:
            False if the function has an unsupported operation (`twin.compute.native.tape`) and nothing was done.
        """
        tape = self._routine.tape
        if tape is None:
            return False
        columns = [one[:, k] for one in inputs for k in range(one.shape[1])]
        found = [array[:, k] for array in outputs for k in range(array.shape[1])]
        wanted = compiler.worth_compiling(len(outputs[0]))
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
        some = [column[:TRIED] for column in columns]
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
        steps = [_steps(some) for some in (columns, found)]

        def part(rows: slice) -> int:
            given, out = (start + 8 * rows.start * step for start, step in zip(starts, steps, strict=True))
            arrays = (given, steps[0], out, steps[1], self._routine.constants)
            job = _RowsJob(rows.stop - rows.start, *(array.ctypes.data for array in arrays), far=LARGEST_ANGLE)
            return int(library.run(ctypes.byref(job)))

        return not any(compiler.map_row_chunks(len(found[0]), part))


def _steps(columns: list[np.ndarray]) -> np.ndarray:
    """Return the number of doubles from one row to the next."""
    return np.array([column.strides[0] // column.itemsize for column in columns], dtype=np.int64)


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
    """A function along lines.

    Args:
        function: dense inputs and outputs; the last input is the fraction of a line, the others are one number for each line.
    """

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
        """Return (lines,) the largest value, at least 0, of the function on each line; None if an angle is too large for the C++.

        Args:
            inputs: (lines, entries) doubles each, of any strides.
            points: (lines,) number of points of each line.
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
            for name, array in (
                ("in", values),
                ("in_step", steps),
                ("points", points[lines]),
                ("k", self._routine.constants),
            ):
                setattr(job, name, array.ctypes.data)
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
