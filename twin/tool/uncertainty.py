"""Uncertainty of the tool's pose, propagated from the covariance of the calibration.

Propagation is of first order (JCGM 100:2008 (GUM), 5.1.2 and 5.2.2, eq. 13, correlations included), in matrix form J Σ Jᵀ (JCGM
102:2011, 6.2); `twin.tool.population` checks whether that is sufficient.

U is the radius about the estimated point within which the true point lies with 95 % probability, for a normally distributed error. It
is not k = 2 times one standard deviation: twice the standard deviation in the largest direction covers 95.4 % of an error along one
line, but only 73.9 % of an error equal in all three directions. U includes the plausible size of the errors that the calibration says
it could not determine (`twin.model.unknown_errors`). Errors with a value but no covariance are named in every result. If none has a
covariance the result is unknown: NaN, never zero. Other error motions missing from the calibration, repeatability, temperature and
rounding are not included.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, closest_name
from twin._common.messages import Message
from twin._common.records import APPROACH
from twin._common.units import count_with_noun
from twin.display import UNKNOWN, expanded, place
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.display import combined_uncertainty, standard_uncertainty, uncertainty_of
from twin.model.effects import Effect, assemble, unit_of
from twin.model.iso16907 import error_motion_of, iso_class
from twin.model.unknown_errors import prior_covariance, unknown_effects
from twin.numerics.covariance import Covariance, symmetric_root
from twin.numerics.spatial import cross_matrix
from twin.tool.forward import Kinematics, Poses, rms_and_max

POSES: Final = 2000
BUDGET_SEED: Final = 16907
CURVE_POINTS: Final = 721
"""Number of points at which a curve's peak is sought: every half degree of a turn."""
ROWS: Final = 16_384
"""Largest number of poses evaluated in one call, fewer than are worth compiling for."""


@final
@dataclass(frozen=True)
class BudgetRow:
    """Row of the error budget: one error motion, squareness or location error, or one class of them."""

    name: str  # ISO 230-1 name, or ISO/TR 16907 class
    iso_class: str
    unit: str  # ``um`` or ``urad``; empty for a class
    peak: float  # largest absolute value over its domain; NaN for a class
    peak_u: float  # largest standard uncertainty (k = 1) over its domain, in ``unit``; NaN for a class, and if unknown
    tool_rms_um: float  # tool_rms_um, tool_max_um: displacement of the tool point due to it alone, over the volume
    tool_max_um: float
    # tilt_rms_urad, tilt_max_urad: tilt of the tool axis due to it alone, about x and about y of the tool frame
    # (`twin.tool.forward.Poses.tilt_urad`); the maximum by absolute value
    tilt_rms_urad: tuple[float, float]
    tilt_max_urad: tuple[float, float]
    illustrative: bool


def volume(machine: Machine, poses: int = POSES, seed: int = BUDGET_SEED) -> np.ndarray:
    """Return commands (poses, axes) spread evenly over the ranges, mm and degrees; an unlimited axis over one turn."""
    return latin_hypercube(np.array([axis.domain for axis in machine.axes]), poses, np.random.default_rng(seed))


def volume_inside_domains(calibration: Calibration) -> np.ndarray:
    """Return the poses (n, axes) of `volume` that lie inside the domain of every curve of a calibration."""
    q = volume(calibration.machine)
    return np.asarray(q[~calibration.outside(q).any(axis=1)])


