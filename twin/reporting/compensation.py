"""Expected error after compensation with a calibration: rounding to least increments, limits of travel, and uncertainty.

Compare measured points with a calibration.

Only unknown positions of stations and targets are fitted (`twin.diagnosis.readings`). An estimate is the curve's value plus the
change that would remove the residuals at that position, all else fixed (component plus residual, as in regression diagnostics: Larsen
and McCleary 1972). Its 95 % interval follows from the spread of the readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.records import APPROACH, json_form
from twin._common.units import UM
from twin.compensation.tables import CorrectedShare, RemainingErrors, Request, account_of, make
from twin.controls import TableSum, table_formats
from twin.diagnosis.candidates.candidate import first_component
from twin.diagnosis.plots import group_means, group_numbers
from twin.diagnosis.readings import readings
from twin.identification.network import Network, Unknowns
from twin.identification.solve import solve
from twin.machine.machine import Machine
from twin.measurement.observation import machine_state
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.conditions import required_channels
from twin.model.effects import split_name
from twin.reporting.contributions import Budget, without
from twin.reporting.identified import PointComparison, PositionEstimates, is_motion, sum_of_effects
from twin.tool.forward import Kinematics, rms_and_max
from twin.tool.inverse import Inverse, Status
from twin.tool.population import TAIL, Spread
from twin.tool.uncertainty import ToolUncertainty

MACHINES: Final = 1000
MACHINES_A_STEP: Final = 50
"""Machines drawn at once: 50 at 2,000 poses are 2.4 MB."""
SIZES: Final = 16_000
"""Number of magnitudes kept of a distribution over all drawn machines and poses."""
_BEFORE: Final = Message("uncompensated, with uncertainty")
SHARES: Final = (0.5, 0.95, 0.99)


@final
@dataclass(frozen=True)
class ErrorDistribution:
    """Distribution of the error of the tool point over the volume in one case."""

    name: str
    size_um: np.ndarray  # (k,) magnitudes, ascending
    machines: tuple[Spread, Spread] | None = None  # RMS and largest error over the drawn machines; None for one machine

    @property
    def rms_um(self) -> float:
        """Root mean square, µm."""
        return float(np.sqrt(np.mean(self.size_um**2)))

    @property
    def max_um(self) -> float:
        """Largest magnitude over the volume, µm; for drawn machines its mean over the machines."""
        return float(self.size_um[-1]) if self.machines is None else self.machines[1].mean

    @property
    def max_half_um(self) -> float:
        """Half width of the 95 % interval of the largest magnitude over the drawn machines, µm; NaN for one machine."""
        if self.machines is None:
            return float("nan")
        most = self.machines[1]
        return max(most.high - most.mean, most.mean - most.low)

    def quantile(self, share: float) -> float:
        """Return the magnitude that a given share of the poses does not exceed, µm."""
        return float(np.quantile(self.size_um, share))

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return {
            "rms_um": self.rms_um,
            "max_um": self.max_um,
            "quantiles_um": {f"{share:g}": self.quantile(share) for share in SHARES},
        }


@final
@dataclass(frozen=True)
class CompensationForecast:
    """Error of the tool point before and after compensation."""

    before: ErrorDistribution  # of the machine, including the tables in its control
    without_tables: ErrorDistribution | None  # error without the tables in the control; None if there are none
    exact: ErrorDistribution | None  # if the calibration is exact; None if the machine runs no programs
    with_uncertainty: ErrorDistribution | None  # on drawn machines; None if unknown
    identified: ErrorDistribution | None  # the same without the errors that could not be determined
    expected_before: ErrorDistribution | None  # as ``judged``, uncompensated; None if U is unknown
    not_identified: tuple[str, ...]
    complete: bool  # whether all errors have an uncertainty; if not, ``with_uncertainty`` is a lower bound
    poses: int
    out_of_range: int  # number of poses at which the correction exceeds the travel
    out_of_range_um: float  # largest remaining error at these poses
    orientation_missed: int  # number of poses at which the point is reached but the orientation is not
    tilt_before_urad: tuple[tuple[float, float], tuple[float, float]]  # RMS and largest, about x and about y
    tilt_after_urad: tuple[tuple[float, float], tuple[float, float]] | None
    uncompensated: tuple[Spread, Spread] | None  # RMS and largest error over the drawn machines; None if U is unknown
    seed: int

    @property
    def start(self) -> ErrorDistribution:
        """Error before compensation, as every page gives it: expected, as ``judged``; that of the model if U is unknown."""
        return self.before if self.expected_before is None else self.expected_before

    def with_u(self, rms_um: float) -> float:
        """Return the expected RMS error, µm, of a state with an RMS error by the model: uncertainty adds the same variance to all."""
        return float(np.sqrt(rms_um**2 + max(self.start.rms_um**2 - self.before.rms_um**2, 0.0)))

    @property
    def judged(self) -> ErrorDistribution | None:
        """Expected error after compensation, without the errors that could not be determined, which are the same before and after."""
        return self.with_uncertainty if self.identified is None else self.identified

    @property
    def levels(self) -> tuple[ErrorDistribution, ...]:
        """All available cases, in the order of the report."""
        return tuple(
            one
            for one in (
                self.without_tables,
                self.before,
                self.expected_before,
                self.exact,
                self.identified,
                self.with_uncertainty,
            )
            if one is not None
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON; null for unknown numbers."""
        tilts = [tilt and {"rms": tilt[0], "max": tilt[1]} for tilt in (self.tilt_before_urad, self.tilt_after_urad)]
        after = None if self.with_uncertainty is None else self.with_uncertainty.machines
        return json_form(
            {
                "poses": self.poses,
                "before": self.before,
                "without_control": self.without_tables,
                "compensated_if_exactly_true": self.exact,
                "compensated": self.with_uncertainty,
                "compensated_identified_errors": self.judged,
                "not_identified": self.not_identified,
                "uncompensated_identified_errors": self.expected_before,
                "compensated_complete": self.with_uncertainty is not None and self.complete,
                "out_of_range": self.out_of_range,
                "out_of_range_max_um": self.out_of_range_um,
                "orientation_not_reached": self.orientation_missed,
                "tilt_before_urad": tilts[0],
                "tilt_after_urad": tilts[1],
                "machines": self.uncompensated
                and {
                    "drawn": MACHINES,
                    **dict(zip(("as_it_is_rms", "as_it_is_largest"), self.uncompensated, strict=True)),
                    **dict(zip(("compensated_rms", "compensated_largest"), after or (None, None), strict=True)),
                },
                "seed": self.seed,
            }
        )


