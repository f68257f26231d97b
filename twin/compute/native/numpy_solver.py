"""The solver without a compiler: NumPy on blocks of poses, CasADi on a few poses.

Newton's method runs on all poses at once. The rotary axes are used if they reach the orientation within their permitted range;
otherwise they go to the best position and the linear axes solve for the point.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Final, final

import casadi as ca
import numpy as np

from twin.compute.native.problem import CONVERGED, OUT_OF_RANGE, ROUTINES, SINGULAR, Batch, BatchOutcome, InverseProblem
from twin.compute.native.tape import Tape

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
    def _function(self) -> ca.Function:
        return getattr(self._problem.functions, self._name)

    @cached_property
    def tape(self) -> Tape | None:
        """The instructions; None if one is not supported."""
        return Tape.of(self._function)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Return (outputs, rows) from (inputs, rows)."""
        if columns.shape[1] > FEW and self.tape is not None:
            return self.tape(list(columns))
        ends = np.cumsum([self._function.numel_in(k) for k in range(self._function.n_in())])
        found = self._function.call([ca.DM(part) for part in np.split(columns, ends[:-1])])
        return np.concatenate([np.asarray(part) for part in found])


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
        found = {name: self._routines[name].tape for name in self.problem.routines}
        known = {name: tape for name, tape in found.items() if tape is not None}
        return known if len(known) == len(found) else None

    def check(self, positions: np.ndarray, batch: Batch) -> np.ndarray:
        """Return the (n,) remaining distances of the point in mm at (n, axes) positions in mm and degrees."""
        x = self._columns(batch)
        x[: self.problem.axes] = (positions * self.problem.scale).T
        return np.sqrt(self._check(x)[2]) / self.problem.mm

    def solve(self, batch: Batch) -> BatchOutcome:
        """Solve all poses of a batch."""
        found = BatchOutcome.empty(len(batch), self.problem.axes)
        iterations = 0
        for start in range(0, len(batch), PORTION):
            part = slice(start, start + PORTION)
            solved = self._solve(batch.part(part))
            found.put(part, solved)
            iterations = max(iterations, solved.iterations)
        return replace(found, iterations=iterations)

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
