"""Which causes account for the misfit: forward selection with re-examination, every search paid for.

Sets of causes are compared by what they explain less what each must explain to be believed (`twin.diagnosis.problem.forms`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, Cell
from twin.diagnosis.problem.forms import ADDITIONAL_CAUSE_PENALTY, Candidates, Form
from twin.diagnosis.problem.readings import DiagnosisTask
from twin.diagnosis.selection.left_out import parts

SHARE: Final = 0.25
"""A family's share of `FALSE_ALARM_RATE` grows with its number of forms to this power: more is lost where each form is dear already."""
SELDOM: Final = 0.1
"""Share of `FALSE_ALARM_RATE`, beside that of others, of mistakes of which one look tells if they are there at all."""
MOST: Final = 30
"""Causes at most: as many as a machine has curves."""
FEW: Final = 6
"""Causes up to which every step is re-examined and other beginnings are tried; beyond, only the whole set is, once."""
STARTS: Final = 4
SAME: Final = 0.01
"""Share of what a form explains that others may leave of it and still count as the same."""
TRIED: Final = 3
"""Exchanges that are looked at in full."""
DOUBTED: Final = 3.0
"""Standard uncertainties by which a value may be beyond what is possible."""
CANCELS: Final = 10.0
"""Times all that the causes explain: what one of them may do to the readings, in squares, at most."""
FEWEST: Final = 25.0
"""Of a chi²: where little is explained, scatter has its part in it."""
ROUGHLY: Final = 0.2
"""How far from one the share of an effect that is there altogether may be, beside other errors of the model."""
LEAST: Final = 0.01
"""Share of what all causes explain that a pliable effect has to do at least: beside what is much larger, what its form leaves looks
like it."""
LIKELY: Final = 12
"""Forms whose inner products with all others are worked out in one go."""


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


def select(candidates: Candidates, begun: Sequence[Form] = ()) -> Selection:
    """The best set: from several first choices, forward, each step re-examined by removing and exchanging.

    Args:
        candidates: the forms.
        begun: a set to begin with instead, whose causes stay where each is worth it.
    """
    found = Selection((), 0.0)
    if not candidates.forms:
        return found
    if begun:
        candidates.prepare(begun)
        forms = grown(candidates, list(begun))
        return Selection(tuple(forms), candidates.penalised_gain(forms))
    margin = candidates.margins([])
    order = [int(i) for i in np.argsort(-margin, kind="stable") if margin[i] > 0.0]
    first: dict[int, int] = {}
    for i in order:
        first.setdefault(int(candidates.key_of[i]), i)
    if not first:
        return found
    candidates.prepare([candidates.forms[i] for i in list(first.values())[:LIKELY]])
    likely = [[candidates.forms[i]] for i in list(first.values())[:STARTS]]
    for start in likely:
        forms = grown(candidates, start)
        worth = candidates.penalised_gain(forms)
        if worth > found.worth + 1e-6:
            found = Selection(tuple(forms), worth)
        if len(forms) > FEW:
            break  # a model that is wrong all over: where one begins is not what matters
    if len(found.forms) > FEW:
        # A machine whose constants were never identified: each of them is worth little before the others are in.
        numbers = np.array([form.candidate.specification.constant for form in candidates.forms])
        forms = grown(candidates, grown(candidates, [], numbers))
        worth = candidates.penalised_gain(forms)
        if worth > (1.0 - SAME) * found.worth:
            found = Selection(tuple(forms), worth)
    forms = _split(candidates, list(found.forms))
    return Selection(tuple(forms), candidates.penalised_gain(forms))


def glimpse(candidates: Candidates, most: int) -> tuple[Form, ...]:
    """The first few causes that anyone would name: what is large, not what is right in the end."""
    margin = candidates.margins([])
    if len(margin) == 0 or margin.max() <= 0.0:
        return ()
    return tuple(grown(candidates, [candidates.forms[int(np.argmax(margin))]], most=most))


