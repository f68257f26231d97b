"""From a set of causes to an answer: sizes, doubts, what is left, what modelling it gains, what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from twin.arrays import locked
from twin.budget import volume
from twin.calibration import Calibration
from twin.diagnosis.absorbed import looks_like
from twin.diagnosis.catalogue import Catalogue
from twin.diagnosis.estimate import Estimate, estimate
from twin.diagnosis.flaws import ITSELF, constant_dropped, flaw, times
from twin.diagnosis.folds import folds
from twin.diagnosis.misfit import MANY
from twin.diagnosis.next_points import next_points
from twin.diagnosis.noise import Scatter
from twin.diagnosis.pool import DOUBT, Form, Pool, log_chance, pseudo
from twin.diagnosis.problem import Problem
from twin.diagnosis.reported import reported
from twin.diagnosis.result import Cause, Diagnosis, Gain, Rival, Trend, Unexplained, readable_unit
from twin.diagnosis.search import Selection, chosen, whole
from twin.diagnosis.signatures import Column
from twin.diagnosis.surrogates import EFFECT, depends_on, whatever
from twin.distributions import chi2_sf, f_log_sf, f_sf
from twin.effects import Effect
from twin.kinematics import Kinematics
from twin.machine import Machine
from twin.units import UM

SEEN_AT: Final = 0.05
"""Chance below which a column is said to go with the misfit."""
LARGE: Final = 1e-4
SMALL: Final = 0.01
"""Share of the excess below which what is left beside causes is noted, and no finding: real machines have some everywhere."""
PART: Final = 0.2
"""Of what an unnamed pattern explains: below it, a cause that goes with the same columns is taken for part of the pattern."""
TOOL_MM: Final = 100.0
SEED: Final = 2001
BOOTSTRAP: Final = 2000
RANKED: Final = 12
RIVALS: Final = 2
"""Rivals of a cause for which points are suggested."""
RUNNERS_UP: Final = 2
"""Causes ruled out in a cause's place that are listed with it."""


def account(
    problem: Problem,
    known: Catalogue,
    pool: Pool,
    best: Selection,
    scatter: Scatter,
    calibration: Calibration,
) -> Diagnosis:
    """The whole answer.

    Args:
        problem: the data.
        known: the causes that were tried.
        pool: what was compared.
        best: the set that was chosen.
        scatter: of the readings.
        calibration: the model that was judged.
    """
    forms = sorted(best.forms, key=lambda form: form.candidate.effect == EFFECT)
    small = _of_patterns(problem, pool, forms)
    forms = [form for form in forms if form not in small]
    found = estimate(problem, forms, scatter.dof)
    while (least := _least(pool, forms, found)) is not None:
        forms = [form for form in forms if form is not least]
        small.append(least)
        found = estimate(problem, forms, scatter.dof)
    named, unnamed = ([form for form in forms if (form.candidate.effect != EFFECT) is has] for has in (True, False))
    excess = max(problem.chi2 - problem.dof, found.explained, 1e-30)
    causes = []
    for k, form in enumerate(named):
        others = [one for one in forms if one is not form]
        explained, dof, log_p = pool.scores(others, [form.index])[0]
        margin = explained - pool.cost(form, dof)
        causes.append(
            Cause(
                effect=form.candidate.effect,
                where=form.candidate.where,
                origin=form.candidate.origin,
                parameters=found.quantities[k],
                p_value=pool.chance(log_p),
                share=float(np.clip(explained / excess, 0.0, 1.0)),
                equivalent=_equivalent(pool, form, others, margin),
                evidence=_evidence(form, found, k) + _flaw(pool, forms, form, calibration),
                pattern_um=locked(_unwhitened(problem, found.signature[:, k])),
                effects=found.effects[k],
                rivals=_rivals(pool, form, others, margin, excess),
            )
        )
    also, silent = reported(pool, forms, lambda moved: _unwhitened(problem, moved))
    order = sorted(range(len(causes)), key=lambda k: -causes[k].share)
    named, causes = [named[k] for k in order], [*(causes[k] for k in order), *also]
    silent += [_too_small(pool, forms, form, excess) for form in small]
    left = _unexplained(pool, unnamed, forms, excess)
    p_value = _p_value(problem, scatter)
    if left is None and not causes and p_value < LARGE:
        left = Unexplained(1.0, (), "both", "more scatter than stated, without any pattern in the columns given")
    elif left is None and causes:
        after = problem.chi2 - found.explained
        share = float((after - problem.dof) / excess)
        if chi2_sf(after, problem.dof - len(causes)) < LARGE and not np.isfinite(scatter.dof) and share > SMALL:
            left = Unexplained(
                share, (), "both", "more scatter than stated is left, without any pattern in the columns given"
            )
    verdict = (
        "unexplained"
        if left is not None
        else "consistent"
        if not causes
        else "ambiguous"
        if any(cause.equivalent for cause in causes)
        else "explained"
    )
    effects = [effect for found_effects in found.effects for effect in found_effects]
    source = "extended by twin diagnose from " + problem.network.data.source
    extended = (
        calibration.extended(effects, found.covariance, source, simulated=problem.network.data.simulated)
        if effects
        else calibration
    )
    weights = problem.network.whitening
    before_um = _unwhitened(problem, problem.projected)
    rest = problem.residual - found.signature.sum(axis=1)
    after_um = _unwhitened(problem, problem.project(rest))
    read = problem.network.read
    hidden = _unidentifiable(problem, pool, known)
    return Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        rms_um=_rms(before_um, read),
        expected_rms_um=_expected(problem),
        points=len(problem.network.data),
        dof=problem.dof,
        p_value=min(
            [
                p_value,
                *(cause.p_value for cause in causes if cause not in also),
                *(pool.chance(pool.scores([], [f.index])[0, 2]) for f in unnamed),
            ]
        ),
        causes=tuple(causes),
        unexplained=left,
        unidentifiable=tuple(hidden),
        looks_like=MappingProxyType(hidden),
        not_evaluated=known.not_evaluated,
        next_measurement=_next(problem, pool, named, forms, causes),
        trends=_trends(pool),
        ranking=_ranking(pool),
        # Last: it puts the pool back to what was tried.
        gain=_gain(problem, pool, forms, found, before_um, after_um) if forms else None,
        tried=len(known.candidates),
        scatter=scatter.source,
        calibration=calibration,
        extended=extended,
        data=replace(problem.network.data, notices=(*problem.network.data.notices, *silent)),
        residual_um=locked(before_um),
        after_um=locked(after_um),
        directions=locked(_plain(problem, problem.view.by_base)),
        precision=locked(np.einsum("nki,nkj->nij", weights, weights) * UM**2),
    )


