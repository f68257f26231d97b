"""The inverse kinematics problem and its result, independent of the solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol, final

import casadi as ca
import numpy as np

CONVERGED: Final = 0
OUT_OF_RANGE: Final = 1
SINGULAR: Final = 2
FOR_NUMPY: Final = 3
"""Status codes of a pose. The last one is internal to the C++: an angle too large for it, which is left to NumPy."""
ROUTINES: Final = ("turn", "again", "follow", "repair", "check")
"""Names of the functions of a step, as in `StepFunctions`."""


class StepFunctions(Protocol):
    """The functions of a solver step. Inputs: q (axes), the approach (sides) if there is one, point (3) and axis (3)."""

    @property
    def turn(self) -> ca.Function:
        """Position q after a Newton step of all axes, the size of the residual before it, and the matrices of the step."""

    @property
    def again(self) -> ca.Function:
        """Change of q (axes) in another step with the same matrices, from residual (3 of the point, 2 of the axis) and matrices."""

    @property
    def follow(self) -> ca.Function:
        """Position q after a Newton step of the linear axes, and the largest component of the point's residual before it."""

    @property
    def repair(self) -> ca.Function:
        """Position q with the rotary axes in the best position where the whole orientation cannot be reached."""

    @property
    def check(self) -> ca.Function:
        """Both residual sizes; squared distances of the point and between the unit vectors of tool axis and target; the residual."""


@final
@dataclass(frozen=True)
class InverseProblem:
    """A machine with errors, reduced to the data of its inverse; metres and radians unless stated otherwise.

    Attributes:
        functions: functions of a step.
        axes: number of axes.
        rotary: indices of the rotary axes that may move; if there are none, no pose may be `Batch.loose`.
        sides: number of further inputs: directions of approach, and channels that differ from pose to pose.
        scale: (axes,) metres per millimetre, radians per degree.
        bounds: (axes, 2) limits of a result in mm and degrees.
        limits: (rotary, 2) limits of the rotary axes for a full correction of the orientation.
        rotary_limit: largest change of a rotary axis for it.
        tolerance: metres, and radians for the tool axis.
        steps: maximum number of Newton steps.
        near: residual below which a step may reuse the matrices of the step before.
        mm: metres per millimetre.
    """

    functions: StepFunctions
    axes: int
    rotary: tuple[int, ...]
    sides: int
    scale: np.ndarray
    bounds: np.ndarray
    limits: np.ndarray
    rotary_limit: float
    tolerance: float
    steps: int
    near: float
    mm: float

    @property
    def routines(self) -> tuple[str, ...]:
        """Names of the functions that are needed: without rotary axes to move only those of the linear axes."""
        return ROUTINES if self.rotary else ("follow", "check")

    @property
    def inputs(self) -> int:
        """Number of inputs of a function."""
        return self.axes + self.sides + 6


@final
@dataclass(frozen=True)
class Batch:
    """Poses to reach, in mm and degrees.

    Attributes:
        start: (n, axes) start positions.
        point: (n, 3) target points.
        axis: (n, 3) target directions of the tool axis.
        approach: (n, sides) directions of approach and channels, or None.
        loose: (n,) whether the rotary axes may move.
    """

    start: np.ndarray
    point: np.ndarray
    axis: np.ndarray
    approach: np.ndarray | None
    loose: np.ndarray

    def __len__(self) -> int:
        return len(self.start)

    def part(self, rows: slice | np.ndarray) -> Batch:
        """Return some of the poses."""
        approach = None if self.approach is None else self.approach[rows]
        return Batch(self.start[rows], self.point[rows], self.axis[rows], approach, self.loose[rows])


@final
@dataclass(frozen=True)
class BatchOutcome:
    """The result of a batch.

    Attributes:
        positions: (n, axes) mm and degrees; NaN for an input that is not finite.
        distance: (n,) remaining distance of the point, mm.
        axis_angle_rad: (n,) angle between tool axis and target, radians.
        code: (n,) `CONVERGED`, `OUT_OF_RANGE`, `SINGULAR`.
        iterations: largest number of Newton steps of a pose.
    """

    positions: np.ndarray
    distance: np.ndarray
    axis_angle_rad: np.ndarray
    code: np.ndarray
    iterations: int

    def put(self, rows: slice | np.ndarray, other: BatchOutcome) -> None:
        """Store the results of some of the poses."""
        self.positions[rows], self.code[rows] = other.positions, other.code
        self.distance[rows], self.axis_angle_rad[rows] = other.distance, other.axis_angle_rad

    @staticmethod
    def empty(rows: int, axes: int) -> BatchOutcome:
        """Return an outcome with uninitialised arrays."""
        return BatchOutcome(np.empty((rows, axes)), np.empty(rows), np.empty(rows), np.empty(rows, dtype=np.uint8), 0)
