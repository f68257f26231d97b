"""Selection of causes: forward with exchange and removal, corrected for multiple testing.

Sets of causes are compared by the χ² they explain less the χ² that each must explain to be significant (`problem.forms`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import first_largest, largest_first
from twin._common.messages import Message
from twin.diagnosis.candidates.candidate import LARGEST_ERROR, Candidate
from twin.diagnosis.cross_validation import choose_folds
from twin.diagnosis.estimate import estimate
from twin.diagnosis.forms import ADDITIONAL_CAUSE_PENALTY, Candidates, Form
from twin.diagnosis.readings import PLACING_ITERATIONS, DiagnosisTask, Readings
from twin.identification.discrepancy import outliers

FAMILY_POWER: Final = 0.25  # a family's share of `FALSE_ALARM_RATE` grows with its number of forms to this power
RARE_FACTOR: Final = 0.1  # on the share of `FALSE_ALARM_RATE` of mistakes in the calibration: rare, easily recognised
MAX_CAUSES: Final = 30  # largest number of causes: about the number of error curves of a machine
MAX_EXCHANGED_CAUSES: Final = 6
"""Number of causes up to which every step is followed by exchanges and several starts are tried; above, only the whole set once."""
MAX_FIRST_CAUSES: Final = 4  # number of first causes to start from
EQUAL_CHI2: Final = 0.01  # relative difference of explained χ² up to which two sets of forms count as equal
MAX_EXCHANGES_EVALUATED: Final = 3  # number of exchanges evaluated in full
MAX_EXCHANGE_ROUNDS: Final = 8  # number of removals and exchanges after a step
LIMIT_SIGMA: Final = 3.0  # standard uncertainties by which a value may exceed its physical limit
MAX_CHI2_RATIO: Final = 10.0  # largest sum of squares of one cause relative to all that the causes explain
NOISE_CHI2: Final = 25.0  # χ² added to the explained one in this comparison, for the contribution of noise
ALL_OR_NOTHING_TOLERANCE: Final = 0.2
"""Deviation from one allowed for the parameter of an effect that is either completely present or absent."""
LEAST_FLEXIBLE_SHARE: Final = 0.01
"""Smallest share of a pliable effect in the χ² explained by all causes: a smaller one only fits the residual of a larger cause."""
FIT_ONLY_TOGETHER: Final = Message("they fit only together with another cause that cancels them")
PART_OF_ANOTHER: Final = Message("they only fit the residuals of a larger cause")
TOO_LARGE: Final = Message("they fit only with a size that is physically impossible")
FIT_ONLY_NEGATIVE: Final = Message("they fit only with a negative size, which is physically impossible")
FIT_ONLY_IN_PART: Final = Message("they are either there completely or not at all, and fit only in part")
"""Reasons for which causes are left out, in words."""
FORMS_AT_ONCE: Final = 12  # number of forms whose inner products with all others are evaluated together


@final
@dataclass(frozen=True)
class Selection:
    """A set of causes."""

    forms: tuple[Form, ...]
    worth: float  # the χ² they explain less the χ² that each must explain


def select(candidates: Candidates, begun: Sequence[Form] = ()) -> Selection:
    """Return the best set of causes: forward selection from several starts, with removal and exchange after each step.

    A set that is begun with stays if each of its causes is significant.
    """
    if not candidates.forms:
        return Selection((), 0.0)
    if begun:
        candidates.prepare(begun)
        return _selection(candidates, forward_selection(candidates, begun))
    margin = candidates.margins([])
    first: dict[int, Form] = {}
    for i in largest_first(margin).tolist():
        if margin[i] > 0.0:
            first.setdefault(int(candidates.key_of[i]), candidates.forms[i])
    candidates.prepare(list(first.values())[:FORMS_AT_ONCE])
    best = Selection((), 0.0)
    starts = [_with_second(candidates, form) for form in list(first.values())[:MAX_FIRST_CAUSES]]
    for start in starts + _pairs(candidates, first):
        selection = _selection(candidates, forward_selection(candidates, start))
        if selection.worth > best.worth + 1e-6:
            best = selection
        if len(selection.forms) > MAX_EXCHANGED_CAUSES:
            break  # a model with very many errors: the start does not matter
    if len(best.forms) > MAX_EXCHANGED_CAUSES:
        # A machine whose constants were never identified: each explains little before the others are in the model.
        constant = np.array([form.candidate.specification.constant for form in candidates.forms])
        selection = _selection(candidates, forward_selection(candidates, forward_selection(candidates, [], constant)))
        if selection.worth > (1.0 - EQUAL_CHI2) * best.worth:
            best = selection
    return _selection(candidates, _split(candidates, list(best.forms)))


def _with_second(candidates: Candidates, form: Form) -> list[Form]:
    """Return a first cause with the best second one, if any: alone, it would be exchanged for the best single cause at once."""
    margin = _free(candidates, [form])
    i = first_largest(margin)
    return [form, candidates.forms[i]] if margin[i] > ADDITIONAL_CAUSE_PENALTY else [form]


def _pairs(candidates: Candidates, first: Mapping[int, Form]) -> list[list[Form]]:
    """Return the best two causes of each kind and place that may have several, such as two steps of a scale: each explains little."""
    pairs = []
    for key, form in first.items():
        own = candidates.key_of == key
        margin = (
            np.where(own, _free(candidates, [form]), -np.inf) if form.candidate.specification.most > 1 else np.zeros(0)
        )
        if margin.size and margin.max() > 0.0:
            pairs.append(_exchanged(candidates, [form, candidates.forms[first_largest(margin)]], own))
    return pairs


def _selection(candidates: Candidates, forms: Sequence[Form]) -> Selection:
    return Selection(tuple(forms), candidates.penalised_gain(forms))


def largest_causes(candidates: Candidates, most: int) -> tuple[Form, ...]:
    """Return the first few, largest causes, without re-examination."""
    margin = candidates.margins([])
    if len(margin) == 0 or margin.max() <= 0.0:
        return ()
    return tuple(forward_selection(candidates, [candidates.forms[first_largest(margin)]], most=most))


def within_limits(candidates: Candidates, best: Selection, anew: bool) -> Selection:
    """Return the best set, from one of any size, in which no cause is larger than possible (`excess_ratio`).

    ``anew``: search from the start without a cause that is too large, not on with the others.
    """
    allowed = candidates.critical_table
    while True:
        flexible = [form for form in best.forms if form.candidate.specification.flexible]
        if any(excess_ratio(candidates, form, best.forms) == np.inf for form in flexible):
            # Exclude all of them; causes they displaced return.
            candidates.critical_table = allowed
            candidates.exclude({form.key for form in candidates.forms if form.candidate.specification.flexible})
            candidates.exclude({form.key for form in flexible}, PART_OF_ANOTHER)
            allowed = candidates.critical_table
            best = select(candidates, () if anew else [form for form in best.forms if form not in flexible])
            continue
        excesses = [max(_excesses(candidates, form, best.forms), key=lambda pair: pair[0]) for form in best.forms]
        if not excesses or max(ratio for ratio, _ in excesses) <= 1.0:
            return best
        # One at a time: another cause that it compensated may be possible without it.
        k = first_largest(np.array([ratio for ratio, _ in excesses]))
        worst = best.forms[k].key
        candidates.exclude({worst}, excesses[k][1])
        best = select(candidates, () if anew else [form for form in best.forms if form.key != worst])


def excess_ratio(candidates: Candidates, form: Form, forms: Sequence[Form]) -> float:
    """Return the ratio of the size of one of some forms to the largest possible: by physics, or by the residuals it explains.

    A cause larger than the residuals needs another that cancels it; neither exists.
    """
    return max(ratio for ratio, _ in _excesses(candidates, form, forms))


def _excesses(candidates: Candidates, form: Form, forms: Sequence[Form]) -> list[tuple[float, Message]]:
    """Return the ratios of a form's size to each of its limits, each with the words for a size beyond it."""
    columns, values, inverse = candidates.fitted(forms)
    at = np.searchsorted(columns, form.columns)
    u = np.sqrt(np.maximum(np.diag(inverse)[at], 0.0))
    return excesses_of(form, values[at], u, candidates.gram([form]), float(candidates.slope[columns] @ values))


