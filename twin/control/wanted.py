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
        calibration: its errors, none whose channel the conditions do not give; what a control takes out is not counted in.
        at: where the other axes stand while one moves, mm, degrees by axis; where none is given linear axes in the middle of their
            ranges, rotary ones as near to zero as they come.
        tool_length_mm: at which length the point is corrected; None: the machine file's.
        classes: basic classes of ISO/TR 16907 to correct.
        conditions: temperatures and time.

    Attributes:
        meant: the machine as drawn.

    Raises:
        InputError: a position of no axis, or out of its range; linear axes that move the point the same way, so that nobody knows which
            of them is to be corrected.
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
        self.at = _middle_of(machine, at)
        self.tool_length_mm = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
        self.conditions = conditions
        self.calibration = calibration.with_control(None)
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
        self._real: dict[tuple[str, ...], Kinematics] = {}

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
        if axes not in self._real:
            kept = {
                effect.name
                for effect in self.calibration.effects
                if effect.frame.axis in axes and self.class_of(effect) in self._classes
            }
            self._real[axes] = self.under(self.calibration.where(lambda name: name in kept))
        return self._real[axes]

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
        goal = self.meant.forward(positions).point_mm
        return step_back(self.real(axes), positions, self._sides(axes, positions, side), goal) * 1e3

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


def _middle_of(machine: Machine, at: Mapping[str, float]) -> dict[str, float]:
    """Where axes stand."""
    for name, value in at.items():
        if name not in machine.by_name:
            raise InputError("--at of no axis", expected=f"one of {' '.join(machine.names)}", value=name)
        low, high = machine.by_name[name].domain
        if not low <= value <= high:
            raise InputError(f"--at out of the range of {name}", expected=f"{low:g} … {high:g}", value=value)
    middle = {
        axis.name: 0.5 * sum(axis.domain) if axis.linear else float(np.clip(0.0, *axis.domain)) for axis in machine.axes
    }
    return {name: float(at.get(name, value)) for name, value in middle.items()}


def step_back(real: Kinematics, positions: np.ndarray, sides: np.ndarray | None, goal_mm: np.ndarray) -> np.ndarray:
    """(n, linear axes) mm: the step of the linear axes that takes the point to a goal (n, 3), or as near as they can."""
    off = real.forward(positions, sides).point_mm - goal_mm
    return np.asarray(-(np.linalg.pinv(_by_linear(real, positions, sides)) @ off[:, :, None])[:, :, 0])


def _by_linear(real: Kinematics, positions: np.ndarray, sides: np.ndarray | None) -> np.ndarray:
    """(n, 3, linear axes) derivatives of the point by their commands."""
    return np.asarray(real.sensitivities(positions, sides).command[:, :3, list(real.machine.linear)])
