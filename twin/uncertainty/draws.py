"""Machines drawn from a calibration's covariance and evaluated at the poses of the volume, in tiles that fit the cache of a core."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.errors import InputError
from twin._common.units import UM
from twin.compute.batch import BatchFunction
from twin.compute.native import equal_portions
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.machine import Machine
from twin.uncertainty.at_tool import ToolUncertainty
from twin.uncertainty.tally import BINS, Tally, binned

PILOT: Final = 2_048
"""Machines of a pilot run that sets the range of the bins: fifty of them lie beyond each limit of a 95 % interval."""
MACHINES_PER_STEP: Final = 1024
"""Machines drawn and evaluated together, at some poses at a time."""
ROWS_PER_TILE: Final = 16_384
"""Poses of all machines evaluated in one call: few enough for the cache of a core, enough to make the cost of the calls small."""
NUMERICAL_UM: Final = 1e-6
"""Rounding error of the kinematics in double precision, µm: the smallest tolerance of a comparison."""
POINT: Final = 4
"""Quantities per pose: deviation from the estimated point along x, y, z, and its length."""
See = Callable[[slice, np.ndarray], None]
"""Function of some of the poses (p) and of the deviations there (4, p, k), µm."""


@final
@dataclass(frozen=True)
class Draws:
    """Settings of a simulation, as sent to the workers.

    Attributes:
        machine, calibration, tool_length_mm, conditions: see `Kinematics`.
        positions: (n, axes) commands, mm and degrees.
        sides: (n, axes) directions of approach.
        seed: random seed.
        bins: lower and upper limits of the bins for the quantities per pose (4, n) and per machine (4); None before the pilot run.
    """

    machine: Machine
    calibration: Calibration
    tool_length_mm: float | None
    conditions: Conditions
    positions: np.ndarray
    sides: np.ndarray
    seed: int
    bins: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling: the fields, without cached properties."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def tool(self) -> ToolUncertainty:
        """Uncertainty of the calibration at the tool."""
        return ToolUncertainty(
            Kinematics(self.machine, self.calibration, tool_length_mm=self.tool_length_mm, conditions=self.conditions)
        )

    @cached_property
    def steps(self) -> _Steps:
        """Evaluation of machines, prepared for these poses."""
        return _Steps(self)

    def part(self, task: tuple[int, int]) -> Tally:
        """Evaluate one task.

        Args:
            task: number of the task and number of machines.
        """
        if self.bins is None:
            raise InputError("the bins are not set", expected="settings returned by `pilot`")
        lower, upper, least, most = self.bins
        count = len(self.positions)
        point = np.zeros((POINT, count, BINS + 2), dtype=np.int64)
        sums, squares = np.zeros((count, 3)), np.zeros((count, 3, 3))

        def see(tile: slice, values: np.ndarray) -> None:
            point[:, tile] += binned(values, lower[:, tile], upper[:, tile])
            by_pose = np.ascontiguousarray(values[:3].transpose(1, 0, 2))
            sums[tile] += by_pose.sum(axis=2)
            squares[tile] += by_pose @ by_pose.transpose(0, 2, 1)

        of_machine = self.steps.run(*task, see)
        measures = binned(of_machine, least, most)
        return Tally(task[1], point, sums, squares, measures, of_machine.sum(axis=1), of_machine.max(axis=1))

    def pilot(self) -> Draws:
        """Return the settings with bins over the range of a pilot run, widened by a tenth at either end."""
        ends = np.full((2, POINT, len(self.positions)), [[[np.inf]], [[-np.inf]]])

        def see(tile: slice, values: np.ndarray) -> None:
            ends[0, :, tile] = np.minimum(ends[0, :, tile], values.min(axis=2))
            ends[1, :, tile] = np.maximum(ends[1, :, tile], values.max(axis=2))

        of_machine = self.steps.run(0, PILOT, see)
        return replace(self, bins=(*_widened(*ends), *_widened(of_machine.min(axis=1), of_machine.max(axis=1))))


@final
class _Steps:
    """Evaluation of machines at all poses, in tiles: some machines at some poses."""

    def __init__(self, draws: Draws) -> None:
        self._seed, self._tool = draws.seed, draws.tool
        kinematics = draws.tool.kinematics
        q, sides = draws.positions, draws.sides
        rates = draws.tool.rates(q, sides)
        errors = kinematics.error_frames(q, sides).reshape(len(q), -1)
        moved = {component for component, _, _ in rates}
        own = [i for i in range(errors.shape[1]) if i in moved or errors[:, i].any()]
        # One more parameter, equal to 1, for the estimate itself: the errors are then one matrix product.
        one = len(draws.tool.parameters)
        self._rates = [
            (own.index(component), [*columns, one], np.column_stack([shape * UM, errors[:, component]]))
            for component, columns, shape in rates
        ]
        self._fixed = [(k, errors[:, i, None]) for k, i in enumerate(own) if i not in moved]
        self._components = len(own)
        self._commands = (q * kinematics.machine.scale).T
        self._tip = BatchFunction(_tip(kinematics, own))
        nominal = Kinematics(
            kinematics.machine, Calibration.zero(kinematics.machine), tool_length_mm=kinematics.tool_length_mm
        )
        estimated = kinematics.forward(q, sides).point_mm
        self._estimated = estimated.T[:, :, None] * 1e3
        self._off = (estimated - nominal.forward(q).point_mm).T[:, :, None] * 1e3
        # Nearly equal tiles: none is too small for the compiled kinematics.
        ends = np.linspace(0, len(q), max(len(q) * MACHINES_PER_STEP // ROWS_PER_TILE, 1) + 1).round().astype(int)
        self._tiles = [slice(a, b) for a, b in pairwise(ends.tolist())]

    def run(self, task: int, machines: int, see: See) -> np.ndarray:
        """Return `MEASURES` (4, machines), µm.

        Args:
            task: number of the task, which together with the seed determines the machines.
            machines: number of machines.
            see: called for every tile.
        """
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(task,)))
        found = []
        with equal_portions(len(self._tiles) * -(-machines // MACHINES_PER_STEP)):
            for start in range(0, machines, MACHINES_PER_STEP):
                count = min(MACHINES_PER_STEP, machines - start)
                # Steps have a fixed size, so that a machine's results do not depend on how many follow.
                numbers = np.concatenate([self._tool.draw(rng, MACHINES_PER_STEP), np.ones((1, MACHINES_PER_STEP))])
                found.append(self._step(numbers, count, see))
        return np.concatenate(found, axis=1)

    def _step(self, numbers: np.ndarray, count: int, see: See) -> np.ndarray:
        """Evaluate the first ``count`` of machines given by their parameters (parameters + 1, k)."""
        chosen = [numbers[columns] for _, columns, _ in self._rates]
        sums, most = np.zeros((2, count)), np.zeros((2, count))
        for tile in self._tiles:
            values, uncompensated = self._deviations(tile, chosen, count)
            for i, squared in enumerate((uncompensated, values[3])):
                sums[i] += squared.sum(axis=0)
                np.maximum(most[i], squared.max(axis=0), out=most[i])
            np.sqrt(values[3], out=values[3])
            see(tile, values)
        mean = sums / self._commands.shape[1]
        return np.sqrt(np.stack([mean[0], most[0], mean[1], most[1]]))

    def _deviations(self, tile: slice, chosen: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return deviations from the estimated points and their squared lengths (4, p, k), and squares of the whole error (p, k)."""
        commands, poses = self._commands[:, tile], tile.stop - tile.start
        errors = np.empty((self._components, poses, MACHINES_PER_STEP))
        for (row, _, shape), some in zip(self._rates, chosen, strict=True):
            np.matmul(shape[tile], some, out=errors[row])
        for row, fixed in self._fixed:
            errors[row] = fixed[tile]
        (tip,) = self._tip(np.repeat(commands, MACHINES_PER_STEP, axis=1).T, errors.reshape(self._components, -1).T)
        values = np.empty((POINT, poses, count))
        point = values[:3]
        np.multiply(tip.T.reshape(3, poses, -1)[:, :, :count], 1.0 / UM, out=point)
        point -= self._estimated[:, tile]
        np.einsum("kpt,kpt->pt", point, point, out=values[3])
        whole = point + self._off[:, tile]
        return values, np.einsum("kpt,kpt->pt", whole, whole)


def _tip(kinematics: Kinematics, own: list[int]) -> ca.Function:
    """Return the function (q, some components of the error frames) → tip, metres and radians; other components are zero."""
    machine = kinematics.machine
    q, some = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("e", len(own))
    errors = ca.SX.zeros(6 * len(machine.frames))
    for row, component in enumerate(own):
        errors[component] = some[row]
    point, _ = kinematics.tip_and_axis_with(q, errors)
    return ca.Function("tip", [q, some], [ca.densify(point)])


def _widened(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a range widened by a tenth at either end, and at least by `NUMERICAL_UM`."""
    more = np.maximum(0.1 * (upper - lower), NUMERICAL_UM)
    return lower - more, upper + more
