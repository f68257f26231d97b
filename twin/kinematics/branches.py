"""Rotary positions that point the tool along a given vector: all solutions, for any two rotary axes.

The nominal tool axis in the work frame is ``Rot(n₁, θ₁)·Rot(n₂, θ₂)·a₀``, with axis 1 the one nearer the workpiece. Solving it for
θ is the second Paden-Kahan subproblem (Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 3.2).
"""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import DEG
from twin.kinematics.forward import Kinematics

SLACK_DEG: Final = 1e-6
"""Angle by which a solution may lie outside a limit: a vector with nine decimals may miss it by this much."""
FIRST_WINDOW: Final = 64
"""Vectors solved at once at first; more after each window that was confirmed as a whole."""
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
        """Return the solution for each vector nearest to the rotary positions before it, including whole turns.

        Args:
            solutions: (n, 2, 2) as returned by `all`.
            previous: (n, 2) degrees.

        Returns:
            (n, 2) degrees within the axes' ranges, NaN where there is no solution.
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
        """Return solutions at the nearest turn, or ``shift`` turns from it, and one turn back where that is out of range.

        Args:
            solution: (2, n) degrees, as by `all`.
            before: (2, n) degrees.
            shift: number of turns.

        Returns:
            (2, n) degrees; (n,) the larger travel of the two axes, infinite for a position out of range or without solution; and the
            indices of those turned back.
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
        """Return the solution for each vector nearest to that of the vector before it, up to the first without a solution.

        Whole windows are solved at once with a guess of the positions before each vector: those of the branch of the window's first
        solution. What the solutions found this way confirm is kept; the next window begins behind.

        Args:
            solutions: (n, 2, 2) as returned by `all`.
            before: (2,) words of the rotary axes before the first.
            offset: (2,) added to words.

        Returns:
            (k, 2) words, k ≤ n.
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
    """Return (n,) the angles between two vectors normal to an axis, given in two perpendicular vectors; NaN where one has no length.

    Args:
        of: components of one of them.
        products: scalar products of the other with those two vectors.
        square: squared length of each of the two.
    """
    (a, b), (c, d) = of, products
    length = np.minimum((a * a + b * b) * square, (c * c + d * d) / square)
    return np.where(length < PARALLEL**2, np.nan, np.arctan2(a * d - b * c, a * c + b * d))
