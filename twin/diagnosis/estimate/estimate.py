"""How large each cause is: all their parameters together, the non-linear ones too, with the set-up free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.linalg import block_diag

from twin._common.arrays import locked
from twin.diagnosis.candidates.candidate import STRAIGHT
from twin.diagnosis.candidates.signatures import Column, of_effect
from twin.diagnosis.estimate.drift_fit import fit_drift, over_forms
from twin.diagnosis.estimate.misfit import larger, more_left, widened
from twin.diagnosis.problem.pool import Form, pseudo
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.result import Quantity
from twin.machine.effects import Effect
from twin.measurement.table import state_of
from twin.numerics.covariance import Covariance

STEPS: Final = 12
STILL: Final = 1e-6
TOGETHER: Final = 64


@final
@dataclass(frozen=True)
class Beside:
    """Patterns without a name, and what the scatter is beside them.

    Attributes:
        random: their columns, each with its standard deviation in the column's unit.
        scatter: times the stated variances.
    """

    random: Sequence[tuple[Column, float]]
    scatter: float


@final
@dataclass(frozen=True)
class Estimate:
    """Parameters of some causes.

    Attributes:
        quantities: by cause.
        effects: by cause; empty for an instrument's.
        covariance: of the parameters of all effects, under their names in a calibration.
        signature: (3n, k) what the causes do to the whitened readings, held out or not, one column a cause.
        explained: of the misfit.
        against: by cause, what the Wald statistic of all its numbers is beside their covariance, their number, and the groups that
            covariance is known from (infinite where it is the stated scatter's).
    """

    quantities: tuple[tuple[Quantity, ...], ...]
    effects: tuple[tuple[Effect, ...], ...]
    covariance: Covariance
    signature: np.ndarray
    explained: float
    against: tuple[tuple[float, int, float], ...] = ()


def estimate(
    problem: Problem, forms: Sequence[Form], scatter: float = float("inf"), beside: Beside | None = None
) -> Estimate:
    """Gauss-Newton on all parameters of the causes, the set-up projected out.

    Args:
        problem: the data.
        forms: the causes.
        scatter: degrees of freedom the scatter is known with.
        beside: patterns without a name; the causes alone are fitted, and these make them less certain.
    """
    if not forms:
        return Estimate((), (), Covariance.none(), np.zeros((len(problem.residual), 0)), 0.0)
    machine = problem.network.machine
    state = state_of(problem.network.data, machine)
    scales = [np.array([column.scale for column in form.cell.columns]) for form in forms]
    columns = [problem.signature(form.cell.columns) / own for form, own in zip(forms, scales, strict=True)]
    _, start = _solved(problem, np.concatenate(columns, axis=1), problem.residual, np.concatenate(scales))
    values = list(np.split(start, np.cumsum([len(own) for own in scales])[:-1]))
    effects: list[tuple[Effect, ...]] = [
        () if form.candidate.build is None else form.candidate.build(value, form.cell.fixed)
        for form, value in zip(forms, values, strict=True)
    ]
    curved = [form.candidate.drift is None and _bent(form, found) for form, found in zip(forms, effects, strict=True)]
    fixed = [dict(form.cell.fixed) for form in forms]
    loose: dict[int, np.ndarray] = {}
    for k, form in enumerate(forms):
        if form.candidate.drift is not None:
            others = [column for form in forms if form is not forms[k] for column in form.cell.columns]
            drift = fit_drift(problem, form.candidate.drift, others)
            straight = drift.time_constant == STRAIGHT
            unit = form.candidate.drift.columns(drift.time_constant)
            fixed[k] = {} if straight else {"time_constant": drift.time_constant}
            scales[k] = np.array([column.scale for column in unit])
            columns[k], values[k] = problem.signature(unit) / scales[k], drift.values
            effects[k] = () if form.candidate.build is None else form.candidate.build(drift.values, fixed[k])
            if drift.moments is not None:
                loose[k] = drift.moments
            curved[k] = drift.moments is None and not straight
    longest = [_longest(form) for form in forms]
    for _ in range(STEPS if any(curved) else 1):
        blocks, current, sizes = [], [], []
        for k, (found, bent) in enumerate(zip(effects, curved, strict=True)):
            if bent:
                derived = of_effect(found[0], machine, state)
                sizes.append(np.array([column.scale for column in derived]))
                blocks.append(problem.signature(derived) / sizes[-1])
                current.append(np.array([p.value for p in found[0].parameters]))
            else:
                sizes.append(scales[k])
                blocks.append(columns[k])
                current.append(values[k])
        made = [
            _made(problem, machine, state, effects[k]) if curved[k] else columns[k] @ current[k]
            for k in range(len(forms))
        ]
        left = problem.residual - np.sum(made, axis=0) if made else problem.residual
        whole = np.concatenate(blocks, axis=1)
        inverse, step = _solved(problem, whole, left, np.concatenate(sizes))
        moved = float(np.sqrt(max(step @ np.linalg.pinv(inverse, hermitian=True) @ step, 0.0)))
        at = 0
        for k, block in enumerate(blocks):
            own = step[at : at + block.shape[1]]
            at += block.shape[1]
            if curved[k]:
                effects[k] = (_kept(forms[k], effects[k][0], current[k] + own, longest[k]),)
            else:
                values[k] = values[k] + own
                if forms[k].candidate.build is not None:
                    effects[k] = forms[k].candidate.build(values[k], fixed[k])  # type: ignore[misc]
        if moved < STILL:
            break
    made = [
        _made(problem, machine, state, effects[k]) if curved[k] else columns[k] @ values[k] for k in range(len(forms))
    ]
    signature = np.stack(made, axis=1) if made else np.zeros((len(problem.residual), 0))
    total = signature.sum(axis=1)
    left = problem.residual - total
    after = float(left @ problem.project(left))
    by_patterns = None if beside is None else _with_patterns(problem, whole, inverse, np.concatenate(sizes), beside)
    count = float("inf")
    if more_left(problem, left, whole.shape[1], scatter):
        size = np.concatenate(sizes)
        wide, count = widened(problem, whole * size, left, inverse / np.outer(size, size))
        inverse = wide * np.outer(size, size)
    if by_patterns is not None:
        inverse = larger(inverse, by_patterns)
    against = []
    quantities, rows, apart, names, at = [], [], [], [], 0
    for k, form in enumerate(forms):
        width = blocks[k].shape[1]
        part = slice(at, at + width)
        now = values[k] if not curved[k] else np.array([p.value for p in effects[k][0].parameters])
        own_size = sizes[k] if k not in loose else scales[k]
        against.append(_wald(now / own_size, inverse[part, part] / np.outer(own_size, own_size), count))
        block = inverse[at : at + width, at : at + width]
        matrix = np.eye(width) if curved[k] else _matrix(form, fixed[k], width)
        own = loose.get(k, matrix @ block @ matrix.T)
        direct = form.candidate.space is not None or curved[k] or k in loose
        shown = _of_either_form(problem, forms, form, own if direct else block)
        quantities.append(_quantities(form, fixed[k], effects[k], values[k], shown))
        if effects[k]:
            placed = np.zeros((len(own), len(inverse)))
            if k not in loose:
                placed[:, at : at + width] = matrix
            rows.append(placed)
            apart.append(own if k in loose else np.zeros_like(own))
            names += [parameter.name for effect in effects[k] for parameter in effect.parameters]
        at += width
    whole_matrix = np.concatenate(rows) if rows else np.zeros((0, len(inverse)))
    spread = whole_matrix @ inverse @ whole_matrix.T
    if loose:
        spread += block_diag(*apart)
    covariance = Covariance(tuple(names), locked((spread + spread.T) / 2.0))
    return Estimate(tuple(quantities), tuple(effects), covariance, signature, problem.chi2 - after, tuple(against))


def _with_patterns(
    problem: Problem, columns: np.ndarray, inverse: np.ndarray, sizes: np.ndarray, beside: Beside
) -> np.ndarray:
    """Covariance of the least-squares values where scatter and patterns without a name are both in the readings."""
    scaled = columns * sizes
    own, _ = pseudo(problem.inner(scaled))
    gain = np.zeros((len(sizes), len(beside.random)))
    for start in range(0, len(beside.random), TOGETHER):
        some = beside.random[start : start + TOGETHER]
        made = problem.signature([column for column, _ in some]) * [deviation for _, deviation in some]
        gain[:, start : start + TOGETHER] = own @ problem.along(scaled, problem.project(made))
    return inverse * beside.scatter + (gain @ gain.T) * np.outer(sizes, sizes)


def _wald(values: np.ndarray, covariance: np.ndarray, count: float) -> tuple[float, int, float]:
    found, vectors = np.linalg.eigh(covariance)
    kept = found > 1e-12 * found[-1]
    along = vectors[:, kept].T @ values
    return float(np.sum(along**2 / found[kept])), int(kept.sum()), count


def _matrix(form: Form, fixed: Mapping[str, float], width: int) -> np.ndarray:
    """From what was fitted to the parameters as a calibration has them, which are linear in it."""
    build = form.candidate.build
    if build is None:
        return np.eye(width)
    columns = [
        [parameter.value for effect in build(unit, fixed) for parameter in effect.parameters] for unit in np.eye(width)
    ]
    return np.array(columns).T


def _solved(
    problem: Problem, columns: np.ndarray, residual: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance and least-squares step; nothing along what the data do not see of the largest plausible size."""
    scaled = columns * scale
    inverse, _ = pseudo(problem.inner(scaled))
    slope = problem.along(scaled, problem.project(residual))
    return inverse * np.outer(scale, scale), (inverse @ slope) * scale


def _made(problem: Problem, machine: object, state: object, effects: Sequence[Effect]) -> np.ndarray:
    """(3n,) what effects do to the whitened readings."""
    view, frames = problem.view, problem.network.machine.frames
    index = {(frame.axis, frame.role): i for i, frame in enumerate(frames)}
    found = np.zeros((len(view.rows), 3))
    for effect in effects:
        at = 6 * index[effect.frame.axis, effect.frame.role]
        for i, values in effect.components(state).items():  # type: ignore[arg-type]
            found += view.by_error[:, :, at + i] * (np.asarray(values)[:, None] * 1e-6)
    return found.reshape(-1)


def _of_either_form(problem: Problem, forms: Sequence[Form], form: Form, covariance: np.ndarray) -> np.ndarray:
    """Covariance of a cause's numbers, whichever of its forms with the same numbers is the true one."""
    own = form.cell
    same = [
        cell.columns
        for cell in form.candidate.cells
        if cell is not own and cell.fixed == own.fixed and len(cell.columns) == len(own.columns)
    ]
    if not same:
        return covariance
    others = [column for one in forms if one is not form for column in one.cell.columns]
    return larger(covariance, over_forms(problem, [own.columns, *same], others))


def _bent(form: Form, effects: Sequence[Effect]) -> bool:
    """Whether non-linear parameters are among those of its effect."""
    names = form.candidate.specification.bent
    return bool(names and effects) and all(name in effects[0].numbers for name in names)


def _longest(form: Form) -> float:
    """Longest period or time constant that a form can have."""
    tried = [cell.fixed[name] for cell in form.candidate.cells for name in form.bent if name in cell.fixed]
    return max(tried, default=np.inf)


def _kept(form: Form, effect: Effect, values: np.ndarray, longest: float) -> Effect:
    kept = form.candidate.specification.kept
    return effect if kept is None else kept(effect, [float(v) for v in values], longest)


def _quantities(
    form: Form, fixed: Mapping[str, float], effects: Sequence[Effect], values: np.ndarray, covariance: np.ndarray
) -> tuple[Quantity, ...]:
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if _bent(form, effects):
        return tuple(
            Quantity(p.name.rsplit(".", 1)[-1], p.value, p.unit, float(one))
            for p, one in zip(effects[0].parameters, u, strict=True)
        )
    if effects and form.candidate.space is not None:
        return tuple(
            Quantity(f"c{k}", p.value, p.unit, float(one))
            for k, (p, one) in enumerate(zip(effects[0].parameters, u, strict=True))
        )
    if effects and form.candidate.drift is not None:
        # The time constant is longer than the record: the rate is known, and with it what the record sees of the amplitude.
        hours = form.candidate.drift.constants[-1] / 3600.0
        rate = effects[0].parameters[0].value
        return (
            Quantity("amplitude", rate * hours, "um", float(u[0]) * hours),
            Quantity("rate", rate, "um/h", float(u[0])),
        )
    found = tuple(
        Quantity(name, float(value), unit, float(one))
        for (name, unit), value, one in zip(form.candidate.names, values, u, strict=False)
        if one > 1e-9 * u.max()  # a direction these data do not see has no size
    )
    if "order" in form.cell.fixed:
        found = (Quantity("order", form.cell.fixed["order"], "1", 0.0), *found)
    if form.candidate.drift is not None and "time_constant" in fixed:
        found = (*found, Quantity("time_constant", fixed["time_constant"], "s", float(u[-1])))
    return found
