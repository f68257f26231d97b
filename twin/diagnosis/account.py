"""From a set of causes to an answer: sizes, doubts, what is left, what modelling it gains, what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_sf, f_log_sf, f_sf
from twin._common.units import UM
from twin.diagnosis.absorbed import looks_like
from twin.diagnosis.candidates.candidate import Catalogue
from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.diagnosis.candidates.following_error import READ_BACK
from twin.diagnosis.estimate import Estimate, estimate
from twin.diagnosis.evidence import between_positions, curve_flaw, evidence
from twin.diagnosis.extend import Extended, extend
from twin.diagnosis.gain import at_tool, held_out, of_file, plain, rms, tool_mm, unwhitened
from twin.diagnosis.misfit import MANY
from twin.diagnosis.next_points import next_points
from twin.diagnosis.noise import Scatter
from twin.diagnosis.payload import payload_causes
from twin.diagnosis.pool import DOUBT, Form, Pool, log_chance
from twin.diagnosis.problem import Problem
from twin.diagnosis.reported import reported, unsettled
from twin.diagnosis.result import Cause, Diagnosis, Gain, Quantity, Rival, Trend, Unexplained, Verdict
from twin.diagnosis.search import excessive
from twin.diagnosis.second_opinion import Comparison, SingleEffect, compared, second_opinion
from twin.diagnosis.structure import Findings
from twin.diagnosis.unnamed import Trace, scan
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.machine.effects.waves import APPROACH
from twin.numerics.covariance import Covariance

SEEN_AT: Final = 0.05
"""Chance below which a column is said to go with the misfit."""
LARGE: Final = 1e-4
SMALL: Final = 0.01
"""Share of the excess below which what is left beside causes is noted, and no finding: real machines have some everywhere."""
MOSTLY_EXPLAINED: Final = 0.1
"""Share of the excess that causes may leave and still count as the explanation."""
AT_BOUND: Final = 0.99
RANKED: Final = 12
RIVALS: Final = 2
"""Rivals of a cause for which points are suggested."""
RUNNERS_UP: Final = 2
"""Causes ruled out in a cause's place that are listed with it."""


