"""How large a cause is that has several forms, beside other causes: a drift by its time constant, an affine error by its centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.candidate import STRAIGHT, Drift
from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.forms import pseudo_inverse
from twin.diagnosis.problem.problem import Problem

FINE: Final = 81
"""Time constants at which the likelihood of a drift is evaluated."""
HIDDEN: Final = 1e-6
"""Share of a drift beside other causes below which they hide it."""
SHARP: Final = 0.15
"""Relative uncertainty of a time constant below which the likelihood is that of a normal distribution."""
DECISIVE: Final = 4.0
"""Chi² (two standard deviations) by which the less usual of exponential and straight line must fit better to be reported."""
AROUND: Final = 5.0
"""Standard deviations on either side of the best time constant over which a sharp likelihood is integrated."""


@final
@dataclass(frozen=True)
class FittedDrift:
    """The most likely drift.

    Attributes:
        time_constant: s; `STRAIGHT` for a straight line.
        values: (w,) linear parameters.
        moments: (w + 1, w + 1) second moments of these and the time constant about the best, under the profile likelihood; None for a
            straight line, and where the likelihood is that of a normal distribution.
    """

    time_constant: float
    values: np.ndarray
    moments: np.ndarray | None


def fit_drift(problem: Problem, drift: Drift, others: Sequence[Column]) -> FittedDrift:
    """The most likely drift beside other causes, and how far its numbers may be from it.

    A time constant as long as the record leaves amplitude and constant free to grow together: no curvature at the best value says how
    far. The second moments about it under the profile likelihood do, over the time constants that were tried, even in their logarithm.

    Args:
        problem: the data.
        drift: its columns.
        others: columns of the other causes.
    """
    tried = np.geomspace(drift.constants[0], drift.constants[-1], FINE)
    gain, values, spread = _profile(problem, [drift.columns(tau) for tau in (*tried.tolist(), STRAIGHT)], others)
    best = int(np.argmax(gain[:-1]))
    ahead = gain[best] - gain[-1]
    if not np.isfinite(gain).all() or ahead < (DECISIVE if drift.straight else -DECISIVE):
        return FittedDrift(STRAIGHT, values[-1], None)
    share = np.exp((gain[:-1] - gain[best]) / 2.0)
    share /= share.sum()
    relative = float(np.sqrt(share @ np.log(tried / tried[best]) ** 2))
    if relative < SHARP and share[0] + share[-1] < 1e-3:
        if not drift.straight:
            return FittedDrift(float(tried[best]), values[best], None)
        # Between two that were tried: as far around the best as its likelihood reaches.
        step = float(np.log(tried[1] / tried[0]))
        reach = max(AROUND * relative, 2.0 * step)
        for _ in range(3):
            tried = tried[best] * np.exp(np.linspace(-reach, reach, FINE))
            gain, values, spread = _profile(problem, [drift.columns(tau) for tau in tried.tolist()], others)
            best = int(np.argmax(gain))
            share = np.exp((gain - gain[best]) / 2.0)
            share /= share.sum()
            step, reach = 2.0 * reach / (FINE - 1), AROUND * float(np.sqrt(share @ np.log(tried / tried[best]) ** 2))
            if reach > 4.0 * AROUND * step:
                break
            reach = max(reach, 2.0 * step)
    else:
        values, spread = values[:-1], spread[:-1]
    off = np.concatenate([values - values[best], (tried - tried[best])[:, None]], axis=1)
    moments = (off * share[:, None]).T @ off
    moments[:-1, :-1] += np.einsum("k,kij->ij", share, spread)
    return FittedDrift(float(tried[best]), values[best], moments)


def over_forms(problem: Problem, forms: Sequence[Sequence[Column]], others: Sequence[Column]) -> np.ndarray:
    """(w, w) second moments of the parameters about those of the first form, the forms weighted by their likelihood.

    Args:
        problem: the data.
        forms: columns of each form that the cause may have, the one that was chosen first.
        others: columns of the other causes.
    """
    gain, values, spread = _profile(problem, forms, others)
    share = np.exp((gain - gain.max()) / 2.0)
    share /= share.sum()
    off = values - values[0]
    return np.asarray((off * share[:, None]).T @ off + np.einsum("k,kij->ij", share, spread))


def _profile(
    problem: Problem, forms: Sequence[Sequence[Column]], others: Sequence[Column]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each form: what it explains beside the others (m,), its parameters (m, w), their covariance (m, w, w)."""
    columns = [[replace(column, scale=1.0) for column in own] for own in forms]
    width = len(columns[0])
    count = width * len(forms)
    found = problem.products([*(column for own in columns for column in own), *others])
    beside = slice(count, None)
    inverse = pseudo_inverse(found.gram[beside, beside])[0] if others else np.zeros((0, 0))
    gain, values, spread = np.zeros(len(forms)), np.zeros((len(forms), width)), np.zeros((len(forms), width, width))
    for k in range(len(forms)):
        own = slice(k * width, (k + 1) * width)
        cross = found.gram[beside, own]
        whole = np.diag(found.gram[own, own])
        size = float(
            np.sqrt(max(whole.max(), 1e-300))
        )  # all have one unit: what is small beside the largest is not seen
        block = (found.gram[own, own] - cross.T @ inverse @ cross) / size**2
        slope = (found.slope[own] - cross.T @ (inverse @ found.slope[beside])) / size
        weights, vectors = np.linalg.eigh(block)
        seen = weights > HIDDEN
        root = vectors[:, seen] / np.sqrt(weights[seen])
        along = root.T @ slope
        gain[k] = along @ along if seen.any() else -np.inf
        values[k] = root @ along / size
        spread[k] = root @ root.T / size**2
    return gain, values, spread
