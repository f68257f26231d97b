"""The causes as they are reported: with alternatives, probabilities and notices.

If the positions reported by the control differ from the commands, the question is which of the two the readings follow. Let s be the
share of the difference that shows in the readings, fitted jointly with the other causes. s = 0: they follow the command, and the
position was reported before the axis had settled (contract §5, ``read_back``). s = 1: the axis was at the reported position; that is a
cause like any other (``following_error``), tested with the same correction for multiple testing.

Payloads under which joints were found to deflect are causes of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import largest_first, read_only
from twin._common.distributions import f_log_sf, normal_sf
from twin.diagnosis.alternatives import (
    between_positions,
    curve_flaw,
    equivalent,
    evidence,
    points_to_measure,
    ruled_out,
)
from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.diagnosis.candidates.machine import FOLLOWING_ERROR, READ_BACK
from twin.diagnosis.estimate import MANY_ROUNDS, Estimate, estimate, reweighted
from twin.diagnosis.forms import Candidates, Form, log_p_value
from twin.diagnosis.payload import CARRIED_INDEX, CENTRE_PRIOR, Load, axis_of_form, loaded_joints, weights
from twin.diagnosis.problem import in_um
from twin.diagnosis.result import Cause, Next, Quantity, readable_unit
from twin.diagnosis.search import LIMIT_SIGMA, TOO_LARGE
from twin.diagnosis.second_opinion import Comparison, SingleEffect, compare_with_search, second_opinion
from twin.diagnosis.structure import Findings
from twin.identification.discrepancy import Discrepancy
from twin.machine.machine import Machine
from twin.measurement.checks import ASSUMED
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Effect, Payload
from twin.model.effects.base import CENTRE_RANGE_MM, LOAD, SIDES
from twin.model.effects.gravity_compliance import CARRIED_LOAD, PAYLOAD, AddedLoad, payloads_of
from twin.model.effects.harmonic import APPROACH
from twin.numerics.covariance import Covariance


@final
@dataclass(frozen=True, eq=False)
class SizedCauses:
    """The selected causes with their sizes.

    Attributes:
        found: the selected causes and patterns.
        forms: the causes that are significant.
        given_patterns: the same forms with the patterns projected out.
        estimate: their sizes, fitted without the patterns.
        dropped: causes that are not significant against the variation between groups of readings.
        doubts: for each cause, why it is not valid between the measured positions; empty if it is.
        discrepancy: what the causes leave beyond the noise; it is in the weights of their sizes.
    """

    found: Findings
    forms: tuple[Form, ...]
    given_patterns: tuple[Form, ...]
    estimate: Estimate
    dropped: tuple[Form, ...]
    doubts: tuple[str, ...]
    discrepancy: Discrepancy

    @property
    def excess(self) -> float:
        """Return the excess of χ² over its expectation from noise."""
        problem = self.found.problem
        return max(problem.chi2 - problem.dof, self.estimate.explained, 1e-30)

    @property
    def promised(self) -> list[bool]:
        """Return whether each cause is in the extended calibration."""
        return [not doubt for doubt in self.doubts]

    @property
    def effects(self) -> list[Effect]:
        """Return the effects of the promised causes."""
        return [
            one for own, promise in zip(self.estimate.effects, self.promised, strict=True) if promise for one in own
        ]

    @property
    def covariance(self) -> Covariance:
        """Return the covariance of the parameters of `effects`."""
        wanted = {parameter.name for effect in self.effects for parameter in effect.parameters}
        names, matrix = self.estimate.covariance.names, self.estimate.covariance.matrix
        at = [i for i, name in enumerate(names) if name in wanted]
        return Covariance(tuple(names[i] for i in at), read_only(np.array(matrix[np.ix_(at, at)])))

    def others(self, form: Form) -> list[Form]:
        """Return all causes but one."""
        return [one for one in self.forms if one is not form]


def estimate_sizes(found: Findings) -> SizedCauses:
    """Estimate the sizes of the causes, and drop one by one those that groups of readings do not confirm.

    Args:
        found: the selected causes and patterns.
    """
    forms = list(found.structure.forms)
    dropped: list[Form] = []
    while True:
        estimated = estimate(found.problem, forms, found.task.noise.dof, found.structure.random_effects)
        if found.structure.pattern_tests:
            judged = [(_log_p_given_others(found, estimated, forms, form), form) for form in forms]
        else:
            judged = [
                (_log_p_of_groups(against) + form.log_tests, form)
                for form, against in zip(forms, estimated.wald, strict=True)
                if MANY_ROUNDS <= against[2] < np.inf
            ]
        worst = max(judged, key=lambda one: one[0], default=None)
        if worst is None or worst[0] <= np.log(found.candidates.level):
            break
        dropped.append(worst[1])
        forms = [form for form in forms if form is not worst[1]]
    given_patterns = tuple(found.given_patterns.forms[form.index] for form in forms)
    doubts = tuple(between_positions(found.candidates, forms, form) for form in forms)
    sizes, discrepancy = reweighted(found.task, forms, estimated, found.structure.random_effects)
    return SizedCauses(found, tuple(forms), given_patterns, sizes, tuple(dropped), doubts, discrepancy)


def _log_p_given_others(found: Findings, estimated: Estimate, forms: Sequence[Form], form: Form) -> float:
    """Return the log p-value of a cause, corrected for multiple testing, with all unexplained residuals counted as noise."""
    explained, dof, _ = found.candidates.scores([one for one in forms if one is not form], [form.index])[0]
    variance_factor = max((found.problem.chi2 - estimated.explained) / max(found.problem.dof, 1), 1.0)
    chance = log_p_value(np.array(explained / variance_factor), max(float(dof), 1.0), found.candidates.dof)
    return min(float(chance) + form.log_tests, 0.0)


def _log_p_of_groups(against: tuple[float, int, float]) -> float:
    """Return the log p-value of a cause by its Wald statistic (F with the groups' degrees of freedom; Hotelling's T² for one cause)."""
    statistic, width, count = against
    free = count - width
    return float(f_log_sf(statistic / width * free / (count - 1.0), width, free)) if free > 0 else 0.0


# --- The causes as they are reported: with alternatives, probabilities and notices ----------------

IMPOSSIBLE: Final = "; this size is physically impossible, so the readings do not determine it"
AT_BOUND: Final = 0.99
"""Ratio of a parameter to its bound from which on it counts as bounded."""
UNDETERMINED_SHARE: Final = 0.9 / np.sqrt(CENTRE_PRIOR)
"""Standard uncertainty of a coordinate, as a share of its bound, from which on the readings do not determine it: almost the prior's."""


