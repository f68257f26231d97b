"""Data common to all programs: machine, calibration, tool and options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, final

import numpy as np

from twin._common.arrays import all_within
from twin._common.bundled import DEFAULT_ROTARY_LIMIT_DEG
from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.provenance import program_comments
from twin.compensation.programs.backlash import Backlash
from twin.compensation.programs.block_conditions import channels_by_block
from twin.compensation.programs.comparison import PoseComparison, ThesisMethod
from twin.compensation.programs.words import Setup, WordSpace, outside_range
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions, values_in_words
from twin.model.effects import ControlCorrection
from twin.model.iso16907 import Scope, error_motion_of, iso_class
from twin.nc.dialect import Dialect
from twin.tool.forward import Kinematics
from twin.tool.inverse import SLACK, Inverse
from twin.tool.uncertainty import ToolUncertainty

Keep = Callable[[str], bool]
KeepTable = Callable[[ControlCorrection], bool]


@final
@dataclass(frozen=True)
class Options:
    """Options of a compensation.

    Attributes:
        setup: work offsets and origin.
        tool_length_mm: tool length; None for that of the machine file.
        tcp: whether tool-centre-point mode is on from the start.
        scope: classes to correct; None for everything the program can carry.
        tolerance_mm: error allowed between the end points of a block, and of a chord.
        rotary_limit_deg: largest motion of a rotary axis to correct an orientation.
        method: ``exact``, or ``thesis`` for the baseline of `twin.compensation.programs.comparison`.
        conditions: temperatures, time and speed.
        language: language of the programs (`twin.read_program`); None to recognise it.
        subprograms: folders in which subprograms are searched after the program's own.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> options = twin.Options(tool_length_mm=120, scope=twin.Scope.parse(["L-VOL", "R-VOL"]))
        >>> twin.compensate("cone_frustum.nc", machine, options=options).report.scope
        'L-VOL R-VOL'
    """

    setup: Setup = field(default_factory=Setup)
    tool_length_mm: float | None = None
    tcp: bool = False
    scope: Scope | None = None
    tolerance_mm: float = 1e-3
    rotary_limit_deg: float = DEFAULT_ROTARY_LIMIT_DEG
    method: Literal["exact", "thesis"] = "exact"
    conditions: Conditions = field(default_factory=Conditions)
    language: str | None = None
    subprograms: tuple[Path, ...] = ()


@final
class PreparedMachine:
    """One machine with one calibration and the options of a compensation, ready for any program; `InputError` if they do not fit.

    ``space``: conversion between words and commands; that of the options if None; ``like``: the same prepared for another space with
    the same tool length, whose machine models are shared.

    Attributes:
        comparison, nominal_comparison: poses with all errors, and poses with other commands, compared with the nominal ones.
        machine_increment, increment: (axes,) least increments in command order and in word order.
        limits: (axes, 2) mm and degrees within which commands stay: axis ranges, or domains of curves where these are narrower.
    """

    def __init__(
        self,
        machine: Machine,
        calibration: Calibration,
        options: Options,
        space: WordSpace | None = None,
        like: PreparedMachine | None = None,
    ) -> None:
        self.machine = machine
        self.options = options
        self._given = calibration
        self._within: dict[WordSpace, PreparedMachine] = {}
        calibration.check_settled()
        calibration.check_not_live()
        self.calibration = calibration = calibration.with_transformation() if options.tcp else calibration
        options.conditions.require(calibration)
        self.by_block = channels_by_block(calibration, options.conditions)
        self.space = WordSpace(machine, options.setup, options.tool_length_mm) if space is None else space
        self._like = like
        self.real: Kinematics = (
            Kinematics(
                machine,
                calibration,
                tool_length_mm=options.tool_length_mm,
                conditions=options.conditions,
                by_pose=self.by_block,
            )
            if like is None
            else like.real
        )
        self.backlash = Backlash(calibration)
        self.comparison: PoseComparison = self.compared(self.real, None if like is None else like.comparison)
        nominal = None if like is None else like.nominal_comparison
        self.nominal_comparison: PoseComparison = self.compared(self.space.nominal, nominal)
        if calibration.corrections and options.method == "thesis":
            raise InputError(
                "the method of the thesis does not model the control's own tables and would correct their share twice",
                expected="the method exact, or a calibration without `control:`",
                file=calibration.path,
                setting="method",
            )
        self.thesis = ThesisMethod(calibration, self.space.nominal) if options.method == "thesis" else None
        self.machine_increment = np.array([axis.increment for axis in machine.axes])
        self.increment = self.machine_increment[self.space.order]
        ranges, domains = machine.limits / machine.scale[:, None], calibration.domains()
        self.limits = np.stack(
            [np.maximum(ranges[:, 0], domains[:, 0]), np.minimum(ranges[:, 1], domains[:, 1])], axis=1
        )

    def within(self, space: WordSpace) -> PreparedMachine:
        """Return the machine prepared for the words of a frame (`twin.compensation.programs.follow.FrameSpaces`)."""
        if space is self.space:
            return self
        if space not in self._within:
            options = replace(self.options, setup=space.setup, tool_length_mm=space.tool_length_mm)
            others = (self, *self._within.values())
            like = next((one for one in others if one.options.tool_length_mm == space.tool_length_mm), None)
            self._within[space] = PreparedMachine(self.machine, self._given, options, space, like)
        return self._within[space]

    @cached_property
    def at_unknown(self) -> ToolUncertainty:
        """Uncertainty at the functional point from the errors that the calibration could not determine; nothing corrects them."""
        return ToolUncertainty(self.real, "unknown")

    @cached_property
    def constant(self) -> dict[str, float]:
        """Channels that the calibration needs and that have one value for the whole program."""
        used = self.options.conditions.used(self.calibration)
        return {name: value for name, value in used.items() if name not in self.by_block}

    @cached_property
    def comments(self) -> tuple[str, ...]:
        """Comments for the header of an output: warnings, and the conditions that it is for."""
        conditions = self.options.conditions
        parts = [values_in_words(self.constant)] if self.constant else []
        if self.by_block:
            source = "with the speeds of the program" if conditions.log is None else f"of {conditions.log.path.name}"
            parts.append(f"a start at {conditions.time_s or 0.0:g} s {source}")
        held = (f"twin: only for {'; '.join(parts).replace('°C', 'degC')}",) if parts else ()
        return (*program_comments(self.calibration.warnings), *held)

    @cached_property
    def control_alone(self) -> Kinematics | None:
        """Machine without errors under the control's tables; None if the tables do not act on these errors."""
        return self.with_errors(lambda name: False, lambda table: True) if self.calibration.corrections else None

    def with_errors(self, keep: Keep, keep_table: KeepTable) -> Kinematics:
        """Return the machine with some of its errors, kept by ISO 230-1 name of their error motion, and of its control's tables."""
        tables = {table.name: table for table in self.calibration.corrections}
        return self.real.where(lambda name: keep_table(tables[name]) if name in tables else keep(self._acts_as[name]))

    @cached_property
    def _acts_as(self) -> dict[str, str]:
        return {effect.name: error_motion_of(effect, self.machine) for effect in self.calibration.effects}

    def compared(self, real: Kinematics, like: PoseComparison | None = None) -> PoseComparison:
        """Return the pose comparison of a machine with errors with the nominal pose; ``like``: as of `PoseComparison`."""
        return PoseComparison(real, self.space.nominal, self.space.commands_at, like)

    def outside(self, commands: np.ndarray) -> np.ndarray:
        """(n,) whether commands (mm, degrees) leave an axis's range."""
        return outside_range(self.machine, commands)

    def printed_increment(self, dialect: Dialect, *, posted: bool) -> np.ndarray:
        """Return the (axes,) least increments of the output's words, in word order; ``posted``: whether to another language."""
        increment = self.increment.copy()
        if dialect.linear_increment_mm is not None and not posted:
            increment[:3] = dialect.linear_increment_mm
        return increment

    def on_grid(self, words: np.ndarray, tips: np.ndarray, increment: np.ndarray) -> np.ndarray:
        """Return (n, axes) words rounded to their increments; one within its axis's limits is not rounded beyond them.

        Linear words that are turned or, in ``tips`` (n,), coordinates of the tool tip have no limits.
        """
        offset = self.space.offset
        rounded = np.round(words / increment) * increment
        low, high = self.limits[self.space.order].T
        if all_within(rounded + offset, low - SLACK, high + SLACK):  # the usual case
            return rounded
        first = np.ceil((low - offset - SLACK) / increment) * increment
        last = np.floor((high - offset + SLACK) / increment) * increment
        bounded = (words + offset >= low - SLACK) & (words + offset <= high + SLACK)
        bounded[tips | (not self.space.parallel), :3] = False
        return np.where(bounded, np.clip(rounded, first, last), rounded)

    def aim(self, *, turns: bool) -> CorrectionAim:
        """Return the errors to correct in a program; ``turns``: whether it moves rotary axes."""
        return self._aims[turns]

    @cached_property
    def _aims(self) -> tuple[CorrectionAim, CorrectionAim]:
        if self._like is not None:
            first, second = self._like.aim(turns=False), self._like.aim(turns=True)
            return first.within(self), second.within(self)
        return CorrectionAim(self, False), CorrectionAim(self, True)


