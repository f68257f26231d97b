"""Alternatives to a cause: those it is confounded with, those that are ruled out, and the points to measure next.

The points to measure next are those at which the predictions of two confounded causes differ most. Both are fitted to the data, each
with its own set-up. If their predictions then differ by d in readings of covariance V, one reading adds dᵀV⁻¹d to the discrimination
between them (twice the expected log-likelihood ratio; Atkinson and Fedorov 1975, T-optimality).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from twin._common.arrays import first_largest, largest_first, read_only
from twin._common.units import MM
from twin.diagnosis.candidates.candidate import ITSELF, constant_dropped, flaw, times
from twin.diagnosis.cross_validation import predicts_held_out
from twin.diagnosis.estimate import Estimate, fitted_effects
from twin.diagnosis.forms import DEVIANCE_RULED_OUT, Candidates, Form
from twin.diagnosis.problem import Problem
from twin.diagnosis.result import Cause, Next, Rival, readable_unit
from twin.diagnosis.search import excess_ratio
from twin.diagnosis.structure import Findings
from twin.display.numbers import listed
from twin.identification.network import Network
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Effect, assemble
from twin.model.effects.specification import FittedCause
from twin.numerics.functions import SHORTEST_PERIOD, sampling_frequency
from twin.tool.uncertainty import volume

ALTERNATIVES_SEPARATED: Final = 2
"""Number of alternatives of a cause for which points are suggested."""
RUNNERS_UP: Final = 2
"""Number of alternatives that are ruled out and listed with a cause."""


def equivalent(found: Findings, form: Form, others: Sequence[Form]) -> tuple[tuple[str, str], ...]:
    """Return the causes that a cause is confounded with, the other causes kept.

    With unnamed patterns, an alternative may fit only because the patterns take over the difference. It is kept only if, without the
    patterns, it explains less than the cause by no more than the patterns explain.

    Args:
        found: the selected causes and patterns.
        form: the cause, of ``found.given_patterns``.
        others: the other causes, likewise.
    """
    keys = _in_place(found.given_patterns, form, others)
    if not found.structure.pattern_tests or not keys:
        return keys
    plain = found.candidates
    kept = [plain.forms[other.index] for other in others]
    explained, _ = plain.scan(kept)
    explained_by_cause = float(explained[form.index])
    allowed = found.structure.explained([*kept, plain.forms[form.index]]) + DEVIANCE_RULED_OUT
    best = {key: 0.0 for key in keys}
    for one in plain.forms:
        if one.key in best:
            best[one.key] = max(best[one.key], float(explained[one.index]))
    return tuple(key for key in keys if best[key] > explained_by_cause - allowed)


def _in_place(candidates: Candidates, form: Form, others: Sequence[Form]) -> tuple[tuple[str, str], ...]:
    """Return the causes that explain as much in place of a cause, corrected for multiple testing."""
    margin = _margin(candidates, form, others)
    used = {other.key for other in others} | {form.key}
    tried = [i for i, one in enumerate(candidates.forms) if one.key not in used]
    scores = candidates.scores(others, tried)
    best: dict[tuple[str, str], float] = {}
    own_dof = candidates.scores(others, [form.index])[0, 1]
    for i, (explained, dof, _) in zip(tried, scores, strict=True):
        if dof > 0:
            worth = float(explained - candidates.critical_value(candidates.forms[i], dof))
            elsewhere = candidates.forms[i].candidate.origin != form.candidate.origin
            more = dof > own_dof and not elsewhere
            if (
                worth > margin - DEVIANCE_RULED_OUT
                and more
                and candidates.contains([*others, candidates.forms[i]], others, form)
            ):
                continue  # contains the cause, with more parameters
            if worth > margin - DEVIANCE_RULED_OUT and candidates.cancels(candidates.forms[i], others, form):
                continue
            if (
                worth > margin - DEVIANCE_RULED_OUT
                and excess_ratio(candidates, candidates.forms[i], [*others, candidates.forms[i]]) > 1.0
            ):
                continue
            best[candidates.forms[i].key] = max(best.get(candidates.forms[i].key, -np.inf), worth)
    ranked = [list(best.items())[i] for i in largest_first(np.array(list(best.values())))]
    keys = [key for key, worth in ranked if worth > margin - DEVIANCE_RULED_OUT]
    return tuple(dict.fromkeys([*keys, *_several(candidates, form, others)]))


def _several(candidates: Candidates, form: Form, others: Sequence[Form]) -> list[tuple[str, str]]:
    """Return causes of one effect that together explain as much as one cause of the other origin, with no more parameters.

    Example: drift of a station in three directions, and drift of the tool side along each of them.
    """
    explained, _ = candidates.scan(others)
    used = {one.key for one in others} | {form.key}
    by_effect: dict[str, dict[tuple[str, str], Form]] = {}
    for one in candidates.forms:
        if one.candidate.origin != form.candidate.origin and one.key not in used and len(one.columns) == 1:
            best = by_effect.setdefault(one.candidate.effect, {})
            if one.key not in best or explained[one.index] > explained[best[one.key].index]:
                best[one.key] = one
    whole = candidates.explained_by([*others, form])
    keys: list[tuple[str, str]] = []
    for group in (list(best.values()) for best in by_effect.values()):
        if not 1 < len(group) <= len(form.columns):
            continue
        together = candidates.explained_by([*others, *group])
        if together < whole - DEVIANCE_RULED_OUT:
            continue
        for one in group:
            if (
                candidates.explained_by([*others, *(other for other in group if other is not one)])
                < together - DEVIANCE_RULED_OUT
            ):
                keys.append(one.key)
    return keys


def _margin(candidates: Candidates, form: Form, others: Sequence[Form]) -> float:
    """Return the χ² that a cause explains given others, less its correction for multiple testing."""
    explained, dof = (float(values[form.index]) for values in candidates.scan(others))
    return explained - candidates.critical_value(form, dof)


def ruled_out(candidates: Candidates, form: Form, others: Sequence[Form], excess: float) -> tuple[Rival, ...]:
    """Return the best alternatives to a cause that are ruled out."""
    margin = _margin(candidates, form, others)
    used = {other.key for other in others} | {form.key}
    tried = [one for one in candidates.forms if one.key not in used]
    best: dict[tuple[str, str], Rival] = {}
    for one, (explained, dof, _) in zip(tried, candidates.scores(others, [one.index for one in tried]), strict=True):
        if dof > 0:
            behind = 0.5 * (margin - float(explained - candidates.critical_value(one, dof)))
            if one.key not in best or behind < best[one.key].log_odds:
                best[one.key] = Rival(*one.key, float(np.clip(explained / excess, 0.0, 1.0)), behind)
    out = [rival for rival in best.values() if rival.log_odds >= 0.5 * DEVIANCE_RULED_OUT]
    return tuple(out[i] for i in largest_first(np.array([-rival.log_odds for rival in out]))[:RUNNERS_UP])


def points_to_measure(candidates: Candidates, named: Sequence[Form], causes: Sequence[Cause]) -> tuple[Next, ...]:
    """Return the points to measure next, which separate the causes from their alternatives."""
    points: list[Next] = []
    plan = _possible(candidates.problem)
    ours = _prediction(candidates.problem, named, plan) if any(cause.equivalent for cause in causes) else None
    for form, cause in zip(named, causes, strict=True):
        others = [one for one in named if one is not form]
        tried = {one.key for one in candidates.forms}
        rivals = [_best(candidates, key, others) for key in cause.equivalent if key in tried][:ALTERNATIVES_SEPARATED]
        if rivals:
            points += next_points(candidates.problem, (form, ours), rivals, others, plan)
    return tuple(points)


def _best(candidates: Candidates, key: tuple[str, str], others: Sequence[Form]) -> Form:
    tried = [i for i, form in enumerate(candidates.forms) if form.key == key]
    return candidates.forms[tried[first_largest(-candidates.scores(others, tried)[:, 2])]]


POSES: Final = 400
"""Number of candidate poses."""
SEED: Final = 1975
POINTS_PER_PAIR: Final = 3
"""Number of points suggested per pair of causes."""
LEAST_POSE_DISTANCE: Final = 0.15
"""Smallest distance of two suggested poses, relative to the ranges of the axes."""


def next_points(
    problem: Problem,
    named: tuple[Form, np.ndarray | None],
    rivals: Sequence[Form],
    others: Sequence[Form],
    plan: Measurements,
) -> tuple[Mapping[str, Any], ...]:
    """Return the points at which the predictions of a cause and its alternatives differ most.

    Args:
        named: the cause, and the prediction of all causes at the candidate points (`_prediction`).
        plan: the candidate points.
    """
    network, (form, ours) = problem.network, named
    points: list[Mapping[str, Any]] = []
    for rival in rivals:
        theirs = _prediction(problem, [rival, *others], plan)
        name = f"{form.candidate.effect} {form.candidate.where}", f"{rival.candidate.effect} {rival.candidate.where}"
        if ours is None or theirs is None:
            text = f"to separate {name[0]} from {name[1]}: repeat the first round without touching the instrument or the targets"
            points.append({"separates": list(name), "text": text})
            continue
        sigma = np.sqrt(np.einsum("nii->n", network.covariance).mean() / max(network.read.sum(axis=1).mean(), 1.0))
        gain = np.sum(((ours - theirs) / sigma) ** 2, axis=1)
        for row in _well_separated(problem, plan.positions, gain):
            pose = {axis.name: round(float(plan.positions[row, i]), 1) for i, axis in enumerate(network.machine.axes)}
            approach = {
                axis.name: int(plan.approach[row, i])
                for i, axis in enumerate(network.machine.axes)
                if np.any(network.data.approach[:, i])
            }
            where = " ".join(f"{axis}{value:g}" for axis, value in pose.items())
            sides = " ".join(f"{axis}{'+' if sign > 0 else '−'}" for axis, sign in approach.items())
            text = (
                f"{where}, target {plan.target[row]}, station {plan.station[row]}"
                + (f", approached from {sides}" if sides else "")
                + f": separates {name[0]} from {name[1]} with χ² {gain[row]:.2g} per reading (25 in total is enough)"
            )
            points.append(
                {
                    "separates": list(name),
                    "pose": pose,
                    "approach": approach,
                    "target": str(plan.target[row]),
                    "station": str(plan.station[row]),
                    "expected_chi2": float(gain[row]),
                    "text": text,
                }
            )
    return tuple(points)


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


def _prediction(problem: Problem, forms: Sequence[Form], plan: Measurements) -> np.ndarray | None:
    """Return (n, 3) m, the change that causes and refitted set-up predict at other points; None for a cause of the instrument."""
    if any(form.candidate.build is None for form in forms):
        return None
    fitted, signature = fitted_effects(problem, forms)
    remaining = problem.residual - signature.sum(axis=1)
    effects = [effect for own in fitted for effect in own]
    return _moves(problem, effects, problem.setup_step(remaining), plan)


def _moves(problem: Problem, effects: Sequence[Effect], moved: np.ndarray, plan: Measurements) -> np.ndarray:
    network = problem.network
    identities = np.broadcast_to(np.eye(3), (len(plan), 3, 3))
    planned = Network(network.machine, plan, network.instruments, network.unknowns, covariance=identities)
    view = planned.view(np.zeros(0), problem.setup, np.arange(len(plan)))
    by_setup = np.zeros((len(plan), 3, len(problem.setup)))
    planned.fill_setup_columns(view, problem.setup, by_setup)
    frames = assemble(effects, network.machine.frames, machine_state(plan, network.machine))
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(plan)) for row in frames for v in row], axis=1)
    return np.asarray(by_setup @ moved + np.einsum("nij,nj->ni", view.by_error, errors))


def _well_separated(problem: Problem, positions: np.ndarray, gain: np.ndarray) -> list[int]:
    span = np.maximum(np.ptp(positions, axis=0), MM)
    taken: list[int] = []
    for row in largest_first(gain):
        if all(np.linalg.norm((positions[row] - positions[k]) / span) > LEAST_POSE_DISTANCE for k in taken):
            taken.append(int(row))
        if len(taken) == POINTS_PER_PAIR:
            break
    return taken


# --- Evidence for a cause in a sentence, and likely mistakes in the making of the calibration -----

ALIAS_CHI2: Final = 9.0
"""χ² (three standard deviations) by which a period must fit worse than the best to be ruled out."""


def evidence(form: Form, found: Estimate, k: int) -> str:
    """Return the effect of the k-th cause in words, with its size in standard uncertainties."""
    specification = form.candidate.specification
    others = {*specification.nonlinear, *specification.fixed, *form.variant.fixed}
    sizes = [q for q in found.quantities[k] if q.name not in others]
    size = max(sizes, key=lambda q: abs(q.value) / q.u if q.u > 0.0 else 0.0)
    numbers = {q.name: q.value for q in found.quantities[k]}
    what = FittedCause(form.candidate.where, size.value, readable_unit(size.unit), numbers, found.effects[k])
    text = specification.evidence(what)
    return f"{text} ({abs(size.value) / size.u:.0f} standard uncertainties)" if size.u > 0.0 else text


def curve_flaw(candidates: Candidates, forms: Sequence[Form], form: Form, calibration: Calibration) -> str:
    """Return the likely mistake in the calibration's curve, in words; empty if none is recognised."""
    space, curve = form.candidate.space, calibration.curves.get(form.candidate.where)
    if curve is not None:
        curve = curve.in_powers()
    if space is None or curve is None or curve.basis != space.basis.name or curve.domain != space.domain:
        return ""
    # With as many functions as the calibration's curve: all coefficients are needed, not only significant corrections.
    count = max(len(curve.coefficients), len(form.columns))
    wide = next(
        (
            f
            for f in candidates.forms
            if f.key == form.key and len(f.columns) == count and f.variant.fixed.get("first") == 0.0
        ),
        form,
    )
    if "stops" in form.variant.fixed:
        wide = form
    columns, values, inverse = candidates.fitted([wide, *(one for one in forms if one is not form)])
    at = np.searchsorted(columns, wide.columns)
    scale = np.array([column.scale for column in wide.variant.columns])
    if "stops" in form.variant.fixed:
        size = float(values[at[0]] * scale[0])
        text = times(1.0 + size) if form.variant.fixed["stops"] == ITSELF else constant_dropped(curve, size)
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
        return f"; other periods ({other} mm) fit equally well at these positions, so the error between them is unknown"
    if not predicts_held_out(candidates, form, forms):
        return "; a curve through these positions does not predict held-out ones, so the error between them is unknown"
    return ""


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
    tried = [one for one in candidates.forms if one.key == form.key and one is not form]
    periods = np.array([one.variant.fixed[name] for one in tried])
    explained = candidates.scores([one for one in forms if one is not form], [one.index for one in (form, *tried)])[
        :, 0
    ]
    away = np.abs(1.0 / periods - 1.0 / form.variant.fixed[name]) * span
    others: list[float] = []
    for i in largest_first(explained[1:]):
        if explained[1 + i] < explained[0] - ALIAS_CHI2:
            break
        if away[i] > 1.0 and all(abs(1.0 / periods[i] - 1.0 / other) * span > 1.0 for other in others):
            others.append(float(periods[i]))
    return others
