"""Fit of every form of every candidate cause to the residuals, alone or given other causes, and the critical value each must exceed.

Given the causes already selected, a form reduces the residual sum of squares by F = bᵀG⁻¹b. Its p-value is that of a chi² with as many
degrees of freedom as the form has identifiable directions (of an F distribution where the noise variance is estimated). It is
corrected for multiple testing: multiplied by the number of forms in its family and by the number of families. The forms are
correlated, so that this correction is too strict; a simulation of the search on noise alone says by how much
(`Candidates.calibrate`).
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import permutations
from typing import Final, final

import numpy as np
import scipy

from twin._common.distributions import chi2_isf, chi2_log_sf, f_isf, f_log_sf
from twin._common.messages import Message
from twin.diagnosis.candidates.candidate import Candidate, Column, Variant
from twin.diagnosis.problem import Problem, Products
from twin.model.effects.base import axis_of

FALSE_ALARM_RATE: Final = 0.03
"""Share of data sets of noise alone in which any form is accepted as a cause; patterns have a rate of their own."""
NULL_DATA_SETS: Final = 200  # data sets of noise alone from which the correction for multiple testing is estimated
ADDITIONAL_CAUSE_PENALTY: Final = 2.5
"""Amount subtracted for each cause after the first (as chi²): several causes at once are rarer than one."""
CALIBRATION_QUANTILE: Final = 0.15
"""Quantile of the smallest p-value in these data sets; smaller false-alarm rates are extrapolated in proportion."""
TAIL_FACTOR: Final = 0.8  # factor on that extrapolation: correlated tests are less dependent further out in the tail
SEED: Final = 4711
LEAST_NONCENTRALITY: Final = 25.0  # at the largest plausible size: below it a direction is not identifiable
DEVIANCE_RULED_OUT: Final = 9.21
"""2 ln 100: a rival is ruled out if its likelihood, corrected for multiple testing, is at least a hundred times smaller."""
# Of n waves, the best follows about 2·ln(n) / positions of any error: with some 40 positions and 300 waves a quarter.
LEAST_SHORT_SHARE: Final = 0.25  # smallest share of the excess of waves shorter than the distance of the positions
SAMPLED_POINTS: Final = 4096  # points that suffice to estimate the correlation between forms
TIE: Final = 1e-6  # added to a critical value for each column: of equal forms the one with the fewest is preferred
RESOLVED: Final = 1.0  # difference of two periods, in waves over the measured span, from which on they are two errors
MAX_ALL_ORDERS: Final = 6  # number of causes up to which the reduction of chi² is averaged over all orders of entry
DRAWN_ORDERS: Final = 512  # orders of entry drawn for more: a share of a half is known to 0.02
BATCH: Final = 48  # columns whose inner products with all others are computed in one pass over the data, at least


@final
@dataclass(frozen=True, eq=False)
class Form:
    """One variant of one candidate, with the indices of its columns in the search."""

    candidate: Candidate
    variant: Variant
    columns: np.ndarray  # indices among all columns of the search
    log_tests: float  # natural log of the number of tests that the p-value is corrected for
    index: int  # in `Candidates.forms`

    @property
    def key(self) -> tuple[str, str]:
        """Effect name and place."""
        return self.candidate.key

    @property
    def nonlinear(self) -> dict[str, float]:
        """Non-linear parameters of which only a grid of values is tried."""
        return {
            name: value for name, value in self.variant.fixed.items() if name in self.candidate.specification.nonlinear
        }

    @property
    def slot(self) -> tuple[str | float, ...]:
        """Key that at most one selected form may have (but see `Candidates.taken`): effect, place, stated numbers (harmonic: order)."""
        return *self.key, *(self.variant.fixed.get(name, 0.0) for name in self.candidate.specification.fixed)


@final
class Candidates:
    """All forms of all candidate causes, with their inner products: within each form, and on demand with other forms.

    Inner products are projected: the set-up and the calibration's uncertainty are projected out.

    Args:
        forms: (candidate, variant, log of the number of tests) of each form.
        dof: degrees of freedom of the noise variance; infinite where the variance is given.
        parts: (n,) number of the part each point belongs to, where parts are to be held out.
        level: p-value, corrected for multiple testing, below which a form is accepted; set by `calibrate` if None.
    """

    further_periods = False

    def __init__(
        self,
        problem: Problem,
        forms: Sequence[tuple[Candidate, Variant, float]],
        dof: float = float("inf"),
        parts: np.ndarray | None = None,
        level: float | None = None,
    ) -> None:
        self.dof = dof
        self.level = FALSE_ALARM_RATE if level is None else level
        self._parts = parts
        self._latest = np.zeros(len(forms))
        self._requested: set[int] = set()
        self._expected: set[int] = set()
        self._refined: dict[int, Form] = {}
        self._initial_critical = np.zeros((0, 0))
        self._reasons: dict[tuple[str, str], Message] = {}
        self._scans: dict[frozenset[int], tuple[np.ndarray, np.ndarray]] = {}
        # The latest result of `fitted`, which is needed for each cause of a set in turn.
        self._fit: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        at: dict[Column, int] = {}
        self.forms: list[Form] = []
        for index, (candidate, variant, log_tests) in enumerate(forms):
            columns = np.array([at.setdefault(column, len(at)) for column in variant.columns])
            self.forms.append(Form(candidate, variant, columns, log_tests, index))
        self.key_of = _numbered([form.key for form in self.forms])
        self.slot_of = _numbered([form.slot for form in self.forms])
        self._columns = [np.stack([form.columns for form in rows]) for _, rows in sorted(_by_width(self.forms).items())]
        self._rows = [np.array([form.index for form in rows]) for _, rows in sorted(_by_width(self.forms).items())]
        # Position of each form's own inner products: (width class, index).
        self._place = {int(i): (kind, k) for kind, rows in enumerate(self._rows) for k, i in enumerate(rows)}
        self.products = Products(problem, list(at), self._columns, parts=parts)
        self._project(problem)
        self.set_problem(problem)
        if level is None:
            self.calibrate()
        self._initial_critical = self._critical = _critical_table(self.forms, self.level, self.dof)

    def for_problem(self, problem: Problem) -> Candidates:
        """Return the same forms at the same level and critical values for a problem of the same readings with random effects."""
        return self._for_products(self.products.for_problem(problem), problem)

    def followed_by(self, further: Candidates) -> Candidates:
        """Return these forms with their indices, as refined and excluded here, followed by those of causes that only others have."""
        own = {form.key for form in self.forms}
        new = [form for form in further.forms if form.key not in own]
        every = [(form.candidate, form.variant, form.log_tests) for form in (*self.forms, *new)]
        other = Candidates(self.problem, every, self.dof, self._parts, self.level)
        other._critical = np.array(other._critical)
        other._critical[: len(self.forms), : self._critical.shape[1]] = self._critical
        other._reasons = dict(self._reasons)
        other.further_periods = self.further_periods
        return other

    def _for_products(self, products: Products, problem: Problem) -> Candidates:
        """Return the same forms and critical values with other inner products."""
        other = copy(self)
        other._refined, other._requested, other._expected = {}, set(), set()
        other.forms = list(self.forms)
        other.products = products
        other._project(problem)
        other.set_problem(problem)
        other._critical = self._critical
        other.further_periods = self.further_periods
        return other

    def taken(self, forms: Sequence[Form]) -> np.ndarray:
        """Return (forms,) which forms may not be added to some others: those of the same slot, and beyond `Specification.most`.

        With `further_periods` an axis may have several periods, if the measured span resolves them.
        """
        taken = np.isin(self.slot_of, [self.slot_of[form.index] for form in forms])
        for form in forms:
            specification, name = form.candidate.specification, form.candidate.specification.period
            alike = [other for other in forms if other.key == form.key]
            if specification.most and len(alike) >= specification.most:
                taken |= self.key_of == self.key_of[form.index]
            elif name and self.further_periods:
                data, machine = self.problem.network.data, self.problem.network.machine
                span = np.ptp(data.positions[:, machine.names.index(form.candidate.where)])
                chosen = np.array([1.0 / other.variant.fixed[name] for other in alike])
                slot = self.slot_of == self.slot_of[form.index]
                tried = np.array([1.0 / self.forms[i].variant.fixed[name] for i in np.flatnonzero(slot)])
                taken[slot] = np.abs(tried[:, None] - chosen).min(axis=1) * span < RESOLVED
        return np.asarray(taken)

    def is_short_wave(self, form: Form) -> bool:
        """Return whether a form is a wave shorter than the mean distance of the measured positions."""
        period = form.candidate.specification.drawing.period(form.variant.fixed) if form.variant.fixed else 0.0
        if period == 0.0:
            return False
        data, machine = self.problem.network.data, self.problem.network.machine
        places = np.unique(np.round(data.positions[:, machine.names.index(axis_of(form.candidate.where))], 3))
        return bool(np.ptp(places) > period * (len(places) - 1))

    def has_imitating_waves(self, forms: Sequence[Form]) -> bool:
        """Return whether some forms hold short waves that explain a small part: one of many fits the rest of any other error."""
        others = [form for form in forms if not self.is_short_wave(form)]
        own = self.explained_by(forms) - self.explained_by(others)
        return len(others) < len(forms) and own < LEAST_SHORT_SHARE * (self.problem.chi2 - self.problem.dof)

    def calibrate(self) -> None:
        """Set the level so that noise alone is taken for a cause in a share `FALSE_ALARM_RATE` of all data sets.

        The smallest corrected p-value of all forms is simulated on noise alone; in the tail of its distribution the probability of
        a value below p is proportional to p.
        """
        problem, rng = self.problem, np.random.default_rng(SEED)
        count = len(problem.view.rows)
        points, products, root, inner = np.arange(count), self.products, problem.root, self._inner
        if count > SAMPLED_POINTS:
            # A sample of the points suffices for the correlation between forms.
            points = np.sort(rng.choice(count, SAMPLED_POINTS, replace=False))
            products = Products(problem, self.products.columns, self._columns, points)
            root = problem.orthonormal_on(points)
            inner = [count / len(points) * block for block in self._projected_blocks(products, products.on_basis(root))]
        basis = problem.nuisances.rows(points).reshape(3 * len(points), len(problem.nuisances.coordinates))
        read = problem.network.read[points].reshape(-1)
        noise = rng.standard_normal((len(read), NULL_DATA_SETS)) * read[:, None]
        # Columns of the symmetric root of the calibration's covariance.
        uncertain = problem.nuisances.coordinates[:, len(problem.setup) :]
        noise += basis @ (uncertain @ rng.standard_normal((uncertain.shape[1], NULL_DATA_SETS)))
        noise -= basis @ (root @ (root.T @ (basis.T @ noise)))
        slope = products.with_vectors(noise, points) * np.sqrt(count / len(points))
        scale = rng.chisquare(self.dof, NULL_DATA_SETS) / self.dof if np.isfinite(self.dof) else np.ones(NULL_DATA_SETS)
        smallest_log_p = np.zeros(NULL_DATA_SETS)
        for rows, columns, blocks in zip(self._rows, self._columns, inner, strict=True):
            values, vectors = np.linalg.eigh(blocks)
            seen = _identifiable(values, np.einsum("nii->ni", blocks).max(axis=1))
            root = vectors * np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), 0.0)[:, None, :]
            explained = np.sum((root.transpose(0, 2, 1) @ slope[columns]) ** 2, axis=1) / scale
            dof, log_tests = seen.sum(axis=1), np.array([self.forms[i].log_tests for i in rows])
            for of in {*zip(dof.tolist(), log_tests.tolist(), strict=True)} if len(rows) else ():
                if of[0]:
                    most = explained[(dof == of[0]) & (log_tests == of[1])].max(axis=0)
                    smallest_log_p = np.minimum(smallest_log_p, log_p_value(most, float(of[0]), self.dof) + of[1])
        quantile = float(np.exp(np.quantile(smallest_log_p, CALIBRATION_QUANTILE)))
        # By Bonferroni's inequality the uncorrected level is a lower bound: correlation can only allow a higher one.
        self.level = max(
            FALSE_ALARM_RATE,
            min(TAIL_FACTOR * quantile * np.log1p(-FALSE_ALARM_RATE) / np.log1p(-CALIBRATION_QUANTILE), 0.5),
        )

    def exclude(self, keys: Collection[tuple[str, str]], why: Message | None = None) -> None:
        """Exclude all forms of some effects and places until `set_problem`; ``why``, if the readings speak for them nevertheless."""
        self.exclude_forms([form for form in self.forms if form.key in keys])
        if why is not None:
            self._reasons |= dict.fromkeys(keys, why)

    @property
    def impossible(self) -> dict[tuple[str, str], Message]:
        """Effect and place of each candidate that is excluded although the readings speak for it, with the reason."""
        allowed = {form.key for form in self.forms if np.isfinite(self._critical[form.index, 1])}
        return {key: why for key, why in self._reasons.items() if key not in allowed}

    def exclude_forms(self, forms: Sequence[Form]) -> None:
        """Exclude these forms until `set_problem` is called."""
        self._critical = np.array(self._critical)
        self._critical[[form.index for form in forms]] = np.inf

    @property
    def critical_table(self) -> np.ndarray:
        """(forms, dof + 1) critical value of each form by degrees of freedom; infinite where the form is excluded."""
        return np.array(self._critical)

    @critical_table.setter
    def critical_table(self, values: np.ndarray) -> None:
        self._critical = np.array(values)

    def p_value(self, log_p: float) -> float:
        """Return the p-value corrected for the whole search, from a form's log p corrected for its number of tests."""
        return float(min(np.exp(log_p) * FALSE_ALARM_RATE / self.level, 1.0))

    def critical_value(self, form: Form, dof: float) -> float:
        """Return the critical value of a form: the reduction of chi² above which it is accepted."""
        return critical_value(dof, form.log_tests, self.level, self.dof)

    def _project(self, problem: Problem) -> None:
        self._on_basis = self.products.on_basis(problem.root)
        self._inner = self._projected_blocks(self.products, self._on_basis)
        # One row of inner products with all columns for each requested column; `_row` maps columns to rows, -1 where missing.
        self._cross = np.zeros((0, self._on_basis.shape[1]))
        self._row = np.full(self._on_basis.shape[1], -1)
        self._scans, self._fit = {}, None

    def _projected_blocks(self, products: Products, on_basis: np.ndarray) -> list[np.ndarray]:
        """Return the projected inner products within each form: (forms, w, w) for each width w."""
        within, projected_blocks = np.ascontiguousarray(on_basis.T), []
        for raw, columns in zip(products.within, self._columns, strict=True):
            removed = within[columns]
            projected_blocks.append(raw - removed @ removed.transpose(0, 2, 1))
        return projected_blocks

    def set_problem(self, problem: Problem) -> None:
        """Take over the residual of a problem with the same set-up and rows; exclusions and refinements are undone."""
        self.problem = problem
        self.products.set_residual(problem.residual)
        for form in self._refined.values():
            self._replace_form(form)
        if self._refined:
            self._project(problem)
        self._refined = {}
        self._update_slope()
        self._critical = self._initial_critical
        self._reasons = {}
        self._scans, self._fit = {}, None
        self.further_periods = False

    def _update_slope(self) -> None:
        """Compute the projected inner product of the residual with every column."""
        right = self.problem.root.T @ self.problem.residual_on_basis
        self.slope = self.products.by_residual - self._on_basis.T @ right

    def on_part(self, part: Problem) -> Candidates:
        """Return the same forms for a problem with some rows held out."""
        products = self.products.without(part.held_out) if len(part.held_out) else self.products
        other = self._for_products(products, part)
        other._expected, other._critical = self._requested, self._initial_critical
        return other

    def refine(self, form: Form, variant: Variant) -> None:
        """Replace the variant of a form by one as wide, with fitted non-linear parameters, until `set_problem` is called."""
        self._refined.setdefault(form.index, self.forms[form.index])
        self._replace_form(replace(form, variant=variant))
        self._project(self.problem)
        self._update_slope()

    def _replace_form(self, form: Form) -> None:
        self.forms[form.index] = form
        self.products.replace(form.columns, form.variant.columns)

    def fitted(self, forms: Sequence[Form]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the columns of some forms, their least-squares coefficients (in plausible sizes) and the covariance of these."""
        columns = columns_of(forms)
        if self._fit is None or not np.array_equal(self._fit[0], columns):
            inverse = pseudo_inverse(self.gram(forms))
            self._fit = columns, inverse @ self.slope[columns], inverse
        return self._fit

    def explained_by(self, forms: Sequence[Form]) -> float:
        """Return the reduction of chi² by some forms fitted together."""
        columns, values, _ = self.fitted(forms)
        return float(self.slope[columns] @ values)

    def divided(self, forms: Sequence[Form]) -> np.ndarray:
        """Return (k,) the reduction of chi² by some forms fitted together, divided among them (`shapley_values`)."""
        # In an order of their own: which orders of entry are drawn does not depend on the order of naming.
        order = sorted(range(len(forms)), key=lambda k: forms[k].index)
        columns = columns_of(forms)
        groups = [np.searchsorted(columns, forms[k].columns) for k in order]
        values = np.zeros(len(forms))
        values[order] = shapley_values(self.gram(forms), self.slope[columns], groups)
        return values

    def gram(self, forms: Sequence[Form]) -> np.ndarray:
        """Return the projected inner products of the columns of some forms, in the order of `columns_of`."""
        columns = columns_of(forms)
        known = self._row[columns] >= 0
        fresh = [form for form in forms if np.any(self._row[form.columns] < 0)]
        if len(fresh) > 1:
            # One new form needs no pass: its products with the others are in their rows, those within it are known.
            self.cross(columns_of(fresh[1:]))
            return self.gram(forms)
        gram = np.zeros((len(columns), len(columns)))
        for form in fresh:
            at = np.searchsorted(columns, form.columns)
            kind, place = self._place[form.index]
            gram[np.ix_(at, at)] = self._inner[kind][place]
        rows = self._cross[np.ix_(self._row[columns[known]], columns)]
        gram[known], gram[:, known] = rows, rows.T
        return gram

    def contains(self, larger: Sequence[Form], others: Sequence[Form], form: Form, *, remaining: float = 1e-3) -> bool:
        """Return whether a larger set of forms spans what a form adds to some others, but for a share of its squared norm."""
        return bool(np.trace(self._remaining(form, larger)) < remaining * np.trace(self._remaining(form, others)))

    def cancels(self, form: Form, others: Sequence[Form], cause: Form) -> bool:
        """Return whether less than 1 % of a form's squared norm remains given others, and 1 % of the share that remains of a cause."""
        share, share_of_cause = (
            float(np.trace(self._remaining(f, others)) / np.trace(self._remaining(f, ()))) for f in (form, cause)
        )
        return share < 1e-2 * min(share_of_cause, 1.0)

    def scan(
        self, forms: Sequence[Form], beside: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the reduction of chi² by every form given some others, and its degrees of freedom; (forms,) each.

        ``beside``: further directions of unit weight, by their inner products (r, all) with all columns and (r,) with the residual.
        """
        key = frozenset(form.index for form in forms)
        if beside is None and key in self._scans:
            return self._scans[key]
        factor, slope = self._given(forms, beside)
        explained, dof = np.zeros(len(self.forms)), np.zeros(len(self.forms), dtype=int)
        for rows, columns, blocks in self.blocks():
            removed = factor[columns]
            given = blocks - removed @ removed.transpose(0, 2, 1)
            explained[rows], dof[rows] = _fit_blocks(blocks, given, slope[columns])
        if beside is None:
            self._latest = explained - self.critical_values(dof)
            self._scans[key] = explained, dof
        return explained, dof

    def critical_values(self, dof: np.ndarray) -> np.ndarray:
        """Return the critical value (forms,) of every form at its degrees of freedom."""
        return np.asarray(self._critical[np.arange(len(dof)), dof])

    def along(
        self, groups: Sequence[tuple[Column, ...]], basis: np.ndarray, which: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the projected inner products (k, which) of the k columns of groups with some columns of the forms, or all.

        ``basis``: their inner products (directions, k) with the nuisance basis, made orthonormal on these data (`Problem.root`).
        """
        on_basis = self._on_basis if which is None else self._on_basis[:, which]
        return self.products.with_groups(groups, which) - basis.T @ on_basis

    def scores(self, forms: Sequence[Form], tried: Sequence[int]) -> np.ndarray:
        """Return (tried, 3) reduction of chi², degrees of freedom and corrected log p of some forms (indices), given others."""
        explained, dof = (values[list(tried)] for values in self.scan(forms))
        log_tests = np.array([self.forms[i].log_tests for i in tried])
        log_p = np.where(dof > 0, log_p_value(explained, np.maximum(dof, 1), self.dof) + log_tests, 0.0)
        return np.stack([explained, dof, np.minimum(log_p, 0.0)], axis=1)

    def margins(self, forms: Sequence[Form]) -> np.ndarray:
        """Return the reduction of chi² by every form given some others, less its critical value; −inf where it is not identifiable."""
        explained, dof = self.scan(forms)
        return explained - self.critical_values(dof)

    def penalised_gain(self, forms: Sequence[Form]) -> float:
        """Return the chi² reduction by a set of forms, less the critical value of each for its identifiable directions."""
        if not forms:
            return 0.0
        columns, gram = columns_of(forms), self.gram(forms)
        explained = float(np.sum((self.slope[columns] @ inverse_root(gram)) ** 2))
        total = explained - ADDITIONAL_CAUSE_PENALTY * (len(forms) - 1)
        # Adding 1 to the diagonal makes the matrix invertible; it is far below `LEAST_NONCENTRALITY`.
        regular = _inverse_factor(gram + np.eye(len(columns)))
        for width, alike in _by_width(forms).items():
            at = np.searchsorted(columns, np.stack([form.columns for form in alike]))
            factor = regular[:, at].transpose(1, 2, 0)
            given_others = np.linalg.inv(factor @ factor.transpose(0, 2, 1)) - np.eye(width)
            seen = _identifiable(np.linalg.eigvalsh(given_others), np.diag(gram)[at].max(axis=1))
            for form, dof in zip(alike, seen.sum(axis=1).tolist(), strict=True):
                total -= float(self._critical[form.index, dof]) if dof else self.critical_value(form, 1.0)
        return total

    def blocks(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return indices (n,), columns (n, w) and projected inner products (n, w, w) of the forms with w columns, for each w."""
        return list(zip(self._rows, self._columns, self._inner, strict=True))

    def cross(self, columns: np.ndarray) -> np.ndarray:
        """Return the projected inner products (columns, all) of some columns with all; missing ones are computed first."""
        if np.any(self._row[columns] < 0):
            fresh = self._with_expected(columns[self._row[columns] < 0])
            products = self.products.cross(fresh) - self._on_basis[:, fresh].T @ self._on_basis
            filled = int(self._row.max()) + 1
            if filled + len(products) > len(self._cross):
                grown = np.zeros((2 * filled + len(products), self._cross.shape[1]))
                grown[:filled] = self._cross[:filled]
                self._cross = grown
            self._row[fresh] = filled + np.arange(len(fresh))
            self._cross[self._row[fresh]] = products
        return self._cross[self._row[columns]]

    def prepare(self, forms: Sequence[Form]) -> None:
        """Compute the inner products of some forms with all others in one pass; for part of the data only those already cached."""
        cached = self.products.cached
        few = [form for form in forms if not self._expected or cached[form.columns].all()]
        if few:
            self.cross(columns_of(few))

    def _with_expected(self, columns: np.ndarray) -> np.ndarray:
        """Return the columns and those likely to be needed next, since most of the cost is the pass over the data.

        For a part of the data, these are the columns that were needed for all data; otherwise the best form of each candidate, in
        order of its margin.
        """
        self._requested |= set(columns.tolist())
        indices = dict.fromkeys([*columns.tolist(), *(self._expected - self._requested)])
        cached = self.products.cached
        here = bool(cached[columns].all())
        seen: set[int] = set()
        for i in np.argsort(-self._latest, kind="stable").tolist():
            if len(indices) >= BATCH or self._latest[i] <= 0.0:
                break
            key, of_form = int(self.key_of[i]), self.forms[i].columns
            if key not in seen and (not here or cached[of_form].all()):
                indices |= dict.fromkeys(of_form[self._row[of_form] < 0].tolist())
            seen.add(key)
        return np.sort(np.array(list(indices), dtype=int))

    def _given(
        self, forms: Sequence[Form], beside: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the factor (all, r) of the matrix to subtract from the inner products given some forms, and the slope left (all,)."""
        columns = columns_of(forms)
        rows = self.cross(columns)
        if beside is None:
            root = inverse_root(rows[:, columns])
            return rows.T @ root, self.slope - (root @ (root.T @ self.slope[columns])) @ rows
        directions, along = beside
        slope = self.slope - directions.T @ along
        rows = rows - directions[:, columns].T @ directions
        root = inverse_root(rows[:, columns])
        return np.concatenate([directions.T, rows.T @ root], axis=1), slope - (root @ (root.T @ slope[columns])) @ rows

    def _remaining(self, form: Form, others: Sequence[Form]) -> np.ndarray:
        """Return the projected inner products (w, w) of a form given others; no pass over the data if one of all forms is new."""
        kind, place = self._place[form.index]
        block = self._inner[kind][place]
        if len(others) == 0:
            return np.asarray(block)
        columns, gram = columns_of([*others, form]), self.gram([*others, form])
        at, given = (np.searchsorted(columns, some) for some in (form.columns, columns_of(others)))
        inverse = pseudo_inverse(gram[np.ix_(given, given)])
        shared = gram[np.ix_(given, at)]
        return np.asarray(block - shared.T @ inverse @ shared)


def _fit_blocks(whole: np.ndarray, blocks: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the reduction of chi² (n,) and the number of identifiable directions (n,) of forms.

    ``whole``: inner products (n, w, w) before other forms are given; ``blocks`` and ``slope`` (n, w), with the residual, after.
    """
    if blocks.shape[1] == 1:
        values, along = blocks[:, :, 0], slope
    else:
        values, vectors = np.linalg.eigh(blocks)
        along = np.einsum("nij,ni->nj", vectors, slope)
    seen = _identifiable(values, np.einsum("nii->ni", whole).max(axis=1))
    return np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1), seen.sum(axis=1)


def _identifiable(values: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Return which directions (n, w) are identifiable, from eigenvalues and the largest inner product (n,) of each form alone."""
    return (values > LEAST_NONCENTRALITY) & (values > 1e-8 * most[:, None])


def log_p_value(explained: np.ndarray, dof: np.ndarray | float, noise_dof: float) -> np.ndarray:
    """Return the natural log of the p-value of a reduction of chi² with ``dof`` degrees of freedom, the noise having ``noise_dof``."""
    half = np.asarray(dof) / 2.0
    # Where the library's sf underflows, use the leading term (Abramowitz and Stegun 1972, 6.5.32 and 26.5.4), which keeps the order.
    if np.isfinite(noise_dof):
        log_p = np.asarray(f_log_sf(explained / dof, dof, noise_dof))
        far, half_noise = np.isneginf(log_p), noise_dof / 2.0
        small = noise_dof / (noise_dof + np.where(far, explained, 1.0))
        tail = half_noise * np.log(small) - np.log(half_noise) - scipy.special.betaln(half_noise, half)
        return np.where(far, tail, log_p)
    log_p = np.asarray(chi2_log_sf(explained, dof))
    far = np.isneginf(log_p)
    safe = np.where(far, explained, 1.0) / 2.0
    return np.where(far, (half - 1.0) * np.log(safe) - safe - scipy.special.gammaln(half), log_p)


@lru_cache(maxsize=4096)
def critical_value(dof: float, log_tests: float, level: float, noise_dof: float) -> float:
    """Return the reduction of chi² above which a form is accepted at a level."""
    dof, p = max(dof, 1.0), level * np.exp(-log_tests)
    return float(dof * f_isf(p, dof, noise_dof) if np.isfinite(noise_dof) else chi2_isf(p, dof))


def _critical_table(forms: Sequence[Form], level: float, noise_dof: float) -> np.ndarray:
    """Return the critical values (forms, dof + 1) by degrees of freedom; infinite for none."""
    most = max((len(form.columns) for form in forms), default=0)
    critical_table = np.full((len(forms), most + 1), np.inf)
    for form in forms:
        for dof in range(1, len(form.columns) + 1):
            critical_table[form.index, dof] = critical_value(float(dof), form.log_tests, level, noise_dof) + TIE * len(
                form.columns
            )
    return critical_table


def _numbered(names: Sequence[Hashable]) -> np.ndarray:
    number: dict[Hashable, int] = {}
    return np.array([number.setdefault(name, len(number)) for name in names], dtype=int)


def _by_width(forms: Sequence[Form]) -> dict[int, list[Form]]:
    forms_by_width: dict[int, list[Form]] = {}
    for form in forms:
        forms_by_width.setdefault(len(form.columns), []).append(form)
    return forms_by_width


def columns_of(forms: Sequence[Form]) -> np.ndarray:
    """Return the columns of some forms, each once, in ascending order."""
    columns = [form.columns for form in forms]
    return np.unique(np.concatenate(columns)) if columns else np.zeros(0, dtype=int)


def shapley_values(gram: np.ndarray, slope: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Return (k,) the reduction of chi² by all columns, divided among k groups of them: the mean over the orders of entry.

    Each value is the reduction by its group in addition to those entered before, averaged (Shapley 1953; Lindeman, Merenda, Gold 1980;
    Grömping 2007, Am. Stat. 61, 139). None is negative, and their sum is the reduction by all.

    Args:
        gram, slope: inner products (c, c) of the columns, and (c,) with the residual.
        groups: columns of each group.
    """
    count = len(groups)
    if count <= MAX_ALL_ORDERS:
        orders = list(permutations(range(count)))
    else:
        rng = np.random.default_rng(SEED)
        drawn = [rng.permutation(count) for _ in range(DRAWN_ORDERS // 2)]
        orders = [tuple(own.tolist()) for order in drawn for own in (order, order[::-1])]
    values = np.zeros(count)
    # As in `penalised_gain`, far below `LEAST_NONCENTRALITY`.
    regular = gram + np.eye(len(gram))
    for order in orders if count else ():
        columns = np.concatenate([groups[k] for k in order])
        whole = regular[np.ix_(columns, columns)]
        # A column that two groups share counts for the first.
        whole[np.diag_indices_from(whole)] += TIE
        gained = (_inverse_factor(whole) @ slope[columns]) ** 2
        values[list(order)] += np.add.reduceat(gained, np.cumsum([0, *(len(groups[k]) for k in order[:-1])]))
    return values / max(len(orders), 1)


def pseudo_inverse(gram: np.ndarray, least: float = LEAST_NONCENTRALITY) -> np.ndarray:
    """Return the pseudo-inverse of inner products over the identifiable directions."""
    root = inverse_root(gram, least)
    return np.asarray(root @ root.T)


def inverse_root(gram: np.ndarray, least: float = LEAST_NONCENTRALITY) -> np.ndarray:
    """Return a root R (n, n) with RRᵀ the pseudo-inverse of inner products (n, n) over the identifiable directions.

    A direction is not if its noncentrality is below ``least``; rounding is excluded always.
    """
    if len(gram) == 0:
        return gram
    # If the matrix less the limit has a Cholesky factor, all eigenvalues are above the limit.
    trace = float(np.trace(gram))
    limit = max(least, 1e-9 * trace)
    if scipy.linalg.lapack.dpotrf(gram - limit * np.eye(len(gram)), lower=1)[1] == 0:
        return _inverse_factor(gram).T
    # Usually a few eigenvalues are below it: their vectors alone take half the time of all.
    values, vectors = scipy.linalg.eigh(gram, subset_by_value=(-np.inf, limit), driver="evx", check_finite=False)
    if np.any(values > least):
        limit = max(least, 1e-9 * float(np.linalg.norm(gram, 2)))
    hidden = vectors[:, values <= limit]
    root = _inverse_factor(gram + ((limit + trace / len(gram)) * hidden) @ hidden.T).T
    return root - hidden @ (hidden.T @ root)


def _inverse_factor(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse (n, n) of the lower Cholesky factor of a positive definite matrix."""
    lower, _ = scipy.linalg.lapack.dpotrf(matrix, lower=1)
    return np.asarray(scipy.linalg.lapack.dtrtri(lower, lower=1)[0])