@final
@dataclass(frozen=True, eq=False)
class ReportedCauses:
    """The causes as they are reported.

    Attributes:
        sized: the causes with their sizes.
        causes: all of them, the strongest first.
        next_measurement: points that separate them from their alternatives.
        notices: causes not named, with the reason.
        disagree: whether the second method explains the readings differently.
    """

    sized: SizedCauses
    causes: tuple[Cause, ...]
    next_measurement: tuple[Next, ...]
    notices: tuple[str, ...]
    disagree: bool


def report_causes(sized: SizedCauses, calibration: Calibration) -> ReportedCauses:
    """Return the causes with alternatives, probabilities and notices.

    Args:
        sized: the causes with their sizes.
        calibration: the calibration tested.
    """
    sized = _without_impossible(sized)
    found, forms = sized.found, sized.forms
    # Evaluated first: later steps reset the pool.
    impossible = _impossible_notices(sized)
    causes = [_cause(sized, k, calibration) for k in range(len(forms))]
    # With unnamed patterns the selection was made by likelihood, and no posterior probability is given.
    comparison = None if found.structure.pattern_tests else _second_method(sized, causes)
    if comparison is not None:
        causes = [
            # The form of a curve that does not predict held-out positions is unknown, and so is its probability.
            replace(cause, probability=opinion.probability, credible=opinion.instead or opinion.credible)
            if cause.promised
            else cause
            for cause, opinion in zip(causes, comparison.causes, strict=True)
        ]
    also, silent = readback_causes(found.candidates, forms)
    causes, loads = causes_with_payloads(found.candidates, forms, causes)
    order = largest_first(np.array([cause.share for cause in causes])).tolist()
    ordered = [causes[k] for k in order]
    wanted = points_to_measure(found.given_patterns, [sized.given_patterns[k] for k in order], ordered)
    further = () if comparison is None else comparison.further
    notices = (
        *_assumed_approach(sized),
        *silent,
        *_insignificant_notice(sized),
        *(_further(effect) for effect in further),
        *_rejected_notices(sized),
        *impossible,
    )
    disagree = comparison is not None and comparison.disagree
    return ReportedCauses(sized, (*ordered, *also, *loads), wanted, notices, disagree)


