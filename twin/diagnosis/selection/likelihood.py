"""Likelihood of causes together with unnamed patterns, whose variances are estimated.

After projecting out the set-up, r ~ N(Xβ, s²(1 + ΦDΦᵀ)) with causes X, functions Φ of the patterns, a variance in D for each direction
of each pattern, and s ≥ 1 for noise larger than stated, all by maximum likelihood (D by the fixed point of MacKay 1992, Neural
Computation 4, 415). Sets of causes are compared by this likelihood, with the variances re-estimated for each. A cause that imitates
part of a pattern increases it little over the pattern alone; a cause that leaves almost nothing to the patterns increases it much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.forms import Candidates, Form, columns_of, pseudo_inverse
from twin.diagnosis.selection.pattern_test import PatternTest

STEPS: Final = 40
"""Largest number of iterations."""
STILL: Final = 0.02
"""Change of the logarithm of a variance below which the iteration has converged."""
SMALL: Final = 1e-3
"""Noncentrality of a pattern along a direction below which that direction is dropped."""
LITTLE: Final = 1e-6
"""Noncentrality below which a function of a pattern has no effect on the likelihood."""
UNREAD: Final = 1e-9
"""Share of the best measured direction below which a direction counts as not measured."""
NEARLY_DEPENDENT: Final = 1e-8
"""Eigenvalue of a pattern's inner products, relative to the largest, below which a pattern imitates nothing along a direction."""
FIRST: Final = 10.0
"""Initial noncentrality of a direction of a pattern."""
TOGETHER: Final = 64
"""Columns evaluated at once."""
MOSTLY: Final = 0.5
"""Share of the effect of a cause that a pattern must reproduce to count as imitating it."""


@final
@dataclass(frozen=True, eq=False)
class Model:
    """Causes with patterns, at the most likely variances.

    Attributes:
        twice_log_ratio: twice the log likelihood ratio wald noise as stated without causes and patterns.
        variances: of each group of the patterns' columns, relative to the noise, µm².
        variance_factor: s², the variance factor of the noise, at least one.
        explained: χ² explained by causes and patterns together.
        values: (columns,) coefficients of the causes, in the order of `together`.
        random: coefficients of the patterns' rotated columns, µm.
        covariance: (columns, columns) of the causes' coefficients at these variances, in units of the noise variance.
        effective_dof: effective degrees of freedom of the patterns.
    """

    twice_log_ratio: float
    variances: np.ndarray
    variance_factor: float
    explained: float
    values: np.ndarray
    random: np.ndarray
    covariance: np.ndarray
    effective_dof: float


