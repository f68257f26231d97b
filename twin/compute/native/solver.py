"""Solver that uses compiled code where there is a compiler and enough work for it, else NumPy.

The solver without a compiler: NumPy on blocks of poses, CasADi on a few poses.

Newton's method runs on all poses at once. The rotary axes are used if they reach the orientation within their permitted range;
otherwise they go to the best position and the linear axes solve for the point.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Protocol, final

import casadi as ca
import numpy as np

from twin._common.resources import builds_expressions
from twin.compute.along import BatchFunction
from twin.compute.native import compiler
from twin.compute.native.compiler import LARGEST_ANGLE, routine, unused
from twin.compute.native.tape import Tape

CONVERGED: Final = 0
OUT_OF_RANGE: Final = 1
SINGULAR: Final = 2
FOR_NUMPY: Final = 3
"""Status codes of a pose. The last one is internal to the C++: an angle too large for it, which is left to NumPy."""
ROUTINES: Final = ("turn", "again", "follow", "repair", "check")
"""Names of the functions of a step, as in `StepFunctions`."""


class StepFunctions(Protocol):
    """The functions of a solver step. Inputs: q (axes), the approach (sides) if there is one, point (3) and axis (3)."""

    @property
    def turn(self) -> ca.Function:
        """Position q after a Newton step of all axes, the size of the residual before it, and the matrices of the step."""

    @property
    def again(self) -> ca.Function:
        """Change of q (axes) in another step with the same matrices, from residual (3 of the point, 2 of the axis) and matrices."""

    @property
    def follow(self) -> ca.Function:
        """Position q after a Newton step of the linear axes, and the largest component of the point's residual before it."""

    @property
    def repair(self) -> ca.Function:
        """Position q with the rotary axes in the best position where the whole orientation cannot be reached."""

    @property
    def check(self) -> ca.Function:
        """Both residual sizes; squared distances of the point and between the unit vectors of tool axis and target; the residual."""


@final
@dataclass(frozen=True)
class InverseProblem:
    """A machine with errors, reduced to the data of its inverse; metres and radians unless stated otherwise.

    Attributes:
        rotary: indices of the rotary axes that may move; if there are none, no pose may be `Batch.loose`.
        sides: number of further inputs: directions of approach, and channels that differ from pose to pose.
        scale: (axes,) metres per millimetre, radians per degree.
        bounds: (axes, 2) limits of a result in mm and degrees.
        limits: (rotary, 2) limits of the rotary axes for a full correction of the orientation.
        rotary_limit: largest change of a rotary axis for it.
        tolerance: metres, and radians for the tool axis.
        near: residual below which a step may reuse the matrices of the step before.
        mm: metres per millimetre.
    """

    functions: StepFunctions
    axes: int
    rotary: tuple[int, ...]
    sides: int
    scale: np.ndarray
    bounds: np.ndarray
    limits: np.ndarray
    rotary_limit: float
    tolerance: float
    steps: int
    near: float
    mm: float

    @property
    def routines(self) -> tuple[str, ...]:
        """Names of the functions that are needed: without rotary axes to move only those of the linear axes."""
        return ROUTINES if self.rotary else ("follow", "check")

    @property
    def inputs(self) -> int:
        """Number of inputs of a function."""
        return self.axes + self.sides + 6


@final
@dataclass(frozen=True)
class Batch:
    """Poses to reach, in mm and degrees.

    Attributes:
        start: (n, axes) start positions.
        point: (n, 3) target points.
        axis: (n, 3) target directions of the tool axis.
        approach: (n, sides) directions of approach and channels, or None.
        loose: (n,) whether the rotary axes may move.
    """

    start: np.ndarray
    point: np.ndarray
    axis: np.ndarray
    approach: np.ndarray | None
    loose: np.ndarray

    def __len__(self) -> int:
        return len(self.start)

    def part(self, rows: slice | np.ndarray) -> Batch:
        """Return some of the poses."""
        approach = None if self.approach is None else self.approach[rows]
        return Batch(self.start[rows], self.point[rows], self.axis[rows], approach, self.loose[rows])


@final
@dataclass(frozen=True)
class BatchOutcome:
    """The result of a batch.

    Attributes:
        positions: (n, axes) mm and degrees; NaN for an input that is not finite.
        distance: (n,) remaining distance of the point, mm.
        axis_angle_rad: (n,) angle between tool axis and target, radians.
        code: (n,) `CONVERGED`, `OUT_OF_RANGE`, `SINGULAR`.
        iterations: largest number of Newton steps of a pose.
    """

    positions: np.ndarray
    distance: np.ndarray
    axis_angle_rad: np.ndarray
    code: np.ndarray
    iterations: int

    def put(self, rows: slice | np.ndarray, other: BatchOutcome) -> None:
        """Store the results of some of the poses."""
        self.positions[rows], self.code[rows] = other.positions, other.code
        self.distance[rows], self.axis_angle_rad[rows] = other.distance, other.axis_angle_rad

    @staticmethod
    def empty(rows: int, axes: int) -> BatchOutcome:
        """Return an outcome with uninitialised arrays."""
        return BatchOutcome(np.empty((rows, axes)), np.empty(rows), np.empty(rows), np.empty(rows, dtype=np.uint8), 0)


