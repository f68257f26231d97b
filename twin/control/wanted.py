"""What the commands of the axes should be shifted by, as the machine's own kinematics have it: on any chain, without a sign of ours.

A table of an axis is about that axis's own errors. With these alone the tool point is off by δ(q); the linear axes undo it by c =
−J⁺·δ, J the point's derivatives by their commands on the same machine: all of it where there are three of them, and what lies along
them where there are fewer. First order: 100 µm times 100 µrad are 10 nm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import URAD
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.effects import Effect
from twin.machine.iso16907 import acts_as, iso_class
from twin.machine.machine import Axis, Machine
from twin.uncertainty.budget import drawn_sides, known_volume


@final
class Wanted:
    """Corrections a machine wants.

    Args:
        machine: the machine.
        calibration: its errors alone, without what a control takes out; none whose channel the conditions do not give.
        at: where the other axes stand while one moves: mm, degrees by axis.
        tool_length_mm: at which length the point is corrected.
        classes: basic classes of ISO/TR 16907 to correct.
        conditions: temperatures and time.

    Attributes:
        meant: the machine as drawn.

    Raises:
        InputError: linear axes that move the point the same way, so that nobody knows which of them is to be corrected.
    """

    def __init__(
        self,
        machine: Machine,
        calibration: Calibration,
        at: Mapping[str, float],
        tool_length_mm: float,
        classes: frozenset[str],
        conditions: Conditions,
    ) -> None:
        self.machine = machine
        self.at = dict(at)
        self.tool_length_mm = tool_length_mm
        self.conditions = conditions
        self.calibration = calibration
        self.meant = self.under(Calibration.zero(machine))
        by = _by_linear(self.meant, np.array([[self.at[name] for name in machine.names]]), None)[0]
        if machine.linear and np.linalg.matrix_rank(by) < len(machine.linear):
            raise InputError(
                f"{machine.name} has linear axes that move the point the same way",
                expected="at most three linear axes, each in a direction that the others leave",
                file=machine.path,
                value=" ".join(machine.axes[i].name for i in machine.linear),
            )
        self._classes = classes
        self._real: dict[str, Kinematics] = {}

    def under(self, errors: Calibration) -> Kinematics:
        """The machine with some errors, its tool and conditions."""
        return Kinematics(self.machine, errors, tool_length_mm=self.tool_length_mm, conditions=self.conditions)

    def class_of(self, effect: Effect) -> str:
        """The basic class of an effect."""
        return iso_class(acts_as(effect, self.machine), self.machine)

    def range_of(self, axis: Axis) -> tuple[float, float]:
        """Where the axis goes and its errors are known; one turn where it is unlimited."""
        low, high = axis.domain
        if axis.lower is None:
            return low, high
        known = self.calibration.domains()[self.machine.names.index(axis.name)]
        return max(low, float(known[0])), min(high, float(known[1]))

    def real(self, axes: tuple[str, ...]) -> Kinematics:
        """The machine with the errors of these axes alone, of the classes wanted."""
        key = " ".join(axes)
        if key not in self._real:
            kept = {
                effect.name
                for effect in self.calibration.effects
                if effect.frame.axis in axes and self.class_of(effect) in self._classes
            }
            self._real[key] = self.under(self.calibration.where(lambda name: name in kept))
        return self._real[key]

    def line(self, axis: Axis, q: np.ndarray, others: Mapping[str, float] | None = None) -> np.ndarray:
        """(n, axes) commands: one axis at q, the others where they stand while it moves, or at ``others``."""
        there = self.at | dict(others or {})
        rows = np.tile([there[name] for name in self.machine.names], (len(q), 1))
        rows[:, self.machine.names.index(axis.name)] = q
        return np.asarray(rows)

    def point(self, axes: tuple[str, ...], positions: np.ndarray, side: int = 0) -> np.ndarray:
        """(n, linear axes) µm to add to the commands of the linear axes for the errors of some axes.

        Args:
            axes: whose errors.
            positions: (n, axes) mm and degrees.
            side: the side these axes come from.
        """
        return undo(self.real(axes), self.meant, positions, self._sides(axes, positions, side)) * 1e3

    def beyond(self, effect: Effect) -> float:
        """Share of what one effect does to the point that no linear axis can undo: 0 where there are three of them."""
        if len(self.machine.linear) == 3:
            return 0.0
        alone = self.under(self.calibration.where(lambda name: name == effect.name))
        q = known_volume(self.calibration)
        sides, goal = drawn_sides(q), self.meant.forward(q).point_mm
        off = alone.forward(q, sides).point_mm - goal
        left = off + (_by_linear(alone, q, sides) @ step_back(alone, q, sides, goal)[:, :, None])[:, :, 0]
        size = float(np.linalg.norm(off))
        return float(np.linalg.norm(left)) / size if size > 0.0 else 0.0

    def turn(self, axis: Axis, q: np.ndarray, side: int = 0) -> np.ndarray:
        """(n,) µrad to add to the command of a rotary axis for its own angular positioning."""
        positions = self.line(axis, q)
        frames = self.real((axis.name,)).error_frames(positions, self._sides((axis.name,), positions, side))
        index = next(i for i, one in enumerate(self.machine.frames) if (one.axis, one.role) == (axis.name, "motion"))
        return np.asarray(-(frames[:, index, 3:] @ np.array(axis.direction)) / URAD)

    def frame_errors(self, axis: Axis, q: np.ndarray) -> np.ndarray:
        """(n, 6) what acts in an axis's error frame, µm and µrad, with its place in it; the side it comes from unknown."""
        frames = self.real((axis.name,)).error_frames(self.line(axis, q))
        own = [i for i, one in enumerate(self.machine.frames) if one.axis == axis.name]
        return np.asarray(frames[:, own].sum(axis=1) * 1e6)

    def _sides(self, axes: tuple[str, ...], positions: np.ndarray, side: int) -> np.ndarray:
        sides = np.zeros(positions.shape)
        for axis in axes:
            sides[:, self.machine.names.index(axis)] = side
        return sides


