"""Which causes account for the misfit: forward selection with re-examination, every search paid for.

A form of a candidate (a cell) explains F = bᵀG⁻¹b of the misfit, given the causes already in. Its p-value is that of a chi² with as
many degrees of freedom as the data see of it, times the number of forms tried in its family times the number of families: the price
of the search. Sets of causes are compared by what they explain less what each must explain to be believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy import stats

from twin.diagnosis.catalogue import Candidate, Cell
from twin.diagnosis.problem import Problem
from twin.diagnosis.signatures import Column

LEVEL: Final = 0.03
"""False alarms allowed, all named causes together."""
SEEN: Final = 25.0
"""Noncentrality at the largest plausible size below which the data do not see a direction at all."""
MOST: Final = 6
"""Causes at most."""
SHORTLIST: Final = 4
"""Forms of a candidate with many that are kept at a time."""
MANY: Final = 8
STARTS: Final = 4


@final
@dataclass(frozen=True)
class Form:
    """One cell of one candidate, among the columns of a pool.

    Attributes:
        candidate: whose it is.
        cell: which form.
        columns: in the pool.
        price: natural log of the number of forms tried.
    """

    candidate: Candidate
    cell: Cell
    columns: np.ndarray
    price: float

    @property
    def key(self) -> tuple[str, str]:
        """Effect and where."""
        return self.candidate.key


@final
class Pool:
    """Forms with their projected inner products.

    Args:
        problem: the data.
        forms: (candidate, cell, price) of each.
        known: a pool whose forms are in it already.
    """

    def __init__(
        self, problem: Problem, forms: Sequence[tuple[Candidate, Cell, float]], known: Pool | None = None
    ) -> None:
        self.problem = problem
        self.signature: np.ndarray
        self.forms: list[Form] = [] if known is None else list(known.forms)
        self._at: dict[Column, int] = {} if known is None else dict(known._at)
        fresh: list[Column] = []
        for candidate, cell, price in forms:
            for column in cell.columns:
                if column not in self._at:
                    self._at[column] = len(self._at)
                    fresh.append(column)
            columns = np.array([self._at[column] for column in cell.columns])
            self.forms.append(Form(candidate, cell, columns, price))
        old = np.zeros((len(problem.residual), 0)) if known is None else known.signature
        new = problem.signature(fresh) if fresh else np.zeros((len(problem.residual), 0))
        self.signature = np.concatenate([old, new], axis=1)
        if known is None:
            self.gram = problem.inner(new, new)
        else:
            cross = problem.inner(old, new)
            self.gram = np.block([[known.gram, cross], [cross.T, problem.inner(new, new)]])
        self.slope = problem.along(self.signature)

    def on(self, part: Problem) -> Pool:
        """The same forms on other rows of the same data."""
        other = copy(self)
        other.problem = part
        # Rows that are taken out are zero in the basis and the residual; in the signatures they are left out here.
        kept = np.flatnonzero(np.abs(part.nuisance).sum(axis=1) > 0.0)
        within = part.basis[kept].T @ self.signature[kept]
        other.gram = self.signature[kept].T @ self.signature[kept] - within.T @ within
        other.slope = self.signature[kept].T @ part.projected[kept]
        return other

    def fitted(self, forms: Sequence[Form]) -> tuple[np.ndarray, np.ndarray, float]:
        """Coefficients (plausible sizes) of all columns of some forms, their covariance, and what they explain."""
        columns = _together(forms)
        if len(columns) == 0:
            return np.zeros(0), np.zeros((0, 0)), 0.0
        inverse, _ = _pseudo(self.gram[np.ix_(columns, columns)])
        values = inverse @ self.slope[columns]
        return values, inverse, float(self.slope[columns] @ values)

    def rest(self, forms: Sequence[Form]) -> tuple[np.ndarray, np.ndarray]:
        """Gram matrix and slope after some forms are in."""
        columns = _together(forms)
        if len(columns) == 0:
            return self.gram, self.slope
        inverse, _ = _pseudo(self.gram[np.ix_(columns, columns)])
        cross = self.gram[:, columns]
        return self.gram - cross @ inverse @ cross.T, self.slope - cross @ (inverse @ self.slope[columns])

    def contains(self, larger: Sequence[Form], others: Sequence[Form], form: Form) -> bool:
        """Whether what a form can do beside some others is done by a larger set already."""
        columns = form.columns
        alone = self.rest(others)[0][np.ix_(columns, columns)]
        left = self.rest(larger)[0][np.ix_(columns, columns)]
        return bool(np.trace(left) < 1e-3 * np.trace(alone))

    def scores(self, forms: Sequence[Form], tried: Sequence[int]) -> np.ndarray:
        """(tried, 3) explained, degrees of freedom and log p (price paid) of forms, given others."""
        gram, slope = self.rest(forms)
        found = np.zeros((len(tried), 3))
        by_size: dict[int, list[int]] = {}
        for row, i in enumerate(tried):
            by_size.setdefault(len(self.forms[i].columns), []).append(row)
        for rows in by_size.values():
            columns = np.stack([self.forms[tried[row]].columns for row in rows])
            blocks = gram[columns[:, :, None], columns[:, None, :]]
            values, vectors = np.linalg.eigh(blocks)
            raw = self.gram[columns, columns].max(axis=1)
            seen = (values > SEEN) & (values > 1e-8 * raw[:, None])
            b = np.einsum("nij,ni->nj", vectors, slope[columns])
            explained = np.sum(np.where(seen, b**2 / np.where(seen, values, 1.0), 0.0), axis=1)
            dof = seen.sum(axis=1)
            price = np.array([self.forms[tried[row]].price for row in rows])
            log_p = np.where(dof > 0, stats.chi2.logsf(explained, np.maximum(dof, 1)) + price, 0.0)
            found[rows] = np.stack([explained, dof, np.minimum(log_p, 0.0)], axis=1)
        return found


def cost(dof: float, price: float) -> float:
    """What a form must explain to be believed."""
    return float(stats.chi2.isf(LEVEL * np.exp(-price), max(dof, 1.0)))


@final
@dataclass(frozen=True)
class Selection:
    """A set of causes.

    Attributes:
        forms: what is in.
        worth: what they explain less what each must.
    """

    forms: tuple[Form, ...]
    worth: float


def select(pool: Pool, start: Sequence[Form] = ()) -> Selection:
    """The best set: from several first choices, forward, each step re-examined by removing and exchanging."""
    everything = list(range(len(pool.forms)))
    if not everything:
        return Selection((), 0.0)
    first = pool.scores(start, everything)
    best: dict[tuple[str, str], int] = {}
    for i in np.argsort(first[:, 2], kind="stable"):
        if first[i, 2] < np.log(LEVEL):
            best.setdefault(pool.forms[i].key, int(i))
        if len(best) == STARTS:
            break
    found = Selection(tuple(start), _worth(pool, list(start)))
    for i in best.values():
        forms = _grown(pool, [*start, pool.forms[i]])
        worth = _worth(pool, forms)
        if worth > found.worth:
            found = Selection(tuple(forms), worth)
    return found


def _grown(pool: Pool, forms: list[Form]) -> list[Form]:
    everything = list(range(len(pool.forms)))
    forms = _exchanged(pool, forms)
    while len(forms) < MOST:
        scores = pool.scores(forms, everything)
        i = int(np.argmin(scores[:, 2]))
        if scores[i, 2] >= np.log(LEVEL):
            break
        before = _worth(pool, forms)
        grown = _exchanged(pool, [*_without_key(forms, pool.forms[i]), pool.forms[i]])
        if _worth(pool, grown) <= before:
            break
        forms = grown
    return forms


def _exchanged(pool: Pool, forms: list[Form]) -> list[Form]:
    """Each cause replaced by any better one, or dropped, until nothing changes."""
    everything = list(range(len(pool.forms)))
    for _ in range(8):
        changed = False
        for k in range(len(forms)):
            others = forms[:k] + forms[k + 1 :]
            now = _worth(pool, forms)
            if others and _worth(pool, others) >= now:
                forms, changed = others, True
                break
            scores = pool.scores(others, everything)
            used = {form.key for form in others}
            margin = np.array(
                [
                    s[0] - cost(s[1], form.price) if form.key not in used and s[1] > 0 else -np.inf
                    for s, form in zip(scores, pool.forms, strict=True)
                ]
            )
            for i in np.argsort(-margin)[:3]:
                trial = [*others, pool.forms[int(i)]]
                if np.isfinite(margin[i]) and _worth(pool, trial) > now + 1e-6:
                    forms, changed = trial, True
                    break
            if changed:
                break
        if not changed:
            return forms
    return forms


def _worth(pool: Pool, forms: Sequence[Form]) -> float:
    if not forms:
        return 0.0
    _, _, explained = pool.fitted(forms)
    total = explained
    for k, form in enumerate(forms):
        others = [*forms[:k], *forms[k + 1 :]]
        index = next(i for i, one in enumerate(pool.forms) if one is form)
        total -= cost(pool.scores(others, [index])[0, 1], form.price)
    return total


def _without_key(forms: Sequence[Form], form: Form) -> list[Form]:
    return [one for one in forms if one.key != form.key]


def _together(forms: Sequence[Form]) -> np.ndarray:
    found = [form.columns for form in forms]
    return np.unique(np.concatenate(found)) if found else np.zeros(0, dtype=int)


def _pseudo(gram: np.ndarray) -> tuple[np.ndarray, int]:
    """Inverse over the directions the data see, and how many they are."""
    values, vectors = np.linalg.eigh(gram)
    seen = (values > SEEN) & (values > 1e-9 * values[-1])
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    return np.asarray(inverse), int(seen.sum())


@final
class Screen:
    """Candidates with many forms, of which only the best peaks are worth comparing with all others.

    Args:
        problem: the data.
        candidates: the catalogue.
        costs: price by effect.
    """

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], costs: dict[str, float]) -> None:
        self._problem = problem
        self._many = []
        for candidate in candidates:
            if len(candidate.cells) <= MANY:
                continue
            width = len(candidate.cells[0].columns)
            signature = problem.signature([column for cell in candidate.cells for column in cell.columns])
            within = problem.basis.T @ signature
            gram = _blocks(signature, width) - _blocks(within, width)
            self._many.append((candidate, costs[candidate.effect], width, signature, gram))

    def peaks(self, pool: Pool, forms: Sequence[Form]) -> list[tuple[Candidate, Cell, float]]:
        """The best separate forms of each, after some causes are in."""
        problem = self._problem
        extra = np.zeros((len(problem.residual), 0))
        residual = problem.projected
        if forms:
            raw = pool.signature[:, _together(forms)]
            extra, _ = np.linalg.qr(raw - problem.basis @ (problem.basis.T @ raw))
            residual = residual - extra @ (extra.T @ residual)
        found = []
        for candidate, price, width, signature, whole in self._many:
            b = (signature.T @ residual).reshape(-1, width)
            gram = whole - _blocks(extra.T @ signature, width) if forms else whole
            values, vectors = np.linalg.eigh(gram)
            seen = (values > SEEN) & (values > 1e-8 * values.max())
            share = np.einsum("cij,ci->cj", vectors, b) ** 2
            score = np.sum(np.where(seen, share / np.where(seen, values, 1.0), 0.0), axis=1)
            taken: list[int] = []
            for i in np.argsort(-score):
                if all(abs(int(i) - k) > 1 for k in taken):
                    taken.append(int(i))
                if len(taken) == SHORTLIST:
                    break
            found += [(candidate, candidate.cells[i], price) for i in sorted(taken)]
        return found


def few(candidates: Sequence[Candidate], costs: dict[str, float]) -> list[tuple[Candidate, Cell, float]]:
    """All forms of the candidates that have few."""
    return [(c, cell, costs[c.effect]) for c in candidates if len(c.cells) <= MANY for cell in c.cells]


def _blocks(columns: np.ndarray, width: int) -> np.ndarray:
    """(cells, width, width) inner products within each cell."""
    found = np.empty((columns.shape[1] // width, width, width))
    for i in range(width):
        for j in range(i, width):
            found[:, i, j] = found[:, j, i] = np.sum(columns[:, i::width] * columns[:, j::width], axis=0)
    return found


def prices(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Log of the number of tests by effect: the forms of its family times the number of families."""
    families = dict.fromkeys(candidate.effect for candidate in candidates)
    return {
        effect: float(np.log(len(families) * sum(c.tests for c in candidates if c.effect == effect)))
        for effect in families
    }
