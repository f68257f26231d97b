"""Solver that uses compiled code where there is a compiler and enough work for it, else NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from twin.compute.native import loading
from twin.compute.native.cpp import LARGEST_ANGLE, routine, unused
from twin.compute.native.numpy_solver import NumpySolver, angle
from twin.compute.native.problem import CONVERGED, FOR_NUMPY, ROUTINES, Batch, BatchOutcome, InverseProblem

TRIED: Final = 256
"""Number of poses on which compiled code must agree with NumPy before it is used."""

_POINTERS: Final = ctypes.c_void_p


class _SolveJob(ctypes.Structure):
    """`Job` of solve.cpp, field by field."""

    _fields_ = (
        ("rows", ctypes.c_int64),
        *((name, _POINTERS) for name in ("start", "point", "axis", "approach", "loose")),
        *(
            (f"{name}_{step}", ctypes.c_int64)
            for name in ("start", "point", "axis", "approach")
            for step in ("row", "column")
        ),
        ("loose_row", ctypes.c_int64),
        *((name, _POINTERS) for name in ("positions", "distance", "axis_angle_rad", "code")),
        *((f"k_{name}", _POINTERS) for name in ROUTINES),
        *((name, _POINTERS) for name in ("scale", "lower", "upper", "first", "last")),
        *((name, ctypes.c_double) for name in ("rotary_limit", "tolerance", "near", "largest", "mm")),
        ("steps", ctypes.c_int64),
        ("taken", ctypes.c_int64),
    )


@final
@dataclass
class _Compiled:
    """Solver of one problem with compiled code."""

    problem: InverseProblem
    library: ctypes.CDLL
    constants: Mapping[str, np.ndarray]
    numbers: dict[str, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        (lower, upper), (first, last) = self.problem.bounds.T, self.problem.limits.T
        numbers = {"scale": self.problem.scale, "lower": lower, "upper": upper, "first": first, "last": last}
        numbers |= {f"k_{name}": values for name, values in self.constants.items()}
        self.numbers = {name: np.array(values, dtype=float, order="C") for name, values in numbers.items()}
        self.library.solve.argtypes = (ctypes.POINTER(_SolveJob),)
        self.library.solve.restype = None

    def solve(self, batch: Batch) -> BatchOutcome:
        found = BatchOutcome.empty(len(batch), self.problem.axes)
        taken = loading.map_row_chunks(len(batch), lambda part: self._run(batch, found, part))
        return replace(found, iterations=max(taken, default=0))

    def _run(self, batch: Batch, found: BatchOutcome, part: slice) -> int:
        job = _SolveJob(
            rows=part.stop - part.start,
            rotary_limit=self.problem.rotary_limit,
            tolerance=self.problem.tolerance,
            near=self.problem.near,
            largest=LARGEST_ANGLE,
            mm=self.problem.mm,
            steps=self.problem.steps,
            taken=0,
        )
        for name, values in self.numbers.items():
            setattr(job, name, values.ctypes.data)
        for name in ("positions", "distance", "axis_angle_rad", "code"):
            setattr(job, name, getattr(found, name)[part].ctypes.data)
        for name in ("start", "point", "axis", "approach", "loose"):
            values = getattr(batch, name)
            if values is None:
                continue
            setattr(job, name, values[part].ctypes.data)
            for step, stride in zip(("row", "column"), values.strides, strict=False):
                setattr(job, f"{name}_{step}", stride // values.itemsize)
        self.library.solve(ctypes.byref(job))
        return int(job.taken)


@final
class Solver:
    """Solver of one problem that chooses the fastest method; the results agree to rounding.

    The compiled code is cached in `store.folder`; it depends on the machine and on the orders of its curves, not on their numbers.
    """

    def __init__(self, problem: InverseProblem) -> None:
        self.problem = problem
        self._plain = NumpySolver(problem)
        self._native: _Compiled | None = None
        self._confirmed = False

    def solve(self, batch: Batch) -> BatchOutcome:
        """Solve all poses of a batch."""
        if not loading.worth_compiling(len(batch)):
            return self._plain.solve(batch)
        if self._native is None:
            self._native = self._compiled()
        if self._native is None:
            return self._plain.solve(batch)
        found = self._native.solve(_aligned(batch))
        if not self._confirmed and not self._agrees(found, batch):
            loading.disable(self._source, "its results are wrong")
            self._native = None
            return self._plain.solve(batch)
        return self._completed(found, batch)

    def _completed(self, found: BatchOutcome, batch: Batch) -> BatchOutcome:
        """Return the outcome with the poses that the C++ leaves to NumPy: large angles."""
        far = np.flatnonzero(
            (found.axis_angle_rad > 0.01) & np.isfinite(found.axis_angle_rad) & (found.code != FOR_NUMPY)
        )
        found.axis_angle_rad[far] = angle(found.axis_angle_rad[far])
        rows = np.flatnonzero(found.code == FOR_NUMPY)
        if not rows.size:
            return found
        rest = self._plain.solve(batch.part(rows))
        found.put(rows, rest)
        return replace(found, iterations=max(found.iterations, rest.iterations))

    def _agrees(self, found: BatchOutcome, batch: Batch) -> bool:
        """Return whether NumPy confirms poses that compiled code reports as reached; guards against a faulty compiler."""
        rows = np.flatnonzero(found.code == CONVERGED)[:TRIED]
        if not rows.size:
            return not np.any(self._plain.solve(batch.part(slice(0, TRIED))).code == CONVERGED)
        left = self._plain.check(found.positions[rows], batch.part(rows))
        # Twice the tolerance, since it holds only to rounding of either evaluation.
        self._confirmed = bool(np.all(left <= 2.0 * 2.0 * self.problem.tolerance / self.problem.mm))
        return self._confirmed

    @cached_property
    def _source(self) -> str:
        problem, tapes = self.problem, self._plain.tapes or {}
        sizes = {"A": problem.axes, "N": problem.inputs, "R": len(problem.rotary), "S": problem.sides}
        sizes["K"] = tapes["turn"].outputs - problem.axes - 1 if "turn" in tapes else 0
        return "\n".join(
            [
                loading.cpp_text("simd.hpp"),
                f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};",
                f"static const int ROTARY[] = {{{', '.join(map(str, problem.rotary or (0,)))}}};",
                *(routine(name, tapes[name]) if name in tapes else unused(name) for name in ROUTINES),
                loading.cpp_text("solve.cpp"),
            ]
        )

    def _compiled(self) -> _Compiled | None:
        tapes = self._plain.tapes
        if tapes is None:
            return None
        library = loading.library(self._source)
        if library is None:
            return None
        constants = {name: np.array(tapes[name].constants if name in tapes else ()) for name in ROUTINES}
        return _Compiled(self.problem, library, constants)


def _aligned(batch: Batch) -> Batch:
    """Return a batch of arrays that C++ can step through: doubles, whole strides."""

    def ready(values: np.ndarray, kind: Any) -> np.ndarray:
        fits = values.dtype == kind and values.flags.aligned and all(s % values.itemsize == 0 for s in values.strides)
        return values if fits else np.array(values, dtype=kind, order="C")

    approach = None if batch.approach is None else ready(batch.approach, np.float64)
    start, point, axis = (ready(values, np.float64) for values in (batch.start, batch.point, batch.axis))
    return Batch(start, point, axis, approach, ready(batch.loose, np.bool_))
