"""Agreement of commands and readings: rows that do not fit, and columns that are swapped, mirrored or in another unit.

Prior variances of the functions of a curve, estimated from the data.

No fixed number of functions is right: if those beyond are set to zero, intervals are too narrow (on the thesis's plan 95 % intervals
then cover 68 %), and if those within are free, noise becomes a curve. So every function of a curve has a Gaussian prior with mean zero,
whose variance decays from one orthonormal function to the next. Initial size and decay are unknown, especially for a curve within the
noise, and are integrated over. On a grid of sizes (uniform in the variance, so that for a curve that the readings hardly determine the
large sizes they allow count) and decays, every pair is weighted with the likelihood of the curve's coefficients, all other unknowns
integrated out; the prior has the mean variance (hierarchical model; Gelman 2006). A function well above the noise is hardly changed.

The noise is that of the residuals of the largest model: stated uncertainties that are too large do not increase the shrinkage.

A. Gelman: Prior distributions for variance parameters in hierarchical models, Bayesian Analysis 1 (2006) 515-534.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.discrepancy import (
    Discrepancy,
    RowAssessment,
    assess_rows,
    isotropic,
    residuals_of_estimate,
    settled,
    updated,
)
from twin.identification.network import Network, SetUp
from twin.identification.solve import FitSolution, solve
from twin.identification.start import LARGEST_MISFIT_M, initial_setup, nominal_carriers
from twin.machine.machine import Machine
from twin.measurement.checks import RowNote, outside_axis_range
from twin.measurement.columns import POINT_COLUMNS
from twin.measurement.instruments import StationInstruments
from twin.measurement.table import Measurements

WRONG_COLUMN_SHARE: Final = 0.2
"""Share of rows with misfits of centimetres above which a column is wrong, not single rows."""
SUSPECT_COLUMN_SHARE: Final = 0.02
"""Share of such rows above which swapped or mirrored columns are tried."""
NOMINAL_SHARE: Final = 0.01
"""Largest deviation of a machine from its nominal geometry, as a share of the measured motion."""
OUTLYING_FACTOR: Final = 10.0
"""Multiple of the median misfit above which a row is wrong."""
SUSPECT_RATIO: Final = 0.1
"""Ratio of misfit to motion above which other units are tried."""
UNRELATED_RATIO: Final = 0.5
"""Ratio of misfit to motion above which the readings do not follow the commands at all."""
CLEAR_MOTION_M: Final = 5e-4
"""Motion, m, below which drift and noise may be as large, so that readings need not follow the commands."""
LEAST_MOTION_M: Final = 1e-5
"""Motion, m, below which readings are not compared with commands."""
GOOD_RATIO: Final = 0.05
"""Ratio of misfit to motion below which a change of unit explains the readings."""
IMPROVEMENT: Final = 5.0
"""Factor by which a change must reduce the misfit, or the number of wrong rows, to be reported."""
TRIAL_ROWS: Final = 200
"""Number of rows on which changes of columns are tried."""
UNITS: Final = (("metres", 1000.0), ("inches", 25.4))
RADIANS: Final = 180.0 / np.pi
Change = tuple[Measurements, str]


def agreeing_rows(machine: Machine, data: Measurements, instruments: StationInstruments) -> tuple[Measurements, SetUp]:
    """Return the rows whose command agrees with the measured motion, and the set-up estimated with the nominal machine.

    Args:
        machine: the machine.
        data: the measurements.
        instruments: those of its stations.

    Raises:
        InputError: more than a fifth of the rows do not agree, or fewer that agree after one change of the columns, or readings that
            do not follow the commands; with the change that would make them agree, if there is one.
    """
    try:
        setup, miss = initial_setup(machine, data, instruments)
    except InputError:
        # Readings in a left-handed frame may be due to one wrong command column; if several would explain them, the frame is wrong.
        candidates = _one_change(machine, data, 1.0, np.inf, instruments)
        if len(candidates) != 1:
            raise
        raise data.error(
            f"commands and readings do not agree: {candidates[0][1]}",
            expected=f"readings that follow the commands of {machine.name}",
            row=0,
        ) from None
    limit = miss_limit(data, miss)
    bad = miss > limit
    share = float(np.mean(bad))
    ratio, motion = misfit_ratio(machine, data, setup, miss)
    candidates = (
        _one_change(machine, data, share, ratio, instruments)
        if share > SUSPECT_COLUMN_SHARE or ratio > SUSPECT_RATIO
        else []
    )
    if candidates or share > WRONG_COLUMN_SHARE or (ratio > UNRELATED_RATIO and motion > CLEAR_MOTION_M):
        worst = int(np.argmax(miss))
        raise data.error(
            f"commands and readings do not agree: {min(candidates)[1] if candidates else _description(machine, data, miss, limit)}",
            expected=f"readings that follow the commands of {machine.name} within {min(limit, motion) / MM:.2g} mm",
            row=worst,
            value=f"deviation {miss[worst] / MM:.3g} mm",
        )
    if not np.any(bad):
        return data, setup
    notes = _notes_of_disagreement(data, bad, miss)
    agreeing = replace(data.select(~bad), set_aside=(*data.set_aside, *notes))
    if set(agreeing.target) != set(data.target) or set(agreeing.station) != set(data.station):
        without_rows = sorted({*data.target, *data.station} - {*agreeing.target, *agreeing.station})
        raise InputError(
            f"no reading of {', '.join(without_rows)} agrees with its command",
            expected="readings that follow the commands",
            file=data.source,
            line=notes[0].line,
        )
    return agreeing, initial_setup(machine, agreeing, instruments)[0]


def _notes_of_disagreement(data: Measurements, bad: np.ndarray, miss: np.ndarray) -> tuple[RowNote, ...]:
    """Return a note for each of the bad rows."""
    causes = "wrong position, wrong target or lost beam"
    return tuple(
        RowNote(
            int(data.lines[row]),
            f"the reading disagrees with the command by {miss[row] / MM:.1f} mm (target {data.target[row]}, "
            f"round {data.round[row]}): {causes}",
            kind=f"the reading disagrees with the command: {causes}",
            size=float(miss[row]),
        )
        for row in np.flatnonzero(bad)
    )


def miss_limit(data: Measurements, miss: np.ndarray) -> float:
    """Return the largest misfit with the nominal machine that is accepted, metres.

    A machine that differs from its nominal geometry everywhere (an uncalibrated robot) has misfits of millimetres in every row,
    of similar size; wrong rows stand out from them. A median misfit that is a large part of the motion is neither case.
    """
    typical = float(np.median(miss))
    read = data.point_mm[:, np.isfinite(data.point_mm).any(axis=0)]
    span = float(np.linalg.norm(np.nanmax(read, axis=0) - np.nanmin(read, axis=0))) * MM
    return max(LARGEST_MISFIT_M, OUTLYING_FACTOR * typical) if typical < NOMINAL_SHARE * span else LARGEST_MISFIT_M


def misfit_ratio(machine: Machine, data: Measurements, setup: SetUp, miss: np.ndarray) -> tuple[float, float]:
    """Return mean misfit over mean commanded motion of the targets (for lengths, over their change), and the largest motion.

    A row's misfit is limited to the largest motion, so that a lost beam does not dominate. Zero if hardly anything moves. Metres.
    """
    carried = nominal_carriers(machine, data)
    index = {name: i for i, name in enumerate(setup.targets)}
    place = setup.place[[index[name] for name in data.target]]
    points = carried.points + np.einsum("nij,nj->ni", carried.rotation, place)
    kind = np.array([setup.reads[setup.stations.index(name)].reads for name in data.station])
    lengths = np.zeros_like(points)
    lengths[:, 0] = np.nan_to_num(data.point_mm[:, 0]) * MM
    points = np.where((kind == "length")[:, None], lengths, points)
    if np.any(kind == "null"):  # the target is always at the station's origin: the motion is that of the linear axes
        linear = np.array([axis.linear for axis in machine.axes])
        travel = np.linalg.norm(np.where(linear, data.positions - np.median(data.positions, axis=0), 0.0), axis=1) * MM
        points = np.where((kind == "null")[:, None], travel[:, None] * np.array([1.0, 0.0, 0.0]), points)
    moved = np.empty(len(points))
    for station, target in dict.fromkeys(zip(data.station, data.target, strict=True)):
        rows = (data.station == station) & (data.target == target)
        moved[rows] = np.linalg.norm(points[rows] - np.median(points[rows], axis=0), axis=1)
    largest = float(moved.max())
    if largest <= LEAST_MOTION_M:
        return 0.0, largest
    return float(np.minimum(miss, largest).sum() / moved.sum()), largest


def other_unit(machine: Machine, data: Measurements, instruments: StationInstruments) -> str | None:
    """Return, in words, which columns would agree in another unit; None if none would, or if all agree as given."""
    try:
        setup, miss = initial_setup(machine, data, instruments)
    except InputError:
        return None
    ratio = misfit_ratio(machine, data, setup, miss)[0]
    candidates = _in_units(machine, _sample(data), 1.0, ratio, instruments) if ratio > SUSPECT_RATIO else []
    return candidates[0][1] if candidates else None


def _one_change(
    machine: Machine, data: Measurements, share: float, ratio: float, instruments: StationInstruments
) -> list[tuple[float, str]]:
    """Return the changes that make the readings agree: two columns swapped, one with opposite sign, some in another unit.

    Args:
        machine: the machine.
        data: the measurements.
        share: share of rows that do not agree.
        ratio: misfit over motion.
        instruments: those of its stations.

    Returns:
        Misfit over motion and description of each change.
    """
    sample = _sample(data)
    found = []
    for changed, text in _swapped_or_mirrored(machine, sample):
        after = _fit_after(machine, changed, instruments)
        if after is not None and (
            after[1] < share / IMPROVEMENT
            if share > SUSPECT_COLUMN_SHARE
            else after[0] < min(GOOD_RATIO, ratio / IMPROVEMENT)
        ):
            found.append((after[0], text))
    return found or _in_units(machine, sample, share, ratio, instruments)


def _in_units(
    machine: Machine, data: Measurements, share: float, ratio: float, instruments: StationInstruments
) -> list[tuple[float, str]]:
    """Return the change of unit that explains the readings, as `_one_change`; equivalent changes are joined in its description."""
    for single in (False, True):
        found = []
        for changed, text in _units(machine, data, single=single):
            after = _fit_after(machine, changed, instruments)
            if (
                after is not None
                and after[0] < min(GOOD_RATIO, ratio / IMPROVEMENT)
                and after[1] <= share / IMPROVEMENT
            ):
                found.append((after[0], text))
        if found:
            best = min(size for size, _ in found)
            return [(best, ", or ".join(text for size, text in found if size <= 2.0 * best))]
    return []


def _fit_after(machine: Machine, changed: Measurements, instruments: StationInstruments) -> tuple[float, float] | None:
    """Return misfit over motion and the share of wrong rows; None if no station can be placed, or nothing moves."""
    try:
        setup, miss = initial_setup(machine, changed, instruments)
    except InputError:
        return None
    ratio, motion = misfit_ratio(machine, changed, setup, miss)
    if motion <= LEAST_MOTION_M:
        return None  # swapped with an axis that did not move: without motion anything fits
    return ratio, float(np.mean(miss > miss_limit(changed, miss)))


def _sample(data: Measurements) -> Measurements:
    """Return rows, evenly distributed over the table, on which changes are tried."""
    return data.select(np.linspace(0, len(data) - 1, min(len(data), TRIAL_ROWS)).astype(int))


def _swapped_or_mirrored(machine: Machine, data: Measurements) -> Iterator[Change]:
    """Yield the data with two command columns swapped, and with the sign of one reversed."""
    names, moving = _columns(machine), _moving(data)
    for i, j in combinations(range(len(names)), 2):
        if i in moving or j in moving:
            swapped = np.array(data.positions)
            swapped[:, [i, j]] = swapped[:, [j, i]]
            yield replace(data, positions=read_only(swapped)), f"columns {names[i]} and {names[j]} look swapped"
    for i in moving:
        yield _scaled(data, "positions", [i], -1.0), f"column {names[i]} appears to have the wrong sign"


def _units(machine: Machine, data: Measurements, *, single: bool) -> Iterator[Change]:
    """Yield the data with commands or readings converted from another unit: single columns, or all columns."""
    names, moving = _columns(machine), _moving(data)
    linear = [i for i in moving if machine.axes[i].linear]
    rotary = [i for i in moving if not machine.axes[i].linear]
    for columns, unit, factor in (*((linear, *unit) for unit in UNITS), (rotary, "radians", RADIANS)):
        for some in _column_groups(columns, single):
            changed = _scaled(data, "positions", some, factor)
            if not any(np.any(outside_axis_range(machine.axes[i], changed.positions[:, i])) for i in some):
                yield changed, _unit_text([names[i] for i in some], unit, factor)
    read = [i for i in range(3) if np.isfinite(data.point_mm[:, i]).any()]
    for unit, factor in (*UNITS, ("micrometres", 1e-3)):
        for some in _column_groups(read, single):
            yield _scaled(data, "point_mm", some, factor), _unit_text([POINT_COLUMNS[i] for i in some], unit, factor)


def _scaled(data: Measurements, field: str, columns: list[int], factor: float) -> Measurements:
    values = np.array(getattr(data, field))
    values[:, columns] *= factor
    changed: dict[str, Any] = {field: read_only(values)}
    return replace(data, **changed)


def _column_groups(columns: list[int], single: bool) -> list[list[int]]:
    """Return each of several columns by itself, or all together."""
    if single:
        return [[one] for one in columns] if len(columns) > 1 else []
    return [columns] if columns else []


def _unit_text(names: list[str], unit: str, factor: float) -> str:
    meant = "degrees" if unit == "radians" else "millimetres"
    look = f"columns {', '.join(names)} look" if len(names) > 1 else f"column {names[0]} looks"
    return f"{look} like {unit}, not {meant} (factor {factor:.4g})"


def _description(machine: Machine, data: Measurements, miss: np.ndarray, limit: float) -> str:
    """Return the share of wrong rows, and the axis whose motion most of them share, in words."""
    by_axis = [
        (float(np.median(miss[data.positions[:, i] != np.median(data.positions[:, i])])), i) for i in _moving(data)
    ]
    _, worst = max(by_axis, default=(0.0, 0))
    share = float(np.mean(miss > limit))
    if share <= WRONG_COLUMN_SHARE:
        return "the readings change, but not as the commands do"
    return f"{share:.0%} of the readings deviate by more than {limit / MM:.2g} mm, mostly where {_columns(machine)[worst]} changes"


def _columns(machine: Machine) -> list[str]:
    return [f"{axis.name}_{axis.unit}" for axis in machine.axes]


def _moving(data: Measurements) -> list[int]:
    return [i for i in range(data.positions.shape[1]) if np.ptp(data.positions[:, i]) > 0.0]


# --- The robust estimate: first robust weights, then least squares without the outliers -----------

ROUNDS: Final = 8
HOPELESS_MISFIT: Final = 100.0
"""Whitened residuals of the nominal machine above which a fit within the noise is not tried: no machine tool has such residuals."""
TRIAL_STEPS: Final = 8
"""Number of steps of that trial."""
REWEIGHTINGS: Final = 6
"""Number of estimates with other weights, at most."""


class RobustStart(NamedTuple):
    """A robust estimate.

    Attributes:
        solution: the estimate.
        weight: (n,) the final weights of the points: zero for an outlier.
        discrepancy: residuals of most rows beyond the noise, isotropic (`RowAssessment.size_m`).
        noise: size of the residuals of most rows, as in `RowAssessment`; one if the model fits.
        gaps: whether the gaps between outliers and other rows made a difference.
    """

    solution: FitSolution
    weight: np.ndarray
    discrepancy: Discrepancy
    noise: float
    gaps: bool


class FinalEstimate(NamedTuple):
    """Least squares without outliers, the discrepancy in its weights, and the assessment of the rows by it."""

    solution: FitSolution
    discrepancy: Discrepancy
    rows: RowAssessment


def robust_start(network: Network, setup: SetUp, triangle: np.ndarray) -> RobustStart:
    """Return an estimate that is not affected by a few wrong points.

    A misfit may be the effect of the outliers on the estimate. If the model fits without any row beyond the limit, these are the
    outliers; if it does not, only those that a gap separates from the other rows.

    Args:
        network: data and model.
        setup: initial set-up with the nominal machine.
        triangle: factor of [J | r] there.
    """
    start = _robust(network, setup, triangle, separated=False)
    if start.noise > 1.0 and start.gaps:
        return _robust(network, setup, triangle, separated=True)
    return start


def _robust(network: Network, setup: SetUp, triangle: np.ndarray, *, separated: bool) -> RobustStart:
    """Return a robust estimate; ``separated``: whether a gap separates every outlier from the other rows of a misfitting model.

    If the model does not fit, the first discrepancy is the misfit of the nominal machine, so that well-determined unknowns are fitted
    first; each further step uses the misfit of the estimate before.
    """
    weight = np.ones(len(network.data))
    zero = np.zeros(len(network.unknowns))
    used = assess_rows(network, network.residual(zero, setup))
    fits_yet = used.noise <= HOPELESS_MISFIT
    if fits_yet:
        solution = solve(network, zero, setup, weight, steps=TRIAL_STEPS, triangle=triangle)
        found = _assessed(network, solution)
    if not fits_yet or found.noise > 1.0:
        solution = _weighted(network, used, zero, setup, weight)
        found = _assessed(network, solution)
    else:
        used = found
    gaps = False
    for _ in range(ROUNDS):
        bad = found.bad if separated else found.beyond
        gaps = gaps or not np.array_equal(found.bad, found.beyond)
        fits = found.noise >= 0.9 * used.noise
        if not np.any(bad) and np.all(weight == 1.0) and fits and solution.converged:
            return RobustStart(solution, weight, isotropic(network, used.size_m), found.noise, gaps)
        new_weight = found.weight if np.any(bad) or np.any(weight < 1.0) else weight
        steady = float(np.abs(new_weight - weight).max()) < 0.01 and fits
        weight = new_weight
        if steady:
            break
        had_prior = used.noise > found.noise == 1.0
        used = found
        solution = _weighted(network, used, solution.theta, solution.setup, weight)
        if had_prior:
            # One step more after a prior was active, so that noise-free readings give the errors to the last digits.
            solution = solve(network, solution.theta, solution.setup, weight, steps=1)
        found = _assessed(network, solution)
    weight = (~(found.bad if separated else found.beyond)).astype(float)
    solution = _weighted(network, found, solution.theta, solution.setup, weight)
    return RobustStart(solution, weight, isotropic(network, found.size_m), found.noise, gaps)


def _assessed(network: Network, solution: FitSolution) -> RowAssessment:
    return assess_rows(network, network.residual(solution.theta, solution.setup))


def _weighted(
    network: Network, rows: RowAssessment, theta: np.ndarray, setup: SetUp, weight: np.ndarray
) -> FitSolution:
    """Return the estimate weighted by the noise and by the misfit of an assessment."""
    weighted = network.with_discrepancy(isotropic(network, rows.size_m).root)
    return solve(weighted, theta, setup, weight, incomplete=rows.noise > 1.0)


def without_outliers(network: Network, start: RobustStart, precision: np.ndarray) -> FinalEstimate:
    """Return least squares on all points that are not its outliers; a point that fits after all is used again.

    The discrepancy in the weights is estimated by restricted maximum likelihood from the residuals of these points.

    Args:
        network: data and model.
        start: a robust estimate.
        precision: (columns,) precision of the priors of the machine's unknowns about zero (`twin.identification.fitting`).
    """
    solution, bad, discrepancy = start.solution, start.weight == 0.0, start.discrepancy
    seen: set[bytes] = set()
    triangle: np.ndarray | None = solution.triangle
    while True:
        for attempt in range(REWEIGHTINGS):
            weighted = network.with_discrepancy(discrepancy.root)
            solution = solve(
                weighted,
                solution.theta,
                solution.setup,
                (~bad).astype(float),
                precision=precision,
                incomplete=start.solution.incomplete,
                triangle=triangle,
            )
            triangle = None
            further = updated(network, discrepancy, *residuals_of_estimate(weighted, solution), ~bad)
            if settled(network, discrepancy, further) or attempt == REWEIGHTINGS - 1:
                break
            discrepancy = further
        found = _assessed(network, solution)
        if np.array_equal(found.bad, bad) or found.bad.tobytes() in seen:
            return FinalEstimate(solution, discrepancy, replace(found, bad=bad))
        seen.add(found.bad.tobytes())
        bad = found.bad


# --- Prior variances of the functions of a curve, estimated from the data -------------------------

DECAYS: Final = read_only(np.array([0.02, 0.05, 0.15, 0.3, 0.5, 0.7, 0.9, 1.0]))
"""Decay ratios of the grid: from a nearly straight line to a curve as rough as its highest function."""
SIZES: Final = read_only(np.geomspace(1e-5, 0.3, 24))
"""Standard deviations of a curve's first function in the grid, relative to its plausible size: 0.01 µm to 300 µm if that is 1 mm."""
ITERATIONS: Final = 6
FEWEST_DOF: Final = 10
"""Degrees of freedom below which residuals do not determine the noise."""
LEAST_NOISE: Final = 1e-9
"""Least noise, relative to the stated standard deviations: rounding."""
FREE: Final = 1.0
"""Precision of free unknowns, relative to their plausible size; negligible for all that the data determine."""


