"""Joint selection of named causes and unnamed patterns.

Causes are selected first without patterns. If a pattern is then significant in the residuals, the selection is repeated starting from
the patterns: a cause enters if it increases the likelihood, with the patterns' variances re-estimated, by more than its correction for
multiple testing (`twin.diagnosis.likelihood`). A cause of imperfect form is thus kept, and a cause that only imitates part
of a pattern is not.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import first_largest, largest_first
from twin._common.messages import Message
from twin.diagnosis.candidates.machine import variant_at
from twin.diagnosis.cross_validation import (
    blocks_of_time,
    held_out_squares,
    jackknife_interval,
    lines_that_predict,
    predicted_shift,
    predicts_held_out,
    without_overfitting,
)
from twin.diagnosis.estimate import RandomEffects, estimate, refine_far_periods, remaining_discrepancy
from twin.diagnosis.forms import DEVIANCE_RULED_OUT, Candidates, Form, columns_of
from twin.diagnosis.likelihood import PATTERN_ALARM_RATE, Likelihood, Model, PatternTest, scan_patterns
from twin.diagnosis.patterns import Pattern, patterns
from twin.diagnosis.payload import select_with_payload
from twin.diagnosis.problem import Problem
from twin.diagnosis.readings import DiagnosisTask
from twin.diagnosis.search import MAX_CAUSES, MAX_EXCHANGED_CAUSES, Selection, candidates_of, excesses_of
from twin.diagnosis.second_opinion import SingleEffect, second_opinion
from twin.identification.discrepancy import settled
from twin.measurement.observation import machine_state

MAX_PATTERNS: Final = 3  # largest number of patterns
MAX_PATTERNS_EVALUATED: Final = 8  # patterns of the smallest p-values whose likelihood is evaluated
MAX_CAUSES_EVALUATED: Final = 5
"""Number of causes refitted with the variances of the patterns at every step, which takes nearly all of the time."""
# Refitted variances can raise what a cause explains, but not from a small part of its price to the whole.
EVALUATED_PRICE_SHARE: Final = 0.3
"""Share of its price that a cause must explain at the present variances of the patterns to be evaluated in full."""
# The gain that is bounded is that of a drop without a refit: at twenty times the price the refit cannot reverse the decision.
KEPT_GAIN_RATIO: Final = 20.0  # bound on a cause's gain over its price from which on it is kept without a refit
EXCHANGE_GAIN: Final = 0.1
"""Smallest gain in twice the log likelihood for an exchange of causes, far below any price: it and its reverse must not alternate."""
# As in the verdict: causes that leave less than a tenth explain the readings.
KEPT_CHI2_SHARE: Final = 0.9  # share of the explained χ² from which on causes are kept, whatever patterns add
# A cause that explains less than the patterns beside it is rather a part of their pattern.
LEAST_IMITATED_RATIO: Final = 1.0
"""Smallest ratio of the χ² explained by a cause to that explained in addition by patterns that can imitate it."""
# A pattern has a handful of variances; two causes are no more complex than that.
CAUSES_PER_PATTERN: Final = 3  # number of causes that one pattern must replace to be the simpler model
# A function of X and Y has parts that are functions of X alone and of Y alone: each imitates an error motion of its axis.
PARTS_PER_PATTERN: Final = 2  # the same for causes that the pattern itself can imitate, every one of them


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """The selected causes and patterns."""

    forms: tuple[Form, ...]  # the causes
    problem: Problem  # with patterns and set-up projected out
    likelihood: Likelihood | None = None  # of causes with the patterns; None without patterns
    model: Model | None = None  # at the most likely variances; None without patterns
    rejected: tuple[Form, ...] = ()  # causes selected at first that are not kept with the patterns
    patterned: bool = False  # the selection started from the patterns, not from the causes
    # causes that would improve the fit with the patterns, but only with a size that is impossible
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
        if self.likelihood is None:
            return 0.0
        return self.likelihood.explained(forms, self.likelihood.fit(forms, self.model))

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
    """The result of the selection, with the problem it belongs to."""

    task: DiagnosisTask
    patterns: Sequence[Pattern]  # those tested
    candidates: Candidates  # with the set-up projected out
    structure: Structure  # the selected causes and patterns
    by_noise: Candidates  # evaluated with the weights of the noise alone, as the first search left them
    refuted: tuple[Form, ...] = ()  # causes that fit the readings but do not predict held-out ones

    @property
    def problem(self) -> Problem:
        """Return the problem without outliers, whitened by noise and discrepancy."""
        return self.task.problem

    @cached_property
    def given_patterns(self) -> Candidates:
        """The candidates with the patterns found projected out as well."""
        return self.candidates.for_problem(self.structure.problem) if self.structure.pattern_tests else self.candidates

    @cached_property
    def second_opinion(self) -> tuple[SingleEffect, ...]:
        """The effects that the second method finds; none beside patterns, where the selection is by likelihood."""
        return () if self.structure.pattern_tests else second_opinion(self.candidates, self.structure.forms)

    def beside_patterns(self, forms: Sequence[Form]) -> list[Form]:
        """Return forms of ``candidates`` as they are among ``given_patterns``."""
        return [self.given_patterns.forms[form.index] for form in forms]

    def with_alternatives(self, further: Candidates | None) -> Findings:
        """Return what was found among more candidates, which were not to be named."""
        if further is None:
            return self
        candidates, structure = self.candidates.followed_by(further), self.structure

        def same(forms: Sequence[Form]) -> tuple[Form, ...]:
            return tuple(candidates.forms[form.index] for form in forms)

        structure = replace(
            structure,
            forms=same(structure.forms),
            rejected=same(structure.rejected),
            impossible=same(structure.impossible),
        )
        return replace(
            self, candidates=candidates, structure=structure, by_noise=candidates, refuted=same(self.refuted)
        )


def joint_selection(candidates: Candidates, forms: Sequence[Form], tried: Sequence[Pattern]) -> Structure:
    """Return the causes selected without patterns, or, if patterns explain more than a small part, a joint selection of both."""
    structure = with_patterns(candidates, forms, tried)
    patterned = False
    if structure.pattern_tests or len(forms) >= PARTS_PER_PATTERN:
        carried = candidates.explained_by(structure.forms)
        small = structure.model is None or (
            bool(structure.forms) and carried >= KEPT_CHI2_SHARE * structure.model.explained
        )
        other, count = _one_pattern(candidates, tried), len(structure.forms)
        if structure.pattern_tests:
            wanted = not small or PARTS_PER_PATTERN <= count <= MAX_EXCHANGED_CAUSES
        else:
            wanted = count >= CAUSES_PER_PATTERN
        if wanted and other.pattern_tests:
            further = _with_further(candidates, tried, other.pattern_tests[0])
            other = other if _worth(candidates, other) > _worth(candidates, further) else further
        simpler = (
            _replaces(other, structure.forms)
            and _worth(candidates, other) > _worth(candidates, structure) - DEVIANCE_RULED_OUT
        )
        # With the patterns that are there anyway, some causes are not needed.
        fewer = {form.key for form in other.forms} < {form.key for form in structure.forms} and (
            _worth(candidates, other) > _worth(candidates, structure)
        )
        # Causes that no pattern can imitate are not parts of one.
        likelihood = structure.likelihood
        better = (
            likelihood is not None
            and bool(structure.forms)
            and not any(likelihood.can_imitate(form).any() for form in structure.forms)
            and _worth(candidates, structure) > _worth(candidates, other)
        )
        if other.pattern_tests and (simpler or fewer or not small) and not better:
            structure, patterned = other, True
    if patterned:
        structure = _with_lines(candidates, structure, forms)
    keys = {form.key for form in structure.forms}
    rejected = tuple(form for form in forms if form.key not in keys)
    return replace(structure, rejected=rejected, patterned=patterned)


def _with_lines(candidates: Candidates, structure: Structure, forms: Sequence[Form]) -> Structure:
    """Return a selection with patterns and those scales, of the causes selected without patterns, that they took up."""
    likelihood = structure.likelihood
    lines = lines_that_predict(candidates, structure.forms, forms)
    if likelihood is None or not lines:
        return structure
    kept = (*structure.forms, *lines)
    model = likelihood.fit(kept, structure.model)
    return replace(structure, forms=kept, problem=likelihood.problem_given(model), model=model)


def _replaces(other: Structure, forms: Sequence[Form]) -> bool:
    """Return whether patterns take the place of enough causes to be the simpler model: enough causes can imitate anything."""
    if len(other.forms) <= len(forms) - CAUSES_PER_PATTERN:
        return True
    likelihood, kept = other.likelihood, {form.key for form in other.forms}
    lost = [form for form in forms if form.key not in kept]
    return (
        likelihood is not None
        and len(other.pattern_tests) == 1
        # Two curves of one axis are less than any function of that axis.
        and (len(other.pattern_tests[0].pattern.names) > 1 or any(form.candidate.space is None for form in lost))
        # A function of an axis and its approach direction is a reversal with an error of position: two errors of any axis.
        and not any(channel.direction for channel in other.pattern_tests[0].pattern.channels)
        and len(other.forms) <= len(forms) - PARTS_PER_PATTERN
        and all(likelihood.can_imitate(form)[0] for form in lost)
    )


def with_patterns(candidates: Candidates, forms: Sequence[Form], tried: Sequence[Pattern]) -> Structure:
    """Return the given causes, without those that explain only part of a pattern, and the patterns found in the residuals."""
    structure, pattern_tests = Structure(tuple(forms), candidates.problem), list[PatternTest]()
    while len(pattern_tests) < MAX_PATTERNS:
        seen = {test.pattern.key for test in pattern_tests}
        further = _further_pattern(candidates, structure, tried, pattern_tests, seen)
        if further is None:
            return structure
        likelihood = Likelihood(candidates, [*pattern_tests, further])
        model = likelihood.fit(structure.forms)
        kept = tuple(without_parts(likelihood, structure.forms, model))
        if len(kept) == len(structure.forms):
            pattern_tests.append(further)
            structure = Structure(kept, likelihood.problem_given(model), likelihood, model)
        else:
            # What these causes explained may belong to patterns or to other causes.
            structure, pattern_tests = Structure(kept, candidates.problem), []
    return structure


def _further_pattern(
    candidates: Candidates,
    structure: Structure,
    tried: Sequence[Pattern],
    present: Sequence[PatternTest] = (),
    seen: Collection[Hashable] = (),
) -> PatternTest | None:
    """Return the most likely of the significant patterns of the residuals, of columns not seen yet; None if there is none.

    The test finds patterns fast, at one plausible variance; which columns they depend on is decided by the likelihood at the most
    likely variances, for fewer columns where more are not clearly likelier.
    """
    tests = [
        test
        for test in scan_patterns(structure.problem, tried, structure.forms, candidates.dof)
        if test.found and test.pattern.key not in seen
    ]
    near = [test for test in tests if test.log_p < tests[0].log_p + DEVIANCE_RULED_OUT][:MAX_PATTERNS_EVALUATED]
    # Functions of both columns may be clearer than the few of one: each column of a pair is tried alone.
    of_pairs = {
        (test.pattern.side, name) for test in near for name in test.pattern.names if len(test.pattern.names) > 1
    }
    near += [
        t
        for t in tests
        if t not in near and len(t.pattern.names) == 1 and (t.pattern.side, *t.pattern.names) in of_pairs
    ]
    if not near:
        return None
    ratios, best = zip(*(_at_likeliest_level(candidates, structure.forms, present, test) for test in near), strict=True)
    likely = [i for i in range(len(near)) if ratios[i] > max(ratios) - DEVIANCE_RULED_OUT]
    chosen = min(likely, key=lambda i: (len(near[i].pattern.names), -ratios[i]))
    own = near[chosen].pattern
    rivals = [near[i].pattern for i in likely if len(near[i].pattern.names) == len(own.names)]
    names = dict.fromkeys(rival.names for rival in rivals if rival.names != own.names and rival.side == own.side)
    return replace(best[chosen], rivals=tuple(names))


def _at_likeliest_level(
    candidates: Candidates, forms: Sequence[Form], present: Sequence[PatternTest], test: PatternTest
) -> tuple[float, PatternTest]:
    """Return twice the log likelihood ratio of a pattern beside others at its likeliest level, and the pattern at this level.

    What functions of too low an order leave of a column would be attributed to others.
    """
    levels = test.pattern.levels if len(test.pattern.names) == 1 else (test.level,)
    tried = [replace(test, level=level) for level in levels if level >= test.level]
    ratios = [Likelihood(candidates, [*present, one]).fit(forms).twice_log_ratio for one in tried]
    best = first_largest(np.array(ratios))
    return ratios[best], tried[best]


def _worth(candidates: Candidates, structure: Structure) -> float:
    """Return what a selection explains less the prices of its causes and patterns."""
    if structure.model is None:
        return candidates.penalised_gain(structure.forms)
    prices = sum(_price(test) for test in structure.pattern_tests)
    return structure.model.twice_log_ratio - prices - sum(_cost(candidates, form) for form in structure.forms)


def _price(pattern_test: PatternTest) -> float:
    """Return the smallest gain in twice the log likelihood for a pattern to be significant."""
    return float(2.0 * (pattern_test.log_price - np.log(PATTERN_ALARM_RATE)))


def _cost(candidates: Candidates, form: Form) -> float:
    """Return the smallest gain in twice the log likelihood for a cause to be significant with patterns in the model."""
    return candidates.critical_value(form, float(len(form.columns)))


def _one_pattern(candidates: Candidates, tried: Sequence[Pattern]) -> Structure:
    """Return the most significant pattern, without causes; an empty selection if none is significant."""
    none = Structure((), candidates.problem)
    first = _further_pattern(candidates, none, tried)
    if first is None:
        return none
    likelihood = Likelihood(candidates, [first])
    model = likelihood.fit(())
    return Structure((), likelihood.problem_given(model), likelihood, model)


def _with_further(candidates: Candidates, tried: Sequence[Pattern], first: PatternTest) -> Structure:
    """Add causes to the first pattern, test further patterns, drop unneeded ones."""
    pattern_tests, seen = [first], {first.pattern.key}
    forms: list[Form] = []
    barred: set[int] = set()
    while True:
        likelihood = Likelihood(candidates, pattern_tests)
        forms, model, impossible = _stepwise(likelihood, forms, barred)
        needed = [
            test
            for k, test in enumerate(pattern_tests)
            if model.twice_log_ratio - likelihood.fit(forms, model, without=k).twice_log_ratio > _price(test)
        ]
        if len(needed) < len(pattern_tests):
            pattern_tests = needed
            if not pattern_tests:
                return Structure(tuple(forms), candidates.problem)
            likelihood = Likelihood(candidates, pattern_tests)
            forms, model, impossible = _stepwise(likelihood, forms, barred)
        problem = likelihood.problem_given(model)
        if len(pattern_tests) < MAX_PATTERNS:
            further = _further_pattern(candidates, Structure(tuple(forms), problem), tried, pattern_tests, seen)
            if further is not None:
                pattern_tests = [*pattern_tests, further]
                seen.add(further.pattern.key)
                continue
        kept = without_parts(likelihood, forms, model)
        if len(kept) == len(forms):
            forms, model = _simplified(likelihood, forms, model)
            return Structure(tuple(forms), problem, likelihood, model, impossible=impossible)
        barred |= {int(candidates.key_of[form.index]) for form in forms if form not in kept}
        forms = kept


def _stepwise(
    likelihood: Likelihood, forms: Sequence[Form], barred: Collection[int]
) -> tuple[list[Form], Model, tuple[Form, ...]]:
    """Add causes while they are significant with the patterns in the model, and drop those that no longer are.

    Returns the causes; the model; causes that are significant in addition, but only with an impossible size.
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
            exchanged = _exchanged(likelihood, fewer, model, barred) if len(fewer) <= MAX_EXCHANGED_CAUSES else None
            if exchanged is None and len(fewer) == len(kept):
                return kept, model, tuple(impossible)
            kept, model = (fewer, model) if exchanged is None else exchanged
            continue
        kept, model = [*kept, best[1]], best[2]
    return *_dropped(likelihood, kept, model), tuple(impossible)


