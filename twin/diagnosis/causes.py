"""The causes as they are reported: with alternatives, probabilities and notices.

If the positions reported by the control differ from the commands, the question is which of the two the readings follow. Let s be the
share of the difference that shows in the readings, fitted jointly with the other causes. s = 0: they follow the command, and the
position was reported before the axis had settled (contract §5, ``read_back``). s = 1: the axis was at the reported position; that is a
cause like any other (``following_error``), tested with the same correction for multiple testing.

Payloads under which joints were found to deflect are causes of their own.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import f_log_sf, normal_sf
from twin._common.messages import Message, Number, joined
from twin._common.records import APPROACH
from twin._common.units import MM, UM
from twin.diagnosis.alternatives import (
    between_positions,
    constants_of_curves,
    curve_flaw,
    equal_orders,
    equivalent,
    evidence,
    follows_a_temperature,
    itself,
    lag_not_excluded,
    rest_on_the_instrument,
    ruled_out,
    together,
    where_measured,
)
from twin.diagnosis.candidates.instrument import ASSUMED_OF_INSTRUMENT, of_a_jumped_side
from twin.diagnosis.candidates.machine import FOLLOWING_ERROR, READ_BACK
from twin.diagnosis.estimate import MANY_ROUNDS, Estimate, estimate, reweighted
from twin.diagnosis.forms import DEVIANCE_RULED_OUT, Candidates, Form, log_p_value
from twin.diagnosis.payload import CARRIED_INDEX, CENTRE_PRIOR, Load, axis_of_form, loaded_joints, weights
from twin.diagnosis.problem import in_um, rewhitened
from twin.diagnosis.result import Cause, Quantity, Unexplained, readable_unit
from twin.diagnosis.search import LIMIT_SIGMA, TOO_LARGE
from twin.diagnosis.second_opinion import (
    CREDIBLE_PROBABILITY,
    Comparison,
    compare_with_search,
    probability_of_any,
)
from twin.diagnosis.structure import Findings
from twin.display.numbers import COVERAGE_FACTOR
from twin.identification.discrepancy import Discrepancy
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Effect, Payload
from twin.model.effects.base import CENTRE_RANGE_MM, LOAD, SEARCHED, SIDES, axis_of
from twin.model.effects.empirical import channel_name
from twin.model.effects.gravity_compliance import CARRIED_LOAD, PAYLOAD, SIDE_NAMES, AddedLoad, payloads_of
from twin.numerics.covariance import Covariance

NEGLIGIBLE_EXCESS: Final = 0.01  # share of the excess below which residuals are no finding: real machines have some
MOST_ALTERNATIVES: Final = 5  # number of alternatives up to which a negligible cause is named
SMALL_EXCESS: Final = 0.02  # share of the excess below which a cause is named only if the second method is certain
NEGLIGIBLE_LEFT, NEGLIGIBLE_CHI2 = 0.02, 36.0
"""Share of the χ² left by all causes, or χ², that all those together may add that are not named although they fit."""


@final
@dataclass(frozen=True, eq=False)
class Indistinct:
    """A small cause that is not named: the readings do not say what it is (more than `MOST_ALTERNATIVES`), or whether it is there."""

    keys: tuple[tuple[str, str], ...]  # the cause, then its alternatives
    probability: float | None  # that one of them is there, where it is not certain
    moved_um: np.ndarray  # (n, 3) on each reading; NaN where no coordinate was measured
    effects: tuple[Effect, ...]


@final
@dataclass(frozen=True, eq=False)
class SizedCauses:
    """The selected causes with their sizes."""

    findings: Findings
    forms: tuple[Form, ...]  # those that are significant
    estimate: Estimate  # fitted without the patterns
    dropped: tuple[Form, ...]  # not significant against the variation between groups of readings
    doubts: tuple[str, ...]  # why each is not promised: not valid between positions, or impossible; empty if it is
    discrepancy: Discrepancy  # what the causes leave beyond the noise, in the weights of their sizes
    indistinct: tuple[Indistinct, ...]  # what is not named, because too many causes fit it

    @property
    def excess(self) -> float:
        """Return the excess of χ² over its expectation from noise."""
        problem = self.findings.problem
        return max(problem.chi2 - problem.dof, self.estimate.explained, 1e-30)

    @cached_property
    def chi2_left(self) -> float:
        """χ² that the causes leave, with the weights of the noise alone."""
        by_noise = self.findings.task.by_noise
        signature = rewhitened(self.estimate.signature.sum(axis=1), self.findings.problem.network, by_noise.network)
        left = by_noise.residual - signature
        return float(left @ by_noise.project(left))

    @cached_property
    def share_left(self) -> float:
        """Share of the excess over measurement noise that the causes leave; 1 without causes."""
        by_noise = self.findings.task.by_noise
        excess = max(by_noise.chi2 - by_noise.dof, by_noise.chi2 - self.chi2_left, 1e-30)
        return float(np.clip((self.chi2_left - by_noise.dof) / excess, 0.0, 1.0)) if self.forms else 1.0

    @cached_property
    def share_of_patterns(self) -> float:
        """Share of the excess that the unnamed patterns explain beside the causes; 0 without patterns."""
        return float(np.clip(self.findings.structure.explained(self.forms) / self.excess, 0.0, 1.0))

    @cached_property
    def shares(self) -> np.ndarray:
        """(k,) share of the excess of each cause: the part that all explain together, divided (`Candidates.divided`).

        Causes, patterns and the rest add up to one.
        """
        divided = self.findings.candidates.divided(self.forms)
        explained = 1.0 - max(self.share_left, self.share_of_patterns)
        return np.asarray(divided * (explained / max(float(divided.sum()), 1e-30)))

    @cached_property
    def temperatures(self) -> tuple[str, ...]:
        """Sensor that each course in time may follow instead (`follows_a_temperature`); empty for other causes."""
        signature = self.estimate.signature
        return tuple(
            follows_a_temperature(self.findings.problem, self.forms, signature, k) for k in range(len(self.forms))
        )

    @property
    def jumped(self) -> Collection[int]:
        """Return the numbers of the displaced targets that are no causes, because their whole side jumped."""
        return [k for k, doubt in enumerate(self.doubts) if doubt == JUMPED]

    @property
    def effects(self) -> list[Effect]:
        """Return the effects of the promised causes."""
        return [
            effect
            for effects, doubt in zip(self.estimate.effects, self.doubts, strict=True)
            if not doubt
            for effect in effects
        ]

    @property
    def covariance(self) -> Covariance:
        """Return the covariance of the parameters of `effects`."""
        wanted = {parameter.name for effect in self.effects for parameter in effect.parameters}
        return self.estimate.covariance.where(lambda name: name in wanted)


def estimate_sizes(findings: Findings) -> SizedCauses:
    """Estimate the sizes of the causes, and drop one by one those that groups of readings do not confirm or that tell nothing."""
    structure = findings.structure
    forms = constants_of_curves(findings.candidates, one_for_each_number(findings.candidates, structure.forms))
    dropped: list[Form] = []
    indistinct: list[Indistinct] = []
    while True:
        estimated = estimate(findings.problem, forms, findings.task.noise.dof, structure.random_effects)
        chi2_left = findings.problem.chi2 - estimated.explained
        if not indistinct:
            most_left = chi2_left + max(NEGLIGIBLE_LEFT * chi2_left, NEGLIGIBLE_CHI2)
        if structure.pattern_tests:
            judged = [(_log_p_given_others(findings, estimated, forms, form), form) for form in forms]
        else:
            judged = [
                (_log_p_of_groups(against) + form.log_tests, form)
                for form, against in zip(forms, estimated.wald, strict=True)
                if MANY_ROUNDS <= against[2] < np.inf
            ]
        log_p, weakest = max(judged, key=lambda pair: pair[0], default=(-np.inf, None))
        if weakest is None or log_p <= np.log(findings.candidates.level):
            weakest, keys, probability = _least_distinct(findings, estimated, forms, most_left - chi2_left)
            if weakest is None:
                break
            k = forms.index(weakest)
            moved_um = in_um(findings.problem.network, estimated.signature[:, k])
            indistinct.append(Indistinct((weakest.key, *keys), probability, moved_um, estimated.effects[k]))
        else:
            dropped.append(weakest)
        forms = [form for form in forms if form is not weakest]
    sizes, discrepancy = reweighted(findings.task, forms, estimated, structure.random_effects)
    network = findings.problem.network
    increment_um = min((axis.increment * MM / UM for axis in network.machine.axes if axis.linear), default=0.0)
    most_um = [np.linalg.norm(np.nan_to_num(in_um(network, own)), axis=1).max(initial=0.0) for own in sizes.signature.T]
    jumped = of_a_jumped_side(network.data, [(form.candidate, form.variant) for form in forms])
    # The search keeps sizes within their limits, but its last steps and the final weights move them: a mass near zero gives any centre.
    doubts = tuple(
        (JUMPED if form.key in jumped else "")
        or (BELOW_INCREMENT if most_um[k] < increment_um else "")
        or between_positions(findings.candidates, forms, form)
        or (IMPOSSIBLE if _is_impossible(form, quantities, effects) else "")
        for k, (form, quantities, effects) in enumerate(zip(forms, sizes.quantities, sizes.effects, strict=True))
    )
    return SizedCauses(findings, tuple(forms), sizes, tuple(dropped), doubts, discrepancy, tuple(indistinct))


def _least_distinct(
    findings: Findings, estimated: Estimate, forms: Sequence[Form], allowed: float
) -> tuple[Form | None, Sequence[tuple[str, str]], float | None]:
    """Return the cause that adds least, of the small ones that are not named, with its alternatives and its probability.

    A false one costs a search and adds its own size to the correction; one that is not named leaves as little. ``allowed``: χ² that it
    may add.
    """
    problem, candidates = findings.problem, findings.candidates
    excess = max(problem.chi2 - problem.dof, estimated.explained)
    rest = {form: [other for other in forms if other is not form] for form in forms}
    added = {form: float(candidates.scores(others, [form.index])[0, 0]) for form, others in rest.items()}
    for form in sorted(forms, key=lambda form: added[form]):
        if added[form] >= min(SMALL_EXCESS * excess, allowed):
            break
        effects, negligible = findings.second_opinion, added[form] < NEGLIGIBLE_EXCESS * excess
        own = itself(findings, form, rest[form])
        certain = not effects or probability_of_any(effects, own) >= CREDIBLE_PROBABILITY
        if certain and not negligible:
            continue
        form_beside, *others_beside = findings.beside_patterns([form, *rest[form]])
        keys = equivalent(findings, form_beside, others_beside)
        if negligible and len(keys) > MOST_ALTERNATIVES:
            return form, keys, None
        probability = probability_of_any(effects, (*own, *keys))
        if not certain and probability < CREDIBLE_PROBABILITY:
            return form, keys, probability
    return None, (), None


def one_for_each_number(candidates: Candidates, forms: Sequence[Form]) -> list[Form]:
    """Return the causes without those that the others already span: a drift of machine and one of a station that are both straight.

    What is one number in the data is one cause, with the other as its alternative (`equivalent`).
    """
    kept = list(forms)
    for form in reversed(forms):
        others = [other for other in kept if other is not form]
        if candidates.contains(others, (), form, remaining=COLLINEAR):
            lost = candidates.explained_by(kept) - candidates.explained_by(others)
            kept = others if lost < DEVIANCE_RULED_OUT else kept
    return kept


def _log_p_given_others(findings: Findings, estimated: Estimate, forms: Sequence[Form], form: Form) -> float:
    """Return the log p-value of a cause, corrected for multiple testing, with all unexplained residuals counted as noise."""
    problem, candidates = findings.problem, findings.candidates
    explained, dof, _ = candidates.scores([other for other in forms if other is not form], [form.index])[0]
    variance_factor = max((problem.chi2 - estimated.explained) / max(problem.dof, 1), 1.0)
    log_p = log_p_value(np.array(explained / variance_factor), max(float(dof), 1.0), candidates.dof)
    return min(float(log_p) + form.log_tests, 0.0)


def _log_p_of_groups(against: tuple[float, int, float]) -> float:
    """Return the log p-value of a cause by its Wald statistic (F with the groups' degrees of freedom; Hotelling's T² for one cause)."""
    statistic, width, count = against
    free = count - width
    return float(f_log_sf(statistic / width * free / (count - 1.0), width, free)) if free > 0 else 0.0


IMPOSSIBLE: Final = Message("; this size is physically impossible, so the readings do not determine it")
BELOW_INCREMENT: Final = Message("; it is below the least increment of the axes, so no command can correct it")
JUMPED: Final = Message("; all targets of its side moved alike")
"""Doubt of a displaced target where its whole side jumped: the jump is unexplained, and its target no cause."""
ONLY_A_PART: Final = Message("they explain only part of a pattern that no known effect explains as a whole")
INSIGNIFICANT: Final = partial(
    Message, "not named, because not significant against the unexplained residuals (share of the excess): {causes}"
)
OVERFITTED: Final = Message(
    "they increase the residuals of held-out readings: too few readings for this number of causes"
)
"""Reasons for which causes are left out, in words."""
AT_BOUND: Final = 0.99  # ratio of a parameter to its bound from which on it counts as bounded
COLLINEAR: Final = 1e-4
"""Share of a cause's squared norm outside the span of the other causes below which it has no number of its own in the data."""
UNDETERMINED_SHARE: Final = 0.9 / np.sqrt(CENTRE_PRIOR)
"""Standard uncertainty of a coordinate, as a share of its bound, from which on the readings do not determine it: almost the prior's."""


