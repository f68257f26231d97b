"""The commands that reach a pose on the machine with errors.

The residual is the point (3) and the tool axis across the target axis (2): the spindle turns freely about it. Newton's
method on all poses at once; the linear axes are eliminated first (their 3×3 block is never singular), what is left is the
2×2 system of the rotary axes, whose smaller singular value says how near a pose is to singular.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin.arrays import locked
from twin.batch import BatchFunction
from twin.errors import InputError
from twin.kinematics import Kinematics, Poses, angle_between_rad
from twin.units import DEG, MM

POINT_TOLERANCE: Final = 1e-12
"""Metres (1e-9 mm), and radians for the tool axis."""
STEPS: Final = 12
"""Newton steps allowed; from a nominal start two or three are taken."""
LARGEST_STEP: Final = 0.1
"""Radians a rotary axis may move in one step: a longer one has left the branch."""
DEFAULT_ROTARY_LIMIT_DEG: Final = 0.5
"""How far a rotary axis may move to repair an orientation, when nobody says otherwise."""


Fixed = tuple[np.ndarray, ...]
"""What the solver holds of every pose while it moves the axes: one array a kind, one row a pose."""


@final
class Status(Enum):
    """What became of a pose."""

    CONVERGED = "converged"
    OUT_OF_RANGE = "out of range"
    SINGULAR = "singular"


@final
@dataclass(frozen=True)
class Solution:
    """Commands for a batch of poses.

    Attributes:
        positions: (n, axes) commands, mm and degrees; for ``out of range`` the solution beyond the limits.
        status: (n,) `Status` objects: ``singular`` means the point is reached and the orientation is not, within what the
            rotary axes may move; ``out of range`` that a command leaves an axis's range or a curve's domain, or that nothing
            was found.
        point_residual_mm: (n,) distance left at the point.
        orientation_residual_rad: (n,) angle left between tool axis and target.
        iterations: most Newton steps taken by any pose.
    """

    positions: np.ndarray
    status: np.ndarray
    point_residual_mm: np.ndarray
    orientation_residual_rad: np.ndarray
    iterations: int

    def where(self, status: Status) -> np.ndarray:
        """(n,) whether each pose has that status."""
        return np.array([found is status for found in self.status], dtype=bool)


@final
class Inverse:
    """Inverse kinematics of one machine with one calibration.

    Args:
        kinematics: the machine, its errors and tool length.
        rotary_limit_deg: how far a rotary axis may leave its start to repair an orientation.

    Raises:
        InputError: the machine has not three linear axes and at most two rotary ones.
    """

    def __init__(self, kinematics: Kinematics, *, rotary_limit_deg: float = DEFAULT_ROTARY_LIMIT_DEG) -> None:
        machine = kinematics.machine
        if len(machine.linear) != 3 or len(machine.rotary) > 2:
            raise InputError(
                f"{machine.name} has {len(machine.linear)} linear and {len(machine.rotary)} rotary axes",
                expected="three linear axes and at most two rotary ones, to run programs",
                file=machine.path,
            )
        self.kinematics = kinematics
        self.rotary_limit_deg = rotary_limit_deg
        self._linear = list(machine.linear)
        self._rotary = list(machine.rotary)

    @cached_property
    def _system(self) -> BatchFunction:
        """(q, point, across) → residual (5) and its Jacobian (5, axes); with the approach last where the machine is directed."""
        at = self.kinematics.symbols()
        q = at[0]
        target = ca.SX.sym("target", 3)
        across = ca.SX.sym("across", 3, 2)
        rotation, point = self.kinematics.pose_at(*at)
        residual = ca.vertcat(point - target, across.T @ rotation[:, 2])
        return BatchFunction(ca.Function("system", [q, target, across, *at[1:]], [residual, ca.jacobian(residual, q)]))

    def solve(self, targets: Poses, start: Any, *, rotary: bool | np.ndarray = True, approach: Any = None) -> Solution:
        """Commands that put the tool tip at each target, with its axis along the target's.

        Args:
            targets: poses in the work frame.
            start: (n, axes) commands near the solution, mm and degrees; the branch (B, C and its alternative) is the start's.
            rotary: whether the rotary axes may move (all poses, or (n,) each). Where not, they keep the start's positions
                and only the point is solved for.
            approach: (n, axes) sides the axes come from, where the machine is directed (`Kinematics.directed`).

        Raises:
            InputError: shapes that do not fit. Never for a pose that cannot be solved: it gets its status.
        """
        machine = self.kinematics.machine
        n = len(targets)
        begin = np.atleast_2d(np.asarray(start, dtype=float))
        if begin.shape != (n, len(machine.axes)):
            raise InputError("start of the wrong shape", expected=f"({n}, {len(machine.axes)})", value=begin.shape)
        free = np.broadcast_to(np.asarray(rotary, dtype=bool), (n,)) & bool(self._rotary)
        q0 = begin * machine.scale
        point = np.asarray(targets.point_mm) * MM
        across = _across(targets.axis)
        good = np.isfinite(q0).all(axis=1) & np.isfinite(point).all(axis=1) & np.isfinite(across).all(axis=1)
        q = np.where(good[:, None], q0, 0.0)
        fixed = (point, across, *self.kinematics.rows(q, approach)[1:])
        iterations = 0
        singular = np.zeros(n, dtype=bool)
        rows = np.flatnonzero(good & free)
        if rows.size:
            solved, orient, steps = self._newton(q[rows], _of(fixed, rows), rotary=True)
            iterations = max(iterations, steps)
            reached = self._admissible(solved, q0[rows]) & orient
            q[rows[reached]] = solved[reached]
            stuck = rows[~reached]
            if stuck.size:
                singular[stuck] = True
                q[stuck] = self._repaired_in_part(q[stuck], _of(fixed, stuck))
        rows = np.flatnonzero(good & (~free | singular))
        if rows.size:
            solved, _, steps = self._newton(q[rows], _of(fixed, rows), rotary=False)
            iterations = max(iterations, steps)
            q[rows] = solved
        return self._judged(q, fixed, targets.axis, good, singular, iterations)

    def _newton(self, q: np.ndarray, fixed: Fixed, *, rotary: bool) -> tuple[np.ndarray, np.ndarray, int]:
        """Newton's method; returns positions, whether each converged, and the steps taken.

        ``fixed``, here and below: point, across and, on a directed machine, approach of every pose.
        """
        q = q.copy()
        done = np.zeros(len(q), dtype=bool)
        active = np.arange(len(q))
        steps = 0
        last = np.full(len(q), np.inf)
        for steps in range(STEPS + 1):
            residual, by_position = self._evaluate(q[active], _of(fixed, active))
            size = np.abs(residual if rotary else residual[:, :3]).max(axis=1)
            # Converged: within a tenth of the promise, or no longer improving while within it.
            finished = (size <= 0.1 * POINT_TOLERANCE) | ((size <= POINT_TOLERANCE) & (size >= last[active]))
            done[active[finished]] = True
            last[active] = size
            keep = ~finished & np.isfinite(size)
            if steps == STEPS or not np.any(keep):
                break
            active, residual, by_position = active[keep], residual[keep], by_position[keep]
            linear, turn = self._step(residual, by_position, rotary=rotary)
            q[np.ix_(active, self._linear)] += linear
            if rotary:
                q[np.ix_(active, self._rotary)] += turn
        return q, done, steps

    def _evaluate(self, q: np.ndarray, fixed: Fixed) -> tuple[np.ndarray, np.ndarray]:
        residual, jacobian = self._system(q, *fixed)
        return residual, jacobian.reshape(len(q), -1, 5).transpose(0, 2, 1)

    def _step(self, residual: np.ndarray, by_position: np.ndarray, *, rotary: bool) -> tuple[np.ndarray, np.ndarray]:
        base = by_position[:, :3, self._linear]
        if not rotary:
            return -np.linalg.solve(base, residual[:, :3, None])[:, :, 0], np.zeros((len(residual), 0))
        reduced, left = self._reduced(residual, by_position)
        turn = -(np.linalg.pinv(reduced) @ left[:, :, None])[:, :, 0]
        turn *= np.minimum(1.0, LARGEST_STEP / np.maximum(np.abs(turn).max(axis=1), 1e-300))[:, None]
        follow = residual[:, :3] + np.einsum("nij,nj->ni", by_position[:, :3, self._rotary], turn)
        return -np.linalg.solve(base, follow[:, :, None])[:, :, 0], turn

    def _reduced(self, residual: np.ndarray, by_position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tool axis's system in the rotary axes alone, the linear axes following the point."""
        base = by_position[:, :3, self._linear]
        right = np.concatenate([by_position[:, :3, self._rotary], residual[:, :3, None]], axis=2)
        solved = np.linalg.solve(base, right)
        coupling = by_position[:, 3:, self._linear]
        reduced = by_position[:, 3:, self._rotary] - coupling @ solved[:, :, :-1]
        left = residual[:, 3:] - np.einsum("nij,nj->ni", coupling, solved[:, :, -1])
        return reduced, left

    def _repaired_in_part(self, q0: np.ndarray, fixed: Fixed) -> np.ndarray:
        """Rotary axes moved as far as makes sense where the whole orientation cannot be had.

        Along each singular direction the repair needs t = δ/σ. Up to the limit β it gets it; beyond, β·(β/t)³: continuous at
        the limit, and soon gone towards the singularity, where turning C repairs nothing: C stays continuous through it, and
        a program that stands at B = 0 does not have its C moved for nothing.
        """
        residual, by_position = self._evaluate(q0, fixed)
        reduced, left = self._reduced(residual, by_position)
        u, sigma, vt = np.linalg.svd(reduced, full_matrices=False)
        delta = -np.einsum("nji,nj->ni", u, left)
        limit = self.rotary_limit_deg * DEG
        within = np.abs(delta) <= limit * sigma
        needed = np.divide(delta, sigma, out=np.zeros_like(delta), where=within & (sigma > 0.0))
        reach = np.divide(limit * sigma, delta, out=np.zeros_like(delta), where=~within)  # β/t, signed
        damped = limit * reach**3
        move = np.einsum("nji,nj->ni", vt, np.where(within, needed, damped))
        q = q0.copy()
        lower, upper = self.kinematics.machine.limits[self._rotary].T
        turned = q[:, self._rotary] + move
        # A start beyond its range stays where it is (and is reported); others stop at the limit.
        q[:, self._rotary] = np.clip(
            turned, np.minimum(lower, q[:, self._rotary]), np.maximum(upper, q[:, self._rotary])
        )
        return q

    def _admissible(self, q: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Whether the rotary axes stayed within what a repair may move them, and in range."""
        limits = self.kinematics.machine.limits[self._rotary]
        turned = q[:, self._rotary]
        inside = (turned >= limits[:, 0]) & (turned <= limits[:, 1])
        near = np.abs(turned - start[:, self._rotary]) <= self.rotary_limit_deg * DEG
        return np.asarray((inside & near).all(axis=1))

    def _judged(
        self,
        q: np.ndarray,
        fixed: Fixed,
        axis: np.ndarray,
        good: np.ndarray,
        singular: np.ndarray,
        iterations: int,
    ) -> Solution:
        machine = self.kinematics.machine
        rotation, reached = self.kinematics.reached(q, *fixed[2:])
        distance = np.linalg.norm(reached - fixed[0], axis=1)
        left = angle_between_rad(rotation[:, 6:9], axis)
        positions = q / machine.scale
        slack = 1e-9
        lower, upper = (machine.limits / machine.scale[:, None]).T
        beyond = ((positions < lower - slack) | (positions > upper + slack)).any(axis=1)
        beyond |= self.kinematics.outside_domain(positions).any(axis=1)
        missed = ~good | ~(distance <= 2.0 * POINT_TOLERANCE)
        status = np.full(len(q), Status.CONVERGED, dtype=object)
        status[singular] = Status.SINGULAR
        status[beyond | missed] = Status.OUT_OF_RANGE
        positions[~good] = np.nan
        distance = np.where(good, distance, np.inf)
        left = np.where(good, left, np.inf)
        return Solution(locked(positions), locked(status), locked(distance / MM), locked(left), iterations)


def _of(fixed: Fixed, rows: np.ndarray) -> Fixed:
    return tuple(part[rows] for part in fixed)


def _across(axis: np.ndarray) -> np.ndarray:
    """(n, 6) two unit vectors across each axis, one after the other."""
    axis = np.asarray(axis, dtype=float)
    helper = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    first = np.cross(axis, helper)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return np.concatenate([first, np.cross(axis, first)], axis=1)
