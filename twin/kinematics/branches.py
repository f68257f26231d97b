"""Rotary positions that point the tool along a given vector: all solutions, for any two rotary axes.

The nominal tool axis in the work frame is ``Rot(n₁, θ₁)·Rot(n₂, θ₂)·a₀``, with axis 1 the one nearer the workpiece. Solving it for
θ is the second Paden-Kahan subproblem (Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 3.2).
"""

from __future__ import annotations

from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import DEG
from twin.kinematics.forward import Kinematics

PARALLEL: Final = 1e-9
"""Sine below which the tool counts as parallel to a rotary axis, so that turning this axis does not change its direction."""


@final
class Branches:
    """Rotary solutions of one machine without errors.

    Args:
        nominal: the machine without errors.

    Raises:
        InputError: the machine does not have two rotary axes, or they are parallel.
    """

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
        """Return all rotary solutions.

        Args:
            axis: (n, 3) unit tool vectors in the work frame.

        Returns:
            (n, 2, 2) degrees: two solutions for the two rotary axes in command order, in (−180, 180]. NaN where there is no solution,
            and NaN for an axis that does not change the tool's direction (it may have any position).
        """
        n1, n2, u = self._n1, self._n2, self._a0
        gamma = float(n1 @ n2)
        alpha, beta = float(u @ n2), axis @ n1
        x = (beta - gamma * alpha) / (1.0 - gamma**2)
        y = (alpha - gamma * beta) / (1.0 - gamma**2)
        normal = np.cross(n1, n2)
        squared = (1.0 - x**2 - y**2 - 2.0 * x * y * gamma) / (normal @ normal)
        # A vector on the boundary of the reachable set gives zero up to rounding.
        height = np.sqrt(np.where(squared > -1e-12, np.maximum(squared, 0.0), np.nan))
        found = np.empty((len(axis), 2, 2))
        for k, sign in enumerate((1.0, -1.0)):
            middle = x[:, None] * n1 + y[:, None] * n2 + (sign * height)[:, None] * normal
            found[:, k, self._order[1]] = _angle_about(n2, np.broadcast_to(u, middle.shape), middle)
            found[:, k, self._order[0]] = _angle_about(n1, middle, axis)
        reachable = np.isfinite(height)
        found[~reachable] = np.nan
        return found / DEG

    def nearest(self, solutions: np.ndarray, previous: np.ndarray) -> np.ndarray | None:
        """Return the solution for one vector nearest to the present rotary positions, including whole turns.

        Args:
            solutions: (2, 2) as returned by `all`.
            previous: (2,) degrees.

        Returns:
            (2,) degrees within the axes' ranges, or None.
        """
        best: np.ndarray | None = None
        for solution in solutions:
            if np.all(np.isnan(solution)):
                continue
            angles = np.where(np.isnan(solution), previous, solution)
            turns = np.round((previous - angles) / 360.0)
            for shift in (0.0, -1.0, 1.0):
                candidate = angles + 360.0 * (turns + shift)
                candidate = np.where(np.isnan(solution), previous, candidate)
                inside = self._into_range(candidate)
                if inside is not None and (best is None or _travel(inside, previous) < _travel(best, previous)):
                    best = inside
        return best

    def _into_range(self, angles: np.ndarray) -> np.ndarray | None:
        lower, upper = self._limits.T
        slack = 1e-6  # a vector given with nine decimals may miss a limit by this much
        shifted = angles + 360.0 * np.where(angles < lower - slack, 1.0, np.where(angles > upper + slack, -1.0, 0.0))
        if np.any((shifted < lower - slack) | (shifted > upper + slack)):
            return None
        return np.clip(shifted, lower, upper)


def _travel(angles: np.ndarray, previous: np.ndarray) -> float:
    return float(np.max(np.abs(angles - previous)))


def _angle_about(axis: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the angle that turns ``start`` into ``end`` about ``axis``; NaN where both are parallel to it."""
    a = start - np.outer(start @ axis, axis)
    b = end - np.outer(end @ axis, axis)
    angle = np.arctan2(np.cross(a, b) @ axis, np.einsum("ni,ni->n", a, b))
    lengths = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    return np.where(lengths < PARALLEL, np.nan, angle)
