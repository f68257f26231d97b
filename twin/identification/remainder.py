"""What a curve may still hold beyond the orders chosen for it.

Held-out error says which functions pay; it does not say that the others are zero. Intervals that take them as zero miss: on the
thesis's plan 95 % intervals then cover 68 %. So the functions beyond keep a Gaussian prior with mean zero, whose variance falls from
one orthonormal function to the next. How large it begins and how fast it falls is not known, least of all for a curve given no order:
both are integrated over. On a grid of sizes (uniform in the standard deviation, as Gelman 2006 recommends where few numbers show it)
and falls, every pair is weighted by the likelihood of the curve's own coefficients, all other unknowns integrated out, and the prior
has the mean variance. The chosen functions themselves are free: nothing pulls on what the data show.

A. Gelman: Prior distributions for variance parameters in hierarchical models, Bayesian Analysis 1 (2006) 515-534.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.arrays import locked
from twin.identification.orders import Choice
from twin.identification.solve import Solution, free_directions
from twin.identification.unknowns import Unknowns

FALL: Final = 0.7
"""Ratio of variances from one orthonormal function to the next where one number must do: gentler than a smooth curve's."""
FALLS: Final = locked(np.array([0.15, 0.3, 0.5, 0.7, 0.9]))
"""Ratios that are weighed: from a curve that is smooth to one that is not."""
SIZES: Final = locked(np.geomspace(1e-5, 0.3, 24))
"""Standard deviations of a curve's first function that are weighed, plausible sizes: from 0.01 µm to 300 µm where that is 1 mm."""
SWEEPS: Final = 6
FREE: Final = 1.0
"""Precision of what is free: its plausible size, which decides nothing that the data see."""


def remainder_precision(unknowns: Unknowns, solution: Solution, choice: Choice) -> np.ndarray:
    """(columns,) precision of each unknown about zero, one over µm² or µrad²; zero for what is free.

    Args:
        unknowns: of the largest model.
        solution: its estimate.
        choice: the functions each curve keeps.
    """
    machine = len(unknowns)
    free = free_directions(unknowns.datum, machine, len(solution.setup))
    triangle = solution.triangle[:, :-1] * solution.spectrum.scale / solution.noise
    normal = free.T @ (triangle.T @ triangle) @ free
    here = np.concatenate([solution.theta / unknowns.plausible, np.zeros(len(solution.setup))])
    pull = free.T @ (triangle.T @ (solution.triangle[:, -1] / solution.noise + triangle @ here))
    own = {curve.name: np.array(unknowns.of(curve.name)) for curve in unknowns.curves}
    own = {name: columns for name, columns in own.items() if len(columns)}
    kept = {curve.name: max(choice.counts[curve.name] - curve.first, 0) for curve in unknowns.curves}
    precision = np.full(len(here), FREE)
    for name, columns in own.items():
        precision[columns[kept[name] :]] = 1.0 / SIZES[len(SIZES) // 2] ** 2
    for _ in range(SWEEPS):
        spread = np.linalg.inv(normal + free.T @ (precision[:, None] * free))
        mean = free @ (spread @ pull)
        for name, columns in own.items():
            variance = mean_variance(mean[columns], free[columns] @ spread @ free[columns].T, precision[columns])
            precision[columns[kept[name] :]] = 1.0 / variance[kept[name] :]
    found = np.zeros(machine)
    for name, columns in own.items():
        beyond = columns[kept[name] :]
        found[beyond] = precision[beyond] / unknowns.plausible[beyond] ** 2
    return found


def mean_variance(mean: np.ndarray, covariance: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(k,) variance of each of a curve's coefficients before they are measured, integrated over its size and fall.

    Args:
        mean: (k,) their estimate under a prior.
        covariance: (k, k) of it.
        precision: (k,) of that prior.
    """
    count = len(mean)
    values, vectors = np.linalg.eigh(covariance)
    # What the datum or nothing else fixes has no variance: a floor far below any size that is weighed.
    inverse = vectors / np.maximum(values, 1e-14) @ vectors.T
    likelihood = inverse - np.diag(precision)
    right = inverse @ mean
    falls = np.sqrt(FALLS[:, None] ** np.arange(count))
    sizes = (SIZES[:, None, None] * falls).reshape(-1, count)
    inner = np.eye(count) + sizes[:, :, None] * likelihood * sizes[:, None, :]
    values, vectors = np.linalg.eigh((inner + inner.transpose(0, 2, 1)) / 2.0)
    values = np.maximum(values, 1.0)
    along = np.einsum("gij,gi->gj", vectors, sizes * right)
    log = 0.5 * np.sum(along**2 / values - np.log(values), axis=1)
    # Equal steps of the logarithm: the weight of a size that is uniform in the standard deviation grows with it.
    log += np.repeat(np.log(SIZES), len(FALLS))
    weight = np.exp(log - log.max())
    return np.asarray(weight @ sizes**2 / weight.sum())