def _exchanged(
    likelihood: Likelihood, kept: list[Form], model: Model, barred: Collection[int]
) -> tuple[list[Form], Model] | None:
    """Return the set with one cause replaced by a likelier one; None if there is none."""
    candidates = likelihood.candidates
    for form in kept:
        others = [other for other in kept if other is not form]
        less = likelihood.fit(others, model)
        for new in _promising(likelihood, others, less, barred):
            trial = [*others, new]
            with_new = likelihood.fit(trial, less)
            gained = with_new.twice_log_ratio - _cost(candidates, new) - model.twice_log_ratio + _cost(candidates, form)
            if new is not form and gained > EXCHANGE_GAIN and _possible(candidates, trial, with_new):
                return trial, with_new
    return None


def _simplified(likelihood: Likelihood, forms: list[Form], model: Model) -> tuple[list[Form], Model]:
    """Replace curves with a constant or slope, which the datum excludes, by a confounded constant of the machine."""
    candidates = likelihood.candidates
    for form in list(forms):
        if form.variant.fixed.get("first") != 0.0:
            continue
        others = [other for other in forms if other is not form]
        explained, dof = likelihood.scan(others, likelihood.fit(others, model))
        margin = explained - candidates.critical_values(dof)
        taken = {other.key for other in others}
        constants = [
            f for f in candidates.forms if f.candidate.specification.constant and f.key not in taken and dof[f.index]
        ]
        if constants:
            constant = constants[first_largest(np.array([margin[f.index] for f in constants]))]
            trial = [*others, constant]
            with_it = likelihood.fit(trial, model)
            gained = with_it.twice_log_ratio - _cost(candidates, constant)
            lost = model.twice_log_ratio - _cost(candidates, form) - gained
            if lost < DEVIANCE_RULED_OUT and _possible(candidates, trial, with_it):
                forms, model = trial, with_it
    return forms, model