def _least(pool: Pool, forms: Sequence[Form], found: Estimate) -> Form | None:
    """The form that is to be left out next: a pattern without a name that is too small, or what is not beyond what is left.

    Beyond, by how what is left differs from group to group, and only where the groups are many enough to say.
    """
    small = SMALL * found.explained
    for form in forms:
        others = [one for one in forms if one is not form]
        if form.candidate.effect == EFFECT and others and pool.scores(others, [form.index])[0, 0] < small:
            return form
    judged = [
        (_log_p(a) + form.price, form) for form, a in zip(forms, found.against, strict=True) if MANY <= a[2] < np.inf
    ]
    worst = max(judged, key=lambda one: one[0], default=None)
    return worst[1] if worst is not None and worst[0] > np.log(pool.level) else None


def _of_patterns(problem: Problem, pool: Pool, forms: Sequence[Form]) -> list[Form]:
    """Causes that are a small part of what goes with an unnamed pattern's columns, and say nothing that those columns do not.

    A pattern that nobody knows looks like this cause here and that cause there; each of them is significant, and none is there.
    """
    unnamed = [form for form in forms if form.candidate.effect == EFFECT]
    gone: list[Form] = []
    for pattern in unnamed:
        any_smooth = whatever(pattern.candidate, problem.network.machine, problem.network.data)
        others = [form for form in forms if form is not pattern and form not in gone]
        own = pool.scores(others, [pattern.index])[0, 0]
        for form in [one for one in others if one.candidate.effect != EFFECT]:
            rest = [one for one in others if one is not form]
            if pool.scores([*rest, pattern], [form.index])[0, 0] < PART * own:
                beside = [*any_smooth, *(column for one in rest for column in one.cell.columns)]
                explained, dof = _beside(problem, form.cell.columns, beside)
                if dof == 0 or explained < pool.cost(form, float(dof)):
                    gone.append(form)
    return gone


