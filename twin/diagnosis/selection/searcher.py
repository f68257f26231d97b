"""The best set of causes, and the patterns without a name that stand beside them."""

from __future__ import annotations

from typing import Final, final

from twin.diagnosis.candidates.machine_effects import variant_at
from twin.diagnosis.estimate.estimate import estimate
from twin.diagnosis.problem.forms import Form
from twin.diagnosis.problem.readings import DiagnosisTask
from twin.diagnosis.selection.left_out import foretells, held_up
from twin.diagnosis.selection.patterns import patterns
from twin.diagnosis.selection.payload import chosen
from twin.diagnosis.selection.search import Selection, candidates_of
from twin.diagnosis.selection.structure import Findings, Structure, named, settled
from twin.measurement.table import state_of

LARGE: Final = 100.0
"""Chi² of a cause from which on what it leaves between two values that were tried could pass for another cause."""
REFINED: Final = 2
STAYS: Final = 0.2
"""Standard uncertainties by which a period or time constant that was put there once may still move."""


def selected(task: DiagnosisTask) -> Findings:
    """The causes that account for the misfit, and the patterns beside them.

    Args:
        task: the rows that count, and the causes to try.
    """
    return Searcher(task).run()


@final
class Searcher:
    """The catalogue and the patterns without a name, on one data set.

    Args:
        task: the rows that count, and the causes to try.
    """

    def __init__(self, task: DiagnosisTask) -> None:
        self.task = task
        self.problem = task.problem
        self.candidates = candidates_of(task)
        self.patterns = patterns(self.problem.network.machine, self.problem.network.data)

    def run(self) -> Findings:
        """The best set of causes, and the patterns without a name that stand beside them."""
        found, refuted = self._settled()
        # What a variant does between positions is asked of positions left out: refuted there, it is the plain effect and a rest.
        while varying := [
            form
            for form in found.forms
            if form.candidate.specification.variant_of and not foretells(self.candidates, form, found.forms)
        ]:
            self.candidates.exclude({form.key for form in varying})
            found, refuted = self._settled()
        beside = self.candidates.for_problem(found.problem) if found.traces else self.candidates
        return Findings(self.task, self.patterns, self.candidates, beside, found, refuted)

    def _settled(self) -> tuple[Structure, tuple[Form, ...]]:
        """The causes that stand and the patterns beside them, and the causes that readings left out refute.

        Where these are too few for what was fitted to them, they are too few as well to ask what causes a pattern could do.
        """
        chosen = self._best().forms
        kept = held_up(self.candidates, chosen)
        if len(kept) == len(chosen):
            found = settled(self.candidates, chosen, self.patterns)
            chosen, kept = found.forms, held_up(self.candidates, found.forms)
            if len(kept) == len(chosen):
                return found, ()
        return named(self.candidates, kept, self.patterns), tuple(form for form in chosen if form not in kept)

    def _best(self) -> Selection:
        """Named causes alone.

        Between two periods or time constants that were tried, a large cause leaves more than another cause is: what is large is put
        where the data have it, and the search made again.
        """
        best = chosen(self.candidates)
        for _ in range(REFINED):
            if not self._refined(best):
                break
            best = chosen(self.candidates, best.forms)
        return best

    def _refined(self, best: Selection) -> bool:
        machine, data = self.problem.network.machine, self.problem.network.data
        bent = [form for form in best.forms if form.nonlinear]
        large = [
            form
            for form in bent
            if self.candidates.scores([one for one in best.forms if one is not form], [form.index])[0, 0] > LARGE
        ]
        if not large:
            return False
        state = state_of(data, machine)
        found = estimate(self.problem, best.forms)
        moved = False
        for form, quantities in zip(best.forms, found.quantities, strict=True):
            # A straight drift has a time constant to show, but none in its columns.
            put = {q.name: q for q in quantities if form in large and q.name in form.nonlinear}
            if not any(abs(form.variant.fixed[q.name] - q.value) > STAYS * q.u for q in put.values()):
                continue
            moved = True
            fixed = {name: q.value for name, q in put.items()}
            self.candidates.refine(form, variant_at(form.candidate, fixed, machine, state))
        return moved
