"""Estimate of all parameters of the causes, non-linear ones included, together with the set-up, and its cluster-robust covariance.

The noise alone gives an estimate's covariance only if the model fits. Where it does not, neighbouring readings share the misfit, and
the covariance is estimated from the differences between groups (Huber 1967; White 1982, eq. 3.2; groups as in Liang and Zeger 1986), as
in `twin.identification.solve`. It is never smaller than the covariance due to noise.

Weights of the noise alone (25 times better along a tracker's beam than across) would select and size the causes by the unexplained
residuals along the beam, at the expense of the others. Tests of consistency compare the residuals with the noise alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.distributions import chi2_sf, f_sf
from twin.diagnosis.candidates.candidate import STRAIGHT_LINE, Column, Drift, effect_columns
from twin.diagnosis.candidates.machine import variant_at
from twin.diagnosis.forms import LEAST_NONCENTRALITY, RESOLVED, Candidates, Form, pseudo_inverse
from twin.diagnosis.problem import Problem, rewhitened, unwhiten
from twin.diagnosis.readings import DiagnosisTask
from twin.diagnosis.result import Quantity
from twin.identification.discrepancy import Discrepancy, no_discrepancy, settled, updated
from twin.measurement.observation import machine_state, repeat_groups
from twin.model.effects import Effect
from twin.model.effects.base import numbered
from twin.model.effects.gravity_compliance import AddedLoad
from twin.numerics.covariance import Covariance

LACK_OF_FIT: Final = 0.01  # p-value below which there is a lack of fit
MANY_ROUNDS: Final = 20
"""Number of rounds from which rounds are the groups; with fewer, poses are: an axis repeats its error at a pose in every round."""
LEAST_GROUPS: Final = 6  # number of groups below which no covariance is estimated from them


def lacks_fit(problem: Problem, residual: np.ndarray, parameters: int, noise_dof: float) -> bool:
    """Return whether (3n,) residuals of a fit exceed the noise, overall or in the means of repeats (test of lack of fit)."""
    projected = problem.project(residual)
    dof = problem.dof - parameters
    tests = [(float(residual @ projected), dof)]
    group = repeat_groups(problem.network.data)
    size = np.bincount(group)
    if size.max() > 1:
        means = np.stack([np.bincount(group, projected[i::3]) for i in range(3)], axis=1) / np.sqrt(size)[:, None]
        read = np.stack([np.bincount(group, problem.network.read[:, i]) > 0 for i in range(3)], axis=1)
        free = int(read.sum()) - (problem.readings - problem.dof) - parameters
        tests.append((float(np.sum(means**2)), free))
    return any(
        float(f_sf(chi2 / free, free, noise_dof) if np.isfinite(noise_dof) else chi2_sf(chi2, free)) < LACK_OF_FIT
        for chi2, free in tests
        if free > 0
    )


def robust_covariance(
    problem: Problem, columns: np.ndarray, residual: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the cluster-robust covariance of an estimate, in no direction below that due to noise, and the number of groups.

    With too few groups: the covariance (k, k) due to noise, and infinity. ``columns`` are the (3n, k) signatures that were fitted.
    """
    data = problem.network.data
    # The group of each row is its round, or its commanded pose where there are few rounds.
    names, group = np.unique(data.round.astype(str), return_inverse=True)
    if len(names) < MANY_ROUNDS:
        _, group = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = int(group.max()) + 1
    if count < LEAST_GROUPS:
        return covariance, float("inf")
    projected = problem.project(columns)
    projected_residual = problem.project(residual)
    scores = np.zeros((count, columns.shape[1]))
    np.add.at(scores, np.repeat(group, 3), projected * projected_residual[:, None])
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    flat = scores @ root
    # Eigenvalues relative to the covariance due to noise.
    share, axes = np.linalg.eigh(flat.T @ flat * (count / (count - 1)))
    rotated = root @ axes
    return np.asarray((rotated * np.maximum(share, 1.0)) @ rotated.T), float(count)


