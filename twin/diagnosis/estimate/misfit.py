"""Cluster-robust covariance of an estimate, for residuals that are larger than the measurement noise.

The noise alone gives an estimate's covariance only if the model fits. Where it does not, neighbouring readings share the misfit, and
the covariance is estimated from the differences between groups (Huber 1967; White 1982, eq. 3.2; groups as in Liang and Zeger 1986), as
in `twin.identification.spread`. It is never smaller than the covariance due to noise.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.distributions import chi2_sf, f_sf
from twin.diagnosis.problem.problem import Problem
from twin.measurement.state import repeat_groups

LACK_OF_FIT: Final = 0.01
"""p-value below which there is a lack of fit."""
MANY_ROUNDS: Final = 20
"""Number of rounds from which rounds are the groups; with fewer, poses are: an axis repeats its error at a pose in every round."""
LEAST_GROUPS: Final = 6
"""Number of groups below which no covariance is estimated from them."""


def groups(problem: Problem) -> np.ndarray:
    """Return the group (n,) of each row: its round, or its commanded pose where there are few rounds."""
    data = problem.network.data
    names, found = np.unique(data.round.astype(str), return_inverse=True)
    if len(names) < MANY_ROUNDS:
        _, found = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    return np.asarray(found.reshape(-1))


def lacks_fit(problem: Problem, residual: np.ndarray, parameters: int, noise_dof: float) -> bool:
    """Return whether the residuals exceed the noise, overall or in the means of repeats (test of lack of fit).

    Args:
        problem: the data.
        residual: (3n,) whitened residual of the fit.
        parameters: number of parameters fitted besides the set-up.
        noise_dof: degrees of freedom of the noise variance.
    """
    rest = problem.project(residual)
    dof = problem.dof - parameters
    found = [(float(residual @ rest), dof)]
    group = repeat_groups(problem.network.data)
    size = np.bincount(group)
    if size.max() > 1:
        means = np.stack([np.bincount(group, rest[i::3]) for i in range(3)], axis=1) / np.sqrt(size)[:, None]
        read = np.stack([np.bincount(group, problem.network.read[:, i]) > 0 for i in range(3)], axis=1)
        free = int(read.sum()) - (problem.readings - problem.dof) - parameters
        found.append((float(np.sum(means**2)), free))
    return any(
        float(f_sf(chi2 / free, free, noise_dof) if np.isfinite(noise_dof) else chi2_sf(chi2, free)) < LACK_OF_FIT
        for chi2, free in found
        if free > 0
    )


def robust_covariance(
    problem: Problem, columns: np.ndarray, residual: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the cluster-robust covariance of an estimate, in no direction below that due to noise, and the number of groups.

    With too few groups: the covariance due to noise, and infinity.

    Args:
        problem: the data.
        columns: (3n, k) signatures that were fitted.
        residual: (3n,) whitened residual of the fit.
        covariance: (k, k) covariance due to noise.
    """
    group = groups(problem)
    count = int(group.max()) + 1
    if count < LEAST_GROUPS:
        return covariance, float("inf")
    own = problem.project(columns)
    rest = problem.project(residual)
    scores = np.zeros((count, columns.shape[1]))
    np.add.at(scores, np.repeat(group, 3), own * rest[:, None])
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    flat = scores @ root
    # Eigenvalues relative to the covariance due to noise.
    share, axes = np.linalg.eigh(flat.T @ flat * (count / (count - 1)))
    rotated = root @ axes
    return np.asarray((rotated * np.maximum(share, 1.0)) @ rotated.T), float(count)


def upper_bound(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return a covariance (k, k) that is an upper bound of two covariances: the larger of them along each common eigenvector.

    Args:
        first: (k, k).
        second: (k, k), zero where the first is zero.
    """
    size = np.sqrt(np.maximum(np.diag(first), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(first / np.outer(scale, scale))
    kept = values > 1e-12 * values[-1]
    root = (scale[:, None] * vectors[:, kept]) * np.sqrt(values[kept])
    inverse_root = (vectors[:, kept] / np.sqrt(values[kept])).T / scale
    share, axes = np.linalg.eigh(inverse_root @ second @ inverse_root.T)
    rotated = root @ axes
    return np.asarray((rotated * np.maximum(share, 1.0)) @ rotated.T)
