"""Joint selection of named causes and unnamed patterns.

Causes are selected first without patterns. If a pattern is then significant in the residuals, the selection is repeated starting from
the patterns: a cause enters if it increases the likelihood, with the patterns' variances re-estimated, by more than its correction for
multiple testing (`twin.diagnosis.likelihood`). A cause of imperfect form is thus kept, and a cause that only imitates part
of a pattern is not.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import largest_first
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.candidates.machine import variant_at
from twin.diagnosis.cross_validation import (
    blocks_of_time,
    held_out_squares,
    jackknife_interval,
    predicted_shift,
    predicts_held_out,
    without_overfitting,
)
from twin.diagnosis.estimate import RandomEffects, estimate, remaining_discrepancy
from twin.diagnosis.forms import DEVIANCE_RULED_OUT, Candidates, Form, columns_of
from twin.diagnosis.likelihood import PATTERN_ALARM_RATE, Likelihood, Model, PatternTest, scan_patterns
from twin.diagnosis.patterns import Pattern, patterns
from twin.diagnosis.payload import select_with_payload
from twin.diagnosis.problem import Problem
from twin.diagnosis.readings import DiagnosisTask
from twin.diagnosis.search import MAX_CAUSES, MAX_EXCHANGED_CAUSES, Selection, candidates_of, excess_ratio_of
from twin.identification.discrepancy import settled
from twin.measurement.observation import machine_state

MAX_PATTERNS: Final = 3
"""Largest number of patterns."""
# The most promising ones alone are refitted with the variances of the patterns, which takes nearly all of the time.
MAX_CAUSES_EVALUATED: Final = 5
"""Number of causes evaluated in full at every step."""
# Refitted variances can raise what a cause explains, but not from a small part of its price to the whole.
EVALUATED_PRICE_SHARE: Final = 0.3
"""Share of its price that a cause must explain at the present variances of the patterns to be evaluated in full."""
# The gain that is bounded is that of a drop without a refit: at twenty times the price the refit cannot reverse the decision.
KEPT_GAIN_RATIO: Final = 20.0
"""Ratio of a cause's bound on its gain to its price from which on it is kept without a refit."""
# Far below any price and above rounding: an exchange and its reverse must not alternate.
EXCHANGE_GAIN: Final = 0.1
"""Smallest gain in twice the log likelihood for an exchange of causes."""
# As in the verdict: causes that leave less than a tenth explain the readings.
KEPT_CHI2_SHARE: Final = 0.9
"""Share of the explained χ² from which on causes are kept, whatever the patterns explain in addition."""
# A cause that explains less than the patterns beside it is rather a part of their pattern.
LEAST_IMITATED_RATIO: Final = 1.0
"""Smallest ratio of the χ² explained by a cause to that explained in addition by patterns that can imitate it."""
# A pattern has a handful of variances; two causes are no more complex than that.
CAUSES_PER_PATTERN: Final = 3
"""Number of causes that one pattern must replace to be the simpler model."""


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """The selected causes and patterns.

    Attributes:
        forms: the causes.
        likelihood: of causes with the patterns; None without patterns.
        model: causes and patterns at the most likely variances; None without patterns.
        problem: the data with patterns and set-up projected out.
        rejected: causes selected at first that are not kept with the patterns.
        patterned: whether the selection started from the patterns, not from the causes.
        impossible: causes that would improve the fit with the patterns, but only with a size that is impossible.
    """

    forms: tuple[Form, ...]
    likelihood: Likelihood | None
    model: Model | None
    problem: Problem
    rejected: tuple[Form, ...]
    patterned: bool = False
    impossible: tuple[Form, ...] = ()

    @property
    def pattern_tests(self) -> tuple[PatternTest, ...]:
        """Return the patterns found."""
        return () if self.likelihood is None else self.likelihood.pattern_tests

    @property
    def random_effects(self) -> RandomEffects | None:
        """Return the patterns for a joint estimate with the causes; None without patterns."""
        if self.model is None or self.likelihood is None:
            return None
        return RandomEffects(self.likelihood.random(self.model), self.model.variance_factor)

    def explained(self, forms: Sequence[Form]) -> float:
        """Return the χ² that the patterns explain in addition to some of the causes."""
        return (
            0.0 if self.likelihood is None else self.likelihood.explained(forms, self.likelihood.fit(forms, self.model))
        )

    def pattern(self, forms: Sequence[Form]) -> np.ndarray:
        """Return the (3n,) effect of the patterns on the whitened readings, given some of the causes.

        It is scaled to the expected size of the patterns: the most likely value at each reading is smaller by its variance.
        """
        if self.likelihood is None:
            return np.zeros(len(self.problem.residual))
        model = self.likelihood.fit(forms, self.model)
        pattern = self.likelihood.pattern(forms, model)
        size = max(float(pattern @ pattern), 1e-300)
        return np.asarray(pattern * np.sqrt(1.0 + model.variance_factor * model.effective_dof / size))


