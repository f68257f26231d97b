"""Residuals of readings that the fit has not seen, without and with what was found."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from twin.diagnosis.judgement.sizes import Sized
from twin.diagnosis.problem.forms import Candidates, Form
from twin.diagnosis.result import HeldOut
from twin.diagnosis.selection.left_out import (
    Parts,
    at_positions,
    foretold,
    foretold_patterns,
    in_time,
    interval,
    on_parts,
    parts,
)
from twin.diagnosis.selection.likelihood import Likelihood
from twin.diagnosis.selection.payload import again as payload_again
from twin.diagnosis.selection.payload import chosen_on
from twin.diagnosis.selection.structure import Findings, again
from twin.machine.effects.empirical import state_name
from twin.machine.effects.waves import APPROACH


def held_out(sized: Sized, written: Collection[int] = ()) -> HeldOut | None:
    """Residuals of readings that the fit has not seen, without and with the causes that are worth their price on the others.

    The search begins with the causes that stand; where a period lies or what cannot be is forgotten first. None where nothing can be
    held out.

    Args:
        sized: the causes that stand in the end: they decide what is held out (`twin.diagnosis.selection.folds`).
        written: numbers of the patterns that are in the file as well.
    """
    found, forms = sized.found, sized.forms
    problem, candidates = found.problem, found.candidates
    barred = {form.key for form, promise in zip(forms, sized.promised, strict=True) if not promise}
    split = parts(problem.network.data, problem.network.machine, [form.candidate for form in forms])
    candidates.set_problem(problem)
    payload_again(candidates, forms)
    if split is None:
        return None

    def judged(small: Candidates) -> tuple[np.ndarray, np.ndarray]:
        # Where causes were refuted by readings left out, those that stand are not searched anew.
        chosen = forms if found.refuted else chosen_on(small, forms).forms
        kept, likelihood = again(small, chosen, found.structure)
        after = foretold(problem, small, [form for form in kept if form.key not in barred])
        if written and likelihood is not None:
            after = after + foretold_patterns(likelihood, kept, written)
        return np.zeros_like(after), after

    return _held_out(candidates, split, judged)


def held_out_patterns(found: Findings, forms: Sequence[Form], written: Collection[int]) -> HeldOut | None:
    """Residuals of readings held out, with the causes alone and with some patterns beside them, all fitted to the other readings.

    Args:
        found: the causes and patterns.
        forms: the causes that stand; the same on every part.
        written: numbers of the patterns.
    """
    problem, structure = found.problem, found.structure
    network, candidates = problem.network, found.candidates
    names = {name for k in written for name in structure.traces[k].pattern.names}
    # A direction of approach is that of a position as well.
    axes = {state_name(name).removeprefix(APPROACH) for name in names}
    moving = [i for i, name in enumerate(network.machine.names) if name in axes]
    split = at_positions(network.data, moving) if moving else in_time(network.data)
    if split is None:
        return None

    def judged(small: Candidates) -> tuple[np.ndarray, np.ndarray]:
        named = foretold(problem, small, forms)
        return named, named + foretold_patterns(Likelihood(small, structure.traces), forms, written)

    return _held_out(candidates, split, judged)


def _held_out(
    candidates: Candidates, split: Parts, judged: Callable[[Candidates], tuple[np.ndarray, np.ndarray]]
) -> HeldOut | None:
    table = on_parts(candidates, split, judged)
    if table is None:
        return None
    total = table.sum(axis=0)
    before, after = np.sqrt(total[:2] / total[2])
    return HeldOut(split.of, len(table), float(before), float(after), interval(table))
