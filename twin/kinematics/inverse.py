"""Inverse kinematics: the commands that reach a pose on the machine with errors.

The residual is the point (3) and the two components of the tool axis perpendicular to the target axis, because the spindle may turn
freely about it. Newton's method runs on all poses at once. The linear axes are eliminated first (their 3×3 block is never singular).
The remaining 2×2 system in the rotary axes shows by its smaller singular value how close a pose is to singular
(`twin.kinematics.newton`). `twin.compute.native` runs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.counts import count_with_noun
from twin._common.defaults import DEFAULT_ROTARY_LIMIT_DEG
from twin._common.errors import InputError
from twin._common.units import DEG, MM
from twin.compute.native import CONVERGED, OUT_OF_RANGE, SINGULAR, Batch, InverseProblem, Solver
from twin.display import card, first_rows, fixed, note, pairs, table
from twin.kinematics.forward import Kinematics, Poses
from twin.kinematics.newton import Steps

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
    """Result for one pose."""

    CONVERGED = "converged"
    OUT_OF_RANGE = "out of range"
    SINGULAR = "singular"


_CODE: Final = {Status.CONVERGED: CONVERGED, Status.OUT_OF_RANGE: OUT_OF_RANGE, Status.SINGULAR: SINGULAR}
_STATUS: Final = np.array(sorted(_CODE, key=lambda status: _CODE[status]), dtype=object)


@final
@dataclass(frozen=True)
class Solution:
    """Commands for a batch of poses.

    Attributes:
        positions: (n, axes) commands, mm and degrees; for ``out of range`` the solution beyond the limits.
        code: (n,) status codes of `twin.compute.native`.
        point_residual_mm: (n,) residual distance of the point.
        orientation_residual_rad: (n,) residual angle between tool axis and target.
        iterations: largest number of Newton steps over all poses.
    """

    positions: np.ndarray
    code: np.ndarray
    point_residual_mm: np.ndarray
    orientation_residual_rad: np.ndarray
    iterations: int

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

    def _repr_html_(self) -> str:
        counts = {status: int(self.where(status).sum()) for status in Status}
        met = counts[Status.CONVERGED] == len(self.code)
        axes = self.positions.shape[1]
        rows, rest = first_rows(
            len(self.code), lambda i: [*(fixed(v, 4) for v in self.positions[i]), str(self.status[i].value)]
        )
        residuals = ""
        if len(self.code):
            residuals = (
                f"{self.point_residual_mm.max() * 1e3:.1e} µm, {self.orientation_residual_rad.max() * 1e6:.1e} µrad"
            )
        summary = pairs(
            [
                ("status", ", ".join(f"{status.value} {count:,}" for status, count in counts.items() if count)),
                ("largest residual", residuals),
                ("Newton steps", str(self.iterations)),
            ]
        )
        headers = [*(f"axis {i + 1}" for i in range(axes)), "status"]
        caption = note("commands in command order, mm and degrees")
        title = f"Solution for {count_with_noun(len(self.code), 'pose')}"
        return card(title, summary, table(headers, rows, right=range(axes)), rest, caption, wrong=not met).text


@final
class Inverse:
    """Inverse kinematics of one machine with one calibration.

    Args:
        kinematics: the machine, its errors and tool length.
        rotary_limit_deg: largest motion of a rotary axis from its start to correct an orientation.

    Raises:
        InputError: the machine does not have three linear and at most two rotary axes.
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
