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

from twin._common.units import UM
from twin.diagnosis.candidates.signatures import ReadingDerivatives
from twin.diagnosis.problem.forms import Form, log_p_value
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.selection.patterns import Pattern
from twin.numerics.functions import Rows, pieces

ALARMS: Final = 0.01
"""Rate of false alarms: share of data sets without an error in which a pattern is found."""
EXACT: Final = 24
"""Number of tests, the most significant ones by two moments, whose p-value is evaluated exactly by eigenvalues."""
DIRECTIONS: Final[tuple[tuple[int, ...], ...]] = ((0,), (1,), (2,), (0, 1, 2))
"""Directions of the frame that are tested: each alone, and all together."""
SAMPLED: Final = 2048
"""Readings of a side from which the distribution of its scores for noise alone is estimated, where there are more: enough to find the
`EXACT` most significant tests. The scores themselves are those of all readings.
"""
SEED: Final = 4712
SEEN: Final = 1e-10
PLAUSIBLE: Final = 100.0
"""Noncentrality along a direction for which the test is most powerful: the score is taken at that variance, not at zero."""


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
    scores = _Scores(problem, forms)
    tests: list[tuple[float, Pattern, int, tuple[int, ...], float]] = []
    for pattern in tried:
        slope, gram = scores.of(pattern)
        for level in pattern.levels:
            chosen = pattern.order <= level
            moments = _moments(slope[:, chosen], gram[:, chosen][:, :, chosen])
            for directions in DIRECTIONS:
                found, mean, variance = moments[:, list(directions)].sum(axis=1)
                if variance > 0.0:
                    tests.append((_two_moments(found, mean, variance), pattern, level, directions, found - mean))
    price = float(np.log(max(len(tests), 1)))
    tests.sort(key=lambda one: one[0])
    best: dict[int, PatternTest] = {}
    for number, (log_p, pattern, level, directions, more) in enumerate(tests):
        if number < EXACT:
            log_p = scores.exact((pattern, level, directions), dof)
        pattern_test = PatternTest(pattern, level, directions, log_p, price, float(more))
        if id(pattern) not in best or log_p < best[id(pattern)].log_p:
            best[id(pattern)] = pattern_test
    return sorted(best.values(), key=lambda one: one.log_p)