# --- The solver without a compiler: NumPy on blocks of poses, CasADi on a few poses ---------------

FEW: Final = 100
"""Number of poses up to which CasADi is faster; NumPy has the cost of a call per instruction."""
PORTION: Final = 16384
"""Poses per chunk, few enough to fit in cache."""


class _Routine:
    """One function of a problem, evaluated on columns."""

    def __init__(self, problem: InverseProblem, name: str) -> None:
        self._problem = problem
        self._name = name

    @cached_property
    @builds_expressions
    def _function(self) -> ca.Function:
        return getattr(self._problem.functions, self._name)

    @cached_property
    def _few(self) -> tuple[BatchFunction, np.ndarray]:
        """The function for few rows, and the inputs at which all but its first argument begin."""
        widths = [self._function.numel_in(k) for k in range(self._function.n_in())]
        return BatchFunction(self._function), np.cumsum(widths)[:-1]

    @cached_property
    def tape(self) -> Tape | None:
        """The instructions; None if one is not supported."""
        return Tape.of(self._function)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Return (outputs, rows) from (inputs, rows)."""
        if columns.shape[1] > FEW and self.tape is not None:
            return self.tape(list(columns))
        function, ends = self._few
        return np.concatenate([part.T for part in function(*(part.T for part in np.split(columns, ends)))])


@final
class NumpySolver:
    """Solver of one problem with NumPy."""

    def __init__(self, problem: InverseProblem) -> None:
        self.problem = problem
        self._routines = {name: _Routine(problem, name) for name in ROUTINES}
        self._turn, self._again, self._follow, self._repair, self._check = self._routines.values()

    @property
    def tapes(self) -> dict[str, Tape] | None:
        """The instructions of the routines that the problem needs, by name; None if one is not supported."""
        by_name = {name: self._routines[name].tape for name in self.problem.routines}
        known = {name: tape for name, tape in by_name.items() if tape is not None}
        return known if len(known) == len(by_name) else None

    def check(self, positions: np.ndarray, batch: Batch) -> np.ndarray:
        """Return the (n,) remaining distances of the point in mm at (n, axes) positions in mm and degrees."""
        x = self._columns(batch)
        x[: self.problem.axes] = (positions * self.problem.scale).T
        return np.sqrt(self._check(x)[2]) / self.problem.mm

    def solve(self, batch: Batch) -> BatchOutcome:
        """Solve all poses of a batch."""
        outcome = BatchOutcome.empty(len(batch), self.problem.axes)
        iterations = 0
        for start in range(0, len(batch), PORTION):
            part = slice(start, start + PORTION)
            solved = self._solve(batch.part(part))
            outcome.put(part, solved)
            iterations = max(iterations, solved.iterations)
        return replace(outcome, iterations=iterations)

    def _columns(self, batch: Batch) -> np.ndarray:
        """Return the (inputs, n) columns for a routine."""
        problem = self.problem
        x = np.empty((problem.inputs, len(batch)))
        x[: problem.axes] = (batch.start * problem.scale).T
        if batch.approach is not None:
            x[problem.axes : -6] = batch.approach.T
        x[-6:-3] = batch.point.T * problem.mm
        x[-3:] = batch.axis.T * (1.0 / np.sqrt(np.einsum("ni,ni->n", batch.axis, batch.axis)))
        return x

    def _solve(self, batch: Batch) -> BatchOutcome:
        problem, axes = self.problem, self.problem.axes
        with np.errstate(all="ignore"):
            x = self._columns(batch)
        good = np.isfinite(x[:axes]).all(axis=0) & np.isfinite(x[-6:]).all(axis=0)
        x[:, ~good] = 0.0
        start = x[:axes].copy()
        singular = np.zeros(len(batch), dtype=bool)
        iterations = 0
        loose = batch.loose & bool(problem.rotary)
        rows = np.flatnonzero(good & loose)
        if rows.size:
            solved, done, iterations = self._newton(x[:, rows], rotary=True)
            reached = done & self._admissible(solved, start[:, rows])
            x[:axes, rows[reached]] = solved[:axes, reached]
            stuck = rows[~reached]
            if stuck.size:
                singular[stuck] = True
                x[:axes, stuck] = self._repair(x[:, stuck])
        rows = np.flatnonzero(good & (~loose | singular))
        if rows.size:
            solved, _, steps = self._newton(x[:, rows], rotary=False)
            iterations = max(iterations, steps)
            x[:axes, rows] = solved[:axes]
        return self._judged(x, good, singular, iterations)

    def _newton(self, x: np.ndarray, *, rotary: bool) -> tuple[np.ndarray, np.ndarray, int]:
        """Return the columns after Newton's method, whether each converged, and the number of steps."""
        problem, axes = self.problem, self.problem.axes
        x, step = x.copy(), self._turn if rotary else self._follow
        done = np.zeros(x.shape[1], dtype=bool)
        last = np.full(x.shape[1], np.inf)
        active, moving, matrices = np.arange(x.shape[1]), x, x[:0]
        for steps in range(problem.steps + 1):
            if steps >= 2:
                # Most poses have converged by now; the residual alone costs half as much as a step.
                found = self._check(moving)
                size = found[0 if rotary else 1]
                finished = self._finished(size, last[active])
                done[active[finished]] = True
                left = ~finished & np.isfinite(size)
                active, moving = active[left], moving[:, left]
                if not active.size:
                    return x, done, steps
                if steps == 2 and rotary:
                    # The remaining residuals are so small that the last matrices can be reused.
                    last[active] = size[left]
                    moved = moving[:axes] + self._again(np.concatenate([found[-5:, left], matrices[:, left]]))
                    far = np.flatnonzero(size[left] > problem.near)
                    if far.size:
                        moved[:, far] = step(moving[:, far])[:axes]
                    moving[:axes] = x[:axes, active] = moved
                    continue
            result = step(moving)
            size = result[axes]
            finished = self._finished(size, last[active])
            done[active[finished]] = True
            last[active] = size
            left = ~finished & np.isfinite(size)
            if steps == problem.steps or not np.any(left):
                break
            active, moving, matrices = active[left], moving[:, left], result[axes + 1 :, left]
            moving[:axes] = result[:axes, left]
            x[:axes, active] = moving[:axes]
        return x, done, steps

    def _finished(self, size: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return whether each pose converged: within a tenth of the tolerance, or within it and no longer improving."""
        tolerance = self.problem.tolerance
        return (size <= 0.1 * tolerance) | ((size <= tolerance) & (size >= last))

    def _admissible(self, x: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return whether the rotary axes stayed within the change and the range permitted for a correction."""
        problem, rotary = self.problem, list(self.problem.rotary)
        turned = x[rotary].T
        inside = (turned >= problem.limits[:, 0]) & (turned <= problem.limits[:, 1])
        near = np.abs(turned - start[rotary].T) <= problem.rotary_limit
        return np.asarray((inside & near).all(axis=1))

    def _judged(self, x: np.ndarray, good: np.ndarray, singular: np.ndarray, iterations: int) -> BatchOutcome:
        problem = self.problem
        positions = x[: problem.axes].T / problem.scale
        left = self._check(x)
        distance = np.sqrt(left[2])
        beyond = ((positions < problem.bounds[:, 0]) | (positions > problem.bounds[:, 1])).any(axis=1)
        missed = ~(distance <= 2.0 * problem.tolerance)
        code = np.where(singular, SINGULAR, CONVERGED).astype(np.uint8)
        code[~good | beyond | missed] = OUT_OF_RANGE
        positions[~good] = np.nan
        distance = np.where(good, distance / problem.mm, np.inf)
        return BatchOutcome(positions, distance, np.where(good, angle(np.sqrt(left[3])), np.inf), code, iterations)


def angle(apart: np.ndarray) -> np.ndarray:
    """Return the angles in radians between unit vectors from the distances between their ends."""
    return np.asarray(2.0 * np.arcsin(np.clip(apart / 2.0, 0.0, 1.0)))


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
        outcome = BatchOutcome.empty(len(batch), self.problem.axes)
        taken = compiler.map_row_chunks(len(batch), lambda part: self._run(batch, outcome, part))
        return replace(outcome, iterations=max(taken, default=0))

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
        results = {name: getattr(found, name)[part] for name in ("positions", "distance", "axis_angle_rad", "code")}
        given = {name: getattr(batch, name) for name in ("start", "point", "axis", "approach", "loose")}
        given = {name: values[part] for name, values in given.items() if values is not None}
        compiler.point_to(job, self.numbers | results | given)
        for name, values in given.items():
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
        if not compiler.worth_compiling(len(batch)):
            return self._plain.solve(batch)
        if self._native is None:
            self._native = self._compiled()
        if self._native is None:
            return self._plain.solve(batch)
        outcome = self._native.solve(_aligned(batch))
        if not self._confirmed and not self._agrees(outcome, batch):
            compiler.disable(self._source, "its results are wrong")
            self._native = None
            return self._plain.solve(batch)
        return self._completed(outcome, batch)

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
                compiler.cpp_text("simd.hpp"),
                f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};",
                f"static const int ROTARY[] = {{{', '.join(map(str, problem.rotary or (0,)))}}};",
                *(routine(name, tapes[name]) if name in tapes else unused(name) for name in ROUTINES),
                compiler.cpp_text("solve.cpp"),
            ]
        )

    def _compiled(self) -> _Compiled | None:
        tapes = self._plain.tapes
        if tapes is None:
            return None
        library = compiler.library(self._source)
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
