"""How large the functions of a curve are before they are measured.

No number of functions is the right one: to take those beyond as zero makes intervals that miss (on the thesis's plan 95 % intervals
then cover 68 %), and to take those within as free makes a curve of the noise that chose them. So every function of a curve has a
Gaussian prior with mean zero, whose variance falls from one orthonormal function to the next. How large it begins and how fast it
falls is not known, least of all for a curve within the noise: both are integrated over. On a grid of sizes (uniform in the variance:
of a curve that the readings hardly show, the large sizes that they allow must count) and falls, every pair is weighted by the
likelihood of the curve's coefficients, all other unknowns integrated out, and the prior has the mean variance (hierarchical model;
Gelman 2006). A function that stands out of the noise is hardly pulled.

The noise is that of the readings as they scatter about the largest model: stated uncertainties that are too large pull no harder.

A. Gelman: Prior distributions for variance parameters in hierarchical models, Bayesian Analysis 1 (2006) 515-534.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.arrays import locked
from twin.identification.network import Network
from twin.identification.robust import Start
from twin.identification.solve import FitSolution

FALLS: Final = locked(np.array([0.02, 0.05, 0.15, 0.3, 0.5, 0.7, 0.9, 1.0]))
"""Ratios that are weighed: from a line with little beside it to a curve as rough as its highest function."""
SIZES: Final = locked(np.geomspace(1e-5, 0.3, 24))
"""Standard deviations of a curve's first function that are weighed, plausible sizes: from 0.01 µm to 300 µm where that is 1 mm."""
SWEEPS: Final = 6
FEWEST_DOF: Final = 10
"""Degrees of freedom below which residuals say nothing of the noise."""
LEAST_NOISE: Final = 1e-9
"""Of stated standard deviations: rounding."""
FREE: Final = 1.0
"""Precision of what is free: its plausible size, which decides nothing that the data see."""


def prior_precision(network: Network, start: Start) -> np.ndarray:
    """(columns,) precision of each unknown about zero for a noise of `FitSolution.noise`, one over µm² or µrad²; zero for what is free.

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
    pull = free.T @ (triangle.T @ (solution.triangle[:, -1] / noise + triangle @ here))
    own = {curve.name: np.array(unknowns.of(curve.name)) for curve in unknowns.curves}
    own = {name: columns for name, columns in own.items() if len(columns)}
    precision = np.full(len(here), FREE)
    for columns in own.values():
        precision[columns] = 1.0 / SIZES[len(SIZES) // 2] ** 2
    for _ in range(SWEEPS):
        spread = np.linalg.inv(normal + free.T @ (precision[:, None] * free))
        mean = free @ (spread @ pull)
        for columns in own.values():
            covariance = free[columns] @ spread @ free[columns].T
            precision[columns] = 1.0 / mean_variance(mean[columns], covariance, precision[columns])
    found = np.zeros(machine)
    for columns in own.values():
        found[columns] = precision[columns] / unknowns.plausible[columns] ** 2 * (noise / solution.noise) ** 2
    return found


def _noise(solution: FitSolution, readings: int) -> float:
    """Size of the whitened residuals of an estimate: less than one where the stated uncertainties are larger than the scatter."""
    dof = readings - solution.determined
    if solution.noise > 1.0 or dof < FEWEST_DOF:
        return solution.noise
    return float(np.clip(np.sqrt(solution.chi2 / dof), LEAST_NOISE, 1.0))


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
    # Equal steps of the logarithm: the weight of a size that is uniform in the variance grows with its square.
    log += 2.0 * np.repeat(np.log(SIZES), len(FALLS))
    weight = np.exp(log - log.max())
    return np.asarray(weight @ sizes**2 / weight.sum())
