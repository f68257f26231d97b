"""Error budget: contribution of each error to the error at the tool, with its uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.records import APPROACH, json_form
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.error_names import DIRECTIONS
from twin.model.display import combined_uncertainty
from twin.model.effects import Effect, split_name, unit_of
from twin.model.effects.entries import drawn_period
from twin.model.iso16907 import error_motion_of, iso_class
from twin.model.unknown_errors import unknown_effects
from twin.reporting.identified import curve_ranges, is_motion, sum_of_effects
from twin.reporting.names import named
from twin.tool.forward import Kinematics, Poses
from twin.tool.uncertainty import (
    BudgetRow,
    PartialErrors,
    ToolUncertainty,
    error_budget,
    radius_95,
    random_approach,
    volume,
    volume_inside_domains,
)

JSON_NAMES: Final = MappingProxyType(
    {
        "iso_class": "class",
        "peak_half": "peak_half_95",
        "u_rms_um": "U_rms_um",
        "u_max_um": "U_max_um",
        "u_complete": "U_complete",
    }
)


@final
@dataclass(frozen=True)
class Contribution:
    """Contribution of one error, or of all errors of a class, to the error of the tool point over the volume."""

    name: str  # ISO 230-1 name, name of the effect, or class of ISO/TR 16907
    words: str  # name in words
    iso_class: str  # class of ISO/TR 16907
    axis: str  # the axis it belongs to; empty for a class
    unit: str  # ``um`` or ``urad`` of ``peak``; empty for a class
    peak: float  # largest absolute value over the range; NaN for a class
    peak_half: float  # half width of the widest 95 % interval; NaN if unknown
    rms_um: float  # error of the tool point from this error alone
    max_um: float
    u_rms_um: float  # U of the tool point from its uncertainty alone, RMS and largest over the poses; NaN if unknown
    u_max_um: float
    u_complete: bool  # whether all its parameters have an uncertainty; if not, a known U is a lower bound
    illustrative: bool  # assumed, not measured

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON; null for unknown numbers."""
        of_one_error = ("axis", "unit", "peak", "peak_half")
        return json_form(self, rename=JSON_NAMES, leave_out=() if self.unit else of_one_error)


@final
@dataclass(frozen=True)
class Budget:
    """Error budget of a machine at the tool, over the volume."""

    kinematics: Kinematics  # the machine with its errors
    positions: np.ndarray  # (n, axes) poses, mm and degrees
    sides: np.ndarray  # (n, axes) directions of approach, +1 or −1
    error_um: np.ndarray  # (n, 3) error of the tool point in the work frame
    tilt_urad: np.ndarray  # (n, 2) tilt of the tool axis about the tool's x and y
    errors: tuple[Contribution, ...]  # contributions of single errors, largest at the tool first
    classes: tuple[Contribution, ...]  # contributions of classes, largest first
    total: Contribution  # contribution of all errors together
    without_uncertainty: tuple[str, ...]  # names of the errors with a value but no uncertainty
    not_identified: tuple[str, ...]  # not determined and left out; U of total and classes includes them

    @property
    def worst(self) -> dict[str, float]:
        """Position of the largest error of the tool point, by axis."""
        row = self.positions[int(np.argmax(np.linalg.norm(self.error_um, axis=1)))]
        return dict(zip(self.kinematics.machine.names, row.tolist(), strict=True))

    @property
    def by_name(self) -> dict[str, Contribution]:
        """Contributions of single errors by name."""
        return {error.name: error for error in self.errors}

    def rms_without_um(self, *names: str) -> float:
        """Return the RMS error over the volume with some errors removed, µm."""
        others = {effect.name for effect in self.kinematics.calibration.effects} - {*names}
        ((nominal, found),) = self._partial.poses([others])
        remaining = found.point_mm - nominal.point_mm
        return float(np.sqrt(np.mean(np.sum(remaining**2, axis=1)))) * 1e3

    @cached_property
    def _partial(self) -> PartialErrors:
        return PartialErrors(self.kinematics, self.positions, self.sides)

    @cached_property
    def nominal_poses(self) -> Poses:
        """Return the poses of the nominal machine."""
        return nominal_machine(self.kinematics).forward(self.positions)