def account(found: Findings, calibration: Calibration, *, empirical: bool = False) -> Diagnosis:
    """The whole answer.

    Args:
        found: the causes that stand, and the patterns beside them.
        calibration: the model that was judged.
        empirical: whether what is left unexplained extends the calibration as well.
    """
    problem, pool, scatter = found.problem, found.pool, found.scatter
    forms, estimated, dropped = _sized(found)
    beside = [found.beside.forms[form.index] for form in forms]
    excess = max(problem.chi2 - problem.dof, estimated.explained, 1e-30)
    doubts = [between_positions(pool, forms, form) for form in forms]
    promised = [not doubt for doubt in doubts]
    causes = [_cause(found, beside, forms, estimated, k, excess, calibration, doubts[k]) for k in range(len(forms))]
    # Beside patterns the variances hold what a cause can imitate: the likelihood has decided, and no posterior is given.
    comparison = None if found.structure.traces else _compared(found, forms, causes)
    if comparison is not None:
        causes = [
            # Of a curve that foretells nothing the form is not known, and so not how probable it is.
            replace(cause, probability=own.probability, credible=own.instead or own.credible)
            if cause.promised
            else cause
            for cause, own in zip(causes, comparison.causes, strict=True)
        ]
    also, silent = reported(pool, forms, lambda moved: unwhitened(problem, moved))
    silent += _not_beyond(pool, forms, dropped, excess)
    silent += [_further(effect) for effect in (() if comparison is None else comparison.further)]
    silent += _unnamed(
        "they carry only a part of a pattern that no known effect explains as a whole", found.structure.fallen
    )
    silent += _unnamed(
        "with them in the fit the readings left out of it are farther off: too few readings for so many causes",
        found.refuted,
    )
    causes, loads = payload_causes(pool, forms, causes, lambda moved: unwhitened(problem, moved))
    also += loads
    order = sorted(range(len(causes)), key=lambda k: -causes[k].share)
    named = [beside[k] for k in order]
    ordered = [causes[k] for k in order]
    p_value = _p_value(problem, scatter)
    left = _unexplained(found, forms, estimated, excess, p_value)
    effects = [effect for k, effects in enumerate(estimated.effects) if promised[k] for effect in effects]
    covariance = _covariance(estimated, effects)
    unnamed = extend(found, forms, estimated, calibration) if empirical and left is not None else None
    if left is not None and unnamed is not None:
        left = replace(left, extension=unnamed.extension)
        effects += unnamed.effects
        # Independent: the causes' covariance already holds what the patterns can do to them.
        covariance = Covariance.of_blocks([covariance, unnamed.covariance])
    source = "extended by twin diagnose from " + problem.network.data.source
    extended = (
        calibration.extended(effects, covariance, source, simulated=problem.network.data.simulated)
        if effects
        else calibration
    )
    instrument = estimated.signature[:, [not own for own in estimated.effects]].sum(axis=1)
    residual = unwhitened(problem, problem.residual)
    after = of_file(problem, extended, instrument) if forms or effects else residual
    hidden = _unidentifiable(problem, pool, found.known)
    weights, read = problem.network.whitening, problem.network.read
    return Diagnosis(
        verdict=_verdict([*ordered, *also], left, comparison is not None and comparison.disagree),
        rms_um=rms(residual, read),
        absorbed_rms_um=rms(unwhitened(problem, problem.projected), read),
        expected_rms_um=_expected(problem),
        points=len(problem.network.data),
        dof=problem.dof,
        p_value=min([p_value, *(cause.p_value for cause in causes), *_chances(found.structure.traces)]),
        causes=(*ordered, *also),
        unexplained=left,
        unidentifiable=tuple(hidden),
        looks_like=MappingProxyType(hidden),
        not_evaluated=found.known.not_evaluated,
        next_measurement=_next(found.beside, named, ordered),
        trends=_trends(found),
        ranking=_ranking(pool),
        # Last: it puts the pool back to what was tried.
        gain=_gain(found, forms, estimated, promised, (residual, after), left, unnamed) if forms or effects else None,
        tried=len(found.known.candidates),
        scatter=scatter.source,
        calibration=calibration,
        extended=extended,
        data=replace(problem.network.data, notices=(*problem.network.data.notices, *silent)),
        residual_um=locked(residual),
        after_um=locked(after),
        directions=locked(plain(problem, problem.view.by_base)),
        precision=locked(np.einsum("nki,nkj->nij", weights, weights) * UM**2),
    )


def _sized(found: Findings) -> tuple[list[Form], Estimate, list[Form]]:
    """The causes with their sizes, fitted without the patterns, and those that are not beyond what differs from group to group."""
    forms = list(found.structure.forms)
    dropped: list[Form] = []
    while True:
        estimated = estimate(found.problem, forms, found.scatter.dof, found.structure.beside)
        if found.structure.traces:
            judged = [(_log_p_beside(found, estimated, forms, form), form) for form in forms]
        else:
            judged = [
                (_log_p(against) + form.price, form)
                for form, against in zip(forms, estimated.against, strict=True)
                if MANY <= against[2] < np.inf
            ]
        worst = max(judged, key=lambda one: one[0], default=None)
        if worst is None or worst[0] <= np.log(found.pool.level):
            return forms, estimated, dropped
        dropped.append(worst[1])
        forms = [form for form in forms if form is not worst[1]]


