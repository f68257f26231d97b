"""Required corrections of the axis commands, from the kinematic model; signs follow from the model for any chain of axes.

A table over an axis corrects that axis's own errors. These alone displace the tool centre point by δ(q). The linear axes correct it by
c = −J⁺·δ, where J holds the derivatives of the point with respect to their commands on the same machine. With three linear axes the
correction is complete; with fewer it corrects the part along them. It is a first-order correction: 100 µm times 100 µrad is 10 nm.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import URAD
from twin.kinematics.forward import Kinematics, Poses
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.effects import Effect
from twin.machine.iso16907 import error_motion_of, iso_class
from twin.machine.machine import Axis, Machine
from twin.uncertainty.at_tool import ToolUncertainty
from twin.uncertainty.budget import errors_in, random_approach, state_at, volume_inside_domains

REMEMBERED: Final = 256
"""Corrections at the positions of a column that are remembered: every format asks for the same ones."""
ITERATIONS: Final = 2
"""Iterations of the linear axes' correction over the volume. The derivatives are those of the nominal machine, so each iteration leaves
the error times the slopes of error motions and tables: of 100 µm at 100 µm/m, 10 nm after the first and 1 pm after the second."""


@final
@dataclass(frozen=True)
class Volume:
    """Poses over the volume at which what remains of the errors is evaluated.

    Attributes:
        q: (n, axes) commands, mm and degrees, within the domains of the curves.
        sides: (n, axes) directions of approach.
        goal: poses of the nominal machine.
        back: (n, linear axes, 3) pseudo-inverse of the derivatives of the nominal point with respect to the linear commands.
    """

    q: np.ndarray
    sides: np.ndarray
    goal: Poses
    back: np.ndarray


@final
class RequiredCorrections:
    """Corrections that a calibration requires.

    Args:
        machine: the machine.
        calibration: its errors, without effects whose channel the conditions do not give; corrections by the control are disregarded.
        at: positions of the other axes while one moves, mm or degrees by axis; by default linear axes in the middle of their ranges,
            rotary axes as near to zero as they can be.
        tool_length_mm: tool length for which the point is corrected; None: that of the machine file.
        classes: basic classes of ISO/TR 16907 to correct.
        conditions: temperatures and time.

    Attributes:
        nominal: the nominal machine.

    Raises:
        InputError: a position of an unknown axis or out of range; linear axes with linearly dependent directions, for which the
            correction is not unique.
    """

    def __init__(
        self,
        machine: Machine,
        calibration: Calibration,
        at: Mapping[str, float],
        tool_length_mm: float | None,
        classes: frozenset[str],
        conditions: Conditions,
    ) -> None:
        self.machine = machine
        self.at = _reference_positions(machine, at)
        self.tool_length_mm = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
        self.conditions = conditions
        self.calibration = calibration.with_control(None)
        self.nominal = self.kinematics_with(Calibration.zero(machine))
        by = _derivatives(self.nominal, np.array([[self.at[name] for name in machine.names]]), None)[0]
        if machine.linear and np.linalg.matrix_rank(by) < len(machine.linear):
            raise InputError(
                f"{machine.name} has linear axes with linearly dependent directions",
                expected="at most three linear axes in independent directions",
                file=machine.path,
                value=" ".join(machine.axes[i].name for i in machine.linear),
            )
        self._classes = classes
        self._real: dict[tuple[str, ...], Kinematics] = {}
        self._uncertain: dict[tuple[str, ...], ToolUncertainty] = {}
        self._known: dict[tuple[tuple[str, ...], int, bytes], np.ndarray] = {}

    def kinematics_with(self, errors: Calibration) -> Kinematics:
        """Return the kinematics with the given errors, this tool length and these conditions."""
        return Kinematics(self.machine, errors, tool_length_mm=self.tool_length_mm, conditions=self.conditions)

    @cached_property
    def volume(self) -> Volume:
        """The poses over the volume."""
        q = volume_inside_domains(self.calibration)
        back = np.linalg.pinv(_derivatives(self.nominal, q, None))
        return Volume(q, random_approach(q), self.nominal.forward(q), back)

    def poses_with(self, errors: Calibration, commands: np.ndarray) -> Poses:
        """Return the poses at commands (n, axes) for `volume` with the given errors, without building their kinematics.

        Raises:
            InputError: a position outside the domain of a curve; an effect needs a channel that is not given.
        """
        errors.check(commands)
        state = state_at(self.machine, commands, self.volume.sides, self.conditions)
        effects = errors.with_tool(self.tool_length_mm).effects
        return self.nominal.with_errors(commands, errors_in(state, effects, self.machine, len(commands)))

    def corrected_commands(self, reach: Callable[[np.ndarray], Poses], reached: Poses) -> tuple[np.ndarray, int]:
        """Return the commands (n, axes) of `volume` whose linear axes correct the point, and at how many an axis's range limits them.

        Args:
            reach: commands (n, axes) for `volume` → poses of the machine that is corrected.
            reached: poses that it reaches with the commands of `volume`.
        """
        at, linear = self.volume, list(self.machine.linear)
        commands, limited = at.q.copy(), np.zeros(len(at.q), dtype=bool)
        limits = np.array([self.range_of(self.machine.axes[i]) for i in linear])
        for i in range(ITERATIONS):
            poses = reach(commands) if i else reached
            off = poses.point_mm - at.goal.point_mm
            step = commands[:, linear] - (at.back @ off[:, :, None])[:, :, 0]
            commands[:, linear] = np.clip(step, *limits.T)
            limited = np.abs(commands[:, linear] - step).max(axis=1) > 1e-6
        return commands, int(limited.sum())

    def class_of(self, effect: Effect) -> str:
        """Return the basic class (ISO/TR 16907) of an effect."""
        return iso_class(error_motion_of(effect, self.machine), self.machine)

    def range_of(self, axis: Axis) -> tuple[float, float]:
        """Return the range in which the axis moves and its errors are known; one turn for an unlimited axis."""
        low, high = axis.domain
        if axis.lower is None:
            return low, high
        known = self.calibration.domains()[self.machine.names.index(axis.name)]
        return max(low, float(known[0])), min(high, float(known[1]))

    def kinematics_of_axes(self, axes: tuple[str, ...]) -> Kinematics:
        """Return the kinematics with the errors of these axes alone, of the selected classes."""
        if axes not in self._real:
            kept = {
                effect.name
                for effect in self.calibration.effects
                if effect.frame.axis in axes and self.class_of(effect) in self._classes
            }
            self._real[axes] = self.kinematics_with(self.calibration.where(lambda name: name in kept))
        return self._real[axes]

    def positions_along(self, axis: Axis, q: np.ndarray, others: Mapping[str, float] | None = None) -> np.ndarray:
        """Return (n, axes) commands: one axis at q, the others at their reference positions or at ``others``."""
        there = self.at | dict(others or {})
        rows = np.tile([there[name] for name in self.machine.names], (len(q), 1))
        rows[:, self.machine.names.index(axis.name)] = q
        return np.asarray(rows)

    def linear_corrections(self, axes: tuple[str, ...], positions: np.ndarray, side: int = 0) -> np.ndarray:
        """Return the corrections (n, linear axes) in µm, to be added to the commands, for the errors of some axes.

        Args:
            axes: the axes whose errors are corrected.
            positions: (n, axes) mm and degrees.
            side: direction of approach of these axes: +1, −1, 0 unknown.
        """
        key = axes, side, positions.tobytes()
        if key not in self._known:
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            goal, sides = self.nominal.forward(positions).point_mm, self._sides(axes, positions, side)
            self._known[key] = read_only(step_back(self.kinematics_of_axes(axes), positions, sides, goal) * 1e3)
        return self._known[key]

    def uncorrectable_share(self, effect: Effect) -> float:
        """Return the share of an effect at the point that the linear axes cannot correct; 0 with three of them."""
        if len(self.machine.linear) == 3:
            return 0.0
        alone = self.kinematics_with(self.calibration.where(lambda name: name == effect.name))
        q = volume_inside_domains(self.calibration)
        sides, goal = random_approach(q), self.nominal.forward(q).point_mm
        off = alone.forward(q, sides).point_mm - goal
        uncorrected = off + (_derivatives(alone, q, sides) @ step_back(alone, q, sides, goal)[:, :, None])[:, :, 0]
        size = float(np.linalg.norm(off))
        return float(np.linalg.norm(uncorrected)) / size if size > 0.0 else 0.0

    def rotary_correction(self, axis: Axis, q: np.ndarray, side: int = 0) -> np.ndarray:
        """Return the correction (n,) in µrad of a rotary axis's command for its own angular positioning error."""
        positions = self.positions_along(axis, q)
        frames = self.kinematics_of_axes((axis.name,)).error_frames(
            positions, self._sides((axis.name,), positions, side)
        )
        index = next(i for i, one in enumerate(self.machine.frames) if (one.axis, one.role) == (axis.name, "motion"))
        return np.asarray(-(frames[:, index, 3:] @ np.array(axis.direction)) / URAD)

    def frame_errors(self, axis: Axis, q: np.ndarray) -> np.ndarray:
        """Return the errors (n, 6) of an axis in its error frame, location errors included, in µm and µrad; approach unknown."""
        frames = self.kinematics_of_axes((axis.name,)).error_frames(self.positions_along(axis, q))
        own = [i for i, one in enumerate(self.machine.frames) if one.axis == axis.name]
        return np.asarray(frames[:, own].sum(axis=1) * 1e6)

    def linear_factors(self, axes: tuple[str, ...], positions: np.ndarray, side: int = 0) -> np.ndarray:
        """Return a factor F (n, linear axes, r) of the covariance F Fᵀ of `linear_corrections`, µm, from the identified errors.

        r is zero if none of these axes' errors has a covariance.
        """
        tool, sides = self._uncertainty(axes), self._sides(axes, positions, side)
        components, spread = tool.frame_factors(positions, sides)
        # Metres per metre and radian equal µm per µm and µrad.
        point = tool.kinematics.sensitivities(positions, sides).error[:, :3][:, :, components] @ spread
        return np.asarray(-np.linalg.pinv(_derivatives(self.nominal, positions, None)) @ point)

    def rotary_factors(self, axis: Axis, q: np.ndarray, side: int = 0) -> np.ndarray:
        """Return a factor (n, r) of the covariance of `rotary_correction`, µrad; see `linear_factors`."""
        index = next(i for i, one in enumerate(self.machine.frames) if (one.axis, one.role) == (axis.name, "motion"))
        own = self._frame_factors(axis, q, [index], side)[:, 3:]
        return np.asarray(-np.einsum("nir,i->nr", own, np.array(axis.direction)))

    def frame_error_factors(self, axis: Axis, q: np.ndarray) -> np.ndarray:
        """Return a factor (n, 6, r) of the covariance of `frame_errors`, µm and µrad; see `linear_factors`."""
        return self._frame_factors(axis, q, [i for i, one in enumerate(self.machine.frames) if one.axis == axis.name])

    def _frame_factors(self, axis: Axis, q: np.ndarray, frames: Sequence[int], side: int = 0) -> np.ndarray:
        """Return the factor (n, 6, r) of the sum of some error frames of an axis."""
        positions = self.positions_along(axis, q)
        components, spread = self._uncertainty((axis.name,)).frame_factors(
            positions, self._sides((axis.name,), positions, side)
        )
        found = np.zeros((len(q), 6, spread.shape[2]))
        for row, component in enumerate(components):
            if component // 6 in frames:
                found[:, component % 6] += spread[:, row]
        return found

    def _uncertainty(self, axes: tuple[str, ...]) -> ToolUncertainty:
        """Return the uncertainty of the identified errors of these axes."""
        if axes not in self._uncertain:
            self._uncertain[axes] = ToolUncertainty(self.kinematics_of_axes(axes), "identified")
        return self._uncertain[axes]

    def not_identified(self, axes: Collection[str], classes: Collection[str]) -> tuple[str, ...]:
        """Return the names of the errors of some axes and classes in the calibration that it could not determine."""
        unknown = {one.name for one in self.calibration.not_identifiable}
        return tuple(
            effect.name
            for effect in self.calibration.effects
            if effect.name in unknown and effect.frame.axis in axes and self.class_of(effect) in classes
        )

    def _sides(self, axes: tuple[str, ...], positions: np.ndarray, side: int) -> np.ndarray:
        """Return the directions of approach (n, axes): ``side`` for these axes, 0 for the others."""
        sides = np.zeros(positions.shape)
        for axis in axes:
            sides[:, self.machine.names.index(axis)] = side
        return sides