def without(real: Kinematics, names: Collection[str]) -> Kinematics:
    """Return the kinematics without some of the errors."""
    return real.where(lambda name: name not in names)


def nominal_machine(real: Kinematics) -> Kinematics:
    """Return the kinematics of the nominal machine, without errors."""
    return real.where(lambda name: False)


def budget(kinematics: Kinematics) -> Budget:
    """Return the error budget over the volume, with U of every contribution to first order (JCGM 100, 5.2.2).

    U of one error includes the uncertainty of its own parameters only; U of a class includes the covariance between its errors, and
    the plausible size of those that could not be determined.
    """
    machine, calibration = kinematics.machine, kinematics.calibration
    rows, classes = error_budget(
        machine, calibration, tool_length_mm=kinematics.tool_length_mm, conditions=kinematics.conditions
    )
    q = volume_inside_domains(calibration)
    sides = random_approach(q)
    meant, reached = nominal_machine(kinematics).forward(q), kinematics.forward(q, sides)
    share = _Shares(kinematics, q, sides)
    acts = {effect.name: error_motion_of(effect, machine) for effect in calibration.effects}
    errors = [_contribution(row, share, [row.name], acts[row.name]) for row in rows]
    uncertain = acts | {name: name for name in share.tool.unknown}
    by_class = [
        _contribution(
            row, share, [name for name, motion in uncertain.items() if iso_class(motion, machine) == row.name], ""
        )
        for row in classes[:-1]
    ]
    return Budget(
        kinematics=kinematics,
        positions=q,
        sides=sides,
        error_um=(reached.point_mm - meant.point_mm) * 1e3,
        tilt_urad=reached.tilt_urad(meant),
        errors=tuple(sorted(errors, key=lambda one: -one.rms_um)),
        classes=tuple(sorted(by_class, key=lambda one: -one.rms_um)),
        total=_contribution(classes[-1], share, list(uncertain), ""),
        without_uncertainty=share.tool.without_uncertainty,
        not_identified=share.tool.unknown,
    )


@final
class _Shares:
    """U of the tool point from the parameters of selected effects, with sensitivities computed once for all."""

    def __init__(self, kinematics: Kinematics, q: np.ndarray, sides: np.ndarray) -> None:
        self.tool = ToolUncertainty(kinematics)
        self._numbers = {
            effect.name: [parameter.name for parameter in effect.parameters]
            for effect in (*unknown_effects(kinematics.calibration), *kinematics.calibration.effects)
        }
        self._place = {name: i for i, name in enumerate(self.tool.parameters)}
        self._rates = self.tool.point_rates(q, sides)

    def u_um(self, effects: Iterable[str]) -> tuple[float, float, bool]:
        """Return RMS and largest U over the poses (NaN if unknown), and whether all parameters have an uncertainty."""
        wanted = [number for effect in effects for number in self._numbers[effect]]
        known = [number for number in wanted if number in self._place]
        if not known:
            # An effect without parameters (a table in the control) has no uncertainty.
            return (np.nan, np.nan, False) if wanted else (0.0, 0.0, True)
        rates = self._rates[:, :, [self._place[number] for number in known]]
        u = radius_95(rates @ self.tool.covariance.of(known).matrix @ rates.transpose(0, 2, 1))
        return float(np.sqrt(np.mean(u**2))), float(u.max()), len(known) == len(wanted)


def _contribution(row: BudgetRow, share: _Shares, effects: list[str], motion: str) -> Contribution:
    u_rms, u_max, complete = share.u_um(effects)
    return Contribution(
        name=row.name,
        words=named(row.name, share.tool.kinematics.machine),
        iso_class=row.iso_class,
        axis=split_name(motion)[2] if motion.startswith("E_") else "",
        unit=row.unit,
        peak=row.peak,
        peak_half=COVERAGE_FACTOR * row.peak_u,
        rms_um=row.tool_rms_um,
        max_um=row.tool_max_um,
        u_rms_um=u_rms,
        u_max_um=u_max,
        u_complete=complete,
        illustrative=row.illustrative,
    )


# --- Error motions along their axes: value, 95 % interval, both directions of approach, and compensation by the control

