"""Alternatives to a cause: those it is confounded with, those that are ruled out, and the points to measure next.

The points to measure next are those at which the predictions of two confounded causes differ most. Both are fitted to the data, each
with its own set-up. If their predictions then differ by d in readings of covariance V, one reading adds dᵀV⁻¹d to the discrimination
between them (twice the expected log-likelihood ratio; Atkinson and Fedorov 1975, T-optimality).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twin._common.arrays import first_largest, largest_first, read_only
from twin._common.messages import Message, Number, joined
from twin._common.units import MM, TURN
from twin.diagnosis.candidates import SPECIFICATIONS
from twin.diagnosis.candidates.calibration import ITSELF, constant_dropped, flaw, times
from twin.diagnosis.candidates.candidate import STRAIGHT_LINE
from twin.diagnosis.candidates.instrument import assumed_zero
from twin.diagnosis.cross_validation import predicts_held_out
from twin.diagnosis.estimate import Estimate, fitted_effects, fitting_periods
from twin.diagnosis.forms import DEVIANCE_RULED_OUT, RESOLVED, Candidates, Form
from twin.diagnosis.problem import Problem
from twin.diagnosis.result import Cause, Next, Rival, readable_unit
from twin.diagnosis.search import excess_ratio
from twin.diagnosis.structure import Findings
from twin.display.numbers import COVERAGE_FACTOR, listed
from twin.identification.network import Network
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import assemble
from twin.model.effects.base import axis_of
from twin.model.effects.specification import FittedCause
from twin.numerics.functions import SHORTEST_PERIOD, sampling_frequency
from twin.tool.uncertainty import volume

ALTERNATIVES_SEPARATED: Final = 2  # number of alternatives of a cause for which points are suggested
MOST_TOGETHER: Final = 6  # causes of one effect tried together, one for each axis: more would imitate anything
SPANNED: Final = 0.01
"""Share of a cause's squared norm outside the span of others up to which they replace it; the rest is within the noise, too."""
FIELD: Final = "with the frame"
"""`Specification.varies` of an error of the instrument that is a field in its frame: scales, shears, bent beams."""
IMITATED: Final = 0.2  # share of a cause's effect that an error of the instrument may leave and still replace it
LAG_SHARE: Final = (
    0.1  # relative difference of a growth's coefficient, with a lag and without, up to which the lag is only a remark
)
SMOOTH_DEGREE: Final = 5  # degree of the smooth function of a temperature that is compared with a course in time
RUNNERS_UP: Final = 2  # number of alternatives that are ruled out and listed with a cause


def equivalent(findings: Findings, form: Form, others: Sequence[Form]) -> tuple[tuple[str, str], ...]:
    """Return the causes that one of ``findings.given_patterns`` is confounded with, the other causes kept.

    With unnamed patterns, an alternative may fit only because the patterns take over the difference. It is kept only if, without the
    patterns, it explains less than the cause by no more than the patterns explain.
    """
    keys = _in_place(findings.given_patterns, form, others)
    if not findings.structure.pattern_tests or not keys:
        return keys
    plain = findings.candidates
    plain_form, *plain_others = (plain.forms[cause.index] for cause in (form, *others))
    explained, _ = plain.scan(plain_others)
    allowed = findings.structure.explained([*plain_others, plain_form]) + DEVIANCE_RULED_OUT
    least = float(explained[form.index]) - allowed
    best = dict.fromkeys(keys, 0.0)
    for other in plain.forms:
        if other.key in best:
            best[other.key] = max(best[other.key], float(explained[other.index]))
    return tuple(key for key in keys if best[key] > least)


