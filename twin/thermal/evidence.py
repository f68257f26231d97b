"""Evidence of subsets of candidate terms, and the average over the subsets that the data allow.

The residual of a displacement is a stationary process with exponential correlation (neighbouring rows are alike) plus white noise. The
coefficients have normal priors, so that the evidence of a subset has a closed form (Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, eq. 2.43 to 2.45). Subsets are drawn by Markov chain Monte Carlo over models (Madigan and York, International
Statistical Review 63, 1995); means and covariances over the draws are those of Bayesian model averaging (Hoeting et al., Statistical
Science 14, 1999).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin.numerics.functions import follow
from twin.thermal.record import ThermalRecord

EXPONENTS: Final = (1.0, 2.0)
"""Exponents of the speed: bearing friction from load heats with the speed, viscous friction and centrifugal force with its square."""
ALIKE: Final = 0.05
"""Largest mean correlation distance inside a group of sensors or displacements (correlation above 0.95)."""
PRIOR_UM_PER_K: Final = 8.0
"""Prior standard deviation of a temperature coefficient: a metal part of 0.7 m."""
PRIOR_SPEED_UM: Final = 15.0
"""Prior standard deviation of the growth at the highest speed of the data."""
PRIOR_DRIFT_UM: Final = 5.0
"""Prior standard deviation of the drift that decays from the unknown state at the start."""
MIN_VARIATION_K: Final = 0.1
"""A sensor that varies by less (standard deviation) is not used."""


@final
@dataclass(frozen=True)
class TermCandidate:
    """One possible term, linear in its coefficient.

    Attributes:
        effect: ``thermal_lag``, ``spindle_growth``, ``spindle_shift`` (without lag) or ``thermal_drift``.
        sensors: sensors whose mean is followed; empty for speed and drift.
        time_constant_s: time constant of the first-order lag; 0 without lag.
        exponent: exponent of the speed; 0 for other effects.
        prior: prior standard deviation of the coefficient, µm/K or µm.
    """

    effect: str
    sensors: tuple[str, ...]
    time_constant_s: float
    exponent: float
    prior: float


@final
@dataclass(frozen=True)
class Inputs:
    """Reference values of the inputs.

    ``reference_degC``: temperature of each sensor at the start of the fitted record; ``highest_rpm``: highest speed of the fitted
    record; 0 without speeds.
    """

    reference_degC: dict[str, float]
    highest_rpm: float
    start_s: float


def sensor_groups(record: ThermalRecord, length: int) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    """Return the groups of sensors that the record cannot distinguish, and the sensors that do not vary.

    Groups are clusters of average linkage by correlation of the temperatures averaged over ``length`` rows.
    """
    values = averaged(record.temperature_degC, length)
    varies = values.std(axis=0) >= MIN_VARIATION_K
    names = [name for name, used in zip(record.sensors, varies, strict=True) if used]
    flat = tuple(name for name, used in zip(record.sensors, varies, strict=True) if not used)
    return clusters(values[:, varies], names), flat


def clusters(values: np.ndarray, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return names grouped by the correlation of their columns (n, names), in the order of first appearance."""
    if len(names) < 2:
        return [(name,) for name in names]
    centred = (values - values.mean(axis=0)).T
    label = scipy.cluster.hierarchy.fcluster(
        scipy.cluster.hierarchy.linkage(centred, "average", metric="correlation"), ALIKE, "distance"
    )
    groups: dict[int, list[str]] = {}
    for name, number in zip(names, label, strict=True):
        groups.setdefault(int(number), []).append(name)
    return [tuple(group) for group in groups.values()]


def averaged(values: np.ndarray, length: int) -> np.ndarray:
    """Return means over consecutive ``length`` rows (n, m) → (n // length, m); a shorter last part is not used."""
    count = len(values) // length
    return values[: count * length].reshape(count, length, -1).mean(axis=1)


def time_constants(duration_s: float) -> list[float]:
    """Return the time constants of the candidates: doubling from 1/140 to about 1/4 of the duration.

    Shorter lags do not show in averages over 1/140 of the duration; a record holds too few responses with longer ones.
    """
    return [float(f"{duration_s / 139.0 * 2.0**k:.2g}") for k in range(6)]