def excesses_of(
    form: Form, values: np.ndarray, u: np.ndarray, gram: np.ndarray, explained: float
) -> list[tuple[float, Message]]:
    """Return the ratios of `excess_ratio`, with words, for values (w,) in plausible sizes; ``explained`` is the χ² by all causes."""
    chi2, specification = float(values @ gram @ values), form.candidate.specification
    excesses = [(chi2 / (MAX_CHI2_RATIO * (explained + NOISE_CHI2)), FIT_ONLY_TOGETHER)]
    if specification.flexible and chi2 < LEAST_FLEXIBLE_SHARE * explained:
        excesses.append((np.inf, PART_OF_ANOTHER))
    scale = np.array([column.scale for column in form.variant.columns])
    if form.candidate.space is not None:
        # What a curve moves at the measured positions: beyond them its functions may be any size.
        scale = np.full(len(scale), LARGEST_ERROR)
    if np.isfinite(form.candidate.largest):
        size = float(np.max((np.abs(values) - LIMIT_SIGMA * u) * scale))
        excesses.append((size / form.candidate.largest, TOO_LARGE))
    if specification.non_negative and values[0] < -LIMIT_SIGMA * u[0]:
        excesses.append((np.inf, FIT_ONLY_NEGATIVE))
    if specification.all_or_nothing:
        off = abs(float(values[0] * scale[0]) - 1.0)
        excesses.append((off / max(ALL_OR_NOTHING_TOLERANCE, LIMIT_SIGMA * float(u[0] * scale[0])), FIT_ONLY_IN_PART))
    return excesses