@final
class CorrectionAim:
    """Errors to correct in one program, and machine models with only these errors; ``turns``: whether the program moves rotary axes."""

    def __init__(self, prepared: PreparedMachine, turns: bool) -> None:
        self.prepared = prepared
        self.turns = turns
        self.scope = scope = prepared.options.scope or Scope.everything(orientation=turns)
        corrected = prepared.with_errors(
            lambda name: (
                scope.at_point(name, prepared.machine) or (turns and scope.in_orientation(name, prepared.machine))
            ),
            self._table_at_point,
        )
        self.backlash = Backlash((prepared.space.nominal if prepared.thesis is not None else corrected).calibration)

    def within(self, prepared: PreparedMachine) -> CorrectionAim:
        """Return the same aim for the words of another frame, with the same tool length: the machine models are shared."""
        _ = self.point, self.point_inverse, self.orientation_inverse, self.at_point, self.at_axis, self.by_class
        found = copy(self)  # with these
        found.prepared = prepared
        vars(found)["comparison"] = prepared.compared(self.point, self.comparison)
        return found

    def _table_at_point(self, table: ControlCorrection) -> bool:
        return self.scope.covers(_classes_of(table))

    @cached_property
    def point(self) -> Kinematics:
        """Machine with the errors corrected at the functional point, less the control's own correction of them."""
        machine = self.prepared.machine
        return self.prepared.with_errors(lambda name: self.scope.at_point(name, machine), self._table_at_point)

    @cached_property
    def comparison(self) -> PoseComparison:
        """Pose comparison of that machine with the nominal pose."""
        return self.prepared.compared(self.point)

    @cached_property
    def point_inverse(self) -> Inverse:
        """Inverse kinematics of that machine."""
        return Inverse(self.point)

    @cached_property
    def orientation(self) -> Kinematics | None:
        """Machine with the errors corrected by the rotary axes; None if these do not move for it."""
        limited = self.prepared.with_errors(
            lambda name: self.scope.in_orientation(name, self.prepared.machine),
            lambda table: not table.axis.linear and (self.scope.orientation or self._table_at_point(table)),
        )
        return limited if self.turns and not limited.calibration.empty else None

    @cached_property
    def orientation_inverse(self) -> Inverse | None:
        """Inverse kinematics of that machine; None if the rotary axes do not move for it."""
        if self.orientation is None:
            return None
        return Inverse(self.orientation, rotary_limit_deg=self.prepared.options.rotary_limit_deg)

    @property
    def idle(self) -> bool:
        """Whether there is nothing to correct."""
        return self.point.calibration.empty and self.orientation is None and self.prepared.thesis is None

    @cached_property
    def at_point(self) -> ToolUncertainty:
        """Uncertainty of the corrected errors at the functional point."""
        return ToolUncertainty(self.point, "identified")

    @cached_property
    def at_axis(self) -> ToolUncertainty | None:
        """Uncertainty of the corrected orientation, or `at_point` itself if that has all its errors; None if not corrected."""
        if self.orientation is None:
            return None
        names = [{effect.name for effect in machine.calibration.effects} for machine in (self.orientation, self.point)]
        return self.at_point if names[0] <= names[1] else ToolUncertainty(self.orientation, "identified")

    @cached_property
    def by_class(self) -> Mapping[str, Kinematics]:
        """Machine with the errors of one class alone, for every class in which it has errors."""
        prepared = self.prepared
        found = {
            basic: prepared.with_errors(partial(_is_of, basic, prepared.machine), lambda table: False)
            for basic in BASIC
        }
        return {name: alone for name, alone in found.items() if not alone.calibration.empty}


def _classes_of(table: ControlCorrection) -> tuple[str, ...]:
    """Return the classes a table corrects through the axis it moves: a rotary axis its own position, the linear axes all others."""
    return tuple(name for name in table.classes if (name == "R-POS") is not table.axis.linear)


def _is_of(basic: str, machine: Machine, name: str) -> bool:
    return iso_class(name, machine) == basic
