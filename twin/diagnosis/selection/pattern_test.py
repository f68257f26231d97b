"""Test for unnamed patterns in the residuals: a variance component for every column and pair of columns.

The residual r is tested for a random function of each pattern (`twin.diagnosis.selection.patterns`): with its functions φ the
statistic is rᵀMφ(φᵀMφ + 1/τ)⁻¹φᵀMr, the score of the variance (Lin 1997, Biometrika 84, 309) at a plausible variance τ. For noise
alone it is a sum of χ² with known weights, whose tail follows from the saddlepoint approximation (Kuonen 1999, Biometrika 86, 929).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import largest_first
from twin.diagnosis.problem.forms import Form, log_p_value
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.selection.pattern_scores import PLAUSIBLE, SEEN, PatternScores
from twin.diagnosis.selection.patterns import Pattern

ALARMS: Final = 0.01
"""Rate of false alarms: share of data sets without an error in which a pattern is found."""
EXACT: Final = 24
"""Number of tests, the most significant ones by two moments, whose p-value is evaluated exactly by eigenvalues."""
AT_ONCE: Final = 32
"""Tests with equally many functions whose moments are computed at once."""
DIRECTIONS: Final[tuple[tuple[int, ...], ...]] = ((0,), (1,), (2,), (0, 1, 2))
"""Directions of the frame that are tested: each alone, and all together."""


@final
@dataclass(frozen=True, eq=False)
class PatternTest:
    """One test of one pattern.

    Attributes:
        pattern: the pattern tested.
        level: highest order of its functions.
        directions: directions of its frame.
        log_p: natural log of the p-value, not corrected for multiple testing.
        log_price: natural log of the number of tests.
        explained: χ² explained beyond the expectation from noise.
    """

    pattern: Pattern
    level: int
    directions: tuple[int, ...]
    log_p: float
    log_price: float
    explained: float

    @property
    def found(self) -> bool:
        """Return whether it is significant, corrected for multiple testing."""
        return self.log_p_corrected < np.log(ALARMS)

    @property
    def log_p_corrected(self) -> float:
        """Return the log p-value corrected for multiple testing."""
        return min(self.log_p + self.log_price, 0.0)


def scan_patterns(problem: Problem, tried: Sequence[Pattern], forms: Sequence[Form], dof: float) -> list[PatternTest]:
    """Return the most significant test of each pattern, most significant first.

    Args:
        problem: the data.
        tried: patterns to test.
        forms: causes that are projected out.
        dof: degrees of freedom of the noise estimate.
    """
    if not tried:
        return []
    scores = PatternScores(problem, forms, tried)
    kinds = [(pattern, level, where) for pattern in tried for level in pattern.levels for where in DIRECTIONS]
    along = _moments_along(scores, tried)
    moments = np.stack([along[:, :, list(where)].sum(axis=2) for where in DIRECTIONS], axis=1)
    found, mean, variance = moments.reshape(-1, 3).T
    varying = np.flatnonzero(variance > 0.0)
    log_p = np.zeros(len(kinds))
    log_p[varying] = _two_moments(found[varying], mean[varying], variance[varying])
    tests = varying[np.argsort(log_p[varying], kind="stable")].tolist()
    price = float(np.log(max(len(tests), 1)))
    distributions = scores.distributions([kinds[i] for i in tests[:EXACT]])
    log_p[tests[:EXACT]] = [log_tail(weights, score, dof) for weights, score in distributions]
    best: dict[Pattern, PatternTest] = {}
    for i in tests:
        pattern, level, directions = kinds[i]
        pattern_test = PatternTest(pattern, level, directions, float(log_p[i]), price, float(found[i] - mean[i]))
        if pattern not in best or pattern_test.log_p < best[pattern].log_p:
            best[pattern] = pattern_test
    every = list(best.values())
    return [every[i] for i in largest_first(np.array([-one.log_p for one in every]))]


def _moments_along(scores: PatternScores, tried: Sequence[Pattern]) -> np.ndarray:
    """Return (n, 3, 3): of each pattern and level the score, and its mean and variance for noise alone, along each direction."""
    found: list[np.ndarray] = []
    alike: dict[int, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for pattern in tried:
        slope, gram = scores.of(pattern)
        for level in pattern.levels:
            chosen = np.flatnonzero(pattern.order <= level)
            found.append(np.zeros((3, 3)))
            waiting = alike.setdefault(len(chosen), [])
            waiting.append((slope[:, chosen], gram[:, chosen[:, None], chosen], found[-1]))
            if len(waiting) == AT_ONCE:
                _fill(alike.pop(len(chosen)))
    for waiting in alike.values():
        _fill(waiting)
    return np.stack(found)


def _fill(waiting: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    """Compute the moments (3, 3) of (3, m) scores and (3, m, m) Gram matrices with as many functions, and put them in place."""
    slopes, grams, places = zip(*waiting, strict=True)
    own = _moments(np.concatenate(slopes), np.concatenate(grams))
    for place, part in zip(places, np.split(own, len(places), axis=1), strict=True):
        place[...] = part


def _moments(slope: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """Return (3, d): score, and its mean and variance for noise alone, along each of d directions."""
    count = slope.shape[1]
    size = np.einsum("dii->d", gram)
    seen = size > 0.0
    # (G + 1/τ)⁻¹; the weights of the χ² are the eigenvalues of 1 − (G + 1/τ)⁻¹/τ.
    by_prior = np.where(seen, size / PLAUSIBLE, 1.0)
    inverse = np.linalg.inv(np.where(seen[:, None, None], gram, 0.0) + by_prior[:, None, None] * np.eye(count))
    weights = np.eye(count) - inverse * by_prior[:, None, None]
    score = np.einsum("di,di->d", slope, (inverse @ slope[:, :, None])[:, :, 0])
    found = [score, np.einsum("dii->d", weights), 2.0 * np.einsum("dij,dij->d", weights, weights)]
    return np.where(seen, np.stack(found), 0.0)


def _two_moments(score: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log p-values of scores by scaled χ² with their means and variances (Satterthwaite 1946)."""
    return log_p_value(2.0 * score * mean / variance, 2.0 * mean**2 / variance, np.inf)