def _beside(problem: Problem, columns: Sequence[Column], others: Sequence[Column]) -> tuple[float, int]:
    """What some columns explain that others do not, and along how many directions that are seen."""
    found = problem.products([*columns, *others])
    own, beside = slice(0, len(columns)), slice(len(columns), None)
    inverse, _ = pseudo(found.gram[beside, beside])
    cross = found.gram[beside, own]
    gram = found.gram[own, own] - cross.T @ inverse @ cross
    slope = found.slope[own] - cross.T @ (inverse @ found.slope[beside])
    left, root = pseudo(gram)
    return float(slope @ left @ slope), root.shape[1]


def _log_p(against: tuple[float, int, float]) -> float:
    """Of a cause that is not there, by its Wald statistic (F with the groups' degrees of freedom, Hotelling's T² with one cause)."""
    statistic, width, count = against
    free = count - width
    return float(f_log_sf(statistic / width * free / (count - 1.0), width, free)) if free > 0 else 0.0


def _too_small(pool: Pool, forms: Sequence[Form], form: Form, excess: float) -> str:
    """What was left out, for the notes."""
    share = 100.0 * float(pool.scores(forms, [form.index])[0, 0]) / excess
    if form.candidate.effect != EFFECT:
        return f"{' '.join(form.key)} shows ({share:.2g} % of the excess), but not beyond what else is left unexplained: not named"
    side, names = depends_on(form.candidate)
    return f"a small pattern is left, {share:.2g} % of the excess, that goes with {' and '.join(names)} on the {side} side: not named"


def _equivalent(pool: Pool, form: Form, others: Sequence[Form], margin: float) -> tuple[tuple[str, str], ...]:
    """What could stand in this cause's place, the others kept, without the data objecting."""
    used = {one.key for one in others} | {form.key}
    tried = [i for i, one in enumerate(pool.forms) if one.key not in used and one.candidate.effect != EFFECT]
    scores = pool.scores(others, tried)
    best: dict[tuple[str, str], float] = {}
    own = pool.scores(others, [form.index])[0, 1]
    for i, (explained, dof, _) in zip(tried, scores, strict=True):
        if dof > 0:
            worth = float(explained - pool.cost(pool.forms[i], dof))
            if worth > margin - DOUBT and dof > own and pool.contains([*others, pool.forms[i]], others, form):
                continue  # the same thing, said with more
            if worth > margin - DOUBT and pool.cancels(pool.forms[i], others, form):
                continue
            if worth > margin - DOUBT and not whole(pool, pool.forms[i], [*others, pool.forms[i]]):
                continue
            best[pool.forms[i].key] = max(best.get(pool.forms[i].key, -np.inf), worth)
    return tuple(key for key, worth in sorted(best.items(), key=lambda one: -one[1]) if worth > margin - DOUBT)


def _rivals(pool: Pool, form: Form, others: Sequence[Form], margin: float, excess: float) -> tuple[Rival, ...]:
    """What came next in a cause's place and is ruled out."""
    used = {one.key for one in others} | {form.key}
    tried = [one for one in pool.forms if one.key not in used and one.candidate.effect != EFFECT]
    best: dict[tuple[str, str], Rival] = {}
    for one, (explained, dof, _) in zip(tried, pool.scores(others, [one.index for one in tried]), strict=True):
        if dof > 0:
            behind = 0.5 * (margin - float(explained - pool.cost(one, dof)))
            if one.key not in best or behind < best[one.key].log_odds:
                best[one.key] = Rival(*one.key, float(np.clip(explained / excess, 0.0, 1.0)), behind)
    out = [rival for rival in best.values() if rival.log_odds >= 0.5 * DOUBT]
    return tuple(sorted(out, key=lambda rival: rival.log_odds)[:RUNNERS_UP])


def _next(
    problem: Problem, pool: Pool, named: Sequence[Form], forms: Sequence[Form], causes: Sequence[Cause]
) -> tuple[Mapping[str, Any], ...]:
    found: list[Mapping[str, Any]] = []
    for form, cause in zip(named, causes, strict=False):
        others = [one for one in forms if one is not form and one.candidate.effect != EFFECT]
        rivals = [_best(pool, key, others) for key in cause.equivalent[:RIVALS]]
        if rivals:
            found += next_points(problem, form, rivals, others)
    return tuple(found)


def _best(pool: Pool, key: tuple[str, str], others: Sequence[Form]) -> Form:
    tried = [i for i, form in enumerate(pool.forms) if form.key == key]
    return pool.forms[tried[int(np.argmin(pool.scores(others, tried)[:, 2]))]]