def causes_with_alternatives(sized: SizedCauses, calibration: Calibration) -> tuple[list[Cause], Comparison]:
    """Return the causes with alternatives and probabilities, in the order of the forms, and what the second method says of them.

    With unnamed patterns the selection was made by likelihood: no probability is given, and the comparison is empty.
    """
    structure = sized.findings.structure
    machine = np.array([form.candidate.origin == "machine" for form in sized.forms], dtype=bool)
    resting = rest_on_the_instrument(sized.findings.problem, sized.estimate.signature, machine)
    causes = [
        replace(_cause(sized, k, calibration), assumes=ASSUMED_OF_INSTRUMENT if resting[k] else "")
        for k in range(len(sized.forms))
    ]
    if structure.pattern_tests:
        return causes, Comparison()
    groups = [
        (*itself(sized.findings, form, [other for other in sized.forms if other is not form]), *cause.equivalent)
        for form, cause in zip(sized.forms, causes, strict=True)
    ]
    comparison = compare_with_search(sized.findings.second_opinion, groups)
    small = {key for one in sized.indistinct for key in one.keys}
    comparison = replace(
        comparison, further=tuple(e for e in comparison.further if small.isdisjoint((*e.credible, *e.sum_of)))
    )
    return [
        # The form of a curve that does not predict held-out positions is unknown, and so is its probability.
        replace(cause, probability=comparison.probability[k], credible=comparison.instead[k] or comparison.credible[k])
        if cause.promised
        else cause
        for k, cause in enumerate(causes)
    ], comparison