def _in_place(candidates: Candidates, form: Form, others: Sequence[Form]) -> tuple[tuple[str, str], ...]:
    """Return the causes that explain as much in place of a cause, corrected for multiple testing."""
    least = _margin(candidates, form, others) - DEVIANCE_RULED_OUT
    used = {other.key for other in others} | {form.key}
    tried = [
        other
        for other in candidates.forms
        if other.key not in used
        and not other.candidate.is_same_event(form.candidate)
        and not other.candidate.is_variant_in_time_of(form.candidate)
    ] + lags(candidates, form, others, differing=True)
    scores = candidates.scores(others, [other.index for other in tried])
    dof_of_form = candidates.scores(others, [form.index])[0, 1]
    best: dict[tuple[str, str], float] = {}
    for rival, (explained, dof, _) in zip(tried, scores, strict=True):
        # A cause that patterns leave little to is no likelier than nothing: what explains nothing is no alternative to it.
        if dof <= 0 or explained < DEVIANCE_RULED_OUT:
            continue
        # Of two fields of errors of one instrument, the one with more numbers is not less likely for that.
        fields = FIELD == rival.candidate.specification.varies == form.candidate.specification.varies
        worth = float(explained - candidates.critical_value(rival, min(dof, dof_of_form) if fields else dof))
        more_parameters = dof > dof_of_form and rival.candidate.origin == form.candidate.origin
        if worth > least and (
            (more_parameters and candidates.contains([*others, rival], others, form))
            or candidates.cancels(rival, others, form)
            or excess_ratio(candidates, rival, [*others, rival]) > 1.0
        ):
            continue
        best[rival.key] = max(best.get(rival.key, -np.inf), worth)
    ranked = [list(best)[i] for i in largest_first(np.array(list(best.values())))]
    return tuple(key for key in ranked if best[key] > least)


def lags(candidates: Candidates, form: Form, others: Sequence[Form], *, differing: bool) -> list[Form]:
    """Return the lags of a growth that the readings do not exclude, the others kept.

    ``differing``: only if they predict something else: one of them has a coefficient outside the interval of the growth's and farther
    from it than `LAG_SHARE`, or excludes the growth without it.
    """
    tried = [o for o in candidates.forms if o.nonlinear and o.candidate.is_variant_in_time_of(form.candidate)]
    if form.nonlinear or not tried:
        return []
    explained, _ = candidates.scan(others)
    gain = np.array([float(explained[lag.index] - explained[form.index]) for lag in tried])
    found = [lag for lag, own in zip(tried, gain, strict=True) if own > max(gain.max(), 0.0) - DEVIANCE_RULED_OUT]
    if not differing or gain.max() > DEVIANCE_RULED_OUT:
        return found
    value, u = coefficient(candidates, form, others)
    most = max(COVERAGE_FACTOR * u, LAG_SHARE * abs(value))
    return found if any(abs(coefficient(candidates, lag, others)[0] - value) > most for lag in found) else []


def coefficient(candidates: Candidates, form: Form, others: Sequence[Form]) -> tuple[float, float]:
    """Return the first parameter of a form fitted with some others, and its standard uncertainty by the noise."""
    columns, values, inverse = candidates.fitted([*others, form])
    at, scale = int(np.searchsorted(columns, form.columns[0])), form.variant.columns[0].scale
    return float(values[at] * scale), float(np.sqrt(max(inverse[at, at], 0.0)) * scale)


def lag_not_excluded(candidates: Candidates, form: Form, others: Sequence[Form]) -> str:
    """Return the longest lag of a growth that the readings do not exclude, and the coefficients with it, in words; empty if none."""
    found = lags(candidates, form, others, differing=False)
    if not found:
        return ""
    values = [coefficient(candidates, some, others)[0] for some in (form, *found)]
    longest = max(lag.nonlinear["time_constant"] for lag in found) / 60.0
    extremes = f"{min(values, key=abs):.3g} to {max(values, key=abs):.3g}".replace("-", "−")
    return Message(
        "; a lag of up to {longest} min behind that temperature cannot be excluded, with a coefficient of {extremes}",
        longest=Number(f"{max(longest, 1.0):.0f}"),
        extremes=Number(f"{extremes} {readable_unit(form.candidate.names[0][1])}"),
    )


