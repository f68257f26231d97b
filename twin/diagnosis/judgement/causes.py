"""The causes as they are reported: with what could stand in their place, how likely they are, and what else is said of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.diagnosis.candidates.following_error import READ_BACK
from twin.diagnosis.judgement.evidence import curve_flaw, evidence
from twin.diagnosis.judgement.in_place import equivalent, measured_next, ruled_out
from twin.diagnosis.judgement.payload_causes import payload_causes
from twin.diagnosis.judgement.reported import reported, unsettled
from twin.diagnosis.judgement.second_opinion import Comparison, SingleEffect, compared, second_opinion
from twin.diagnosis.judgement.sizes import Sized
from twin.diagnosis.problem.pool import Form
from twin.diagnosis.problem.problem import unwhitened
from twin.diagnosis.result import Cause, Next, Quantity
from twin.machine.calibration import Calibration
from twin.machine.effects.waves import APPROACH

AT_BOUND: Final = 0.99


@final
@dataclass(frozen=True, eq=False)
class Judged:
    """The causes as they are reported.

    Attributes:
        sized: the causes that stand, with their sizes.
        causes: all of them, the strongest first.
        next_measurement: points that tell them from what they could be mistaken for.
        notices: what is not named, and why.
        disagree: whether a second method explains the readings otherwise.
    """

    sized: Sized
    causes: tuple[Cause, ...]
    next_measurement: tuple[Next, ...]
    notices: tuple[str, ...]
    disagree: bool


def judged(sized: Sized, calibration: Calibration) -> Judged:
    """Every cause with its doubts.

    Args:
        sized: the causes that stand, with their sizes.
        calibration: the model that was judged.
    """
    found, forms = sized.found, sized.forms
    causes = [_cause(sized, k, calibration) for k in range(len(forms))]
    # Beside patterns the variances hold what a cause can imitate: the likelihood has decided, and no posterior is given.
    comparison = None if found.structure.traces else _compared(sized, causes)
    if comparison is not None:
        causes = [
            # Of a curve that foretells nothing the form is not known, and so not how probable it is.
            replace(cause, probability=own.probability, credible=own.instead or own.credible)
            if cause.promised
            else cause
            for cause, own in zip(causes, comparison.causes, strict=True)
        ]
    also, silent = reported(found.pool, forms)
    causes, loads = payload_causes(found.pool, forms, causes)
    order = sorted(range(len(causes)), key=lambda k: -causes[k].share)
    ordered = [causes[k] for k in order]
    wanted = measured_next(found.beside, [sized.beside[k] for k in order], ordered)
    further = () if comparison is None else comparison.further
    notices = (*silent, *_not_beyond(sized), *(_further(effect) for effect in further), *_fallen(sized))
    disagree = comparison is not None and comparison.disagree
    return Judged(sized, (*ordered, *also, *loads), wanted, notices, disagree)


def _cause(sized: Sized, k: int, calibration: Calibration) -> Cause:
    """One cause: its share beside the other causes, its rivals beside the patterns as well."""
    found, form = sized.found, sized.forms[k]
    others, rest = sized.others(form), [one for one in sized.beside if one is not sized.beside[k]]
    explained = found.pool.scores(others, [form.index])[0, 0]
    doubt, quantities = sized.doubts[k], sized.estimate.quantities[k]
    text = evidence(form, sized.estimate, k) + curve_flaw(found.pool, sized.forms, form, calibration) + doubt
    equal = equivalent(found, sized.beside[k], rest)
    if why := _unsettled(sized, form):
        text, equal = f"{text}; {why}", (*equal, (READ_BACK.name, form.candidate.where))
    return Cause(
        effect=form.candidate.effect,
        where=form.candidate.where,
        origin=form.candidate.origin,
        parameters=quantities,
        p_value=found.pool.chance(sized.log_p(form)),
        share=float(np.clip(explained / sized.excess, 0.0, 1.0)),
        equivalent=equal,
        evidence=text,
        pattern_um=locked(unwhitened(found.problem, sized.estimate.signature[:, k])),
        effects=() if doubt else sized.estimate.effects[k],
        promised=not doubt,
        bounded=_bounded(form, quantities),
        rivals=ruled_out(found.beside, sized.beside[k], rest, sized.excess),
    )


def _unsettled(sized: Sized, form: Form) -> str:
    """Why an effect of the side that an axis came from may be none; empty where nothing speaks against it."""
    where, network = form.candidate.where, sized.found.problem.network
    directed = any(name.startswith(APPROACH) for name in form.candidate.specification.channels(where))
    return unsettled(network.data, network.machine, where) if directed else ""


def _bounded(form: Form, quantities: Sequence[Quantity]) -> bool:
    """Whether a parameter stands where it cannot go further."""
    candidate = form.candidate
    limits = {name: candidate.range(name) for name in candidate.specification.bent}
    if candidate.drift is not None and not candidate.drift.straight:
        # In a straight line: its time constant is beyond the record.
        return not any(q.name == "time_constant" and q.value < AT_BOUND * limits[q.name] for q in quantities)
    return any(abs(q.value) >= AT_BOUND * limits.get(q.name, candidate.largest) for q in quantities)


def _not_beyond(sized: Sized) -> list[str]:
    pool = sized.found.pool
    shares = [100.0 * float(pool.scores(sized.forms, [form.index])[0, 0]) / sized.excess for form in sized.dropped]
    each = [f"{' '.join(form.key)} ({share:.2g} %)" for form, share in zip(sized.dropped, shares, strict=True)]
    text = "not named, for they are not beyond what else is left unexplained (share of the excess): "
    return [text + ", ".join(each)] if each else []


def _fallen(sized: Sized) -> list[str]:
    part = "they carry only a part of a pattern that no known effect explains as a whole"
    few = "with them in the fit the readings left out of it are farther off: too few readings for so many causes"
    return [
        f"not named, for {why}: {', '.join(sorted({' '.join(form.key) for form in forms}))}"
        for why, forms in ((part, sized.found.structure.fallen), (few, sized.found.refuted))
        if forms
    ]


def _compared(sized: Sized, causes: Sequence[Cause]) -> Comparison:
    pairs = zip(sized.forms, causes, strict=True)
    groups = [(form.key, *cause.equivalent, *_variants(form.key)) for form, cause in pairs]
    return compared(second_opinion(sized.found.pool, sized.found.structure.forms), groups)


def _variants(key: tuple[str, str]) -> list[tuple[str, str]]:
    """The same cause with more numbers: a plain reversal is one that changes along the travel by nothing."""
    return [(one.name, key[1]) for one in SPECIFICATIONS.values() if one.more_of == key[0]]


def _further(effect: SingleEffect) -> str:
    names = ", ".join(" ".join(key) for key in effect.credible)
    return (
        f"a second method finds one of {names} as well (odds {np.exp(min(effect.log_odds, 99.0)):.2g} : 1): not named"
    )