def possible(candidates: Candidates, best: Selection, anew: bool) -> Selection:
    """The best set in which no cause is larger than it can be (`excessive`).

    Args:
        candidates: the forms.
        best: the best set, whatever its size (`select`).
        anew: whether the search is made anew without a cause that is too large, or goes on from the others.
    """
    allowed = candidates.critical_table
    while True:
        if any(
            form.candidate.specification.flexible and excessive(candidates, form, best.forms) == np.inf
            for form in best.forms
        ):
            # None of them: what they displaced comes back.
            candidates.critical_table = allowed
            candidates.exclude({form.key for form in candidates.forms if form.candidate.specification.flexible})
            allowed = candidates.critical_table
            best = select(candidates, () if anew else [f for f in best.forms if not f.candidate.specification.flexible])
            continue
        excess = [excessive(candidates, form, best.forms) for form in best.forms]
        if not excess or max(excess) <= 1.0:
            return best
        # One at a time: what it made up for may be possible without it.
        worst = best.forms[int(np.argmax(excess))].key
        candidates.exclude({worst})
        best = select(candidates, () if anew else [form for form in best.forms if form.key != worst])


def excessive(candidates: Candidates, form: Form, forms: Sequence[Form]) -> float:
    """How many times larger a form is than it can be: than physics allows, or than what it is to explain.

    A cause that would move the readings by more than they are off needs another that takes it back; neither is there.

    Args:
        candidates: the data.
        form: one of ``forms``.
        forms: what is in.
    """
    columns, values, inverse = candidates.fitted(forms)
    at = np.searchsorted(columns, form.columns)
    u = np.sqrt(np.maximum(np.diag(inverse)[at], 0.0))
    return excess_of(form, values[at], u, candidates.gram([form]), float(candidates.slope[columns] @ values))


def excess_of(form: Form, values: np.ndarray, u: np.ndarray, gram: np.ndarray, explained: float) -> float:
    """The same, of values (plausible sizes) with their standard uncertainties.

    Args:
        form: the form.
        values: (w,) of its columns.
        u: (w,) standard uncertainties.
        gram: (w, w) inner products of its columns.
        explained: by all causes together.
    """
    own = float(values @ gram @ values)
    if form.candidate.specification.flexible and own < LEAST * explained:
        return np.inf
    found = own / (CANCELS * (explained + FEWEST))
    scale = np.array([column.scale for column in form.variant.columns])
    if np.isfinite(form.candidate.largest):
        found = max(found, float(np.max((np.abs(values) - DOUBTED * u) * scale)) / form.candidate.largest)
    if form.candidate.specification.non_negative and len(values) == 1 and values[0] < -DOUBTED * u[0]:
        return np.inf
    if form.candidate.specification.all_or_nothing:
        found = max(found, abs(float(values[0] * scale[0]) - 1.0) / max(ROUGHLY, DOUBTED * float(u[0] * scale[0])))
    return found


def _split(candidates: Candidates, forms: list[Form]) -> list[Form]:
    """Curves that have a constant or a slope, told apart into the numbers those are and the curves they leave.

    The datum gives a curve neither (`twin.identification.unknowns`). Where they are the smaller part of it, one cause says it in fewer
    words; where they are the larger, the number is what is wrong with the machine, and curves that share it hide it.
    """
    pure = {
        (one.key, one.variant.columns[-1]): one for one in candidates.forms if one.variant.fixed.get("first", 0.0) > 0.0
    }
    bent = [pure[form.key, form.variant.columns[-1]] for form in forms if form.variant.fixed.get("first") == 0.0]
    trial = [form for form in forms if form.variant.fixed.get("first") != 0.0]
    whole = candidates.explained_by(forms)
    enough = whole - SAME * (whole - candidates.explained_by(trial))
    trial += bent
    numbers: list[Form] = []
    while bent and candidates.explained_by(trial) < enough:
        margin = np.where(
            [form.candidate.specification.constant for form in candidates.forms], _free(candidates, trial), -np.inf
        )
        if margin.max() <= 0.0:
            return forms
        numbers.append(candidates.forms[int(np.argmax(margin))])
        trial.append(numbers[-1])
    whole = candidates.explained_by(trial)
    for one in numbers:
        others = [other for other in trial if other is not one]
        own = whole - candidates.explained_by(others)
        hosts = []
        for form, rest in zip([form for form in forms if form.variant.fixed.get("first") == 0.0], bent, strict=True):
            hosted = candidates.explained_by([form if other is rest else other for other in others])
            if hosted > whole - SAME * own:
                hosts.append(whole - candidates.explained_by([other for other in trial if other is not rest]))
        # Of several curves none has it more than another.
        if len(hosts) == 1 and own < hosts[0]:
            return forms
    for rest in bent:
        without = [one for one in trial if one is not rest]
        if candidates.penalised_gain(without) >= candidates.penalised_gain(trial):
            trial = without
    return trial