def _unexplained(pool: Pool, unnamed: Sequence[Form], forms: Sequence[Form], excess: float) -> Unexplained | None:
    if not unnamed:
        return None
    columns: list[str] = []
    sides: set[str] = set()
    share = 0.0
    for form in unnamed:
        others = [one for one in forms if one is not form]
        explained = pool.scores(others, [form.index])[0, 0]
        share += float(explained) / excess
        side, names = depends_on(form.candidate)
        sides.add(side)
        columns += [name for name in names if name not in columns]
    carrier = sides.pop() if len(sides) == 1 else "both"
    text = (
        f"a pattern that goes with {' and '.join(columns)} on the {carrier} side, {100 * min(share, 1.0):.0f} % of the excess, "
        "fits no effect that is known here"
    )
    return Unexplained(min(share, 1.0), tuple(columns), carrier, text)


def _evidence(form: Form, found: Estimate, k: int) -> str:
    sizes = [q for q in found.quantities[k] if q.name not in ("order", "period", "phase", "time_constant")]
    size = max(sizes, key=lambda q: abs(q.value) / q.u if q.u > 0.0 else 0.0)
    unit = readable_unit(size.unit)
    where = form.candidate.where
    text = {
        "reversal": f"{where} stands {abs(size.value):.3g} {unit} apart depending on the side it came from",
        "pitch_error": f"{where} errs periodically along its travel",
        "squareness": f"{where}: the axes are out of square by {size.value:.3g} {unit} more than the model says",
        "axis_location": f"{where}: the axis's average line lies {size.value:.3g} {unit} from where the model has it",
        "angular_error_motion": f"{where}: the axis turns as it travels, otherwise than the model says",
        "straightness": f"{where}: the axis runs along another curve than the model says",
        "positioning": f"{where}: the axis stands elsewhere along its travel than the model says",
        "error_motion": f"{where}: the axis errs along another curve than the model says",
        "harmonic": f"{where}: an error that repeats with the turn of the axis",
        "thermal_expansion": f"{where}'s scale lengthens by {size.value:.3g} {unit} as it warms",
        "thermal_growth": f"the tool side moves along {where} as that sensor warms",
        "thermal_drift": f"the tool side creeps along {where} as the machine warms up",
        "cross_axis": f"{where}: one axis's error grows with another axis's position",
        "table_load": f"the cradle on {where} droops by {size.value:.3g} {unit} when turned",
        "frame_shift": f"the instrument's frame was re-aligned from {where} on",
        "gravity_compliance": f"{where} gives way under gravity",
        "zero_offset": f"{where}'s zero is off by {size.value:.3g} {unit}",
        "following_error": f"{where} stood where the control reported it, not where it was told to go",
        "refraction_scale": f"all lengths are read {size.value:.3g} {unit} too long",
        "station_drift": f"station {where} creeps while it measures",
        "misplaced": _misplaced(where),
        "target_shift": f"target {where} sits elsewhere than before",
    }.get(form.candidate.effect, f"{where}: an error of the kind {form.candidate.effect.replace('_', ' ')}")
    return f"{text} ({abs(size.value) / size.u:.0f} standard uncertainties)" if size.u > 0.0 else text


def _flaw(pool: Pool, forms: Sequence[Form], form: Form, calibration: Calibration) -> str:
    """What was done wrong in making the calibration's own curve, if that is plain."""
    space, curve = form.candidate.space, calibration.curves.get(form.candidate.where)
    if curve is not None:
        curve = curve.in_powers()
    if space is None or curve is None or curve.basis != space.basis.name or curve.domain != space.domain:
        return ""
    # With as many functions as the calibration's curve has: what they all are is asked, not what need be corrected.
    count = max(len(curve.coefficients), len(form.columns))
    wide = next(
        (f for f in pool.forms if f.key == form.key and len(f.columns) == count and f.cell.fixed.get("first") == 0.0),
        form,
    )
    if "stops" in form.cell.fixed:
        wide = form
    columns, values, inverse = pool.fitted([wide, *(one for one in forms if one is not form)])
    own = np.searchsorted(columns, wide.columns)
    scale = np.array([column.scale for column in wide.cell.columns])
    if "stops" in form.cell.fixed:
        size = float(values[own[0]] * scale[0])
        text = times(1.0 + size) if form.cell.fixed["stops"] == ITSELF else constant_dropped(curve, size)
    else:
        # Functions that the form leaves out it says nothing of: no correction, and none known.
        first = round(wide.cell.fixed.get("first", 0.0))
        correction = np.concatenate([np.zeros(first), values[own] * scale])
        covariance = np.zeros((len(correction), len(correction)))
        covariance[first:, first:] = inverse[np.ix_(own, own)] * np.outer(scale, scale)
        text = flaw(space, curve, correction, covariance)
    return f"; {text}" if text else ""


