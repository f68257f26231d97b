"""The causes as they are reported: with what could stand in their place, how likely they are, and what else is said of them.

Where the control reported other positions than it was told, the question is which of the two the measurement follows. With s the share
of the difference that shows in the readings, everything else that was found beside it: s = 0, they follow the command, and the report
was taken before the axis had settled (contract §5, ``read_back``); s = 1, the axis stood where the control said, and that is a cause
like any other (``following_error``), sought and paid for with the others.

The payloads that joints were found to give way under are causes of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import normal_sf
from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.diagnosis.candidates.following_error import FOLLOWING_ERROR, READ_BACK
from twin.diagnosis.judgement.evidence import curve_flaw, evidence
from twin.diagnosis.judgement.in_place import equivalent, measured_next, ruled_out
from twin.diagnosis.judgement.second_opinion import Comparison, SingleEffect, compared, second_opinion
from twin.diagnosis.judgement.sizes import Sized
from twin.diagnosis.problem.forms import Candidates, Form, log_p_value
from twin.diagnosis.problem.problem import unwhitened_um
from twin.diagnosis.result import Cause, Next, Quantity, readable_unit
from twin.diagnosis.selection.payload import Load, asked, axis_of_form, weights
from twin.machine.calibration import Calibration
from twin.machine.effects import Payload
from twin.machine.effects.gravity_compliance import PAYLOAD, payloads_of
from twin.machine.effects.payload import SIDES, SOUGHT_MM
from twin.machine.effects.waves import APPROACH
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

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
    also, silent = reported(found.candidates, forms)
    causes, loads = payload_causes(found.candidates, forms, causes)
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
    explained = found.candidates.scores(others, [form.index])[0, 0]
    doubt, quantities = sized.doubts[k], sized.estimate.quantities[k]
    text = evidence(form, sized.estimate, k) + curve_flaw(found.candidates, sized.forms, form, calibration) + doubt
    equal = equivalent(found, sized.beside[k], rest)
    if why := _unsettled(sized, form):
        text, equal = f"{text}; {why}", (*equal, (READ_BACK.name, form.candidate.where))
    return Cause(
        effect=form.candidate.effect,
        where=form.candidate.where,
        origin=form.candidate.origin,
        parameters=quantities,
        p_value=found.candidates.p_value(sized.log_p(form)),
        share=float(np.clip(explained / sized.excess, 0.0, 1.0)),
        equivalent=equal,
        evidence=text,
        pattern_um=locked(unwhitened_um(found.problem, sized.estimate.signature[:, k])),
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
    limits = {name: candidate.range(name) for name in candidate.specification.nonlinear}
    if candidate.drift is not None and not candidate.drift.straight:
        # In a straight line: its time constant is beyond the record.
        return not any(q.name == "time_constant" and q.value < AT_BOUND * limits[q.name] for q in quantities)
    return any(abs(q.value) >= AT_BOUND * limits.get(q.name, candidate.largest) for q in quantities)


def _not_beyond(sized: Sized) -> list[str]:
    candidates = sized.found.candidates
    shares = [
        100.0 * float(candidates.scores(sized.forms, [form.index])[0, 0]) / sized.excess for form in sized.dropped
    ]
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
    return compared(second_opinion(sized.found.candidates, sized.found.structure.forms), groups)


def _variants(key: tuple[str, str]) -> list[tuple[str, str]]:
    """The same cause with more numbers: a plain reversal is one that changes along the travel by nothing."""
    return [(one.name, key[1]) for one in SPECIFICATIONS.values() if one.variant_of == key[0]]


def _further(effect: SingleEffect) -> str:
    names = ", ".join(" ".join(key) for key in effect.credible)
    return (
        f"a second method finds one of {names} as well (odds {np.exp(min(effect.log_odds, 99.0)):.2g} : 1): not named"
    )


FINER: Final = 0.01
"""Least increments by which a position may be off a whole number of them for rounding."""
MOST: Final = 0.5
"""Share of the positions that no control can command, above which they are taken for reported ones."""
RULED_OUT: Final = 5.0
"""Standard uncertainties from one at which the readings do not follow the report: 1 in 10⁶."""
COMPATIBLE: Final = 3.0
"""Standard uncertainties from nothing within which they follow the command."""


def reported(candidates: Candidates, forms: Sequence[Form]) -> tuple[list[Cause], list[str]]:
    """Axes whose reported positions the measurement does not follow, and in words those of which nothing can be said.

    Args:
        candidates: what was tried.
        forms: what was found.
    """
    data, machine = candidates.problem.network.data, candidates.problem.network.machine
    causes, silent = [], []
    tried = [form for form in candidates.forms if form.candidate.specification is FOLLOWING_ERROR and form not in forms]
    for form in tried:
        axis = machine.by_name[form.candidate.where]
        off = largest_off(data, machine.names.index(axis.name))
        text = f"the positions reported for {axis.name} differ from the commands by up to {off:.3g} {axis.unit}"
        columns, values, inverse = candidates.fitted([form, *forms])
        at, scale = int(np.searchsorted(columns, form.columns[0])), form.variant.columns[0].scale
        share, u = float(values[at] * scale), float(scale * np.sqrt(inverse[at, at]))
        if candidates.scan([one for one in forms if one is not form])[1][form.index] == 0 or u == 0.0:
            if candidates.scan([])[1][form.index] > 0:
                silent.append(
                    f"{text}; beside what was found, these data cannot tell which of them the measurement follows"
                )
            continue
        if abs(share - 1.0) > RULED_OUT * u and abs(share) < COMPATIBLE * u:
            causes.append(
                Cause(
                    effect=READ_BACK.name,
                    where=axis.name,
                    origin="instrument",
                    parameters=(Quantity("share", share, "1", u),),
                    p_value=float(min(2.0 * normal_sf(abs(share - 1.0) / u) * len(tried), 1.0)),
                    share=0.0,
                    equivalent=(),
                    evidence=f"{text}, and the measurement follows the commands: they were read before {axis.name} had settled",
                    pattern_um=locked(
                        unwhitened_um(
                            candidates.problem, candidates.problem.signature(form.variant.columns)[:, 0] / scale
                        )
                    ),
                )
            )
        elif abs(share - 1.0) < COMPATIBLE * u and abs(share) < COMPATIBLE * u:
            silent.append(f"{text}; these data cannot tell which of them the measurement follows")
    return causes, silent


def largest_off(data: Measurements, axis: int) -> float:
    """How far the control's report is from its command at most, mm or degrees."""
    return float(np.nanmax(np.abs(data.readback[:, axis] - data.positions[:, axis])))


