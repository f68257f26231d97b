"""Where the tool really is: forward kinematics with errors, in batches, and its sensitivities.

Positions go in as (poses, axes) arrays in mm and degrees, axes in command order. The one recursion is the expression of
`twin.symbolic`; Pinocchio evaluates the same model for whoever wants it (`Machine.model`), and the tests hold the two together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from twin.arrays import locked
from twin.batch import BatchFunction
from twin.calibration import Calibration
from twin.errors import InputError
from twin.machine import Machine
from twin.symbolic import chain_function, error_vector
from twin.units import DEG, MM


@final
@dataclass(frozen=True)
class Poses:
    """Poses of the tool in the work frame.

    Attributes:
        point_mm: (n, 3) the functional point: the tool tip.
        rotation: (n, 3, 3) tool frame in the work frame; its third column is the tool axis, from tip to spindle.
    """

    point_mm: np.ndarray
    rotation: np.ndarray

    @property
    def axis(self) -> np.ndarray:
        """(n, 3) tool axis (i, j, k), from tip to spindle."""
        return self.rotation[:, :, 2]

    def __len__(self) -> int:
        return len(self.point_mm)


@final
@dataclass(frozen=True)
class Sensitivities:
    """First derivatives of the tool pose in the work frame, metres and radians a metre or radian.

    Attributes:
        command: (n, 6, axes) of point (3) and rotation (3, as a rotation vector in the work frame), errors following the axes.
        error: (n, 6, 6·frames) of the same with respect to every component of every error frame.
    """

    command: np.ndarray
    error: np.ndarray


@final
class Kinematics:
    """A machine with a calibration: what its commands really reach.

    Args:
        machine: the machine.
        calibration: its errors; the machine file's own if None. `Calibration.zero` gives the machine as drawn.
        tool_length_mm: the machine file's own if None.

    Attributes:
        machine, calibration, tool_length_mm: as given.
        chain: CasADi function (q, e, length) → (R, p), metres and radians; see `twin.symbolic.chain_function`.
        errors: CasADi function q → e of this calibration.

    Raises:
        InputError: a tool length that is no finite number.
    """

    def __init__(
        self, machine: Machine, calibration: Calibration | None = None, *, tool_length_mm: float | None = None
    ) -> None:
        self.machine = machine
        self.calibration = Calibration.default(machine) if calibration is None else calibration
        self.tool_length_mm = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
        if not np.isfinite(self.tool_length_mm):
            raise InputError("tool length is no number", expected="a finite number of mm", value=tool_length_mm)
        self.chain = chain_function(machine)
        q = ca.SX.sym("q", len(machine.axes))
        self.errors = ca.Function("errors", [q], [error_vector(machine, self.calibration.effects, q)], ["q"], ["e"])

    def pose_at(self, q: Any) -> tuple[Any, Any]:
        """Rotation and tip as expressions of q (metres, radians), errors of the calibration included."""
        rotation, point = self.chain(q, self.errors(q), self.tool_length_mm * MM)
        return rotation, point

    @cached_property
    def _forward(self) -> BatchFunction:
        q = ca.SX.sym("q", len(self.machine.axes))
        return BatchFunction(ca.Function("forward", [q], list(self.pose_at(q))))

    @cached_property
    def _sensitivities(self) -> BatchFunction:
        q = ca.SX.sym("q", len(self.machine.axes))
        e = ca.SX.sym("e", 6 * len(self.machine.frames))
        rotation, point = self.chain(q, e, self.tool_length_mm * MM)
        # Against a rotation held fixed the change is a rotation vector: three rows to differentiate, not nine.
        held = ca.SX.sym("held", 3, 3)
        turn = rotation @ held.T
        pose = ca.vertcat(point, ca.inv_skew(turn - turn.T) / 2.0)
        errors = self.errors(q)
        by_error = ca.jacobian(pose, e)
        # Errors follow the axes: total derivative.
        by_command = ca.jacobian(pose, q) + by_error @ ca.jacobian(errors, q)
        results = ca.substitute([by_command, by_error], [held], [rotation])
        results = ca.cse(ca.substitute(results, [e], [errors]))
        return BatchFunction(ca.Function("sensitivities", [q], results))

    def reached(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What `forward` gives, unchecked and in our own units, for a batch that must never raise.

        Args:
            q: (n, axes) metres and radians.

        Returns:
            (n, 9) rotations, column after column, and (n, 3) points in metres.
        """
        rotation, point = self._forward(q)
        return rotation, point

    def forward(self, positions: Any) -> Poses:
        """Poses the machine really reaches.

        Args:
            positions: (n, axes) or (axes,) commands, mm and degrees, command order.

        Raises:
            InputError: wrong shape, a value that is no finite number, or outside the domain of a curve.
        """
        q = self.check(positions)
        rotation, point = self.reached(q * self.machine.scale)
        return Poses(locked(point / MM), locked(rotation.reshape(-1, 3, 3).transpose(0, 2, 1)))

    def error_frames(self, positions: Any) -> np.ndarray:
        """(n, frames, 6) the error frames at commands: metres and rotation vectors in radians, order ``machine.frames``.

        Raises:
            InputError: as `forward`.
        """
        q = self.check(positions)
        (errors,) = BatchFunction(self.errors)(q * self.machine.scale)
        return locked(errors.reshape(len(q), -1, 6))

    def sensitivities(self, positions: Any) -> Sensitivities:
        """Derivatives of the pose with respect to commands and to every error motion.

        Raises:
            InputError: as `forward`.
        """
        q = self.check(positions)
        command, error = self._sensitivities(q * self.machine.scale)
        shape = (len(q), -1, 6)
        return Sensitivities(
            locked(command.reshape(shape).transpose(0, 2, 1)), locked(error.reshape(shape).transpose(0, 2, 1))
        )

    def check(self, positions: Any) -> np.ndarray:
        """Positions as an (n, axes) array of finite numbers inside the domain of every curve.

        Raises:
            InputError: they are not.
        """
        q = np.atleast_2d(np.asarray(positions, dtype=float))
        axes = self.machine.axes
        if q.ndim != 2 or q.shape[1] != len(axes):
            raise InputError(
                "positions of the wrong shape",
                expected=f"(n, {len(axes)}): {', '.join(self.machine.names)}",
                value=q.shape,
            )
        if not np.all(np.isfinite(q)):
            raise InputError(
                "a position that is no number", expected="finite mm and degrees", value=q[~np.isfinite(q)][0]
            )
        self.calibration.check(q)
        return q

    def outside_domain(self, q: np.ndarray) -> np.ndarray:
        """(n, axes) where positions (mm, degrees) leave the domain of a curve, by more than rounding."""
        return self.calibration.outside(q)


def angle_between_rad(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) angle between unit vectors (n, 3), exact for small angles too."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=1) / 2.0, 0.0, 1.0)))


def turned(axis: np.ndarray, vectors: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
    """(n, 3) ``vectors`` turned about one unit ``axis`` by (n,) angles (Rodrigues)."""
    angle = (np.asarray(angles_deg) * DEG)[:, None]
    along = (vectors @ axis)[:, None] * axis
    return np.asarray(along + np.cos(angle) * (vectors - along) + np.sin(angle) * np.cross(axis, vectors))
