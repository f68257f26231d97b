"""What stands beside each other in the readings: causes with a name, and patterns without.

Causes are chosen first as if everything had a name. Where a pattern is left beside them, the account is made anew from the patterns on:
a cause comes in where it makes the readings more likely, the patterns' variances fitted anew with it, by more than its price
(`twin.diagnosis.selection.likelihood`). So a cause with an imperfect form stays a cause, and one that imitates a part of a pattern
is none.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.diagnosis.estimate.estimate import RandomEffects
from twin.diagnosis.problem.forms import DEVIANCE_RULED_OUT, Candidates, Form, columns_of
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.readings import DiagnosisTask
from twin.diagnosis.selection.likelihood import Likelihood, Model
from twin.diagnosis.selection.patterns import Pattern
from twin.diagnosis.selection.search import FEW, excess_of
from twin.diagnosis.selection.unnamed import ALARMS, Trace, scan

MOST: Final = 3
"""Patterns at most."""
CAUSES: Final = 30
"""Causes at most."""
TRIED: Final = 5
"""Causes that are looked at in full at every step."""
CLEAR: Final = 20.0
"""Times its price that a cause gains at most, from which on it is not asked whether it pays for itself."""
BETTER: Final = 0.1
MOSTLY: Final = 0.9
"""Share of all that is explained from which on causes stand, whatever their form leaves to patterns."""
PART: Final = 1.0
"""Times what patterns that can imitate it leave, which a cause must carry."""
HOPEFUL: Final = 0.3
"""Share of its price that a cause must explain beside patterns whose variances still hold it, to be looked at."""
FEWER: Final = 3
"""Causes that one pattern must replace to be the simpler account."""


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """Causes, and the patterns beside them.

    Attributes:
        forms: the causes.
        likelihood: of causes beside the patterns; None where there are none.
        model: at the most likely variances; likewise.
        problem: the data with the patterns free beside the set-up.
        fallen: causes that were chosen at first and do not stand beside the patterns.
        patterned: whether the account was made from the patterns on, not from the causes.
    """

    forms: tuple[Form, ...]
    likelihood: Likelihood | None
    model: Model | None
    problem: Problem
    fallen: tuple[Form, ...]
    patterned: bool = False

    @property
    def traces(self) -> tuple[Trace, ...]:
        """The patterns."""
        return () if self.likelihood is None else self.likelihood.traces

    @property
    def beside(self) -> RandomEffects | None:
        """The patterns, for an estimate of the causes beside them."""
        if self.model is None or self.likelihood is None:
            return None
        return RandomEffects(self.likelihood.random(self.model), self.model.scatter)

    def explained(self, forms: Sequence[Form]) -> float:
        """What the patterns explain beside some of the causes."""
        return (
            0.0 if self.likelihood is None else self.likelihood.explained(forms, self.likelihood.fit(forms, self.model))
        )

    def pattern(self, forms: Sequence[Form]) -> np.ndarray:
        """(3n,) what the patterns do to the whitened readings beside some of the causes.

        As large as the patterns are expected to be: what is most likely at every reading is smaller by its own variance.
        """
        if self.likelihood is None:
            return np.zeros(len(self.problem.residual))
        model = self.likelihood.fit(forms, self.model)
        pattern = self.likelihood.pattern(forms, model)
        size = max(float(pattern @ pattern), 1e-300)
        return np.asarray(pattern * np.sqrt(1.0 + model.scatter * model.followed / size))


@final
@dataclass(frozen=True, eq=False)
class Findings:
    """What was asked of the data and what they answered.

    Attributes:
        task: the rows that count, and the causes that were tried.
        patterns: the patterns without a name that were looked for.
        candidates: the causes, beside the set-up.
        beside: the same, beside the patterns that were found as well; ``candidates`` itself where there are none.
        structure: the causes that stand, and those patterns.
        refuted: causes that the readings show, and readings left out of the fit do not (`twin.diagnosis.selection.left_out`).
    """

    task: DiagnosisTask
    patterns: Sequence[Pattern]
    candidates: Candidates
    beside: Candidates
    structure: Structure
    refuted: tuple[Form, ...] = ()

    @property
    def problem(self) -> Problem:
        """The rows that count, whitened."""
        return self.task.problem


def settled(candidates: Candidates, forms: Sequence[Form], tried: Sequence[Pattern]) -> Structure:
    """Causes chosen as if everything had a name, or, where patterns carry more than a small part, those that stand beside these.

    Args:
        candidates: the data, and what a cause must explain.
        forms: the causes that were chosen.
        tried: patterns to look for.
    """
    found = named(candidates, forms, tried)
    left, patterned = bool(found.traces), False
    if left or len(forms) >= FEWER:
        carried = candidates.explained_by(found.forms)
        if not found.forms or (found.model is not None and carried < MOSTLY * found.model.explained) or not left:
            other = _patterned(candidates, tried)
            # Enough causes can imitate anything: a pattern that does what several of them do is the simpler account.
            simpler = (
                len(other.forms) <= len(found.forms) - FEWER
                and _worth(candidates, other) > candidates.penalised_gain(forms) - DEVIANCE_RULED_OUT
            )
            # Causes that no pattern beside them can do are no parts of one.
            better = _apart(found) and _worth(candidates, found) > _worth(candidates, other)
            if other.traces and (left or simpler) and not better:
                found, patterned = other, True
    keys = {form.key for form in found.forms}
    fallen = tuple(form for form in forms if form.key not in keys)
    return Structure(found.forms, found.likelihood, found.model, found.problem, fallen, patterned)


def _apart(found: Structure) -> bool:
    """Whether there are causes and patterns, and no pattern could do most of any cause."""
    likelihood = found.likelihood
    return likelihood is not None and bool(found.forms) and not any(likelihood.imitated(f).any() for f in found.forms)


def again(
    candidates: Candidates, forms: Sequence[Form], found: Structure
) -> tuple[tuple[Form, ...], Likelihood | None]:
    """Causes as they stand on a part of the data, beside the patterns that were found on all of it, and the likelihood of those.

    Args:
        candidates: the part.
        forms: the causes that were chosen on it.
        found: the account of all data.
    """
    if not found.traces:
        return tuple(forms), None
    likelihood = Likelihood(candidates, found.traces)
    if found.patterned:
        stand = [candidates.forms[form.index] for form in found.forms]
        return tuple(_dropped(likelihood, stand, likelihood.fit(stand))[0]), likelihood
    return tuple(without_parts(likelihood, forms, likelihood.fit(forms))), likelihood


def named(candidates: Candidates, forms: Sequence[Form], tried: Sequence[Pattern]) -> Structure:
    """The causes that were chosen, without those that carry only a part of what they go with, and the patterns beside them."""
    stand = list(forms)
    traces: list[Trace] = []
    problem, likelihood, model = candidates.problem, None, None
    while True:
        seen = {(trace.pattern.side, trace.pattern.names) for trace in traces}
        more = [
            trace
            for trace in (scan(problem, tried, stand, candidates.dof) if len(traces) < MOST else [])
            if trace.found and (trace.pattern.side, trace.pattern.names) not in seen
        ]
        if not more:
            return Structure(tuple(stand), likelihood, model, problem, ())
        likelihood = Likelihood(candidates, [*traces, more[0]])
        model = likelihood.fit(stand)
        whole = without_parts(likelihood, stand, model)
        if len(whole) == len(stand):
            traces.append(more[0])
            problem = candidates.problem.with_random_effects(likelihood.random(model), model.scatter)
        else:
            # What they had taken up is the patterns' or another cause's.
            stand, traces, problem, likelihood, model = whole, [], candidates.problem, None, None


def _patterned(candidates: Candidates, tried: Sequence[Pattern]) -> Structure:
    """The account from the pattern on that shows best; nothing where none shows."""
    whole = scan(candidates.problem, tried, (), candidates.dof)
    if not (whole and whole[0].found):
        return Structure((), None, None, candidates.problem, ())
    return _beside(candidates, whole[0], tried)


def _worth(candidates: Candidates, found: Structure) -> float:
    """What an account explains less what each part of it must."""
    if found.model is None:
        return candidates.penalised_gain(found.forms)
    prices = sum(_price(trace) for trace in found.traces)
    return found.model.twice - prices - sum(_cost(candidates, form) for form in found.forms)


def _price(trace: Trace) -> float:
    """What a pattern must make the readings more likely by, twice the logarithm."""
    return float(2.0 * (trace.log_price - np.log(ALARMS)))


def _cost(candidates: Candidates, form: Form) -> float:
    """What a cause must make the readings more likely by beside a pattern, twice the logarithm."""
    return candidates.critical_value(form, float(len(form.columns)))


def _beside(candidates: Candidates, first: Trace, tried: Sequence[Pattern]) -> Structure:
    """The account from a pattern on: causes beside it, another pattern where one is left, and no pattern that is not needed."""
    traces = [first]
    forms: list[Form] = []
    seen = {(first.pattern.side, first.pattern.names)}
    barred: set[int] = set()
    while True:
        likelihood = Likelihood(candidates, traces)
        forms, model = _stepwise(likelihood, forms, barred)
        needed = [
            trace
            for k, trace in enumerate(traces)
            if model.twice - likelihood.fit(forms, model, without=k).twice > _price(trace)
        ]
        if len(needed) < len(traces):
            traces = needed
            if not traces:
                return Structure(tuple(forms), None, None, candidates.problem, ())
            likelihood = Likelihood(candidates, traces)
            forms, model = _stepwise(likelihood, forms, barred)
        problem = candidates.problem.with_random_effects(likelihood.random(model), model.scatter)
        more = [
            trace
            for trace in (scan(problem, tried, forms, candidates.dof) if len(traces) < MOST else [])
            if trace.found and (trace.pattern.side, trace.pattern.names) not in seen
        ]
        if more:
            traces = [*traces, more[0]]
            seen.add((more[0].pattern.side, more[0].pattern.names))
            continue
        whole = without_parts(likelihood, forms, model)
        if len(whole) == len(forms):
            forms, model = _plainer(likelihood, forms, model)
            return Structure(tuple(forms), likelihood, model, problem, ())
        barred |= {int(candidates.key_of[form.index]) for form in forms if form not in whole}
        forms = whole


def _stepwise(likelihood: Likelihood, forms: Sequence[Form], barred: Collection[int]) -> tuple[list[Form], Model]:
    """Causes added while they pay for themselves beside the patterns, and dropped where they no more do."""
    candidates = likelihood.candidates
    stand, model = _dropped(likelihood, list(forms), likelihood.fit(forms))
    while len(stand) < CAUSES:
        best: tuple[float, Form, Model] | None = None
        for form in _hopeful(likelihood, stand, model, barred):
            with_it = likelihood.fit([*stand, form], model)
            gained = with_it.twice - model.twice - _cost(candidates, form)
            if gained > (best[0] if best else 0.0) and _possible(candidates, [*stand, form], with_it):
                best = gained, form, with_it
                if len(stand) >= FEW:
                    break  # a model that is wrong all over: the order is not what matters
        if best is None:
            fewer, model = _dropped(likelihood, stand, model)
            other = _exchanged(likelihood, fewer, model, barred) if len(fewer) <= FEW else None
            if other is None and len(fewer) == len(stand):
                return stand, model
            stand, model = (fewer, model) if other is None else other
            continue
        stand, model = [*stand, best[1]], best[2]
    return _dropped(likelihood, stand, model)


def _exchanged(
    likelihood: Likelihood, stand: list[Form], model: Model, barred: Collection[int]
) -> tuple[list[Form], Model] | None:
    """One cause replaced by another where that is likelier; None where none is."""
    candidates = likelihood.candidates
    for form in stand:
        others = [one for one in stand if one is not form]
        less = likelihood.fit(others, model)
        for other in _hopeful(likelihood, others, less, barred):
            trial = [*others, other]
            found = likelihood.fit(trial, less)
            gained = found.twice - _cost(candidates, other) - model.twice + _cost(candidates, form)
            if other is not form and gained > BETTER and _possible(candidates, trial, found):
                return trial, found
    return None


def _plainer(likelihood: Likelihood, forms: list[Form], model: Model) -> tuple[list[Form], Model]:
    """Curves that no datum leaves a constant or a slope, replaced by the machine's constant that these data cannot tell from them."""
    candidates = likelihood.candidates
    for form in list(forms):
        if form.variant.fixed.get("first") != 0.0:
            continue
        others = [one for one in forms if one is not form]
        explained, dof = likelihood.scan(others, likelihood.fit(others, model))
        margin = explained - candidates.critical_values(dof)
        taken = {one.key for one in others}
        numbers = [
            f for f in candidates.forms if f.candidate.specification.constant and f.key not in taken and dof[f.index]
        ]
        for number in sorted(numbers, key=lambda one: -margin[one.index])[:1]:
            trial = [*others, number]
            found = likelihood.fit(trial, model)
            lost = model.twice - _cost(candidates, form) - found.twice + _cost(candidates, number)
            if lost < DEVIANCE_RULED_OUT and _possible(candidates, trial, found):
                forms, model = trial, found
    return forms, model


