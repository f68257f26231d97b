"""Comparison of real and nominal tool poses at many points on straight lines of commands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.units import MM
from twin.compute.batch import BatchFunction
from twin.compute.native import TableRows
from twin.kinematics.forward import Kinematics

SLACK: Final = 1e-9
"""Distance (mm, degrees) beyond a curve's domain that is rounding, as in `twin.machine.calibration.Calibration.outside`."""


@final
@dataclass(frozen=True)
class Commands:
    """(n, axes) commands, mm and degrees, either as an array or as points ``begin + share · way`` on straight lines.

    Attributes:
        begin: (lines, axes) start of each line; the points themselves if the other attributes are None.
        way: (lines, axes) displacement along each line.
        line: (n,) line of each point.
        share: (n,) fraction of that line.
    """

    begin: np.ndarray
    way: np.ndarray | None = None
    line: np.ndarray | None = None
    share: np.ndarray | None = None

    def as_array(self, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the commands as an (n, axes) array; ``which``: a selection of them."""
        if self.way is None or self.line is None or self.share is None:
            return np.asarray(self.begin[which])
        line = self.line[which]
        return np.asarray(self.begin[line] + self.share[which][:, None] * self.way[line])

    @property
    def inputs(self) -> tuple[np.ndarray | TableRows, ...]:
        """Begin, displacement and fraction of every point."""
        if self.way is None or self.line is None or self.share is None:
            return self.begin, np.zeros(self.begin.shape[1]), np.zeros(1)
        return TableRows(self.begin, self.line), TableRows(self.way, self.line), self.share[:, None]


@final
@dataclass(frozen=True)
class ComparedPoses:
    """Deviations of tool poses from nominal ones.

    Attributes:
        distance_mm: (n,) distance between the functional points.
        angle_rad: (n,) angle between the tool axes.
        axis_in_nominal_frame: (n, 3) tool axis in the nominal tool frame, the argument of `twin.numerics.spatial.tilt`.
        known: (n,) whether the commands are finite and within the domains of all curves of the machine.
    """

    distance_mm: np.ndarray
    angle_rad: np.ndarray
    axis_in_nominal_frame: np.ndarray
    known: np.ndarray

    def where(self, keep: np.ndarray) -> ComparedPoses:
        """Return a selection of the poses."""
        return ComparedPoses(
            self.distance_mm[keep], self.angle_rad[keep], self.axis_in_nominal_frame[keep], self.known[keep]
        )


@final
class PoseComparison:
    """Compares poses of a machine with errors with nominal poses; never raises.

    Args:
        real: the machine with errors.
        nominal: the machine without errors.
    """

    def __init__(self, real: Kinematics, nominal: Kinematics) -> None:
        self._real, self._nominal = real, nominal

    def distance_mm(self, nominal: Commands, commanded: Commands, approach: np.ndarray | None = None) -> np.ndarray:
        """Return (n,) distances between the functional points.

        Args:
            nominal: n nominal commands, for the machine without errors.
            commanded: n commands given to the machine with errors.
            approach: (n, axes) approach directions, as in `Kinematics.directed`.
        """
        (distance,) = self._distance(*self._inputs(nominal, commanded, approach))
        return distance[:, 0]

    def poses(self, nominal: Commands, commanded: Commands, approach: np.ndarray | None = None) -> ComparedPoses:
        """Return the deviations in point and orientation; arguments as for `distance_mm`."""
        distance, axis_gap, axis_in_nominal_frame, beyond = self._poses(*self._inputs(nominal, commanded, approach))
        known = np.isfinite(distance[:, 0]) & (beyond[:, 0] <= SLACK)
        angle = 2.0 * np.arcsin(np.minimum(axis_gap[:, 0] / 2.0, 1.0))
        return ComparedPoses(distance[:, 0], angle, axis_in_nominal_frame, known)

    def _inputs(
        self, nominal: Commands, commanded: Commands, approach: np.ndarray | None
    ) -> Iterator[np.ndarray | TableRows]:
        yield from nominal.inputs
        yield from commanded.inputs
        if self._real.directed:
            yield np.zeros(len(self._real.machine.axes)) if approach is None else approach

    @cached_property
    def _distance(self) -> BatchFunction:
        inputs, distance, _, _ = self._expressions
        return BatchFunction(ca.Function("distance", inputs, [distance]))

    @cached_property
    def _poses(self) -> BatchFunction:
        inputs, distance, (nominal, real), beyond = self._expressions
        axis_gap = ca.norm_2(real - nominal[:, 2])
        return BatchFunction(ca.Function("poses", inputs, [distance, axis_gap, nominal.T @ real, beyond]))

    @cached_property
    def _expressions(self) -> tuple[list[Any], Any, tuple[Any, Any], Any]:
        """Expressions: inputs; distance in mm; nominal tool frame and real tool axis; amount by which a domain is exceeded."""
        machine = self._real.machine
        inputs, commands = [], []
        for name in ("meant", "given"):
            begin, way, share = (ca.SX.sym(name, size) for size in (len(machine.axes), len(machine.axes), 1))
            inputs += [begin, way, share]
            commands.append(begin + share * way)
        sides = self._real.symbols()[1:]
        nominal, commanded = (command * ca.DM(machine.scale) for command in commands)
        frame, target = self._nominal.pose_at(nominal)
        rotation, point = self._real.pose_at(commanded, *sides)
        beyond = ca.SX(-1.0)
        for q, (lower, upper) in zip(ca.vertsplit(commands[1]), self._real.calibration.domains(), strict=True):
            beyond = beyond if np.isneginf(lower) else ca.fmax(beyond, lower - q)
            beyond = beyond if np.isposinf(upper) else ca.fmax(beyond, q - upper)
        return [*inputs, *sides], ca.norm_2(point - target) / MM, (frame, rotation[:, 2]), beyond
