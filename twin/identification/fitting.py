"""Estimate without outliers, and prior variances of the functions of a curve, estimated from the data.

No fixed number of functions is right: if those beyond are set to zero, intervals are too narrow (on the thesis's plan 95 % intervals
then cover 68 %), and if those within are free, noise becomes a curve. So every function of a curve has a Gaussian prior with mean zero,
whose variance decays from one orthonormal function to the next. Initial size and decay are unknown, especially for a curve within the
noise, and are averaged over (hierarchical model; Gelman 2006). On a grid of sizes and decays every pair is weighted with the likelihood
of the curve's coefficients, all other unknowns integrated out, and with the share of the machine's curves that have this size, which is
estimated from all curves (empirical Bayes; Robbins 1956): on a machine without curves, none is made of the noise of many. The prior
shrinks each coefficient as the average of these models does (`mixed_prior`). A function well above the noise is hardly changed.
Curves that a condition of the datum ties to each other (the two tilts of a rotary axis) have one size and decay together: apart, the
prior of one would be a reading of the other, and both would shrink to zero with an interval far too narrow.

The noise is that of the residuals of the largest model: stated uncertainties that are too large do not increase the shrinkage.

A. Gelman: Prior distributions for variance parameters in hierarchical models, Bayesian Analysis 1 (2006) 515-534.
H. Robbins: An empirical Bayes approach to statistics, Proc. Third Berkeley Symp. Math. Statist. Prob. 1 (1956) 157-163.
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
from twin.identification.network import Network, Unknowns
from twin.identification.solve import FitSolution, Priors, solve
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

    ``triangle``: factor of [J | r] there.
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


def without_outliers(network: Network, start: RobustStart, shrunk: ShrunkStart) -> FinalEstimate:
    """Return least squares on all points that are not its outliers; a point that fits after all is used again.

    The discrepancy in the weights is estimated by restricted maximum likelihood from the residuals of these points.

    ``shrunk``: priors of the machine's unknowns, and the estimate with them at which it starts.
    """
    priors, theta, setup = shrunk
    bad, discrepancy = start.weight == 0.0, start.discrepancy
    seen: set[bytes] = set()
    while True:
        for attempt in range(REWEIGHTINGS):
            weighted = network.with_discrepancy(discrepancy.root)
            solution = solve(
                weighted, theta, setup, (~bad).astype(float), priors=priors, incomplete=start.solution.incomplete
            )
            theta, setup = solution.theta, solution.setup
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
ITERATIONS: Final = 12
FEWEST_DOF: Final = 10
"""Degrees of freedom below which residuals do not determine the noise."""
LEAST_NOISE: Final = 1e-9
"""Least noise, relative to the stated standard deviations: rounding."""
FREE: Final = 1.0
"""Precision of free unknowns, relative to their plausible size; negligible for all that the data determine."""


class ShrunkStart(NamedTuple):
    """The priors of the machine's unknowns, and a linear estimate with them: weak directions have no values of the noise.

    ``priors``: of the machine's unknowns, about zero; ``theta``: (columns,) µm and µrad.
    """

    priors: Priors
    theta: np.ndarray
    setup: StationsAndTargets


def shrunk_start(network: Network, start: RobustStart) -> ShrunkStart:
    """Return the prior of each unknown of the machine, and the estimate with these near a robust one."""
    unknowns, solution = network.unknowns, start.solution
    readings = int(np.count_nonzero(network.read[start.weight > 0.0])) + len(network.certified(solution.setup))
    machine = len(unknowns)
    noise = _noise(solution, readings)
    free = solution.free
    inside = free[:machine, : free.shape[1] - len(solution.setup)]
    triangle = solution.triangle[:, :-1] * solution.spectrum.scale / noise
    here = np.concatenate([solution.theta / unknowns.plausible, np.zeros(len(solution.setup))])
    normal, right = _normal_equations(triangle, solution.triangle[:, -1] / noise + triangle @ here, inside)
    groups = _tied_curves(unknowns, free)
    precision, variance = np.full(len(here), FREE), np.zeros(machine)
    for group in groups:
        precision[group.columns] = 1.0 / SIZES[len(SIZES) // 2] ** 2
    share_of_size = np.full(len(SIZES), 1.0 / len(SIZES))
    for _ in range(ITERATIONS):
        spread = np.linalg.inv(normal + inside.T @ (precision[:machine, None] * inside))
        mean = inside @ (spread @ right)
        # One curve's worth of equal shares is added: a size that no curve has so far remains possible.
        shares = np.full(len(SIZES), 1.0 / len(SIZES))
        for group in groups:
            columns = group.columns
            covariance = inside[columns] @ spread @ inside[columns].T
            mixture = mixed_prior(mean[columns], covariance, precision[columns], share_of_size, group)
            precision[columns], variance[columns] = mixture.precision, mixture.variance
            shares += mixture.share_of_size
        share_of_size = shares / shares.sum()
    unit = unknowns.plausible**2
    # Only curves have priors, and these have a variance.
    priors = Priors(np.where(variance > 0.0, precision[:machine] / unit * noise**2, 0.0), variance * unit / noise**2)
    # A step of orthogonal transformations: normal equations would lose half of the digits.
    root = np.sqrt(precision)[:, None]
    rows = np.concatenate([triangle @ free, root * free])
    step = (
        free
        @ np.linalg.lstsq(rows, np.concatenate([solution.triangle[:, -1] / noise, -root[:, 0] * here]), rcond=None)[0]
    )
    step *= solution.spectrum.scale
    return ShrunkStart(priors, solution.theta + step[:machine], solution.setup.moved(step[machine:]))


def _normal_equations(triangle: np.ndarray, right: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal matrix (f, f) and right side (f,) of the machine's unknowns, the set-up eliminated.

    By orthogonal transformations: where only the sum of a station's and a target's place is determined, normal equations of all
    unknowns have no digit left for the machine's (`twin.identification.orders`).

    ``triangle``: (k, p) derivatives by machine and set-up; ``right``: (k,); ``inside``: (m, f) directions that fulfil all conditions.
    """
    machine = len(inside)
    setup = triangle.shape[1] - machine
    rows = np.column_stack([triangle[:, machine:], triangle[:, :machine] @ inside, right])
    prior = np.sqrt(FREE) * np.eye(setup, rows.shape[1])
    left = np.asarray(np.linalg.qr(np.concatenate([rows, prior]), mode="r"))[setup:, setup:]
    return left[:, :-1].T @ left[:, :-1], left[:, :-1].T @ left[:, -1]


