"""How large each cause is: all their parameters together, the non-linear ones too, with the set-up free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from scipy.linalg import block_diag

from twin._common.arrays import locked
from twin.diagnosis.candidates.candidate import STRAIGHT
from twin.diagnosis.candidates.signatures import Column, effect_columns
from twin.diagnosis.estimate.drift_fit import fit_drift, over_forms
from twin.diagnosis.estimate.misfit import lacks_fit, robust_covariance, upper_bound
from twin.diagnosis.problem.forms import Form, pseudo_inverse
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
class RandomEffects:
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
        wald: by cause, what the Wald statistic of all its numbers is beside their covariance, their number, and the groups that
            covariance is known from (infinite where it is the stated scatter's).
    """

    quantities: tuple[tuple[Quantity, ...], ...]
    effects: tuple[tuple[Effect, ...], ...]
    covariance: Covariance
    signature: np.ndarray
    explained: float
    wald: tuple[tuple[float, int, float], ...] = ()


@dataclass
class _Part:
    """One cause while all are fitted together.

    Attributes:
        form: the cause.
        fixed: its non-linear parameters, where they are not fitted with the others.
        scales: (w,) units of its columns that are plausible.
        columns: (3n, w) what a unit of each of its numbers does; of those that change with the numbers, as they are now.
        values: (w,) its numbers.
        effects: that are made of it; none for an instrument's.
        bent: whether its columns change with its numbers.
        moments: second moments of the numbers of a drift whose likelihood is not that of a normal distribution.
    """

    form: Form
    fixed: dict[str, float]
    scales: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    effects: tuple[Effect, ...]
    bent: bool
    moments: np.ndarray | None = None

    def put(self, values: np.ndarray, longest: float) -> None:
        """Other numbers."""
        self.values = values
        if self.bent:
            self.effects = (_kept(self.form, self.effects[0], values, longest),)
            self.values = np.array([parameter.value for parameter in self.effects[0].parameters])
        else:
            self.effects = _built(self.form, values, self.fixed)

    def turn(self, problem: Problem, state: Mapping[str, Any]) -> None:
        """Columns as they are at the numbers of now."""
        if self.bent:
            derived = effect_columns(self.effects[0], problem.network.machine, state)
            self.scales = np.array([column.scale for column in derived])
            self.columns = problem.signature(derived) / self.scales
            self.values = np.array([parameter.value for parameter in self.effects[0].parameters])

    def made(self, problem: Problem, state: Mapping[str, Any]) -> np.ndarray:
        """(3n,) what it does to the whitened readings."""
        return _made(problem, state, self.effects) if self.bent else np.asarray(self.columns @ self.values)