def candidates(groups: Sequence[tuple[str, ...]], speeds: bool, duration_s: float) -> list[TermCandidate]:
    """Return all candidate terms."""
    lags = time_constants(duration_s)
    candidates = [
        TermCandidate("thermal_lag", group, tau, 0.0, PRIOR_UM_PER_K) for group in groups for tau in (0.0, *lags)
    ]
    if speeds:
        candidates += [TermCandidate("spindle_shift", (), 0.0, power, PRIOR_SPEED_UM) for power in EXPONENTS]
        candidates += [
            TermCandidate("spindle_growth", (), tau, power, PRIOR_SPEED_UM) for power in EXPONENTS for tau in lags
        ]
    candidates += [TermCandidate("thermal_drift", (), tau, 0.0, PRIOR_DRIFT_UM) for tau in (*lags[1:], 2.0 * lags[-1])]
    return candidates


def lagged(
    values: np.ndarray, time_s: np.ndarray, time_constant_s: float, state: float | None = None, *, held: bool = False
) -> np.ndarray:
    """Return the first-order lag of an input that is linear between rows, or has each row's value since the row before; (n,).

    ``values``: the input (n,); ``time_s``: times (n,); ``time_constant_s``: 0 returns the input; ``state``: state at the first row; the
    first value (steady state) if None.
    """
    if time_constant_s == 0.0:
        return np.array(values, dtype=float)
    first = float(values[0]) if state is None else state
    return np.r_[
        first,
        follow(np.diff(time_s), values[1 if held else 0 :][: len(values) - 1], values[1:], time_constant_s, first),
    ]


def drivers(record: ThermalRecord, terms: Sequence[TermCandidate], inputs: Inputs) -> np.ndarray:
    """Return the input of every term before its lag (n, terms): K above the reference, or relative speed to its exponent, or 0."""
    index = {name: i for i, name in enumerate(record.sensors)}
    drivers = np.zeros((len(record), len(terms)))
    for j, term in enumerate(terms):
        if term.sensors:
            columns = [record.temperature_degC[:, index[name]] - inputs.reference_degC[name] for name in term.sensors]
            drivers[:, j] = np.mean(columns, axis=0)
        elif term.exponent and record.speed_rpm is not None:
            drivers[:, j] = (record.speed_rpm / max(inputs.highest_rpm, 1e-9)) ** term.exponent
    return drivers


def features(
    record: ThermalRecord, terms: Sequence[TermCandidate], inputs: Inputs, states: np.ndarray | None = None
) -> np.ndarray:
    """Return the value of every term for coefficient 1, (n, terms).

    ``states``: state of every lag at the first row; if None, steady state for temperatures, and a spindle that starts there.
    """
    features = drivers(record, terms, inputs)
    for j, term in enumerate(terms):
        if term.effect == "thermal_drift":
            features[:, j] = -np.expm1(-(record.time_s - inputs.start_s) / term.time_constant_s)
        else:
            held = term.exponent > 0.0
            state = float(states[j]) if states is not None else 0.0 if held else None
            features[:, j] = lagged(features[:, j], record.time_s, term.time_constant_s, state, held=held)
    return features


# --- Evidence of subsets of candidate terms, and the average over the subsets that the data allow -

TERM_COST: Final = 3.0
"""Prior log odds against each candidate: some three terms are expected among sixty candidates."""
DRIFT_COST: Final = 6.0
"""The same for a drift, which has no measured cause and fits any slow change."""
STEPS: Final = 8000
BURN_IN: Final = 0.25
THINNING: Final = 20
CONSTANT_UM: Final = 2.0
"""Prior standard deviation of the constant: displacements count from the start of the record."""
RESIDUAL_SHARES: Final = np.geomspace(0.03, 1.5, 11)
"""Standard deviations of the residual tried, relative to the displacement's variation."""
RESIDUAL_TIME: Final = 2.0
"""Correlation time of the residual in durations of the record: it wanders, since what no term describes lasts as long as they do."""


LEAST_SHARE: Final = 1e-3
"""Least share of a model in an average, relative to the largest."""
DENSE_SIZES: Final = (0.01, 0.03, 0.1, 0.3)
"""Sizes tried of a candidate's part in a displacement, in the model with all of them, relative to the displacement's variation."""


@final
@dataclass(frozen=True)
class Average:
    """Average over models, for one displacement; the last coefficient is the constant.

    ``mean``: (terms + 1,), µm/K or µm; ``covariance``: (terms + 1, terms + 1), within and between models.
    """

    mean: np.ndarray
    covariance: np.ndarray
    residual_um: float


@final
@dataclass(frozen=True)
class DrawnModels:
    """Drawn models of a group of displacements. ``models``: indices of the candidates of every drawn model of few terms."""

    models: tuple[tuple[int, ...], ...]
    averages: tuple[Average, ...]