def upper_bound(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return a covariance (k, k) that is an upper bound of two: the larger along each common eigenvector; zero where the first is."""
    size = np.sqrt(np.maximum(np.diag(first), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(first / np.outer(scale, scale))
    kept = values > 1e-12 * values[-1]
    root = (scale[:, None] * vectors[:, kept]) * np.sqrt(values[kept])
    inverse_root = (vectors[:, kept] / np.sqrt(values[kept])).T / scale
    share, axes = np.linalg.eigh(inverse_root @ second @ inverse_root.T)
    rotated = root @ axes
    return np.asarray((rotated * np.maximum(share, 1.0)) @ rotated.T)


TIME_CONSTANT_GRID: Final = 81  # number of time constants at which the likelihood of a drift is evaluated
NOT_IDENTIFIABLE: Final = 1e-6  # share of a drift's squared norm, given other causes, below which it is not seen
NARROW_LIKELIHOOD: Final = 0.15  # relative uncertainty of a time constant below which its likelihood is normal
DECISIVE_CHI2: Final = 4.0
"""Reduction of chi² (two standard deviations) by which the less usual of exponential and straight line must fit better."""
INTEGRATED_SIGMA: Final = 5.0  # standard deviations about the best over which a narrow likelihood is integrated


def fit_drift(problem: Problem, drift: Drift, others: Sequence[Column]) -> tuple[float, np.ndarray, np.ndarray | None]:
    """Return time constant, linear parameters (w,) and second moments (w + 1, w + 1) of the most likely drift given other causes.

    No moments for a straight line, and where the likelihood is treated as normal. Where the time constant is as long as the record,
    amplitude and time constant are strongly correlated and the curvature at the optimum does not describe their uncertainty. Their
    moments under the profile likelihood do; they are taken over the constants tried, with a prior uniform in the logarithm.
    """
    tried = np.geomspace(drift.constants[0], drift.constants[-1], TIME_CONSTANT_GRID)
    gain, values, covariance = _profile(
        problem, [drift.columns(tau) for tau in (*tried.tolist(), STRAIGHT_LINE)], others
    )
    best = int(np.argmax(gain[:-1]))
    ahead = gain[best] - gain[-1]
    if not np.isfinite(gain).all() or ahead < (DECISIVE_CHI2 if drift.straight else -DECISIVE_CHI2):
        return STRAIGHT_LINE, values[-1], None
    likelihood = np.exp((gain[:-1] - gain[best]) / 2.0)
    likelihood /= likelihood.sum()
    relative = float(np.sqrt(likelihood @ np.log(tried / tried[best]) ** 2))
    if relative < NARROW_LIKELIHOOD and likelihood[0] + likelihood[-1] < 1e-3:
        if not drift.straight:
            return float(tried[best]), values[best], None
        # Refine the grid around the best value, over the width of the likelihood.
        step = float(np.log(tried[1] / tried[0]))
        reach = max(INTEGRATED_SIGMA * relative, 2.0 * step)
        for _ in range(3):
            tried = tried[best] * np.exp(np.linspace(-reach, reach, TIME_CONSTANT_GRID))
            gain, values, covariance = _profile(problem, [drift.columns(tau) for tau in tried.tolist()], others)
            best = int(np.argmax(gain))
            likelihood = np.exp((gain - gain[best]) / 2.0)
            likelihood /= likelihood.sum()
            step, reach = (
                2.0 * reach / (TIME_CONSTANT_GRID - 1),
                INTEGRATED_SIGMA * float(np.sqrt(likelihood @ np.log(tried / tried[best]) ** 2)),
            )
            if reach > 4.0 * INTEGRATED_SIGMA * step:
                break
            reach = max(reach, 2.0 * step)
    else:
        values, covariance = values[:-1], covariance[:-1]
    deviations = np.concatenate([values - values[best], (tried - tried[best])[:, None]], axis=1)
    moments = (deviations * likelihood[:, None]).T @ deviations
    moments[:-1, :-1] += np.einsum("k,kij->ij", likelihood, covariance)
    return float(tried[best]), values[best], moments


def over_forms(problem: Problem, forms: Sequence[Sequence[Column]], others: Sequence[Column]) -> np.ndarray:
    """Return second moments (w, w) of the parameters about those of the first form, the forms weighted by their likelihood."""
    gain, values, covariance = _profile(problem, forms, others)
    likelihood = np.exp((gain - gain.max()) / 2.0)
    likelihood /= likelihood.sum()
    deviations = values - values[0]
    return np.asarray(
        (deviations * likelihood[:, None]).T @ deviations + np.einsum("k,kij->ij", likelihood, covariance)
    )


PERIOD_STEPS: Final = 5  # periods tried between the middles of two intervals of the tabulated ones
NEAR_PERIOD: Final = (
    0.6  # share of the chi² explained by the best tabulated period from which on others are compared with it
)


def fitting_periods(candidates: Candidates, form: Form, others: Sequence[Form]) -> tuple[np.ndarray, np.ndarray]:
    """Return periods (m,) that fit as well as that of a form or nearly, mm, and the reduction of chi² by each given others.

    Between two tabulated periods a wave loses up to a fifth of its chi², more than an alias does: the maxima are
    compared. Periods are a wave over the measured span apart.
    """
    problem, name, explained = candidates.problem, form.candidate.specification.period, candidates.scan(others)[0]
    machine, data = problem.network.machine, problem.network.data
    state, span = machine_state(data, machine), np.ptp(data.positions[:, machine.names.index(form.candidate.where)])
    tried = [other for other in candidates.forms if other.key == form.key]
    most = NEAR_PERIOD * max(float(explained[other.index]) for other in tried)
    given = [column for other in others for column in other.variant.columns]
    found: list[tuple[float, float]] = []
    for other in tried:
        if explained[other.index] >= most:
            frequencies = 1.0 / other.variant.fixed[name] + np.linspace(-0.25, 0.25, PERIOD_STEPS) / span
            fixed = [{**other.variant.fixed, name: float(1.0 / f)} for f in frequencies]
            columns = [variant_at(form.candidate, own, machine, state).columns for own in fixed]
            gain, best = _vertex(_profile(problem, columns, given)[0])
            found.append((gain, float(np.interp(best, np.arange(PERIOD_STEPS), frequencies))))
    kept: list[tuple[float, float]] = []
    for gain, frequency in sorted(found, reverse=True):
        if all(abs(frequency - better) * span > RESOLVED for _, better in kept):
            kept.append((gain, frequency))
    return np.array([1.0 / frequency for _, frequency in kept]), np.array([gain for gain, _ in kept])


def refine_far_periods(candidates: Candidates, forms: Sequence[Form]) -> bool:
    """Refine periods that fit better than those of the causes, far from them; return whether there are any."""
    better = False
    for form in forms:
        if not form.candidate.specification.period:
            continue
        others = [other for other in forms if other is not form]
        (best, *_), gains = fitting_periods(candidates, form, others)
        name = form.candidate.specification.period
        tried = [other for other in candidates.forms if other.key == form.key]
        near = min(tried, key=lambda other: abs(1.0 / other.variant.fixed[name] - 1.0 / best))
        if near.index != form.index and gains[0] > candidates.scan(others)[0][form.index]:
            network = candidates.problem.network
            state = machine_state(network.data, network.machine)
            fixed = {**near.variant.fixed, name: float(best)}
            candidates.refine(near, variant_at(near.candidate, fixed, network.machine, state))
            better = True
    return better


def _vertex(values: np.ndarray) -> tuple[float, float]:
    """Return the maximum of evenly spaced values and its index, by the parabola through the largest and its neighbours."""
    k = int(np.clip(np.argmax(values), 1, len(values) - 2))
    before, middle, after = values[k - 1 : k + 2].tolist()
    bend = before - 2.0 * middle + after
    shift = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend < 0.0 else 0.0
    return max(float(values.max()), middle - 0.25 * (before - after) * shift), k + shift


def _profile(
    problem: Problem, forms: Sequence[Sequence[Column]], others: Sequence[Column]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for each form its chi² reduction given the others (m,), parameters (m, w) and their covariance (m, w, w)."""
    columns = [[replace(column, scale=1.0) for column in own] for own in forms]
    width = len(columns[0])
    count = width * len(forms)
    products = problem.products([*(column for own in columns for column in own), *others])
    given = slice(count, None)
    inverse = pseudo_inverse(products.gram[given, given]) if others else np.zeros((0, 0))
    gain, values, covariance = np.zeros(len(forms)), np.zeros((len(forms), width)), np.zeros((len(forms), width, width))
    for k in range(len(forms)):
        own = slice(k * width, (k + 1) * width)
        cross = products.gram[given, own]
        whole = np.diag(products.gram[own, own])
        # All parameters have the same unit: directions small against the largest are not identifiable.
        size = float(np.sqrt(max(whole.max(), 1e-300)))
        block = (products.gram[own, own] - cross.T @ inverse @ cross) / size**2
        slope = (products.slope[own] - cross.T @ (inverse @ products.slope[given])) / size
        weights, vectors = np.linalg.eigh(block)
        seen = weights > NOT_IDENTIFIABLE
        root = vectors[:, seen] / np.sqrt(weights[seen])
        along = root.T @ slope
        gain[k] = along @ along if seen.any() else -np.inf
        values[k] = root @ along / size
        covariance[k] = root @ root.T / size**2
    return gain, values, covariance


STEPS: Final = 12  # Gauss-Newton steps, at most
CONVERGED_STEP: Final = 1e-6  # step, in standard deviations, below which the iteration has converged
BLOCK_COLUMNS: Final = 64  # columns of random effects evaluated at a time


@final
@dataclass(frozen=True)
class RandomEffects:
    """Patterns without a name as random effects, and the noise estimated with them."""

    random: Sequence[tuple[Column, float]]  # columns, each with its standard deviation in the column's unit
    variance_factor: float  # on the stated noise variances


@final
@dataclass(frozen=True)
class Estimate:
    """Estimated parameters of some causes."""

    quantities: tuple[tuple[Quantity, ...], ...]  # reported parameters of each cause
    effects: tuple[tuple[Effect, ...], ...]  # of each cause; none for one in the instrument
    covariance: Covariance  # of the parameters of all effects, by their names in a calibration
    signature: np.ndarray  # (3n, k) contribution of each cause to the whitened readings, held out or not
    explained: float  # reduction of chi²
    # of each cause: Wald statistic, number of its parameters, and of groups that the covariance is from (infinite for stated noise)
    wald: tuple[tuple[float, int, float], ...] = ()


@dataclass
class _Part:
    """One cause during the joint fit."""

    form: Form
    fixed: dict[str, float]  # non-linear parameters that are not fitted with the others
    scales: np.ndarray  # (w,) plausible sizes of its parameters
    columns: np.ndarray  # (3n, w) derivatives of the whitened readings at the current values
    values: np.ndarray  # (w,)
    effects: tuple[Effect, ...]  # with these parameters; none for a cause in the instrument
    nonlinear: bool  # the columns depend on the parameters
    moments: np.ndarray | None = None  # of the parameters of a drift whose likelihood is not normal

    def set_values(self, values: np.ndarray, longest: float) -> None:
        """Set the parameters, within the effect's limits; ``longest`` is the longest period or time constant tried."""
        self.values = values
        if not self.nonlinear:
            self.effects = _effects(self.form, values, self.fixed)
            return
        constrain = self.form.candidate.specification.constrain
        if constrain is not None:
            self.effects = (constrain(self.effects[0], [float(value) for value in values], longest),)
        self.values = np.array([parameter.value for parameter in self.effects[0].parameters])

    def set_drift(self, problem: Problem, drift: Drift, others: Sequence[Column]) -> None:
        """Set a drift to its maximum-likelihood fit given the other causes."""
        time_constant, self.values, self.moments = fit_drift(problem, drift, others)
        variant = drift.variant(time_constant)
        self.fixed = dict(variant.fixed)
        self.scales = np.array([column.scale for column in variant.columns])
        self.columns = problem.signature(variant.columns) / self.scales
        self.effects = _effects(self.form, self.values, self.fixed)
        self.nonlinear = self.moments is None and time_constant != STRAIGHT_LINE

    def linearise(self, problem: Problem, state: Mapping[str, Any]) -> None:
        """Evaluate the columns at the current parameters."""
        if self.nonlinear:
            derived = effect_columns(self.effects[0], problem.network.machine, state)
            self.scales = np.array([column.scale for column in derived])
            self.columns = problem.signature(derived) / self.scales
            self.values = np.array([parameter.value for parameter in self.effects[0].parameters])

    def signature(self, problem: Problem, state: Mapping[str, Any]) -> np.ndarray:
        """Return the contribution (3n,) to the whitened readings."""
        return _signature_of(problem, state, self.effects) if self.nonlinear else np.asarray(self.columns @ self.values)


def estimate(
    problem: Problem,
    forms: Sequence[Form],
    noise_dof: float = float("inf"),
    random_effects: RandomEffects | None = None,
    least: float = LEAST_NONCENTRALITY,
) -> Estimate:
    """Estimate all parameters of the causes by Gauss-Newton iteration, with the set-up projected out.

    Random effects are not fitted but increase the covariance; a direction is identifiable from a noncentrality of ``least`` on.
    """
    if not forms:
        return Estimate((), (), Covariance.none(), np.zeros((len(problem.residual), 0)), 0.0)
    state = machine_state(problem.network.data, problem.network.machine)
    parts, inverse, signature = _fitted(problem, forms, state, least)
    columns = np.concatenate([part.columns for part in parts], axis=1)
    scales = np.concatenate([part.scales for part in parts])
    residual = problem.residual - signature.sum(axis=1)
    explained = problem.chi2 - float(residual @ problem.project(residual))
    groups = float("inf")
    by_patterns = None if random_effects is None else _with_patterns(problem, columns, inverse, scales, random_effects)
    if lacks_fit(problem, residual, columns.shape[1], noise_dof):
        wide, groups = robust_covariance(problem, columns * scales, residual, inverse / np.outer(scales, scales))
        inverse = wide * np.outer(scales, scales)
    if by_patterns is not None:
        inverse = upper_bound(inverse, by_patterns)
    wide = inverse + _by_compliances(problem, parts, state)
    return _reported(problem, parts, inverse, wide, signature, explained, groups)


def fitted_effects(problem: Problem, forms: Sequence[Form]) -> tuple[list[tuple[Effect, ...]], np.ndarray]:
    """Return the effects of each of k ≥ 1 causes with their parameters as `estimate` finds them, and the (3n, k) signatures."""
    parts, _, signature = _fitted(problem, forms, machine_state(problem.network.data, problem.network.machine))
    return [part.effects for part in parts], signature


def _fitted(
    problem: Problem, forms: Sequence[Form], state: Mapping[str, Any], least: float = LEAST_NONCENTRALITY
) -> tuple[list[_Part], np.ndarray, np.ndarray]:
    """Return the fitted causes, the covariance of all parameters, and the (3n, k) signature of each cause."""
    parts = _initial_parts(problem, forms, least)
    inverse = _gauss_newton(problem, parts, state, least)
    named = iter(numbered(effect for part in parts for effect in part.effects))
    for part in parts:
        part.effects = tuple(next(named) for _ in part.effects)
    return parts, inverse, np.stack([part.signature(problem, state) for part in parts], axis=1)


def _initial_parts(problem: Problem, forms: Sequence[Form], least: float) -> list[_Part]:
    """Return all causes with parameters from a linear fit, and each drift with its most likely time constant given the others."""
    scales = [np.array([column.scale for column in form.variant.columns]) for form in forms]
    columns = [problem.signature(form.variant.columns) / sizes for form, sizes in zip(forms, scales, strict=True)]
    _, start = _least_squares(problem, np.concatenate(columns, axis=1), problem.residual, np.concatenate(scales), least)
    values = np.split(start, np.cumsum([len(sizes) for sizes in scales])[:-1])
    parts = []
    for form, sizes, signature, start_values in zip(forms, scales, columns, values, strict=True):
        fixed = dict(form.variant.fixed)
        effects = _effects(form, start_values, fixed)
        nonlinear = form.candidate.drift is None and _is_nonlinear(form, effects)
        parts.append(_Part(form, fixed, sizes, signature, start_values, effects, nonlinear))
    for part in parts:
        drift = part.form.candidate.drift
        if drift is not None:
            others = [column for form in forms if form is not part.form for column in form.variant.columns]
            part.set_drift(problem, drift, others)
    return parts


def _gauss_newton(problem: Problem, parts: Sequence[_Part], state: Mapping[str, Any], least: float) -> np.ndarray:
    """Iterate until convergence and return the covariance of all parameters at the last step."""
    longest = [max((part.form.candidate.range(name) for name in part.form.nonlinear), default=np.inf) for part in parts]
    for _ in range(STEPS if any(part.nonlinear for part in parts) else 1):
        for part in parts:
            part.linearise(problem, state)
        residual = problem.residual - np.sum([part.signature(problem, state) for part in parts], axis=0)
        sizes = np.concatenate([part.scales for part in parts])
        inverse, step = _least_squares(
            problem, np.concatenate([part.columns for part in parts], axis=1), residual, sizes, least
        )
        change = float(np.sqrt(max(step @ np.linalg.pinv(inverse, hermitian=True) @ step, 0.0)))
        ends = np.cumsum([len(part.values) for part in parts])[:-1]
        for part, part_step, most in zip(parts, np.split(step, ends), longest, strict=True):
            part.set_values(part.values + part_step, most)
        if change < CONVERGED_STEP:
            break
    return inverse


def _reported(
    problem: Problem,
    parts: Sequence[_Part],
    inverse: np.ndarray,
    wide: np.ndarray,
    signature: np.ndarray,
    explained: float,
    groups: float,
) -> Estimate:
    """Return the parameters with their covariance, as they are reported and as they stand in a calibration.

    ``inverse`` is the covariance by the readings alone, for the test whether a cause is there; ``wide`` that of the sizes.
    """
    forms = [part.form for part in parts]
    wald, quantities, transforms, drift_moments, names, at = [], [], [], [], [], 0
    for part in parts:
        width = part.columns.shape[1]
        own_rows = slice(at, at + width)
        test = inverse[own_rows, own_rows] / np.outer(part.scales, part.scales)
        wald.append((*_wald(part.values / part.scales, test), groups))
        block = wide[own_rows, own_rows]
        matrix, build = np.eye(width), part.form.candidate.build
        if build is not None and not part.nonlinear:
            # The parameters of a calibration are linear in those that are fitted.
            matrix = np.array([list(_parameters(build(unit, part.fixed)).values()) for unit in matrix]).T
        covariance_block = matrix @ block @ matrix.T if part.moments is None else part.moments
        direct = part.form.candidate.space is not None or part.nonlinear or part.moments is not None
        reported = _over_variants(problem, forms, part.form, covariance_block if direct else block)
        quantities.append(_quantities(part.form, part.fixed, part.effects, part.values, reported))
        if part.effects:
            transform = np.zeros((len(covariance_block), len(inverse)))
            if part.moments is None:
                transform[:, own_rows] = matrix
            transforms.append(transform)
            drift_moments.append(np.zeros_like(covariance_block) if part.moments is None else covariance_block)
            names += list(_parameters(part.effects))
        at += width
    transform = np.concatenate(transforms) if transforms else np.zeros((0, len(inverse)))
    spread = transform @ wide @ transform.T
    if any(part.moments is not None for part in parts):
        spread += scipy.linalg.block_diag(*drift_moments)
    covariance = Covariance(tuple(names), read_only((spread + spread.T) / 2.0))
    effects = tuple(part.effects for part in parts)
    return Estimate(tuple(quantities), effects, covariance, signature, explained, tuple(wald))


def _effects(form: Form, values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
    build = form.candidate.build
    return () if build is None else build(values, fixed)


def _with_patterns(
    problem: Problem, columns: np.ndarray, inverse: np.ndarray, sizes: np.ndarray, random_effects: RandomEffects
) -> np.ndarray:
    """Return the covariance of the least-squares values when noise and random effects both act on the readings."""
    scaled = columns * sizes
    inverse_gram = pseudo_inverse(problem.inner(scaled))
    gain = np.zeros((len(sizes), len(random_effects.random)))
    for start in range(0, len(random_effects.random), BLOCK_COLUMNS):
        some = random_effects.random[start : start + BLOCK_COLUMNS]
        signature = problem.signature([column for column, _ in some]) * [deviation for _, deviation in some]
        gain[:, start : start + BLOCK_COLUMNS] = inverse_gram @ (scaled.T @ problem.project(signature))
    return inverse * random_effects.variance_factor + (gain @ gain.T) * np.outer(sizes, sizes)


def _by_compliances(problem: Problem, parts: Sequence[_Part], state: Mapping[str, Any]) -> np.ndarray:
    """Return the (w, w) share of the covariance of all parameters due to the compliances by which added loads act (GUM 5.1.2).

    Their uncertainties are taken as independent. A compliance that is not known counts with a plausible size (`AddedLoad.beside`).
    """
    scales = np.concatenate([part.scales for part in parts])
    added = [effect for part in parts for effect in part.effects if isinstance(effect, AddedLoad)]
    loads = [effect for load in added for effect in (load, *load.beside) if effect.relative_u > 0.0]
    if not loads:
        return np.zeros((len(scales), len(scales)))
    scaled = np.concatenate([part.columns for part in parts], axis=1) * scales
    moved = np.stack([load.relative_u * _signature_of(problem, state, (load,)) for load in loads], axis=1)
    inverse_gram = pseudo_inverse(problem.inner(scaled))
    gain = inverse_gram @ (scaled.T @ problem.project(moved))
    return np.asarray((gain @ gain.T) * np.outer(scales, scales))


def _wald(values: np.ndarray, covariance: np.ndarray) -> tuple[float, int]:
    eigenvalues, vectors = np.linalg.eigh(covariance)
    kept = eigenvalues > 1e-12 * eigenvalues[-1]
    along = vectors[:, kept].T @ values
    return float(np.sum(along**2 / eigenvalues[kept])), int(kept.sum())


def _parameters(effects: Sequence[Effect]) -> dict[str, float]:
    """Return the parameters of a cause by name; effects of one cause in several frames share theirs."""
    return {parameter.name: parameter.value for effect in effects for parameter in effect.parameters}


def _least_squares(
    problem: Problem, columns: np.ndarray, residual: np.ndarray, scale: np.ndarray, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return covariance and least-squares step; both are zero along directions that are not identifiable; overwrites ``columns``."""
    scaled = np.multiply(columns, scale, out=columns)
    gram, slope = problem.normal_equations(scaled, residual)
    inverse = pseudo_inverse(gram, least)
    return inverse * np.outer(scale, scale), (inverse @ slope) * scale


def _signature_of(problem: Problem, state: Mapping[str, Any], effects: Sequence[Effect]) -> np.ndarray:
    """Return the contribution (3n,) of effects to the whitened readings."""
    view, frames = problem.view, problem.network.machine.frames
    index = {(frame.axis, frame.role): i for i, frame in enumerate(frames)}
    shift_m = np.zeros((len(view.rows), 3))
    for effect in effects:
        at = 6 * index[effect.frame.axis, effect.frame.role]
        for i, values in effect.components(state).items():
            shift_m += view.by_error[:, :, at + i] * (np.asarray(values)[:, None] * 1e-6)
    return shift_m.reshape(-1)


def _over_variants(problem: Problem, forms: Sequence[Form], form: Form, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance of a cause's parameters, allowing for its other variants with the same parameters."""
    selected = form.variant
    same = [
        variant.columns
        for variant in form.candidate.variants
        if variant is not selected and variant.fixed == selected.fixed and len(variant.columns) == len(selected.columns)
    ]
    if not same:
        return covariance
    others = [column for other in forms if other is not form for column in other.variant.columns]
    return upper_bound(covariance, over_forms(problem, [selected.columns, *same], others))


def _is_nonlinear(form: Form, effects: Sequence[Effect]) -> bool:
    """Return whether the effect has the form's non-linear parameters among its own."""
    names = form.candidate.specification.nonlinear
    return bool(names and effects) and all(name in effects[0].numbers for name in names)


def _converted(
    reported: Callable[[np.ndarray], np.ndarray], values: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters reported and their covariance, to first order (GUM 5.2.2)."""
    steps = 1e-4 * np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    slopes = np.stack(
        [(reported(values + step) - reported(values - step)) / (2.0 * step.sum()) for step in np.diag(steps)], axis=1
    )
    return reported(values), slopes @ covariance @ slopes.T


def _quantities(
    form: Form, fixed: Mapping[str, float], effects: Sequence[Effect], values: np.ndarray, covariance: np.ndarray
) -> tuple[Quantity, ...]:
    """Return the estimated parameters of a cause and the numbers that its specification states, in the order of an entry."""
    stated = {**form.variant.fixed, **(effects[0].numbers if effects else {})}
    specification = form.candidate.specification
    by_name = {
        name: Quantity(name, float(stated[name]), unit, 0.0)
        for name, unit in specification.fixed.items()
        if name in stated
    }
    by_name |= {quantity.name: quantity for quantity in _estimated(form, fixed, effects, values, covariance)}
    order = [name for name in specification.parameters if name in by_name]
    return tuple(by_name[name] for name in (*order, *(name for name in by_name if name not in order)))


def _estimated(
    form: Form, fixed: Mapping[str, float], effects: Sequence[Effect], values: np.ndarray, covariance: np.ndarray
) -> list[Quantity]:
    candidate, drift = form.candidate, form.candidate.drift
    if candidate.reported is not None:
        values, covariance = _converted(candidate.reported, values, covariance)
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if _is_nonlinear(form, effects):
        return [
            Quantity(p.name.rsplit(".", 1)[-1], p.value, p.unit, deviation)
            for p, deviation in zip(effects[0].parameters, u.tolist(), strict=True)
        ]
    if effects and candidate.space is not None:
        return [
            Quantity(f"c{k}", p.value, p.unit, deviation, coefficient=True)
            for k, (p, deviation) in enumerate(zip(effects[0].parameters, u.tolist(), strict=True))
        ]
    if effects and drift is not None:
        # A time constant longer than the record: only rates are identifiable, and from them the drift over the record.
        hours = drift.constants[-1] / 3600.0
        rates = [
            Quantity(p.name.rsplit(".", 1)[-1], p.value, p.unit, deviation)
            for p, deviation in zip(effects[0].parameters, u.tolist(), strict=True)
        ]
        over_record = zip(candidate.names, rates, strict=True)
        return [
            *(Quantity(name, rate.value * hours, unit, rate.u * hours) for (name, unit), rate in over_record),
            *rates,
        ]
    estimated = [
        Quantity(name, float(value), unit, float(deviation))
        for (name, unit), value, deviation in zip(candidate.names, values, u, strict=False)
        if deviation > 1e-9 * u.max()  # a parameter that is not identifiable is left out
    ]
    # Parameters that the search fixed within their bounds, such as a centre that the readings do not determine.
    estimated += [
        Quantity(name, form.variant.fixed[name], unit, float("nan"))
        for name, unit in candidate.names[len(values) :]
        if name in form.variant.fixed
    ]
    if drift is not None and drift.name in fixed:
        estimated.append(Quantity(drift.name, fixed[drift.name], "s", float(u[-1])))
    return estimated


REWEIGHTINGS: Final = 4  # number of estimates with other weights, at most
LOST: Final = 1e-6  # share of its earlier standard uncertainty below which that of a parameter is rounding


def remaining_discrepancy(
    task: DiagnosisTask, forms: Sequence[Form], estimated: Estimate, patterned: Problem | None = None
) -> Discrepancy:
    """Return the discrepancy of the residuals that causes, and patterns if any, leave.

    Without the problem ``patterned``, with the patterns projected out, they count as discrepancy.
    """
    network, problem = task.by_noise.network, task.problem if patterned is None else patterned
    residual = problem.residual - rewhitened(estimated.signature.sum(axis=1), task.problem.network, problem.network)
    residual_m = unwhiten(problem.network, problem.project(residual).reshape(-1, 3)[:, :, None])[:, :, 0]
    # A direction with a prior takes up the share of a reading that its posterior variance has lost.
    absorbed = len(problem.nuisances.coordinates) - float(np.sum(problem.nuisances.prior**2))
    share = min((absorbed + _width(forms)) / problem.readings, 1.0)
    taken_up = share * task.problem.network.covariance
    return updated(network, task.discrepancy, residual_m, taken_up, np.ones(len(residual_m), dtype=bool))


def reweighted(
    task: DiagnosisTask, forms: Sequence[Form], estimated: Estimate, random_effects: RandomEffects | None
) -> tuple[Estimate, Discrepancy]:
    """Return the estimate with all that the causes leave in its weights, patterns too, and this discrepancy.

    The same estimate where the causes fit. The reduction of chi² and the Wald statistics stay as they are: they are tests.
    """
    by_noise = task.by_noise
    whitened_residual = by_noise.residual - rewhitened(
        estimated.signature.sum(axis=1), task.problem.network, by_noise.network
    )
    if not forms or not lacks_fit(by_noise, whitened_residual, _width(forms), task.noise.dof):
        return estimated, no_discrepancy(by_noise.network)
    weighted, again = task, estimated
    for attempt in range(REWEIGHTINGS):
        further = remaining_discrepancy(weighted, forms, again)
        if settled(by_noise.network, weighted.discrepancy, further) or attempt == REWEIGHTINGS - 1:
            break
        weighted = weighted.with_discrepancy(further)
        again = estimate(weighted.problem, forms, np.inf, random_effects)
        if not _has_sizes(again, estimated):
            # Named by the readings, a cause has a size, even if these weights would no longer show its largest plausible one.
            again = estimate(weighted.problem, forms, np.inf, random_effects, least=0.0)
    signature = rewhitened(again.signature, weighted.problem.network, task.problem.network)
    return (
        replace(again, signature=read_only(signature), explained=estimated.explained, wald=estimated.wald),
        weighted.discrepancy,
    )


def _has_sizes(again: Estimate, estimated: Estimate) -> bool:
    """Return whether no cause has lost its uncertainty, and with it its size, against an earlier estimate."""

    def largest_u(quantities: Sequence[Quantity]) -> float:
        return max((q.u for q in quantities if np.isfinite(q.u)), default=0.0)

    pairs = zip(again.quantities, estimated.quantities, strict=True)
    return all(largest_u(now) > LOST * largest_u(before) or largest_u(before) == 0.0 for now, before in pairs)


def _width(forms: Sequence[Form]) -> int:
    return sum(len(form.variant.columns) for form in forms)