def _misplaced(where: str) -> str:
    curve, _, other = where.partition(" as ")
    if other:
        return f"the calibration's curve {curve} is what the machine does as {other}"
    if where.endswith("exchanged"):
        return f"in the calibration, the curves of {where.removesuffix(' exchanged')} stand under each other's names"
    axis, _, joint = where.partition(" at ")
    return f"the calibration's error motions of {axis} act at {joint} instead of {axis}'s own joint"


def _p_value(problem: Problem, scatter: Scatter) -> float:
    if np.isfinite(scatter.dof):
        return float(f_sf(problem.chi2 / problem.dof, problem.dof, scatter.dof))
    return float(chi2_sf(problem.chi2, problem.dof))


def _unwhitened(problem: Problem, residual: np.ndarray) -> np.ndarray:
    """(n, 3) µm."""
    found = _plain(problem, residual.reshape(-1, 3)[:, :, None])[:, :, 0]
    return np.where(problem.network.read, found * 1e6, np.nan)


def _plain(problem: Problem, whitened: np.ndarray) -> np.ndarray:
    """(n, 3, k) as it was before it was whitened; zero where nothing was read."""
    read = problem.network.read
    safe = np.where(read[:, :, None] & read[:, None, :], problem.network.whitening, np.eye(3))
    return np.asarray(np.linalg.solve(safe, np.where(read[:, :, None], whitened, 0.0)))


def _rms(values: np.ndarray, read: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values[read] ** 2)))


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


def _trends(pool: Pool) -> tuple[Trend, ...]:
    """Columns the misfit goes with; the unnamed patterns of one column are all that is compared, so their own number is the price."""
    forms = [form for form in pool.forms if form.candidate.effect == EFFECT and form.candidate.where.count("|") == 1]
    explained, dof = pool.scan([])
    best: dict[str, tuple[float, float]] = {}
    for form in forms:
        if dof[form.index]:
            log_p = float(log_chance(explained[form.index], float(dof[form.index]), pool.dof)) + np.log(len(forms))
            where = form.candidate.where
            best[where] = min(best.get(where, (0.0, 0.0)), (log_p, float(explained[form.index])))
    found = []
    for where, (log_p, chi2) in sorted(best.items(), key=lambda one: (one[1][0], -one[1][1])):
        if log_p < np.log(SEEN_AT):
            side, column = where.split("|")
            found.append(Trend(column, side, chi2, float(np.exp(log_p))))
    return tuple(found)


def _ranking(pool: Pool) -> tuple[tuple[str, str, float, float], ...]:
    everything = list(range(len(pool.forms)))
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for form, (explained, _, log_p) in zip(pool.forms, pool.scores([], everything), strict=True):
        if form.candidate.effect != EFFECT and log_p < best.get(form.key, (0.0, 1.0))[1]:
            best[form.key] = float(explained), float(log_p)
    ranked = sorted(best.items(), key=lambda one: (one[1][1], -one[1][0]))[:RANKED]
    return tuple((effect, where, explained, pool.chance(log_p)) for (effect, where), (explained, log_p) in ranked)


def _gain(
    problem: Problem, pool: Pool, forms: Sequence[Form], found: Estimate, before: np.ndarray, after: np.ndarray
) -> Gain:
    read = problem.network.read
    held_before, held_after, interval = _held_out(problem, pool)
    machine_effects = [effect for effects in found.effects for effect in effects]
    tool_before, tool_after = _at_tool(problem, machine_effects, found)
    return Gain(
        _rms(before, read),
        _rms(after, read),
        held_before,
        held_after,
        interval,
        tool_before,
        tool_after,
        _tool_mm(problem.network.machine),
    )


