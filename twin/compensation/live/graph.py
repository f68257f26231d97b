"""The correction of the axes' commands that a control computes in every cycle, as CasADi functions without branches.

The correction c takes the position n that a program means to the command n + c(n) at which the machine with its errors holds tip and
tool axis where the machine without errors holds them at n. It is an explicit function: a fixed number of Newton steps with the
derivatives of the machine without errors, whose error is the errors' slope per step (a thousandth), so that its time is constant.

Near a singular position the rotary axes would need a turn δ/σ that grows without limit (δ the tilt error, σ the smaller singular value
of the derivative of the tool axis by the rotary axes). There the turn is damped: δσ/(σ² + λ²) with λ² = λ₀²(1 − (σ/ε)²)² below σ = ε, and
λ = 0 above, where the correction is exact (Nakamura, Hanafusa: Inverse kinematic solutions with singularity robustness for robot
manipulator control, J. Dyn. Sys. Meas. Control 108 (1986) 163-171; Chiaverini, Siciliano, Egeland 1994). Its slope is at most about
δ/λ₀², and λ₀ and ε follow from the largest δ so that n → n + c(n) stays invertible: the forward kinematics exists everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.errors import InputError
from twin.machine.chain import branches
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import APPROACH
from twin.model.unknown_errors import ErrorTerms

STEPS: Final = 3
"""Newton steps: the first leaves about a thousandth of the errors, the second a millionth; one more for turns near a singular position."""
STEEPEST: Final = 0.25
"""Largest slope of the damped turn by a position, rad/rad: n → n + c(n) stays invertible, and the forward kinematics converges."""


@final
@dataclass(frozen=True)
class Damping:
    """Damping of the rotary axes near singular positions; both zero without rotary axes.

    Attributes:
        factor: λ₀.
        region: ε, the singular value from which the orientation is corrected in full.
    """

    factor: float
    region: float

    @classmethod
    def for_tilt(cls, largest_rad: float) -> Damping:
        """Return the damping for errors that tilt the tool by at most ``largest_rad``."""
        factor = float(np.sqrt(largest_rad / STEEPEST))
        return cls(factor, 2.0 * factor)


@final
class LiveCorrection:
    """Functions of one machine with one calibration.

    All positions are metres and radians, axes in command order.

    Args:
        machine: a machine with three linear axes and at most two rotary ones.
        calibration: its errors.
        channels: names of the channels besides the directions of approach, in the order of the input.
        damping: damping near singular positions.

    Raises:
        InputError: a chain that it does not carry.
    """

    def __init__(self, machine: Machine, calibration: Calibration, channels: Sequence[str], damping: Damping) -> None:
        if len(machine.linear) != 3 or len(machine.rotary) > 2:
            raise InputError(
                f"{machine.name}: {len(machine.linear)} linear and {len(machine.rotary)} rotary axes",
                expected="three linear axes and at most two rotary ones",
                file=machine.path,
            )
        self.machine, self.calibration, self.damping = machine, calibration, damping
        self.channels = tuple(channels)
        self._terms = ErrorTerms(
            machine, calibration.effects, {}, [*(f"{APPROACH}{axis.name}" for axis in machine.axes), *self.channels]
        )
        self._errors = self._terms.vector({effect.name for effect in calibration.effects})

    @cached_property
    def domains(self) -> np.ndarray:
        """(axes, 2) range of positions at which the errors are evaluated, metres and radians; beyond it they keep their values."""
        bounds = np.array(self.calibration.domains())
        for i, axis in enumerate(self.machine.axes):
            if axis.lower is None:
                bounds[i] = -np.inf, np.inf
        return bounds * self.machine.scale[:, None]

    @cached_property
    def correction(self) -> ca.Function:
        """(n (axes,), channels (axes + channels,), tool (3,), orientation) → c (axes,).

        ``tool``: offset of the tip from the spindle nose, metres: x, y and the length. ``orientation``: share of the rotary axes' turn, 0 to 1.
        """
        axes = len(self.machine.axes)
        n, channels = ca.SX.sym("n", axes), ca.SX.sym("channels", axes + len(self.channels))
        tool, orientation = ca.SX.sym("tool", 3), ca.SX.sym("orientation")
        rotary, linear = list(self.machine.rotary), list(self.machine.linear)
        goal, target = self._tip_and_axis(n, None, tool)
        across = _perpendicular(self.machine, target, n)
        tilt_by = ca.jacobian(across.T @ target, n)[:, rotary] if rotary else None
        # The two directions are held while the axis turns.
        if rotary:
            held = ca.SX.sym("held", 3, 2)
            tilt_by = ca.substitute(ca.jacobian(held.T @ target, n)[:, rotary], held, across)
        inverse = ca.inv(ca.jacobian(goal, n)[:, linear])
        c = ca.SX.zeros(axes)
        for _ in range(STEPS):
            tip, pointing = self._tip_and_axis(n + c, self._errors_at(n + c, channels), tool)
            move = ca.SX.zeros(axes)
            if rotary:
                turn = _damped(tilt_by, tilt_by @ c[rotary] / _safe(orientation) - across.T @ pointing, self.damping)
                move[rotary] = orientation * turn - c[rotary]
            by_turn = ca.jacobian(goal, n)[:, rotary] @ move[rotary] if rotary else ca.SX.zeros(3)
            move[linear] = -inverse @ (tip - goal + by_turn)
            c = c + move
        c = ca.cse(ca.densify(c))
        return ca.Function(
            "twin_correction", [n, channels, tool, orientation], [c], ["n", "channels", "tool", "orientation"], ["c"]
        )

    @cached_property
    def to_workpiece(self) -> ca.Function:
        """(n (axes,), tool (3,)) → p (3,): the tip, in the directions of the linear axes, equal to them with all rotary axes at zero."""
        n, tool = ca.SX.sym("n", len(self.machine.axes)), ca.SX.sym("tool", 3)
        tip, _ = self._tip_and_axis(n, None, tool)
        return ca.Function("twin_to_workpiece", [n, tool], [ca.cse(self._linear_of(tip))], ["n", "tool"], ["p"])

    @cached_property
    def to_axes(self) -> ca.Function:
        """(p and rotary positions (axes,), tool (3,)) → positions (3,) of the linear axes; inverse of `to_workpiece`."""
        n, tool = ca.SX.sym("n", len(self.machine.axes)), ca.SX.sym("tool", 3)
        linear = list(self.machine.linear)
        at_rest = ca.SX(n)
        at_rest[linear] = 0.0
        tip = self._linear_of(self._tip_and_axis(at_rest, None, tool)[0])
        by = ca.substitute(ca.jacobian(self._linear_of(self._tip_and_axis(n, None, tool)[0]), n)[:, linear], n, at_rest)
        return ca.Function("twin_to_axes", [n, tool], [ca.cse(ca.inv(by) @ (n[linear] - tip))], ["n", "tool"], ["l"])

    def _linear_of(self, tip: Any) -> Any:
        """Return a point of the work frame as positions of the linear axes with all rotary axes at zero, for a tool of no length."""
        n = ca.SX.sym("n", len(self.machine.axes))
        start, _ = self._tip_and_axis(n, None, ca.SX.zeros(3))
        by = ca.jacobian(start, n)[:, list(self.machine.linear)]
        rest = ca.Function("rest", [n], [start, by])(np.zeros(len(self.machine.axes)))
        return ca.DM(np.linalg.inv(np.array(rest[1]))) @ (tip - rest[0])

    def _errors_at(self, q: Any, channels: Any) -> Any:
        inside = [
            ca.fmin(ca.fmax(q[i], low), high) if np.isfinite(low) else q[i] for i, (low, high) in enumerate(self.domains)
        ]
        return ca.substitute(self._errors, ca.vertcat(self._terms.q, self._terms.channels), ca.vertcat(*inside, channels))

    def _tip_and_axis(self, q: Any, errors: Any, tool: Any) -> tuple[Any, Any]:
        """Return tip and tool axis in the work frame; ``errors`` None: nominal."""
        tool_side, work_side = branches(self.machine, q, errors)
        tip = ca.vertcat(-tool[0], -tool[1], -tool[2])
        return work_side.into(*tool_side.carried(tip, ca.vertcat(0.0, 0.0, 1.0)))


def _safe(orientation: Any) -> Any:
    return ca.if_else(orientation > 0.0, orientation, 1.0)


def _perpendicular(machine: Machine, target: Any, n: Any) -> Any:
    """Return two directions (3, 2) perpendicular to the nominal tool axis: the tool frame's x and y."""
    tool_side, work_side = branches(machine, n, None)
    columns = []
    for direction in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        _, along = work_side.into(*tool_side.carried(ca.SX.zeros(3), ca.vertcat(*direction)))
        columns.append(along)
    return ca.horzcat(*columns)


def _damped(a: Any, b: Any, damping: Damping) -> Any:
    """Return the damped solution of A x = b for A (2, 1) or (2, 2): Aᵀ(A Aᵀ + λ²)⁻¹ b."""
    squares = ca.sumsqr(a)
    if a.shape[1] == 1:
        return a.T @ b / (squares + _lambda(squares, damping))
    determinant = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    # The smaller singular value's square.
    smaller = 0.5 * (squares - ca.sqrt(ca.fmax(squares * squares - 4.0 * determinant * determinant, 0.0)))
    lam = _lambda(smaller, damping)
    m = a @ a.T + lam * ca.SX.eye(2)
    det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    adj = ca.vertcat(ca.horzcat(m[1, 1], -m[0, 1]), ca.horzcat(-m[1, 0], m[0, 0]))
    return a.T @ (adj @ b) / det


def _lambda(smaller: Any, damping: Damping) -> Any:
    """Return λ² at the square of the smaller singular value."""
    share = ca.fmax(1.0 - smaller / damping.region**2, 0.0)
    return damping.factor**2 * share * share
