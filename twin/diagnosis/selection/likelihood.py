"""How likely causes are beside patterns without a name, whose variances the data decide.

r ~ N(Xβ, s²(1 + ΦDΦᵀ)) beside the set-up: causes X, the patterns' functions Φ, a variance in D for each direction of each pattern,
and s ≥ 1 for scatter larger than stated, all by maximum likelihood (D by the fixed point of MacKay 1992, Neural Computation 4, 415).
Two sets of causes are compared by this likelihood, the variances fitted anew for each: a cause that imitates a part of a pattern gains
little over the pattern alone, and one beside which next to nothing is left gains much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri

from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.forms import Candidates, Form, columns_of, pseudo_inverse
from twin.diagnosis.selection.unnamed import Trace

STEPS: Final = 40
STILL: Final = 0.02
"""Change of a variance's logarithm below which it is settled."""
SMALL: Final = 1e-3
"""Share of a variance that fits the misfit below which a pattern is no more followed along a direction."""
LITTLE: Final = 1e-6
"""Noncentrality below which a function of a pattern changes the likelihood by nothing that counts."""
UNREAD: Final = 1e-9
"""Share of the best read direction below which a direction is not read."""
FIRST: Final = 10.0
"""Noncentrality a direction of a pattern begins with."""
TOGETHER: Final = 64
MOSTLY: Final = 0.5
"""Share of what a cause does from which on a pattern is said to be able to imitate it."""


@final
@dataclass(frozen=True, eq=False)
class Model:
    """Causes with patterns beside them, at the most likely variances.

    Attributes:
        twice: twice the log likelihood, from that of scatter as stated alone.
        variances: of each group of the patterns' columns, relative to the scatter, µm².
        scatter: s², at least one.
        explained: of the misfit, by causes and patterns together.
        values: (columns,) of the causes, in the order of `columns_of`.
        random: of the patterns' rotated columns, µm.
        covariance: (columns, columns) of the causes' values at these variances, in units of the scatter.
        followed: degrees of freedom that the patterns follow the readings with.
    """

    twice: float
    variances: np.ndarray
    scatter: float
    explained: float
    values: np.ndarray
    random: np.ndarray
    covariance: np.ndarray
    followed: float


