"""One step of the inverse kinematics as expressions: Newton for all axes, for the linear axes alone, and the limited rotary correction.

The expressions have no branches and hold for any chain; the same ones are evaluated by CasADi, by NumPy and as C++
(`twin.compute.native`).

The derivatives are the chain's twists (Lynch, Park: Modern Robotics, 5.1), errors following the axes: less than half of the work of
differentiating the whole expression. Of the Jacobian of Exp, I + [e]/2 + [e]²/6 + …, a step takes the first term only. This causes an
error of an angular error times a slope: a millionth for a milliradian and a milliradian per radian, far below the error of Newton's
method itself. The limited rotary correction (``repair``), which is not iterated, takes two terms. The residual is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, final

import casadi as ca

from twin.kinematics.forward import Kinematics
from twin.machine.chain import Branch, branches
from twin.machine.machine import Machine

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

    They implement `twin.compute.native.StepFunctions`.

    Args:
        kinematics: the machine.
        rotary_limit: largest move (radians) of a rotary axis from its start to correct an orientation.
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
        matrices = _matrices(machine, residual)
        return self._function(
            "turn",
            [
                self._at[0] + _newton_move(machine, matrices, residual, longest=True),
                size,
                ca.vertcat(*map(ca.vec, matrices)),
            ],
        )

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
        (tip, pointing), (goal, target) = (
            branch.carried(*start)
            for branch, start in zip(
                self._branches, (self._kinematics.tip_and_axis, (self._point, self._axis)), strict=True
            )
        )
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
    found = ca.fabs(vector[0])
    for i in range(1, vector.numel()):
        found = ca.fmax(found, ca.fabs(vector[i]))
    return found


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


def _matrices(machine: Machine, residual: _Residual) -> _Matrices:
    inverse, slope, coupling, system = _reduced(machine, residual)
    return _Matrices(inverse, slope, coupling, _pseudo_inverse(system))


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
