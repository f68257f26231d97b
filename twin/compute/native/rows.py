"""A CasADi function over very many rows: compiled if that pays, else evaluated by NumPy (`twin.compute.native.tape`)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Final, final

import casadi as ca
import numpy as np

from twin.compute.native import loading
from twin.compute.native.cpp import LARGEST_ANGLE, ROUNDING
from twin.compute.native.routine import CompiledRoutine
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
        wanted = loading.worth_compiling(len(outputs[0]))
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
            job = _RowsJob(rows.stop - rows.start, *(one.ctypes.data for one in arrays), far=LARGEST_ANGLE)
            return int(library.run(ctypes.byref(job)))

        return not any(loading.map_row_chunks(len(found[0]), part))


def _steps(columns: list[np.ndarray]) -> np.ndarray:
    """Return the number of doubles from one row to the next."""
    return np.array([column.strides[0] // column.itemsize for column in columns], dtype=np.int64)