@final
class Likelihood:
    """Likelihood of the causes of a pool together with some patterns.

    The columns of each variance are rotated so that they are orthogonal in the readings. The likelihood stays the same, and columns
    that the readings do not determine drop out: for few readings, that is most of the columns.

    Args:
        candidates: the data and the causes.
        pattern_tests: the patterns.
    """

    def __init__(self, candidates: Candidates, pattern_tests: Sequence[PatternTest]) -> None:
        self.candidates = candidates
        self.pattern_tests = tuple(pattern_tests)
        self._imitated: dict[int, np.ndarray] = {}
        self._roots: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.columns: list[Column] = []
        group: list[int] = []
        for k, pattern_test in enumerate(pattern_tests):
            # All directions, each with its own variance: a cause may imitate the pattern along a direction other than the clearest.
            for i in range(3):
                own = pattern_test.pattern.columns(pattern_test.level, [i])
                group += [3 * k + i] * len(own)
                self.columns += own
        self.group = np.array(group, dtype=int)
        problem = candidates.problem
        gram, by_nuisance, slope = candidates.products.among(self.columns)
        basis = problem.root.T @ problem.nuisances.from_raw(by_nuisance)
        gram, slope = gram - basis.T @ basis, slope - basis.T @ (problem.root.T @ problem.residual_on_basis)
        size = np.bincount(self.group, np.diag(gram), 3 * len(pattern_tests))
        self._size = np.where(size > UNREAD * size.max(initial=0.0), size, 0.0)
        self._rotation, self._own = _orthogonal(gram, self.group, self._size)
        self._gram = self._rotation.T @ gram @ self._rotation
        self._slope = self._rotation.T @ slope
        self._cross = self._rotation.T @ candidates.along(self.columns, basis)
        self._chi2, self._dof = problem.chi2, max(problem.dof, 1)

    def fit(self, forms: Sequence[Form], start: Model | None = None, without: int | None = None) -> Model:
        """Return the model at the most likely variances, for some causes.

        Args:
            forms: the causes.
            start: model whose variances are the initial ones.
            without: number of a pattern to omit.
        """
        first = np.where(self._size > 0.0, FIRST / np.maximum(self._size, 1e-300), 0.0)
        variances, variance_factor = first, 1.0
        if start is not None:
            variances, variance_factor = np.maximum(start.variances, SMALL * first), start.variance_factor
        if without is not None:
            variances = np.where(np.arange(len(variances)) // 3 == without, 0.0, variances)
        columns = columns_of(forms)
        fixed = self.candidates.gram(forms)
        for _ in range(STEPS):
            model, moved = self._at(columns, fixed, variances, variance_factor)
            with np.errstate(divide="ignore", invalid="ignore"):
                change = np.abs(np.log(moved / variances))
            followed = variances * self._size > SMALL
            settled = (
                not np.any(change[followed] > STILL)
                and abs(model.variance_factor / variance_factor - 1.0) < STILL * 0.1
            )
            variances, variance_factor = moved, model.variance_factor
            if settled:
                break
        return self._at(columns, fixed, variances, variance_factor)[0]

    def _followed(self, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rotated columns with a relevant variance, their standard deviations, and 1 + D^½ΦᵀMΦD^½ of them."""
        followed = (variances * self._size)[self._own] > SMALL
        used = np.flatnonzero(followed & (variances[self._own] * np.diag(self._gram) > LITTLE))
        deviation = np.sqrt(variances[self._own[used]])
        inner = self._gram[np.ix_(used, used)]
        inner *= deviation[:, None]
        inner *= deviation
        inner[np.diag_indices_from(inner)] += 1.0
        return used, deviation, inner

    def _at(
        self, columns: np.ndarray, fixed: np.ndarray, variances: np.ndarray, variance_factor: float
    ) -> tuple[Model, np.ndarray]:
        """Return the model at given variances, and updated variances."""
        used, deviation, inner = self._followed(variances)
        cross = self._cross[np.ix_(used, columns)] * deviation[:, None]
        slope = self._slope[used] * deviation
        inverse, log_det = _inverse_factor(inner)
        cross, slope_left = inverse @ cross, inverse @ slope
        values, back = np.zeros(len(columns)), np.zeros((0, 0))
        if len(columns):
            back = pseudo_inverse(fixed - cross.T @ cross)
            values = back @ (self.candidates.slope[columns] - cross.T @ slope_left)
        found = inverse.T @ (slope_left - cross @ values)
        explained = float(self.candidates.slope[columns] @ values + slope @ found)
        more = max((self._chi2 - explained) / self._dof, 1.0)
        # Relative to the stated noise alone, for which twice the log likelihood is −χ².
        twice_log_ratio = self._chi2 - (self._chi2 - explained) / more - self._dof * float(np.log(more)) - log_det
        groups = len(variances)
        share = 1.0 - np.einsum("ij,ij->j", inverse, inverse)
        known = np.bincount(self._own[used], share, groups)
        squares = np.bincount(self._own[used], found**2, groups)
        moved = np.where(known > 0.0, variances * squares / np.maximum(known, 1e-12) / variance_factor, variances)
        random = np.zeros(len(self._own))
        random[used] = found * deviation
        return Model(twice_log_ratio, variances, more, explained, values, random, back, float(share.sum())), moved

    def gain_bound(self, forms: Sequence[Form], model: Model, form: Form) -> float:
        """Return an upper bound of the gain in twice the log likelihood by one cause: variances are not re-estimated without it."""
        at = np.searchsorted(columns_of(forms), form.columns)
        values = model.values[at]
        return (
            float(values @ np.linalg.pinv(model.covariance[np.ix_(at, at)], hermitian=True) @ values)
            / model.variance_factor
        )

    def scan(self, forms: Sequence[Form], model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Return the χ² that every form explains given causes and patterns, in units of the noise, and its degrees of freedom."""
        used, deviation, inner = self._followed(model.variances)
        lower = np.linalg.cholesky(inner)
        cross = scipy.linalg.solve_triangular(lower, self._cross[used] * deviation[:, None], lower=True)
        slope = scipy.linalg.solve_triangular(lower, self._slope[used] * deviation, lower=True)
        explained, dof = self.candidates.scan_beside(forms, cross, slope)
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
        own = form.columns
        whole = self.candidates.gram([form])
        values = np.ones(len(own)) if len(own) == 1 else self.candidates.fitted([form])[1]
        size = float(values @ whole @ values)
        found = np.zeros(len(self.pattern_tests))
        for k in range(len(self.pattern_tests)):
            mine, root = self._root_of(k)
            along = root.T @ (self._cross[np.ix_(mine, own)] @ values)
            found[k] = 1.0 if along @ along > MOSTLY * size else 0.0
        self._imitated[form.index] = found
        return found

    def _root_of(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns of a pattern, and a square root of the pseudo-inverse of their inner products."""
        if k not in self._roots:
            mine = np.flatnonzero(self._own // 3 == k)
            found, vectors = np.linalg.eigh(self._gram[np.ix_(mine, mine)])
            kept = found > NEARLY_DEPENDENT * found.max(initial=0.0)
            self._roots[k] = mine, vectors[:, kept] / np.sqrt(found[kept])
        return self._roots[k]

    def explained(self, forms: Sequence[Form], model: Model) -> float:
        """Return the χ² that the patterns explain in addition to the causes."""
        return model.explained - self.candidates.explained_by(forms)

    def slope_beside(self, forms: Sequence[Form]) -> np.ndarray:
        """Return inner products of the patterns' rotated columns with the residual of the causes, fitted without patterns."""
        columns, values, _ = self.candidates.fitted(forms)
        return np.asarray(self._slope - self._cross[:, columns] @ values)

    def slope_with(self, residual: np.ndarray) -> np.ndarray:
        """Return inner products of the patterns' rotated columns with a (3n,) whitened residual, the set-up projected out."""
        problem = self.candidates.problem
        left = problem.project(residual)
        found = [
            problem.along(problem.signature(self.columns[start : start + TOGETHER]), left)
            for start in range(0, len(self.columns), TOGETHER)
        ]
        return np.asarray(self._rotation.T @ np.concatenate(found))

    def most_likely(self, model: Model, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the most likely coefficients of the patterns at given variances, with the causes fixed.

        Args:
            model: the variances.
            slope: result of `slope_beside` or `slope_with`.

        Returns:
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
        return np.flatnonzero((model.variances * self._size)[self.group] > SMALL)

    def effect_on_readings(self, which: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the (3n,) effect of some columns of the patterns on the whitened readings, held out or not.

        Args:
            which: (k,) column numbers.
            values: (k,) coefficients, µm.
        """
        problem = self.candidates.problem
        found = np.zeros(len(problem.residual))
        for start in range(0, len(which), TOGETHER):
            some = slice(start, start + TOGETHER)
            found += problem.signature([self.columns[i] for i in which[some]]) @ values[some]
        return found

    def pattern(self, forms: Sequence[Form], model: Model) -> np.ndarray:
        """Return the (3n,) most likely effect of the patterns on the whitened readings, set-up and causes projected out."""
        problem = self.candidates.problem
        found = self.effect_on_readings(np.arange(len(self.columns)), self._rotation @ model.random)
        columns = columns_of(forms)
        if len(columns):
            back = pseudo_inverse(self.candidates.gram(forms))
            signature = problem.signature([self.candidates.products.columns[i] for i in columns])
            found -= signature @ (back @ (self._cross[:, columns].T @ model.random))
        return problem.project(found)

    def random(self, model: Model) -> list[tuple[Column, float]]:
        """Return the patterns' columns with their standard deviations, µm."""
        which = self._followed_columns(model)
        sizes = np.sqrt(model.variances[self.group[which]] * model.variance_factor).tolist()
        return [(self.columns[i], size) for i, size in zip(which.tolist(), sizes, strict=True)]


def _orthogonal(gram: np.ndarray, group: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a rotation that makes the columns of each group orthogonal in the readings, without undetermined columns.

    Args:
        gram: (columns, columns) inner products.
        group: (columns,) group of each column.
        size: (groups,) sum of squares of each group; zero for a group that is not measured.

    Returns:
        (columns, k) the rotation, and (k,) the group of each rotated column.
    """
    rotation = np.zeros((len(group), len(group)))
    kept: list[int] = []
    for number in np.flatnonzero(size > 0.0).tolist():
        own = np.flatnonzero(group == number)
        found, vectors = np.linalg.eigh(gram[np.ix_(own, own)])
        rotation[np.ix_(own, own)] = vectors
        kept += own[found > UNREAD * found[-1]].tolist()
    return rotation[:, kept], group[kept]


def _inverse_factor(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of the Cholesky factor of a positive definite matrix, which is overwritten, and its log determinant."""
    if len(matrix) == 0:
        return matrix, 0.0
    lower, _ = scipy.linalg.lapack.dpotrf(matrix.T, lower=1, overwrite_a=1)
    log_det = float(2.0 * np.sum(np.log(np.diag(lower))))
    return scipy.linalg.lapack.dtrtri(lower, lower=1, overwrite_c=1)[0], log_det