@final
@dataclass(frozen=True, eq=False)
class Findings:
    """The result of the selection, with the problem it belongs to.

    Attributes:
        task: the problem without outliers, and the causes tested.
        patterns: the unnamed patterns tested.
        candidates: the causes, with the set-up projected out.
        given_patterns: the same with the patterns found projected out as well; ``candidates`` itself without patterns.
        structure: the selected causes and patterns.
        by_noise: the causes evaluated with the weights of the noise alone, as the first search left them.
        refuted: causes that fit the readings but do not predict held-out ones (`twin.diagnosis.cross_validation`).
    """

    task: DiagnosisTask
    patterns: Sequence[Pattern]
    candidates: Candidates
    given_patterns: Candidates
    structure: Structure
    by_noise: Candidates
    refuted: tuple[Form, ...] = ()

    @property
    def problem(self) -> Problem:
        """Return the problem without outliers, whitened by noise and discrepancy."""
        return self.task.problem

    def beside_patterns(self, forms: Sequence[Form]) -> list[Form]:
        """Return forms of ``candidates`` as they are among ``given_patterns``."""
        return [self.given_patterns.forms[form.index] for form in forms]


def joint_selection(candidates: Candidates, forms: Sequence[Form], tried: Sequence[Pattern]) -> Structure:
    """Return the given causes, or, if patterns explain more than a small part, the joint selection of causes and patterns.

    Args:
        candidates: the data and the forms.
        forms: the causes selected without patterns.
        tried: patterns to test.
    """
    model = with_patterns(candidates, forms, tried)
    left, patterned = bool(model.pattern_tests), False
    if left or len(forms) >= CAUSES_PER_PATTERN:
        carried = candidates.explained_by(model.forms)
        if (
            not model.forms
            or (model.model is not None and carried < KEPT_CHI2_SHARE * model.model.explained)
            or not left
        ):
            other = _patterned(candidates, tried)
            # Enough causes can imitate anything: one pattern instead of several causes is the simpler model.
            simpler = (
                len(other.forms) <= len(model.forms) - CAUSES_PER_PATTERN
                and _worth(candidates, other) > candidates.penalised_gain(forms) - DEVIANCE_RULED_OUT
            )
            # Causes that no pattern can imitate are not parts of one.
            better = _not_imitable(model) and _worth(candidates, model) > _worth(candidates, other)
            if other.pattern_tests and (left or simpler) and not better:
                model, patterned = other, True
    keys = {form.key for form in model.forms}
    rejected = tuple(form for form in forms if form.key not in keys)
    return replace(model, rejected=rejected, patterned=patterned)


def _not_imitable(found: Structure) -> bool:
    """Return whether there are causes and patterns, and no pattern can imitate any cause."""
    likelihood = found.likelihood
    return (
        likelihood is not None and bool(found.forms) and not any(likelihood.can_imitate(f).any() for f in found.forms)
    )