def forecast_compensation(found: Budget, seed: int) -> CompensationForecast:
    """Compensate every pose of a budget and return the errors before and after.

    The commands are those of a compensated program: rotary words are rounded to their increment, linear ones solved for the rounded
    rotary positions and then rounded; all are limited to the axis travel.
    """
    real, q, sides = found.kinematics, found.positions, found.sides
    before = np.linalg.norm(found.error_um, axis=1)
    without_tables = None
    if real.calibration.corrections:
        bare = without(real, {table.name for table in real.calibration.corrections})
        remaining_bare = (bare.forward(q, sides).point_mm - found.nominal_poses.point_mm) * 1e3
        without_tables = _distribution(Message("without the control's tables"), remaining_bare)
    exact = with_uncertainty = identified = tilt_after = uncompensated = None
    out = unoriented_count = 0
    worst_out = np.nan
    uncertainty = ToolUncertainty(real)
    deviations = _Deviations(uncertainty, q, sides, seed)
    alone = ToolUncertainty(real, "identified") if uncertainty.unknown else uncertainty
    judged = _Deviations(alone, q, sides, seed) if uncertainty.unknown else deviations
    if real.machine.runs_programs:
        name = Message("compensated, with uncertainty")
        commands, beyond, unoriented = _commanded(found)
        meant, reached = found.nominal_poses, real.forward(commands, sides)
        remaining = (reached.point_mm - meant.point_mm) * 1e3
        exact = _distribution(Message("compensated, for an exact calibration"), remaining)
        tilt_after = rms_and_max(reached.tilt_urad(meant))
        out, unoriented_count = int(np.count_nonzero(beyond)), int(np.count_nonzero(unoriented))
        if out:
            worst_out = float(np.linalg.norm(remaining[beyond], axis=1).max())
        if uncertainty.parameters:
            everything = Message("compensated, with uncertainty and errors not identified")
            with_uncertainty = deviations.distribution(everything if uncertainty.unknown else name, remaining)
        if uncertainty.unknown:
            identified = judged.distribution(name, remaining) if alone.parameters else _distribution(name, remaining)
    expected_before = None
    if uncertainty.parameters:
        every = deviations.distribution(_BEFORE, found.error_um)
        uncompensated = every.machines
        if alone.parameters:
            expected_before = judged.distribution(_BEFORE, found.error_um) if uncertainty.unknown else every
    return CompensationForecast(
        before=ErrorDistribution(Message("uncompensated, by the model alone"), read_only(np.sort(before))),
        without_tables=without_tables,
        exact=exact,
        with_uncertainty=with_uncertainty,
        identified=identified,
        expected_before=expected_before,
        not_identified=uncertainty.unknown,
        complete=not uncertainty.without_uncertainty,
        poses=len(q),
        out_of_range=out,
        out_of_range_um=worst_out,
        orientation_missed=unoriented_count,
        tilt_before_urad=rms_and_max(found.tilt_urad),
        tilt_after_urad=tilt_after,
        uncompensated=uncompensated,
        seed=seed,
    )