def log_tail(weights: np.ndarray, value: float, dof: float = np.inf) -> float:
    """Return the log probability that Σ wᵢχ²₁ exceeds a value times χ²/dof of an estimated noise variance.

    Saddlepoint approximation of Kuonen (1999), in the form of Barndorff-Nielsen (1990), whose logarithm is finite for any probability.

    Args:
        weights: weights of the sum, not negative.
        value: value of the sum.
        dof: degrees of freedom of the noise estimate; infinite if the noise is known.
    """
    w = weights[weights > SEEN * max(float(weights.max(initial=0.0)), 1e-300)]
    if len(w) == 0 or value <= 0.0:
        return 0.0
    count = np.ones(len(w))
    target = value
    if np.isfinite(dof):
        w, count, target = np.append(w, -value / dof), np.append(count, dof), 0.0
    if target <= float(count @ w):
        return float(np.log(0.5))
    low, high = 0.0, 0.5 / float(w.max()) * (1.0 - 1e-15)

    def slope(zeta: float) -> float:
        return float(np.sum(count * w / (1.0 - 2.0 * zeta * w)) - target)

    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
    zeta = 0.5 * (low + high)
    generating = -0.5 * float(np.sum(count * np.log1p(-2.0 * zeta * w)))
    curvature = 2.0 * float(np.sum(count * w**2 / (1.0 - 2.0 * zeta * w) ** 2))
    first = np.sqrt(max(2.0 * (zeta * target - generating), 0.0))
    second = zeta * np.sqrt(curvature)
    if first < 1e-4:
        return float(np.log(0.5))
    return float(scipy.special.log_ndtr(-(first + np.log(second / first) / first)))