def refit_on_part(
    candidates: Candidates, forms: Sequence[Form], found: Structure
) -> tuple[tuple[Form, ...], Likelihood | None]:
    """Return the causes kept on a part of the data, with the patterns found on all of it, and their likelihood.

    Args:
        candidates: the part of the data.
        forms: the causes selected on it.
        found: the selection on all data.
    """
    if not found.pattern_tests:
        return tuple(forms), None
    likelihood = Likelihood(candidates, found.pattern_tests)
    if found.patterned:
        kept = [candidates.forms[form.index] for form in found.forms]
        return tuple(_dropped(likelihood, kept, likelihood.fit(kept))[0]), likelihood
    return tuple(without_parts(likelihood, forms, likelihood.fit(forms))), likelihood


def with_patterns(candidates: Candidates, forms: Sequence[Form], tried: Sequence[Pattern]) -> Structure:
    """Return the given causes, without those that explain only part of a pattern, and the patterns found in the residuals."""
    kept = list(forms)
    pattern_tests: list[PatternTest] = []
    problem, likelihood, model = candidates.problem, None, None
    while True:
        seen = {(pattern_test.pattern.side, pattern_test.pattern.names) for pattern_test in pattern_tests}
        more = [
            pattern_test
            for pattern_test in (
                scan_patterns(problem, tried, kept, candidates.dof) if len(pattern_tests) < MAX_PATTERNS else []
            )
            if pattern_test.found and (pattern_test.pattern.side, pattern_test.pattern.names) not in seen
        ]
        if not more:
            return Structure(tuple(kept), likelihood, model, problem, ())
        likelihood = Likelihood(candidates, [*pattern_tests, more[0]])
        model = likelihood.fit(kept)
        remaining = without_parts(likelihood, kept, model)
        if len(remaining) == len(kept):
            pattern_tests.append(more[0])
            problem = candidates.problem.with_random_effects(likelihood.random(model), model.variance_factor)
        else:
            # What these causes explained may belong to patterns or to other causes.
            kept, pattern_tests, problem, likelihood, model = remaining, [], candidates.problem, None, None


def _patterned(candidates: Candidates, tried: Sequence[Pattern]) -> Structure:
    """Return the selection starting from the most significant pattern; an empty one if none is significant."""
    tests = scan_patterns(candidates.problem, tried, (), candidates.dof)
    if not (tests and tests[0].found):
        return Structure((), None, None, candidates.problem, ())
    return _from_pattern(candidates, tests[0], tried)


def _worth(candidates: Candidates, found: Structure) -> float:
    """Return what a selection explains less the prices of its causes and patterns."""
    if found.model is None:
        return candidates.penalised_gain(found.forms)
    prices = sum(_price(pattern_test) for pattern_test in found.pattern_tests)
    return found.model.twice_log_ratio - prices - sum(_cost(candidates, form) for form in found.forms)


def _price(pattern_test: PatternTest) -> float:
    """Return the smallest gain in twice the log likelihood for a pattern to be significant."""
    return float(2.0 * (pattern_test.log_price - np.log(PATTERN_ALARM_RATE)))


def _cost(candidates: Candidates, form: Form) -> float:
    """Return the smallest gain in twice the log likelihood for a cause to be significant with patterns in the model."""
    return candidates.critical_value(form, float(len(form.columns)))


