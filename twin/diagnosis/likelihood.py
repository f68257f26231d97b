"""Likelihood of causes together with unnamed patterns, whose variances are estimated.

After projecting out the set-up, r ~ N(Xβ, s²(1 + ΦDΦᵀ)) with causes X, functions Φ of the patterns, a variance in D for each direction
of each pattern, and s ≥ 1 for noise larger than stated, all by maximum likelihood (D by the fixed point of MacKay 1992, Neural
Computation 4, 415). Sets of causes are compared by this likelihood, with the variances re-estimated for each. A cause that imitates
part of a pattern increases it little over the pattern alone; a cause that leaves almost nothing to the patterns increases it much.

Test for unnamed patterns in the residuals: a variance component for every column and pair of columns.

The residual r is tested for a random function of each pattern (`twin.diagnosis.patterns`): with its functions φ the
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
from twin.diagnosis.candidates.candidate import Column
from twin.diagnosis.forms import Candidates, Form, columns_of, log_p_value, pseudo_inverse
from twin.diagnosis.patterns import TESTED_NONCENTRALITY, ZERO_SHARE, Pattern, PatternScores
from twin.diagnosis.problem import Problem

PATTERN_ALARM_RATE: Final = 0.01  # share of data sets without an error in which a pattern is found
EXACT_P_VALUES: Final = 24  # most significant tests by two moments whose p-value is evaluated exactly
AT_ONCE: Final = 32  # tests with equally many functions whose moments are computed at once
DIRECTIONS: Final[tuple[tuple[int, ...], ...]] = ((0,), (1,), (2,), (0, 1, 2))
"""Directions of the frame that are tested: each alone, and all together."""


@final
@dataclass(frozen=True, eq=False)
class PatternTest:
    """One test of one pattern."""

    pattern: Pattern
    level: int  # highest order of its functions
    directions: tuple[int, ...]  # of its frame
    log_p: float  # natural log of the p-value, not corrected for multiple testing
    log_price: float  # natural log of the number of tests
    explained: float  # χ² beyond the expectation from noise
    rivals: tuple[tuple[str, ...], ...] = ()  # columns of patterns about as likely

    @property
    def found(self) -> bool:
        """Return whether it is significant, corrected for multiple testing."""
        return self.log_p_corrected < np.log(PATTERN_ALARM_RATE)

    @property
    def log_p_corrected(self) -> float:
        """Return the log p-value corrected for multiple testing."""
        return min(self.log_p + self.log_price, 0.0)


def scan_patterns(problem: Problem, tried: Sequence[Pattern], forms: Sequence[Form], dof: float) -> list[PatternTest]:
    """Return the most significant test of each pattern, causes projected out, most significant first; ``dof`` is that of the noise."""
    if not tried:
        return []
    scores = PatternScores(problem, forms, tried)
    kinds = [(pattern, level, where) for pattern in tried for level in pattern.levels for where in DIRECTIONS]
    along = _moments_along(scores, tried)
    moments = np.stack([along[:, :, list(where)].sum(axis=2) for where in DIRECTIONS], axis=1)
    score, mean, variance = moments.reshape(-1, 3).T
    varying = np.flatnonzero(variance > 0.0)
    log_p = np.zeros(len(kinds))
    log_p[varying] = _two_moments(score[varying], mean[varying], variance[varying])
    tests = varying[np.argsort(log_p[varying], kind="stable")].tolist()
    price = float(np.log(max(len(tests), 1)))
    distributions = scores.distributions([kinds[i] for i in tests[:EXACT_P_VALUES]])
    log_p[tests[:EXACT_P_VALUES]] = [log_tail(weights, value, dof) for weights, value in distributions]
    best: dict[Pattern, PatternTest] = {}
    for i in tests:
        pattern, level, directions = kinds[i]
        pattern_test = PatternTest(pattern, level, directions, float(log_p[i]), price, float(score[i] - mean[i]))
        if pattern not in best or pattern_test.log_p < best[pattern].log_p:
            best[pattern] = pattern_test
    clearest = list(best.values())
    return [clearest[i] for i in largest_first(np.array([-test.log_p for test in clearest]))]


def _moments_along(scores: PatternScores, tried: Sequence[Pattern]) -> np.ndarray:
    """Return (n, 3, 3): of each pattern and level the score, and its mean and variance for noise alone, along each direction."""
    moments: list[np.ndarray] = []
    alike: dict[int, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for pattern in tried:
        slope, gram = scores.of(pattern)
        for level in pattern.levels:
            chosen = np.flatnonzero(pattern.order <= level)
            moments.append(np.zeros((3, 3)))
            waiting = alike.setdefault(len(chosen), [])
            waiting.append((slope[:, chosen], gram[:, chosen[:, None], chosen], moments[-1]))
            if len(waiting) == AT_ONCE:
                _fill(alike.pop(len(chosen)))
    for waiting in alike.values():
        _fill(waiting)
    return np.stack(moments)


def _fill(waiting: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    """Compute the moments (3, 3) of (3, m) scores and (3, m, m) Gram matrices with as many functions, and put them in place."""
    slopes, grams, places = zip(*waiting, strict=True)
    moments = _moments(np.concatenate(slopes), np.concatenate(grams))
    for place, part in zip(places, np.split(moments, len(places), axis=1), strict=True):
        place[...] = part


def _moments(slope: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """Return (3, d): score, and its mean and variance for noise alone, along each of d directions."""
    count = slope.shape[1]
    size = np.einsum("dii->d", gram)
    seen = size > 0.0
    # (G + 1/τ)⁻¹; the weights of the χ² are the eigenvalues of 1 − (G + 1/τ)⁻¹/τ.
    by_prior = np.where(seen, size / TESTED_NONCENTRALITY, 1.0)
    inverse = np.linalg.inv(np.where(seen[:, None, None], gram, 0.0) + by_prior[:, None, None] * np.eye(count))
    weights = np.eye(count) - inverse * by_prior[:, None, None]
    score = np.einsum("di,di->d", slope, (inverse @ slope[:, :, None])[:, :, 0])
    moments = [score, np.einsum("dii->d", weights), 2.0 * np.einsum("dij,dij->d", weights, weights)]
    return np.where(seen, np.stack(moments), 0.0)


def _two_moments(score: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log p-values of scores by scaled χ² with their means and variances (Satterthwaite 1946)."""
    return log_p_value(2.0 * score * mean / variance, 2.0 * mean**2 / variance, np.inf)


