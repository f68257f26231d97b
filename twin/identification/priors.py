"""Prior variances of the functions of a curve, estimated from the data.

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

from typing import Final

import numpy as np

from twin._common.arrays import read_only
from twin.identification.network import Network
from twin.identification.robust import RobustStart
from twin.identification.solve import FitSolution

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