def _hopeful(likelihood: Likelihood, stand: Sequence[Form], model: Model, barred: Collection[int]) -> list[Form]:
    """The best form of the most promising candidates."""
    candidates = likelihood.candidates
    explained, dof = likelihood.scan(stand, model)
    costs = candidates.critical_values(dof)
    out = np.isin(candidates.slot_of, [candidates.slot_of[form.index] for form in stand]) | np.isin(
        candidates.key_of, list(barred)
    )
    margin = np.where(out, -np.inf, explained - costs)
    found: dict[int, Form] = {}
    for i in np.argsort(-margin, kind="stable").tolist():
        if len(found) == TRIED or not explained[i] > HOPEFUL * costs[i] or not np.isfinite(margin[i]):
            break
        found.setdefault(int(candidates.key_of[i]), candidates.forms[i])
    return list(found.values())


def _dropped(likelihood: Likelihood, forms: list[Form], model: Model) -> tuple[list[Form], Model]:
    """Without the causes that do not pay for themselves, those first that gain least at the variances as they are."""
    stand = list(forms)
    while True:
        prices = {form.index: _cost(likelihood.candidates, form) for form in stand}
        gained = {form.index: likelihood.gained(stand, model, form) for form in stand}
        for form in sorted(stand, key=lambda one: gained[one.index] - prices[one.index]):
            if gained[form.index] > CLEAR * prices[form.index]:
                continue
            others = [one for one in stand if one is not form]
            less = likelihood.fit(others, model)
            if model.twice - less.twice < prices[form.index]:
                stand, model = others, less
                break
        else:
            return stand, model