def _without_impossible(sized: SizedCauses) -> SizedCauses:
    """Return the causes, of which none with a size beyond its physical limits is promised.

    The search keeps sizes within their limits, but its last steps and the final weights move them: a mass near zero gives any centre.
    """
    sizes = zip(sized.forms, sized.estimate.quantities, sized.estimate.effects, sized.doubts, strict=True)
    doubts = tuple(
        doubt or (IMPOSSIBLE if _is_impossible(form, estimated, effects) else "")
        for form, estimated, effects, doubt in sizes
    )
    return replace(sized, doubts=doubts)


def _is_impossible(form: Form, quantities: Sequence[Quantity], effects: Sequence[Effect]) -> bool:
    """Return whether a size is beyond its physical limit, or a load is impossible."""
    if any(isinstance(effect, AddedLoad) and not effect.payload.plausible for effect in effects):
        return True
    specification, sizes = form.candidate.specification, _sizes(form, quantities)
    if not all(specification.is_plausible(size.value, size.unit) for size in sizes):
        return True
    return bool(specification.non_negative and sizes and sizes[0].value < -LIMIT_SIGMA * sizes[0].u)


def _sizes(form: Form, quantities: Sequence[Quantity]) -> list[Quantity]:
    """Return the estimated parameters of a cause; in place of the coefficients of a curve its largest value over its domain."""
    space, coefficients = form.candidate.space, [q.value for q in quantities if q.coefficient]
    if space is None or not coefficients:
        return [q for q in quantities if q.name not in form.candidate.specification.fixed]
    values = space.basis.value(space.grid()[0], space.domain, tuple(coefficients))
    return [Quantity("largest", float(np.abs(values).max()), quantities[0].unit, 0.0)]


def _cause(sized: SizedCauses, k: int, calibration: Calibration) -> Cause:
    """Return one cause; its share is relative to the other causes, its rivals also to the patterns."""
    found, form = sized.found, sized.forms[k]
    others, other_forms = (
        sized.others(form),
        [one for one in sized.given_patterns if one is not sized.given_patterns[k]],
    )
    explained = found.candidates.scores(others, [form.index])[0, 0]
    doubt, quantities = sized.doubts[k], sized.estimate.quantities[k]
    text = evidence(form, sized.estimate, k) + curve_flaw(found.candidates, sized.forms, form, calibration)
    text += _fixed_centre(form) + doubt
    equal = equivalent(found, sized.given_patterns[k], other_forms)
    if why := _approach_doubt(sized, form):
        text, equal = f"{text}; {why}", (*equal, (READ_BACK.name, form.candidate.where))
    return Cause(
        effect=form.candidate.effect,
        where=form.candidate.where,
        origin=form.candidate.origin,
        parameters=quantities,
        p_value=found.candidates.p_value(_log_p_given_others(found, sized.estimate, sized.forms, form)),
        share=float(np.clip(explained / sized.excess, 0.0, 1.0)),
        equivalent=equal,
        evidence=text,
        pattern_um=read_only(in_um(found.problem.network, sized.estimate.signature[:, k])),
        effects=() if doubt else sized.estimate.effects[k],
        promised=not doubt,
        bounded=doubt == IMPOSSIBLE or _bounded(form, quantities),
        rivals=ruled_out(found.given_patterns, sized.given_patterns[k], other_forms, sized.excess),
    )


def _fixed_centre(form: Form) -> str:
    """Return that the readings do not determine the centre of a load with the known compliances; empty if they do."""
    if form.candidate.specification not in (PAYLOAD, CARRIED_LOAD) or not form.variant.fixed:
        return ""
    return f"; the readings do not determine its centre of mass: the most likely one within ±{CENTRE_RANGE_MM:g} mm is taken"


def _assumed_approach(sized: SizedCauses) -> list[str]:
    """Return a notice for each axis with an effect of its approach direction that is unknown for some readings."""
    network, notices = sized.found.problem.network, []
    for form in sized.forms:
        for axis in _approach_axes(form):
            if axis not in network.machine.names:
                continue
            unknown = int(np.count_nonzero(network.data.approach[:, network.machine.names.index(axis)] == 0.0))
            if unknown:
                notices.append(
                    f"{ASSUMED}where {APPROACH}{axis} is unknown (0), {axis} is in the middle of its backlash ({unknown} of "
                    f"{len(network.data)} readings); if it was on one side there, the size is wrong by up to a factor of two"
                )
    return list(dict.fromkeys(notices))


