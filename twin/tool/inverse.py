"""Inverse kinematics: the commands that reach a pose on the machine with errors, by Newton's method on all poses at once.

The residual is the point (3) and the two components of the tool axis perpendicular to the target axis, because the spindle may turn
freely about it. The linear axes are eliminated first (their 3×3 block is never singular). The remaining 2×2 system in the rotary axes
shows by its smaller singular value how close a pose is to singular. The expressions have no branches and hold for any chain; the same
ones are evaluated by CasADi, by NumPy and as C++ (`twin.compute.native`).

The derivatives are the chain's twists (Lynch, Park: Modern Robotics, 5.1), errors following the axes: less than half of the work of
differentiating the whole expression. Of the Jacobian of Exp, I + [e]/2 + [e]²/6 + …, a step takes the first term only. This causes an
error of an angular error times a slope: a millionth for a milliradian and a milliradian per radian, far below the error of Newton's
method itself. The limited rotary correction (``repair``), which is not iterated, takes two terms. The residual is exact.

All rotary solutions for a tool axis ``Rot(n₁, θ₁)·Rot(n₂, θ₂)·a₀`` in the work frame, axis 1 nearer the workpiece, are those of the
second Paden-Kahan subproblem (Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 3.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, Final, NamedTuple, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.bundled import DEFAULT_ROTARY_LIMIT_DEG
from twin._common.errors import InputError
from twin._common.units import DEG, MM, count_with_noun
from twin.compute.native.solver import CONVERGED, OUT_OF_RANGE, SINGULAR, Batch, InverseProblem, Solver
from twin.display.results import Result
from twin.machine.chain import Branch, branches
from twin.machine.machine import Machine
from twin.tool.forward import Kinematics, Poses

LARGEST_STEP: Final = 0.1
"""Largest move (radians) of a rotary axis in one step; a longer one would leave the branch."""
RANK_ONE_RATIO: Final = 1e-15
"""Ratio of singular values below which a system of two counts as having rank one (as in NumPy's pinv)."""


@dataclass(frozen=True)
class _Residual:
    point: Any
    axis: Any
    """(2,) components of the tool axis along two directions perpendicular to the target."""
    point_by: Any
    """(3, axes) derivative of the point."""
    axis_by: Any
    """(2, axes) derivative of the axis components."""


@final
class Steps:
    """Functions of the inverse kinematics of one machine with one calibration, metres and radians.

    They implement `twin.compute.native.solver.StepFunctions`. No rotary axis moves further than ``rotary_limit`` (radians) from its
    start to correct an orientation.
    """

    def __init__(self, kinematics: Kinematics, rotary_limit: float) -> None:
        self._kinematics = kinematics
        self._limit = rotary_limit
        self._at = kinematics.symbols()
        self._point, self._axis = ca.SX.sym("point", 3), ca.SX.sym("axis", 3)

    @cached_property
    def turn(self) -> ca.Function:
        """One Newton step of all axes, and its matrices."""
        residual, machine = self._step_residual, self._kinematics.machine
        size = _largest(ca.vertcat(residual.point, residual.axis))
        if not machine.rotary:
            return self._function("turn", [self._linear_step, size])
        linear, slope, coupling, system = _reduced(machine, residual)
        matrices = _Matrices(linear, slope, coupling, _pseudo_inverse(system))
        moved = self._at[0] + _newton_move(machine, matrices, residual, longest=True)
        return self._function("turn", [moved, size, ca.vertcat(*map(ca.vec, matrices))])

    @cached_property
    def again(self) -> ca.Function:
        """Further step with the same matrices."""
        machine = self._kinematics.machine
        point, axis, rotary = ca.SX.sym("point", 3), ca.SX.sym("axis", 2), len(machine.rotary)
        if not rotary:
            return ca.Function("again", [point, axis], [ca.SX.zeros(len(machine.axes))])
        shapes = ((3, 3), (3, rotary), (2, 3), (rotary, 2))
        parts = [ca.SX.sym("matrix", *shape) for shape in shapes]
        residual = _Residual(point, axis, None, None)
        move = _newton_move(machine, _Matrices(*parts), residual, longest=False)
        return ca.Function("again", [point, axis, ca.vertcat(*map(ca.vec, parts))], [ca.densify(move)])

    @cached_property
    def follow(self) -> ca.Function:
        """One step of the linear axes."""
        return self._function("follow", [self._linear_step, _largest(self._step_residual.point)])

    @cached_property
    def repair(self) -> ca.Function:
        """Limited correction of the orientation by the rotary axes."""
        machine, q = self._kinematics.machine, self._at[0]
        if not machine.rotary:
            return self._function("repair", [q])
        return self._function("repair", [_limited_correction(machine, q, self._residual(terms=2), self._limit)])

    @cached_property
    def check(self) -> ca.Function:
        """Residuals: tip less goal, tool axis less target, and components of the tool axis perpendicular to the target.

        Only two vectors per side are carried along the chain; the derivatives need every frame.
        """
        tool, work = self._branches
        tip, pointing = tool.carried(*self._kinematics.tip_and_axis)
        goal, target = work.carried(self._point, self._axis)
        gap, axis_gap, off = tip - goal, pointing - target, ca.horzcat(*_perpendicular(target)).T @ pointing
        return self._function(
            "check", [_largest(ca.vertcat(gap, off)), _largest(gap), ca.sumsqr(gap), ca.sumsqr(axis_gap), gap, off]
        )

    @cached_property
    def _errors(self) -> Any:
        return ca.densify(self._kinematics.errors(*self._at))

    @cached_property
    def _branches(self) -> tuple[Branch, Branch]:
        return branches(self._kinematics.machine, self._at[0], self._errors)

    def _residual(self, terms: int) -> _Residual:
        """Residual of the tool from its target, both in the frame where the chains to tool and work branch."""
        by_position = ca.jacobian(self._errors, self._at[0])
        (tool, tool_twists), (work, work_twists) = (
            branch.twists(self._errors, by_position, terms) for branch in self._branches
        )
        tip = tool.rotation @ self._kinematics.tip_and_axis[0] + tool.translation
        goal = work.rotation @ self._point + work.translation
        pointing, target = tool.rotation[:, 2], work.rotation @ self._axis
        perpendicular = ca.horzcat(*_perpendicular(target))
        moved, turned = [], []
        # Rotation of the tool by every axis, and velocity of the tip, both relative to the work.
        for a, b in zip(tool_twists, work_twists, strict=True):
            turn = a[0] - b[0]
            moved.append(a[1] - b[1] + ca.cross(turn, tip))
            turned.append(perpendicular.T @ ca.cross(turn, pointing))
        return _Residual(tip - goal, perpendicular.T @ pointing, ca.horzcat(*moved), ca.horzcat(*turned))

    @cached_property
    def _step_residual(self) -> _Residual:
        return self._residual(terms=1)

    @property
    def _linear_step(self) -> Any:
        linear = list(self._kinematics.machine.linear)
        move = -(_inverse(self._step_residual.point_by[:, linear]) @ self._step_residual.point)
        return self._at[0] + _at_axes(self._kinematics.machine, linear, move)

    def _function(self, name: str, results: list[Any]) -> ca.Function:
        return ca.Function(name, [*self._at, self._point, self._axis], [ca.densify(result) for result in results])


def _perpendicular(z: Any) -> tuple[Any, Any]:
    """Return two unit vectors perpendicular to a unit vector, without a branch (Duff et al., J. Comput. Graph. Tech. 6 (2017) 1)."""
    sign = ca.if_else(z[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + z[2])
    b = z[0] * z[1] * a
    first = ca.vertcat(1.0 + sign * z[0] * z[0] * a, sign * b, -sign * z[0])
    return first, ca.vertcat(b, sign + z[1] * z[1] * a, -z[1])


def _largest(vector: Any) -> Any:
    largest = ca.fabs(vector[0])
    for i in range(1, vector.numel()):
        largest = ca.fmax(largest, ca.fabs(vector[i]))
    return largest


def _at_axes(machine: Machine, which: list[int], values: Any) -> Any:
    """Return an (axes,) vector with ``values`` at some axes and zero elsewhere."""
    found = ca.SX(len(machine.axes), 1)
    for k, i in enumerate(which):
        found[i] = values[k]
    return found


def _inverse(matrix: Any) -> Any:
    """Return the inverse of a 3×3 matrix by cofactors; its columns are the linear axes, nearly perpendicular."""
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    rows = ca.vertcat(ca.cross(b, c).T, ca.cross(c, a).T, ca.cross(a, b).T)
    return rows * (1.0 / ca.dot(a, rows[0, :].T))


class _Matrices(NamedTuple):
    """Matrices of a step: with the linear axes eliminated by the point, the tool axis gives a system in the rotary axes."""

    linear: Any
    """(3, 3) linear axes by the point."""
    slope: Any
    """(3, rotary) motion of the linear axes that follows the rotary ones."""
    coupling: Any
    """(2, 3) tool axis by the linear axes."""
    rotary: Any
    """(rotary, 2) rotary axes by the tool axis, with the linear axes following."""


def _reduced(machine: Machine, residual: _Residual) -> tuple[Any, Any, Any, Any]:
    """Return the first three of `_Matrices`, and the matrix whose inverse is the fourth."""
    linear, rotary = list(machine.linear), list(machine.rotary)
    inverse, coupling = _inverse(residual.point_by[:, linear]), residual.axis_by[:, linear]
    slope = inverse @ residual.point_by[:, rotary]
    return inverse, slope, coupling, residual.axis_by[:, rotary] - coupling @ slope


def _newton_move(machine: Machine, by: _Matrices, residual: _Residual, *, longest: bool) -> Any:
    """Return the move of one Newton step; with ``longest``, no rotary axis moves further than `LARGEST_STEP`."""
    alone = by.linear @ residual.point
    move = -(by.rotary @ (residual.axis - by.coupling @ alone))
    if longest:
        move = move * ca.fmin(1.0, LARGEST_STEP / ca.fmax(_largest(move), 1e-300))
    follow = -(alone + by.slope @ move)
    return _at_axes(machine, list(machine.rotary), move) + _at_axes(machine, list(machine.linear), follow)


def _limited_correction(machine: Machine, q: Any, residual: _Residual, limit: float) -> Any:
    """Return the commands with the rotary axes moved to correct the orientation, within the limit."""
    inverse, _, coupling, matrix = _reduced(machine, residual)
    right = residual.axis - coupling @ (inverse @ residual.point)
    rotary = list(machine.rotary)
    lower, upper = machine.limits[rotary].T
    reach = q[rotary] + _bounded_move(matrix, right, limit)
    # An axis that starts beyond its range keeps its position (and is reported); others stop at the limit.
    reach = ca.fmin(ca.fmax(reach, ca.fmin(lower, q[rotary])), ca.fmax(upper, q[rotary]))
    return q + _at_axes(machine, rotary, reach - q[rotary])


def _pseudo_inverse(a: Any) -> Any:
    """Return A⁺ of a (2, 2) or (2, 1) matrix."""
    squares = ca.sumsqr(a)
    flat = ca.if_else(squares > 0.0, 1.0 / squares, 0.0)
    if a.shape[1] == 1:
        return a.T * flat
    determinant = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    adjugate = ca.vertcat(ca.horzcat(a[1, 1], -a[0, 1]), ca.horzcat(-a[1, 0], a[0, 0]))
    whole = ca.fabs(determinant) > RANK_ONE_RATIO * squares
    return ca.if_else(whole, adjugate, a.T) * ca.if_else(whole, 1.0 / determinant, flat)


def _bounded_move(a: Any, b: Any, limit: float) -> Any:
    """Return the move of the rotary axes where they cannot correct the whole orientation.

    Along each singular direction the full correction needs t = δ/σ. Up to the limit β it is made in full; beyond the limit the move is
    β·(β/t)³. This is continuous at the limit and decreases rapidly towards the singularity, where turning C has no effect on the
    orientation: C stays continuous through it, and a program at B = 0 gets no useless motion of C.
    """
    if a.shape[1] == 1:
        return _along(a, -b, ca.SX.ones(1, 1), limit)
    # One Jacobi rotation makes the columns orthogonal (Golub, Van Loan: Matrix Computations, 8.6.4): they are σ u, it is v.
    first, second = a[:, 0], a[:, 1]
    dot, gap = ca.dot(first, second), ca.dot(second, second) - ca.dot(first, first)
    length = ca.sqrt(gap * gap + 4.0 * dot * dot)
    sign = ca.if_else(gap < 0.0, -1.0, 1.0)
    below = ca.fabs(gap) + length
    tangent = ca.if_else(below > 0.0, sign * 2.0 * dot / ca.if_else(below > 0.0, below, 1.0), 0.0)
    cosine = 1.0 / ca.sqrt(1.0 + tangent * tangent)
    sine = tangent * cosine
    first_direction, second_direction = ca.vertcat(cosine, -sine), ca.vertcat(sine, cosine)
    return _along(a @ first_direction, -b, first_direction, limit) + _along(
        a @ second_direction, -b, second_direction, limit
    )


def _along(column: Any, right: Any, direction: Any, limit: float) -> Any:
    """Return the move along one singular direction; ``column`` is σ u."""
    squares = ca.sumsqr(column)
    sigma = ca.sqrt(squares)
    delta = ca.dot(column, right)  # σ δ
    within = ca.fabs(delta) <= limit * squares
    safe = ca.if_else(squares > 0.0, squares, 1.0)
    reach = ca.if_else(within, 0.0, limit * squares / ca.if_else(within, 1.0, delta))  # β/t, signed
    wanted = ca.if_else(within, delta / safe, limit * reach * reach * reach)
    return direction * ca.if_else(sigma > 0.0, wanted, 0.0)


# --- Rotary positions that point the tool along a given vector: all solutions, for any two rotary axes

SLACK_DEG: Final = 1e-6
"""Angle by which a solution may lie outside a limit: a vector with nine decimals may miss it by this much."""
FIRST_WINDOW: Final = 64
"""Vectors solved at once at first; more after each window that was confirmed as a whole."""
PARALLEL: Final = 1e-9
"""Sine below which the tool counts as parallel to a rotary axis, so that turning this axis does not change its direction."""


@final
class Branches:
    """Rotary solutions of one machine without errors."""

    def __init__(self, nominal: Kinematics) -> None:
        machine = nominal.machine
        if len(machine.rotary) != 2:
            raise InputError(
                "tool vectors need two rotary axes", expected="a machine with B and C, or the like", file=machine.path
            )
        self._limits = (machine.limits / machine.scale[:, None])[list(machine.rotary)]
        rest = np.zeros((2, len(machine.axes)))
        first, second = machine.rotary
        rest[1, first] = 90.0
        rest[:, list(machine.linear)] = [
            np.mean([machine.axes[i].lower, machine.axes[i].upper]) for i in machine.linear
        ]
        turns = nominal.sensitivities(np.where(np.isfinite(rest), rest, 0.0)).command[:, 3:, [first, second]]
        # The direction of the axis nearer the work is fixed in the work frame, independent of the other axis.
        work_first = bool(np.allclose(turns[0, :, 1], turns[1, :, 1], atol=1e-9))
        self._order = (1, 0) if work_first else (0, 1)
        self._n1, self._n2 = turns[0, :, self._order[0]], turns[0, :, self._order[1]]
        self._a0 = np.array(nominal.forward(rest[:1]).axis[0])
        if np.linalg.norm(np.cross(self._n1, self._n2)) < PARALLEL:
            raise InputError(
                "the rotary axes are parallel", expected="axes that can orient the tool", file=machine.path
            )

    @property
    def master(self) -> int:
        """Index of the rotary axis nearer the tool, whose sign distinguishes the two solutions."""
        return self._order[1]

    def all(self, axis: np.ndarray) -> np.ndarray:
        """Return all rotary solutions (n, 2, 2) of unit tool vectors (n, 3) in the work frame.

        Degrees: two solutions for the two rotary axes in command order, in (−180, 180]. NaN where there is no solution, and NaN for an
        axis that does not change the tool's direction (it may have any position).
        """
        n1, n2, u = self._n1, self._n2, self._a0
        gamma, normal = float(n1 @ n2), np.cross(n1, n2)
        square = 1.0 - gamma**2
        alpha, beta = float(u @ n2), axis @ n1
        x, y = (beta - gamma * alpha) / square, (alpha - gamma * beta) / square
        squared = (1.0 - x * x - y * y - 2.0 * gamma * x * y) / square
        # A vector on the boundary of the reachable set gives zero up to rounding.
        height = np.sqrt(np.where(squared > -1e-12, np.maximum(squared, 0.0), np.nan))
        # About each axis turn the parts normal to it: along the other axis less its part along this one, and along the normal of both.
        start = float(u @ n1) - gamma * alpha, float(u @ normal)
        end = axis @ n2 - gamma * beta, axis @ normal
        found = np.empty((2, 2, len(axis)))  # axis by axis: NumPy is slow along a short last axis
        for k, up in enumerate((height, -height)):
            found[k, self._order[1]] = _angle((x, up), start, square)
            found[k, self._order[0]] = _angle((y, up), end, square)
        found /= DEG
        return found.transpose(2, 0, 1)

    def nearest(self, solutions: np.ndarray, previous: np.ndarray) -> np.ndarray:
        """Return (n, 2) degrees: for each vector the solution nearest to the rotary positions (n, 2) before it, including whole turns.

        The solutions (n, 2, 2) are those of `all`; the result is within the axes' ranges, NaN where there is no solution.
        """
        before = np.ascontiguousarray(previous.T)
        best, least = np.full(before.shape, np.nan), np.full(len(previous), np.inf)
        for solution in (np.ascontiguousarray(solutions[:, k].T) for k in (0, 1)):
            found, travel, rows = self._turned(solution, before, 0.0)
            better = travel < least
            best[:, better], least[better] = found[:, better], travel[better]
            # Elsewhere no other turn is nearer.
            for shift in (-1.0, 1.0) if rows.size else ():
                found, travel, _ = self._turned(solution[:, rows], before[:, rows], shift)
                better = travel < least[rows]
                best[:, rows[better]], least[rows[better]] = found[:, better], travel[better]
        return best.T

    def _turned(
        self, solution: np.ndarray, before: np.ndarray, shift: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return solutions (2, n) at the nearest turn, or ``shift`` turns from it, and one turn back where that is out of range.

        Then (n,) the larger travel of the two axes, infinite for a position out of range or without solution, and the indices of those
        turned back.
        """
        free = np.isnan(solution)
        angles = np.where(free, before, solution) if free.any() else solution
        found = angles + 360.0 * (np.round((before - angles) / 360.0) + shift)
        found[free] = before[free]
        low, high = self._limits[:, :1], self._limits[:, 1:]
        lower, upper = low - SLACK_DEG, high + SLACK_DEG
        back = np.flatnonzero(((found < lower) | (found > upper)).any(axis=0))
        turned = found[:, back]
        turned += 360.0 * ((turned < lower) * 1.0 - (turned > upper) * 1.0)
        found[:, back] = turned
        found = np.clip(found, low, high)
        travel = np.maximum(*np.abs(found - before))
        travel[back[((turned < lower) | (turned > upper)).any(axis=0)]] = np.inf
        travel[free.all(axis=0)] = np.inf
        return found, travel, back

    def along(self, solutions: np.ndarray, before: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return the words (k, 2), k ≤ n, of the solution nearest to that of the vector before it, up to the first without a solution.

        Whole windows are solved at once with a guess of the positions before each vector: those of the branch of the window's first
        solution. What the solutions found this way confirm is kept; the next window begins behind. The solutions (n, 2, 2) are those of
        `all`, ``before`` (2,) the words before the first, and ``offset`` (2,) is added to words.
        """
        parts = [np.empty((0, 2))]
        at, window = 0, FIRST_WINDOW
        while at < len(solutions):
            part = solutions[at : at + window]
            words = self._guess(part, before + offset) - offset
            for _ in range(2):
                last = words
                words = self.nearest(part, np.concatenate([before[None], last[:-1]]) + offset) - offset
            wrong = np.flatnonzero((words != last).any(axis=1))
            count = int(wrong[0]) + 1 if wrong.size else len(part)
            window = max(window // 2, 1) if wrong.size else 2 * window
            if np.isnan(words[count - 1]).any():
                return np.concatenate([*parts, words[: count - 1]])
            parts.append(words[:count])
            before, at = words[count - 1], at + count
        return np.concatenate(parts)

    def _guess(self, solutions: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return (n, 2) degrees on one branch without jumps by whole turns: that nearest to the positions before the first."""
        first = self.nearest(solutions[:1], before[None])
        apart = np.abs((solutions[0] - first + 180.0) % 360.0 - 180.0)
        angles = solutions[:, int(np.argmin(np.nan_to_num(apart).max(axis=1)))]
        angles = np.concatenate([before[None], angles])
        known = np.where(np.isnan(angles), 0, np.arange(len(angles))[:, None])
        angles = np.take_along_axis(angles, np.maximum.accumulate(known, axis=0), axis=0)
        return np.asarray(angles[1:] - 360.0 * np.cumsum(np.round(np.diff(angles, axis=0) / 360.0), axis=0))


def _angle(of: tuple[np.ndarray, np.ndarray], products: tuple[Any, Any], square: float) -> np.ndarray:
    """Return (n,) the angles between two vectors normal to an axis, NaN where one has no length.

    They are given in two perpendicular vectors of squared length ``square``: one by its components, the other by scalar products.
    """
    (a, b), (c, d) = of, products
    length = np.minimum((a * a + b * b) * square, (c * c + d * d) / square)
    return np.where(length < PARALLEL**2, np.nan, np.arctan2(a * d - b * c, a * c + b * d))


POINT_TOLERANCE: Final = 1e-12
"""Convergence limit: metres (1e-9 mm), and radians for the tool axis."""
STEPS: Final = 12
"""Most Newton steps; from a nominal start two or three are needed."""
NEAR: Final = 1e-6
"""Residual below which a step may reuse the derivatives of the last one. Such a step reduces the residual to a millionth, less near a
singularity.
"""
SLACK: Final = 1e-9
"""Distance (mm, degrees) beyond a limit that is rounding."""


@final
class Status(Enum):
    """Result for one pose.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> kinematics = twin.Kinematics(machine, tool_length_mm=120)
        >>> command = np.array([[501.0, 225.0, -200.0, 30.0, 45.0]])  # X ends at 500 mm
        >>> nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=120)
        >>> twin.Inverse(kinematics).solve(nominal.forward(command), command).where(twin.Status.OUT_OF_RANGE)
        array([ True])
    """

    CONVERGED = "converged"
    OUT_OF_RANGE = "out of range"
    SINGULAR = "singular"


_CODE: Final = {Status.CONVERGED: CONVERGED, Status.OUT_OF_RANGE: OUT_OF_RANGE, Status.SINGULAR: SINGULAR}
_STATUS: Final = np.array(sorted(_CODE, key=lambda status: _CODE[status]), dtype=object)


@final
@dataclass(frozen=True, repr=False)
class Solution(Result):
    """Commands for a batch of poses."""

    positions: np.ndarray  # (n, axes) commands, mm and degrees; for ``out of range`` the solution beyond the limits
    code: np.ndarray  # (n,) status codes of `twin.compute.native.solver`
    point_residual_mm: np.ndarray  # (n,) residual distance of the point
    orientation_residual_rad: np.ndarray  # (n,) residual angle between tool axis and target
    iterations: int  # largest number of Newton steps over all poses

    @property
    def status(self) -> np.ndarray:
        """(n,) `Status` objects.

        ``singular``: the point is reached, but the orientation is not within the allowed motion of the rotary axes. ``out of range``: a
        command leaves an axis's range or a curve's domain, or no solution was found.
        """
        return read_only(_STATUS[self.code])

    def where(self, status: Status) -> np.ndarray:
        """Return (n,) whether each pose has that status."""
        return np.asarray(self.code == _CODE[status])

    @property
    def brief(self) -> str:
        """Number of poses by status, and the largest residual."""
        counts = {status: int(self.where(status).sum()) for status in Status}
        parts = [f"commands for {count_with_noun(len(self.code), 'pose')}"]
        parts += [f"{status.value} {count:,}" for status, count in counts.items() if count]
        if len(self.code):
            parts.append(f"largest residual {self.point_residual_mm.max() * 1e3:.1e} µm")
        return ", ".join(parts)


@final
class Inverse:
    """Inverse kinematics of one machine with one calibration.

    Args:
        kinematics: the machine, its errors and tool length.
        rotary_limit_deg: largest motion of a rotary axis from its start to correct an orientation.

    Raises:
        InputError: the machine does not have three linear and at most two rotary axes.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> real = twin.Kinematics(machine, tool_length_mm=120)
        >>> nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=120)
        >>> programmed = np.array([[250.0, 225.0, -200.0, 30.0, 45.0]])
        >>> solution = twin.Inverse(real).solve(nominal.forward(programmed), programmed)
        >>> solution.status[0].name
        'CONVERGED'
        >>> (1e3 * (solution.positions - programmed)).round(1)  # µm and millidegrees
        array([[-21.7,  -8.1,  64.6, -15.7,  37.7]])

    References:
        - R. M. Murray, Z. Li, S. S. Sastry: A Mathematical Introduction to Robotic Manipulation, CRC Press, 1994, 3.2.
        - K. M. Lynch, F. C. Park: Modern Robotics, Cambridge University Press, 2017, 5.1.
        - K. Sørby: Inverse kinematics of five-axis machines near singular configurations, Int. J. Mach. Tools Manuf. 47 (2007) 299-306.
    """

    def __init__(self, kinematics: Kinematics, *, rotary_limit_deg: float = DEFAULT_ROTARY_LIMIT_DEG) -> None:
        machine = kinematics.machine
        machine.check_programs()
        self.kinematics = kinematics
        self.rotary_limit_deg = rotary_limit_deg

    @cached_property
    def _solver(self) -> Solver:
        return Solver(self._problem(self.kinematics.machine.rotary))

    @cached_property
    def _point_solver(self) -> Solver:
        """Solver that moves linear axes only, which needs fewer functions."""
        return Solver(self._problem(()))

    @cached_property
    def _steps(self) -> Steps:
        return Steps(self.kinematics, self.rotary_limit_deg * DEG)

    def _problem(self, rotary: tuple[int, ...]) -> InverseProblem:
        machine, calibration = self.kinematics.machine, self.kinematics.calibration
        limits, domains = machine.limits / machine.scale[:, None], calibration.domains()
        lower = np.maximum(limits[:, 0], domains[:, 0]) - SLACK
        upper = np.minimum(limits[:, 1], domains[:, 1]) + SLACK
        return InverseProblem(
            functions=self._steps,
            axes=len(machine.axes),
            rotary=rotary,
            sides=sum(symbol.numel() for symbol in self.kinematics.symbols()[1:]),
            scale=machine.scale,
            bounds=np.column_stack([lower, upper]),
            limits=machine.limits[list(rotary)],
            rotary_limit=self.rotary_limit_deg * DEG,
            tolerance=POINT_TOLERANCE,
            steps=STEPS,
            near=NEAR,
            mm=MM,
        )

    def solve(self, targets: Poses, start: Any, *, rotary: bool | np.ndarray = True, approach: Any = None) -> Solution:
        """Return commands that put the tool tip at each target, with its axis along the target's.

        Args:
            targets: poses in the work frame.
            start: (n, axes) commands near the solution, mm and degrees; they determine the branch (B, C and its alternative).
            rotary: whether the rotary axes may move (for all poses, or (n,) for each). Otherwise they keep the start's positions and
                only the point is solved for.
            approach: (n, axes) approach directions, if the machine depends on them (`Kinematics.directed`).

        Raises:
            InputError: shapes that do not fit. A pose that cannot be solved does not raise: see its status.
        """
        machine = self.kinematics.machine
        n = len(targets)
        begin = np.atleast_2d(np.asarray(start, dtype=float))
        if begin.shape != (n, len(machine.axes)):
            raise InputError("start has the wrong shape", expected=f"({n}, {len(machine.axes)})", value=begin.shape)
        sides = self.kinematics.rows(begin, approach)[1:]
        solver = self._solver if np.any(rotary) else self._point_solver
        found = solver.solve(
            Batch(
                start=begin,
                point=np.asarray(targets.point_mm, dtype=float),
                axis=np.asarray(targets.axis, dtype=float),
                approach=sides[0] if sides else None,
                loose=np.broadcast_to(np.asarray(rotary, dtype=bool), (n,)),
            )
        )
        return Solution(
            read_only(found.positions),
            read_only(found.code),
            read_only(found.distance),
            read_only(found.axis_angle_rad),
            found.iterations,
        )