def notices(sized: SizedCauses, comparison: Comparison, undecided: Sequence[Message]) -> tuple[Message, ...]:
    """Return what was assumed, and which causes are not named, with the reason; ``undecided`` are notices of `readback_causes`."""
    candidates, structure = sized.findings.candidates, sized.findings.structure
    shares = [float(candidates.scores(sized.forms, [form.index])[0, 0]) / sized.excess for form in sized.dropped]
    insignificant = [
        Message("{name} ({share:.2g} %)", name=" ".join(form.key), share=100.0 * share)
        for form, share in zip(sized.dropped, shares, strict=True)
    ]
    further = [
        Message(
            "not named, but found by the second method: one of {names} (odds {odds:.2g} : 1)",
            names=", ".join(" ".join(key) for key in effect.credible),
            odds=np.exp(min(effect.log_odds, 99.0)),
        )
        for effect in comparison.further
    ]
    left_out: dict[Message, list[tuple[str, str]]] = {
        ONLY_A_PART: [form.key for form in structure.rejected],
        OVERFITTED: [form.key for form in sized.findings.refuted],
    }
    named = {form.key for form in sized.forms}
    for key, why in (candidates.impossible | {form.key: TOO_LARGE for form in structure.impossible}).items():
        if key not in named:
            left_out.setdefault(why, []).append(key)
    return (
        *_assumed_approach(sized),
        *undecided,
        *([INSIGNIFICANT(causes=joined(", ", insignificant))] if insignificant else []),
        *further,
        *(
            Message(
                "not named, because {why}: {names}", why=why, names=", ".join(sorted({" ".join(key) for key in keys}))
            )
            for why, keys in left_out.items()
            if keys
        ),
    )


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
    """Return one cause; its share is that among the other causes, its rivals are relative to the patterns too."""
    findings, form, network = sized.findings, sized.forms[k], sized.findings.problem.network
    candidates = findings.candidates
    others = [other for other in sized.forms if other is not form]
    form_beside, *others_beside = findings.beside_patterns([form, *others])
    doubt, quantities = sized.doubts[k], sized.estimate.quantities[k]
    text = evidence(form, sized.estimate, k) + curve_flaw(candidates, sized.forms, form, calibration)
    if form.candidate.specification in (PAYLOAD, CARRIED_LOAD) and form.variant.fixed:
        text += Message(
            "; the readings do not determine its centre of mass: the most likely one within ±{range:g} mm is taken",
            range=CENTRE_RANGE_MM,
        )
    text += equal_orders(candidates, sized.forms, form) + lag_not_excluded(candidates, form, others)
    text += where_measured(candidates, sized.forms, form) + doubt
    if sized.temperatures[k]:
        text += Message(
            "; a smooth function of the temperature of {sensor}, not in proportion to it, fits as well: until it is measured in "
            "another course of temperatures (after a pause, or while the machine cools), it is known for this course only",
            sensor=sized.temperatures[k],
        )
    groups = () if findings.structure.pattern_tests else together(candidates, form, others)
    equal = tuple(dict.fromkeys([*equivalent(findings, form_beside, others_beside), *chain.from_iterable(groups)]))
    why = reversal_doubt(network.data, network.machine, form.candidate.where) if _approach_axes(form) else ""
    if why:
        text, equal = f"{text}; {why}", (*equal, (READ_BACK.name, form.candidate.where))
    return Cause(
        effect=form.candidate.effect,
        where=form.candidate.where,
        origin=form.candidate.origin,
        parameters=quantities,
        p_value=candidates.p_value(_log_p_given_others(findings, sized.estimate, sized.forms, form)),
        share=float(sized.shares[k]),
        equivalent=equal,
        together=groups,
        evidence=text,
        pattern_um=read_only(in_um(network, sized.estimate.signature[:, k])),
        effects=() if doubt else sized.estimate.effects[k],
        promised=not doubt,
        bounded=doubt == IMPOSSIBLE or _bounded(form, quantities),
        below_increment=doubt == BELOW_INCREMENT,
        rivals=ruled_out(findings.given_patterns, form_beside, others_beside, float(sized.shares[k])),
    )