def _distribution(name: str, error_um: np.ndarray) -> ErrorDistribution:
    return ErrorDistribution(name, read_only(np.sort(np.linalg.norm(error_um, axis=1))))


def _commanded(found: Budget) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (n, axes) compensated commands, (n,) whether the travel is exceeded, (n,) whether the orientation is missed."""
    real, q, sides = found.kinematics, found.positions, found.sides
    machine, inverse, meant = real.machine, Inverse(real), found.nominal_poses
    approach = sides if real.directed else None
    increment = np.array([axis.increment for axis in machine.axes])
    ranges, domains = machine.limits / machine.scale[:, None], real.calibration.domains()
    low, high = np.maximum(ranges[:, 0], domains[:, 0]), np.minimum(ranges[:, 1], domains[:, 1])
    rotary, linear = list(machine.rotary), list(machine.linear)
    first = inverse.solve(meant, q, approach=approach)
    commands = np.clip(first.positions, low, high)
    commands[:, rotary] = np.clip(np.round(commands / increment) * increment, low, high)[:, rotary]
    second = inverse.solve(meant, commands, rotary=False, approach=approach)
    commands[:, linear] = np.clip(np.round(second.positions / increment) * increment, low, high)[:, linear]
    beyond = second.where(Status.OUT_OF_RANGE)
    return commands, beyond, first.where(Status.SINGULAR) | first.where(Status.OUT_OF_RANGE)


@final
class _Deviations:
    """Deviations of the tool point on machines drawn from the covariance, to first order; the same machines for every case."""

    def __init__(self, uncertainty: ToolUncertainty, q: np.ndarray, sides: np.ndarray, seed: int) -> None:
        self._rates = uncertainty.point_rates(q, sides).reshape(3 * len(q), -1)
        self._drawn = (
            uncertainty.draw(np.random.default_rng(seed), MACHINES) if uncertainty.parameters else np.zeros((0, 0))
        )

    def distribution(self, name: str, error_um: np.ndarray) -> ErrorDistribution:
        """Return the distribution of an error (n, 3), µm, with the deviations of whole drawn machines, not of single poses."""
        count = len(error_um)
        size = np.empty((MACHINES, count))
        for start in range(0, MACHINES, MACHINES_A_STEP):
            part = slice(start, start + MACHINES_A_STEP)
            deviation = (self._rates @ self._drawn[:, part]).reshape(count, 3, -1)
            size[part] = np.linalg.norm(error_um[:, :, None] + deviation, axis=1).T
        machines = _spread(np.sqrt(np.mean(size**2, axis=1))), _spread(size.max(axis=1))
        ordered = np.sort(size, axis=None)
        kept = ((np.arange(SIZES) + 0.5) / SIZES * len(ordered)).astype(int)
        return ErrorDistribution(name, read_only(ordered[kept]), machines)


def _spread(values: np.ndarray) -> Spread:
    low, high = np.quantile(values, (TAIL, 1.0 - TAIL))
    return Spread(float(values.mean()), float(low), float(high), float(values.max()))


@final
@dataclass(frozen=True)
class TablesLeft:
    """Errors that remain with the tables of one format."""

    kind: str  # name of the format: one with tables of single axes, not volumetric as ``isg`` and ``grid``
    at: Mapping[str, float]  # positions of the other axes while one moves, by axis; mm, degrees
    tool_length_mm: float  # tool length for which the tables are made
    remains: RemainingErrors  # the error at the tool with them
    carried: tuple[CorrectedShare, ...]  # every error, and the part of it that the format compensates

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"kind": "format", "remains": "error_at_tool"}, leave_out=("carried",))


def tables_left(
    real: Kinematics, errors: Calibration, missing: Mapping[str, tuple[str, ...]]
) -> tuple[TablesLeft, ...]:
    """Make the tables of every format and return the remaining errors, the most effective format first.

    Empty if the control has tables already, the estimate did not converge or there are no errors. Formats that cannot hold tables of
    this machine are omitted. ``real`` has the errors that can be evaluated, ``errors`` all, ``missing`` the others by channel.
    """
    if errors.control is not None or not errors.settled or real.calibration.empty:
        return ()
    tables: list[TablesLeft] = []
    required = None
    for form in table_formats():
        if form.correction is not TableSum:
            continue
        request = Request(form.name, tool_length_mm=real.tool_length_mm, conditions=real.conditions)
        try:
            made = make(real.machine, real.calibration, request, required)
        except InputError:
            continue
        required = made.required
        account = account_of(made, errors, real.calibration, missing)
        tables.append(TablesLeft(form.name, made.required.at, real.tool_length_mm, account.remains, account.carried))
    return tuple(sorted(tables, key=lambda one: -one.remains.reduction))


# --- Compare measured points with a calibration ---------------------------------------------------

LEGIBLE: Final = 5.0
"""An estimate is omitted if its interval exceeds the curve's largest value by this factor."""
FEWEST: Final = 3
"""Smallest number of positions of an axis for a curve."""
NO_SIDE: Final = 0


