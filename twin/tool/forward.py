"""Forward kinematics with errors, in batches, and its sensitivities.

Positions are (poses, axes) arrays in mm and degrees, axes in command order. The chain is evaluated only by the expression of
`twin.machine.chain`; Pinocchio can evaluate the same model (`Machine.model`), and the tests compare the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, require_type
from twin._common.records import APPROACH
from twin._common.resources import builds_expressions
from twin._common.units import MM, URAD, count_with_noun
from twin.compute.along import BatchFunction
from twin.display import fixed
from twin.display.results import Result
from twin.machine.chain import chain_function, sparse, tip_function
from twin.machine.machine import Machine
from twin.machine.machine_file import LONGEST_TOOL_MM
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects.empirical import check_ranges
from twin.model.unknown_errors import ErrorTerms
from twin.numerics.spatial import tilt


@final
@dataclass(frozen=True, repr=False)
class Poses(Result):
    """Poses of the tool in the work frame."""

    point_mm: np.ndarray  # (n, 3) the functional point: the tool tip
    # (n, 3, 3) tool frame in the work frame; its third column is the tool axis, from tip to spindle
    rotation: np.ndarray

    @property
    def axis(self) -> np.ndarray:
        """(n, 3) tool axis (i, j, k), from tip to spindle."""
        return self.rotation[:, :, 2]

    def tilt_urad(self, nominal: Poses) -> np.ndarray:
        """Return the tilt (n, 2) of the tool axis from its nominal direction, µrad about x and y, free of any order (`spatial.tilt`).

        The angles are about x and y of the nominal tool frame, which are those of the work frame where the two are parallel, as on most
        machines at rotary zero. They are not taken about x and y of the work frame, because such angles are undefined for a tool across
        its z and ill-conditioned close to that. There are two angles because a rotation of the tool about its own axis has no effect.
        """
        if len(nominal) != len(self):
            raise InputError("the number of nominal poses differs", expected=f"{len(self)} poses", value=len(nominal))
        return read_only(tilt(np.einsum("nij,ni->nj", nominal.rotation, self.axis)) / URAD)

    def __len__(self) -> int:
        return len(self.point_mm)

    @property
    def brief(self) -> str:
        """Number of poses, and the first of them."""
        if not len(self):
            return "no poses"
        point, axis = (
            ", ".join(fixed(v, digits) for v in row[0]) for row, digits in ((self.point_mm, 4), (self.axis, 6))
        )
        more = f", the first of {len(self):,}" if len(self) > 1 else ""
        return f"tool tip x, y, z = {point} mm, tool axis i, j, k = {axis}{more}"


@final
@dataclass(frozen=True, repr=False)
class Sensitivities(Result):
    """First derivatives of the tool pose in the work frame, in metres and radians per metre or radian."""

    # (n, 6, axes) derivatives of point (3) and rotation (3, as a rotation vector in the work frame) by the commands, errors following
    # the axes
    command: np.ndarray
    error: np.ndarray  # (n, 6, 6·frames) derivatives by every component of every error frame

    @property
    def brief(self) -> str:
        """Numbers of poses, axes and error components."""
        poses = count_with_noun(len(self.command), "pose")
        return f"derivatives of {poses} by {self.command.shape[2]} axes and {self.error.shape[2]} error components"


@final
class Kinematics:
    """A machine with a calibration: the poses that its commands really reach.

    Args:
        machine: the machine.
        calibration: its errors; the machine file's own if None. `Calibration.zero` gives the machine without errors.
        tool_length_mm: the machine file's own if None.
        conditions: temperatures and time, for the effects that need them.
        by_pose: names of the channels that differ from pose to pose; they take the place of those of the conditions.

    Attributes:
        machine, tool_length_mm, conditions: as given.
        by_pose: as given.
        calibration: as given, with the control's own correction evaluated for this tool.
        chain: CasADi function (q, e, length) → (R, p), metres and radians; see `twin.machine.chain.chain_function`.
        directed: whether the approach direction of an axis matters (backlash), or a channel by pose. An argument ``approach`` is (n,
            axes), from +1 (from below) to −1 (from above), 0 where unknown; None for 0 throughout. Channels by pose follow as further
            columns and must be given.
        errors: CasADi function q → e of this calibration; (q, approach) → e if directed.

    Raises:
        InputError: a tool length that is negative, too large or not a number; an effect needs a channel that is not given; a
            temperature or speed outside the range of an effect.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> command = [[250, 225, -200, 30, 45]]  # X, Y, Z in mm, B, C in degrees
        >>> real = twin.Kinematics(machine, tool_length_mm=120)
        >>> nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=120)
        >>> error_mm = real.forward(command).point_mm - nominal.forward(command).point_mm
        >>> (1e3 * error_mm).round(2)  # µm
        array([[-26.33,  11.51, -63.3 ]])

    References:
        - ISO 230-1:2012 (error motions of an axis).
        - K. Sørby: Inverse kinematics of five-axis machines near singular configurations, Int. J. Mach. Tools Manuf. 47 (2007) 299-306
          (closed form of the DMU 50 without errors).
    """

    def __init__(
        self,
        machine: Machine,
        calibration: Calibration | None = None,
        *,
        tool_length_mm: float | None = None,
        conditions: Conditions | None = None,
        by_pose: Sequence[str] = (),
    ) -> None:
        require_type("machine", machine, Machine)
        self.machine = machine
        self.conditions = Conditions() if conditions is None else conditions
        self.by_pose = tuple(by_pose)
        self.tool_length_mm = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
        if not 0.0 <= self.tool_length_mm <= LONGEST_TOOL_MM:
            raise InputError(
                "tool length out of range",
                expected=f"a finite number of mm from the spindle nose to the tool tip, 0 to {LONGEST_TOOL_MM:g}",
                value=tool_length_mm,
            )
        given_errors = Calibration.given(machine, calibration)
        self.calibration = given_errors.with_tool(self.tool_length_mm)
        check_ranges(self.calibration.bounded, self.conditions.channels)
        self.chain = chain_function(machine)
        varying = [*(f"{APPROACH}{axis.name}" for axis in machine.axes), *self.by_pose]
        self._terms = ErrorTerms(machine, self.calibration.effects, self.conditions.channels, varying)
        self._set_errors()

    @builds_expressions
    def _set_errors(self) -> None:
        """Build the function of the errors of the calibration."""
        terms = self._terms
        errors = terms.vector({effect.name for effect in self.calibration.effects})
        self.directed = bool(ca.depends_on(errors, terms.channels))
        inputs = {"q": terms.q, "approach": terms.channels} if self.directed else {"q": terms.q}
        self.errors = ca.Function("errors", [*inputs.values()], [errors], [*inputs], ["e"])

    def where(self, keep: Callable[[str], bool]) -> Kinematics:
        """Return the same machine with only those effects whose name fulfils ``keep``, as by `Calibration.where`."""
        calibration = self.calibration.where(keep)
        if len(calibration.effects) == len(self.calibration.effects):
            return self
        other = object.__new__(Kinematics)
        other.machine, other.conditions, other.by_pose = self.machine, self.conditions, self.by_pose
        other.tool_length_mm, other.chain = self.tool_length_mm, self.chain
        other.calibration, other._terms = calibration, self._terms
        other._set_errors()
        return other

    def symbols(self) -> list[Any]:
        """Return new symbols of the arguments of a pose: q (metres, radians), and the approach directions if directed."""
        axes = len(self.machine.axes)
        sizes = {"q": axes, "approach": axes + len(self.by_pose)} if self.directed else {"q": axes}
        return [ca.SX.sym(name, size) for name, size in sizes.items()]

    def rows(self, q: np.ndarray, approach: Any = None) -> tuple[np.ndarray, ...]:
        """Return numerical values for `symbols`, from (n, axes) q in metres and radians.

        Raises:
            InputError: approach directions of another shape.
        """
        if not self.directed:
            return (q,)
        if approach is None and not self.by_pose:
            return q, np.zeros(q.shape)
        sides = np.atleast_2d(np.asarray([] if approach is None else approach, dtype=float))
        shape = (len(q), len(self.machine.axes) + len(self.by_pose))
        if sides.shape != shape:
            raise InputError("approach has the wrong shape", expected=str(shape), value=sides.shape)
        return q, sides

    def pose_at(self, *at: Any) -> tuple[Any, Any]:
        """Return rotation and tip as expressions of `symbols`, errors of the calibration included."""
        rotation, point = self.chain(at[0], self.errors(*at), self.tool_length_mm * MM)
        return rotation, point

    def tip_and_axis_at(self, *at: Any) -> tuple[Any, Any]:
        """Return tip and tool axis in the work frame as expressions of `symbols`; fewer operations than `pose_at`."""
        return self.tip_and_axis_with(at[0], self.errors(*at))

    def tip_and_axis_with(self, q: Any, errors: Any) -> tuple[Any, Any]:
        """Return the same at positions (axes,) with given errors (6·frames,)."""
        tip, axis = tip_function(self.machine)(q, errors, self.tool_length_mm * MM)
        return tip, axis

    @property
    def tip_and_axis(self) -> tuple[Any, Any]:
        """Tip and direction of the tool in the tool frame, sparse."""
        return sparse(0.0, 0.0, -self.tool_length_mm * MM), sparse(0.0, 0.0, 1.0)

    @cached_property
    @builds_expressions
    def _forward(self) -> BatchFunction:
        at = self.symbols()
        return BatchFunction(ca.Function("forward", at, list(self.pose_at(*at))))

    @cached_property
    @builds_expressions
    def _error_frames(self) -> BatchFunction:
        return BatchFunction(self.errors)

    @cached_property
    @builds_expressions
    def _sensitivities(self) -> BatchFunction:
        at = self.symbols()
        q = at[0]
        e = ca.SX.sym("e", 6 * len(self.machine.frames))
        rotation, point = self.chain(q, e, self.tool_length_mm * MM)
        # Relative to a fixed rotation the change is a rotation vector: three rows to differentiate instead of nine.
        fixed = ca.SX.sym("held", 3, 3)
        turn = rotation @ fixed.T
        pose = ca.vertcat(point, ca.inv_skew(turn - turn.T) / 2.0)
        errors = self.errors(*at)
        by_error = ca.jacobian(pose, e)
        # Errors follow the axes: total derivative.
        by_command = ca.jacobian(pose, q) + by_error @ ca.jacobian(errors, q)
        results = ca.substitute([by_command, by_error], [fixed], [rotation])
        results = ca.cse(ca.substitute(results, [e], [errors]))
        return BatchFunction(ca.Function("sensitivities", at, results))

    @cached_property
    @builds_expressions
    def _travel(self) -> BatchFunction:
        at = self.symbols()
        _, point = self.pose_at(*at)
        return BatchFunction(ca.Function("travel", at, [point, ca.jacobian(point, at[0])]))

    def reached(self, q: np.ndarray, approach: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the result of `forward` without checks and in metres, for batches that must not raise.

        Args:
            q: (n, axes) metres and radians.
            approach: as for `directed`.

        Returns:
            (n, 9) rotations, column by column, and (n, 3) points in metres.
        """
        rotation, point = self._forward(*self.rows(q, approach))
        return rotation, point

    def forward(self, positions: Any, approach: Any = None) -> Poses:
        """Return the poses the machine really reaches.

        Args:
            positions: (n, axes) or (axes,) commands, mm and degrees, command order; or a mapping or pandas frame of numbers by axis.
            approach: as for `directed`.

        Raises:
            InputError: wrong shape, a value that is not a finite number, or a position outside the domain of a curve.
        """
        q = self.check(positions)
        rotation, point = self.reached(q * self.machine.scale, approach)
        return _poses(rotation, point)

    def error_frames(self, positions: Any, approach: Any = None) -> np.ndarray:
        """Return (n, frames, 6) error frames at commands: metres and rotation vectors in radians, in the order of ``machine.frames``.

        Raises:
            InputError: as for `forward`.
        """
        q = self.check(positions)
        (errors,) = self._error_frames(*self.rows(q * self.machine.scale, approach))
        return read_only(errors.reshape(len(q), -1, 6))

    def with_errors(self, positions: Any, errors: np.ndarray) -> Poses:
        """Return the poses with given errors in place of those of the calibration.

        Args:
            positions: as for `forward`.
            errors: (n, 6·frames) metres and rotation vectors in radians, frame after frame.

        Raises:
            InputError: as for `forward`.
        """
        q = self.check(positions) * self.machine.scale
        rotation, point = _chain_of_rows(self.machine)(q, errors, np.array([self.tool_length_mm * MM]))
        return _poses(rotation, point)

    def sensitivities(self, positions: Any, approach: Any = None) -> Sensitivities:
        """Return the derivatives of the pose by the commands and by every error motion.

        Raises:
            InputError: as for `forward`.
        """
        q = self.check(positions)
        command, error = self._sensitivities(*self.rows(q * self.machine.scale, approach))
        shape = (len(q), -1, 6)
        return Sensitivities(
            read_only(command.reshape(shape).transpose(0, 2, 1)), read_only(error.reshape(shape).transpose(0, 2, 1))
        )

    def travel(self, positions: Any, approach: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (n, 3) in mm, and their derivatives (n, 3, axes) by the commands in metres and radians.

        The derivatives are those of `sensitivities`, whose derivatives by the error motions take ten times as long.

        Raises:
            InputError: as for `forward`.
        """
        q = self.check(positions)
        point, by = self._travel(*self.rows(q * self.machine.scale, approach))
        return read_only(point / MM), read_only(by.reshape(len(q), -1, 3).transpose(0, 2, 1))

    def check(self, positions: Any) -> np.ndarray:
        """Return positions as an (n, axes) array of finite numbers within the domain of every curve.

        Raises:
            InputError: wrong shape, a value that is not a finite number, or a position outside the domain of a curve.
        """
        axes = self.machine.axes
        by_axis = self._in_order(positions) if hasattr(positions, "keys") else positions
        try:
            q = np.atleast_2d(np.asarray(by_axis, dtype=float))
        except (TypeError, ValueError) as error:
            expected = f"(n, {len(axes)}) numbers: {', '.join(self.machine.names)}"
            raise InputError("positions are not rows of numbers", expected=expected, value=positions) from error
        if q.ndim != 2 or q.shape[1] != len(axes):
            raise InputError(
                "positions have the wrong shape",
                expected=f"(n, {len(axes)}): {', '.join(self.machine.names)}",
                value=q.shape,
            )
        if not np.all(np.isfinite(q)):
            raise InputError(
                "a position is not a finite number", expected="finite mm and degrees", value=q[~np.isfinite(q)][0]
            )
        self.calibration.check(q)
        return q

    def _in_order(self, positions: Mapping[str, Any]) -> list[list[Any]]:
        """Return the positions of a mapping or frame by axis as rows in command order; errors as for `check`."""
        names = self.machine.names
        for what, wrong in (
            ("positions of no axis of this machine", [name for name in positions if name not in names]),
            ("an axis without position", [name for name in names if name not in positions]),
        ):
            if wrong:
                expected = f"one number or column for each of {', '.join(names)}"
                raise InputError(what, expected=expected, value=", ".join(map(str, wrong)))
        try:
            return np.stack(np.broadcast_arrays(*(positions[name] for name in names)), axis=-1).tolist()
        except ValueError as error:
            rows = ", ".join(f"{name} {np.shape(positions[name])}" for name in names)
            raise InputError(
                "positions by axis differ in number", expected="as many for each axis, or one", value=rows
            ) from error

    def outside_domain(self, q: np.ndarray) -> np.ndarray:
        """Return (n, axes) where positions (mm, degrees) are outside the domains of the calibration (`Calibration.outside`)."""
        return self.calibration.outside(q)


@lru_cache(maxsize=16)  # shared by all calibrations; a machine is immutable
def _chain_of_rows(machine: Machine) -> BatchFunction:
    return BatchFunction(chain_function(machine))


def _poses(rotation: np.ndarray, point: np.ndarray) -> Poses:
    """Return the poses of (n, 9) rotations, column by column, and (n, 3) points in metres."""
    return Poses(read_only(point / MM), read_only(rotation.reshape(-1, 3, 3).transpose(0, 2, 1)))


def angle_between_rad(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (n,) the angle between unit vectors (n, 3), accurate for small angles too."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=1) / 2.0, 0.0, 1.0)))


def rms_and_max(tilt_urad: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return RMS and largest amount of (n, 2) tilts about x and about y; zero if there are none."""
    if not len(tilt_urad):
        return (0.0, 0.0), (0.0, 0.0)
    (a, b), (c, d) = np.sqrt(np.mean(tilt_urad**2, axis=0)), np.abs(tilt_urad).max(axis=0)
    return (float(a), float(b)), (float(c), float(d))