def _from_pattern(candidates: Candidates, first: PatternTest, tried: Sequence[Pattern]) -> Structure:
    """Return the selection starting from a pattern: causes are added, further patterns tested, unneeded patterns dropped."""
    pattern_tests = [first]
    forms: list[Form] = []
    seen = {(first.pattern.side, first.pattern.names)}
    barred: set[int] = set()
    while True:
        likelihood = Likelihood(candidates, pattern_tests)
        forms, model, impossible = _stepwise(likelihood, forms, barred)
        needed = [
            pattern_test
            for k, pattern_test in enumerate(pattern_tests)
            if model.twice_log_ratio - likelihood.fit(forms, model, without=k).twice_log_ratio > _price(pattern_test)
        ]
        if len(needed) < len(pattern_tests):
            pattern_tests = needed
            if not pattern_tests:
                return Structure(tuple(forms), None, None, candidates.problem, ())
            likelihood = Likelihood(candidates, pattern_tests)
            forms, model, impossible = _stepwise(likelihood, forms, barred)
        problem = candidates.problem.with_random_effects(likelihood.random(model), model.variance_factor)
        more = [
            pattern_test
            for pattern_test in (
                scan_patterns(problem, tried, forms, candidates.dof) if len(pattern_tests) < MAX_PATTERNS else []
            )
            if pattern_test.found and (pattern_test.pattern.side, pattern_test.pattern.names) not in seen
        ]
        if more:
            pattern_tests = [*pattern_tests, more[0]]
            seen.add((more[0].pattern.side, more[0].pattern.names))
            continue
        remaining = without_parts(likelihood, forms, model)
        if len(remaining) == len(forms):
            forms, model = _simplified(likelihood, forms, model)
            return Structure(tuple(forms), likelihood, model, problem, (), impossible=impossible)
        barred |= {int(candidates.key_of[form.index]) for form in forms if form not in remaining}
        forms = remaining


def _stepwise(
    likelihood: Likelihood, forms: Sequence[Form], barred: Collection[int]
) -> tuple[list[Form], Model, tuple[Form, ...]]:
    """Add causes while they are significant with the patterns in the model, and drop those that no longer are.

    Returns:
        The causes; the model; causes that are significant in addition, but only with an impossible size.
    """
    impossible: list[Form] = []
    candidates = likelihood.candidates
    kept, model = _dropped(likelihood, list(forms), likelihood.fit(forms))
    while len(kept) < MAX_CAUSES:
        best: tuple[float, Form, Model] | None = None
        impossible = []
        for form in _promising(likelihood, kept, model, barred):
            with_it = likelihood.fit([*kept, form], model)
            gained = with_it.twice_log_ratio - model.twice_log_ratio - _cost(candidates, form)
            if gained > (best[0] if best else 0.0):
                if not _possible(candidates, [*kept, form], with_it):
                    impossible.append(form)
                    continue
                best = gained, form, with_it
                if len(kept) >= MAX_EXCHANGED_CAUSES:
                    break  # a model with very many errors: the order does not matter
        if best is None:
            fewer, model = _dropped(likelihood, kept, model)
            other = _exchanged(likelihood, fewer, model, barred) if len(fewer) <= MAX_EXCHANGED_CAUSES else None
            if other is None and len(fewer) == len(kept):
                return kept, model, tuple(impossible)
            kept, model = (fewer, model) if other is None else other
            continue
        kept, model = [*kept, best[1]], best[2]
    return *_dropped(likelihood, kept, model), tuple(impossible)


def _exchanged(
    likelihood: Likelihood, kept: list[Form], model: Model, barred: Collection[int]
) -> tuple[list[Form], Model] | None:
    """Return the set with one cause replaced by a likelier one; None if there is none."""
    candidates = likelihood.candidates
    for form in kept:
        others = [one for one in kept if one is not form]
        less = likelihood.fit(others, model)
        for other in _promising(likelihood, others, less, barred):
            trial = [*others, other]
            found = likelihood.fit(trial, less)
            gained = found.twice_log_ratio - _cost(candidates, other) - model.twice_log_ratio + _cost(candidates, form)
            if other is not form and gained > EXCHANGE_GAIN and _possible(candidates, trial, found):
                return trial, found
    return None