def _assumed_approach(sized: SizedCauses) -> list[Message]:
    """Return a notice for each axis with an effect of its approach direction that is unknown for some readings."""
    network, assumed = sized.findings.problem.network, []
    for form in sized.forms:
        for axis in _approach_axes(form):
            if axis not in network.machine.names:
                continue
            unknown = int(np.count_nonzero(network.data.approach[:, network.machine.names.index(axis)] == 0.0))
            if unknown:
                assumed.append(
                    Message(
                        "assumed: where {column}{axis} is unknown (0), {axis} is in the middle of its backlash ({unknown} of "
                        "{count} readings); if it was on one side there, the size is wrong by up to a factor of two",
                        column=APPROACH,
                        axis=axis,
                        unknown=unknown,
                        count=len(network.data),
                    )
                )
    return list(dict.fromkeys(assumed))


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


OFF_GRID_INCREMENTS: Final = 0.01
"""Deviation of a position from a whole number of least increments that is attributed to rounding, in increments."""
OFF_GRID_SHARE: Final = 0.5
"""Share of positions off the grid of least increments above which the positions are taken as reported, not commanded."""
REPORT_RULED_OUT_SIGMA: Final = 5.0
"""Distance of the share from one, in standard uncertainties, at which the readings do not follow the report (p = 10⁻⁶)."""
COMPATIBLE_SIGMA: Final = 3.0  # standard uncertainties of the share from zero within which readings follow the command