def middle_of(machine: Machine, at: Mapping[str, float]) -> dict[str, float]:
    """Where axes stand: as given; else linear axes in the middle of their ranges, rotary ones as near to zero as they come.

    Raises:
        InputError: no such axis, or a position out of its range.
    """
    found = {}
    for axis in machine.axes:
        low, high = axis.domain
        found[axis.name] = 0.5 * (low + high) if axis.linear else float(np.clip(0.0, low, high))
    for name, value in at.items():
        if name not in found:
            raise InputError("--at of no axis", expected=f"one of {' '.join(machine.names)}", value=name)
        low, high = machine.by_name[name].domain
        if not low <= value <= high:
            raise InputError(f"--at out of the range of {name}", expected=f"{low:g} … {high:g}", value=value)
        found[name] = float(value)
    return found


def undo(real: Kinematics, meant: Kinematics, positions: np.ndarray, sides: np.ndarray | None) -> np.ndarray:
    """(n, linear axes) mm: the step of the linear axes that takes the point to where it was meant to be, or as near as they can."""
    return step_back(real, positions, sides, meant.forward(positions).point_mm)


def step_back(real: Kinematics, positions: np.ndarray, sides: np.ndarray | None, goal_mm: np.ndarray) -> np.ndarray:
    """(n, linear axes) mm: the step of the linear axes that takes the point to a goal (n, 3), or as near as they can."""
    off = real.forward(positions, sides).point_mm - goal_mm
    return np.asarray(-(np.linalg.pinv(_by_linear(real, positions, sides)) @ off[:, :, None])[:, :, 0])


def _by_linear(real: Kinematics, positions: np.ndarray, sides: np.ndarray | None) -> np.ndarray:
    """(n, 3, linear axes) derivatives of the point by their commands."""
    return np.asarray(real.sensitivities(positions, sides).command[:, :3, list(real.machine.linear)])