def compare_points(data: Measurements, machine: Machine, calibration: Calibration, path: Path) -> PointComparison:
    """Fit the set-up to measured points with a fixed calibration and return the residuals; ``path`` is the file of the data."""
    given = machine_state(data, machine)
    needed = required_channels(calibration.effects, machine)
    absent = {name for channel, by in needed.items() if channel not in given for name in by}
    held = calibration.where(lambda name: name not in absent)
    evaluated = {effect.name for effect in held.effects}
    placed = readings(data, machine, held)
    network, good = placed.network, ~placed.bad
    nominal_network = Network(
        machine, network.data, network.instruments, Unknowns(machine, (), ()), None, network.covariance
    )
    nominal_setup = solve(nominal_network, np.zeros(0), placed.setup, good.astype(float)).setup
    every = np.arange(len(network.data))
    nominal_residual = nominal_network.residuals_m(np.zeros(0), nominal_setup, every)
    residual = network.residuals_m(np.zeros(0), placed.setup, every)
    read = network.read
    return PointComparison(
        source=str(path),
        points=len(every),
        far=int(np.count_nonzero(placed.bad)),
        rms_before_um=_rms(nominal_residual, read),
        rms_after_um=_rms(residual, read),
        noise_source=placed.noise.source,
        before_um=read_only(np.linalg.norm(nominal_residual, axis=1) / UM),
        after_um=read_only(np.linalg.norm(residual, axis=1) / UM),
        stops=MappingProxyType(_estimates(network, placed.setup, held)),
        rows=tuple((note.line, note.text) for note in network.data.set_aside),
        notices=network.data.notices,
        left_out=tuple(effect.name for effect in calibration.effects if effect.name not in evaluated),
    )


def _rms(residual: np.ndarray, read: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residual[read] ** 2))) / UM


def _estimates(
    network: Network, setup: StationsAndTargets, calibration: Calibration
) -> dict[str, tuple[PositionEstimates, ...]]:
    machine, data = network.machine, network.data
    view = network.view(np.zeros(0), setup, np.arange(len(data)))
    state = machine_state(data, machine)
    estimates: dict[str, tuple[PositionEstimates, ...]] = {}
    for name in machine.motion_names:
        component, _, axis = split_name(name)
        q = state[axis]
        if len(np.unique(np.round(q, 3))) < FEWEST:
            continue
        derivative = view.by_error[:, :, first_component(machine, axis) + component]
        weight = np.einsum("ni,ni->n", derivative, derivative)
        if not np.any(weight > 0.0):
            continue
        safe = np.where(weight > 0.0, weight, 1.0)
        off = np.einsum("ni,ni->n", derivative, view.residual) / safe / UM
        # The value of the curve at each reading already includes the direction of approach.
        effects = [effect for effect in calibration.effects if is_motion(effect, axis, calibration)]
        value = sum_of_effects(effects, state, component)
        side = state.get(f"{APPROACH}{axis}", np.zeros(len(q)))
        both = bool(np.any(side > 0) and np.any(side < 0))
        parts = [
            _estimates_of_side(name, way, q, value + off, weight, np.sign(side) == way)
            for way in ((1, -1) if both else ())
        ]
        parts = [part for part in parts if len(part.position)] or [
            _estimates_of_side(name, NO_SIDE, q, value + off, weight, np.ones(len(q), dtype=bool))
        ]
        estimates[name] = tuple(parts)
    return estimates


def _estimates_of_side(
    name: str, side: int, q: np.ndarray, value: np.ndarray, weight: np.ndarray, rows: np.ndarray
) -> PositionEstimates:
    rows = rows & (weight > 0.0)
    if np.count_nonzero(rows) < FEWEST:
        return PositionEstimates(name, side, np.zeros(0), np.zeros(0), np.zeros(0))
    at, mean, half = group_means(q[rows], value[rows], weight[rows], group_numbers(q[rows]))
    legible = half <= LEGIBLE * max(float(np.abs(mean).max(initial=0.0)), 1.0)
    return PositionEstimates(name, side, read_only(at[legible]), read_only(mean[legible]), read_only(half[legible]))
