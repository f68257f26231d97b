"""Search for the best set of causes together with unnamed patterns."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.candidates.machine_effects import variant_at
from twin.diagnosis.estimate.estimate import estimate
from twin.diagnosis.estimate.reweighted import remaining_discrepancy
from twin.diagnosis.problem.forms import Candidates, Form
from twin.diagnosis.problem.readings import DiagnosisTask
from twin.diagnosis.selection.cross_validation import (
    blocks_of_time,
    held_out_squares,
    jackknife_interval,
    predicted_shift,
    predicts_held_out,
    without_overfitting,
)
from twin.diagnosis.selection.patterns import patterns
from twin.diagnosis.selection.payload import select_with_payload
from twin.diagnosis.selection.search import Selection, candidates_of
from twin.diagnosis.selection.structure import Findings, Structure, joint_selection, with_patterns
from twin.identification.discrepancy import settled
from twin.measurement.state import machine_state

RESELECTED: Final = 4
"""Largest number of searches with other weights."""
TIME: Final = "time_s"
NOT_PREDICTED: Final = "they do not predict held-out positions"
"""Reason for which variants are left out, in words."""
LARGE: Final = 100.0
"""χ² of a cause above which its residual between two tabulated periods or time constants could look like another cause."""
REFINED: Final = 2
"""Largest number of refinements of periods and time constants."""
STAYS: Final = 0.2
"""Change of a period or time constant, in standard uncertainties, below which it is not refined again."""


def select_causes(task: DiagnosisTask) -> Findings:
    """Return the causes and the unnamed patterns that explain the residuals.

    If they leave more than the noise, the search is repeated with noise and discrepancy in the weights.

    Args:
        task: the problem without outliers, and the causes to test; with the weights of the noise.
    """
    found = _select(task)
    for _ in range(RESELECTED):
        structure = found.structure
        discrepancy = remaining_discrepancy(
            found.task, structure.forms, estimate(found.problem, structure.forms), structure.problem
        )
        if settled(task.problem.network, found.task.discrepancy, discrepancy):
            break
        found = replace(_select(task.with_discrepancy(discrepancy)), by_noise=found.by_noise)
    return found


def _select(task: DiagnosisTask) -> Findings:
    """Return the causes and the unnamed patterns, with the weights of the task.

    A variant that changes with time (a growth that lags behind its sensor) resembles many slow changes. It is searched for only where
    something changes with time, and named only if it predicts held-out blocks of time better than the plain effect does, or as well as
    several causes with more parameters.
    """
    plain = without_variants_in_time(task)
    found = Searcher(plain).run()
    if plain is task or not _changes_with_time(found):
        return found
    other = Searcher(task).run()
    return other if _is_better_in_time(other, found) else found


def without_variants_in_time(task: DiagnosisTask) -> DiagnosisTask:
    """Return the task with plain effects only, for the first search; the task itself if it has no variants that change with time."""
    plain = tuple(one for one in task.catalogue.candidates if not _is_variant_in_time(one))
    if len(plain) == len(task.catalogue.candidates):
        return task
    return replace(task, catalogue=replace(task.catalogue, candidates=plain))


def _is_variant_in_time(candidate: Candidate) -> bool:
    return bool(candidate.specification.variant_of) and candidate.specification.varies == "with time"


def _changes_with_time(found: Findings) -> bool:
    columns = {name for one in found.structure.pattern_tests for name in one.pattern.names}
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
        found, refuted = self._settled()
        # A variant that does not predict held-out positions is replaced by the plain effect and unexplained residuals.
        while varying := [
            form
            for form in found.forms
            if form.candidate.specification.variant_of and not predicts_held_out(self.candidates, form, found.forms)
        ]:
            self.candidates.exclude({form.key for form in varying}, NOT_PREDICTED)
            found, refuted = self._settled()
        beside = self.candidates.for_problem(found.problem) if found.pattern_tests else self.candidates
        return Findings(self.task, self.patterns, self.candidates, beside, found, self.candidates, refuted)

    def _settled(self) -> tuple[Structure, tuple[Form, ...]]:
        """Return the selected causes and patterns, and the causes that held-out readings refute.

        If there are too few readings for the causes, there are also too few to decide which causes a pattern could replace.
        """
        chosen = self._best().forms
        kept = without_overfitting(self.candidates, chosen)
        if len(kept) == len(chosen):
            found = joint_selection(self.candidates, chosen, self.patterns)
            chosen, kept = found.forms, without_overfitting(self.candidates, found.forms)
            if len(kept) == len(chosen):
                return found, ()
        return with_patterns(self.candidates, kept, self.patterns), tuple(form for form in chosen if form not in kept)

    def _best(self) -> Selection:
        """Return the best set of causes without patterns.

        Between two tabulated periods or time constants, the residual of a large cause can exceed another cause. Periods and time
        constants of large causes are therefore refined, and the search is repeated.
        """
        best = select_with_payload(self.candidates)
        for _ in range(REFINED):
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
            if self.candidates.scores([one for one in best.forms if one is not form], [form.index])[0, 0] > LARGE
        ]
        if not large:
            return False
        state = machine_state(data, machine)
        found = estimate(self.problem, best.forms)
        moved = False
        for form, quantities in zip(best.forms, found.quantities, strict=True):
            # A straight drift reports a time constant, but its columns have none.
            put = {q.name: q for q in quantities if form in large and q.name in form.nonlinear}
            if not any(abs(form.variant.fixed[q.name] - q.value) > STAYS * q.u for q in put.values()):
                continue
            moved = True
            fixed = {name: q.value for name, q in put.items()}
            self.candidates.refine(form, variant_at(form.candidate, fixed, machine, state))
        return moved