Share = tuple[tuple[int, ...], int, float | np.ndarray, float]
"""Indices of the candidates of a model, kind of its residual, factor on its priors, and its share of an average."""


class Evidence:
    """Evidence of every subset of candidates for the displacements of one group."""

    def __init__(
        self,
        x: np.ndarray,
        y: np.ndarray,
        time_s: np.ndarray,
        terms: Sequence[TermCandidate],
        noise_um: np.ndarray,
        duration_s: float,
    ) -> None:
        """Prepare the normal equations for every size and correlation time of the residual.

        ``x``: candidates (n, terms); ``y``: displacements (n, m) in µm; ``time_s``: (n,); ``noise_um``: white noise of the
        displacements (m,).
        """
        self.scale = np.r_[[term.prior for term in terms], CONSTANT_UM]
        self.count = x.shape[1]
        self._alike = 1.0 / (np.maximum(x.std(axis=0), 1e-9) * self.scale[:-1])
        drift = np.array([term.effect == "thermal_drift" for term in terms])
        self._cost = np.where(drift, DRIFT_COST, TERM_COST)
        self._alike[drift] = 0.0
        self.size = y.shape[1]
        self._known: dict[tuple[tuple[int, ...], int, int], float] = {}
        design = np.c_[x, np.ones(len(x))] * self.scale
        correlation = np.exp(-np.abs(time_s[:, None] - time_s) / (RESIDUAL_TIME * duration_s))
        self.spread_um = [max(float(y[:, c].std()), float(noise_um[c]), 1e-3) for c in range(self.size)]
        self.residual_um = [[spread * share for share in RESIDUAL_SHARES] for spread in self.spread_um]
        self._normal: list[list[tuple[np.ndarray, np.ndarray, float]]] = []
        for c in range(self.size):
            kinds = []
            for size in self.residual_um[c]:
                covariance = size**2 * correlation + (noise_um[c] ** 2 + 1e-8) * np.eye(len(x))
                factor = np.linalg.cholesky(covariance)
                white = scipy.linalg.solve_triangular(factor, np.c_[design, y[:, c]], lower=True)
                product = white.T @ white
                rest = 0.5 * product[-1, -1] + float(np.log(np.diag(factor)).sum())
                kinds.append((product[:-1, :-1], product[:-1, -1], rest))
            self._normal.append(kinds)

    def log_evidence(
        self, chosen: Sequence[int], displacement: int, kind: int, times: float | np.ndarray = 1.0
    ) -> float:
        """Return the log evidence of a subset for one displacement and one kind of residual; ``times``: factor on the terms' priors."""
        _, normal, right = self._scaled(chosen, displacement, kind, times)
        factor = np.linalg.cholesky(normal)
        half = np.linalg.solve(factor, right)
        return float(0.5 * half @ half - np.log(np.diag(factor)).sum() - self._normal[displacement][kind][2])

    def coefficients(
        self, chosen: Sequence[int], displacement: int, kind: int, times: float | np.ndarray = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of the coefficients of a subset, the constant last; arguments as of `log_evidence`."""
        index, normal, right = self._scaled(chosen, displacement, kind, times)
        covariance = np.linalg.inv(normal)
        scale = self.scale[index] * _with_constant(times, len(index))
        return covariance @ right * scale, covariance * np.outer(scale, scale)

    def _all_terms(self, displacement: int) -> tuple[list[Share], float]:
        """Return the models with all candidates but drifts, and their log evidence together.

        Every candidate's part in the displacement has one prior standard deviation: this is ridge regression on all lags. Where many
        sensors warm up together, it predicts what follows better than any few of them.
        """
        every = tuple(range(self.count))
        tried = [
            (size * self.spread_um[displacement] * self._alike, kind)
            for size in DENSE_SIZES
            for kind in range(len(self.residual_um[displacement]))
        ]
        found = np.array([self.log_evidence(every, displacement, kind, times) for times, kind in tried])
        together = float(np.logaddexp.reduce(found))
        shares = np.exp(found - together)
        return [
            (every, kind, times, float(share)) for (times, kind), share in zip(tried, shares, strict=True)
        ], together - float(np.log(len(tried)))

    def _scaled(
        self, chosen: Sequence[int], displacement: int, kind: int, times: float | np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the indices of a subset, its normal matrix with the priors, and the right-hand side."""
        matrix, right, _ = self._normal[displacement][kind]
        index = np.array([*chosen, self.count])
        factor = _with_constant(times, len(index))
        normal = matrix[index[:, None], index] * np.outer(factor, factor) + np.eye(len(index))
        return index, normal, right[index] * factor

    def draw(self, generator: np.random.Generator, steps: int = STEPS) -> DrawnModels:
        """Draw models from their posterior distribution and return their average.

        The log evidence is the mean over the displacements of the group: they move together and are not independent observations.
        """
        kinds = len(self.residual_um[0])
        chosen: list[int] = []
        kind = [int(np.argmax([self.log_evidence(chosen, c, k) for k in range(kinds)])) for c in range(self.size)]
        now = self._posterior(chosen, kind)
        drawn = []
        for step in range(steps):
            new, new_kind = self._proposal(chosen, kind, generator)
            value = self._posterior(new, new_kind)
            if np.log(generator.random()) < value - now:
                chosen, kind, now = new, new_kind, value
            if step >= BURN_IN * steps and step % THINNING == 0:
                drawn.append((tuple(sorted(chosen)), tuple(kind)))
        averages = tuple(self._average([(model, k[c]) for model, k in drawn], c) for c in range(self.size))
        return DrawnModels(tuple(model for model, _ in drawn), averages)

    def _posterior(self, chosen: Sequence[int], kind: Sequence[int]) -> float:
        model = tuple(sorted(chosen))
        evidence = sum(self._known_evidence(model, c, kind[c]) for c in range(self.size)) / self.size
        return evidence - float(self._cost[list(chosen)].sum())

    def _known_evidence(self, model: tuple[int, ...], displacement: int, kind: int) -> float:
        """Return `log_evidence`; most models are proposed again and again."""
        key = (model, displacement, kind)
        if key not in self._known:
            self._known[key] = self.log_evidence(model, displacement, kind)
        return self._known[key]

    def _proposal(
        self, chosen: list[int], kind: list[int], generator: np.random.Generator
    ) -> tuple[list[int], list[int]]:
        """Return a neighbour: another kind of residual, a term exchanged, added or removed; the proposal is symmetric."""
        way = generator.random()
        if way < 0.15:
            new_kind = list(kind)
            new_kind[int(generator.integers(self.size))] = int(generator.integers(len(self.residual_um[0])))
            return chosen, new_kind
        one = int(generator.integers(self.count))
        if way < 0.55:
            if one in chosen or not chosen:
                return chosen, kind
            place = int(generator.integers(len(chosen)))
            return [*chosen[:place], one, *chosen[place + 1 :]], kind
        return ([j for j in chosen if j != one] if one in chosen else [*chosen, one]), kind

    def _average(self, drawn: Sequence[tuple[tuple[int, ...], int]], displacement: int) -> Average:
        """Return the average over drawn models and those with all terms, both kinds by their evidence (equal prior probability).

        Evidence is the probability that a model gave, before each reading, to that reading (A. P. Dawid, J. R. Statist. Soc. A 147
        (1984) 278-292). That of the drawn models is the mean over the draws of their joint probability, plus the entropy of the draws.
        """
        counted = {one: times / len(drawn) for one, times in Counter(drawn).items()}
        evidence = -float(np.log1p(np.exp(-self._cost)).sum() + np.log(len(self.residual_um[displacement])))
        for (model, kind), share in counted.items():
            joint = self._known_evidence(model, displacement, kind) - float(self._cost[list(model)].sum())
            evidence += share * (joint - np.log(share))
        every, other = self._all_terms(displacement)
        few = float(scipy.special.expit(evidence - other))
        size = self.count + 1
        mean, second, variance = np.zeros(size), np.zeros((size, size)), 0.0
        parts: list[Share] = [(model, kind, 1.0, few * share) for (model, kind), share in counted.items()]
        parts += [(model, kind, times, (1.0 - few) * share) for model, kind, times, share in every]
        least = LEAST_SHARE * max(share for *_, share in parts)
        parts = [part for part in parts if part[-1] > least]
        total = sum(share for *_, share in parts)
        for model, kind, times, share in parts:
            value, covariance = self.coefficients(model, displacement, kind, times)
            index = np.array([*model, self.count])
            mean[index] += share / total * value
            second[index[:, None], index] += share / total * (covariance + np.outer(value, value))
            variance += share / total * self.residual_um[displacement][kind] ** 2
        return Average(mean, second - np.outer(mean, mean), float(np.sqrt(variance)))


def _with_constant(times: float | np.ndarray, count: int) -> np.ndarray:
    """Return a factor for each coefficient, one for the constant, which is the last."""
    return np.append(np.broadcast_to(times, count - 1), 1.0)