def _approach_doubt(sized: SizedCauses, form: Form) -> str:
    """Return why an effect of the approach direction may not exist; empty if there is no doubt."""
    where, network = form.candidate.where, sized.found.problem.network
    return reversal_doubt(network.data, network.machine, where) if _approach_axes(form) else ""


def _approach_axes(form: Form) -> list[str]:
    """Return the axes whose approach direction a form depends on."""
    channels = form.candidate.specification.channels(form.candidate.where)
    return [name.removeprefix(APPROACH) for name in channels if name.startswith(APPROACH)]


def _bounded(form: Form, quantities: Sequence[Quantity]) -> bool:
    """Return whether a parameter is at its bound."""
    candidate, specification = form.candidate, form.candidate.specification
    tried = {name: candidate.range(name) for name in specification.nonlinear}
    drift = candidate.drift
    if drift is not None and not drift.straight:
        # A straight line: the time constant is longer than the record.
        return not any(q.name == drift.name and q.value < AT_BOUND * tried[q.name] for q in quantities)
    return any(
        abs(size.value) >= AT_BOUND * tried.get(size.name, specification.limits.get(size.unit, np.inf))
        for size in _sizes(form, quantities)
    )


def _insignificant_notice(sized: SizedCauses) -> list[str]:
    candidates = sized.found.candidates
    shares = [
        100.0 * float(candidates.scores(sized.forms, [form.index])[0, 0]) / sized.excess for form in sized.dropped
    ]
    each = [f"{' '.join(form.key)} ({share:.2g} %)" for form, share in zip(sized.dropped, shares, strict=True)]
    text = "not named, because not significant against the unexplained residuals (share of the excess): "
    return [text + ", ".join(each)] if each else []


def _rejected_notices(sized: SizedCauses) -> list[str]:
    part = "they explain only part of a pattern that no known effect explains as a whole"
    few = "they increase the residuals of held-out readings: too few readings for this number of causes"
    return [
        _not_named(why, [form.key for form in forms])
        for why, forms in ((part, sized.found.structure.rejected), (few, sized.found.refuted))
        if forms
    ]


def _impossible_notices(sized: SizedCauses) -> list[str]:
    """Return a notice for each reason for which causes were left out although the readings speak for them."""
    by_reason: dict[str, list[tuple[str, str]]] = {}
    named = {form.key for form in sized.forms}
    reasons = sized.found.candidates.impossible | {form.key: TOO_LARGE for form in sized.found.structure.impossible}
    for key, why in reasons.items():
        if key not in named:
            by_reason.setdefault(why, []).append(key)
    return [_not_named(why, keys) for why, keys in by_reason.items()]


def _not_named(why: str, keys: Iterable[tuple[str, str]]) -> str:
    return f"not named, because {why}: {', '.join(sorted({' '.join(key) for key in keys}))}"


def _second_method(sized: SizedCauses, causes: Sequence[Cause]) -> Comparison:
    pairs = zip(sized.forms, causes, strict=True)
    groups = [(form.key, *cause.equivalent, *_variants(form.key)) for form, cause in pairs]
    return compare_with_search(second_opinion(sized.found.candidates, sized.found.structure.forms), groups)


def _variants(key: tuple[str, str]) -> list[tuple[str, str]]:
    """Return the variants of a cause with more parameters, such as ``reversal_curve`` for ``reversal``."""
    return [
        (specification.name, key[1]) for specification in SPECIFICATIONS.values() if specification.variant_of == key[0]
    ]


def _further(effect: SingleEffect) -> str:
    names = ", ".join(" ".join(key) for key in effect.credible)
    return (
        f"not named, but found by the second method: one of {names} (odds {np.exp(min(effect.log_odds, 99.0)):.2g} : 1)"
    )


OFF_GRID_INCREMENTS: Final = 0.01
"""Deviation of a position from a whole number of least increments that is attributed to rounding, in increments."""
OFF_GRID_SHARE: Final = 0.5
"""Share of positions off the grid of least increments above which the positions are taken as reported, not commanded."""
REPORT_RULED_OUT_SIGMA: Final = 5.0
"""Distance of the share from one, in standard uncertainties, at which the readings do not follow the report (p = 10⁻⁶)."""
COMPATIBLE_SIGMA: Final = 3.0
"""Distance of the share from zero, in standard uncertainties, within which the readings follow the command."""