def log_tail(weights: np.ndarray, value: float, dof: float = np.inf) -> float:
    """Return the log probability that Σ wᵢχ²₁ (wᵢ ≥ 0) exceeds a value times χ²/dof of an estimated noise variance.

    Saddlepoint approximation of Kuonen (1999), in the form of Barndorff-Nielsen (1990), whose logarithm is finite for any probability.
    """
    w = weights[weights > ZERO_SHARE * max(float(weights.max(initial=0.0)), 1e-300)]
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


STEPS: Final = 40  # largest number of iterations
CONVERGED_LOG_VARIANCE: Final = 0.02  # change of the logarithm of a variance below which the iteration has converged
LEAST_NONCENTRALITY: Final = 1e-3  # noncentrality of a pattern along a direction below which that direction is dropped
NO_NONCENTRALITY: Final = 1e-6  # noncentrality below which a function of a pattern has no effect on the likelihood
UNREAD_SHARE: Final = 1e-9  # share of the best measured direction below which a direction counts as not measured
NEARLY_DEPENDENT: Final = 1e-8
"""Eigenvalue of a pattern's inner products, relative to the largest, below which a pattern imitates nothing along a direction."""
FIRST_NONCENTRALITY: Final = 10.0  # initial noncentrality of a direction of a pattern
COLUMNS_AT_ONCE: Final = 64
IMITATED_SHARE: Final = 0.5  # share of the effect of a cause that a pattern must reproduce to count as imitating it


@final
@dataclass(frozen=True, eq=False)
class Model:
    """Causes with patterns, at the most likely variances."""

    twice_log_ratio: float  # to noise as stated, without causes and patterns
    variances: np.ndarray  # of each group of the patterns' columns, relative to the noise, µm²
    variance_factor: float  # s² of the noise, at least one
    explained: float  # χ² by causes and patterns together
    values: np.ndarray  # (columns,) of the causes, as in `columns_of`
    random: np.ndarray  # coefficients of the patterns' rotated columns, µm
    covariance: np.ndarray  # (columns, columns) of ``values`` at these variances, in units of the noise variance
    effective_dof: float  # of the patterns