def _cause(
    found: Findings,
    beside: Sequence[Form],
    forms: Sequence[Form],
    estimated: Estimate,
    k: int,
    excess: float,
    calibration: Calibration,
    doubt: str,
) -> Cause:
    """One cause: its share beside the other causes, its rivals beside the patterns as well."""
    form, others = forms[k], [one for one in forms if one is not forms[k]]
    explained = found.pool.scores(others, [form.index])[0, 0]
    log_p = _log_p_beside(found, estimated, forms, form)
    pool, rest = found.beside, [one for one in beside if one is not beside[k]]
    text = evidence(form, estimated, k) + curve_flaw(found.pool, forms, form, calibration) + doubt
    equal = equivalent(found, beside[k], rest)
    if _directed(form) and (why := _unsettled(found, form)):
        text, equal = f"{text}; {why}", (*equal, (READ_BACK.name, form.candidate.where))
    quantities = estimated.quantities[k]
    return Cause(
        effect=form.candidate.effect,
        where=form.candidate.where,
        origin=form.candidate.origin,
        parameters=quantities,
        p_value=found.pool.chance(log_p),
        share=float(np.clip(explained / excess, 0.0, 1.0)),
        equivalent=equal,
        evidence=text,
        pattern_um=locked(unwhitened(found.problem, estimated.signature[:, k])),
        effects=() if doubt else estimated.effects[k],
        promised=not doubt,
        bounded=_bounded(form, quantities),
        rivals=_rivals(pool, beside[k], rest, excess),
    )


def _directed(form: Form) -> bool:
    """Whether it is an effect of the side that an axis came from."""
    return any(name.startswith(APPROACH) for name in form.candidate.specification.channels(form.candidate.where))


def _unsettled(found: Findings, form: Form) -> str:
    return unsettled(found.problem.network.data, found.problem.network.machine, form.candidate.where)


def _bounded(form: Form, quantities: Sequence[Quantity]) -> bool:
    """Whether a parameter stands where it cannot go further."""
    candidate = form.candidate
    limits = {name: candidate.range(name) for name in candidate.specification.bent}
    if candidate.drift is not None and not candidate.drift.straight:
        # In a straight line: its time constant is beyond the record.
        return not any(q.name == "time_constant" and q.value < AT_BOUND * limits[q.name] for q in quantities)
    return any(abs(q.value) >= AT_BOUND * limits.get(q.name, candidate.largest) for q in quantities)


def _log_p_beside(found: Findings, estimated: Estimate, forms: Sequence[Form], form: Form) -> float:
    """Log of a cause's chance, its price paid, where all that causes leave counts as scatter, be it a pattern or not."""
    explained, dof, _ = found.pool.scores([one for one in forms if one is not form], [form.index])[0]
    left = max((found.problem.chi2 - estimated.explained) / max(found.problem.dof, 1), 1.0)
    chance = log_chance(np.array(explained / left), max(float(dof), 1.0), found.pool.dof)
    return min(float(chance) + form.price, 0.0)


def _log_p(against: tuple[float, int, float]) -> float:
    """Of a cause that is not there, by its Wald statistic (F with the groups' degrees of freedom, Hotelling's T² with one cause)."""
    statistic, width, count = against
    free = count - width
    return float(f_log_sf(statistic / width * free / (count - 1.0), width, free)) if free > 0 else 0.0


def _not_beyond(pool: Pool, forms: Sequence[Form], dropped: Sequence[Form], excess: float) -> list[str]:
    shares = [100.0 * float(pool.scores(forms, [form.index])[0, 0]) / excess for form in dropped]
    each = [f"{' '.join(form.key)} ({share:.2g} %)" for form, share in zip(dropped, shares, strict=True)]
    text = "not named, for they are not beyond what else is left unexplained (share of the excess): "
    return [text + ", ".join(each)] if each else []


def _unnamed(why: str, forms: Sequence[Form]) -> list[str]:
    return [f"not named, for {why}: {', '.join(sorted({' '.join(form.key) for form in forms}))}"] if forms else []


def _covariance(estimated: Estimate, effects: Sequence[Effect]) -> Covariance:
    """Of the parameters of some effects."""
    wanted = {parameter.name for effect in effects for parameter in effect.parameters}
    names = estimated.covariance.names
    at = [i for i, name in enumerate(names) if name in wanted]
    return Covariance(tuple(names[i] for i in at), locked(np.array(estimated.covariance.matrix[np.ix_(at, at)])))


def _compared(found: Findings, forms: Sequence[Form], causes: Sequence[Cause]) -> Comparison:
    groups = [(form.key, *cause.equivalent, *_variants(form.key)) for form, cause in zip(forms, causes, strict=True)]
    return compared(second_opinion(found.pool, found.structure.forms), groups)


