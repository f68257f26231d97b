"""Estimate without outliers, and prior variances of the functions of a curve, estimated from the data.

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

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from twin._common.arrays import read_only
from twin.identification.discrepancy import (
    Discrepancy,
    RowAssessment,
    assess_rows,
    isotropic,
    residuals_of_estimate,
    settled,
    updated,
)
from twin.identification.network import Network
from twin.identification.solve import FitSolution, solve
from twin.measurement.set_up import StationsAndTargets

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


def robust_start(network: Network, setup: StationsAndTargets, triangle: np.ndarray) -> RobustStart:
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


def _robust(network: Network, setup: StationsAndTargets, triangle: np.ndarray, *, separated: bool) -> RobustStart:
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
    network: Network, rows: RowAssessment, theta: np.ndarray, setup: StationsAndTargets, weight: np.ndarray
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
        assessed = _assessed(network, solution)
        if np.array_equal(assessed.bad, bad) or assessed.bad.tobytes() in seen:
            return FinalEstimate(solution, discrepancy, replace(assessed, bad=bad))
        seen.add(assessed.bad.tobytes())
        bad = assessed.bad


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
    prior_precision = np.zeros(machine)
    for columns in own.values():
        prior_precision[columns] = precision[columns] / unknowns.plausible[columns] ** 2 * noise**2
    return prior_precision


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
