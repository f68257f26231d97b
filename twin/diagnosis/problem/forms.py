"""What the data say of every form a cause can take, alone and beside others, and what each must explain to be believed.

A form of a candidate (a variant) explains F = bᵀG⁻¹b of the misfit, given the causes already in. Its p-value is that of a chi² with as
many degrees of freedom as the data see of it (of an F where the scatter itself is estimated), times the number of forms tried in its
family times the number of families: the price of the search. Forms go with one another, so that price is too high; how much, the
same search on scatter alone says (`Candidates.calibrate`).
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, final

import numpy as np
from scipy import special

from twin._common.distributions import chi2_isf, chi2_log_sf, f_isf, f_log_sf
from twin.diagnosis.candidates.candidate import Candidate, Cell
from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.products import Products

FALSE_ALARM_RATE: Final = 0.03
"""Share of data sets with nothing in them in which a cause is found, all forms together; patterns have their own share."""
SILENT: Final = 200
"""Data sets of scatter alone that the price of the search is taken from."""
FURTHER: Final = 2.5
"""What each cause beside the first must explain more: several at once are rarer than one."""
OFTEN: Final = 0.15
"""Share of those at which the price is read; rarer ones follow in proportion."""
RARER: Final = 0.8
"""What of that proportion is left: forms that go with one another do so less, the further out."""
SEED: Final = 4711
LEAST_NONCENTRALITY: Final = 25.0
"""Noncentrality at the largest plausible size below which the data do not see a direction at all."""
DEVIANCE_RULED_OUT: Final = 9.21
"""Twice the log of 100: a rival whose likelihood is less than a hundred times smaller, its price counted, is not ruled out."""
SAMPLED_POINTS: Final = 4096
"""Points that are enough to see how forms go with one another."""
TIE: Final = 1e-6
BATCH: Final = 48
"""Columns whose inner products with all others are worked out in one pass, at least."""


@final
@dataclass(frozen=True, eq=False)
class Form:
    """One variant of one candidate, among the columns of the candidates.

    Attributes:
        candidate: whose it is.
        variant: which form.
        columns: in the candidates.
        price: natural log of the number of forms tried.
        index: among the forms.
    """

    candidate: Candidate
    variant: Cell
    columns: np.ndarray
    log_tests: float
    index: int

    @property
    def key(self) -> tuple[str, str]:
        """Effect and where."""
        return self.candidate.key

    @property
    def nonlinear(self) -> dict[str, float]:
        """Its non-linear parameters that only some values are tried of."""
        return {name: value for name, value in self.variant.fixed.items() if name in self.candidate.specification.bent}

    @property
    def slot(self) -> tuple[str, str, float]:
        """What only one form at a time can fill: effect and where, and the order of a harmonic, of which an axis may have several."""
        return *self.key, self.variant.fixed.get("order", 0.0)


@final
class Candidates:
    """Forms with what the data say of each: inner products within a form, and on demand those with the forms that are in.

    Args:
        problem: the data.
        forms: (candidate, variant, price) of each.
        dof: degrees of freedom the scatter is known with; infinite where it is given.
        parts: (n,) which part of the data each point is in, where one or another is to be held out.
        level: at which forms are believed; found by `calibrate` if None.
    """

    def __init__(
        self,
        problem: Problem,
        forms: Sequence[tuple[Candidate, Cell, float]],
        dof: float = float("inf"),
        parts: np.ndarray | None = None,
        level: float | None = None,
    ) -> None:
        self.dof = dof
        self.level = FALSE_ALARM_RATE if level is None else level
        self._latest = np.zeros(len(forms))
        self._asked: set[int] = set()
        self._likely: set[int] = set()
        self._tried: dict[int, Form] = {}
        self._initial_critical = np.zeros((0, 0))
        self._scans: dict[frozenset[int], tuple[np.ndarray, np.ndarray]] = {}
        at: dict[Column, int] = {}
        self.forms: list[Form] = []
        for index, (candidate, variant, price) in enumerate(forms):
            columns = np.array([at.setdefault(column, len(at)) for column in variant.columns])
            self.forms.append(Form(candidate, variant, columns, price, index))
        self.key_of = _numbered([form.key for form in self.forms])
        self.slot_of = _numbered([form.slot for form in self.forms])
        self._columns = [np.stack([form.columns for form in rows]) for _, rows in sorted(_by_width(self.forms).items())]
        self._rows = [np.array([form.index for form in rows]) for _, rows in sorted(_by_width(self.forms).items())]
        # Where the inner products within each form are.
        self._place = {int(i): (kind, k) for kind, rows in enumerate(self._rows) for k, i in enumerate(rows)}
        self.products = Products(problem, list(at), self._columns, parts=parts)
        self._project(problem)
        self.set_problem(problem)
        if level is None:
            self.calibrate()
        self._initial_critical = self._critical = _critical_table(self.forms, self.level, self.dof)

    def for_problem(self, problem: Problem) -> Candidates:
        """The same forms, refined and barred ones too, at the same level, on the same readings with more beside them."""
        forms = [(form.candidate, form.variant, form.log_tests) for form in self.forms]
        found = Candidates(problem, forms, self.dof, level=self.level)
        found._critical = self._critical
        return found

    def calibrate(self) -> None:
        """Set the level at which forms are believed so that scatter alone passes for a cause in `FALSE_ALARM_RATE` of all data sets.

        The smallest p-value of all forms, prices paid, is drawn on scatter alone; in its tail the chance of one below p is
        proportional to p.
        """
        problem, rng = self.problem, np.random.default_rng(SEED)
        count = len(problem.view.rows)
        points, products, root = np.arange(count), self.products, problem.root
        if count > SAMPLED_POINTS:
            # How forms go with one another, some of the points show as well.
            points = np.sort(rng.choice(count, SAMPLED_POINTS, replace=False))
            products = Products(problem, self.products.columns, self._columns, points)
            root = problem.orthonormal_on(points)
        basis = problem.rows(points).reshape(-1, problem.basis.shape[1])
        read = problem.network.read[points].reshape(-1)
        silent = rng.standard_normal((len(read), SILENT)) * read[:, None]
        silent += basis @ (
            problem.calibration_directions @ rng.standard_normal((problem.calibration_directions.shape[1], SILENT))
        )
        silent -= basis @ (root @ (root.T @ (basis.T @ silent)))
        more = count / len(points)
        slope = products.along(silent, points) * np.sqrt(more)
        scale = rng.chisquare(self.dof, SILENT) / self.dof if np.isfinite(self.dof) else np.ones(SILENT)
        least = np.zeros(SILENT)
        inner = [more * own for own in self._beside(products, root)]
        for rows, columns, blocks in zip(self._rows, self._columns, inner, strict=True):
            values, vectors = np.linalg.eigh(blocks)
            seen = _seen(values, np.einsum("nii->ni", blocks).max(axis=1))
            root = vectors * np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), 0.0)[:, None, :]
            found = np.sum((root.transpose(0, 2, 1) @ slope[columns]) ** 2, axis=1) / scale
            dof, price = seen.sum(axis=1), np.array([self.forms[i].log_tests for i in rows])
            for of in {*zip(dof.tolist(), price.tolist(), strict=True)} if len(rows) else ():
                if of[0]:
                    most = found[(dof == of[0]) & (price == of[1])].max(axis=0)
                    least = np.minimum(least, log_p_value(most, float(of[0]), self.dof) + of[1])
        often = float(np.exp(np.quantile(least, OFTEN)))
        # The sum of the chances bounds the chance of any: the forms' being alike can only allow more.
        self.level = max(FALSE_ALARM_RATE, min(RARER * often * np.log1p(-FALSE_ALARM_RATE) / np.log1p(-OFTEN), 0.5))

    def exclude(self, keys: Collection[tuple[str, str]]) -> None:
        """Believe no form of some candidates, whatever it explains, until other data are judged."""
        self.exclude_forms([form for form in self.forms if form.key in keys])

    def exclude_forms(self, forms: Sequence[Form]) -> None:
        """Believe none of some forms, likewise."""
        self._critical = np.array(self._critical)
        self._critical[[form.index for form in forms]] = np.inf

    @property
    def critical_table(self) -> np.ndarray:
        """(forms, dof + 1) what each form must explain to be believed; infinite where it was forbidden."""
        return np.array(self._critical)

    @critical_table.setter
    def critical_table(self, costs: np.ndarray) -> None:
        self._critical = np.array(costs)

    def p_value(self, log_p: float) -> float:
        """A p-value, the whole search paid for, from a form's log p with its price."""
        return float(min(np.exp(log_p) * FALSE_ALARM_RATE / self.level, 1.0))

    def critical_value(self, form: Form, dof: float) -> float:
        """What a form must explain to be believed."""
        return critical_value(dof, form.log_tests, self.level, self.dof)

    def _project(self, problem: Problem) -> None:
        self._within = problem.root.T @ self.products.by_basis
        self._inner = self._beside(self.products, problem.root)
        # Inner products with all columns of those that were asked for, a row each, and which row is whose.
        self._cross = np.zeros((0, self._within.shape[1]))
        self._row = np.full(self._within.shape[1], -1)
        self._scans = {}

    def _beside(self, products: Products, root: np.ndarray) -> list[np.ndarray]:
        """Inner products within each form, by width, (forms, w, w), beside the set-up."""
        within = (root.T @ products.by_basis).T
        lost = [within[columns] for columns in self._columns]
        return [raw - own @ own.transpose(0, 2, 1) for raw, own in zip(products.within, lost, strict=True)]

    def set_problem(self, problem: Problem) -> None:
        """Take the residual of a problem whose set-up and rows are the same; what was forbidden or refined for another is forgotten."""
        self.problem = problem
        self.products.set_residual(problem.residual)
        for form in self._tried.values():
            self._put(form)
        if self._tried:
            self._project(problem)
        self._tried = {}
        self._sloped()
        self._critical = self._initial_critical
        self._scans = {}

    def _sloped(self) -> None:
        """What is left of the residual beside the set-up, with every column."""
        right = self.problem.root.T @ self.problem.along_basis
        self.slope = self.products.by_residual - self._within.T @ right

    def on_part(self, part: Problem) -> Candidates:
        """The same forms on a part of the same data."""
        other = copy(self)
        other._tried = {}
        other._asked, other._likely = set(), self._asked
        other.forms = list(self.forms)
        other.products = self.products.less(part.held_out) if len(part.held_out) else self.products
        other._project(part)
        other.set_problem(part)
        return other

    def refine(self, form: Form, variant: Cell) -> None:
        """Let a form have its non-linear parameters where the data put them, beside those that were tried; until other data are judged.

        Args:
            form: of this candidates.
            variant: with as many columns.
        """
        self._tried.setdefault(form.index, self.forms[form.index])
        self._put(replace(form, variant=variant))
        self._project(self.problem)
        self._sloped()

    def _put(self, form: Form) -> None:
        self.forms[form.index] = form
        self.products.replace(form.columns, form.variant.columns)

    def fitted(self, forms: Sequence[Form]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The columns of some forms, how much of each (plausible sizes), and the covariance of that."""
        columns = columns_of(forms)
        if len(columns) == 0:
            return columns, np.zeros(0), np.zeros((0, 0))
        inverse, _ = pseudo_inverse(self.gram(forms))
        return columns, inverse @ self.slope[columns], inverse

    def explained_by(self, forms: Sequence[Form]) -> float:
        """What some forms explain together."""
        columns, values, _ = self.fitted(forms)
        return float(self.slope[columns] @ values)

    def gram(self, forms: Sequence[Form]) -> np.ndarray:
        """Inner products of the columns of some forms (`columns_of`)."""
        columns = columns_of(forms)
        known = self._row[columns] >= 0
        fresh = [form for form in forms if np.any(self._row[form.columns] < 0)]
        if len(fresh) > 1:
            # One that is new has those with the others in their rows, and its own from the beginning.
            self._with(columns_of(fresh[1:]))
            return self.gram(forms)
        found = np.zeros((len(columns), len(columns)))
        for form in fresh:
            at = np.searchsorted(columns, form.columns)
            kind, place = self._place[form.index]
            found[np.ix_(at, at)] = self._inner[kind][place]
        rows = self._cross[np.ix_(self._row[columns[known]], columns)]
        found[known], found[:, known] = rows, rows.T
        return found

    def contains(self, larger: Sequence[Form], others: Sequence[Form], form: Form) -> bool:
        """Whether what a form can do beside some others is done by a larger set already."""
        alone = self._left(form, others)
        left = self._left(form, larger)
        return bool(np.trace(left) < 1e-3 * np.trace(alone))

    def cancels(self, form: Form, others: Sequence[Form], cause: Form) -> bool:
        """Whether a form would have to be ten times as large as what shows of it beside others, and more so than a cause."""
        left, own = (float(np.trace(self._left(one, others)) / np.trace(self._left(one, ()))) for one in (form, cause))
        return left < 1e-2 * min(own, 1.0)

    def scan(self, forms: Sequence[Form]) -> tuple[np.ndarray, np.ndarray]:
        """What every form of the candidates explains beside some others, and the degrees of freedom it does it with."""
        key = frozenset(form.index for form in forms)
        if key in self._scans:
            return self._scans[key]
        explained, dof = self._scanned(*self._after(forms))
        self._latest = explained - self.critical_values(dof)
        self._scans[key] = explained, dof
        return explained, dof

    def scan_beside(self, forms: Sequence[Form], cross: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same as `scan`, beside directions of unit weight as well.

        Args:
            forms: the causes.
            cross: (r, all) inner products of the directions with all columns.
            slope: (r,) with the residual.
        """
        return self._scanned(*self._after(forms, (cross, slope)))

    def _scanned(self, factor: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What every form explains, and its degrees of freedom, where factor · factorᵀ is taken from the inner products."""
        explained, dof = np.zeros(len(self.forms)), np.zeros(len(self.forms), dtype=int)
        for rows, columns, blocks in zip(self._rows, self._columns, self._inner, strict=True):
            lost = factor[columns]
            explained[rows], dof[rows] = _explained(blocks, blocks - lost @ lost.transpose(0, 2, 1), slope[columns])
        return explained, dof

    def critical_values(self, dof: np.ndarray) -> np.ndarray:
        """(forms,) what every form must explain to be believed, with its degrees of freedom."""
        return np.asarray(self._critical[np.arange(len(dof)), dof])

    def along(self, columns: Sequence[Column]) -> np.ndarray:
        """(columns, all) inner products of any columns with those of the candidates, beside the set-up."""
        points = np.setdiff1d(np.arange(len(self.problem.view.rows)), self.problem.held_out)
        found = np.zeros((len(columns), len(self.slope)))
        for start in range(0, len(columns), BATCH):
            made = self.problem.signature(columns[start : start + BATCH])
            kept = made.reshape(len(self.problem.view.rows), 3, -1)[points].reshape(3 * len(points), -1)
            within = self.problem.root.T @ (self.problem.basis.T @ self.problem.zero_held_out(made))
            found[start : start + BATCH] = self.products.along(kept, points).T - within.T @ self._within
        return found

    def scores(self, forms: Sequence[Form], tried: Sequence[int]) -> np.ndarray:
        """(tried, 3) explained, degrees of freedom and log p (price paid) of forms, given others."""
        explained, dof = (values[list(tried)] for values in self.scan(forms))
        price = np.array([self.forms[i].log_tests for i in tried])
        log_p = np.where(dof > 0, log_p_value(explained, np.maximum(dof, 1), self.dof) + price, 0.0)
        return np.stack([explained, dof, np.minimum(log_p, 0.0)], axis=1)

    def margins(self, forms: Sequence[Form]) -> np.ndarray:
        """What every form explains beside some others, less what it must to be believed; −inf where nothing is seen of it."""
        explained, dof = self.scan(forms)
        return explained - self.critical_values(dof)

    def penalised_gain(self, forms: Sequence[Form]) -> float:
        """What a set explains less what each of it must, along the directions that are seen of it beside the others."""
        columns = columns_of(forms)
        if len(columns) == 0:
            return 0.0
        gram = self.gram(forms)
        # A unit on the diagonal is far below what counts as seen, and makes the inverse exist.
        inverse = np.linalg.inv(gram + np.eye(len(columns)))
        total = self.explained_by(forms) - FURTHER * (len(forms) - 1)
        for form in forms:
            own = np.searchsorted(columns, form.columns)
            left = np.linalg.inv(inverse[np.ix_(own, own)]) - np.eye(len(own))
            most = float(np.diag(gram)[own].max())
            dof = int(_seen(np.linalg.eigvalsh(left)[None], np.array([most])).sum())
            total -= float(self._critical[form.index, dof]) if dof else self.critical_value(form, 1.0)
        return total

    def blocks(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Numbers (n,), columns (n, w) and inner products (n, w, w) of the forms, by number of columns."""
        return list(zip(self._rows, self._columns, self._inner, strict=True))

    def cross(self, columns: np.ndarray) -> np.ndarray:
        """(columns, all) inner products of some columns with all, beside the set-up."""
        return self._with(columns)

    def prepare(self, forms: Sequence[Form]) -> None:
        """Work out the inner products of some forms with all others in one go; of part of the data those that cost next to nothing."""
        cheap = self.products.at_hand
        few = [form for form in forms if not self._likely or cheap[form.columns].all()]
        if few:
            self._with(columns_of(few))

    def _with(self, columns: np.ndarray) -> np.ndarray:
        """(columns, all) inner products."""
        rows = self._rows_of(columns)
        return self._cross[rows]

    def _rows_of(self, columns: np.ndarray) -> np.ndarray:
        """Where the inner products of some columns with all stand, worked out first where they were not yet."""
        if np.any(self._row[columns] < 0):
            fresh = self._with_likely(columns[self._row[columns] < 0])
            found = self.products.cross(fresh) - self._within[:, fresh].T @ self._within
            filled = int(self._row.max()) + 1
            if filled + len(found) > len(self._cross):
                grown = np.zeros((2 * filled + len(found), self._cross.shape[1]))
                grown[:filled] = self._cross[:filled]
                self._cross = grown
            self._row[fresh] = filled + np.arange(len(fresh))
            self._cross[self._row[fresh]] = found
        return self._row[columns]

    def _with_likely(self, columns: np.ndarray) -> np.ndarray:
        """Columns, and those that are likely to be asked for next: a pass over the data costs more than what is done in it.

        On a part of the data those that all of them were asked for; else the best form of each candidate, the best first.
        """
        self._asked |= set(columns.tolist())
        found = dict.fromkeys([*columns.tolist(), *(self._likely - self._asked)])
        cheap = self.products.at_hand
        here = bool(cheap[columns].all())
        seen: set[int] = set()
        for i in np.argsort(-self._latest, kind="stable").tolist():
            if len(found) >= BATCH or self._latest[i] <= 0.0:
                break
            key, own = int(self.key_of[i]), self.forms[i].columns
            if key not in seen and (not here or cheap[own].all()):
                found |= dict.fromkeys(own[self._row[own] < 0].tolist())
            seen.add(key)
        return np.sort(np.array(list(found), dtype=int))

    def _after(
        self, forms: Sequence[Form], beside: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(all, r) what is taken from inner products by what is in (factor · factorᵀ), and the slope left.

        Args:
            forms: that are in.
            beside: (r, all) and (r,) of directions that are in as well, as of `scan_beside`.
        """
        cross, slope = (np.zeros((0, len(self.slope))), np.zeros(0)) if beside is None else beside
        left, columns = self.slope - cross.T @ slope, columns_of(forms)
        if len(columns) == 0:
            return cross.T, left
        own = self._with(columns) - cross[:, columns].T @ cross
        inverse, root = pseudo_inverse(own[:, columns])
        return np.concatenate([cross.T, own.T @ root], axis=1), left - (inverse @ left[columns]) @ own

    def _left(self, form: Form, others: Sequence[Form]) -> np.ndarray:
        kind, place = self._place[form.index]
        block = self._inner[kind][place]
        if len(others) == 0:
            return np.asarray(block)
        columns = columns_of(others)
        rows = self._rows_of(columns)
        inverse, _ = pseudo_inverse(self._cross[np.ix_(rows, columns)])
        shared = self._cross[np.ix_(rows, form.columns)]
        return np.asarray(block - shared.T @ inverse @ shared)


def _explained(whole: np.ndarray, blocks: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of (n, w, w) inner products and (n, w) slopes: what is explained, along how many directions that are seen."""
    if blocks.shape[1] == 1:
        values, along = blocks[:, :, 0], slope
    else:
        values, vectors = np.linalg.eigh(blocks)
        along = np.einsum("nij,ni->nj", vectors, slope)
    seen = _seen(values, np.einsum("nii->ni", whole).max(axis=1))
    return np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1), seen.sum(axis=1)


def _seen(values: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Which directions of (n, w) eigenvalues the data see, beside what there was of the form before others were in."""
    return (values > LEAST_NONCENTRALITY) & (values > 1e-8 * most[:, None])


def log_p_value(explained: np.ndarray, dof: np.ndarray | float, scatter: float) -> np.ndarray:
    """Log p of what is explained with some degrees of freedom, the scatter being known with ``scatter``."""
    half = np.asarray(dof) / 2.0
    # Beyond what the library's sf can hold, the leading term (Abramowitz and Stegun 1972, 6.5.32 and 26.5.4): an order stays one.
    if np.isfinite(scatter):
        found = np.asarray(f_log_sf(explained / dof, dof, scatter))
        far, rest = np.isneginf(found), scatter / 2.0
        small = scatter / (scatter + np.where(far, explained, 1.0))
        return np.where(far, rest * np.log(small) - np.log(rest) - special.betaln(rest, half), found)
    found = np.asarray(chi2_log_sf(explained, dof))
    far = np.isneginf(found)
    safe = np.where(far, explained, 1.0) / 2.0
    return np.where(far, (half - 1.0) * np.log(safe) - safe - special.gammaln(half), found)


@lru_cache(maxsize=4096)
def critical_value(dof: float, price: float, level: float, scatter: float) -> float:
    """What a form must explain to be believed at a level."""
    dof, p = max(dof, 1.0), level * np.exp(-price)
    return float(dof * f_isf(p, dof, scatter) if np.isfinite(scatter) else chi2_isf(p, dof))


def _critical_table(forms: Sequence[Form], level: float, scatter: float) -> np.ndarray:
    """(forms, dof + 1) `cost` by degrees of freedom; infinite for none."""
    most = max((len(form.columns) for form in forms), default=0)
    found = np.full((len(forms), most + 1), np.inf)
    for form in forms:
        for dof in range(1, len(form.columns) + 1):
            # Of forms that do the same, the one of fewest columns, whatever the rounding.
            found[form.index, dof] = critical_value(float(dof), form.log_tests, level, scatter) + TIE * len(
                form.columns
            )
    return found


def _numbered(names: Sequence[Hashable]) -> np.ndarray:
    number: dict[Hashable, int] = {}
    return np.array([number.setdefault(name, len(number)) for name in names], dtype=int)


def _by_width(forms: Sequence[Form]) -> dict[int, list[Form]]:
    found: dict[int, list[Form]] = {}
    for form in forms:
        found.setdefault(len(form.columns), []).append(form)
    return found


def columns_of(forms: Sequence[Form]) -> np.ndarray:
    """The columns of some forms, each once, in order."""
    found = [form.columns for form in forms]
    return np.unique(np.concatenate(found)) if found else np.zeros(0, dtype=int)


def pseudo_inverse(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse over the directions the data see, and its root."""
    values, vectors = np.linalg.eigh(gram)
    seen = (values > LEAST_NONCENTRALITY) & (values > 1e-9 * values.max(initial=0.0))
    root = vectors[:, seen] / np.sqrt(values[seen])
    return np.asarray(root @ root.T), np.asarray(root)