def readback_causes(candidates: Candidates, forms: Sequence[Form]) -> tuple[list[Cause], list[str]]:
    """Return causes for axes whose reported positions the readings do not follow, and notices on undecided axes.

    Args:
        candidates: the forms tested.
        forms: the forms selected.
    """
    data, machine = candidates.problem.network.data, candidates.problem.network.machine
    causes, silent = [], []
    tried = [form for form in candidates.forms if form.candidate.specification is FOLLOWING_ERROR and form not in forms]
    for form in tried:
        axis = machine.by_name[form.candidate.where]
        off = largest_readback_error(data, machine.names.index(axis.name))
        text = f"the positions reported for {axis.name} differ from the commands by up to {off:.3g} {axis.unit}"
        columns, values, inverse = candidates.fitted([form, *forms])
        at, scale = int(np.searchsorted(columns, form.columns[0])), form.variant.columns[0].scale
        share, u = float(values[at] * scale), float(scale * np.sqrt(inverse[at, at]))
        if candidates.scan([one for one in forms if one is not form])[1][form.index] == 0 or u == 0.0:
            if candidates.scan([])[1][form.index] > 0:
                silent.append(
                    f"{text}; given the other causes, these data cannot decide which of the two the readings follow"
                )
            continue
        if abs(share - 1.0) > REPORT_RULED_OUT_SIGMA * u and abs(share) < COMPATIBLE_SIGMA * u:
            causes.append(
                Cause(
                    effect=READ_BACK.name,
                    where=axis.name,
                    origin="instrument",
                    parameters=(Quantity("share", share, "1", u),),
                    p_value=float(min(2.0 * normal_sf(abs(share - 1.0) / u) * len(tried), 1.0)),
                    share=0.0,
                    equivalent=(),
                    evidence=f"{text}, and the readings follow the commands: positions were reported before {axis.name} had settled",
                    pattern_um=read_only(
                        in_um(
                            candidates.problem.network, candidates.problem.signature(form.variant.columns)[:, 0] / scale
                        )
                    ),
                )
            )
        elif abs(share - 1.0) < COMPATIBLE_SIGMA * u and abs(share) < COMPATIBLE_SIGMA * u:
            silent.append(f"{text}; these data cannot decide which of the two the readings follow")
    return causes, silent


def largest_readback_error(data: Measurements, axis: int) -> float:
    """Return the largest difference of reported and commanded position of an axis, mm or degrees."""
    return float(np.nanmax(np.abs(data.readback[:, axis] - data.positions[:, axis])))


def reversal_doubt(data: Measurements, machine: Machine, where: str) -> str:
    """Return why a reversal of an axis may not exist; empty if there is no doubt.

    Positions finer than the least increment cannot be commands. If they were reported before the axis had settled, their error
    depends on the approach direction, as a reversal does.
    """
    axis = machine.by_name.get(where)
    if axis is None or np.any(np.isfinite(data.readback[:, machine.names.index(where)])):
        return ""
    steps = data.positions[:, machine.names.index(where)] / axis.increment
    if np.mean(np.abs(steps - np.round(steps)) > OFF_GRID_INCREMENTS) <= OFF_GRID_SHARE:
        return ""
    return (
        f"the positions of {where} are finer than its least increment, so they are not the commanded ones: if they were reported "
        f"before {where} had settled, this is no reversal; commanded positions with a column readback_{where}_{axis.unit} would decide"
    )


def causes_with_payloads(
    candidates: Candidates, forms: Sequence[Form], causes: Sequence[Cause]
) -> tuple[list[Cause], list[Cause]]:
    """Return the causes with uncertainties that include that of the payloads, and the payloads as causes.

    Args:
        candidates: the forms.
        forms: the forms selected.
        causes: the causes, with uncertainties for exactly known payloads.
    """
    causes, found = list(causes), []
    for side in SIDES:
        load = loaded_joints(candidates, forms, side)
        known = (
            () if load is None else payloads_of(axis_of_form(candidates, load.joints[0]), load.joints[0].variant.fixed)
        )
        if load is None or not known:
            continue
        own = {one.carried: one for one in known}
        payload = own.get(False)
        shares = load.shares_of(payload, own.get(True))
        at = [forms.index(form) for form in load.joints]
        more, variances = load.covariances(shares, np.array([causes[k].parameters[0].u for k in at]))
        _, compliances = load.explained_under(shares)
        for k, times, value in zip(at, more.tolist(), compliances.tolist(), strict=True):
            causes[k] = _less_certain(causes[k], times, value, payload, load)
        found += [_load_cause(candidates, load, one, shares, variances) for one in known]
    return causes, found