def _promising(likelihood: Likelihood, kept: Sequence[Form], model: Model, barred: Collection[int]) -> list[Form]:
    """Return the best form of each of the most promising candidates."""
    candidates = likelihood.candidates
    explained, dof = likelihood.scan(kept, model)
    costs = candidates.critical_values(dof)
    out = candidates.taken(kept) | np.isin(candidates.key_of, list(barred))
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
            others = [other for other in kept if other is not form]
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
        # A machine has all its constants: they are assessed together, as are the orders of one component's harmonics.
        constant = form.candidate.specification.constant
        others = [f for f in forms if f.key != form.key and not (constant and f.candidate.specification.constant)]
        carried = explained - likelihood.candidates.explained_by(others)
        ratio = carried / max(imitated, 1e-9)
        if carried < LEAST_IMITATED_RATIO * imitated and (worst is None or ratio < worst[0]):
            worst = ratio, form
    return None if worst is None else worst[1]


def _possible(candidates: Candidates, forms: Sequence[Form], model: Model) -> bool:
    """Return whether no cause is larger than possible."""
    columns = columns_of(forms)
    return all(
        ratio <= 1.0
        for form in forms
        for at in [np.searchsorted(columns, form.columns)]
        for ratio, _ in excesses_of(form, model.values[at], np.zeros(len(at)), candidates.gram([form]), model.explained)
    )