def _variants(key: tuple[str, str]) -> list[tuple[str, str]]:
    """The same cause with more numbers: a plain reversal is one that changes along the travel by nothing."""
    return [(one.name, key[1]) for one in SPECIFICATIONS.values() if one.more_of == key[0]]


def _further(effect: SingleEffect) -> str:
    names = ", ".join(" ".join(key) for key in effect.credible)
    return (
        f"a second method finds one of {names} as well (odds {np.exp(min(effect.log_odds, 99.0)):.2g} : 1): not named"
    )


def _verdict(causes: Sequence[Cause], left: Unexplained | None, disagree: bool) -> Verdict:
    if left is not None and left.share > MOSTLY_EXPLAINED:
        return "unexplained"
    if not causes:
        return "ambiguous" if disagree else "consistent"
    return "ambiguous" if disagree or any(cause.equivalent for cause in causes) else "explained"


def _unexplained(
    found: Findings, forms: Sequence[Form], estimated: Estimate, excess: float, p_value: float
) -> Unexplained | None:
    """What the causes leave: the patterns, or more scatter than stated."""
    problem, structure = found.problem, found.structure
    if structure.traces:
        patterns_um = unwhitened(problem, structure.pattern(forms))
        share = float(np.clip(structure.explained(forms) / excess, 0.0, 1.0))
        columns = tuple(dict.fromkeys(name for trace in structure.traces for name in trace.pattern.names))
        sides = {trace.pattern.side for trace in structure.traces}
        carrier = sides.pop() if len(sides) == 1 else "both"
        size = float(np.sqrt(np.nansum(patterns_um**2) / max(np.count_nonzero(problem.network.read), 1)))
        text = (
            f"a pattern that goes with {' and '.join(columns)} on the {carrier} side, {size:.2g} µm RMS a coordinate, "
            f"{100 * share:.2g} % of the excess, fits no effect that is known here"
        )
        return Unexplained(share, columns, carrier, text, size)
    after = problem.chi2 - estimated.explained
    share = float((after - problem.dof) / excess) if forms else 1.0
    more = _p_value(problem, found.scatter, after, len(forms)) if forms else p_value
    if more >= LARGE or (forms and share <= SMALL):
        return None
    size = float(np.sqrt(max(after / problem.dof - 1.0, 0.0))) * _expected(problem)
    what = "more scatter than stated" + (" is left" if forms else "")
    return Unexplained(share, (), "both", f"{what}, without any pattern in the columns given", size)


def _chances(traces: Sequence[Trace]) -> list[float]:
    return [float(np.exp(trace.log_paid)) for trace in traces]


def _trends(found: Findings) -> tuple[Trend, ...]:
    """Columns the misfit goes with, one by one, before any cause is taken out."""
    single = [pattern for pattern in found.patterns if len(pattern.channels) == 1]
    best: dict[tuple[str, str], Trace] = {}
    for trace in scan(found.problem, [one for one in single if one.field == "base"], (), found.scatter.dof):
        best.setdefault((trace.pattern.side, trace.pattern.names[0]), trace)
    return tuple(
        Trend(column, side, trace.explained, float(np.exp(trace.log_paid)))
        for (side, column), trace in best.items()
        if trace.log_paid < np.log(SEEN_AT)
    )


def _gain(
    found: Findings,
    forms: Sequence[Form],
    estimated: Estimate,
    promised: Sequence[bool],
    residuals: tuple[np.ndarray, np.ndarray],
    left: Unexplained | None,
    unnamed: Extended | None,
) -> Gain:
    network = found.problem.network
    barred = {form.key for form, own in zip(forms, promised, strict=True) if not own}
    held = held_out(found, forms, barred, () if unnamed is None else unnamed.written)
    effects = [effect for own, promise in zip(estimated.effects, promised, strict=True) if promise for effect in own]
    covariance = _covariance(estimated, effects)
    # What is not in the file stays: curves that are not promised, and what no effect in it explains.
    stays = [
        float(np.nansum(unwhitened(found.problem, estimated.signature[:, k]) ** 2) / len(network.data))
        for k, own in enumerate(promised)
        if not own
    ]
    size = 0.0 if left is None or not left.depends_on else left.size_um
    unseen = 0.0
    if unnamed is not None and unnamed.effects:
        effects += unnamed.effects
        covariance, size = Covariance.of_blocks([covariance, unnamed.covariance]), unnamed.left_um
        # As far as it is not known it is in the machine as well: what is most likely is smaller than what is.
        unseen = at_tool(network.data, network.machine, unnamed.effects, unnamed.covariance)[1]
    moved, doubt = at_tool(network.data, network.machine, effects, covariance)
    rest = sum(stays) + 3.0 * size**2
    before, after = residuals
    return Gain(
        rms(before, network.read),
        rms(after, network.read),
        held,
        float(np.sqrt(moved**2 + unseen**2 + rest)),
        float(np.sqrt(doubt**2 + rest)),
        tool_mm(network.machine),
    )