FINE: Final = 361
A_PERIOD: Final = 16
"""Points per period of a periodic error."""
MOST: Final = 4001


@final
@dataclass(frozen=True)
class Motion:
    """One error motion of an axis over its range, with the other axes at mid-range."""

    name: str  # ISO 230-1 name
    words: str  # name in words
    axis: str
    linear: bool  # whether the axis is linear
    unit: str  # ``um`` or ``urad``
    position: np.ndarray  # (k,) mm or degrees
    value: np.ndarray  # (k,) mean of both directions of approach
    half: np.ndarray  # (k,) half width of the 95 % interval; NaN if unknown
    ways: np.ndarray | None  # (2, k) value on approach from below and from above; None if they are equal
    corrected: np.ndarray | None  # (k,) value after compensation by the control's tables; None if they do not act on it
    order: int | None  # degree, or number of harmonics, of its curve; None without a curve
    basis: str  # basis of its curve, or empty
    source: str  # of its curve
    added: tuple[str, ...]  # names of effects added to its curve
    illustrative: bool  # assumed, not measured

    @property
    def peak(self) -> tuple[float, float]:
        """Value of largest magnitude over both directions, and its position."""
        values = self.value[None] if self.ways is None else self.ways
        row, column = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
        return float(values[row, column]), float(self.position[column])

    @property
    def widest(self) -> float:
        """Half width of its widest 95 % interval; NaN if unknown."""
        return float(self.half.max())

    @property
    def axis_unit(self) -> str:
        """Unit of the axis position, for display."""
        return "mm" if self.linear else "°"

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        peak, at = self.peak
        below, above = (None, None) if self.ways is None else self.ways
        return json_form(
            {
                "name": self.name,
                "words": self.words,
                "axis": self.axis,
                "unit": self.unit,
                "peak": peak,
                "peak_at": at,
                "half_95_max": self.widest,
                "order": self.order,
                "basis": self.basis,
                "source": self.source,
                "added": self.added,
                "illustrative": self.illustrative,
                "position": self.position,
                "value": self.value,
                "half_95": self.half,
                "from_below": below,
                "from_above": above,
                "with_control": self.corrected,
            }
        )


def motions(kinematics: Kinematics) -> tuple[Motion, ...]:
    """Return every error motion with a value in the calibration, in the order of the machine's names."""
    return tuple(found for name in kinematics.machine.motion_names if (found := _motion(kinematics, name)) is not None)


def _motion(kinematics: Kinematics, name: str) -> Motion | None:
    machine, calibration = kinematics.machine, kinematics.calibration
    component, axis = DIRECTIONS.index(name[2]), machine.by_name[name[3:]]
    own = [e for e in calibration.effects if e not in calibration.corrections and is_motion(e, axis.name, calibration)]
    q = _positions(kinematics, axis.name, own)
    state = _state(kinematics, axis.name, q)
    parts = [effect for effect in own if component in effect.components(state)]
    if not parts:
        return None
    value = sum_of_effects(parts, state, component)
    sides = [state | {f"{APPROACH}{axis.name}": np.full(len(q), side)} for side in (1.0, -1.0)]
    ways = np.stack([sum_of_effects(parts, side, component) for side in sides])
    tables = [table for table in calibration.corrections if table.axis.name == axis.name]
    taken = sum_of_effects(tables, state, component)
    curve = calibration.curves.get(name)
    added = tuple(effect.name for effect in parts if effect.name != name)
    return Motion(
        name=name,
        words=named(name, machine),
        axis=axis.name,
        linear=axis.linear,
        unit=unit_of(name),
        position=read_only(q),
        value=read_only(value),
        half=read_only(
            COVERAGE_FACTOR * combined_uncertainty(parts, calibration.covariance, state, component, q.shape)
        ),
        ways=read_only(ways) if np.any(ways[0] != ways[1]) else None,
        corrected=read_only(value + taken) if np.any(taken) else None,
        order=None if curve is None else curve.family.order(len(curve.coefficients)),
        basis="" if curve is None else curve.basis,
        source="" if curve is None else curve.source,
        added=added,
        illustrative=curve is not None and curve.illustrative,
    )


