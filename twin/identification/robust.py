"""The robust estimate: first robust weights, then least squares without the outliers."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from twin.identification.network import Network
from twin.identification.outliers import RowAssessment, assess_rows
from twin.identification.setup import SetUp
from twin.identification.solve import FitSolution, solve

ROUNDS: Final = 8
HOPELESS_MISFIT: Final = 100.0
"""Whitened residuals of the nominal machine above which a fit within the noise is not tried: no machine tool has such residuals."""
TRIAL_STEPS: Final = 8
"""Number of steps of that trial."""


class RobustStart(NamedTuple):
    """A robust estimate.

    Attributes:
        solution: the estimate.
        weight: (n,) the final weights of the points: zero for an outlier.
        noise: size of the residuals of most rows, as in `RowAssessment`; one if the model fits.
        gaps: whether the gaps between outliers and other rows made a difference.
    """

    solution: FitSolution
    weight: np.ndarray
    noise: float
    gaps: bool


class FinalEstimate(NamedTuple):
    """Least squares without outliers, and the assessment of the rows by it."""

    solution: FitSolution
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

    If the model does not fit, the first noise is the misfit of the nominal machine, so that well-determined unknowns are fitted first;
    each further step uses the misfit of the estimate before.
    """
    weight = np.ones(len(network.data))
    zero = np.zeros(len(network.unknowns))
    nominal = assess_rows(network, network.residual(zero, setup))
    if nominal.noise <= HOPELESS_MISFIT:
        solution = solve(network, zero, setup, weight, steps=TRIAL_STEPS, triangle=triangle)
        found = _assessed(network, solution)
    if nominal.noise > HOPELESS_MISFIT or found.noise > 1.0:
        solution = solve(network, zero, setup, weight, noise=nominal.noise, triangle=triangle)
        found = _assessed(network, solution)
    gaps = False
    for _ in range(ROUNDS):
        bad = found.bad if separated else found.beyond
        gaps = gaps or not np.array_equal(found.bad, found.beyond)
        fits = found.noise >= 0.9 * solution.noise
        if not np.any(bad) and np.all(weight == 1.0) and fits and solution.converged:
            return RobustStart(solution, weight, found.noise, gaps)
        new_weight = found.weight if np.any(bad) or np.any(weight < 1.0) else weight
        settled = float(np.abs(new_weight - weight).max()) < 0.01 and fits
        weight = new_weight
        if settled:
            break
        had_prior = solution.noise > found.noise == 1.0
        solution = _continued(network, solution, weight, found.noise)
        if had_prior:
            # One step more after a prior was active, so that noise-free readings give the errors to the last digits.
            solution = solve(network, solution.theta, solution.setup, weight, steps=1)
        found = _assessed(network, solution)
    weight = (~(found.bad if separated else found.beyond)).astype(float)
    return RobustStart(_continued(network, solution, weight, found.noise), weight, found.noise, gaps)


def _assessed(network: Network, solution: FitSolution) -> RowAssessment:
    return assess_rows(network, network.residual(solution.theta, solution.setup))


def _continued(network: Network, solution: FitSolution, weight: np.ndarray, noise: float) -> FitSolution:
    return solve(network, solution.theta, solution.setup, weight, noise=noise)


def without_outliers(network: Network, start: RobustStart, precision: np.ndarray) -> FinalEstimate:
    """Return least squares on all points that are not its outliers; a point that fits after all is used again.

    Args:
        network: data and model.
        start: a robust estimate.
        precision: (columns,) precision of the priors of the machine's unknowns about zero (`twin.identification.priors`).
    """
    solution, bad = start.solution, start.weight == 0.0
    seen: set[bytes] = set()
    triangle: np.ndarray | None = solution.triangle
    while True:
        solution = solve(
            network,
            solution.theta,
            solution.setup,
            (~bad).astype(float),
            precision=precision,
            noise=solution.noise,
            triangle=triangle,
        )
        triangle = None
        found = _assessed(network, solution)
        if np.array_equal(found.bad, bad) or found.bad.tobytes() in seen:
            return FinalEstimate(solution, replace(found, bad=bad))
        seen.add(found.bad.tobytes())
        bad = found.bad