def follows_a_temperature(problem: Problem, forms: Sequence[Form], signature: np.ndarray, k: int) -> str:
    """Return the sensor of which a smooth function fits as well as the course in time of the k-th cause of the machine; empty if none.

    A temperature that only rises is as good a clock as time: any function of the one is a function of the other. ``signature``: (3n, k)
    of all causes.
    """
    drift, data = forms[k].candidate.drift, problem.network.data
    if drift is None or forms[k].candidate.origin != "machine":
        return ""
    since = np.repeat(data.time_s - data.time_s.min(), 3)[:, None]
    shape = problem.signature(drift.columns(STRAIGHT_LINE)) / np.where(since > 0.0, since, np.inf)
    others = np.delete(signature, k, axis=1)

    def explained(own: np.ndarray) -> float:
        columns = np.concatenate([others, own], axis=1)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        projected = problem.project(columns)
        along = projected.T @ problem.residual
        return float(along @ np.linalg.pinv(columns.T @ projected, rcond=1e-10, hermitian=True) @ along)

    free = SMOOTH_DEGREE * shape.shape[1] - 1  # parameters more than those of the course and its time constant
    least = explained(signature[:, [k]]) - DEVIANCE_RULED_OUT + free
    found: dict[str, float] = {}
    for sensor, warm in data.temperature_degC.items():
        if np.ptp(warm) > 0.0:
            scaled = np.repeat(2.0 * (warm - warm.min()) / np.ptp(warm) - 1.0, 3)
            powers = np.polynomial.chebyshev.chebvander(scaled, SMOOTH_DEGREE)
            found[sensor] = explained(np.concatenate([shape * power[:, None] for power in powers.T], axis=1)) - least
    own_axis = axis_of(forms[k].candidate.where)
    fitting = [sensor for sensor, margin in found.items() if margin > 0.0]
    return own_axis if own_axis in fitting else max(fitting, key=lambda sensor: found[sensor], default="")


def together(candidates: Candidates, form: Form, others: Sequence[Form]) -> tuple[tuple[tuple[str, str], ...], ...]:
    """Return groups of causes of one effect and of the other origin that together explain as much as a cause, the others kept.

    Either with no more parameters (drift of a station in three directions, and of the tool side along each of them), or because what
    the cause adds to the readings lies in their span (a scale of all lengths, and equal scales of three axes): then no readings of this
    kind distinguish the two, whatever their number.
    """
    explained, _ = candidates.scan(others)
    used = {other.key for other in others} | {form.key}
    by_effect: dict[str, dict[tuple[str, str], Form]] = {}
    for rival in candidates.forms:
        if rival.candidate.origin != form.candidate.origin and rival.key not in used and len(rival.columns) == 1:
            best = by_effect.setdefault(rival.candidate.effect, {})
            if rival.key not in best or explained[rival.index] > explained[best[rival.key].index]:
                best[rival.key] = rival
    least = candidates.explained_by([*others, form]) - DEVIANCE_RULED_OUT
    groups = []
    for group in (list(best.values()) for best in by_effect.values()):
        if not 1 < len(group) <= MOST_TOGETHER:
            continue
        explained_together = candidates.explained_by([*others, *group])
        if explained_together < least:
            continue
        needed = [
            rival
            for rival in group
            if candidates.explained_by([*others, *(other for other in group if other is not rival)])
            < explained_together - DEVIANCE_RULED_OUT
        ]
        spanned = candidates.contains([*others, *group], others, form, remaining=SPANNED)
        if len(needed) > 1 and (spanned or len(group) <= len(form.columns)):
            groups.append(tuple(rival.key for rival in needed))
    return tuple(groups)


def rest_on_the_instrument(problem: Problem, signature: np.ndarray, machine: np.ndarray) -> np.ndarray:
    """Return (k,) whether an error of the instrument that no one looks for would fit in place of a cause of the ``machine`` (k,).

    Tried for all causes of the machine together and for each alone, the others kept: the readings do not show the difference, and the
    error spans most of the (3n, k) signatures.
    """
    assumed = problem.signature(assumed_zero(problem.network.data))
    columns = np.concatenate([signature, assumed], axis=1)
    gram = columns.T @ problem.project(columns)
    instrument = np.arange(signature.shape[1], columns.shape[1])

    def rest(some: np.ndarray) -> bool:
        total, kept = signature[:, some].sum(axis=1), np.flatnonzero(~some)
        along = np.append(columns.T @ problem.project(total), total @ problem.project(total))

        def remaining(others: np.ndarray) -> float:
            inverse = np.linalg.pinv(gram[np.ix_(others, others)], rcond=1e-10, hermitian=True)
            return float(along[-1] - along[others] @ inverse @ along[others])

        left = remaining(np.concatenate([kept, instrument]))
        return left < min(DEVIANCE_RULED_OUT, IMITATED * remaining(kept))

    if np.count_nonzero(machine) > 1 and rest(machine):
        return machine
    every = np.arange(len(machine))
    return np.array([bool(machine[k]) and rest(every == k) for k in every], dtype=bool)


