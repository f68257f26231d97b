"""A CasADi function over very many rows: compiled if that pays, else evaluated by NumPy (`twin.compute.native.tape`)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import casadi as ca
import numpy as np

from twin.compute.native import loading
from twin.compute.native.cpp import LARGEST_ANGLE, routine
from twin.compute.native.tape import Tape

LARGEST_TAPE: Final = 5_000
"""Largest number of instructions that is compiled; the compiler takes a third of a millisecond for each."""
TRIED: Final = 256
"""Number of rows on which compiled code must agree with NumPy before it is used."""
ROUNDING: Final = 1e-10
"""Tolerance of that comparison, relative to the value or to one; rounding errors of either are a thousandth of it."""


class _RowsJob(ctypes.Structure):
    """`Rows` of rows.cpp, field by field."""

    _fields_ = (
        ("rows", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("in", "in_step", "in_line", "out", "out_step", "k")),
    )


@final
@dataclass(frozen=True)
class TableRows:
    """Rows taken from a shorter table by index, without copying.

    Attributes:
        table: (lines, entries).
        line: (rows,) index of each row in the table.
    """

    table: np.ndarray
    line: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of the expanded array."""
        return len(self.line), self.table.shape[1]

    def written(self) -> np.ndarray:
        """Return the expanded array (rows, entries)."""
        return self.table.take(self.line, axis=0)


@final
class RowFunction:
    """A function from columns to rows, evaluated by compiled code or NumPy; the results agree to rounding.

    Args:
        function: dense inputs and outputs.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._library: ctypes.CDLL | None = None

    def __call__(self, inputs: Sequence[np.ndarray | TableRows], outputs: tuple[np.ndarray, ...]) -> bool:
        """Fill the outputs.

        Args:
            inputs: (rows, entries) doubles of any strides; a number shared by all rows has stride 0.
            outputs: (rows, entries) each, C-contiguous.

        Returns:
            False if the function has an unsupported operation (`twin.compute.native.tape`) and nothing was done.
        """
        if self._tape is None:
            return False
        columns = [_Column(one, k) for one in inputs for k in range(one.shape[1])]
        found = [array[:, k] for array in outputs for k in range(array.shape[1])]
        many = len(outputs[0]) >= loading.WORTH_COMPILING
        wanted = many and len(self._tape.nodes) <= LARGEST_TAPE and loading.enabled()
        if wanted and self._library is None:
            self._library = self._confirmed(loading.library(self._source), columns)
        # Angles too large for the C++ are left to NumPy; infinity and not-a-number are handled correctly.
        if self._library is None or not wanted or any(_far(one) for one in inputs):
            self._plain(columns, found)
        else:
            self._compiled(self._library, columns, found)
        return True

    @cached_property
    def _tape(self) -> Tape | None:
        return Tape.of(self._function)

    @cached_property
    def _source(self) -> str:
        tape = self._tape
        if tape is None:
            return ""
        sizes = f"enum {{ N = {tape.inputs}, O = {tape.outputs} }};"
        return "\n".join([loading.cpp_text("simd.hpp"), sizes, routine("row", tape), loading.cpp_text("rows.cpp")])

    @cached_property
    def _constants(self) -> np.ndarray:
        return np.array(self._tape.constants if self._tape is not None else ())

    def _plain(self, columns: list[_Column], found: list[np.ndarray]) -> None:
        if self._tape is not None:
            for column, values in zip(found, self._tape([one.part() for one in columns]), strict=True):
                column[:] = values

    def _confirmed(self, library: ctypes.CDLL | None, columns: list[_Column]) -> ctypes.CDLL | None:
        """Return the library if NumPy gives the same results for the first rows."""
        if library is None or self._tape is None:
            return None
        some = [column.part(TRIED) for column in columns]
        plain = self._tape(some)
        fast = np.empty_like(plain)
        self._compiled(library, [_Column(values[:, None], 0) for values in some], list(fast))
        there = np.isfinite(plain)
        if np.all(np.abs(fast - plain)[there] <= ROUNDING * np.maximum(1.0, np.abs(plain[there]))):
            return library
        loading.disable(self._source, "its results are wrong")
        return None

    def _compiled(self, library: ctypes.CDLL, columns: list[_Column], found: list[np.ndarray]) -> None:
        values = [
            np.array([column.values.ctypes.data for column in columns]),
            np.array([column.ctypes.data for column in found]),
        ]
        steps = [_steps([column.values for column in columns]), _steps(found)]
        lines = np.array([0 if column.line is None else column.line.ctypes.data for column in columns])
        of_table = lines != 0

        def part(rows: slice) -> None:
            start = rows.start
            given = values[0] + np.where(of_table, 0, 8 * start * steps[0])
            taken = lines + np.where(of_table, 8 * start, 0)
            out = values[1] + 8 * start * steps[1]
            job = _RowsJob(
                rows.stop - start,
                *(one.ctypes.data for one in (given, steps[0], taken, out, steps[1], self._constants)),
            )
            library.run(ctypes.byref(job))

        loading.map_row_chunks(len(found[0]), part)


@final
class _Column:
    """One entry of an input.

    Attributes:
        values: doubles, separated by a whole number of doubles.
        line: (rows,) index of each row among these; None: the row itself.
    """

    def __init__(self, given: np.ndarray | TableRows, entry: int) -> None:
        table = given.table if isinstance(given, TableRows) else given
        self.values = table[:, entry]
        self.line = np.ascontiguousarray(given.line, dtype=np.int64) if isinstance(given, TableRows) else None

    def part(self, rows: int | None = None) -> np.ndarray:
        """Return the first n rows, or all."""
        return self.values[:rows] if self.line is None else self.values.take(self.line[:rows])


def _steps(columns: list[np.ndarray]) -> np.ndarray:
    """Return the number of doubles from one row to the next."""
    return np.array([column.strides[0] // column.itemsize for column in columns], dtype=np.int64)


def _far(given: np.ndarray | TableRows) -> bool:
    """Return whether a number is larger than the C++ accepts as an angle."""
    values = given.table if isinstance(given, TableRows) else given
    if not values.size or (values.max() <= LARGEST_ANGLE and values.min() >= -LARGEST_ANGLE):
        return False
    return bool(np.fmax.reduce(np.abs(values), axis=None) > LARGEST_ANGLE)