def readback_causes(candidates: Candidates, forms: Sequence[Form]) -> tuple[list[Cause], list[Message]]:
    """Return causes for axes whose reported positions the readings do not follow, and notices on undecided axes."""
    data, machine = candidates.problem.network.data, candidates.problem.network.machine
    causes, silent = list[Cause](), list[Message]()
    tried = [form for form in candidates.forms if form.candidate.specification is FOLLOWING_ERROR and form not in forms]
    for form in tried:
        axis = machine.by_name[form.candidate.where]
        i = machine.names.index(axis.name)
        off = float(np.nanmax(np.abs(data.readback[:, i] - data.positions[:, i])))
        text = Message(
            "the positions reported for {name} differ from the commands by up to {off:.3g} {unit}",
            name=axis.name,
            off=off,
            unit=axis.unit,
        )
        columns, values, inverse = candidates.fitted([form, *forms])
        at, scale = int(np.searchsorted(columns, form.columns[0])), form.variant.columns[0].scale
        share, u = float(values[at] * scale), float(scale * np.sqrt(inverse[at, at]))
        if candidates.scan([other for other in forms if other is not form])[1][form.index] == 0 or u == 0.0:
            if candidates.scan([])[1][form.index] > 0:
                silent.append(
                    Message(
                        "{text}; given the other causes, these data cannot decide which of the two the readings follow",
                        text=text,
                    )
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
                    evidence=Message(
                        "{text}, and the readings follow the commands: positions were reported before {name} had "
                        "settled",
                        text=text,
                        name=axis.name,
                    ),
                    pattern_um=read_only(
                        in_um(
                            candidates.problem.network, candidates.problem.signature(form.variant.columns)[:, 0] / scale
                        )
                    ),
                )
            )
        elif abs(share - 1.0) < COMPATIBLE_SIGMA * u and abs(share) < COMPATIBLE_SIGMA * u:
            silent.append(Message("{text}; these data cannot decide which of the two the readings follow", text=text))
    return causes, silent


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
    return Message(
        "the positions of {where} are finer than its least increment, so they are not the commanded ones: if they "
        "were reported before {where} had settled, this is no reversal; commanded positions with a column "
        "readback_{where}_{unit} would decide",
        where=where,
        unit=axis.unit,
    )