def _simplified(likelihood: Likelihood, forms: list[Form], model: Model) -> tuple[list[Form], Model]:
    """Replace curves with a constant or slope, which the datum excludes, by a confounded constant of the machine."""
    candidates = likelihood.candidates
    for form in list(forms):
        if form.variant.fixed.get("first") != 0.0:
            continue
        others = [one for one in forms if one is not form]
        explained, dof = likelihood.scan(others, likelihood.fit(others, model))
        margin = explained - candidates.critical_values(dof)
        taken = {other.key for other in others}
        numbers = [
            f for f in candidates.forms if f.candidate.specification.constant and f.key not in taken and dof[f.index]
        ]
        for i in largest_first(np.array([margin[one.index] for one in numbers]))[:1]:
            number = numbers[i]
            trial = [*others, number]
            found = likelihood.fit(trial, model)
            lost = model.twice_log_ratio - _cost(candidates, form) - found.twice_log_ratio + _cost(candidates, number)
            if lost < DEVIANCE_RULED_OUT and _possible(candidates, trial, found):
                forms, model = trial, found
    return forms, model


def _promising(likelihood: Likelihood, kept: Sequence[Form], model: Model, barred: Collection[int]) -> list[Form]:
    """Return the best form of each of the most promising candidates."""
    candidates = likelihood.candidates
    explained, dof = likelihood.scan(kept, model)
    costs = candidates.critical_values(dof)
    out = np.isin(candidates.slot_of, [candidates.slot_of[form.index] for form in kept]) | np.isin(
        candidates.key_of, list(barred)
    )
    margin = np.where(out, -np.inf, explained - costs)
    promising: dict[int, Form] = {}
    for i in largest_first(margin).tolist():
        if (
            len(promising) == MAX_CAUSES_EVALUATED
            or not explained[i] > EVALUATED_PRICE_SHARE * costs[i]
            or not np.isfinite(margin[i])
        ):
            break
        promising.setdefault(int(candidates.key_of[i]), candidates.forms[i])
    return list(promising.values())


def _dropped(likelihood: Likelihood, forms: list[Form], model: Model) -> tuple[list[Form], Model]:
    """Drop the causes that are not significant, those with the smallest gain at the present variances first."""
    kept = list(forms)
    while True:
        prices = {form.index: _cost(likelihood.candidates, form) for form in kept}
        gained = {form.index: likelihood.gain_bound(kept, model, form) for form in kept}
        for form in [kept[i] for i in largest_first(np.array([prices[f.index] - gained[f.index] for f in kept]))]:
            if gained[form.index] > KEPT_GAIN_RATIO * prices[form.index]:
                continue
            others = [one for one in kept if one is not form]
            less = likelihood.fit(others, model)
            if model.twice_log_ratio - less.twice_log_ratio < prices[form.index]:
                kept, model = others, less
                break
        else:
            return kept, model


def without_parts(likelihood: Likelihood, forms: Sequence[Form], model: Model) -> list[Form]:
    """Return the causes without those that explain only part of a pattern."""
    kept = list(forms)
    while (part := _partial_cause(likelihood, kept, model)) is not None:
        kept = [form for form in kept if form is not part]
        model = likelihood.fit(kept, model)
    return kept


def _partial_cause(likelihood: Likelihood, forms: Sequence[Form], model: Model) -> Form | None:
    """Return the cause that explains the smallest part of a pattern that can imitate it, if the pattern explains more; else None."""
    explained_by_patterns = likelihood.explained_by_patterns(forms, model)
    explained = likelihood.candidates.explained_by(forms)
    worst: tuple[float, Form] | None = None
    for form in forms:
        imitated = float(likelihood.can_imitate(form) @ explained_by_patterns)
        if imitated <= 0.0:
            continue
        # A machine has all its constants: they are assessed together.
        constant = form.candidate.specification.constant
        alike = [one for one in forms if constant and one.candidate.specification.constant]
        others = [one for one in forms if one is not form and one not in alike]
        carried = explained - likelihood.candidates.explained_by(others)
        ratio = carried / max(imitated, 1e-9)
        if carried < LEAST_IMITATED_RATIO * imitated and (worst is None or ratio < worst[0]):
            worst = ratio, form
    return None if worst is None else worst[1]