def equivalent(found: Findings, form: Form, others: Sequence[Form]) -> tuple[tuple[str, str], ...]:
    """What could stand in a cause's place, the others kept, without the data objecting.

    Beside patterns much fits that would leave the patterns more to do: what a cause carries more than another, all patterns aside, may
    be no more than what the patterns are.

    Args:
        found: causes and patterns.
        form: the cause, of ``found.beside``.
        others: the other causes, likewise.
    """
    keys = _in_place(found.beside, form, others)
    if not found.structure.traces or not keys:
        return keys
    plain = found.pool
    kept = [plain.forms[one.index] for one in others]
    explained, _ = plain.scan(kept)
    own = float(explained[form.index])
    allowed = found.structure.explained([*kept, plain.forms[form.index]]) + DOUBT
    best = {key: 0.0 for key in keys}
    for one in plain.forms:
        if one.key in best:
            best[one.key] = max(best[one.key], float(explained[one.index]))
    return tuple(key for key in keys if best[key] > own - allowed)


def _in_place(pool: Pool, form: Form, others: Sequence[Form]) -> tuple[tuple[str, str], ...]:
    """What explains as much in a cause's place, its price paid."""
    margin = _margin(pool, form, others)
    used = {one.key for one in others} | {form.key}
    tried = [i for i, one in enumerate(pool.forms) if one.key not in used]
    scores = pool.scores(others, tried)
    best: dict[tuple[str, str], float] = {}
    own = pool.scores(others, [form.index])[0, 1]
    for i, (explained, dof, _) in zip(tried, scores, strict=True):
        if dof > 0:
            worth = float(explained - pool.cost(pool.forms[i], dof))
            elsewhere = pool.forms[i].candidate.origin != form.candidate.origin
            more = dof > own and not elsewhere
            if worth > margin - DOUBT and more and pool.contains([*others, pool.forms[i]], others, form):
                continue  # the same thing, said with more
            if worth > margin - DOUBT and pool.cancels(pool.forms[i], others, form):
                continue
            if worth > margin - DOUBT and excessive(pool, pool.forms[i], [*others, pool.forms[i]]) > 1.0:
                continue
            best[pool.forms[i].key] = max(best.get(pool.forms[i].key, -np.inf), worth)
    keys = [key for key, worth in sorted(best.items(), key=lambda one: -one[1]) if worth > margin - DOUBT]
    return tuple(dict.fromkeys([*keys, *_several(pool, form, others)]))


def _several(pool: Pool, form: Form, others: Sequence[Form]) -> list[tuple[str, str]]:
    """Causes of one effect that explain together, with no more numbers, what one cause of the other origin does.

    A station that drifts along three directions, and a tool side that does so along each.
    """
    explained, _ = pool.scan(others)
    used = {one.key for one in others} | {form.key}
    by_effect: dict[str, dict[tuple[str, str], Form]] = {}
    for one in pool.forms:
        if one.candidate.origin != form.candidate.origin and one.key not in used and len(one.columns) == 1:
            best = by_effect.setdefault(one.candidate.effect, {})
            if one.key not in best or explained[one.index] > explained[best[one.key].index]:
                best[one.key] = one
    whole = pool.explained_by([*others, form])
    keys: list[tuple[str, str]] = []
    for group in (list(best.values()) for best in by_effect.values()):
        if not 1 < len(group) <= len(form.columns):
            continue
        together = pool.explained_by([*others, *group])
        if together < whole - DOUBT:
            continue
        for one in group:
            if pool.explained_by([*others, *(other for other in group if other is not one)]) < together - DOUBT:
                keys.append(one.key)
    return keys