def itself(findings: Findings, form: Form, others: Sequence[Form]) -> list[tuple[str, str]]:
    """Return a cause and the causes that are this one and something more, which count as that cause for the second method.

    Those are its variants, such as ``reversal_curve`` of ``reversal``, and causes of the same origin that make the same readings with
    further parameters (the growth of a scale about a far point is a growth): the search names the smaller if no more is needed.
    """
    candidates, (effect, where) = findings.candidates, form.key
    found = {key for one in findings.second_opinion for key in one.credible} - {other.key for other in others}
    larger = (
        other
        for other in candidates.forms
        if other.key in found
        and other.candidate.origin == form.candidate.origin
        and len(other.columns) > len(form.columns)
        and candidates.contains([*others, other], others, form)
    )
    variants = [(own.name, where) for own in SPECIFICATIONS.values() if own.variant_of == effect]
    return [form.key, *variants, *(other.key for other in larger)]


def constants_of_curves(candidates: Candidates, forms: Sequence[Form]) -> list[Form]:
    """Return the causes with those constants given back to a curve that are nothing over the measured positions.

    The datum makes a squareness of the mean of a tilt and of the slope of a straightness, over the whole travel. Where a part of it was
    not measured, the mean follows from the curve's course there: constant and curve are one number in the data, and what the readings
    have of the constant without these curves is its size over the measured positions.
    """
    kept = list(forms)
    for constant in [form for form in forms if form.candidate.specification.constant]:
        holding, beside = _holding(candidates, kept, constant)
        explained, dof = (float(values[constant.index]) for values in candidates.scan(beside))
        if holding and explained < candidates.critical_value(constant, dof):
            others = [form for form in kept if form is not constant]
            left = {form: candidates.scan([o for o in others if o is not form])[0][constant.index] for form in holding}
            curve = min(holding, key=lambda form: left[form])
            kept = [holding[curve] if form is curve else form for form in others]
    return kept


def _holding(candidates: Candidates, forms: Sequence[Form], constant: Form) -> tuple[dict[Form, Form], list[Form]]:
    """Return the curves that hold a constant, each with the same curve in which it is free, and the causes without both."""
    others, holding = [form for form in forms if form is not constant], dict[Form, Form]()
    for curve in others:
        if first := round(curve.variant.fixed.get("first", 0.0)):
            alike = [form for form in candidates.forms if form.key == curve.key]
            whole = [form for form in alike if len(form.columns) == len(curve.columns) + first]
            free = next((form for form in whole if form.variant.fixed.get("first") == 0.0), None)
            rest = [form for form in others if form is not curve]
            if free is not None and candidates.contains([*rest, free], others, constant):
                holding[curve] = free
    return holding, [form for form in others if form not in holding]


def where_measured(candidates: Candidates, forms: Sequence[Form], constant: Form) -> str:
    """Return the size of a constant over the measured positions, in words, if curves beside it make another of it over the travel."""
    holding, beside = _holding(candidates, forms, constant) if constant.candidate.specification.constant else ({}, [])
    whole, u = coefficient(candidates, constant, [*beside, *holding])
    own, _ = coefficient(candidates, constant, beside) if holding else (whole, u)
    if abs(own - whole) <= COVERAGE_FACTOR * u:
        return ""
    return Message(
        "; over the measured positions alone {own}: the rest is the mean line of {curves} over the whole travel, a part of which was "
        "not measured",
        own=Number(f"{own:.3g} {readable_unit(constant.candidate.names[0][1])}".replace("-", "−")),
        curves=listed([form.key[1] for form in holding]),
    )


def _margin(candidates: Candidates, form: Form, others: Sequence[Form]) -> float:
    """Return the χ² that a cause explains given others, less its correction for multiple testing."""
    explained, dof = (float(values[form.index]) for values in candidates.scan(others))
    return explained - candidates.critical_value(form, dof)