def _possible(candidates: Candidates, forms: Sequence[Form], model: Model) -> bool:
    """Return whether no cause is larger than possible."""
    columns = columns_of(forms)
    return all(
        excess_ratio_of(form, model.values[at], np.zeros(len(at)), candidates.gram([form]), model.explained) <= 1.0
        for form in forms
        for at in [np.searchsorted(columns, form.columns)]
    )


# --- Search for the best set of causes together with unnamed patterns -----------------------------

MOST_RESELECTIONS: Final = 4
"""Largest number of searches with other weights."""
TIME: Final = "time_s"
NOT_PREDICTED: Final = "they do not predict held-out positions"
"""Reason for which variants are left out, in words."""
REFINED_CHI2: Final = 100.0
"""χ² of a cause above which its residual between two tabulated periods or time constants could look like another cause."""
MAX_REFINEMENTS: Final = 2
"""Largest number of refinements of periods and time constants."""
REFINED_SIGMA: Final = 0.2
"""Change of a period or time constant, in standard uncertainties, below which it is not refined again."""


def select_causes(task: DiagnosisTask) -> Findings:
    """Return the causes and the unnamed patterns that explain the residuals.

    If they leave more than the noise, the search is repeated with noise and discrepancy in the weights.

    Args:
        task: the problem without outliers, and the causes to test; with the weights of the noise.
    """
    selected = _select(task)
    for _ in range(MOST_RESELECTIONS):
        structure = selected.structure
        discrepancy = remaining_discrepancy(
            selected.task, structure.forms, estimate(selected.problem, structure.forms), structure.problem
        )
        if settled(task.problem.network, selected.task.discrepancy, discrepancy):
            break
        selected = replace(_select(task.with_discrepancy(discrepancy)), by_noise=selected.by_noise)
    return selected


def _select(task: DiagnosisTask) -> Findings:
    """Return the causes and the unnamed patterns, with the weights of the task.

    A variant that changes with time (a growth that lags behind its sensor) resembles many slow changes. It is searched for only where
    something changes with time, and named only if it predicts held-out blocks of time better than the plain effect does, or as well as
    several causes with more parameters.
    """
    plain = without_variants_in_time(task)
    selected = Searcher(plain).run()
    if plain is task or not _changes_with_time(selected):
        return selected
    other = Searcher(task).run()
    return other if _is_better_in_time(other, selected) else selected


def without_variants_in_time(task: DiagnosisTask) -> DiagnosisTask:
    """Return the task with plain effects only, for the first search; the task itself if it has no variants that change with time."""
    plain = tuple(candidate for candidate in task.catalogue.candidates if not _is_variant_in_time(candidate))
    if len(plain) == len(task.catalogue.candidates):
        return task
    return replace(task, catalogue=replace(task.catalogue, candidates=plain))


def _is_variant_in_time(candidate: Candidate) -> bool:
    return bool(candidate.specification.variant_of) and candidate.specification.varies == "with time"


def _changes_with_time(found: Findings) -> bool:
    columns = {name for pattern_test in found.structure.pattern_tests for name in pattern_test.pattern.names}
    return any(form.candidate.specification.varies == "with time" for form in found.structure.forms) or any(
        name == TIME or name.startswith("T_") for name in columns
    )


def _is_better_in_time(other: Findings, plain: Findings) -> bool:
    """Return whether causes with a variant in time are preferred to those without.

    They are if they predict held-out blocks of time no worse with fewer parameters, or, of equally many, with fewer causes; or if they
    are the same causes, some as variants, and predict better with 95 % confidence. Blocks inside one warm-up are interpolation: any
    further drift would predict them, so a better prediction by other causes with more parameters does not count.
    """
    split = blocks_of_time(plain.problem.network.data)
    if split is None or not any(_is_variant_in_time(form.candidate) for form in other.structure.forms):
        return False
    tables = []
    for found in (plain, other):

        def predict(part: Candidates, found: Findings = found) -> list[np.ndarray]:
            return [predicted_shift(found.problem, part, found.structure.forms)]

        table = held_out_squares(found.candidates, split, predict)
        if table is None:
            return False
        tables.append(table)
    interval = jackknife_interval(np.column_stack([tables[0][:, 0], tables[1]]))
    if interval is None or interval[1] < 0.0:
        return False
    if _complexity(other) < _complexity(plain):
        return True
    keys = {
        (one.candidate.specification.variant_of or one.candidate.effect, one.key[1]) for one in other.structure.forms
    }
    return interval[0] > 0.0 and keys == {form.key for form in plain.structure.forms}