MOST_RESELECTIONS: Final = 4  # largest number of searches with other weights
NOT_PREDICTED: Final = Message(
    "they do not predict held-out positions"
)  # reason for which variants are left out, in words
REFINED_CHI2: Final = 100.0
"""χ² of a cause above which its residual between two tabulated periods or time constants could look like another cause."""
MAX_REFINEMENTS: Final = 2  # largest number of refinements of periods and time constants
REFINED_SIGMA: Final = 0.2  # change of a period or time constant, in standard uncertainties, that is not refined again


def select_causes(task: DiagnosisTask) -> Findings:
    """Return the causes and the unnamed patterns that explain the residuals.

    If they leave more than the noise, the search is repeated with noise and discrepancy in the weights.
    """
    selected, further = _select(task)
    by_noise = selected.with_alternatives(further).by_noise
    for _ in range(MOST_RESELECTIONS):
        structure = selected.structure
        discrepancy = remaining_discrepancy(
            selected.task, structure.forms, estimate(selected.problem, structure.forms), structure.problem
        )
        if settled(task.problem.network, selected.task.discrepancy, discrepancy):
            break
        selected, further = _select(task.with_discrepancy(discrepancy))
    return replace(selected.with_alternatives(further), by_noise=by_noise)


def _select(task: DiagnosisTask) -> tuple[Findings, Candidates | None]:
    """Return the causes and the unnamed patterns, with the weights of the task, and further candidates for alternatives.

    A variant that changes with time (a growth that lags behind its sensor) resembles many slow changes. It is searched for only where
    something changes with time, and named only if it predicts held-out blocks of time better than the plain effect does, or as well as
    several causes with more parameters. If it is not named, it may still be an alternative to the causes that are.
    """
    network, without_time = task.problem.network, without_variants_in_time(task)
    tried = patterns(network.machine, network.data)
    plain = search(without_time, candidates_of(without_time), tried)
    if without_time is task or not _changes_with_time(plain.structure):
        return plain, None
    lagging = search(task, candidates_of(task), tried)
    return (lagging, None) if _is_better_in_time(lagging, plain) else (plain, lagging.candidates)