def estimate(
    problem: Problem, forms: Sequence[Form], scatter: float = float("inf"), beside: RandomEffects | None = None
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
    state = state_of(problem.network.data, problem.network.machine)
    parts = _begun(problem, forms)
    inverse = _fitted(problem, parts, state)
    signature = np.stack([part.made(problem, state) for part in parts], axis=1)
    whole = np.concatenate([part.columns for part in parts], axis=1)
    size = np.concatenate([part.scales for part in parts])
    left = problem.residual - signature.sum(axis=1)
    explained = problem.chi2 - float(left @ problem.project(left))
    count = float("inf")
    by_patterns = None if beside is None else _with_patterns(problem, whole, inverse, size, beside)
    if lacks_fit(problem, left, whole.shape[1], scatter):
        wide, count = robust_covariance(problem, whole * size, left, inverse / np.outer(size, size))
        inverse = wide * np.outer(size, size)
    if by_patterns is not None:
        inverse = upper_bound(inverse, by_patterns)
    return _told(problem, parts, inverse, signature, explained, count)


def _begun(problem: Problem, forms: Sequence[Form]) -> list[_Part]:
    """All causes as they are linear, and each drift at its most likely time constant beside the others."""
    scales = [np.array([column.scale for column in form.variant.columns]) for form in forms]
    columns = [problem.signature(form.variant.columns) / own for form, own in zip(forms, scales, strict=True)]
    _, start = _solved(problem, np.concatenate(columns, axis=1), problem.residual, np.concatenate(scales))
    values = np.split(start, np.cumsum([len(own) for own in scales])[:-1])
    parts = []
    for form, own, made, found in zip(forms, scales, columns, values, strict=True):
        fixed = dict(form.variant.fixed)
        effects = _built(form, found, fixed)
        part = _Part(form, fixed, own, made, found, effects, form.candidate.drift is None and _bent(form, effects))
        parts.append(part)
    for part in parts:
        _drifting(problem, part, [column for form in forms if form is not part.form for column in form.variant.columns])
    return parts


def _drifting(problem: Problem, part: _Part, others: Sequence[Column]) -> None:
    """Put a drift where its likelihood is largest."""
    drift = part.form.candidate.drift
    if drift is None:
        return
    found = fit_drift(problem, drift, others)
    straight = found.time_constant == STRAIGHT
    unit = drift.columns(found.time_constant)
    part.fixed = {} if straight else {"time_constant": found.time_constant}
    part.scales = np.array([column.scale for column in unit])
    part.columns, part.values = problem.signature(unit) / part.scales, found.values
    part.effects = _built(part.form, found.values, part.fixed)
    part.moments = found.moments
    part.bent = found.moments is None and not straight


def _fitted(problem: Problem, parts: Sequence[_Part], state: Mapping[str, Any]) -> np.ndarray:
    """Steps until nothing moves; the covariance of all numbers at the last one."""
    longest = [_longest(part.form) for part in parts]
    for _ in range(STEPS if any(part.bent for part in parts) else 1):
        for part in parts:
            part.turn(problem, state)
        left = problem.residual - np.sum([part.made(problem, state) for part in parts], axis=0)
        sizes = np.concatenate([part.scales for part in parts])
        inverse, step = _solved(problem, np.concatenate([part.columns for part in parts], axis=1), left, sizes)
        moved = float(np.sqrt(max(step @ np.linalg.pinv(inverse, hermitian=True) @ step, 0.0)))
        ends = np.cumsum([len(part.values) for part in parts])[:-1]
        for part, own, most in zip(parts, np.split(step, ends), longest, strict=True):
            part.put(part.values + own, most)
        if moved < STILL:
            break
    return inverse


def _told(
    problem: Problem,
    parts: Sequence[_Part],
    inverse: np.ndarray,
    signature: np.ndarray,
    explained: float,
    count: float,
) -> Estimate:
    """Parameters with their covariance, as they are reported and as a calibration has them."""
    forms = [part.form for part in parts]
    against, quantities, rows, apart, names, at = [], [], [], [], [], 0
    for part in parts:
        width = part.columns.shape[1]
        own_rows = slice(at, at + width)
        block = inverse[own_rows, own_rows]
        against.append(_wald(part.values / part.scales, block / np.outer(part.scales, part.scales), count))
        matrix = np.eye(width) if part.bent else _matrix(part.form, part.fixed, width)
        own = matrix @ block @ matrix.T if part.moments is None else part.moments
        direct = part.form.candidate.space is not None or part.bent or part.moments is not None
        shown = _of_either_form(problem, forms, part.form, own if direct else block)
        quantities.append(_quantities(part.form, part.fixed, part.effects, part.values, shown))
        if part.effects:
            placed = np.zeros((len(own), len(inverse)))
            if part.moments is None:
                placed[:, own_rows] = matrix
            rows.append(placed)
            apart.append(np.zeros_like(own) if part.moments is None else own)
            names += [parameter.name for effect in part.effects for parameter in effect.parameters]
        at += width
    placed = np.concatenate(rows) if rows else np.zeros((0, len(inverse)))
    spread = placed @ inverse @ placed.T
    if any(part.moments is not None for part in parts):
        spread += block_diag(*apart)
    covariance = Covariance(tuple(names), locked((spread + spread.T) / 2.0))
    effects = tuple(part.effects for part in parts)
    return Estimate(tuple(quantities), effects, covariance, signature, explained, tuple(against))


def _built(form: Form, values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
    build = form.candidate.build
    return () if build is None else build(values, fixed)


def _with_patterns(
    problem: Problem, columns: np.ndarray, inverse: np.ndarray, sizes: np.ndarray, beside: RandomEffects
) -> np.ndarray:
    """Covariance of the least-squares values where scatter and patterns without a name are both in the readings."""
    scaled = columns * sizes
    own, _ = pseudo_inverse(problem.inner(scaled))
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
    inverse, _ = pseudo_inverse(problem.inner(scaled))
    slope = problem.along(scaled, problem.project(residual))
    return inverse * np.outer(scale, scale), (inverse @ slope) * scale


def _made(problem: Problem, state: Mapping[str, Any], effects: Sequence[Effect]) -> np.ndarray:
    """(3n,) what effects do to the whitened readings."""
    view, frames = problem.view, problem.network.machine.frames
    index = {(frame.axis, frame.role): i for i, frame in enumerate(frames)}
    found = np.zeros((len(view.rows), 3))
    for effect in effects:
        at = 6 * index[effect.frame.axis, effect.frame.role]
        for i, values in effect.components(state).items():
            found += view.by_error[:, :, at + i] * (np.asarray(values)[:, None] * 1e-6)
    return found.reshape(-1)


def _of_either_form(problem: Problem, forms: Sequence[Form], form: Form, covariance: np.ndarray) -> np.ndarray:
    """Covariance of a cause's numbers, whichever of its forms with the same numbers is the true one."""
    own = form.variant
    same = [
        variant.columns
        for variant in form.candidate.variants
        if variant is not own and variant.fixed == own.fixed and len(variant.columns) == len(own.columns)
    ]
    if not same:
        return covariance
    others = [column for one in forms if one is not form for column in one.variant.columns]
    return upper_bound(covariance, over_forms(problem, [own.columns, *same], others))


def _bent(form: Form, effects: Sequence[Effect]) -> bool:
    """Whether non-linear parameters are among those of its effect."""
    names = form.candidate.specification.bent
    return bool(names and effects) and all(name in effects[0].numbers for name in names)


def _longest(form: Form) -> float:
    """Longest period or time constant that a form can have."""
    tried = [
        variant.fixed[name] for variant in form.candidate.variants for name in form.nonlinear if name in variant.fixed
    ]
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
    if "order" in form.variant.fixed:
        found = (Quantity("order", form.variant.fixed["order"], "1", 0.0), *found)
    if form.candidate.drift is not None and "time_constant" in fixed:
        found = (*found, Quantity("time_constant", fixed["time_constant"], "s", float(u[-1])))
    return found