@final
class Likelihood:
    """Likelihood of the causes of a pool together with some patterns.

    The columns of each variance are rotated so that they are orthogonal in the readings. The likelihood stays the same, and columns
    that the readings do not determine drop out: for few readings, that is most of the columns.
    """

    def __init__(self, candidates: Candidates, pattern_tests: Sequence[PatternTest]) -> None:
        self.candidates = candidates
        self.pattern_tests = tuple(pattern_tests)
        self._imitated: dict[int, np.ndarray] = {}
        self._roots: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        # All directions, each with its own variance: a cause may imitate the pattern along a direction other than the clearest.
        columns = [test.pattern.columns(test.level, range(3)) for test in pattern_tests]
        self.columns = [column for own in columns for column in own]
        self.group = np.repeat(np.arange(3 * len(columns)), [len(own) // 3 for own in columns for _ in range(3)])
        self._families = [test.pattern.family(test.level) for test in pattern_tests]
        own = set(self.columns)
        self._in_families = np.array([column in own for family in self._families for column in family], dtype=bool)
        problem, at = candidates.problem, self._in_families
        gram, by_nuisance, slope = candidates.products.among(self._families)
        self._basis = problem.root.T @ problem.nuisances.from_raw(by_nuisance)
        gram = (gram - self._basis.T @ self._basis)[np.ix_(at, at)]
        slope = (slope - self._basis.T @ (problem.root.T @ problem.residual_on_basis))[at]
        size = np.bincount(self.group, np.diag(gram), 3 * len(pattern_tests))
        self._size = np.where(size > UNREAD_SHARE * size.max(initial=0.0), size, 0.0)
        self._rotation, self._own = _orthogonal(gram, self.group, self._size)
        self._gram = self._rotation.T @ gram @ self._rotation
        self._slope = self._rotation.T @ slope
        self._chi2, self._dof = problem.chi2, max(problem.dof, 1)

    def _along(self, which: np.ndarray | None = None) -> np.ndarray:
        """Return the projected inner products (k, which) of the rotated columns with some columns of the forms, or all."""
        along = self.candidates.along(self._families, self._basis, which)
        return np.asarray(self._rotation.T @ along[self._in_families])

    def fit(self, forms: Sequence[Form], start: Model | None = None, without: int | None = None) -> Model:
        """Return the model at the most likely variances for some causes, sought from those of ``start``; ``without`` one pattern."""
        first = np.where(self._size > 0.0, FIRST_NONCENTRALITY / np.maximum(self._size, 1e-300), 0.0)
        variances, variance_factor = first, 1.0
        if start is not None:
            variances, variance_factor = np.maximum(start.variances, LEAST_NONCENTRALITY * first), start.variance_factor
        if without is not None:
            variances = np.where(np.arange(len(variances)) // 3 == without, 0.0, variances)
        columns = columns_of(forms)
        fixed, cross = self.candidates.gram(forms), self._along(columns)
        for _ in range(STEPS):
            model, moved = self._at(columns, fixed, cross, variances, variance_factor)
            with np.errstate(divide="ignore", invalid="ignore"):
                change = np.abs(np.log(moved / variances))
            followed = variances * self._size > LEAST_NONCENTRALITY
            settled = (
                not np.any(change[followed] > CONVERGED_LOG_VARIANCE)
                and abs(model.variance_factor / variance_factor - 1.0) < CONVERGED_LOG_VARIANCE * 0.1
            )
            variances, variance_factor = moved, model.variance_factor
            if settled:
                break
        return self._at(columns, fixed, cross, variances, variance_factor)[0]

    def _followed(self, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rotated columns with a relevant variance, their standard deviations, and 1 + D^½ΦᵀMΦD^½ of them."""
        followed = (variances * self._size)[self._own] > LEAST_NONCENTRALITY
        used = np.flatnonzero(followed & (variances[self._own] * np.diag(self._gram) > NO_NONCENTRALITY))
        deviation = np.sqrt(variances[self._own[used]])
        inner = self._gram[np.ix_(used, used)]
        inner *= deviation[:, None]
        inner *= deviation
        inner[np.diag_indices_from(inner)] += 1.0
        return used, deviation, inner

    def _at(
        self, columns: np.ndarray, fixed: np.ndarray, cross: np.ndarray, variances: np.ndarray, variance_factor: float
    ) -> tuple[Model, np.ndarray]:
        """Return the model at given variances, and updated variances; ``fixed`` and ``cross`` are inner products of the causes."""
        used, deviation, inner = self._followed(variances)
        cross = cross[used] * deviation[:, None]
        slope = self._slope[used] * deviation
        inverse, log_det = _inverse_factor(inner)
        cross, slope_left = inverse @ cross, inverse @ slope
        values, back = np.zeros(len(columns)), np.zeros((0, 0))
        if len(columns):
            back = pseudo_inverse(fixed - cross.T @ cross)
            values = back @ (self.candidates.slope[columns] - cross.T @ slope_left)
        amplitudes = inverse.T @ (slope_left - cross @ values)
        explained = float(self.candidates.slope[columns] @ values + slope @ amplitudes)
        more = max((self._chi2 - explained) / self._dof, 1.0)
        # Relative to the stated noise alone, for which twice the log likelihood is −χ².
        twice_log_ratio = self._chi2 - (self._chi2 - explained) / more - self._dof * float(np.log(more)) - log_det
        groups = len(variances)
        share = 1.0 - np.einsum("ij,ij->j", inverse, inverse)
        known = np.bincount(self._own[used], share, groups)
        squares = np.bincount(self._own[used], amplitudes**2, groups)
        moved = np.where(known > 0.0, variances * squares / np.maximum(known, 1e-12) / variance_factor, variances)
        random = np.zeros(len(self._own))
        random[used] = amplitudes * deviation
        return Model(twice_log_ratio, variances, more, explained, values, random, back, float(share.sum())), moved

    def gain_bound(self, forms: Sequence[Form], model: Model, form: Form) -> float:
        """Return an upper bound of the gain in twice the log likelihood by one cause: variances are not re-estimated without it."""
        at = np.searchsorted(columns_of(forms), form.columns)
        precision = np.linalg.pinv(model.covariance[np.ix_(at, at)], hermitian=True)
        return float(model.values[at] @ precision @ model.values[at]) / model.variance_factor

    def scan(self, forms: Sequence[Form], model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Return the χ² that every form explains given causes and patterns, in units of the noise, and its degrees of freedom."""
        used, deviation, inner = self._followed(model.variances)
        lower = np.linalg.cholesky(inner)
        cross = scipy.linalg.solve_triangular(lower, self._along()[used] * deviation[:, None], lower=True)
        slope = scipy.linalg.solve_triangular(lower, self._slope[used] * deviation, lower=True)
        explained, dof = self.candidates.scan(forms, (cross, slope))
        return explained / model.variance_factor, dof

    def explained_by_patterns(self, forms: Sequence[Form], model: Model) -> np.ndarray:
        """Return (patterns,) the χ² that each pattern explains and causes and other patterns do not."""
        return np.array(
            [
                max(model.explained - self.fit(forms, model, without=k).explained, 0.0)
                for k in range(len(self.pattern_tests))
            ]
        )

    def can_imitate(self, form: Form) -> np.ndarray:
        """Return (patterns,) one for each pattern that could reproduce most of the effect of a cause, else zero."""
        if form.index in self._imitated:
            return self._imitated[form.index]
        columns = form.columns
        values = np.ones(1) if len(columns) == 1 else self.candidates.fitted([form])[1]
        size, cross = float(values @ self.candidates.gram([form]) @ values), self._along(columns)
        can_imitate = np.zeros(len(self.pattern_tests))
        for k in range(len(self.pattern_tests)):
            of_pattern, root = self._root_of(k)
            along = root.T @ (cross[of_pattern] @ values)
            can_imitate[k] = 1.0 if along @ along > IMITATED_SHARE * size else 0.0
        self._imitated[form.index] = can_imitate
        return can_imitate

    def _root_of(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns of a pattern, and a square root of the pseudo-inverse of their inner products."""
        if k not in self._roots:
            columns = np.flatnonzero(self._own // 3 == k)
            eigenvalues, vectors = np.linalg.eigh(self._gram[np.ix_(columns, columns)])
            kept = eigenvalues > NEARLY_DEPENDENT * eigenvalues.max(initial=0.0)
            self._roots[k] = columns, vectors[:, kept] / np.sqrt(eigenvalues[kept])
        return self._roots[k]

    def explained(self, forms: Sequence[Form], model: Model) -> float:
        """Return the χ² that the patterns explain in addition to the causes."""
        return model.explained - self.candidates.explained_by(forms)

    def slope_beside(self, forms: Sequence[Form]) -> np.ndarray:
        """Return inner products of the patterns' rotated columns with the residual of the causes, fitted without patterns."""
        columns, values, _ = self.candidates.fitted(forms)
        return np.asarray(self._slope - self._along(columns) @ values)

    def slope_with(self, residual: np.ndarray) -> np.ndarray:
        """Return inner products of the patterns' rotated columns with a (3n,) whitened residual, the set-up projected out."""
        problem = self.candidates.problem
        left = problem.project(residual)
        slopes = [
            problem.signature(self.columns[start : start + COLUMNS_AT_ONCE]).T @ left
            for start in range(0, len(self.columns), COLUMNS_AT_ONCE)
        ]
        return np.asarray(self._rotation.T @ np.concatenate(slopes))

    def most_likely(self, model: Model, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the most likely coefficients of the patterns at given variances, causes fixed; ``slope`` as of `slope_beside`.

        Numbers of the k columns with a relevant variance; (k,) their coefficients, µm; (k, k) the covariance, µm².
        """
        used, deviation, inner = self._followed(model.variances)
        factor, _ = _inverse_factor(inner)
        inverse = factor.T @ factor
        which = self._followed_columns(model)
        rotation = self._rotation[np.ix_(which, used)] * deviation
        # A direction that is not measured keeps its prior variance.
        covariance = np.diag(model.variances[self.group[which]]) + rotation @ (inverse - np.eye(len(used))) @ rotation.T
        values = rotation @ (inverse @ (slope[used] * deviation))
        return which, values, model.variance_factor * (covariance + covariance.T) / 2.0

    def _followed_columns(self, model: Model) -> np.ndarray:
        return np.flatnonzero((model.variances * self._size)[self.group] > LEAST_NONCENTRALITY)

    def effect_on_readings(self, which: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the (3n,) effect of some columns of the patterns, µm each, on the whitened readings, held out or not."""
        problem = self.candidates.problem
        effect_on_readings = np.zeros(len(problem.residual))
        for start in range(0, len(which), COLUMNS_AT_ONCE):
            some = slice(start, start + COLUMNS_AT_ONCE)
            effect_on_readings += problem.signature([self.columns[i] for i in which[some]]) @ values[some]
        return effect_on_readings

    def pattern(self, forms: Sequence[Form], model: Model) -> np.ndarray:
        """Return the (3n,) most likely effect of the patterns on the whitened readings, set-up and causes projected out."""
        problem = self.candidates.problem
        effect = self.effect_on_readings(np.arange(len(self.columns)), self._rotation @ model.random)
        columns = columns_of(forms)
        if len(columns):
            back = pseudo_inverse(self.candidates.gram(forms))
            signature = problem.signature([self.candidates.products.columns[i] for i in columns])
            effect -= signature @ (back @ (self._along(columns).T @ model.random))
        return problem.project(effect)

    def problem_given(self, model: Model) -> Problem:
        """Return the data with the patterns projected out as well, at the variances of a model."""
        return self.candidates.problem.with_random_effects(self.random(model), model.variance_factor)

    def random(self, model: Model) -> list[tuple[Column, float]]:
        """Return the patterns' columns with their standard deviations, µm."""
        which = self._followed_columns(model)
        sizes = np.sqrt(model.variances[self.group[which]] * model.variance_factor).tolist()
        return [(self.columns[i], size) for i, size in zip(which.tolist(), sizes, strict=True)]


def _orthogonal(gram: np.ndarray, group: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a rotation (columns, k) that makes the columns of each group orthogonal in the readings, and (k,) their groups.

    Undetermined columns are left out; ``size`` is the sum of squares of each group, zero for one that is not measured.
    """
    rotation = np.zeros((len(group), len(group)))
    kept: list[int] = []
    for number in np.flatnonzero(size > 0.0).tolist():
        own = np.flatnonzero(group == number)
        found, vectors = np.linalg.eigh(gram[np.ix_(own, own)])
        rotation[np.ix_(own, own)] = vectors
        kept += own[found > UNREAD_SHARE * found[-1]].tolist()
    return rotation[:, kept], group[kept]


def _inverse_factor(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of the Cholesky factor of a positive definite matrix, which is overwritten, and its log determinant."""
    if len(matrix) == 0:
        return matrix, 0.0
    lower, _ = scipy.linalg.lapack.dpotrf(matrix.T, lower=1, overwrite_a=1)
    log_det = float(2.0 * np.sum(np.log(np.diag(lower))))
    return scipy.linalg.lapack.dtrtri(lower, lower=1, overwrite_c=1)[0], log_det