def unsettled(data: Measurements, machine: Machine, where: str) -> str:
    """Why a reversal of an axis may be none; empty where nothing speaks against it.

    Positions finer than the least increment are no commands. Reported before the axis had settled, they are off by the side it came
    from, as lost motion is.
    """
    axis = machine.by_name.get(where)
    if axis is None or np.any(np.isfinite(data.readback[:, machine.names.index(where)])):
        return ""
    steps = data.positions[:, machine.names.index(where)] / axis.increment
    if np.mean(np.abs(steps - np.round(steps)) > FINER) <= MOST:
        return ""
    return (
        f"the positions of {where} are finer than its least increment, so not as commanded: if they were reported before {where} had "
        f"settled, this is no lost motion; commanded positions with a column readback_{where}_{axis.unit} would settle it"
    )


def payload_causes(
    candidates: Candidates, forms: Sequence[Form], causes: Sequence[Cause]
) -> tuple[list[Cause], list[Cause]]:
    """The causes with what they are uncertain by because the payload is an estimate as well, and the payloads.

    Args:
        candidates: the forms.
        forms: the causes that stand.
        causes: what was said of them as if the payload were known.
    """
    causes, found = list(causes), []
    for side in SIDES:
        load = asked(candidates, forms, side)
        known = (
            () if load is None else payloads_of(axis_of_form(candidates, load.joints[0]), load.joints[0].variant.fixed)
        )
        if load is None or not known:
            continue
        (payload,) = known
        four = load.four(payload)
        at = [forms.index(form) for form in load.joints]
        more, variances = load.covariances(four, np.array([causes[k].parameters[0].u for k in at]))
        _, compliances = load.under(four)
        for k, times, value in zip(at, more.tolist(), compliances.tolist(), strict=True):
            causes[k] = _less_certain(causes[k], times, value * payload.mass_kg, at_bound=_heaviest(load, payload))
        found.append(_load_cause(candidates, load, payload, variances))
    return causes, found


def _heaviest(load: Load, payload: Payload) -> bool:
    """Whether its mass stands at the bound."""
    return payload.mass_kg > AT_BOUND * load.heaviest


def _less_certain(cause: Cause, times: float, product: float, *, at_bound: bool) -> Cause:
    """A compliance as uncertain as the payload makes it; a limit is that of the largest mass: as if it were known."""
    first = cause.parameters[0]
    text = f"{cause.evidence}; compliance times mass of the payload {product:.3g} {readable_unit(first.unit)}·kg"
    if at_bound:
        return replace(cause, evidence=f"{text}, the compliance a lower limit", parameters=(first,), bounded=True)
    return replace(cause, evidence=text, parameters=(replace(first, u=first.u * times),))


def _load_cause(candidates: Candidates, load: Load, payload: Payload, variances: np.ndarray) -> Cause:
    """The payload: what the joints explain with it, more than without."""
    four, nothing = load.four(payload), np.zeros(4)
    explained, compliances = load.under(four)
    own, _ = load.under(nothing)
    log_p = float(log_p_value(np.array(max(explained - own, 0.0)), 4.0, candidates.dof)) + load.joints[0].log_tests
    excess = max(candidates.problem.chi2 - candidates.problem.dof, explained)
    text = f"the {load.side} side carries a mass that the URDF does not have: joints give way under it"
    at_bound = _heaviest(load, payload)
    if at_bound:
        text += (
            f". The mass is at the largest considered ({load.heaviest:.3g} kg): the machine's own weight shows less than "
            "its URDF says, as if the control corrected it; only the products of mass and compliance are known"
        )
    columns = [column for form in load.free for column in form.variant.columns]
    size = np.array([column.scale for column in columns])
    shape = np.kron(compliances, weights(four) - weights(nothing))
    return Cause(
        effect=PAYLOAD.name,
        where=load.side,
        origin="machine",
        parameters=_quantities(payload, np.sqrt(variances), load.heaviest),
        p_value=candidates.p_value(min(log_p, 0.0)),
        share=float(np.clip((explained - own) / excess, 0.0, 1.0)),
        equivalent=(),
        evidence=text,
        pattern_um=locked(unwhitened_um(candidates.problem, (candidates.problem.signature(columns) / size) @ shape)),
        bounded=at_bound,
    )


def _quantities(payload: Payload, u: np.ndarray, heaviest: float) -> tuple[Quantity, ...]:
    units, sizes = ("kg", "mm", "mm", "mm"), (heaviest, *[SOUGHT_MM] * 3)
    return tuple(
        Quantity(name, value, unit, float(own) * size)
        for (name, value), unit, own, size in zip(payload.numbers.items(), units, u, sizes, strict=True)
    )