def ruled_out(candidates: Candidates, form: Form, others: Sequence[Form], share: float) -> tuple[Rival, ...]:
    """Return the best alternatives to a cause that are ruled out; theirs is the part of its ``share`` that they explain."""
    margin = _margin(candidates, form, others)
    by_form = max(float(candidates.scan(others)[0][form.index]), 1e-30)
    used = {other.key for other in others} | {form.key}
    tried = [other for other in candidates.forms if other.key not in used]
    scores = candidates.scores(others, [other.index for other in tried])
    best: dict[tuple[str, str], Rival] = {}
    for other, (explained, dof, _) in zip(tried, scores, strict=True):
        if dof > 0:
            log_odds = 0.5 * (margin - float(explained - candidates.critical_value(other, dof)))
            if other.key not in best or log_odds < best[other.key].log_odds:
                best[other.key] = Rival(*other.key, share * min(float(explained) / by_form, 1.0), log_odds)
    rivals = [rival for rival in best.values() if rival.log_odds >= 0.5 * DEVIANCE_RULED_OUT]
    return tuple(rivals[i] for i in largest_first(np.array([-rival.log_odds for rival in rivals]))[:RUNNERS_UP])


def points_to_measure(candidates: Candidates, named: Sequence[Form], causes: Sequence[Cause]) -> tuple[Next, ...]:
    """Return the points to measure next, which separate the causes from their alternatives."""
    points: list[Next] = []
    problem = candidates.problem
    plan = _possible(problem)
    prediction = _prediction(problem, named, plan) if any(cause.equivalent for cause in causes) else np.zeros(0)
    for form, cause in zip(named, causes, strict=True):
        others = [other for other in named if other is not form]
        rivals: list[Form] = []
        # What separates a cause from the first of a group separates it from all.
        further = {key for group in cause.together for key in group[1:]}
        for key in (key for key in cause.equivalent if key not in further):
            tried = [other.index for other in candidates.forms if other.key == key]
            if tried and len(rivals) < ALTERNATIVES_SEPARATED:
                log_p = candidates.scores(others, tried)[:, 2]
                rivals.append(candidates.forms[tried[first_largest(-log_p)]])
        points += [point for rival in rivals for point in _separating(problem, form, prediction, rival, others, plan)]
    return tuple(points)


POSES: Final = 400  # number of candidate poses
SEED: Final = 1975
POINTS_PER_PAIR: Final = 3  # number of points suggested per pair of causes
LEAST_POSE_DISTANCE: Final = 0.15  # smallest distance of two suggested poses, relative to the ranges of the axes


def _separating(
    problem: Problem, form: Form, prediction: np.ndarray, rival: Form, others: Sequence[Form], plan: Measurements
) -> list[Next]:
    """Return the points of a plan at which the predictions (`_prediction`) of a cause and an alternative differ most."""
    network, axes = problem.network, problem.network.machine.axes
    separates = [f"{cause.candidate.effect} {cause.candidate.where}" for cause in (form, rival)]
    of_instrument = [cause.candidate for cause in (form, rival) if cause.candidate.build is None]
    if of_instrument:
        decided_by = of_instrument[0].specification.decided_by
        return [
            {
                "separates": separates,
                "decided_by": Message(decided_by),
                "text": f"to separate {' from '.join(separates)}: {decided_by}",
            }
        ]
    of_rival = _prediction(problem, [rival, *others], plan)
    sigma = np.sqrt(np.einsum("nii->n", network.covariance).mean() / max(network.read.sum(axis=1).mean(), 1.0))
    chi2 = np.sum(((prediction - of_rival) / sigma) ** 2, axis=1)
    points: list[Next] = []
    for row in _well_separated(plan.positions, chi2):
        pose = {axis.name: round(float(plan.positions[row, i]), 1) for i, axis in enumerate(axes)}
        approach = {
            axis.name: int(plan.approach[row, i]) for i, axis in enumerate(axes) if np.any(network.data.approach[:, i])
        }
        where = " ".join(f"{axis}{value:g}" for axis, value in pose.items())
        sides = " ".join(f"{axis}{'+' if sign > 0 else '−'}" for axis, sign in approach.items())
        text = (
            f"{where}, target {plan.target[row]}, station {plan.station[row]}"
            + (f", approached from {sides}" if sides else "")
            + f": separates {' from '.join(separates)} with χ² {chi2[row]:.2g} per reading (25 in total is enough)"
        )
        points.append(
            {
                "separates": separates,
                "pose": pose,
                "approach": approach,
                "target": str(plan.target[row]),
                "station": str(plan.station[row]),
                "expected_chi2": float(chi2[row]),
                "text": text,
            }
        )
    return points