def _is_heaviest(load: Load, payload: Payload | None) -> bool:
    """Return whether the mass of a payload is at its bound."""
    return payload is not None and not payload.carried and payload.mass_kg > AT_BOUND * load.heaviest


def _less_certain(cause: Cause, times: float, compliance: float, payload: Payload | None, load: Load) -> Cause:
    """Return a compliance with the uncertainty of the loads included; at the bound of the payload's mass it is a lower limit."""
    first = cause.parameters[0]
    less = replace(cause, parameters=(replace(first, u=first.u * times),))
    if payload is None:
        return less
    product = f"{compliance * payload.mass_kg:.3g} {readable_unit(first.unit)}·kg"
    text = f"{cause.evidence}; compliance times mass of the payload {product}"
    if _is_heaviest(load, payload):
        return replace(cause, evidence=f"{text}, the compliance a lower limit", parameters=(first,), bounded=True)
    return replace(less, evidence=text)


def _load_cause(
    candidates: Candidates, load: Load, payload: Payload, shares: np.ndarray, variances: np.ndarray
) -> Cause:
    """Return a payload or a carried load as a cause: it explains what the joints explain with it and not without."""
    own_shares = slice(CARRIED_INDEX, None) if payload.carried else slice(0, CARRIED_INDEX)
    without = np.array(shares)
    without[own_shares] = 0.0
    explained, compliances = load.explained_under(shares)
    by_others, _ = load.explained_under(without)
    log_p = (
        float(log_p_value(np.array(max(explained - by_others, 0.0)), 4.0, candidates.dof)) + load.joints[0].log_tests
    )
    excess = max(candidates.problem.chi2 - candidates.problem.dof, explained)
    columns = [column for form in load.free for column in form.variant.columns]
    size = np.array([column.scale for column in columns])
    shape = np.kron(compliances, weights(shares) - weights(without))
    specification = CARRIED_LOAD if payload.carried else PAYLOAD
    return Cause(
        effect=specification.name,
        where=load.side,
        origin="machine",
        parameters=_quantities(payload, np.sqrt(variances[own_shares]), load.heaviest),
        p_value=candidates.p_value(min(log_p, 0.0)),
        share=float(np.clip((explained - by_others) / excess, 0.0, 1.0)),
        equivalent=(),
        evidence=_load_evidence(load, payload),
        pattern_um=read_only(in_um(candidates.problem.network, (candidates.problem.signature(columns) / size) @ shape)),
        bounded=_is_heaviest(load, payload),
    )


def _load_evidence(load: Load, payload: Payload) -> str:
    if payload.carried:
        return f"joints of the {load.side} side deflect under the mass in the column {LOAD}"
    text = f"the {load.side} side carries a mass that is not in the URDF: joints deflect under it"
    if not _is_heaviest(load, payload):
        return text
    return (
        f"{text}. The mass is at its upper bound ({load.heaviest:.3g} kg): the effect of the machine's own weight is smaller than the "
        "URDF implies, as if the control corrected it; only the products of mass and compliance are known"
    )


def _quantities(payload: Payload, u: np.ndarray, heaviest: float) -> tuple[Quantity, ...]:
    """Return mass and centre of a payload, or those coordinates of the centre of a carried load that the readings determine."""
    first, largest = ("1", 1.0) if payload.carried else ("kg", heaviest)
    units, sizes = (first, "mm", "mm", "mm"), (largest, *[CENTRE_RANGE_MM] * 3)
    reported = tuple(
        Quantity(name, value, unit, float(deviation) * size)
        for (name, value), unit, deviation, size in zip(payload.numbers.items(), units, u, sizes, strict=True)
    )
    if not payload.carried:
        return reported
    known = [one for one, deviation in zip(reported[1:], u[1:], strict=True) if deviation < UNDETERMINED_SHARE]
    return tuple(known) or reported[:1]
