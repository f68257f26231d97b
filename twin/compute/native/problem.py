"""What is solved, and what comes of it: the same whichever way it is done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol, final

import casadi as ca
import numpy as np

CONVERGED: Final = 0
OUT_OF_RANGE: Final = 1
SINGULAR: Final = 2
LEFT: Final = 3
"""Codes of a pose; the last one is for the C++ alone: an angle larger than it reduces, which NumPy sees to."""
ROUTINES: Final = ("turn", "again", "follow", "repair", "check")
"""Names of the functions of a step, as of `StepFunctions`."""


class StepFunctions(Protocol):
    """What a step of the solver is; each takes q (axes), the approach (axes) if the machine is directed, point (3) and axis (3)."""

    @property
    def turn(self) -> ca.Function:
        """To q after one step of all axes, the size of the residual before it, and the matrices of the step."""

    @property
    def again(self) -> ca.Function:
        """From residual (3 of the point, 2 of the axis) and matrices to what one more step with these moves: (axes)."""

    @property
    def follow(self) -> ca.Function:
        """To q after one step of the linear axes, and the largest component of the point's residual before it."""

    @property
    def repair(self) -> ca.Function:
        """To q with the rotary axes moved as far as makes sense where the whole orientation cannot be had."""

    @property
    def check(self) -> ca.Function:
        """To the two sizes; the squares of what is left at the point, and of the length between tool axis and target; the residual."""


@final
@dataclass(frozen=True)
class InverseProblem:
    """A machine with errors, as far as its inverse needs it; metres and radians but where said.

    Attributes:
        functions: its steps.
        axes: how many.
        rotary: indices of the rotary ones.
        directed: whether there is an approach.
        scale: (axes,) metres a millimetre, radians a degree.
        bounds: (axes, 2) mm and degrees that a result must keep to.
        limits: (rotary, 2) that a full repair of the orientation must keep to.
        rotary_limit: how far a rotary axis may leave its start for it.
        tolerance: metres, and radians for the tool axis.
        steps: Newton steps allowed.
        near: residual from which on a step may have the matrices of the one before.
        mm: metres a millimetre.
    """

    functions: StepFunctions
    axes: int
    rotary: tuple[int, ...]
    directed: bool
    scale: np.ndarray
    bounds: np.ndarray
    limits: np.ndarray
    rotary_limit: float
    tolerance: float
    steps: int
    near: float
    mm: float

    @property
    def inputs(self) -> int:
        """Numbers that a function takes."""
        return self.axes * (1 + self.directed) + 6


@final
@dataclass(frozen=True)
class Batch:
    """Poses to be reached; mm and degrees.

    Attributes:
        start: (n, axes).
        point: (n, 3).
        axis: (n, 3).
        approach: (n, axes), or None where there is none.
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
        """Some of them."""
        approach = None if self.approach is None else self.approach[rows]
        return Batch(self.start[rows], self.point[rows], self.axis[rows], approach, self.loose[rows])


@final
@dataclass(frozen=True)
class BatchOutcome:
    """What became of a batch.

    Attributes:
        positions: (n, axes) mm and degrees; not-a-number where a given number was none.
        distance: (n,) mm left at the point.
        apart: (n,) radians between tool axis and target.
        code: (n,) `CONVERGED`, `OUT_OF_RANGE`, `SINGULAR`.
        iterations: most Newton steps taken by any pose.
    """

    positions: np.ndarray
    distance: np.ndarray
    apart: np.ndarray
    code: np.ndarray
    iterations: int

    def put(self, rows: slice | np.ndarray, other: BatchOutcome) -> None:
        """Write what became of some of the poses."""
        self.positions[rows], self.code[rows] = other.positions, other.code
        self.distance[rows], self.apart[rows] = other.distance, other.apart

    @staticmethod
    def empty(rows: int, axes: int) -> BatchOutcome:
        """Room for as many."""
        return BatchOutcome(np.empty((rows, axes)), np.empty(rows), np.empty(rows), np.empty(rows, dtype=np.uint8), 0)