def _possible(problem: Problem) -> Measurements:
    """Return candidate poses over the volume, with both approach directions and the measured pairs of target and station."""
    data, machine = problem.network.data, problem.network.machine
    rng = np.random.default_rng(SEED)
    positions = volume(machine, POSES, SEED)
    rows = rng.integers(0, len(data), POSES)
    approach = np.where(np.any(data.approach != 0, axis=0), rng.choice([-1.0, 1.0], (POSES, len(machine.axes))), 0.0)
    # Target, time and temperatures are those of a measured row; its reading is not used.
    some = data.select(rows)
    return replace(some, positions=read_only(positions), approach=read_only(approach))


def _prediction(problem: Problem, forms: Sequence[Form], plan: Measurements) -> np.ndarray:
    """Return (n, 3) m, the change that causes of the machine and refitted set-up predict at other points.

    Causes of the instrument are fitted with them; they are not of the other points.
    """
    fitted, signature = fitted_effects(problem, forms)
    setup_step = problem.setup_step(problem.residual - signature.sum(axis=1))
    network = problem.network
    identities = np.broadcast_to(np.eye(3), (len(plan), 3, 3))
    planned = Network(network.machine, plan, network.instruments, network.unknowns, covariance=identities)
    view = planned.view(np.zeros(0), problem.setup, np.arange(len(plan)))
    by_setup = np.zeros((len(plan), 3, len(problem.setup)))
    planned.fill_setup_columns(view, problem.setup, by_setup)
    effects = [effect for effects in fitted for effect in effects]
    frames = assemble(effects, network.machine.frames, machine_state(plan, network.machine))
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(plan)) for row in frames for v in row], axis=1)
    return np.asarray(by_setup @ setup_step + np.einsum("nij,nj->ni", view.by_error, errors))


def _well_separated(positions: np.ndarray, gain: np.ndarray) -> list[int]:
    span = np.maximum(np.ptp(positions, axis=0), MM)
    taken: list[int] = []
    for row in largest_first(gain).tolist():
        if all(np.linalg.norm((positions[row] - positions[k]) / span) > LEAST_POSE_DISTANCE for k in taken):
            taken.append(row)
        if len(taken) == POINTS_PER_PAIR:
            break
    return taken


ARC_COVERED: Final = 0.8
"""Share of an axis's travel, one turn at most, from which on it counts as measured: the last position is one step short of a turn."""
ALIAS_CHI2: Final = 9.0  # χ² (three standard deviations) by which a period must fit worse than the best to be ruled out


def evidence(form: Form, estimated: Estimate, k: int) -> str:
    """Return the effect of the k-th cause in words, with its size in standard uncertainties."""
    specification = form.candidate.specification
    others = {*specification.nonlinear, *specification.fixed, *form.variant.fixed}
    sizes = [q for q in estimated.quantities[k] if q.name not in others]
    size = max(sizes, key=lambda q: abs(q.value) / q.u if q.u > 0.0 else 0.0)
    numbers = {q.name: q.value for q in estimated.quantities[k]}
    what = FittedCause(form.candidate.where, size.value, readable_unit(size.unit), numbers, estimated.effects[k])
    text = specification.evidence(what)
    place = form.candidate.where
    if not re.search(rf"\b{re.escape(place)}\b", text):
        text = joined("", [f"{place}: ", text])
    return (
        joined("", [text, Message(" ({count:.0f} standard uncertainties)", count=abs(size.value) / size.u)])
        if size.u > 0.0
        else text
    )