def causes_with_payloads(
    candidates: Candidates, forms: Sequence[Form], causes: Sequence[Cause]
) -> tuple[list[Cause], list[Cause]]:
    """Return the causes with uncertainties that include that of the payloads, and the payloads as causes."""
    causes, load_causes = list(causes), []
    for side in SIDES:
        load = loaded_joints(candidates, forms, side)
        known = (
            () if load is None else payloads_of(axis_of_form(candidates, load.joints[0]), load.joints[0].variant.fixed)
        )
        if load is None or not known:
            continue
        by_kind = {payload.carried: payload for payload in known}
        shares = load.shares_of(by_kind.get(False), by_kind.get(True))
        at = [forms.index(form) for form in load.joints]
        factors, variances = load.covariances(shares, np.array([causes[k].parameters[0].u for k in at]))
        _, compliances = load.explained_under(shares)
        loads = [_load_cause(candidates, load, payload, shares, variances) for payload in known]
        # The loads take their share from that of the joints: all of it at most.
        by_joints, by_loads = sum(causes[k].share for k in at), sum(cause.share for cause in loads)
        load_causes += [replace(one, share=one.share * by_joints / max(by_loads, 1.0)) for one in loads]
        for k, factor, compliance in zip(at, factors.tolist(), compliances.tolist(), strict=True):
            less = replace(causes[k], share=causes[k].share * max(1.0 - by_loads, 0.0))
            causes[k] = _less_certain(less, factor, compliance, by_kind.get(False), load)
    return causes, load_causes


def _is_no_mass(load: Load, payload: Payload | None) -> bool:
    """Return whether a payload is heavier than the moving parts; only a ratio is known then (`payload_entries`)."""
    return payload is not None and not payload.carried and payload.mass_kg > load.heaviest / SEARCHED


def _less_certain(cause: Cause, times: float, compliance: float, payload: Payload | None, load: Load) -> Cause:
    """Return a compliance with the uncertainty of the loads included; if the payload is no mass it is a lower limit."""
    first = cause.parameters[0]
    less = replace(cause, parameters=(replace(first, u=first.u * times),))
    if payload is None:
        return less
    product = Number(f"{compliance * payload.mass_kg:.3g} {readable_unit(first.unit)}·kg")
    text = Message(
        "{evidence}; compliance times mass of the payload {product}", evidence=cause.evidence, product=product
    )
    if _is_no_mass(load, payload):
        return replace(
            cause,
            evidence=Message("{text}, the compliance a lower limit", text=text),
            parameters=(first,),
            bounded=True,
        )
    return replace(less, evidence=text)