def _margin(pool: Pool, form: Form, others: Sequence[Form]) -> float:
    """What a cause explains beside others, its price paid."""
    explained, dof = (float(values[form.index]) for values in pool.scan(others))
    return explained - pool.cost(form, dof)


def _rivals(pool: Pool, form: Form, others: Sequence[Form], excess: float) -> tuple[Rival, ...]:
    """What came next in a cause's place and is ruled out."""
    margin = _margin(pool, form, others)
    used = {one.key for one in others} | {form.key}
    tried = [one for one in pool.forms if one.key not in used]
    best: dict[tuple[str, str], Rival] = {}
    for one, (explained, dof, _) in zip(tried, pool.scores(others, [one.index for one in tried]), strict=True):
        if dof > 0:
            behind = 0.5 * (margin - float(explained - pool.cost(one, dof)))
            if one.key not in best or behind < best[one.key].log_odds:
                best[one.key] = Rival(*one.key, float(np.clip(explained / excess, 0.0, 1.0)), behind)
    out = [rival for rival in best.values() if rival.log_odds >= 0.5 * DOUBT]
    return tuple(sorted(out, key=lambda rival: rival.log_odds)[:RUNNERS_UP])


def _next(pool: Pool, named: Sequence[Form], causes: Sequence[Cause]) -> tuple[Mapping[str, Any], ...]:
    found: list[Mapping[str, Any]] = []
    for form, cause in zip(named, causes, strict=True):
        others = [one for one in named if one is not form]
        tried = {one.key for one in pool.forms}
        rivals = [_best(pool, key, others) for key in cause.equivalent if key in tried][:RIVALS]
        if rivals:
            found += next_points(pool.problem, form, rivals, others)
    return tuple(found)


def _best(pool: Pool, key: tuple[str, str], others: Sequence[Form]) -> Form:
    tried = [i for i, form in enumerate(pool.forms) if form.key == key]
    return pool.forms[tried[int(np.argmin(pool.scores(others, tried)[:, 2]))]]


def _p_value(problem: Problem, scatter: Scatter, chi2: float | None = None, fitted: int = 0) -> float:
    chi2, dof = problem.chi2 if chi2 is None else chi2, max(problem.dof - fitted, 1)
    if np.isfinite(scatter.dof):
        return float(f_sf(chi2 / dof, dof, scatter.dof))
    return float(chi2_sf(chi2, dof))


def _expected(problem: Problem) -> float:
    variances = np.einsum("nii->ni", problem.network.covariance)[problem.network.read]
    return float(np.sqrt(np.mean(variances) * problem.dof / problem.readings)) * 1e6


def _unidentifiable(problem: Problem, pool: Pool, known: Catalogue) -> dict[tuple[str, str], str]:
    everything = list(range(len(pool.forms)))
    seen: dict[tuple[str, str], bool] = {}
    for form, score in zip(pool.forms, pool.scores([], everything), strict=True):
        seen[form.key] = seen.get(form.key, False) or score[1] > 0
    hidden = [candidate.key for candidate in known.candidates if not seen.get(candidate.key, True)]
    why = looks_like(problem, [form for form in pool.forms if form.key in set(hidden)])
    return {key: why[key] for key in hidden}


def _ranking(pool: Pool) -> tuple[tuple[str, str, float, float], ...]:
    everything = list(range(len(pool.forms)))
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for form, (explained, _, log_p) in zip(pool.forms, pool.scores([], everything), strict=True):
        if log_p < best.get(form.key, (0.0, 1.0))[1]:
            best[form.key] = float(explained), float(log_p)
    ranked = sorted(best.items(), key=lambda one: (one[1][1], -one[1][0]))[:RANKED]
    return tuple((effect, where, explained, pool.chance(log_p)) for (effect, where), (explained, log_p) in ranked)