def curve_flaw(candidates: Candidates, forms: Sequence[Form], form: Form, calibration: Calibration) -> str:
    """Return the likely mistake in the calibration's curve, in words; empty if none is recognised."""
    space, curve = form.candidate.space, calibration.curves.get(form.candidate.where)
    if curve is not None:
        curve = curve.in_powers()
    if space is None or curve is None or curve.basis != space.basis.name or curve.domain != space.domain:
        return ""
    # With as many functions as the calibration's curve: all coefficients are needed, not only significant corrections.
    count = max(len(curve.coefficients), len(form.columns))
    stops, wide = form.variant.fixed.get("stops"), form
    if stops is None:
        alike = [other for other in candidates.forms if other.key == form.key and len(other.columns) == count]
        wide = next((other for other in alike if other.variant.fixed.get("first") == 0.0), form)
    columns, values, inverse = candidates.fitted([wide, *(other for other in forms if other is not form)])
    at = np.searchsorted(columns, wide.columns)
    scale = np.array([column.scale for column in wide.variant.columns])
    if stops is not None:
        size = float(values[at[0]] * scale[0])
        text = times(1.0 + size) if stops == ITSELF else constant_dropped(curve, size)
    else:
        # For functions not in the form the correction is zero and has no uncertainty.
        first = round(wide.variant.fixed.get("first", 0.0))
        correction = np.concatenate([np.zeros(first), values[at] * scale])
        covariance = np.zeros((len(correction), len(correction)))
        covariance[first:, first:] = inverse[np.ix_(at, at)] * np.outer(scale, scale)
        text = flaw(space, curve, correction, covariance)
    return f"; {text}" if text else ""


def between_positions(candidates: Candidates, forms: Sequence[Form], form: Form) -> str:
    """Return why a cause is not valid between the measured positions; empty if it is."""
    periods = _other_periods(candidates, forms, form)
    if periods:
        other = listed([f"{period:.3g}" for period in periods])
        return Message(
            "; other periods ({other} mm) fit equally well at these positions, so the error between them is unknown",
            other=other,
        )
    if not predicts_held_out(candidates, form, forms):
        return Message(
            "; a curve through these positions does not predict held-out ones, so the error between them is unknown"
        )
    return ""


def equal_orders(candidates: Candidates, forms: Sequence[Form], form: Form) -> str:
    """Return the other orders at which a function that repeats with the turn of an axis fits equally well, in words; empty if none.

    On a part of a turn these are the neighbours: it does not show more than a smooth function of the angle.
    """
    specification = form.candidate.specification
    if specification.period or not specification.drawing.period(form.variant.fixed):
        return ""
    tried = [other for other in candidates.forms if other.key == form.key and other is not form]
    others = [other for other in forms if other is not form]
    explained = candidates.scores(others, [other.index for other in (form, *tried)])[:, 0]
    orders = [
        TURN / specification.drawing.period(other.variant.fixed)
        for other, value in zip(tried, explained[1:], strict=True)
        if value > explained[0] - ALIAS_CHI2
    ]
    if not orders:
        return ""
    network = candidates.problem.network
    axis = network.machine.by_name[axis_of(form.candidate.where)]
    arc = float(np.ptp(network.data.positions[:, network.machine.names.index(axis.name)]))
    travel = TURN if axis.lower is None or axis.upper is None else min(axis.upper - axis.lower, TURN)
    beyond = Message(": beyond the measured arc the error is unknown") if arc < ARC_COVERED * travel else ""
    return Message(
        "; orders {orders} fit equally well at these angles{beyond}",
        orders=listed([f"{order:g}" for order in sorted(orders)]),
        beyond=beyond,
    )


def _other_periods(candidates: Candidates, forms: Sequence[Form], form: Form) -> list[float]:
    """Return other periods, mm, at which an effect whose period was sought fits the readings equally well (aliases)."""
    name = form.candidate.specification.period
    if not name:
        return []
    network = candidates.problem.network
    q = network.data.positions[:, network.machine.names.index(form.candidate.where)]
    span, even = float(np.ptp(q)), sampling_frequency(q)
    if even is not None:
        frequency = 1.0 / form.variant.fixed[name]
        aliases = (1.0 / max(abs(even - frequency), 1e-9), 1.0 / (even + frequency))
        return [float(aliase) for aliase in aliases if aliase >= SHORTEST_PERIOD]
    kept = [other for other in forms if other is not form]
    periods, gains = fitting_periods(candidates, form, kept)
    away = np.abs(1.0 / periods - 1.0 / form.variant.fixed[name]) * span
    least = float(candidates.scan(kept)[0][form.index]) - ALIAS_CHI2
    return [
        float(period) for period, gain, far in zip(periods, gains, away, strict=True) if gain > least and far > RESOLVED
    ]
