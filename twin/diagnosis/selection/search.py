"""Selection of causes: forward with exchange and removal, corrected for multiple testing.

Sets of causes are compared by the χ² they explain less the χ² that each must explain to be significant (`twin.diagnosis.problem.pool`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, Cell
from twin.diagnosis.problem.pool import FURTHER, Form, Pool
from twin.diagnosis.problem.readings import Posed
from twin.diagnosis.selection.left_out import choose_folds

SHARE: Final = 0.25
"""A family's share of `ALARMS` grows with its number of forms to this power, less than proportionally."""
SELDOM: Final = 0.1
"""Factor on the share of `ALARMS` of mistakes in the calibration, which are rare and easily recognised."""
MOST: Final = 30
"""Largest number of causes: about the number of error curves of a machine."""
FEW: Final = 6
"""Number of causes up to which every step is followed by exchanges and several starts are tried; above, only the whole set once."""
STARTS: Final = 4
"""Number of first causes to start from."""
SAME: Final = 0.01
"""Relative difference of explained χ² up to which two sets of forms count as equal."""
TRIED: Final = 3
"""Number of exchanges evaluated in full."""
DOUBTED: Final = 3.0
"""Standard uncertainties by which a value may exceed its physical limit."""
CANCELS: Final = 10.0
"""Largest sum of squares of one cause relative to all that the causes explain."""
FEWEST: Final = 25.0
"""χ² added to the explained one in this comparison, for the contribution of noise."""
ROUGHLY: Final = 0.2
"""Deviation from one allowed for the parameter of an effect that is either completely present or absent."""
LEAST: Final = 0.01
"""Smallest share of a pliable effect in the χ² explained by all causes: a smaller one only fits the residual of a larger cause."""
LIKELY: Final = 12
"""Number of forms whose inner products with all others are evaluated together."""


@final
@dataclass(frozen=True)
class Selection:
    """A set of causes.

    Attributes:
        forms: the causes.
        worth: the χ² they explain less the χ² that each must explain.
    """

    forms: tuple[Form, ...]
    worth: float


def select(pool: Pool, begun: Sequence[Form] = ()) -> Selection:
    """Return the best set of causes: forward selection from several starts, with removal and exchange after each step.

    Args:
        pool: the forms.
        begun: a set to start from instead, whose causes stay if each is significant.
    """
    found = Selection((), 0.0)
    if not pool.forms:
        return found
    if begun:
        pool.prepare(begun)
        forms = forward_selection(pool, list(begun))
        return Selection(tuple(forms), pool.worth(forms))
    margin = pool.margins([])
    order = [int(i) for i in np.argsort(-margin, kind="stable") if margin[i] > 0.0]
    first: dict[int, int] = {}
    for i in order:
        first.setdefault(int(pool.key_of[i]), i)
    if not first:
        return found
    pool.prepare([pool.forms[i] for i in list(first.values())[:LIKELY]])
    likely = [[pool.forms[i]] for i in list(first.values())[:STARTS]]
    for start in likely:
        forms = forward_selection(pool, start)
        worth = pool.worth(forms)
        if worth > found.worth + 1e-6:
            found = Selection(tuple(forms), worth)
        if len(forms) > FEW:
            break  # a model with very many errors: the start does not matter
    if len(found.forms) > FEW:
        # A machine whose constants were never identified: each explains little before the others are in the model.
        numbers = np.array([form.candidate.specification.constant for form in pool.forms])
        forms = forward_selection(pool, forward_selection(pool, [], numbers))
        worth = pool.worth(forms)
        if worth > (1.0 - SAME) * found.worth:
            found = Selection(tuple(forms), worth)
    forms = _split(pool, list(found.forms))
    return Selection(tuple(forms), pool.worth(forms))


def largest_causes(pool: Pool, most: int) -> tuple[Form, ...]:
    """Return the first few, largest causes, without re-examination."""
    margin = pool.margins([])
    if len(margin) == 0 or margin.max() <= 0.0:
        return ()
    return tuple(forward_selection(pool, [pool.forms[int(np.argmax(margin))]], most=most))


