"""Independence factors of Wen et al. (2023), for comparison with leverages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np


@final
@dataclass(frozen=True)
class IndependenceFactors:
    """Algorithm 1 of Wen et al. (2023), eq. 19 to 24.

    Attributes:
        eigenvalues: (p,) of the covariance of the columns, descending.
        rank: number of eigenvalues above the threshold.
        factors: (p,) independence factor of each unknown: the largest magnitude in its row of the leading eigenvectors.
    """

    eigenvalues: np.ndarray
    rank: int
    factors: np.ndarray


def independence_factors(jacobian: np.ndarray, *, threshold: float) -> IndependenceFactors:
    """Return independence factors of the columns as in the paper: centred, in their own units.

    They depend on the units, on the threshold, which the paper does not specify, and on the basis of repeated eigenvalues;
    `Determinability.leverage` does not.

    Args:
        jacobian: (n, p) derivatives.
        threshold: TH_σ, on the eigenvalues.
    """
    centred = jacobian - jacobian.mean(axis=0)
    # The eigenvectors of AᵀA / n are A's right singular vectors: taken from A itself, small eigenvalues keep their digits.
    _, values, right = np.linalg.svd(centred, full_matrices=True)
    eigenvalues = np.zeros(jacobian.shape[1])
    eigenvalues[: len(values)] = values**2 / len(jacobian)
    rank = int(np.count_nonzero(eigenvalues > threshold))
    factors = np.abs(right[:rank]).max(axis=0, initial=0.0)
    return IndependenceFactors((eigenvalues), rank, (factors))