def _orthonormal(columns: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of projected columns.

    Args:
        columns: (3n, k) columns.
        own: the same, projected; any rows held out are zero.
    """
    gram = columns.T @ own
    values, vectors = np.linalg.eigh((gram + gram.T) / 2.0)
    seen = values > SEEN * values.max(initial=0.0)
    return np.asarray(own @ (vectors[:, seen] / np.sqrt(values[seen])))


@final
class _Scores:
    """Scores of patterns with set-up and causes projected out.

    Args:
        problem: the data.
        forms: causes that are projected out.
    """

    def __init__(self, problem: Problem, forms: Sequence[Form]) -> None:
        n = len(problem.view.rows)
        self._problem, self._view = problem, problem.view
        self._kept = np.ones(n, dtype=bool)
        self._kept[problem.held_out] = False
        columns = problem.signature([column for form in forms for column in form.variant.columns])
        self._causes = _orthonormal(problem.zero_held_out(columns), problem.project(columns))
        # With the calibration's uncertainty the projection is not idempotent: the causes are fitted to the residual itself.
        left = problem.projected - self._causes @ (self._causes.T @ problem.residual)
        self._left = left.reshape(n, 3)
        self._of: dict[tuple[str, str], tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = {}

    def of(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Return (3, m) φᵀMr and (3, m, m) φᵀMφ along each direction."""
        rows, weight, taken, own, along = self._along(pattern)
        slope = np.zeros((3, len(pattern.order)))
        gram = np.zeros((3, len(pattern.order), len(pattern.order)))
        lost = np.zeros((3, len(pattern.order), taken.shape[2]))
        alike = np.ptp(weight) <= 1e-9 * weight.max()
        for some in pieces(len(own)):
            slope += along[:, some] @ pattern.at(own[some])
        for some in pieces(len(rows)):
            made = pattern.at(rows[some])
            lost += made.T @ taken[:, some]
            for i in range(1 if alike else 3):
                gram[i] += made.T @ (made * weight[some, i, None])
        if alike:
            gram[1:] = gram[0]
        share = len(rows) / max(len(own), 1)
        return slope, (gram - lost @ lost.transpose(0, 2, 1)) / share

    def exact(self, pattern_test: tuple[Pattern, int, tuple[int, ...]], dof: float) -> float:
        """Return the exact log p-value of one test (pattern, level, directions)."""
        pattern, level, directions = pattern_test
        rows = np.flatnonzero(pattern.own & self._kept)
        chosen = pattern.order <= level
        count = len(directions) * int(chosen.sum())
        problem, causes = self._problem, self._causes.reshape(len(self._kept), 3, -1)
        within, beside = np.zeros((count, problem.basis.shape[1])), np.zeros((count, causes.shape[2]))
        slope, gram = np.zeros(count), np.zeros((count, count))
        for some in pieces(len(rows)):
            here = rows[some]
            fields = self._fields(pattern, here)[:, :, list(directions)]
            made = pattern.at(here)[:, chosen]
            whole = (fields[:, :, :, None] * made[:, None, None, :]).reshape(3 * len(here), -1)
            within += whole.T @ problem.rows(here).reshape(3 * len(here), -1)
            beside += whole.T @ causes[here].reshape(3 * len(here), -1)
            slope += whole.T @ self._left[here].reshape(-1)
            gram += whole.T @ whole
        lost = np.concatenate([within @ problem.root, beside], axis=1)
        gram -= lost @ lost.T
        size = np.diag(gram).reshape(len(directions), -1).sum(axis=1)
        deviation = np.repeat(np.sqrt(PLAUSIBLE / np.where(size > 0.0, size, np.inf)), int(chosen.sum()))
        values, vectors = np.linalg.eigh(gram * np.outer(deviation, deviation))
        values = np.maximum(values, 0.0)
        score = float(np.sum((vectors.T @ (slope * deviation)) ** 2 / (1.0 + values)))
        return log_tail(values / (1.0 + values), score, dof)

    def _along(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what belongs to a side and the directions of a frame.

        Returns:
            A sample of the rows, with weight (r, 3) and basis (3, r, k) along each direction; all rows, with the residual (3, n).
        """
        key = pattern.side, pattern.field
        if key not in self._of:
            own = rows = np.flatnonzero(pattern.own & self._kept)
            if len(own) > SAMPLED:
                rows = np.sort(np.random.default_rng(SEED).choice(own, SAMPLED, replace=False))
            fields = self._fields(pattern, rows)
            self._of[key] = (
                rows,
                np.einsum("nki,nki->ni", fields, fields),
                np.einsum("nki,nkq->inq", fields, self._basis(rows, len(own)), optimize=True),
                own,
                np.einsum("nki,nk->in", self._fields(pattern, own), self._left[own]),
            )
        return self._of[key]

    def _basis(self, rows: np.ndarray, count: int) -> np.ndarray:
        """Return the basis (r, 3, k) of set-up and causes at some rows, scaled so that they stand for ``count`` of them."""
        problem, n = self._problem, len(self._kept)
        found = np.concatenate([problem.rows(rows) @ problem.root, self._causes.reshape(n, 3, -1)[rows]], axis=2)
        if len(rows) == count:
            return np.asarray(found)
        flat = found.reshape(3 * len(rows), -1) * np.sqrt(count / len(rows))
        # Over all rows no direction is longer than one; over a sample it may seem to be.
        values, vectors = np.linalg.eigh(flat.T @ flat)
        return np.asarray(flat @ (vectors / np.sqrt(np.maximum(values, 1.0)))).reshape(len(rows), 3, -1)

    def _fields(self, pattern: Pattern, rows: Rows) -> np.ndarray:
        return ReadingDerivatives(self._view, rows).of(pattern.derivative) * UM


def _moments(slope: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """Return (3, d): score, and its mean and variance for noise alone, along each of d directions."""
    found = np.zeros((3, len(slope)))
    for i, (along, own) in enumerate(zip(slope, gram, strict=True)):
        size = float(np.trace(own))
        if size > SEEN:
            # (G + 1/τ)⁻¹; the weights of the χ² are the eigenvalues of 1 − (G + 1/τ)⁻¹/τ.
            inverse = np.linalg.inv(own + size / PLAUSIBLE * np.eye(len(own)))
            weights = np.eye(len(own)) - inverse * (size / PLAUSIBLE)
            found[:, i] = along @ inverse @ along, np.trace(weights), 2.0 * np.sum(weights**2)
    return found


def _two_moments(score: float, mean: float, variance: float) -> float:
    """Return the log p-value of a score by a scaled χ² with its mean and variance (Satterthwaite 1946)."""
    return float(log_p_value(np.array(2.0 * score * mean / variance), 2.0 * mean**2 / variance, np.inf))


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
        low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
    zeta = 0.5 * (low + high)
    generating = -0.5 * float(np.sum(count * np.log1p(-2.0 * zeta * w)))
    curvature = 2.0 * float(np.sum(count * w**2 / (1.0 - 2.0 * zeta * w) ** 2))
    first = np.sqrt(max(2.0 * (zeta * target - generating), 0.0))
    second = zeta * np.sqrt(curvature)
    if first < 1e-4:
        return float(np.log(0.5))
    return float(scipy.special.log_ndtr(-(first + np.log(second / first) / first)))
