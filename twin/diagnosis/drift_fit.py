"""Fit of a cause with several forms, given other causes: a drift over its time constant, an affine error over its centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.candidate import STRAIGHT_LINE, Column, Drift
from twin.diagnosis.forms import pseudo_inverse
from twin.diagnosis.problem import Problem

TIME_CONSTANT_GRID: Final = 81
"""Number of time constants at which the likelihood of a drift is evaluated."""
NOT_IDENTIFIABLE: Final = 1e-6
"""Share of a drift's squared norm, given other causes, below which it is not identifiable."""
NARROW_LIKELIHOOD: Final = 0.15
"""Relative uncertainty of a time constant below which its likelihood is treated as normal."""
DECISIVE_CHI2: Final = 4.0
"""Reduction of chi² (two standard deviations) by which the less usual of exponential and straight line must fit better."""
INTEGRATED_SIGMA: Final = 5.0
"""Standard deviations on either side of the best time constant over which a narrow likelihood is integrated."""


@final
@dataclass(frozen=True)
class FittedDrift:
    """Maximum-likelihood fit of a drift."""

    time_constant: float  # s; `STRAIGHT_LINE` for a straight line
    values: np.ndarray  # (w,) linear parameters
    # second moments (w + 1, w + 1) of values and time constant about the best, under the profile likelihood; None for a straight
    # line, or where the likelihood is treated as normal
    moments: np.ndarray | None


def fit_drift(problem: Problem, drift: Drift, others: Sequence[Column]) -> FittedDrift:
    """Return the maximum-likelihood drift given other causes, and the uncertainty of its parameters.

    Where the time constant is as long as the record, amplitude and time constant are strongly correlated and the curvature at the
    optimum does not describe their uncertainty. Their second moments under the profile likelihood do; they are taken over the time
    constants tried, with a prior uniform in the logarithm.
    """
    tried = np.geomspace(drift.constants[0], drift.constants[-1], TIME_CONSTANT_GRID)
    gain, values, covariance = _profile(
        problem, [drift.columns(tau) for tau in (*tried.tolist(), STRAIGHT_LINE)], others
    )
    best = int(np.argmax(gain[:-1]))
    ahead = gain[best] - gain[-1]
    if not np.isfinite(gain).all() or ahead < (DECISIVE_CHI2 if drift.straight else -DECISIVE_CHI2):
        return FittedDrift(STRAIGHT_LINE, values[-1], None)
    likelihood = np.exp((gain[:-1] - gain[best]) / 2.0)
    likelihood /= likelihood.sum()
    relative = float(np.sqrt(likelihood @ np.log(tried / tried[best]) ** 2))
    if relative < NARROW_LIKELIHOOD and likelihood[0] + likelihood[-1] < 1e-3:
        if not drift.straight:
            return FittedDrift(float(tried[best]), values[best], None)
        # Refine the grid around the best value, over the width of the likelihood.
        step = float(np.log(tried[1] / tried[0]))
        reach = max(INTEGRATED_SIGMA * relative, 2.0 * step)
        for _ in range(3):
            tried = tried[best] * np.exp(np.linspace(-reach, reach, TIME_CONSTANT_GRID))
            gain, values, covariance = _profile(problem, [drift.columns(tau) for tau in tried.tolist()], others)
            best = int(np.argmax(gain))
            likelihood = np.exp((gain - gain[best]) / 2.0)
            likelihood /= likelihood.sum()
            step, reach = (
                2.0 * reach / (TIME_CONSTANT_GRID - 1),
                INTEGRATED_SIGMA * float(np.sqrt(likelihood @ np.log(tried / tried[best]) ** 2)),
            )
            if reach > 4.0 * INTEGRATED_SIGMA * step:
                break
            reach = max(reach, 2.0 * step)
    else:
        values, covariance = values[:-1], covariance[:-1]
    deviations = np.concatenate([values - values[best], (tried - tried[best])[:, None]], axis=1)
    moments = (deviations * likelihood[:, None]).T @ deviations
    moments[:-1, :-1] += np.einsum("k,kij->ij", likelihood, covariance)
    return FittedDrift(float(tried[best]), values[best], moments)


def over_forms(problem: Problem, forms: Sequence[Sequence[Column]], others: Sequence[Column]) -> np.ndarray:
    """Return second moments (w, w) of the parameters about those of the first form, the forms weighted by their likelihood."""
    gain, values, covariance = _profile(problem, forms, others)
    likelihood = np.exp((gain - gain.max()) / 2.0)
    likelihood /= likelihood.sum()
    deviations = values - values[0]
    return np.asarray(
        (deviations * likelihood[:, None]).T @ deviations + np.einsum("k,kij->ij", likelihood, covariance)
    )


def _profile(
    problem: Problem, forms: Sequence[Sequence[Column]], others: Sequence[Column]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for each form its chi² reduction given the others (m,), parameters (m, w) and their covariance (m, w, w)."""
    columns = [[replace(column, scale=1.0) for column in own] for own in forms]
    width = len(columns[0])
    count = width * len(forms)
    products = problem.products([*(column for own in columns for column in own), *others])
    given = slice(count, None)
    inverse = pseudo_inverse(products.gram[given, given]) if others else np.zeros((0, 0))
    gain, values, covariance = np.zeros(len(forms)), np.zeros((len(forms), width)), np.zeros((len(forms), width, width))
    for k in range(len(forms)):
        own = slice(k * width, (k + 1) * width)
        cross = products.gram[given, own]
        whole = np.diag(products.gram[own, own])
        # All parameters have the same unit: directions small against the largest are not identifiable.
        size = float(np.sqrt(max(whole.max(), 1e-300)))
        block = (products.gram[own, own] - cross.T @ inverse @ cross) / size**2
        slope = (products.slope[own] - cross.T @ (inverse @ products.slope[given])) / size
        weights, vectors = np.linalg.eigh(block)
        seen = weights > NOT_IDENTIFIABLE
        root = vectors[:, seen] / np.sqrt(weights[seen])
        along = root.T @ slope
        gain[k] = along @ along if seen.any() else -np.inf
        values[k] = root @ along / size
        covariance[k] = root @ root.T / size**2
    return gain, values, covariance
