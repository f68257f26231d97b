"""A CasADi function over very many rows: compiled where that is worth it, else NumPy's way (`twin.native.tape`)."""

from __future__ import annotations

import ctypes
import os
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin.native import loading
from twin.native.cpp import LARGEST_ANGLE, routine
from twin.native.tape import Tape, UnknownOperationError

LARGEST_TAPE: Final = 5_000
"""Instructions of what is compiled: the compiler takes a third of a millisecond for each."""
TRIED: Final = 256
"""Rows that NumPy confirms before compiled code is believed."""
ROUNDING: Final = 1e-10
"""Of a value that is at most one, or of the value: rounding of either evaluation is a thousandth of it."""


class _Job(ctypes.Structure):
    """`Rows` of rows.cpp, field by field."""

    _fields_ = (
        ("rows", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("in", "in_step", "out", "out_step", "k")),
    )


@final
class RowFunction:
    """``columns in, rows out``; the answers of its ways agree to rounding.

    Args:
        function: dense inputs and outputs.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._library: ctypes.CDLL | None = None

    def __call__(self, inputs: list[np.ndarray], outputs: tuple[np.ndarray, ...]) -> bool:
        """Fill the outputs.

        Args:
            inputs: (rows, entries) doubles of any strides; one number for all rows has the stride 0.
            outputs: (rows, entries) each, row after row.

        Returns:
            Whether it did: not where the function has an operation that is not known here (`twin.native.tape`).
        """
        if self._tape is None:
            return False
        rows = len(outputs[0])
        columns = [array[:, k] for array in inputs for k in range(array.shape[1])]
        found = [array[:, k] for array in outputs for k in range(array.shape[1])]
        wanted = rows >= loading.WORTH_COMPILING and len(self._tape.nodes) <= LARGEST_TAPE and loading.enabled()
        if wanted and self._library is None:
            self._library = self._confirmed(loading.library(self._source), columns)
        # Sines of angles the C++ does not reduce are left to NumPy; infinite and not-a-number come out as they should.
        far = wanted and any(np.fmax.reduce(np.abs(column)) > LARGEST_ANGLE for column in columns)
        if self._library is None or not wanted or far:
            self._plain(columns, found)
        else:
            self._compiled(self._library, columns, found)
        return True

    @cached_property
    def _tape(self) -> Tape | None:
        try:
            return Tape(self._function)
        except UnknownOperationError:
            return None

    @cached_property
    def _source(self) -> str:
        tape = self._tape
        if tape is None:
            return ""
        sizes = f"enum {{ N = {tape.inputs}, O = {tape.outputs} }};"
        return "\n".join([loading.text("simd.hpp"), sizes, routine("row", tape), loading.text("rows.cpp")])

    @cached_property
    def _constants(self) -> np.ndarray:
        return np.array(self._tape.constants if self._tape is not None else ())

    def _plain(self, columns: list[np.ndarray], found: list[np.ndarray]) -> None:
        if self._tape is not None:
            for column, values in zip(found, self._tape(columns), strict=True):
                column[:] = values

    def _confirmed(self, library: ctypes.CDLL | None, columns: list[np.ndarray]) -> ctypes.CDLL | None:
        """The library, if NumPy finds the same for the first rows."""
        if library is None or self._tape is None:
            return None
        some = [column[:TRIED] for column in columns]
        plain = self._tape(some)
        fast = np.empty_like(plain)
        self._compiled(library, some, list(fast))
        there = np.isfinite(plain)
        if np.all(np.abs(fast - plain)[there] <= ROUNDING * np.maximum(1.0, np.abs(plain[there]))):
            return library
        loading.give_up(self._source, "its results are wrong")
        return None

    def _compiled(self, library: ctypes.CDLL, columns: list[np.ndarray], found: list[np.ndarray]) -> None:
        rows = len(found[0])
        steps = [np.array([a.strides[0] // a.itemsize for a in some], dtype=np.int64) for some in (columns, found)]

        def part(start: int) -> None:
            stop = min(start + loading.PORTION, rows)
            pointers: list[Any] = [
                np.array([a[start:stop].ctypes.data for a in some], dtype=np.uintp) for some in (columns, found)
            ]
            job = _Job(
                stop - start,
                pointers[0].ctypes.data,
                steps[0].ctypes.data,
                pointers[1].ctypes.data,
                steps[1].ctypes.data,
                self._constants.ctypes.data,
            )
            library.run(ctypes.byref(job))

        starts = range(0, rows, loading.PORTION)
        if len(starts) == 1:
            part(0)
            return
        # ctypes lets go of Python while it is in there.
        with ThreadPoolExecutor(min(os.cpu_count() or 1, len(starts))) as pool:
            for _ in pool.map(part, starts):
                pass