def without_variants_in_time(task: DiagnosisTask) -> DiagnosisTask:
    """Return the task with plain effects only, for the first search; the task itself if it has no variants that change with time."""
    plain = tuple(candidate for candidate in task.catalogue.candidates if not candidate.varies_in_time)
    if len(plain) == len(task.catalogue.candidates):
        return task
    return replace(task, catalogue=replace(task.catalogue, candidates=plain))


def _changes_with_time(structure: Structure) -> bool:
    return any(form.candidate.specification.varies == "with time" for form in structure.forms) or any(
        name == "time_s" or name.startswith("T_") for test in structure.pattern_tests for name in test.pattern.names
    )


def _is_better_in_time(lagging: Findings, plain: Findings) -> bool:
    """Return whether causes with a variant in time are preferred to those without.

    They are if they predict held-out blocks of time no worse with fewer parameters or, of equally many, with fewer causes; with no more
    causes, if they need no pattern beside them; or if they are the same causes, some as variants, and predict better with 95 %
    confidence. Blocks inside one warm-up are interpolation: any further drift would predict them, so a better prediction by other
    causes with more parameters does not count.
    """
    folds, forms = blocks_of_time(plain.problem.network.data), lagging.structure.forms
    if folds is None or not any(form.candidate.varies_in_time for form in forms):
        return False
    squares = []
    for findings in (plain, lagging):

        def predict(part: Candidates, findings: Findings = findings) -> list[np.ndarray]:
            return [predicted_shift(findings.problem, part, findings.structure.forms)]

        table = held_out_squares(findings.candidates, folds, predict)
        if table is None:
            return False
        squares.append(table)
    interval = jackknife_interval(np.column_stack([squares[0][:, 0], squares[1]]))
    if interval is None or interval[1] < 0.0:
        return False
    # A sum of more causes would take the place of any pattern.
    worth, worth_of_plain = (_complexity(structure) for structure in (lagging.structure, plain.structure))
    if worth < worth_of_plain:
        return True
    if (
        plain.structure.pattern_tests
        and not lagging.structure.pattern_tests
        and len(forms) <= max(worth_of_plain[1], 1)
    ):
        return True
    # With its variant beside it, a cause is one more: sorted lists, not sets.
    keys = sorted(
        (form.candidate.specification.variant_of or form.candidate.effect, form.candidate.where) for form in forms
    )
    return interval[0] > 0.0 and keys == sorted(form.key for form in plain.structure.forms)