def _complexity(found: Findings) -> tuple[int, int]:
    """Return the number of parameters of the causes, non-linear ones counted, and the number of causes."""
    forms = found.structure.forms
    return sum(len(form.columns) + len(form.nonlinear) for form in forms), len(forms)


@final
class Searcher:
    """Search in the catalogue of causes and in the unnamed patterns, on one data set.

    Args:
        task: the problem without outliers, and the causes to test.
    """

    def __init__(self, task: DiagnosisTask) -> None:
        self.task = task
        self.problem = task.problem
        self.candidates = candidates_of(task)
        self.patterns = patterns(self.problem.network.machine, self.problem.network.data)

    def run(self) -> Findings:
        """Return the best set of causes together with unnamed patterns."""
        structure, refuted = self._settled()
        # A variant that does not predict held-out positions is replaced by the plain effect and unexplained residuals.
        while varying := [
            form
            for form in structure.forms
            if form.candidate.specification.variant_of and not predicts_held_out(self.candidates, form, structure.forms)
        ]:
            self.candidates.exclude({form.key for form in varying}, NOT_PREDICTED)
            structure, refuted = self._settled()
        given_patterns = self.candidates.for_problem(structure.problem) if structure.pattern_tests else self.candidates
        return Findings(self.task, self.patterns, self.candidates, given_patterns, structure, self.candidates, refuted)

    def _settled(self) -> tuple[Structure, tuple[Form, ...]]:
        """Return the selected causes and patterns, and the causes that held-out readings refute.

        If there are too few readings for the causes, there are also too few to decide which causes a pattern could replace.
        """
        chosen = self._best().forms
        kept = without_overfitting(self.candidates, chosen)
        if len(kept) == len(chosen):
            model = joint_selection(self.candidates, chosen, self.patterns)
            chosen, kept = model.forms, without_overfitting(self.candidates, model.forms)
            if len(kept) == len(chosen):
                return model, ()
        return with_patterns(self.candidates, kept, self.patterns), tuple(form for form in chosen if form not in kept)

    def _best(self) -> Selection:
        """Return the best set of causes without patterns.

        Between two tabulated periods or time constants, the residual of a large cause can exceed another cause. Periods and time
        constants of large causes are therefore refined, and the search is repeated.
        """
        best = select_with_payload(self.candidates)
        for _ in range(MAX_REFINEMENTS):
            if not self._refined(best):
                break
            best = select_with_payload(self.candidates, best.forms)
        return best

    def _refined(self, best: Selection) -> bool:
        """Refine the periods and time constants of large causes; return whether any moved."""
        machine, data = self.problem.network.machine, self.problem.network.data
        bent = [form for form in best.forms if form.nonlinear]
        large = [
            form
            for form in bent
            if self.candidates.scores([one for one in best.forms if one is not form], [form.index])[0, 0] > REFINED_CHI2
        ]
        if not large:
            return False
        state = machine_state(data, machine)
        found = estimate(self.problem, best.forms)
        moved = False
        for form, quantities in zip(best.forms, found.quantities, strict=True):
            # A straight drift reports a time constant, but its columns have none.
            put = {q.name: q for q in quantities if form in large and q.name in form.nonlinear}
            if not any(abs(form.variant.fixed[q.name] - q.value) > REFINED_SIGMA * q.u for q in put.values()):
                continue
            moved = True
            fixed = {name: q.value for name, q in put.items()}
            self.candidates.refine(form, variant_at(form.candidate, fixed, machine, state))
        return moved
