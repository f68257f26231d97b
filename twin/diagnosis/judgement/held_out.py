"""Residuals of held-out readings, without and with the causes found."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from twin.diagnosis.judgement.sizes import SizedCauses
from twin.diagnosis.problem.forms import Candidates, Form
from twin.diagnosis.result import HeldOut
from twin.diagnosis.selection.cross_validation import (
    HeldOutFolds,
    choose_folds,
    folds_at_positions,
    folds_in_time,
    held_out_squares,
    jackknife_interval,
    predicted_pattern_shift,
    predicted_shift,
)
from twin.diagnosis.selection.likelihood import Likelihood
from twin.diagnosis.selection.payload import restore_payloads, select_on_part
from twin.diagnosis.selection.structure import Findings, refit_on_part
from twin.machine.effects.empirical import channel_name
from twin.machine.effects.waves import APPROACH


def held_out(sized: SizedCauses, written: Collection[int] = ()) -> HeldOut | None:
    """Return the residuals of held-out readings, without and with the causes that are significant on the other readings.

    The search on each part starts from the selected causes; fitted periods and forbidden causes are reset first. None if nothing can
    be held out.

    Args:
        sized: the causes with their sizes; they decide what is held out (`twin.diagnosis.selection.cross_validation`).
        written: numbers of the patterns that are in the file as well.
    """
    found, forms = sized.found, sized.forms
    problem, candidates = found.problem, found.candidates
    barred = {form.key for form, promise in zip(forms, sized.promised, strict=True) if not promise}
    split = choose_folds(problem.network.data, problem.network.machine, [form.candidate for form in forms])
    candidates.set_problem(problem)
    restore_payloads(candidates, forms)
    if split is None:
        return None

    def predict(small: Candidates) -> tuple[np.ndarray, np.ndarray]:
        # If held-out readings refuted causes, the remaining ones are not searched again.
        chosen = forms if found.refuted else select_on_part(small, forms).forms
        kept, likelihood = refit_on_part(small, chosen, found.structure)
        after = predicted_shift(problem, small, [form for form in kept if form.key not in barred])
        if written and likelihood is not None:
            after = after + predicted_pattern_shift(likelihood, kept, written)
        return np.zeros_like(after), after

    return _held_out(candidates, split, predict)


def held_out_patterns(found: Findings, forms: Sequence[Form], written: Collection[int]) -> HeldOut | None:
    """Return the residuals of held-out readings, with the causes alone and with some patterns added, fitted to the other readings.

    Args:
        found: the selected causes and patterns.
        forms: the causes; the same on every part.
        written: numbers of the patterns added.
    """
    problem, structure = found.problem, found.structure
    network, candidates = problem.network, found.candidates
    names = {name for k in written for name in structure.pattern_tests[k].pattern.names}
    # The approach direction of an axis is held out by the positions of that axis.
    axes = {channel_name(name).removeprefix(APPROACH) for name in names}
    moving = [i for i, name in enumerate(network.machine.names) if name in axes]
    split = folds_at_positions(network.data, moving) if moving else folds_in_time(network.data)
    if split is None:
        return None

    def predict(small: Candidates) -> tuple[np.ndarray, np.ndarray]:
        named = predicted_shift(problem, small, forms)
        return named, named + predicted_pattern_shift(Likelihood(small, structure.pattern_tests), forms, written)

    return _held_out(candidates, split, predict)


def _held_out(
    candidates: Candidates, split: HeldOutFolds, predict: Callable[[Candidates], tuple[np.ndarray, np.ndarray]]
) -> HeldOut | None:
    table = held_out_squares(candidates, split, predict)
    if table is None:
        return None
    total = table.sum(axis=0)
    before, after = np.sqrt(total[:2] / total[2])
    return HeldOut(split.of, len(table), float(before), float(after), jackknife_interval(table))