def _split(candidates: Candidates, forms: list[Form]) -> list[Form]:
    """Split curves with a constant or a slope into constants of the machine and the remaining curves.

    By the datum, a curve has neither (`twin.identification.network`). If they are the smaller part of the curve, one cause is the
    simpler description; if they are the larger part, the error is the constant, and the curves that share it hide it.
    """
    remainder = {
        (form.key, form.variant.columns[-1]): form
        for form in candidates.forms
        if form.variant.fixed.get("first", 0.0) > 0.0
    }
    whole_curves = [form for form in forms if form.variant.fixed.get("first") == 0.0]
    remainders = [remainder[form.key, form.variant.columns[-1]] for form in whole_curves]
    trial = [form for form in forms if form.variant.fixed.get("first") != 0.0]
    explained = candidates.explained_by(forms)
    enough = explained - EQUAL_CHI2 * (explained - candidates.explained_by(trial))
    trial += remainders
    constants: list[Form] = []
    is_constant = [form.candidate.specification.constant for form in candidates.forms]
    while remainders and candidates.explained_by(trial) < enough:
        margin = np.where(is_constant, _free(candidates, trial), -np.inf)
        if margin.max() <= 0.0:
            return forms
        constants.append(candidates.forms[first_largest(margin)])
        trial.append(constants[-1])
    explained = candidates.explained_by(trial)
    for constant in constants:
        others = [form for form in trial if form is not constant]
        by_constant = explained - candidates.explained_by(others)
        by_hosts = []
        for curve, bent in zip(whole_curves, remainders, strict=True):
            hosted = candidates.explained_by([curve if form is bent else form for form in others])
            if hosted > explained - EQUAL_CHI2 * by_constant:
                by_hosts.append(explained - candidates.explained_by([form for form in trial if form is not bent]))
        # If several curves could contain the constant, none is preferred.
        if len(by_hosts) == 1 and by_constant < by_hosts[0]:
            return forms
    for bent in remainders:
        without = [form for form in trial if form is not bent]
        if candidates.penalised_gain(without) >= candidates.penalised_gain(trial):
            trial = without
    return trial


def forward_selection(
    candidates: Candidates, forms: Sequence[Form], allowed: np.ndarray | bool = True, most: int = MAX_CAUSES
) -> list[Form]:
    """Add forms, of those ``allowed`` (forms,), as long as each is significant."""
    forms = _exchanged(candidates, list(forms), allowed)
    while len(forms) < most:
        now = candidates.penalised_gain(forms)
        best = candidates.forms[first_largest(candidates.margins(forms))]
        if best.nonlinear and candidates.taken(forms)[best.index]:
            # Most of the residual is due to a period or time constant between two tabulated ones; the estimate refines these.
            return forms
        margin = np.where(allowed, _free(candidates, forms), -np.inf)
        for i in largest_first(margin)[:MAX_EXCHANGES_EVALUATED]:
            if margin[i] <= ADDITIONAL_CAUSE_PENALTY:
                return _exchanged(candidates, forms, allowed) if len(forms) > MAX_EXCHANGED_CAUSES else forms
            larger = [*forms, candidates.forms[int(i)]]
            if len(larger) <= MAX_EXCHANGED_CAUSES:
                larger = _exchanged(candidates, larger, allowed)
            if candidates.penalised_gain(larger) > now + 1e-6:
                break
        else:
            return forms
        forms = larger
    return _exchanged(candidates, forms, allowed) if len(forms) > MAX_EXCHANGED_CAUSES else forms


def _free(candidates: Candidates, forms: Sequence[Form]) -> np.ndarray:
    """Return the margins of the forms that may be added to some others."""
    return np.where(candidates.taken(forms), -np.inf, candidates.margins(forms))


def _exchanged(candidates: Candidates, forms: list[Form], allowed: np.ndarray | bool) -> list[Form]:
    """Return the set with each cause replaced by a better one, or dropped, until nothing changes."""
    worth = candidates.penalised_gain(forms)
    for _ in range(MAX_EXCHANGE_ROUNDS):
        better = _better(candidates, forms, worth, allowed)
        if better is None:
            break
        forms, worth = better
    return forms