def _held_out(problem: Problem, pool: Pool) -> tuple[float, float, tuple[float, float]]:
    """Residuals of rounds that neither the selection nor the fit has seen, without and with the causes chosen then.

    As many selections as `folds` makes parts. What the search learnt from all rounds, where a period lies or what cannot be, is
    forgotten first.
    """
    pool.judge(problem)
    nothing = float("nan"), float("nan"), (float("nan"), float("nan"))
    group, fold = folds(problem.network.data)
    if fold.max() == 0:
        return nothing
    rng = np.random.default_rng(SEED)
    table = np.zeros((group.max() + 1, 3))
    for k in range(int(fold.max()) + 1):
        rows = fold == k
        held = np.repeat(rows, 3)
        part = problem.without(rows)
        if part is None:
            return nothing
        small = pool.on(part)
        # What has no name is modelled by nothing, and foretells nothing.
        forms = [form for form in chosen(small, starts=1).forms if form.candidate.effect != EFFECT]
        plain = part.following(problem.residual)[held]
        # Nothing along what the training rounds do not see: it would be noise times a lever on the round held out.
        columns, values, _ = small.fitted(forms)
        signature = problem.signature([pool.products.columns[i] for i in columns])
        better = part.following(problem.residual - signature @ values)[held]
        read = np.count_nonzero(problem.network.read[rows], axis=1).astype(float)
        found = [_squares(problem, plain, held), _squares(problem, better, held), read]
        np.add.at(table, group[rows], np.stack(found, axis=1))
    drawn = table[rng.integers(0, len(table), (BOOTSTRAP, len(table)))].sum(axis=1)
    gains = np.sqrt(drawn[:, 0] / drawn[:, 2]) - np.sqrt(drawn[:, 1] / drawn[:, 2])
    total = table.sum(axis=0)
    low, high = np.quantile(gains, [0.025, 0.975])
    return float(np.sqrt(total[0] / total[2])), float(np.sqrt(total[1] / total[2])), (float(low), float(high))


def _squares(problem: Problem, residual: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(rows,) sum of squares in µm² of whitened residuals."""
    rows = held.reshape(-1, 3)[:, 0]
    read = problem.network.read[rows]
    safe = np.where(read[:, :, None] & read[:, None, :], problem.network.whitening[rows], np.eye(3))
    found = np.linalg.solve(safe, residual.reshape(-1, 3)[:, :, None])[:, :, 0] * 1e6
    return np.asarray(np.sum(np.where(read, found, 0.0) ** 2, axis=1))


def _tool_mm(machine: Machine) -> float:
    """Of the machine file, or of a usual tool: at the spindle nose itself a turn about it would seem to do no harm."""
    return machine.tool_length_mm or TOOL_MM


def _at_tool(problem: Problem, effects: Sequence[Effect], found: Estimate) -> tuple[float, float]:
    """RMS at the tool over the volume after compensating, with the old model and with the extended one, executed on the extended one.

    The old model's compensation leaves what the effects do there, to first order; the extended one's what they are uncertain by.
    """
    if not effects:
        return 0.0, 0.0
    network = problem.network
    machine = network.machine
    positions = volume(machine, 400)
    rng = np.random.default_rng(16907)
    state: dict[str, Any] = {axis.name: positions[:, i] for i, axis in enumerate(machine.axes)}
    state |= {f"approach_{axis.name}": rng.choice([-1.0, 1.0], len(positions)) for axis in machine.axes}
    rows = rng.integers(0, len(network.data), len(positions))
    state["time_s"] = np.asarray(network.data.time_s)[rows]
    state |= {f"T_{name}_degC": np.asarray(values)[rows] for name, values in network.data.temperature_degC.items()}
    at_tip = Kinematics(machine, Calibration.zero(machine), tool_length_mm=_tool_mm(machine))
    by_error = at_tip.sensitivities(positions).error[:, :3]
    index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(machine.frames)}

    def moved(effect: Effect, parts: Mapping[int, Any]) -> np.ndarray:
        at = index[effect.frame.axis, effect.frame.role]
        values = {at + i: np.broadcast_to(np.asarray(v, dtype=float), len(positions)) for i, v in parts.items()}
        return np.asarray(sum(by_error[:, :, i] * v[:, None] for i, v in values.items()))

    whole = np.sum([moved(effect, effect.components(state)) for effect in effects], axis=0)
    by_parameter = np.stack([moved(effect, parts) for effect in effects for parts in effect.derivatives(state)], axis=2)
    variance = np.einsum("nip,pq,niq->n", by_parameter, found.covariance.matrix, by_parameter)
    return float(np.sqrt(np.mean(np.sum(whole**2, axis=1)))), float(np.sqrt(np.mean(np.maximum(variance, 0.0))))