def grown(
    candidates: Candidates, forms: Sequence[Form], allowed: np.ndarray | bool = True, most: int = MOST
) -> list[Form]:
    """More and more forms, as long as each is worth it.

    Args:
        candidates: the forms.
        forms: to begin with.
        allowed: (forms,) which may come in.
        most: how many at most.
    """
    forms = _exchanged(candidates, list(forms), allowed)
    while len(forms) < most:
        now = candidates.penalised_gain(forms)
        best = candidates.forms[int(np.argmax(candidates.margins(forms)))]
        if best.nonlinear and best.slot in {form.slot for form in forms}:
            # Most of what is left is what lies between two periods or time constants that were tried: the estimate sees to that.
            return forms
        margin = np.where(allowed, _free(candidates, forms), -np.inf)
        for i in np.argsort(-margin, kind="stable")[:TRIED]:
            if margin[i] <= ADDITIONAL_CAUSE_PENALTY:
                return _exchanged(candidates, forms, allowed) if len(forms) > FEW else forms
            larger = [*forms, candidates.forms[int(i)]]
            if len(larger) <= FEW:
                larger = _exchanged(candidates, larger, allowed)
            if candidates.penalised_gain(larger) > now + 1e-6:
                break
        else:
            return forms
        forms = larger
    return _exchanged(candidates, forms, allowed) if len(forms) > FEW else forms


def _free(candidates: Candidates, forms: Sequence[Form]) -> np.ndarray:
    """Margins of the forms that may stand beside some others."""
    taken = [candidates.slot_of[form.index] for form in forms]
    return np.where(np.isin(candidates.slot_of, taken), -np.inf, candidates.margins(forms))


def _exchanged(candidates: Candidates, forms: list[Form], allowed: np.ndarray | bool) -> list[Form]:
    """Each cause replaced by any better one, or dropped, until nothing changes."""
    now = candidates.penalised_gain(forms)
    for _ in range(8):
        better = _better(candidates, forms, now, allowed)
        if better is None:
            break
        forms, now = better
    return forms


def _better(
    candidates: Candidates, forms: list[Form], now: float, allowed: np.ndarray | bool
) -> tuple[list[Form], float] | None:
    for k in range(len(forms))[-FEW:]:
        others = forms[:k] + forms[k + 1 :]
        if others and (worth := candidates.penalised_gain(others)) >= now:
            return others, worth
        margin = np.where(allowed, _free(candidates, others), -np.inf)
        for i in np.argsort(-margin)[:TRIED]:
            trial = [*others, candidates.forms[int(i)]]
            if (
                np.isfinite(margin[i])
                and candidates.forms[int(i)] is not forms[k]
                and (worth := candidates.penalised_gain(trial)) > now + 1e-6
            ):
                return trial, worth
    return None


def every(candidates: Sequence[Candidate], costs: dict[str, float]) -> list[tuple[Candidate, Cell, float]]:
    """All forms of all candidates, with their prices."""
    return [(c, variant, costs[c.effect]) for c in candidates for variant in c.variants]


def prices(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Log of the number of tests by effect: the forms of its family over the family's share of all false alarms."""
    tests: dict[str, float] = {}
    seldom = {candidate.effect for candidate in candidates if candidate.specification.rare}
    for candidate in candidates:
        tests[candidate.effect] = tests.get(candidate.effect, 0.0) + candidate.tests
    shares = {effect: count**SHARE * (SELDOM if effect in seldom else 1.0) for effect, count in tests.items()}
    total = sum(shares.values())
    return {effect: float(np.log(total * count / shares[effect])) for effect, count in tests.items()}


def candidates_of(task: DiagnosisTask) -> Candidates:
    """Every form of every candidate with its price, and what the data say of it."""
    problem, known = task.problem, task.catalogue.candidates
    split = parts(problem.network.data, problem.network.machine, ())
    return Candidates(problem, every(known, prices(known)), task.noise.dof, None if split is None else split.part)