def latin_hypercube(ranges: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return a Latin hypercube sample (count, k) of (k, 2) ranges: one point in each of ``count`` slices of every range."""
    lower, upper = ranges.T
    cells = np.argsort(rng.random((count, len(ranges))), axis=0)
    return np.asarray(lower + (cells + rng.random(cells.shape)) / count * (upper - lower))


def random_approach(positions: np.ndarray) -> np.ndarray:
    """Return random directions of approach (n, axes), +1 or −1, from a fixed seed."""
    return np.asarray(np.random.default_rng(BUDGET_SEED).choice([-1.0, 1.0], np.shape(positions)))


def inside_domains(positions: np.ndarray, *calibrations: Calibration) -> np.ndarray:
    """Return the positions (n, axes), at least one, that lie inside the domain of every curve of all calibrations."""
    outside = np.any([calibration.outside(positions).any(axis=1) for calibration in calibrations], axis=0)
    if np.all(outside):
        raise InputError("no pose of the volume lies within every curve's domain", expected="curves over the ranges")
    return np.asarray(positions[~outside])


def state_at(
    machine: Machine, q: np.ndarray, sides: np.ndarray, conditions: Conditions, by_pose: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the arguments of effects by name, each (n,): positions (n, axes), directions of approach, and channels.

    Columns of ``sides`` after the directions are the channels ``by_pose``.
    """
    found: dict[str, Any] = dict(zip(machine.names, q.T, strict=True))
    names = [*(f"{APPROACH}{name}" for name in machine.names), *by_pose]
    return found | dict(conditions.channels) | dict(zip(names, sides.T, strict=True))


def errors_in(state: Mapping[str, Any], effects: Sequence[Effect], machine: Machine, count: int) -> np.ndarray:
    """Return the errors (n, 6·frames) of effects in ``count`` states (`state_at`), as `Kinematics.with_errors` takes them."""
    rows = assemble(effects, machine.frames, state)
    return np.stack([np.broadcast_to(value, count) for row in rows for value in row], axis=1)


@final
class PartialErrors:
    """Poses of a machine with some of its errors: each error is evaluated once, and many selections at a time.

    At commands ``q`` (n, axes), mm and degrees, with directions of approach ``sides`` (n, axes), +1 or −1.
    """

    def __init__(self, real: Kinematics, q: np.ndarray, sides: np.ndarray) -> None:
        self._real = real
        self._q = real.check(q)
        state = state_at(real.machine, q, sides, real.conditions)
        self._errors: dict[str, np.ndarray] = {}
        for effect in real.calibration.effects:
            own = errors_in(state, [effect], real.machine, len(q))
            self._errors[effect.name] = self._errors.get(effect.name, 0.0) + own

    def poses(self, selections: Sequence[Collection[str]]) -> Iterator[tuple[Poses, Poses]]:
        """Yield the (n,) nominal poses, and those with each selection of errors, given by the names of their effects.

        Both are results of one call, so that an error without effect gives exactly zero.
        """
        count, size = len(self._q), 6 * len(self._real.machine.frames)
        step = max(1, ROWS // max(count, 1))
        for first in range(0, len(selections), step):
            some = [(), *selections[first : first + step]]
            errors = np.zeros((len(some), count, size))
            for total, names in zip(errors, some, strict=True):
                for name, own in self._errors.items():
                    if name in names:
                        total += own
            found = self._real.with_errors(np.tile(self._q, (len(some), 1)), errors.reshape(-1, size))
            parts = [slice(i * count, (i + 1) * count) for i in range(len(some))]
            nominal, *reached = (Poses(found.point_mm[rows], found.rotation[rows]) for rows in parts)
            yield from ((nominal, one) for one in reached)


def error_budget(
    machine: Machine,
    calibration: Calibration,
    *,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
) -> tuple[tuple[BudgetRow, ...], tuple[BudgetRow, ...]]:
    """Return the budget: rows by error, and rows by class with the total last.

    A reversal counts as ± half its size, as directions of approach are random. The calibration is without effects whose channel the
    conditions do not give (`without_missing_channels`).
    """
    q = volume_inside_domains(calibration)
    sides = random_approach(q)
    classes = {effect.name: iso_class(error_motion_of(effect, machine), machine) for effect in calibration.effects}

    real = Kinematics(machine, calibration, tool_length_mm=tool_length_mm, conditions=conditions)
    partial = PartialErrors(real, q, sides)

    def at_tool(nominal: Poses, reached: Poses) -> tuple[float, float, tuple[float, float], tuple[float, float]]:
        distance = np.linalg.norm(reached.point_mm - nominal.point_mm, axis=1) * 1e3
        return float(np.sqrt(np.mean(distance**2))), float(distance.max()), *rms_and_max(reached.tilt_urad(nominal))

    state = state_at(machine, q, sides, Conditions() if conditions is None else conditions)
    entries = list(_entries(calibration, state))
    rows = [
        BudgetRow(effect.name, classes[effect.name], unit, peak, u, *at_tool(*alone), illustrative)
        for (effect, peak, u, unit, illustrative), alone in zip(
            entries, partial.poses([{effect.name} for effect, *_ in entries]), strict=True
        )
    ]
    totals = []
    members = {
        iso: [row for row in rows if row.iso_class == iso] for iso in dict.fromkeys(row.iso_class for row in rows)
    }
    selections = [{row.name for row in some} for some in members.values()]
    for (iso, some), own in zip(members.items(), partial.poses(selections), strict=True):
        totals.append(BudgetRow(iso, iso, "", np.nan, np.nan, *at_tool(*own), any(row.illustrative for row in some)))
    drawn = any(row.illustrative for row in rows)
    (whole,) = partial.poses([{row.name for row in rows}])
    totals.append(BudgetRow("all", "all", "", np.nan, np.nan, *at_tool(*whole), drawn))
    return tuple(rows), tuple(totals)


def without_missing_channels(
    conditions: Conditions, calibration: Calibration
) -> tuple[Calibration, dict[str, tuple[str, ...]]]:
    """Return the calibration without effects whose channel is not given, and the effects left out by channel."""
    missing = conditions.missing(calibration)
    left_out = {name for by in missing.values() for name in by}
    return calibration.where(lambda name: name not in left_out), missing


def _entries(calibration: Calibration, state: Mapping[str, Any]) -> Iterator[tuple[Effect, float, float, str, bool]]:
    """Yield for every effect its largest value, its largest standard uncertainty (NaN if unknown), unit, whether illustrative.

    Curves are evaluated over their domains, other effects over the poses of ``state``. Corrections by the control are among the other
    effects and have zero uncertainty.
    """
    covariance = calibration.covariance
    constants = {**calibration.squareness, **calibration.location}
    for effect in calibration.effects:
        name = effect.name
        curve = calibration.curves.get(name)
        if curve is not None:
            q = np.linspace(*curve.domain, CURVE_POINTS)
            u = float(standard_uncertainty(effect, covariance, q).max())
            yield effect, float(np.abs(curve(q)).max()), u, curve.unit, curve.illustrative
        elif name in constants:
            yield effect, abs(constants[name]), uncertainty_of(name, covariance), unit_of(name), False
        else:
            component, values = max(effect.components(state).items(), key=lambda one: float(np.max(np.abs(one[1]))))
            u = 0.0
            if effect.parameters:
                shape = np.shape(state[calibration.machine.names[0]])
                u = float(combined_uncertainty([effect], covariance, state, component, shape).max())
            yield effect, float(np.max(np.abs(values))), u, "um" if component < 3 else "urad", False


DEFINITION: Final = Message("U: radius within which the point lies with 95 % probability (normal distribution assumed)")
RADIUS: Final = (1.73085, -0.15300, 0.04808, -0.01687, 0.00799, -0.00311)
"""Polynomial of √(χ²_0.95(ν)/ν) in ν − 2 for 1 ≤ ν ≤ 3; its error is below 4e-5."""
POSES_PER_STEP: Final = 1024
POSES_PER_CHUNK: Final = 256
"""Poses whose error frames are in memory at once: 256 · 42 components · 400 parameters take 34 MB."""


def radius_95(covariance: np.ndarray) -> np.ndarray:
    """Return the radius (n,) within which a normally distributed error of covariance (n, 3, 3) lies with 95 % probability.

    The squared length is approximated by a multiple of χ² with ν = tr²(Σ)/tr(Σ²) degrees of freedom, which has the right mean and
    variance (Satterthwaite 1946; JCGM 100, G.4.1). It is exact for one, two or three equal standard deviations and otherwise between
    0.06 % too small and 0.54 % too large (coverage 94.98 … 95.15 %).
    """
    mean = np.trace(covariance, axis1=1, axis2=2)
    square = np.einsum("nij,nij->n", covariance, covariance)
    # Without any variance ν does not matter and the radius is zero; an unknown covariance (NaN) stays unknown.
    freedom = np.clip(mean**2 / np.where(square == 0.0, 1.0, square), 1.0, 3.0)
    return np.asarray(np.sqrt(mean) * np.polynomial.polynomial.polyval(freedom - 2.0, np.array(RADIUS)))


@final
@dataclass(frozen=True, repr=False)
class PoseUncertainty(Result):
    """Uncertainty of poses of the tool in the work frame."""

    # (n, 6, 6) of the point (µm) and of the rotation as a rotation vector (µrad), along the axes of the work frame; NaN if unknown
    covariance: np.ndarray
    axis: np.ndarray  # (n, 3) tool axis
    parameters: int  # number of the calibration's parameters that contribute; 0: unknown
    # names of errors with a value but no uncertainty, which are therefore not included
    without_uncertainty: tuple[str, ...]

    @property
    def known(self) -> bool:
        """Whether any parameter has a covariance."""
        return self.parameters > 0

    @property
    def complete(self) -> bool:
        """Whether all errors with a value have a covariance; if not, the uncertainties are lower bounds."""
        return self.known and not self.without_uncertainty

    @property
    def standard_um(self) -> np.ndarray:
        """Standard uncertainty (n, 3), k = 1, of the point along x, y, z of the work frame, µm."""
        return self._standard[:, :3]

    @property
    def standard_urad(self) -> np.ndarray:
        """Standard uncertainty (n, 3), k = 1, of the rotation about x, y, z of the work frame, µrad."""
        return self._standard[:, 3:]

    @cached_property
    def expanded_um(self) -> np.ndarray:
        """U (n,) of the point, µm: see `DEFINITION`."""
        return read_only(radius_95(self.covariance[:, :3, :3]))

    @cached_property
    def axis_expanded_urad(self) -> np.ndarray:
        """U (n,) of the tool axis, µrad: angle within which its direction lies with 95 % probability."""
        # δa = ω × a: a rotation about the tool axis has no effect.
        lever = -cross_matrix(self.axis)
        return read_only(radius_95(lever @ self.covariance[:, 3:, 3:] @ lever.transpose(0, 2, 1)))

    @property
    def brief(self) -> str:
        """U of the tool point over the poses."""
        poses = f"U of the tool point at {count_with_noun(len(self.axis), 'pose')}"
        if not self.known or not len(self.axis):
            return f"{poses}: {UNKNOWN}" if len(self.axis) else poses
        u = self.expanded_um
        rms, largest = (expanded(float(one), complete=self.complete) for one in (np.sqrt(np.mean(u**2)), u.max()))
        return f"{poses}: {rms} RMS, {largest} largest"

    def where(self, keep: np.ndarray) -> PoseUncertainty:
        """Return the uncertainty of the selected poses, (n,) booleans."""
        return PoseUncertainty(
            read_only(self.covariance[keep]), read_only(self.axis[keep]), self.parameters, self.without_uncertainty
        )

    @cached_property
    def _standard(self) -> np.ndarray:
        return read_only(np.sqrt(np.einsum("nii->ni", self.covariance)))


@final
@dataclass(frozen=True, repr=False)
class UncertaintyMap(Result):
    """U of the tool point over many poses."""

    axes: tuple[str, ...]  # names, in the order of the columns of ``positions``
    positions: np.ndarray  # (n, axes) commands, mm and degrees
    uncertainty: PoseUncertainty

    @property
    def rms_um(self) -> float:
        """RMS of U over the poses; NaN if unknown."""
        return float(np.sqrt(np.mean(self.uncertainty.expanded_um**2)))

    @property
    def max_um(self) -> float:
        """Largest U; NaN if unknown."""
        return float(np.max(self.uncertainty.expanded_um))

    @property
    def where(self) -> dict[str, float]:
        """Position of the largest U, by axis; empty if unknown or without poses."""
        if not self.uncertainty.known or not len(self.positions):
            return {}
        row = self.positions[int(np.argmax(self.uncertainty.expanded_um))]
        return dict(zip(self.axes, row.tolist(), strict=True))

    @property
    def brief(self) -> str:
        """U of the tool point over the poses, and where it is largest."""
        return f"{self.uncertainty.brief}{f' at {place(self.where)}' if self.where else ''}"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object: summary and every pose; unknown numbers are null."""
        known = self.uncertainty.known
        return {
            "known": known,
            "complete": self.uncertainty.complete,
            "definition": DEFINITION,
            "without_uncertainty": list(self.uncertainty.without_uncertainty),
            "rms_um": self.rms_um if known else None,
            "max_um": self.max_um if known else None,
            "where": self.where if known else None,
            "axes": list(self.axes),
            "positions": self.positions.tolist(),
            "u_um": self.uncertainty.standard_um.tolist() if known else None,
            "expanded_um": self.uncertainty.expanded_um.tolist() if known else None,
        }


@final
class ToolUncertainty:
    """Propagation of a calibration's covariance to the tool's pose.

    Args:
        kinematics: machine, calibration and tool.
        errors: ``all``; ``identified``: those that the calibration determined, on which its corrections are based; ``unknown``: those
            that it left out because it could not determine them (`twin.model.unknown_errors`).

    Attributes:
        kinematics: machine, calibration and tool.
        covariance: covariance of the parameters, those of unknown errors last.
        factor: (parameters, r) F, of which F Fᵀ is that covariance.
        unknown: names of the errors left out of the calibration whose plausible size is included.
        without_uncertainty: names of errors, or of single parameters of a curve, with a value but no uncertainty.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> expected = twin.judge(twin.thesis_plan.plan(machine), machine).calibration  # zero, with its covariance
        >>> tool = twin.ToolUncertainty(twin.Kinematics(machine, expected, tool_length_mm=120))
        >>> tool.at([[250, 225, -200, 0, 0]]).expanded_um.round(1)  # U (95 %)
        array([36.3])
        >>> tool.on_grid((5, 5, 5)).where
        {'X': 500.0, 'Y': 450.0, 'Z': -400.0, 'B': 0.0, 'C': 0.0}

    References:
        - JCGM 100:2008 (GUM), 5.1.2 and 5.2.2.
        - JCGM 102:2011, 6.2.
    """

    def __init__(self, kinematics: Kinematics, errors: Literal["all", "identified", "unknown"] = "all") -> None:
        self.kinematics = kinematics
        calibration = kinematics.calibration
        named = {parameter.name for effect in calibration.effects for parameter in effect.parameters}
        covariance = calibration.covariance.where(lambda name: errors != "unknown" and name in named)
        absent = unknown_effects(calibration) if errors != "identified" else ()
        self.unknown = tuple(effect.name for effect in absent)
        if absent:
            covariance = Covariance.of_blocks([covariance, prior_covariance(calibration)])
        self.covariance = covariance
        self._effects = (*(() if errors == "unknown" else calibration.effects), *absent)
        self.without_uncertainty = (
            tuple(
                name
                for name in _without(calibration, set(covariance.names))
                if name.partition("[")[0] not in self.unknown
            )
            if errors != "unknown"
            else ()
        )
        self._index = {name: i for i, name in enumerate(covariance.names)}
        self.factor = _factor(covariance)
        frames = kinematics.machine.frames
        self._start = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(frames)}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that have an uncertainty."""
        return self.covariance.names

    def at(self, positions: Any, approach: Any = None) -> PoseUncertainty:
        """Return the uncertainty at given poses, by first-order propagation about the calibration's values.

        Args:
            positions: (n, axes) commands, mm and degrees; memory use does not grow with n.
            approach: (n, axes) directions of approach, see `Kinematics.directed`; without them a reversal does not contribute.

        Raises:
            InputError: see `Kinematics.forward`.
        """
        q = self.kinematics.check(positions)
        sides = _sides(q, approach)
        covariance = np.full((len(q), 6, 6), np.nan)
        if self.parameters:
            for start in range(0, len(q), POSES_PER_STEP):
                step = q[start : start + POSES_PER_STEP]
                error = self.kinematics.sensitivities(step, sides[start : start + POSES_PER_STEP]).error
                for first in range(0, len(step), POSES_PER_CHUNK):
                    part = slice(first, first + POSES_PER_CHUNK)
                    rows, spread = self.frame_factors(step[part], sides[start : start + POSES_PER_STEP][part])
                    # Metres per metre and radian equal µm per µm and µrad; the product is a factor, so no variance is negative.
                    root = error[part][:, :, rows] @ spread
                    covariance[start:][part] = root @ root.transpose(0, 2, 1)
        axis = self.kinematics.forward(q, sides).axis if len(q) else np.zeros((0, 3))
        return PoseUncertainty(read_only(covariance), axis, len(self.parameters), self.without_uncertainty)

    def over_volume(self, poses: int = POSES) -> UncertaintyMap:
        """Return U over poses spread evenly over the ranges (`twin.tool.uncertainty.volume`), inside the domains of the curves."""
        return self._map(volume(self.kinematics.machine, poses))

    def on_grid(self, counts: Sequence[int], rotary_deg: Mapping[str, float] | None = None) -> UncertaintyMap:
        """Return U on a regular grid of the linear axes, with the rotary axes at fixed positions.

        Args:
            counts: number of positions of each linear axis in command order, limits of the range included.
            rotary_deg: positions of the rotary axes by name; 0 by default.

        Raises:
            InputError: the counts do not fit the machine, a rotary axis is unknown, or all positions are outside a curve's domain.
        """
        machine = self.kinematics.machine
        linear = [axis for axis in machine.axes if axis.linear]
        stand = dict(rotary_deg or {})
        turning = [axis.name for axis in machine.axes if not axis.linear]
        if len(counts) != len(linear) or any(count < 1 for count in counts):
            raise InputError(
                "the grid does not fit the machine",
                expected=f"a count for each of {', '.join(axis.name for axis in linear)}",
                value=tuple(counts),
            )
        for name in stand:
            if name not in turning:
                raise InputError(
                    "no such rotary axis",
                    expected=f"some of {', '.join(turning)}",
                    value=name,
                    nearest=closest_name(name, turning),
                )
        size = dict(zip((axis.name for axis in linear), counts, strict=True))
        ranges = zip(machine.limits / machine.scale[:, None], self.kinematics.calibration.domains(), strict=True)
        bounds = [(max(own[0], curves[0]), min(own[1], curves[1])) for own, curves in ranges]
        steps = [
            np.linspace(*bound, size[axis.name]) if axis.linear else np.array([stand.get(axis.name, 0.0)])
            for axis, bound in zip(machine.axes, bounds, strict=True)
        ]
        return self._map(np.array(list(product(*steps))))

    def _map(self, positions: np.ndarray) -> UncertaintyMap:
        """Return U at some poses, with random directions of approach: a reversal counts as ± half its size."""
        inside = inside_domains(positions, self.kinematics.calibration)
        return UncertaintyMap(
            self.kinematics.machine.names, read_only(inside), self.at(inside, random_approach(inside))
        )

    def rates(self, positions: np.ndarray, approach: np.ndarray) -> list[tuple[int, list[int], np.ndarray]]:
        """Return the derivatives of the error frames' components with respect to the uncertain parameters.

        Args:
            positions: (n, axes) commands, mm and degrees, checked.
            approach: (n, axes) directions of approach, see `at`.

        Returns:
            For every component with a derivative: its index into the (6·frames,) vector, the indices of the ``parameters`` it depends
            on, and its derivatives (n, k) with respect to them, µm and µrad. They are exact, as components are linear in parameters.
        """
        state = state_at(
            self.kinematics.machine, positions, approach, self.kinematics.conditions, self.kinematics.by_pose
        )
        moved: dict[int, list[tuple[int, Any]]] = {}
        for effect in self._effects:
            start = self._start[effect.frame.axis, effect.frame.role]
            for parameter, rates in zip(effect.parameters, effect.derivatives(state), strict=True):
                column = self._index.get(parameter.name)
                if column is not None:
                    for component, rate in rates.items():
                        moved.setdefault(start + component, []).append((column, rate))
        count = len(positions)
        return [
            (
                component,
                [column for column, _ in found],
                np.stack([np.broadcast_to(rate, count) for _, rate in found], axis=1),
            )
            for component, found in moved.items()
        ]

    def point_rates(self, positions: np.ndarray, approach: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, 3, parameters) of the tool point with respect to the uncertain parameters, µm per unit of each.

        Args:
            positions: (n, axes) commands, mm and degrees, checked.
            approach: (n, axes) directions of approach, see `at`.
        """
        point_rates = np.zeros((len(positions), 3, len(self.parameters)))
        if self.parameters:
            error = self.kinematics.sensitivities(positions, approach).error[:, :3]
            for component, columns, shape in self.rates(positions, approach):
                # m per m and m per rad equal µm per µm and µm per µrad.
                point_rates[:, :, columns] += error[:, :, component, None] * shape[:, None, :]
        return point_rates

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw deviations (parameters, count) of the uncertain parameters, µm and µrad: normal, with their covariance."""
        return np.asarray(self.factor @ rng.standard_normal((count, self.factor.shape[1])).T)

    def frame_factors(self, q: np.ndarray, sides: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Return a factor of the covariance of the error frames' components that have an uncertainty.

        Args:
            q: (n, axes) commands, mm and degrees, checked.
            sides: (n, axes) directions of approach, see `at`.

        Returns:
            Their indices into the (6·frames,) vector, and the factor F (n, indices, r), µm and µrad: their covariance is F Fᵀ.
        """
        moved = self.rates(q, sides)
        spread = np.empty((len(moved), len(q), self.factor.shape[1]))
        for i, (_, columns, shape) in enumerate(moved):
            np.matmul(shape, self.factor[columns], out=spread[i])
        return [component for component, _, _ in moved], spread.transpose(1, 0, 2)


def _sides(q: np.ndarray, approach: Any) -> np.ndarray:
    return np.zeros(q.shape) if approach is None else np.atleast_2d(np.asarray(approach, dtype=float))


def _without(calibration: Calibration, known: set[str]) -> tuple[str, ...]:
    """Return the names of errors without any uncertainty, and of single parameters without one in the other errors."""
    found: list[str] = []
    for effect in calibration.effects:
        missing = [parameter.name for parameter in effect.parameters if parameter.name not in known]
        found += [effect.name] if missing and len(missing) == len(effect.parameters) else missing
    return tuple(found)


def _factor(covariance: Covariance) -> np.ndarray:
    """Return F (p, p) with Σ = F Fᵀ, a continuous function of Σ.

    It is computed from the correlation matrix, so that different units do not cost precision.
    """
    scale = np.sqrt(np.diag(covariance.matrix))
    safe = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(scale[:, None] * symmetric_root(covariance.matrix / np.outer(safe, safe)))
