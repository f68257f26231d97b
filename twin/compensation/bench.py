"""What stays the same for every program: machine, calibration, tool and the user's choices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, final

import numpy as np

from twin.approach import LostMotion
from twin.calibration import Calibration
from twin.channels import Conditions
from twin.compensation.thesis import ThesisMethod
from twin.inverse import DEFAULT_ROTARY_LIMIT_DEG
from twin.iso16907 import Scope, acts_as
from twin.kinematics import Kinematics
from twin.machine import Machine
from twin.toolpath import Setup, WordSpace, outside_range

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the fraction done."""


@final
@dataclass(frozen=True)
class Options:
    """What to do, beside the machine and its calibration.

    Attributes:
        setup: work offsets and origin.
        tool_length_mm: None for the machine file's own.
        tcp: whether the control's kinematics are on from the start.
        scope: None for everything the program can carry.
        tolerance_mm: error allowed between the ends of a block, and of a chord.
        rotary_limit_deg: how far a rotary axis may move to repair an orientation.
        method: ``exact``, or ``thesis`` for the baseline of `twin.thesis`.
        conditions: temperatures and time, over the whole program.
    """

    setup: Setup = field(default_factory=Setup)
    tool_length_mm: float | None = None
    tcp: bool = False
    scope: Scope | None = None
    tolerance_mm: float = 1e-3
    rotary_limit_deg: float = DEFAULT_ROTARY_LIMIT_DEG
    method: Literal["exact", "thesis"] = "exact"
    conditions: Conditions = field(default_factory=Conditions)


@final
class Bench:
    """One machine with one calibration, set up.

    Args:
        machine: the machine.
        calibration: its errors.
        options: what to do.

    Attributes:
        space: words to commands on the machine as drawn.
        full: the machine with all its errors.
        lost: its reversals.
        thesis: the baseline, where it is asked for.
        machine_increment: (axes,) least increments in command order.
        increment: (axes,) the same in the order of the words.
        limits: (axes, 2) mm and degrees that commands keep to: ranges, and domains of curves where those are narrower.

    Raises:
        InputError: the machine cannot run programs, or the method does not fit it; a temperature or time that the calibration needs
            and nobody gave, or a temperature of nothing it knows.
    """

    def __init__(self, machine: Machine, calibration: Calibration, options: Options) -> None:
        self.machine = machine
        self.calibration = calibration
        self.options = options
        options.conditions.require(calibration)
        self.space = WordSpace(machine, options.setup, options.tool_length_mm)
        self.full = self._with(calibration)
        self.lost = LostMotion(calibration)
        self.thesis = ThesisMethod(calibration, self.space.nominal) if options.method == "thesis" else None
        self.machine_increment = np.array([axis.increment for axis in machine.axes])
        self.increment = self.machine_increment[self.space.order]
        ranges, domains = machine.limits / machine.scale[:, None], calibration.domains()
        self.limits = np.stack(
            [np.maximum(ranges[:, 0], domains[:, 0]), np.minimum(ranges[:, 1], domains[:, 1])], axis=1
        )

    def limited(self, keep: Callable[[str], bool]) -> Kinematics:
        """The machine with only some of its errors, by the ISO 230-1 name of the error motion each is part of."""
        return self._with(self._where(keep))

    def corrected(self, scope: Scope, *, orientation: bool) -> Calibration:
        """The errors a scope corrects, at the point or, where the rotary axes move for it, in the orientation."""
        return self._where(
            lambda name: (
                scope.at_point(name, self.machine) or (orientation and scope.in_orientation(name, self.machine))
            )
        )

    @property
    def none(self) -> Calibration:
        """No error at all."""
        return self.space.nominal.calibration

    def _where(self, keep: Callable[[str], bool]) -> Calibration:
        return self.calibration.where(lambda name: keep(self._acts_as[name]))

    def _with(self, calibration: Calibration) -> Kinematics:
        length = self.options.tool_length_mm
        return Kinematics(self.machine, calibration, tool_length_mm=length, conditions=self.options.conditions)

    @cached_property
    def _acts_as(self) -> dict[str, str]:
        return {effect.name: acts_as(effect, self.machine) for effect in self.calibration.effects}

    def outside(self, commands: np.ndarray) -> np.ndarray:
        """(n,) whether commands (mm, degrees) leave an axis's range."""
        return outside_range(self.machine, commands)