def _positions(kinematics: Kinematics, axis: str, effects: Sequence[Effect]) -> np.ndarray:
    """Return positions over the domain of the curves, dense enough for periodic errors."""
    low, high = curve_ranges(kinematics)[kinematics.machine.names.index(axis)]
    periods = [period for effect in effects if (period := abs(drawn_period(effect)))]
    count = max([FINE, *(int((high - low) / period * A_PERIOD) + 1 for period in periods)])
    return np.linspace(low, high, min(count, MOST))


def _state(kinematics: Kinematics, axis: str, q: np.ndarray) -> dict[str, Any]:
    machine = kinematics.machine
    middle = {one.name: np.full(len(q), 0.0 if one.lower is None else sum(one.domain) / 2.0) for one in machine.axes}
    state: dict[str, Any] = middle | {axis: q} | {f"{APPROACH}{one.name}": np.zeros(len(q)) for one in machine.axes}
    return state | dict(kinematics.conditions.channels)


# --- Error of the tool point, and its U, as a field over the linear axes at fixed rotary positions

COUNTS: Final = {1: 101, 2: 25, 3: 13}
"""Grid positions per axis, by the number of linear axes; odd, to include the middle."""
DRAWN: Final = 7
"""Largest number of arrows per axis."""
POSES: Final = 300
"""Number of poses for a machine without linear axes."""


@final
@dataclass(frozen=True)
class Slice:
    """One plane of the error field."""

    horizontal: str  # names of the two axes that span the plane
    vertical: str
    fixed: dict[str, float]  # positions of the other axes, mm and degrees
    across: np.ndarray  # (a,), (b,) positions of the two axes, mm
    up: np.ndarray
    error_um: np.ndarray  # (b, a) magnitude of the error of the tool point
    u_um: np.ndarray  # (b, a) U of the tool point; NaN if unknown

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"u_um": "U_um"})