def prior_precision(network: Network, start: RobustStart) -> np.ndarray:
    """Return (columns,) the precision of each unknown's prior about zero, one over µm² or µrad².

    Zero for unknowns without a prior.

    Args:
        network: data and the largest model.
        start: a robust estimate of it.
    """
    unknowns, solution = network.unknowns, start.solution
    readings = int(np.count_nonzero(network.read[start.weight > 0.0]))
    machine = len(unknowns)
    noise = _noise(solution, readings)
    free = solution.free
    triangle = solution.triangle[:, :-1] * solution.spectrum.scale / noise
    normal = free.T @ (triangle.T @ triangle) @ free
    here = np.concatenate([solution.theta / unknowns.plausible, np.zeros(len(solution.setup))])
    right = free.T @ (triangle.T @ (solution.triangle[:, -1] / noise + triangle @ here))
    own = {curve.name: np.array(unknowns.of(curve.name)) for curve in unknowns.curves}
    own = {name: columns for name, columns in own.items() if len(columns)}
    precision = np.full(len(here), FREE)
    for columns in own.values():
        precision[columns] = 1.0 / SIZES[len(SIZES) // 2] ** 2
    for _ in range(ITERATIONS):
        spread = np.linalg.inv(normal + free.T @ (precision[:, None] * free))
        mean = free @ (spread @ right)
        for columns in own.values():
            covariance = free[columns] @ spread @ free[columns].T
            precision[columns] = 1.0 / mean_variance(mean[columns], covariance, precision[columns])
    found = np.zeros(machine)
    for columns in own.values():
        found[columns] = precision[columns] / unknowns.plausible[columns] ** 2 * noise**2
    return found


def _noise(solution: FitSolution, readings: int) -> float:
    """Return the size of the whitened residuals of an estimate: less than one if the stated uncertainties are too large."""
    dof = readings - solution.determined
    if solution.incomplete or dof < FEWEST_DOF:
        return 1.0
    return float(np.clip(np.sqrt(solution.chi2 / dof), LEAST_NOISE, 1.0))


def mean_variance(mean: np.ndarray, covariance: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return (k,) the prior variances of a curve's coefficients, integrated over size and decay.

    Args:
        mean: (k,) their estimate under a prior.
        covariance: (k, k) its covariance.
        precision: (k,) precision of that prior.
    """
    count = len(mean)
    values, vectors = np.linalg.eigh(covariance)
    # Combinations fixed by the datum have no variance; the floor is far below any size of the grid.
    inverse = vectors / np.maximum(values, 1e-14) @ vectors.T
    likelihood = inverse - np.diag(precision)
    right = inverse @ mean
    falls = np.sqrt(DECAYS[:, None] ** np.arange(count))
    sizes = (SIZES[:, None, None] * falls).reshape(-1, count)
    inner = np.eye(count) + sizes[:, :, None] * likelihood * sizes[:, None, :]
    values, vectors = np.linalg.eigh((inner + inner.transpose(0, 2, 1)) / 2.0)
    values = np.maximum(values, 1.0)
    along = np.einsum("gij,gi->gj", vectors, sizes * right)
    log = 0.5 * np.sum(along**2 / values - np.log(values), axis=1)
    # The grid has equal steps of the logarithm, so a weight that is uniform in the variance increases with the square of the size.
    log += 2.0 * np.repeat(np.log(SIZES), len(DECAYS))
    weight = np.exp(log - log.max())
    return np.asarray(weight @ sizes**2 / weight.sum())
