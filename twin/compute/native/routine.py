"""A CasADi function as one C++ routine, compiled together with a file of this package that runs it over many points."""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Final, final

import casadi as ca
import numpy as np

from twin.compute.native import loading
from twin.compute.native.cpp import routine
from twin.compute.native.tape import Tape

LARGEST_TAPE: Final = 5_000
"""Largest number of instructions that is compiled; the compiler takes a third of a millisecond for each."""


@final
class CompiledRoutine:
    """The routine of a function in a library.

    Args:
        function: dense inputs and outputs.
        file: the C++ file, which calls the routine ``row`` with the sizes N inputs and O outputs.
    """

    def __init__(self, function: ca.Function, file: str) -> None:
        self._function, self._file = function, file
        self._library: ctypes.CDLL | None = None
        self._refused = False

    @cached_property
    def tape(self) -> Tape | None:
        """The instructions; None if one of them is not supported."""
        return Tape.of(self._function)

    @cached_property
    def constants(self) -> np.ndarray:
        """The constants of the instructions."""
        return np.array(self.tape.constants if self.tape is not None else ())

    def library(self, entry: str) -> ctypes.CDLL | None:
        """Return the library, whose function ``entry`` returns an integer; None if it cannot be compiled, or is too long for that."""
        if self._refused or self.tape is None or len(self.tape.nodes) > LARGEST_TAPE:
            return None
        if self._library is None:
            self._library = loading.library(self._source)
            if self._library is not None:
                getattr(self._library, entry).restype = ctypes.c_int64
        return self._library

    def refuse(self) -> None:
        """Stop using the library, whose results are wrong."""
        self._refused = True
        loading.disable(self._source, "its results are wrong")

    @cached_property
    def _source(self) -> str:
        tape = self.tape
        if tape is None:
            return ""
        sizes = f"enum {{ N = {tape.inputs}, O = {tape.outputs} }};"
        return "\n".join([loading.cpp_text("simd.hpp"), sizes, routine("row", tape), loading.cpp_text(self._file)])