def within_limits(pool: Pool, best: Selection, anew: bool) -> Selection:
    """Return the best set in which no cause is larger than possible (`excess_ratio`).

    Args:
        pool: the forms.
        best: the best set, whatever its size (`select`).
        anew: whether to search from the start without a cause that is too large, or to continue with the others.
    """
    allowed = pool.allowed
    while True:
        if any(
            form.candidate.specification.pliable and excess_ratio(pool, form, best.forms) == np.inf
            for form in best.forms
        ):
            # Exclude all of them; causes they displaced return.
            pool.allowed = allowed
            pool.forbid({form.key for form in pool.forms if form.candidate.specification.pliable})
            allowed = pool.allowed
            best = select(pool, () if anew else [f for f in best.forms if not f.candidate.specification.pliable])
            continue
        excess = [excess_ratio(pool, form, best.forms) for form in best.forms]
        if not excess or max(excess) <= 1.0:
            return best
        # One at a time: another cause that it compensated may be possible without it.
        worst = best.forms[int(np.argmax(excess))].key
        pool.forbid({worst})
        best = select(pool, () if anew else [form for form in best.forms if form.key != worst])


def excess_ratio(pool: Pool, form: Form, forms: Sequence[Form]) -> float:
    """Return the ratio of a form's size to the largest possible: by physics, or by the residuals it explains.

    A cause larger than the residuals needs another that cancels it; neither exists.

    Args:
        pool: the data.
        form: one of ``forms``.
        forms: the selected forms.
    """
    columns, values, inverse = pool.fitted(forms)
    at = np.searchsorted(columns, form.columns)
    u = np.sqrt(np.maximum(np.diag(inverse)[at], 0.0))
    return excess_ratio_of(form, values[at], u, pool.gram([form]), float(pool.slope[columns] @ values))


def excess_ratio_of(form: Form, values: np.ndarray, u: np.ndarray, gram: np.ndarray, explained: float) -> float:
    """Return the ratio of `excess_ratio` for given values, in plausible sizes, with their standard uncertainties.

    Args:
        form: the form.
        values: (w,) of its columns.
        u: (w,) standard uncertainties.
        gram: (w, w) inner products of its columns.
        explained: χ² explained by all causes together.
    """
    own = float(values @ gram @ values)
    if form.candidate.specification.pliable and own < LEAST * explained:
        return np.inf
    found = own / (CANCELS * (explained + FEWEST))
    scale = np.array([column.scale for column in form.cell.columns])
    if np.isfinite(form.candidate.largest):
        found = max(found, float(np.max((np.abs(values) - DOUBTED * u) * scale)) / form.candidate.largest)
    if form.candidate.specification.one_way and len(values) == 1 and values[0] < -DOUBTED * u[0]:
        return np.inf
    if form.candidate.specification.whole:
        found = max(found, abs(float(values[0] * scale[0]) - 1.0) / max(ROUGHLY, DOUBTED * float(u[0] * scale[0])))
    return found


def _split(pool: Pool, forms: list[Form]) -> list[Form]:
    """Split curves with a constant or a slope into constants of the machine and the remaining curves.

    By the datum, a curve has neither (`twin.identification.unknowns`). If they are the smaller part of the curve, one cause is the
    simpler description; if they are the larger part, the error is the constant, and the curves that share it hide it.
    """
    pure = {(one.key, one.cell.columns[-1]): one for one in pool.forms if one.cell.fixed.get("first", 0.0) > 0.0}
    bent = [pure[form.key, form.cell.columns[-1]] for form in forms if form.cell.fixed.get("first") == 0.0]
    trial = [form for form in forms if form.cell.fixed.get("first") != 0.0]
    whole = pool.explained_by(forms)
    enough = whole - SAME * (whole - pool.explained_by(trial))
    trial += bent
    numbers: list[Form] = []
    while bent and pool.explained_by(trial) < enough:
        margin = np.where([form.candidate.specification.constant for form in pool.forms], _free(pool, trial), -np.inf)
        if margin.max() <= 0.0:
            return forms
        numbers.append(pool.forms[int(np.argmax(margin))])
        trial.append(numbers[-1])
    whole = pool.explained_by(trial)
    for one in numbers:
        others = [other for other in trial if other is not one]
        own = whole - pool.explained_by(others)
        hosts = []
        for form, rest in zip([form for form in forms if form.cell.fixed.get("first") == 0.0], bent, strict=True):
            hosted = pool.explained_by([form if other is rest else other for other in others])
            if hosted > whole - SAME * own:
                hosts.append(whole - pool.explained_by([other for other in trial if other is not rest]))
        # If several curves could contain the constant, none is preferred.
        if len(hosts) == 1 and own < hosts[0]:
            return forms
    for rest in bent:
        without = [one for one in trial if one is not rest]
        if pool.worth(without) >= pool.worth(trial):
            trial = without
    return trial