def _better(
    candidates: Candidates, forms: list[Form], now: float, allowed: np.ndarray | bool
) -> tuple[list[Form], float] | None:
    """Return the first better set by removal or exchange, with its worth; None if there is none."""
    for k in range(len(forms))[-MAX_EXCHANGED_CAUSES:]:
        others = forms[:k] + forms[k + 1 :]
        if others and (worth := candidates.penalised_gain(others)) >= now:
            return others, worth
        margin = np.where(allowed, _free(candidates, others), -np.inf)
        for i in largest_first(margin)[:MAX_EXCHANGES_EVALUATED].tolist():
            new = candidates.forms[i]
            if not np.isfinite(margin[i]) or new is forms[k]:
                continue
            if (worth := candidates.penalised_gain([*others, new])) > now + 1e-6:
                return [*others, new], worth
    return None


def prices(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Return the log of the effective number of tests by effect: forms of its family over the family's share of false alarms."""
    tests: dict[str, float] = {}
    seldom = {candidate.effect for candidate in candidates if candidate.specification.rare}
    for candidate in candidates:
        tests[candidate.effect] = tests.get(candidate.effect, 0.0) + candidate.tests
    shares = {
        effect: count**FAMILY_POWER * (RARE_FACTOR if effect in seldom else 1.0) for effect, count in tests.items()
    }
    total = sum(shares.values())
    return {effect: float(np.log(total * count / shares[effect])) for effect, count in tests.items()}


def candidates_of(task: DiagnosisTask) -> Candidates:
    """Return every form of every candidate with its correction for multiple testing, evaluated on the data."""
    network, tested = task.problem.network, task.catalogue.candidates
    log_tests = prices(tested)
    forms = [
        (candidate, variant, log_tests[candidate.effect] + float(np.log(candidate.moments)))
        for candidate in tested
        for variant in candidate.variants
    ]
    folds = choose_folds(network.data, network.machine, ())
    return Candidates(task.problem, forms, task.noise.dof, None if folds is None else folds.fold)


LEAST_OUTLIERS: Final = 3  # number of outliers below which no cause is sought for them
MAX_OUTLIER_CAUSES: Final = 3  # largest number of causes sought to explain outliers
RETESTED_SHARES: Final = (1.0, 0.9, 0.5)
"""Shares of the outliers, smallest first, that are tested again: all, or without the largest (a lost beam, for example)."""
OUTLIER_SAMPLE: Final = 20_000  # number of rows used to test whether causes explain the outliers
SEED: Final = 1964


def exclude_outliers(placed: Readings) -> DiagnosisTask:
    """Return the problem without outliers: whitened rows and the causes to test."""
    few = np.count_nonzero(placed.bad) < LEAST_OUTLIERS
    return placed.without(placed.bad if few else _outliers_beside_causes(placed))


def _outliers_beside_causes(placed: Readings) -> np.ndarray:
    """Return (n,) which rows are outliers: the initial ones, unless causes explain more than half of them.

    A cause of such large residuals shows in other rows as well, so for very many rows a sample is used.
    """
    count, bad = len(placed.bad), np.flatnonzero(placed.bad)
    if count > OUTLIER_SAMPLE and len(bad) < OUTLIER_SAMPLE // 4:
        drawn = np.random.default_rng(SEED).choice(
            np.flatnonzero(~placed.bad), OUTLIER_SAMPLE - len(bad), replace=False
        )
        rows = np.sort(np.concatenate([bad, drawn]))
        outlying = np.zeros(count, dtype=bool)
        outlying[rows] = _outliers_beside_causes(placed.select_rows(rows))
        return outlying
    candidates = candidates_of(placed.without(np.zeros(len(placed.bad), dtype=bool)))
    size = np.linalg.norm(placed.network.residual(np.zeros(0), placed.setup), axis=1)
    for share in RETESTED_SHARES:
        bad = placed.bad & (size > np.quantile(size[placed.bad], share))
        for _ in range(PLACING_ITERATIONS):
            outlying = _outlying(placed, candidates, bad)
            settled = not np.any(outlying & ~bad) and np.count_nonzero(outlying) > 0.9 * np.count_nonzero(bad)
            if settled or np.count_nonzero(outlying) > 0.5 * np.count_nonzero(placed.bad):
                break
            bad = outlying
        if np.count_nonzero(outlying) <= 0.5 * np.count_nonzero(placed.bad):
            return outlying
    return placed.bad


def _outlying(placed: Readings, candidates: Candidates, bad: np.ndarray) -> np.ndarray:
    """Return (n,) which rows are outliers after removing the causes that the other rows show."""
    problem = candidates.problem
    part = problem.without(bad) if np.any(bad) else problem
    forms = largest_causes(candidates.on_part(part), MAX_OUTLIER_CAUSES)
    residual = problem.residual - estimate(part, forms).signature.sum(axis=1)
    return outliers(placed.network, part.refit_setup(residual).reshape(-1, 3))