def _reference_positions(machine: Machine, at: Mapping[str, float]) -> dict[str, float]:
    """Return the reference position of every axis: as given, else the middle of a linear range, zero for a rotary axis."""
    for name, value in at.items():
        if name not in machine.by_name:
            raise InputError(
                "position of an unknown axis", expected=f"one of {' '.join(machine.names)}", value=name, setting="at"
            )
        low, high = machine.by_name[name].domain
        if not low <= value <= high:
            raise InputError(
                f"position out of the range of {name}", expected=f"{low:g} … {high:g}", value=value, setting="at"
            )
    middle = {
        axis.name: 0.5 * sum(axis.domain) if axis.linear else float(np.clip(0.0, *axis.domain)) for axis in machine.axes
    }
    return {name: float(at.get(name, value)) for name, value in middle.items()}


def step_back(real: Kinematics, positions: np.ndarray, sides: np.ndarray | None, goal_mm: np.ndarray) -> np.ndarray:
    """Return the step (n, linear axes) in mm that moves the point to, or as near as possible to, the goal (n, 3)."""
    point, by = real.travel(positions, sides)
    back = np.linalg.pinv(by[:, :, list(real.machine.linear)])
    return np.asarray(-(back @ (point - goal_mm)[:, :, None])[:, :, 0])


def _derivatives(real: Kinematics, positions: np.ndarray, sides: np.ndarray | None) -> np.ndarray:
    """Return the derivatives (n, 3, linear axes) of the point with respect to the linear axes' commands."""
    return np.asarray(real.travel(positions, sides)[1][:, :, list(real.machine.linear)])
