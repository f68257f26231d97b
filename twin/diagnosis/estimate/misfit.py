"""How far an estimate may be off when what is left is more than scatter: by how the left-over differs from group to group.

The stated scatter makes an estimate's covariance only if nothing else is left. Where more is left, that is shared by neighbouring
readings, and the covariance that the groups themselves show is the one that holds (Huber 1967; White 1982, eq. 3.2; groups as Liang and
Zeger 1986), as in `twin.identification.spread`. It is never taken smaller than what the stated scatter gives.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.distributions import chi2_sf, f_sf
from twin.diagnosis.problem.problem import Problem
from twin.identification.spread import repeats

LARGE: Final = 0.01
"""Chance that scatter alone leaves as much, below which more is left."""
MANY: Final = 20
"""Rounds from which on they are the groups; with fewer it is the poses: what an axis does at a place it does in every round."""
FEW: Final = 6
"""Groups below which they say nothing."""


def groups(problem: Problem) -> np.ndarray:
    """(n,) group of each row: its round, or its commanded pose where the rounds are few."""
    data = problem.network.data
    names, found = np.unique(data.round.astype(str), return_inverse=True)
    if len(names) < MANY:
        _, found = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    return np.asarray(found.reshape(-1))


def more_left(problem: Problem, left: np.ndarray, fitted: int, scatter: float) -> bool:
    """Whether more is left than scatter would, at all or where the same point was read again (test of lack of fit).

    Args:
        problem: the data.
        left: (3n,) whitened residual of the fit.
        fitted: how many numbers were fitted beside the set-up.
        scatter: degrees of freedom the scatter is known with.
    """
    rest = problem.project(left)
    dof = problem.dof - fitted
    found = [(float(left @ rest), dof)]
    group = repeats(problem.network.data)
    size = np.bincount(group)
    if size.max() > 1:
        means = np.stack([np.bincount(group, rest[i::3]) for i in range(3)], axis=1) / np.sqrt(size)[:, None]
        read = np.stack([np.bincount(group, problem.network.read[:, i]) > 0 for i in range(3)], axis=1)
        free = int(read.sum()) - (problem.readings - problem.dof) - fitted
        found.append((float(np.sum(means**2)), free))
    return any(
        float(f_sf(chi2 / free, free, scatter) if np.isfinite(scatter) else chi2_sf(chi2, free)) < LARGE
        for chi2, free in found
        if free > 0
    )


def widened(problem: Problem, columns: np.ndarray, left: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, float]:
    """The larger of the two covariances of an estimate in every direction, and the number of groups it is known from.

    The stated scatter's, and infinitely many, where there are too few groups.

    Args:
        problem: the data.
        columns: (3n, k) signatures that were fitted.
        left: (3n,) whitened residual with them taken out.
        inverse: (k, k) covariance by the stated scatter.
    """
    group = groups(problem)
    count = int(group.max()) + 1
    if count < FEW:
        return inverse, float("inf")
    own = problem.project(columns)
    rest = problem.project(left)
    scores = np.zeros((count, columns.shape[1]))
    np.add.at(scores, np.repeat(group, 3), own * rest[:, None])
    values, vectors = np.linalg.eigh(inverse)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    flat = scores @ root
    # In units of the stated covariance: one where it holds.
    share, axes = np.linalg.eigh(flat.T @ flat * (count / (count - 1)))
    turned = root @ axes
    return np.asarray((turned * np.maximum(share, 1.0)) @ turned.T), float(count)


def larger(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(k, k) covariance that is in every direction of the plane of two covariances the larger of them.

    Args:
        one: (k, k).
        other: (k, k), nothing where the first is nothing.
    """
    size = np.sqrt(np.maximum(np.diag(one), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(one / np.outer(scale, scale))
    kept = values > 1e-12 * values[-1]
    root = (scale[:, None] * vectors[:, kept]) * np.sqrt(values[kept])
    back = (vectors[:, kept] / np.sqrt(values[kept])).T / scale
    share, axes = np.linalg.eigh(back @ other @ back.T)
    turned = root @ axes
    return np.asarray((turned * np.maximum(share, 1.0)) @ turned.T)
