"""Where the tool is beside where it was meant to be, at very many points of straight lines of commands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.units import MM
from twin.compute.batch import BatchFunction
from twin.compute.native import Taken
from twin.kinematics.forward import Kinematics

SLACK: Final = 1e-9
"""mm and degrees beyond a curve's domain that are rounding, as of `twin.machine.calibration.Calibration.outside`."""


@final
@dataclass(frozen=True)
class Commands:
    """(n, axes) commands, mm and degrees; points on straight lines as ``begin + share · way``, not written out.

    Attributes:
        begin: (lines, axes) where each line begins; the points themselves where there is no more than that.
        way: (lines, axes) how far each goes.
        line: (n,) which of them each point is on.
        share: (n,) how far along.
    """

    begin: np.ndarray
    way: np.ndarray | None = None
    line: np.ndarray | None = None
    share: np.ndarray | None = None

    def written(self, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(n, axes) written out; ``which``: some of them."""
        if self.way is None or self.line is None or self.share is None:
            return np.asarray(self.begin[which])
        line = self.line[which]
        return np.asarray(self.begin[line] + self.share[which][:, None] * self.way[line])

    @property
    def inputs(self) -> tuple[np.ndarray | Taken, ...]:
        """Begin, way and share of every point."""
        if self.way is None or self.line is None or self.share is None:
            return self.begin, np.zeros(self.begin.shape[1]), np.zeros(1)
        return Taken(self.begin, self.line), Taken(self.way, self.line), self.share[:, None]


@final
@dataclass(frozen=True)
class ComparedPoses:
    """Poses of the tool beside those meant.

    Attributes:
        distance_mm: (n,) between the functional points.
        angle_rad: (n,) between the tool axes.
        leaning: (n, 3) tool axis in the tool frame as meant: what `twin.numerics.spatial.tilt` takes.
        known: (n,) whether commands are finite, and within the domains of all curves of the machine.
    """

    distance_mm: np.ndarray
    angle_rad: np.ndarray
    leaning: np.ndarray
    known: np.ndarray

    def where(self, keep: np.ndarray) -> ComparedPoses:
        """Some of them."""
        return ComparedPoses(self.distance_mm[keep], self.angle_rad[keep], self.leaning[keep], self.known[keep])


@final
class PoseComparison:
    """Compares what a machine with errors reaches with what the machine as drawn was meant to, never raising.

    Args:
        real: the machine with errors.
        nominal: the same without.
    """

    def __init__(self, real: Kinematics, nominal: Kinematics) -> None:
        self._real, self._nominal = real, nominal

    def distance_mm(self, meant: Commands, given: Commands, approach: np.ndarray | None = None) -> np.ndarray:
        """(n,) distances between the functional points.

        Args:
            meant: n commands of the machine as drawn.
            given: n commands of the real one.
            approach: (n, axes) sides that it comes from, as of `Kinematics.directed`.
        """
        (distance,) = self._distance(*self._inputs(meant, given, approach))
        return distance[:, 0]

    def poses(self, meant: Commands, given: Commands, approach: np.ndarray | None = None) -> ComparedPoses:
        """All there is to compare; arguments as of `distance_mm`."""
        distance, apart, leaning, beyond = self._poses(*self._inputs(meant, given, approach))
        known = np.isfinite(distance[:, 0]) & (beyond[:, 0] <= SLACK)
        angle = 2.0 * np.arcsin(np.minimum(apart[:, 0] / 2.0, 1.0))
        return ComparedPoses(distance[:, 0], angle, leaning, known)

    def _inputs(self, meant: Commands, given: Commands, approach: np.ndarray | None) -> Iterator[np.ndarray | Taken]:
        yield from meant.inputs
        yield from given.inputs
        if self._real.directed:
            yield np.zeros(len(self._real.machine.axes)) if approach is None else approach

    @cached_property
    def _distance(self) -> BatchFunction:
        inputs, distance, _, _ = self._expressions
        return BatchFunction(ca.Function("distance", inputs, [distance]))

    @cached_property
    def _poses(self) -> BatchFunction:
        inputs, distance, (meant, real), beyond = self._expressions
        apart = ca.norm_2(real - meant[:, 2])
        return BatchFunction(ca.Function("poses", inputs, [distance, apart, meant.T @ real, beyond]))

    @cached_property
    def _expressions(self) -> tuple[list[Any], Any, tuple[Any, Any], Any]:
        """Inputs; mm between the points; the tool frame as meant, and the real tool axis; by how much a domain is left."""
        machine = self._real.machine
        inputs, commands = [], []
        for name in ("meant", "given"):
            begin, way, share = (ca.SX.sym(name, size) for size in (len(machine.axes), len(machine.axes), 1))
            inputs += [begin, way, share]
            commands.append(begin + share * way)
        sides = self._real.symbols()[1:]
        meant, given = (command * ca.DM(machine.scale) for command in commands)
        frame, target = self._nominal.pose_at(meant)
        rotation, point = self._real.pose_at(given, *sides)
        beyond = ca.SX(-1.0)
        for q, (lower, upper) in zip(ca.vertsplit(commands[1]), self._real.calibration.domains(), strict=True):
            beyond = beyond if np.isneginf(lower) else ca.fmax(beyond, lower - q)
            beyond = beyond if np.isposinf(upper) else ca.fmax(beyond, q - upper)
        return [*inputs, *sides], ca.norm_2(point - target) / MM, (frame, rotation[:, 2]), beyond