@final
class Likelihood:
    """Causes of the candidates beside some patterns.

    The columns of each variance are rotated so that they are orthogonal in the readings. The likelihood stays the same, and columns
    without a reading drop out: for few readings, that is most of the columns.

    Args:
        candidates: the data and the causes.
        traces: the patterns.
    """

    def __init__(self, candidates: Candidates, traces: Sequence[Trace]) -> None:
        self.candidates = candidates
        self.traces = tuple(traces)
        self._imitated: dict[int, np.ndarray] = {}
        self.columns: list[Column] = []
        group: list[int] = []
        for k, trace in enumerate(traces):
            # All directions, each with its own variance: a cause may imitate the pattern along another one than shows it best.
            for i in range(3):
                own = trace.pattern.columns(trace.level, [i])
                group += [3 * k + i] * len(own)
                self.columns += own
        self.group = np.array(group, dtype=int)
        problem = candidates.problem
        found = problem.products(self.columns)
        size = np.bincount(self.group, np.diag(found.gram), 3 * len(traces))
        self._size = np.where(size > UNREAD * size.max(initial=0.0), size, 0.0)
        self._rotation, self._own = _orthogonal(found.gram, self.group, self._size)
        self._gram = self._rotation.T @ found.gram @ self._rotation
        self._slope = self._rotation.T @ found.slope
        self._cross = self._rotation.T @ candidates.along(self.columns)
        self._chi2, self._dof = problem.chi2, max(problem.dof, 1)

    def fit(self, forms: Sequence[Form], start: Model | None = None, without: int | None = None) -> Model:
        """The most likely variances beside some causes.

        Args:
            forms: the causes.
            start: variances to begin with.
            without: number of a pattern that is left out.
        """
        first = np.where(self._size > 0.0, FIRST / np.maximum(self._size, 1e-300), 0.0)
        variances, scatter = first, 1.0
        if start is not None:
            variances, scatter = np.maximum(start.variances, SMALL * first), start.scatter
        if without is not None:
            variances = np.where(np.arange(len(variances)) // 3 == without, 0.0, variances)
        columns = columns_of(forms)
        fixed = self.candidates.gram(forms)
        for _ in range(STEPS):
            model, moved = self._at(columns, fixed, variances, scatter)
            with np.errstate(divide="ignore", invalid="ignore"):
                change = np.abs(np.log(moved / variances))
            followed = variances * self._size > SMALL
            settled = not np.any(change[followed] > STILL) and abs(model.scatter / scatter - 1.0) < STILL * 0.1
            variances, scatter = moved, model.scatter
            if settled:
                break
        return self._at(columns, fixed, variances, scatter)[0]

    def _followed(self, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rotated columns whose variance is worth following, their deviations, and 1 + D^½ΦᵀMΦD^½ of them."""
        followed = (variances * self._size)[self._own] > SMALL
        used = np.flatnonzero(followed & (variances[self._own] * np.diag(self._gram) > LITTLE))
        deviation = np.sqrt(variances[self._own[used]])
        inner = self._gram[np.ix_(used, used)] * np.outer(deviation, deviation)
        inner[np.diag_indices_from(inner)] += 1.0
        return used, deviation, inner

    def _at(
        self, columns: np.ndarray, fixed: np.ndarray, variances: np.ndarray, scatter: float
    ) -> tuple[Model, np.ndarray]:
        """The likelihood at some variances, and better ones."""
        used, deviation, inner = self._followed(variances)
        cross = self._cross[np.ix_(used, columns)] * deviation[:, None]
        slope = self._slope[used] * deviation
        inverse, log_det = _inverse(inner)
        values, back = np.zeros(len(columns)), np.zeros((0, 0))
        if len(columns):
            back, _ = pseudo_inverse(fixed - cross.T @ inverse @ cross)
            values = back @ (self.candidates.slope[columns] - cross.T @ (inverse @ slope))
        found = inverse @ (slope - cross @ values)
        explained = float(self.candidates.slope[columns] @ values + slope @ found)
        more = max((self._chi2 - explained) / self._dof, 1.0)
        # From that of the stated scatter alone, which is −χ².
        twice = self._chi2 - (self._chi2 - explained) / more - self._dof * float(np.log(more)) - log_det
        groups = len(variances)
        share = 1.0 - np.diag(inverse)
        known = np.bincount(self._own[used], share, groups)
        squares = np.bincount(self._own[used], found**2, groups)
        moved = np.where(known > 0.0, variances * squares / np.maximum(known, 1e-12) / scatter, variances)
        random = np.zeros(len(self._own))
        random[used] = found * deviation
        return Model(twice, variances, more, explained, values, random, back, float(share.sum())), moved

    def gained(self, forms: Sequence[Form], model: Model, form: Form) -> float:
        """What one of the causes makes the readings more likely by at most: at variances that are not fitted anew without it."""
        at = np.searchsorted(columns_of(forms), form.columns)
        values = model.values[at]
        return float(values @ np.linalg.pinv(model.covariance[np.ix_(at, at)], hermitian=True) @ values) / model.scatter

    def scan(self, forms: Sequence[Form], model: Model) -> tuple[np.ndarray, np.ndarray]:
        """What every form explains beside causes and patterns, in units of the scatter, and its degrees of freedom."""
        used, deviation, inner = self._followed(model.variances)
        lower = np.linalg.cholesky(inner)
        cross = solve_triangular(lower, self._cross[used] * deviation[:, None], lower=True)
        slope = solve_triangular(lower, self._slope[used] * deviation, lower=True)
        explained, dof = self.candidates.scan_beside(forms, cross, slope)
        return explained / model.scatter, dof

    def left(self, forms: Sequence[Form], model: Model) -> np.ndarray:
        """(patterns,) what each pattern explains that causes and other patterns do not."""
        return np.array(
            [max(model.explained - self.fit(forms, model, without=k).explained, 0.0) for k in range(len(self.traces))]
        )

    def imitated(self, form: Form) -> np.ndarray:
        """(patterns,) share of what a cause does that each pattern could do as well: one where it is most of it, else zero."""
        if form.index in self._imitated:
            return self._imitated[form.index]
        own = form.columns
        whole = self.candidates.gram([form])
        values = np.ones(len(own)) if len(own) == 1 else self.candidates.fitted([form])[1]
        size = float(values @ whole @ values)
        found = np.zeros(len(self.traces))
        for k in range(len(self.traces)):
            mine = np.flatnonzero(self._own // 3 == k)
            inner = self._gram[np.ix_(mine, mine)]
            along = self._cross[np.ix_(mine, own)] @ values
            shared = along @ np.linalg.lstsq(inner, along, rcond=1e-8)[0]
            found[k] = 1.0 if shared > MOSTLY * size else 0.0
        self._imitated[form.index] = found
        return found

    def explained(self, forms: Sequence[Form], model: Model) -> float:
        """What the patterns explain beside some causes, more than these alone."""
        return model.explained - self.candidates.explained_by(forms)

    def slope_beside(self, forms: Sequence[Form]) -> np.ndarray:
        """Inner products of the patterns' rotated columns with what the causes leave, these fitted alone."""
        columns, values, _ = self.candidates.fitted(forms)
        return np.asarray(self._slope - self._cross[:, columns] @ values)

    def slope_with(self, residual: np.ndarray) -> np.ndarray:
        """Inner products of the patterns' rotated columns with a (3n,) whitened residual, beside the set-up."""
        problem = self.candidates.problem
        left = problem.project(residual)
        found = [
            problem.along(problem.signature(self.columns[start : start + TOGETHER]), left)
            for start in range(0, len(self.columns), TOGETHER)
        ]
        return np.asarray(self._rotation.T @ np.concatenate(found))

    def most_likely(self, model: Model, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the patterns most likely are at some variances, beside causes that stay as they are.

        Args:
            model: the variances.
            slope: what `slope_beside` or `slope_with` gives.

        Returns:
            Numbers of the k columns whose variance is followed; (k,) how much of each, µm; (k, k) its covariance, µm².
        """
        used, deviation, inner = self._followed(model.variances)
        inverse, _ = _inverse(inner)
        which = self._followed_columns(model)
        rotation = self._rotation[np.ix_(which, used)] * deviation
        # What is not read is as uncertain as its variance.
        covariance = np.diag(model.variances[self.group[which]]) + rotation @ (inverse - np.eye(len(used))) @ rotation.T
        values = rotation @ (inverse @ (slope[used] * deviation))
        return which, values, model.scatter * (covariance + covariance.T) / 2.0

    def _followed_columns(self, model: Model) -> np.ndarray:
        return np.flatnonzero((model.variances * self._size)[self.group] > SMALL)

    def made(self, which: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(3n,) what some columns of the patterns do to the whitened readings, held out or not.

        Args:
            which: (k,) their numbers.
            values: (k,) how much of each, µm.
        """
        problem = self.candidates.problem
        found = np.zeros(len(problem.residual))
        for start in range(0, len(which), TOGETHER):
            some = slice(start, start + TOGETHER)
            found += problem.signature([self.columns[i] for i in which[some]]) @ values[some]
        return found

    def pattern(self, forms: Sequence[Form], model: Model) -> np.ndarray:
        """(3n,) what the patterns do to the whitened readings, most likely, beside set-up and causes: what those cannot do."""
        problem = self.candidates.problem
        found = self.made(np.arange(len(self.columns)), self._rotation @ model.random)
        columns = columns_of(forms)
        if len(columns):
            back, _ = pseudo_inverse(self.candidates.gram(forms))
            signature = problem.signature([self.candidates.products.columns[i] for i in columns])
            found -= signature @ (back @ (self._cross[:, columns].T @ model.random))
        return problem.project(found)

    def random(self, model: Model) -> list[tuple[Column, float]]:
        """The patterns' columns with their standard deviations, µm."""
        which = self._followed_columns(model)
        sizes = np.sqrt(model.variances[self.group[which]] * model.scatter).tolist()
        return [(self.columns[i], size) for i, size in zip(which.tolist(), sizes, strict=True)]


def _orthogonal(gram: np.ndarray, group: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation of the columns of each group after which they are orthogonal in the readings, without those that are not read.

    Args:
        gram: (columns, columns) their inner products.
        group: (columns,) of each.
        size: (groups,) the sum of the squares of each; zero for one that is not read.

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


def _inverse(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Of a positive definite matrix its inverse and the log of its determinant, by Cholesky: half the work of the general inverse."""
    if len(matrix) == 0:
        return matrix, 0.0
    lower, _ = dpotrf(matrix, lower=1)
    found, _ = dpotri(lower, lower=1)
    found = np.tril(found)
    return found + np.tril(found, -1).T, float(2.0 * np.sum(np.log(np.diag(lower))))
