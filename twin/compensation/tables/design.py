"""Computation of tables: one subclass of `Design` for each kind of correction, shared by all formats of that kind.

A table over an axis corrects that axis's own errors. These alone displace the tool centre point by δ(q). The linear axes correct it by
c = −J⁺·δ, where J holds the derivatives of the point with respect to their commands on the same machine. With three linear axes the
correction is complete; with fewer it corrects the part along them. It is a first-order correction: 100 µm times 100 µrad is 10 nm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Generic, Literal, TypeVar, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.families import BASIC, BasicClass
from twin._common.units import URAD
from twin.controls import Correction, TableFormat, TableSummary, format_named
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.machine import Axis, Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects import Effect
from twin.model.iso16907 import error_motion_of, iso_class
from twin.tool.forward import Kinematics, Poses
from twin.tool.uncertainty import ToolUncertainty, errors_in, random_approach, state_at, volume_inside_domains


@final
@dataclass(frozen=True)
class Request:
    """Format and settings of the tables to be made."""

    kind: str  # name of a format of `twin.controls`
    # positions of the other axes while one moves, mm or degrees by axis; by default the middle of a linear range, 0° of a rotary
    at: Mapping[str, float] = field(default_factory=dict)
    tool_length_mm: float | None = None  # tool length for which the point is corrected; None: that of the machine file
    classes: frozenset[str] = frozenset(BASIC)  # basic classes to correct (ISO/TR 16907)
    tolerance_um: float = 1.0  # tolerance of the interpolation
    step: float | None = None  # mm or degrees between nodes; None: as wide as the tolerance allows
    most: int | None = None  # number of tables the control has; None: the format's default
    products: bool = True  # whether two tables may be multiplied, if the format can do that
    conditions: Conditions = field(default_factory=Conditions)  # temperatures and time
    unproven: bool = False  # whether tables are written although U of their correction exceeds the correction
    # whether the calibration was measured with tables switched on, and the new tables are added to those
    add: bool = False
    notes: tuple[str, ...] = ()  # lines for the comments of every file

    @property
    def form(self) -> TableFormat[Any]:
        """The format. Raises `InputError`: no format has that name."""
        return format_named(self.kind)

    @property
    def carried_classes(self) -> tuple[BasicClass, ...]:
        """Selected classes that the format can correct, wholly or in part."""
        return tuple(name for name in self.form.classes if name in self.classes)


# --- Required corrections of the axis commands, from the kinematic model; signs follow from the model for any chain of axes

CORRECTIONS_REMEMBERED: Final = 256
"""Corrections at the positions of a column that are remembered: every format asks for the same ones."""
ITERATIONS: Final = 2
"""Iterations of the linear axes' correction over the volume. The derivatives are those of the nominal machine, so each iteration leaves
the error times the slopes of error motions and tables: of 100 µm at 100 µm/m, 10 nm after the first and 1 pm after the second."""


@final
@dataclass(frozen=True)
class Volume:
    """Poses over the volume at which what remains of the errors is evaluated."""

    q: np.ndarray  # (n, axes) commands, mm and degrees, within the domains of the curves
    sides: np.ndarray  # (n, axes) directions of approach
    goal: Poses  # poses of the nominal machine
    # (n, linear axes, 3) pseudo-inverse of the derivatives of the nominal point with respect to the linear commands
    back: np.ndarray


@final
class RequiredCorrections:
    """Corrections that a calibration requires; corrections by the control are disregarded.

    ``at``: positions of the other axes while one moves; by default linear axes in the middle of their ranges, rotary axes as near to
    zero as they can be. `InputError` for a position of an unknown axis or out of range, or if directions of linear axes are linearly
    dependent.
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
        """Return the poses at commands (n, axes) for `volume` with the given errors, without building their kinematics."""
        errors.check(commands)
        state = state_at(self.machine, commands, self.volume.sides, self.conditions)
        effects = errors.with_tool(self.tool_length_mm).effects
        return self.nominal.with_errors(commands, errors_in(state, effects, self.machine, len(commands)))

    def corrected_commands(self, reach: Callable[[np.ndarray], Poses], reached: Poses) -> tuple[np.ndarray, int]:
        """Return the commands (n, axes) of `volume` whose linear axes correct the point, and at how many an axis's range limits them.

        ``reach``: function from commands to poses of the machine that is corrected; ``reached``: poses at the commands of `volume`.
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
        """Return the corrections (n, linear axes) in µm for errors of some axes, approached from ``side``: +1, −1, 0 unknown."""
        key = axes, side, positions.tobytes()
        if key not in self._known:
            if len(self._known) >= CORRECTIONS_REMEMBERED:
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
        """Return F (n, linear axes, r) of the covariance F Fᵀ of `linear_corrections`, µm; r = 0 if no error has one."""
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
        frame_factors = np.zeros((len(q), 6, spread.shape[2]))
        for row, component in enumerate(components):
            if component // 6 in frames:
                frame_factors[:, component % 6] += spread[:, row]
        return frame_factors

    def _uncertainty(self, axes: tuple[str, ...]) -> ToolUncertainty:
        """Return the uncertainty of the identified errors of these axes."""
        if axes not in self._uncertain:
            self._uncertain[axes] = ToolUncertainty(self.kinematics_of_axes(axes), "identified")
        return self._uncertain[axes]

    def not_identified(self, axes: Collection[str], classes: Collection[str]) -> tuple[str, ...]:
        """Return the names of the errors of some axes and classes in the calibration that it could not determine."""
        unknown = {error.name for error in self.calibration.not_identifiable}
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


# --- Computation of tables: one subclass of `Design` for each kind of correction, shared by all formats of that kind

C = TypeVar("C", bound=Correction)
Share = Literal["whole", "line", "no"]
URAD_PER_UM: Final = 2.0
"""Angular tolerance in µrad per µm of tolerance: 1 µm at half a metre."""
NEGLIGIBLE_SHARE: Final = 0.1
"""Tables with a largest value up to this share of the tolerance are not written."""
POSITIONS_CHECKED: Final = 997
"""Number of random positions at which every table is compared with the model."""
SEED: Final = 16907
U_EVERY: Final = 8
"""U of a table is evaluated at every eighth of these positions: it varies slowly."""


def tolerance_of(axis: Axis, tolerance_um: float) -> float:
    """Return the tolerance of an axis: µm, or µrad for a rotary axis."""
    return tolerance_um if axis.linear else tolerance_um * URAD_PER_UM


def check_positions(low: float, high: float) -> np.ndarray:
    """Return (`POSITIONS_CHECKED`,) random positions of a table, the same for every table of that range."""
    return np.random.default_rng(SEED).uniform(low, high, POSITIONS_CHECKED)


@final
@dataclass(frozen=True)
class Table:
    """One table compared with the model; all numbers in the table's unit."""

    content: TableSummary  # nodes and largest value
    deviation: float  # largest deviation of the model from the interpolation between nodes
    rounding: float  # rounding error of the written digits
    tolerance: float  # tolerance of the interpolation
    read_back_deviation: float  # largest deviation of the table read back from the model, at random positions

    @property
    def holds(self) -> bool:
        """Whether the file read back agrees with the model within interpolation and rounding."""
        return self.read_back_deviation <= self.deviation + self.rounding

    @property
    def within_tolerance(self) -> bool:
        """Whether the interpolation error is within the tolerance."""
        return self.deviation <= self.tolerance * (1.0 + 1e-9)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        name, unit = self.content.name, self.content.unit
        unmet = []
        if not self.holds:
            unmet.append(
                f"{name}: read back, it deviates from the model by {self.read_back_deviation:.4f} {unit}, "
                f"more than {self.deviation:.4f} + {self.rounding:.4f}"
            )
        if not self.within_tolerance:
            unmet.append(
                f"{name}: deviation between nodes {self.deviation:.3f} {unit}, more than the tolerance {self.tolerance:g}"
            )
        return tuple(unmet)


