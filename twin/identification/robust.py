"""The estimate that a few wrong points do not pull: robust weights to begin with, least squares without the outliers in the end."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from twin.identification.network import Network
from twin.identification.outliers import JudgedRows, judged
from twin.identification.setup import SetUp
from twin.identification.solve import FitSolution, solve

ROUNDS: Final = 8
FAR: Final = 100.0
"""Whitened residuals of the machine as drawn beyond which it is not tried whether the model fits: no machine tool before a tracker."""
TRIED: Final = 8
"""Steps of that trial."""


class Start(NamedTuple):
    """A robust estimate, and (n,) the weights of the points it ended with: zero for an outlier."""

    solution: FitSolution
    weight: np.ndarray


class FinalEstimate(NamedTuple):
    """Least squares without outliers, and the rows judged by it."""

    solution: FitSolution
    rows: JudgedRows


def robust_start(network: Network, setup: SetUp, triangle: np.ndarray) -> Start:
    """An estimate that a few wrong points do not pull.

    If the model does not fit, it begins with the misfit of the machine as drawn as its noise, so that what the readings say most of is
    fitted first, and goes on with what each estimate leaves.

    Args:
        network: data and model.
        setup: to start from, the machine as drawn.
        triangle: factor of [J | r] there.
    """
    weight = np.ones(len(network.data))
    nothing = np.zeros(len(network.unknowns))
    drawn = judged(network, network.residual(nothing, setup))
    if drawn.noise <= FAR:
        solution = solve(network, nothing, setup, weight, steps=TRIED, triangle=triangle)
        found = _judged(network, solution)
    if drawn.noise > FAR or found.noise > 1.0:
        solution = solve(network, nothing, setup, weight, noise=drawn.noise, triangle=triangle)
        found = _judged(network, solution)
    for _ in range(ROUNDS):
        fits = found.noise >= 0.9 * solution.noise
        if not np.any(found.bad) and np.all(weight == 1.0) and fits and solution.converged:
            return Start(solution, weight)
        fresh = found.weight if np.any(found.bad) or np.any(weight < 1.0) else weight
        still = float(np.abs(fresh - weight).max()) < 0.01 and fits
        weight = fresh
        if still:
            break
        pulled = solution.noise > found.noise == 1.0
        solution = _further(network, solution, weight, found.noise)
        if pulled:
            # From where a prior held it, one step more than to a still one: readings without noise give the errors to the last digits.
            solution = solve(network, solution.theta, solution.setup, weight, steps=1)
        found = _judged(network, solution)
    weight = (~found.bad).astype(float)
    return Start(_further(network, solution, weight, found.noise), weight)


def _judged(network: Network, solution: FitSolution) -> JudgedRows:
    return judged(network, network.residual(solution.theta, solution.setup))


def _further(network: Network, solution: FitSolution, weight: np.ndarray, noise: float) -> FitSolution:
    return solve(network, solution.theta, solution.setup, weight, noise=noise)


def without_outliers(network: Network, start: Start, precision: np.ndarray) -> FinalEstimate:
    """Least squares on all points that are no outliers of it: one is let back in when it fits after all.

    Args:
        network: data and model.
        start: a robust estimate.
        precision: (columns,) of the machine's unknowns about zero (`twin.identification.priors`).
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
        found = _judged(network, solution)
        if np.array_equal(found.bad, bad) or found.bad.tobytes() in seen:
            return FinalEstimate(solution, replace(found, bad=bad))
        seen.add(found.bad.tobytes())
        bad = found.bad
