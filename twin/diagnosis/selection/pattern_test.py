"""Test for unnamed patterns in the residuals: a variance component for every column and pair of columns.

The residual r is tested for a random function of each pattern (`twin.diagnosis.selection.patterns`): with its functions φ the
statistic is rᵀMφ(φᵀMφ + 1/τ)⁻¹φᵀMr, the score of the variance (Lin 1997, Biometrika 84, 309) at a plausible variance τ. For noise
alone it is a sum of χ² with known weights, whose tail follows from the saddlepoint approximation (Kuonen 1999, Biometrika 86, 929).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, final

import numpy as np
import scipy

from twin._common.units import UM
from twin.diagnosis.candidates.signatures import Column, ReadingDerivatives
from twin.diagnosis.problem.forms import Form, log_p_value
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.signature_products import PointBlock, Signatures
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
    best: dict[Pattern, PatternTest] = {}
    exact = scores.exact([test[1:4] for test in tests[:EXACT]], dof)
    for number, (log_p, pattern, level, directions, more) in enumerate(tests):
        if number < EXACT:
            log_p = exact[number]
        pattern_test = PatternTest(pattern, level, directions, log_p, price, float(more))
        if pattern not in best or log_p < best[pattern].log_p:
            best[pattern] = pattern_test
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
@dataclass(frozen=True)
class _Side:
    """Readings and nuisance derivatives that the tests of all patterns of one side and frame share.

    Attributes:
        rows: (r,) the rows of the side, or a sample of them.
        weight: (r, 3) squared norm of the derivative along each direction.
        by_raw: function that returns (3, r, raw) the base's nuisance derivatives along each direction.
        beside: (3, r, q) those of random effects, and the causes, along each direction.
        change: (raw + q, k) coefficients of an orthonormal basis of all these.
        own: (n,) all rows of the side.
        along: (3, n) the residual along each direction.
    """

    rows: np.ndarray
    weight: np.ndarray
    by_raw: Callable[[], np.ndarray]
    beside: np.ndarray
    change: np.ndarray
    own: np.ndarray
    along: np.ndarray


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
        self._nuisance = problem.nuisances
        self._of: dict[tuple[str, str], _Side] = {}

    def of(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Return (3, m) φᵀMr and (3, m, m) φᵀMφ along each direction."""
        side = self._side(pattern)
        slope = np.zeros((3, len(pattern.order)))
        for some in pieces(len(side.own)):
            slope += side.along[:, some] @ pattern.at(side.own[some])
        by_raw, gram = self._sampled(pattern, side)
        beside = np.zeros((3, len(pattern.order), side.beside.shape[2]))
        for some in pieces(len(side.rows) if beside.size else 0):
            beside += pattern.at(side.rows[some]).T @ side.beside[:, some]
        lost = np.concatenate([by_raw, beside], axis=2) @ side.change
        return slope, (gram - lost @ lost.transpose(0, 2, 1)) / (len(side.rows) / max(len(side.own), 1))

    def _sampled(self, pattern: Pattern, side: _Side) -> tuple[np.ndarray, np.ndarray]:
        """Return over the sample the (3, m, raw) inner products with the nuisance derivatives of the base, and the Gram matrices.

        They are the same in every test of the pattern on these readings and are kept.
        """
        known, base = self._nuisance.base.known, self._nuisance.base
        key = "sample", pattern, side.rows.tobytes()
        if key not in known:
            weight, made_raw = side.weight / self._nuisance.scale**2, side.by_raw()
            alike = np.ptp(weight) <= 1e-9 * weight.max()
            count = len(pattern.order)
            found = np.zeros((3, count, base.raw_count + count))
            for some in pieces(len(side.rows)):
                made = pattern.at(side.rows[some])
                found[:, :, : base.raw_count] += made.T @ made_raw[:, some]
                for i in range(1 if alike else 3):
                    found[i, :, base.raw_count :] += made.T @ (made * weight[some, i, None])
            if alike:
                found[1:, :, base.raw_count :] = found[0, :, base.raw_count :]
            known[key] = found
        by_raw, gram = np.split(known[key], [base.raw_count], axis=2)
        return by_raw * self._raw_scale, gram * self._nuisance.scale**2

    def exact(self, tests: Sequence[tuple[Pattern, int, tuple[int, ...]]], dof: float) -> list[float]:
        """Return the exact log p-value of each test (pattern, level, directions)."""
        every = list(dict.fromkeys(c for pattern, level, where in tests for c in pattern.columns(level, where)))
        if not every:
            return []
        at = {column: i for i, column in enumerate(every)}
        rows = np.flatnonzero(self._kept) if len(self._problem.held_out) else None
        lost, slope = self._along_every(every, rows)
        found = []
        for pattern, level, directions in tests:
            own = [at[column] for column in pattern.columns(level, directions)]
            gram = self._gram(pattern, level, directions) - lost[own] @ lost[own].T
            size = np.diag(gram).reshape(len(directions), -1).sum(axis=1)
            deviation = np.repeat(np.sqrt(PLAUSIBLE / np.where(size > 0.0, size, np.inf)), len(own) // len(directions))
            values, vectors = np.linalg.eigh(gram * np.outer(deviation, deviation))
            values = np.maximum(values, 0.0)
            score = float(np.sum((vectors.T @ (slope[own] * deviation)) ** 2 / (1.0 + values)))
            found.append(log_tail(values / (1.0 + values), score, dof))
        return found

    def _along_every(self, columns: Sequence[Column], rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return inner products (columns, k) with the orthonormal basis of nuisance and causes, and (columns,) with the residual."""
        problem, base, nuisance = self._problem, self._nuisance.base, self._nuisance
        causes = self._causes.reshape(len(self._kept), 3, -1)

        def vectors(block: PointBlock) -> np.ndarray:
            here = [self._more_raw(block), causes[block.rows], self._left[block.rows, :, None]]
            return np.concatenate(here, axis=2)

        keys = [("exact", column, problem.held_out.tobytes()) for column in columns]
        fresh = [column for key, column in zip(keys, columns, strict=True) if key not in base.known]
        if fresh:
            signatures = Signatures(base.signatures.view, fresh)
            for column, own in zip(fresh, signatures.along(base.raw, rows)[0], strict=True):
                base.known["exact", column, problem.held_out.tobytes()] = own
        beside = Signatures(self._view, columns).along(vectors, rows)[0]
        more, own, slope = np.split(beside, [nuisance.raw_count - base.raw_count, beside.shape[1] - 1], axis=1)
        by_raw = np.concatenate([np.stack([base.known[key] for key in keys]) * self._raw_scale, more], axis=1)
        return np.concatenate([by_raw @ nuisance.change @ problem.root, own], axis=1), slope[:, 0]

    def _gram(self, pattern: Pattern, level: int, directions: tuple[int, ...]) -> np.ndarray:
        """Return φᵀφ of the functions up to an order along some directions, without projection; kept."""
        known = self._nuisance.base.known
        key = "gram", pattern, level, directions, self._problem.held_out.tobytes()
        if key not in known:
            rows, chosen = np.flatnonzero(pattern.own & self._kept), pattern.order <= level
            count = len(directions)
            found = np.zeros((count, int(chosen.sum()), count, int(chosen.sum())))
            for some in pieces(len(rows)):
                here = rows[some]
                fields = self._fields(pattern, here)[:, :, list(directions)] / self._nuisance.scale
                weights = np.einsum("nki,nkj->nij", fields, fields)
                made = pattern.at(here)[:, chosen]
                for i in range(count):
                    for j in range(i + 1):
                        found[i, :, j] += made.T @ (made * weights[:, i, j, None])
            for i in range(count):
                for j in range(i):
                    found[j, :, i] = found[i, :, j].T
            known[key] = found.reshape(count * found.shape[1], -1)
        return known[key] * self._nuisance.scale**2

    def _more_raw(self, block: PointBlock) -> np.ndarray:
        """Return the nuisance derivatives (points, 3, r) of random effects at a block of points."""
        return self._nuisance.raw(block)[:, :, self._nuisance.base.raw_count :]

    @property
    def _raw_scale(self) -> np.ndarray:
        """(raw,) factors on inner products with the base's nuisance derivatives, whose set-up part is orthonormal with any weights."""
        nuisance, base = self._nuisance, self._nuisance.base
        return np.where(np.arange(base.raw_count) < base.setup_count, nuisance.scale, nuisance.scale**2)

    def _side(self, pattern: Pattern) -> _Side:
        """Return what belongs to a side and the directions of a frame."""
        key = pattern.side, pattern.field
        if key not in self._of:
            own = rows = np.flatnonzero(pattern.own & self._kept)
            if len(own) > SAMPLED:
                rows = np.sort(np.random.default_rng(SEED).choice(own, SAMPLED, replace=False))
            fields = self._fields(pattern, rows)
            block = PointBlock(self._view, rows)
            raw = self._nuisance.raw(block)
            causes = self._causes.reshape(len(self._kept), 3, -1)[rows]
            whole = np.concatenate([raw, causes], axis=2)
            base, scale = self._nuisance.base, self._nuisance.scale
            self._of[key] = _Side(
                rows,
                np.einsum("nki,nki->ni", fields, fields),
                cache(lambda: _along_each(fields / scale, base.raw(PointBlock(base.signatures.view, rows)))),
                _along_each(fields, whole[:, :, base.raw_count :]),
                self._change(whole, len(own)),
                own,
                np.einsum("nki,nk->in", self._fields(pattern, own), self._left[own]),
            )
        return self._of[key]

    def _change(self, whole: np.ndarray, count: int) -> np.ndarray:
        """Return the coefficients (raw, k) of an orthonormal basis of nuisance and causes, scaled so that a sample stands for all rows.

        Args:
            whole: (r, 3, raw) nuisance derivatives and causes at the sample.
            count: number of all rows.
        """
        change = scipy.linalg.block_diag(self._nuisance.change @ self._problem.root, np.eye(self._causes.shape[1]))
        if len(whole) == count:
            return change
        flat = whole.reshape(3 * len(whole), -1) @ change * np.sqrt(count / len(whole))
        # Over all rows no direction is longer than one; over a sample it may seem to be.
        values, vectors = np.linalg.eigh(flat.T @ flat)
        return change @ (vectors / np.sqrt(np.maximum(values, 1.0))) * np.sqrt(count / len(whole))

    def _fields(self, pattern: Pattern, rows: Rows) -> np.ndarray:
        return ReadingDerivatives(self._view, rows).of(pattern.derivative) * UM


def _along_each(fields: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return products (3, n, q) of (n, 3, q) vectors with each direction of (n, 3, 3) fields."""
    return np.stack([sum(fields[:, k, i, None] * vectors[:, k] for k in range(3)) for i in range(3)])


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
