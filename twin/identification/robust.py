"""The robust estimate: first robust weights, then least squares without the outliers."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from twin.identification.discrepancy import Discrepancy, isotropic, residuals_of_estimate, settled, updated
from twin.identification.network import Network
from twin.identification.outliers import RowAssessment, assess_rows
from twin.identification.setup import SetUp
from twin.identification.solve import FitSolution, solve

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
        precision: (columns,) precision of the priors of the machine's unknowns about zero (`twin.identification.priors`).
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