@final
@dataclass(frozen=True)
class Field:
    """Error of the tool point at the nodes of a grid."""

    axes: tuple[str, ...]  # in the order of the columns of ``positions``
    spread: tuple[str, ...]  # names of the axes that vary: the linear ones, or all if there is none
    positions: np.ndarray  # (n, axes) commands, mm and degrees; a grid over the linear axes, else random
    counts: tuple[int, ...]  # number of grid positions of every axis of ``spread``; empty without a grid
    point_mm: np.ndarray  # (n, 3) nominal tool points in the work frame
    error_um: np.ndarray  # (n, 3) error of the tool point, mean of both directions of approach
    u_um: np.ndarray  # (n,) U of the tool point; NaN if unknown
    complete: bool  # whether all errors have an uncertainty; if not, a known U is a lower bound

    @property
    def standing(self) -> dict[str, float]:
        """Positions of the fixed axes."""
        return {name: float(self.positions[0, i]) for i, name in enumerate(self.axes) if name not in self.spread}

    @property
    def size_um(self) -> np.ndarray:
        """(n,) magnitude of the error."""
        return np.asarray(np.linalg.norm(self.error_um, axis=1))

    @property
    def mean_um(self) -> np.ndarray:
        """(3,) mean error, which setting the workpiece zero removes."""
        return np.asarray(self.error_um.mean(axis=0))

    @property
    def rms_um(self) -> float:
        """Root mean square of the error."""
        return float(np.sqrt(np.mean(self.size_um**2)))

    @property
    def rms_about_mean_um(self) -> float:
        """Root mean square of the error minus its mean."""
        return float(np.sqrt(np.mean(np.sum((self.error_um - self.mean_um) ** 2, axis=1))))

    @property
    def steps_mm(self) -> dict[str, float]:
        """Grid spacing by axis."""
        columns = [self.positions[:, self.axes.index(name)] for name in self.spread]
        ways = zip(self.spread, self.counts, columns, strict=True)
        return {name: float(np.ptp(column)) / max(count - 1, 1) for name, count, column in ways}

    @property
    def known(self) -> bool:
        """Whether U is known at all positions."""
        return bool(np.all(np.isfinite(self.u_um)))

    @property
    def drawn(self) -> np.ndarray:
        """Indices of the positions drawn as arrows, on a coarser grid with its ends."""
        if not self.counts:
            return np.arange(len(self.positions))
        thin = [np.unique(np.round(np.linspace(0, count - 1, min(count, DRAWN))).astype(int)) for count in self.counts]
        return np.asarray(np.ravel_multi_index(np.meshgrid(*thin, indexing="ij"), self.counts).reshape(-1))

    @cached_property
    def slices(self) -> tuple[Slice, ...]:
        """Planes: for three axes, three per direction at both ends and in the middle; for two axes one; for one axis none."""
        places = [np.unique(self.positions[:, self.axes.index(name)]) for name in self.spread]
        if len(self.counts) == 2:
            return (self._slice(places, {}),)
        if len(self.counts) < 2:
            return ()
        levels = [(axis, level) for axis in (2, 1, 0) for level in (0, self.counts[axis] // 2, self.counts[axis] - 1)]
        return tuple(self._slice(places, {axis: level}) for axis, level in levels)

    def _slice(self, places: list[np.ndarray], at: Mapping[int, int]) -> Slice:
        """Return the plane at the given grid level of the fixed axes."""
        across, up = (i for i in range(len(places)) if i not in at)
        levels = tuple(at.get(i, slice(None)) for i in range(len(places)))
        error, u = (read_only(values.reshape(self.counts)[levels].T.copy()) for values in (self.size_um, self.u_um))
        fixed = {self.spread[i]: float(places[i][level]) for i, level in at.items()}
        return Slice(
            self.spread[across], self.spread[up], fixed, read_only(places[across]), read_only(places[up]), error, u
        )

    def edges(self) -> tuple[tuple[str, np.ndarray, np.ndarray], ...]:
        """Return the edges of the grid's box, each with a label and its end points, mm; one edge per axis has a label."""
        if not self.counts:
            return ()
        edges = []
        for i, name in enumerate(self.spread):
            others = [(0, count - 1) for k, count in enumerate(self.counts) if k != i]
            for first, corner in enumerate(product(*others)):
                ends = []
                for end in (0, self.counts[i] - 1):
                    at = [*corner[:i], end, *corner[i:]]
                    ends.append(int(np.ravel_multi_index(at, self.counts)))
                low, high = (self.positions[end, self.axes.index(name)] for end in ends)
                text = "" if first else f"{name} {low:g} … {high:g} mm".replace("-", "−")
                edges.append((text, self.point_mm[ends[0]], self.point_mm[ends[1]]))
        return tuple(edges)

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(
            {
                "axes": self.axes,
                "spread": self.spread,
                "standing": self.standing,
                "rms_um": self.rms_um,
                "max_um": self.size_um.max(),
                "mean_um": self.mean_um,
                "U_known": self.known,
                "U_complete": self.known and self.complete,
                "positions": self.positions,
                "point_mm": self.point_mm,
                "error_um": self.error_um,
                "U_um": self.u_um,
                "slices": self.slices,
            }
        )


def field(kinematics: Kinematics) -> Field:
    """Return the error field of a machine, with the rotary axes at zero or at the end of their range nearest to zero."""
    machine = kinematics.machine
    bounds = curve_ranges(kinematics)
    linear = machine.linear[:3]
    if linear:
        counts = tuple(COUNTS[len(linear)] for _ in linear)
        steps = [
            np.linspace(low, high, counts[linear.index(i)])
            if i in linear
            else np.array([(low + high) / 2.0 if axis.linear else float(np.clip(0.0, low, high))])
            for i, (axis, (low, high)) in enumerate(zip(machine.axes, bounds, strict=True))
        ]
        q = np.array(list(product(*steps)))
        # Linear and rotary axes may alternate in command order; a rotary axis has one position.
        spread = tuple(machine.names[i] for i in linear)
    else:
        counts, spread = (), machine.names
        q = volume(machine, POSES)
        q = q[~kinematics.outside_domain(q).any(axis=1)]
    meant, reached = nominal_machine(kinematics).forward(q), kinematics.forward(q)
    error = (reached.point_mm - meant.point_mm) * 1e3
    u = ToolUncertainty(kinematics).at(q)
    return Field(
        axes=machine.names,
        spread=spread,
        positions=read_only(q),
        counts=counts,
        point_mm=meant.point_mm,
        error_um=read_only(error),
        u_um=u.expanded_um,
        complete=u.complete,
    )