def _complexity(structure: Structure) -> tuple[int, int]:
    """Return the number of parameters of causes, non-linear ones counted, and the number of causes."""
    return sum(len(form.columns) + len(form.nonlinear) for form in structure.forms), len(structure.forms)


def search(task: DiagnosisTask, candidates: Candidates, tried: Sequence[Pattern]) -> Findings:
    """Return the best set of the causes of a task together with unnamed patterns."""
    structure, refuted = _predicting(candidates, tried)
    # A variant that does not predict held-out positions is replaced by the plain effect and unexplained residuals.
    while varying := [
        form
        for form in structure.forms
        if form.candidate.specification.variant_of and not predicts_held_out(candidates, form, structure.forms)
    ]:
        candidates.exclude({form.key for form in varying}, NOT_PREDICTED)
        structure, refuted = _predicting(candidates, tried)
    if candidates.has_imitating_waves(structure.forms):
        candidates.exclude_forms([form for form in candidates.forms if candidates.is_short_wave(form)])
        structure, refuted = _predicting(candidates, tried)
    return Findings(task, tried, candidates, structure, candidates, refuted)


def _predicting(candidates: Candidates, tried: Sequence[Pattern]) -> tuple[Structure, tuple[Form, ...]]:
    """Return the selected causes and patterns, and the causes that held-out readings refute.

    If there are too few readings for the causes, there are also too few to decide which causes a pattern could replace.
    """
    forms = _best(candidates).forms
    kept = without_overfitting(candidates, forms)
    if len(kept) == len(forms):
        structure = joint_selection(candidates, forms, tried)
        forms, kept = structure.forms, without_overfitting(candidates, structure.forms)
        if len(kept) == len(forms):
            return structure, ()
    return with_patterns(candidates, kept, tried), tuple(form for form in forms if form not in kept)