@final
@dataclass(frozen=True)
class Unproven:
    """A table that is not shown to be an improvement: U of its correction exceeds the correction (RMS over the table).

    A machine without that error would get such a table in 95 % of cases. Below U, the table may increase the error.
    """

    name: str  # name of the table
    axes: tuple[str, ...]  # axes whose errors it corrects
    unit: str  # ``um`` or ``urad``
    rms: float  # RMS of the correction over the table
    u_rms: float  # RMS of its U (95 %) over the table
    # errors in the correction that the calibration could not determine; if none, it is known to be small
    not_identified: tuple[str, ...]

    @property
    def text(self) -> str:
        """Name and numbers, without a sentence's end."""
        why = f"; not identified: {' '.join(self.not_identified)}" if self.not_identified else ""
        return f"{self.name}: correction {self.rms:.2f} {self.unit}, its U {self.u_rms:.2f} {self.unit} (RMS){why}"


@final
class ProofOfTables:
    """Comparison of the corrections of tables with their uncertainty; ``keep_all``: whether unproven tables are kept."""

    def __init__(self, required: RequiredCorrections, *, keep_all: bool) -> None:
        self._required, self._keep_all = required, keep_all
        self.unproven: list[Unproven] = []

    def keeps(
        self,
        content: TableSummary,
        axes: Sequence[str],
        classes: Collection[str],
        values: np.ndarray,
        factor: np.ndarray,
    ) -> bool:
        """Return whether a table is to be written; an unproven one is noted. Without a covariance nothing is refused.

        ``values``: (n,) the correction at positions of the table; ``factor``: (m, r) factor of its covariance at some of them.
        """
        rms = float(np.sqrt(np.mean(np.square(values))))
        u_rms = COVERAGE_FACTOR * float(np.sqrt(np.mean(np.sum(np.square(factor), axis=1))))
        if u_rms <= rms:
            return True
        unknown = self._required.not_identified(axes, classes)
        self.unproven.append(Unproven(content.name, tuple(axes), content.unit, rms, u_rms, unknown))
        return self._keep_all


@final
@dataclass(frozen=True)
class TablePlan(Generic[C]):
    """Tables to be written."""

    correction: C  # the tables
    # function that compares them with the files read back: one `Table` for each of `Correction.contents`, in that order
    compared: Callable[[C], tuple[Table, ...]]
    left_out: tuple[str, ...] = ()  # tables left out because the control has too few
    # tables that are not shown to be an improvement; they are not written unless the request says so
    unproven: tuple[Unproven, ...] = ()


class Design(ABC, Generic[C]):
    """Computation of the tables of one kind of correction."""

    correction: type[C]

    @abstractmethod
    def plan(self, required: RequiredCorrections, request: Request, old: C | None) -> TablePlan[C]:
        """Return the tables, on the nodes of the old ones if there are any; `InputError` if the machine cannot have them."""

    @abstractmethod
    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """Return which share of one error, that depends on ``others``, the tables correct, and the reason if it is not the whole."""


def share_depending_on(others: Sequence[Axis]) -> tuple[Share, str]:
    """Return ``whole`` for an error that depends on no other axes, else ``line`` and the reason."""
    return ("line", f"also depends on {' '.join(axis.name for axis in others)}") if others else ("whole", "")