def without_parts(likelihood: Likelihood, forms: Sequence[Form], model: Model) -> list[Form]:
    """Causes without those that carry only a part of what they go with."""
    stand = list(forms)
    while (part := _partial(likelihood, stand, model)) is not None:
        stand = [form for form in stand if form is not part]
        model = likelihood.fit(stand, model)
    return stand


def _partial(likelihood: Likelihood, forms: Sequence[Form], model: Model) -> Form | None:
    """The cause that carries the smallest part of what it goes with, if patterns that could do the same explain more beside it."""
    left = likelihood.left(forms, model)
    whole = likelihood.candidates.explained_by(forms)
    worst: tuple[float, Form] | None = None
    for form in forms:
        # A machine has all its constants: what they carry together is asked.
        constant = form.candidate.specification.constant
        alike = [one for one in forms if constant and one.candidate.specification.constant]
        others = [one for one in forms if one is not form and one not in alike]
        carried = whole - likelihood.candidates.explained_by(others)
        beside = float(likelihood.imitated(form) @ left)
        ratio = carried / max(beside, 1e-9)
        if carried < PART * beside and (worst is None or ratio < worst[0]):
            worst = ratio, form
    return None if worst is None else worst[1]


def _possible(candidates: Candidates, forms: Sequence[Form], model: Model) -> bool:
    """Whether no cause would have to be larger than it can be."""
    columns = columns_of(forms)
    return all(
        excess_of(form, model.values[at], np.zeros(len(at)), candidates.gram([form]), model.explained) <= 1.0
        for form in forms
        for at in [np.searchsorted(columns, form.columns)]
    )