def _noise(solution: FitSolution, readings: int) -> float:
    """Return the size of the whitened residuals of an estimate: less than one if the stated uncertainties are too large."""
    dof = readings - solution.determined
    if solution.incomplete or dof < FEWEST_DOF:
        return 1.0
    return float(np.clip(np.sqrt(solution.chi2 / dof), LEAST_NOISE, 1.0))


class TiedCurves(NamedTuple):
    """Curves that conditions of the datum tie to each other, mostly one.

    ``columns``: (k,) of their coefficients; ``orders``: (k,) order of each within its curve, from 0; ``inside``: (k, f) orthonormal
    directions that fulfil the conditions.
    """

    columns: np.ndarray
    orders: np.ndarray
    inside: np.ndarray


def _tied_curves(unknowns: Unknowns, free: np.ndarray) -> list[TiedCurves]:
    """Return the curves in groups; ``free``: (p, f) directions that fulfil all conditions."""
    columns_of = {curve.name: unknowns.of(curve.name) for curve in unknowns.curves}
    group_of = {name: [name] for name, columns in columns_of.items() if columns}
    for row in unknowns.datum:
        tied = [name for name in group_of if np.any(row[columns_of[name]] != 0.0)]
        together = list(dict.fromkeys(other for name in tied for other in group_of[name]))
        group_of |= dict.fromkeys(together, together)
    groups = []
    for names in {id(group): group for group in group_of.values()}.values():
        columns = np.array([i for name in names for i in columns_of[name]], dtype=int)
        orders = np.concatenate([np.arange(len(columns_of[name])) for name in names])
        directions, size, _ = np.linalg.svd(free[columns], full_matrices=False)
        if np.any(size > 0.5):
            groups.append(TiedCurves(columns, orders, directions[:, size > 0.5]))
    return groups