def _load_cause(
    candidates: Candidates, load: Load, payload: Payload, shares: np.ndarray, variances: np.ndarray
) -> Cause:
    """Return a payload or a carried load as a cause; its share is that of the χ² of the joints that is not explained without it."""
    own_shares = slice(CARRIED_INDEX, None) if payload.carried else slice(0, CARRIED_INDEX)
    without = np.array(shares)
    without[own_shares] = 0.0
    explained, compliances = load.explained_under(shares)
    by_others, _ = load.explained_under(without)
    log_p = (
        float(log_p_value(np.array(max(explained - by_others, 0.0)), 4.0, candidates.dof)) + load.joints[0].log_tests
    )
    columns = [column for form in load.free for column in form.variant.columns]
    size = np.array([column.scale for column in columns])
    shape = np.kron(compliances, weights(shares) - weights(without))
    specification, no_mass = CARRIED_LOAD if payload.carried else PAYLOAD, _is_no_mass(load, payload)
    text = Message(
        "the {side} side carries a mass that is not in the URDF: joints deflect under it", side=SIDE_NAMES[load.side]
    )
    if payload.carried:
        text = Message(
            "joints of the {side} side deflect under the mass in the column {column}",
            side=SIDE_NAMES[load.side],
            column=LOAD,
        )
    elif no_mass:
        text += Message(
            ". The readings do not determine the mass: the effect of the machine's own weight is smaller than the "
            "URDF implies, as if the control corrected it; only the products of mass and compliance are known, and "
            "compensation holds for this load alone"
        )
    quantities = _quantities(payload, np.sqrt(variances[own_shares]), load.heaviest)
    if not payload.carried:
        unknown = [name for name in payload.numbers if name not in {q.name for q in quantities}]
        if no_mass and unknown[1:]:
            text += Message("; nor {names}", names=", ".join(unknown[1:]))
        elif unknown and not no_mass:
            text += Message(
                ". The readings do not determine {names}; the most likely values are in the calibration",
                names=", ".join(unknown),
            )
    return Cause(
        effect=specification.name,
        where=load.side,
        origin="machine",
        parameters=quantities,
        p_value=candidates.p_value(min(log_p, 0.0)),
        share=float(np.clip((explained - by_others) / max(explained, 1e-30), 0.0, 1.0)),
        equivalent=(),
        evidence=text,
        pattern_um=read_only(in_um(candidates.problem.network, (candidates.problem.signature(columns) / size) @ shape)),
        bounded=no_mass,
    )


def _quantities(payload: Payload, u: np.ndarray, heaviest: float) -> tuple[Quantity, ...]:
    """Return those of mass and centre of a load that the readings determine; of a carried load its ratio, if no others.

    A mass whose 95 % interval reaches beyond its physical range is the prior's, not that of the readings.
    """
    first, largest = ("1", 1.0) if payload.carried else ("kg", heaviest)
    units, sizes = (first, "mm", "mm", "mm"), (largest, *[CENTRE_RANGE_MM] * 3)
    mass, *centre = (
        Quantity(name, value, unit, float(deviation) * size)
        for (name, value), unit, deviation, size in zip(payload.numbers.items(), units, u, sizes, strict=True)
    )
    determined = [q for q, deviation in zip(centre, u[1:], strict=True) if deviation < UNDETERMINED_SHARE]
    if payload.carried:
        return tuple(determined) or (mass,)
    inside = COVERAGE_FACTOR * mass.u < min(mass.value, heaviest / SEARCHED - mass.value)
    return (*([mass] if inside else []), *determined)


def misshapen(sized: SizedCauses, unexplained: Unexplained | None) -> bool:
    """Return whether a course in time leaves a pattern in time of its axis although temperatures were read.

    Such a course stands for a temperature: the error then follows none of them in a known form, and the course will not come again.
    """
    temperatures = {f"T_{name}_degC" for name in sized.findings.problem.network.data.temperature_degC}
    axes = {
        axis_of(form.candidate.where)
        for form in sized.forms
        if form.candidate.origin == "machine" and form.candidate.drift is not None
    }
    if unexplained is None or unexplained.share <= NEGLIGIBLE_EXCESS or not temperatures:
        return False
    for names in (unexplained.depends_on, *unexplained.or_on):
        left = {channel_name(name) for name in names if name not in {"time_s", "round", *temperatures}}
        if len(left) < len(names) and any(left <= {axis} for axis in axes):
            return True
    return False