def forward_selection(
    pool: Pool, forms: Sequence[Form], allowed: np.ndarray | bool = True, most: int = MOST
) -> list[Form]:
    """Add forms as long as each is significant.

    Args:
        pool: the forms.
        forms: the forms to start with.
        allowed: (forms,) which may be added.
        most: largest number of forms.
    """
    forms = _exchanged(pool, list(forms), allowed)
    while len(forms) < most:
        now = pool.worth(forms)
        best = pool.forms[int(np.argmax(pool.margins(forms)))]
        if best.bent and best.slot in {form.slot for form in forms}:
            # Most of the residual is due to a period or time constant between two tabulated ones; the estimate refines these.
            return forms
        margin = np.where(allowed, _free(pool, forms), -np.inf)
        for i in np.argsort(-margin, kind="stable")[:TRIED]:
            if margin[i] <= FURTHER:
                return _exchanged(pool, forms, allowed) if len(forms) > FEW else forms
            larger = [*forms, pool.forms[int(i)]]
            if len(larger) <= FEW:
                larger = _exchanged(pool, larger, allowed)
            if pool.worth(larger) > now + 1e-6:
                break
        else:
            return forms
        forms = larger
    return _exchanged(pool, forms, allowed) if len(forms) > FEW else forms


def _free(pool: Pool, forms: Sequence[Form]) -> np.ndarray:
    """Return the margins of the forms that may be added to some others."""
    taken = [pool.slot_of[form.index] for form in forms]
    return np.where(np.isin(pool.slot_of, taken), -np.inf, pool.margins(forms))


def _exchanged(pool: Pool, forms: list[Form], allowed: np.ndarray | bool) -> list[Form]:
    """Return the set with each cause replaced by a better one, or dropped, until nothing changes."""
    now = pool.worth(forms)
    for _ in range(8):
        better = _better(pool, forms, now, allowed)
        if better is None:
            break
        forms, now = better
    return forms


def _better(pool: Pool, forms: list[Form], now: float, allowed: np.ndarray | bool) -> tuple[list[Form], float] | None:
    """Return the first better set by removal or exchange, with its worth; None if there is none."""
    for k in range(len(forms))[-FEW:]:
        others = forms[:k] + forms[k + 1 :]
        if others and (worth := pool.worth(others)) >= now:
            return others, worth
        margin = np.where(allowed, _free(pool, others), -np.inf)
        for i in np.argsort(-margin)[:TRIED]:
            trial = [*others, pool.forms[int(i)]]
            if (
                np.isfinite(margin[i])
                and pool.forms[int(i)] is not forms[k]
                and (worth := pool.worth(trial)) > now + 1e-6
            ):
                return trial, worth
    return None


def priced_forms(candidates: Sequence[Candidate], costs: dict[str, float]) -> list[tuple[Candidate, Cell, float]]:
    """Return all forms of all candidates, with their corrections for multiple testing."""
    return [(c, cell, costs[c.effect]) for c in candidates for cell in c.cells]


def prices(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Return the log of the effective number of tests by effect: forms of its family over the family's share of false alarms."""
    tests: dict[str, float] = {}
    seldom = {candidate.effect for candidate in candidates if candidate.specification.seldom}
    for candidate in candidates:
        tests[candidate.effect] = tests.get(candidate.effect, 0.0) + candidate.tests
    shares = {effect: count**SHARE * (SELDOM if effect in seldom else 1.0) for effect, count in tests.items()}
    total = sum(shares.values())
    return {effect: float(np.log(total * count / shares[effect])) for effect, count in tests.items()}


def pool_of(posed: Posed) -> Pool:
    """Return every form of every candidate with its correction for multiple testing, evaluated on the data."""
    problem, known = posed.problem, posed.known.candidates
    split = choose_folds(problem.network.data, problem.network.machine, ())
    return Pool(problem, priced_forms(known, prices(known)), posed.scatter.dof, None if split is None else split.fold)