class Mixture(NamedTuple):
    """The prior of a curve's k coefficients, a mixture of sizes and decays.

    ``precision``: (k,) of the one Gaussian prior that shrinks them as the mixture does; ``variance``: (k,) of the mixture in which each
    size has the same share; ``share_of_size``: (sizes,) probability of each size of this curve.
    """

    precision: np.ndarray
    variance: np.ndarray
    share_of_size: np.ndarray


def mixed_prior(
    mean: np.ndarray, covariance: np.ndarray, precision: np.ndarray, share_of_size: np.ndarray, curves: TiedCurves
) -> Mixture:
    """Return the prior of the coefficients of curves, given the readings.

    The estimate of the mixture is the mean of its members' estimates, each with its own covariance C and the weight of its likelihood.
    With the precision of the readings L, a member's estimate is C L y, so that of the mixture has the mean covariance, and its prior
    has the precision mean(C)⁻¹ − L, of which the diagonal is taken.

    ``mean``: (k,) their estimate under a prior; ``covariance``: (k, k) its covariance; ``precision``: (k,) precision of that prior;
    ``share_of_size``: (sizes,) share of the machine's curves that have each size; ``curves``: the orders of the coefficients and the
    conditions on them.
    """
    inside = curves.inside
    values, vectors = np.linalg.eigh(inside.T @ covariance @ inside)
    # Readings without noise leave no variance; the floor is far below any size of the grid.
    inverse = vectors / np.maximum(values, 1e-14) @ vectors.T
    likelihood = inverse - inside.T @ (precision[:, None] * inside)
    right = inverse @ (inside.T @ mean)
    sizes = (SIZES[:, None, None] * np.sqrt(DECAYS[:, None] ** curves.orders)).reshape(-1, len(mean))
    # Of each prior the part that fulfils the conditions: θ = root ξ with standard normal ξ.
    outside = np.linalg.qr(inside, mode="complete")[0][:, inside.shape[1] :]
    allowed = np.linalg.qr(sizes[:, :, None] * outside, mode="complete")[0][:, :, outside.shape[1] :]
    roots = inside.T @ (sizes[:, :, None] * allowed)
    inner = np.eye(len(likelihood)) + roots.transpose(0, 2, 1) @ likelihood @ roots
    values, vectors = np.linalg.eigh((inner + inner.transpose(0, 2, 1)) / 2.0)
    values = np.maximum(values, 1.0)
    along = np.einsum("gji,gj->gi", roots @ vectors, np.broadcast_to(right, (len(sizes), len(right))))
    log = 0.5 * np.sum(along**2 / values - np.log(values), axis=1) + np.log(np.repeat(share_of_size, len(DECAYS)))
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    spread = roots @ vectors * np.sqrt(weight[:, None] / values)[:, None, :]
    mixed = np.einsum("gij,gkj->ik", spread, spread)
    # A coefficient that the conditions fix has no part in any direction.
    part = np.maximum(np.sum(inside**2, axis=1), 1e-12)
    shrinking = np.diag(inside @ (np.linalg.inv(mixed) - likelihood) @ inside.T) / part
    # Between the precision of the mean variance and the mean precision, its limits for readings that say nothing and everything.
    clipped = np.clip(shrinking, 1.0 / (weight @ sizes**2), weight @ sizes**-2.0)
    # Intervals give each size the same share: they hold for a curve that is unlike the others of its machine, too.
    equal = weight / np.repeat(share_of_size, len(DECAYS))
    variance = equal @ sizes**2 / equal.sum()
    return Mixture(clipped, variance, weight.reshape(len(SIZES), -1).sum(axis=1))