def _best(candidates: Candidates) -> Selection:
    """Return the best set of causes without patterns.

    Between two tabulated periods or time constants, the residual of a large cause can exceed another cause. Periods and time
    constants of large causes are therefore refined, and the search is repeated; then an axis may have further periods.
    """
    candidates.further_periods = False
    best = _with_refined(candidates, select_with_payload(candidates))
    if any(form.candidate.specification.period for form in best.forms):
        candidates.further_periods = True
        best = _with_refined(candidates, select_with_payload(candidates, best.forms))
    return best


def _with_refined(candidates: Candidates, best: Selection) -> Selection:
    """Return the best set of causes with the periods and time constants of large causes refined."""
    if refine_far_periods(candidates, best.forms):
        best = select_with_payload(candidates, best.forms)
    for _ in range(MAX_REFINEMENTS):
        if not _refined(candidates, best.forms):
            break
        best = select_with_payload(candidates, best.forms)
    return best


def _refined(candidates: Candidates, forms: Sequence[Form]) -> bool:
    """Refine the periods and time constants of large causes; return whether any moved."""
    network = candidates.problem.network
    large: list[Form] = []
    for form in forms:
        others = [other for other in forms if other is not form]
        if form.nonlinear and candidates.scores(others, [form.index])[0, 0] > REFINED_CHI2:
            large.append(form)
    if not large:
        return False
    state = machine_state(network.data, network.machine)
    estimated = estimate(candidates.problem, forms)
    moved = False
    for form, quantities in zip(forms, estimated.quantities, strict=True):
        # A straight drift reports a time constant, but its columns have none.
        fitted = [q for q in quantities if form in large and q.name in form.nonlinear]
        if any(abs(form.variant.fixed[q.name] - q.value) > REFINED_SIGMA * q.u for q in fitted):
            moved = True
            fixed = {q.name: q.value for q in fitted}
            candidates.refine(form, variant_at(form.candidate, fixed, network.machine, state))
    return moved
