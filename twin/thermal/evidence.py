"""Evidence of subsets of candidate terms, and the average over the subsets that the data allow.

The residual of a displacement is a stationary process with exponential correlation (neighbouring rows are alike) plus white noise. The
coefficients have normal priors, so that the evidence of a subset has a closed form (Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, eq. 2.43 to 2.45). Subsets are drawn by Markov chain Monte Carlo over models (Madigan and York, International
Statistical Review 63, 1995); means and covariances over the draws are those of Bayesian model averaging (Hoeting et al., Statistical
Science 14, 1999).
"""

from __future__ import annotations

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


def lagged(values: np.ndarray, time_s: np.ndarray, time_constant_s: float, state: float | None = None) -> np.ndarray:
    """Return the first-order lag of an input that is linear between rows; (n,).

    ``values``: the input (n,); ``time_s``: times (n,); ``time_constant_s``: 0 returns the input; ``state``: state at the first row; the
    first value (steady state) if None.
    """
    if time_constant_s == 0.0:
        return np.array(values, dtype=float)
    first = float(values[0]) if state is None else state
    return np.r_[first, follow(np.diff(time_s), values[:-1], values[1:], time_constant_s, first)]


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

    ``states``: state of every lag at the first row; steady state if None.
    """
    features = drivers(record, terms, inputs)
    for j, term in enumerate(terms):
        if term.effect == "thermal_drift":
            features[:, j] = -np.expm1(-(record.time_s - inputs.start_s) / term.time_constant_s)
        else:
            state = None if states is None else float(states[j])
            features[:, j] = lagged(features[:, j], record.time_s, term.time_constant_s, state)
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
RESIDUAL_SHARES: Final = np.geomspace(0.03, 0.7, 9)
RESIDUAL_TIMES: Final = (48.0, 24.0, 12.0, 6.0)
"""Correlation times of the residual tried: the record's duration divided by these."""


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

    def with_other(self, other: Average, weight: float) -> Average:
        """Return the average of this, with a weight of 0 to 1, and another; their disagreement counts as uncertainty."""
        apart = self.mean - other.mean
        return Average(
            weight * self.mean + (1.0 - weight) * other.mean,
            weight * self.covariance
            + (1.0 - weight) * other.covariance
            + weight * (1.0 - weight) * np.outer(apart, apart),
            float(np.sqrt(weight * self.residual_um**2 + (1.0 - weight) * other.residual_um**2)),
        )


@final
@dataclass(frozen=True)
class DrawnModels:
    """Drawn models of a group of displacements. ``models``: indices of the candidates of every drawn model."""

    models: tuple[tuple[int, ...], ...]
    averages: tuple[Average, ...]


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
        drift = np.array([term.effect == "thermal_drift" for term in terms])
        self._cost = np.where(drift, DRIFT_COST, TERM_COST)
        self.size = y.shape[1]
        design = np.c_[x, np.ones(len(x))] * self.scale
        distance = np.abs(time_s[:, None] - time_s[None, :])
        self.residual_um: list[list[float]] = []
        self._normal: list[list[tuple[np.ndarray, np.ndarray, float]]] = []
        for c in range(self.size):
            spread = max(float(y[:, c].std()), float(noise_um[c]), 1e-3)
            self.residual_um.append([spread * share for _ in RESIDUAL_TIMES for share in RESIDUAL_SHARES])
            kinds = []
            for part in RESIDUAL_TIMES:
                correlation = np.exp(-distance * part / duration_s)
                for share in RESIDUAL_SHARES:
                    covariance = (spread * share) ** 2 * correlation + (noise_um[c] ** 2 + 1e-8) * np.eye(len(x))
                    factor = np.linalg.cholesky(covariance)
                    white = np.linalg.solve(factor, np.c_[design, y[:, c]])
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

    def dense(self, displacement: int, sizes: np.ndarray) -> Average:
        """Return the estimate with all candidates, whose small coefficients have one size: ridge regression on all lags.

        The common size and the kind of residual are those of the largest evidence. Where many sensors warm up together, it predicts
        what follows better than any few of them.

        ``sizes``: (terms,) coefficients that are alike, µm/K or µm.
        """
        every, factor = range(self.count), sizes / self.scale[:-1]
        tried = [(times * factor, kind) for times in DENSE_SIZES for kind in range(len(self.residual_um[displacement]))]
        times, kind = max(tried, key=lambda one: self.log_evidence(every, displacement, one[1], one[0]))
        mean, covariance = self.coefficients(every, displacement, kind, times)
        return Average(mean, covariance, self.residual_um[displacement][kind])

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
        evidence = sum(self.log_evidence(chosen, c, kind[c]) for c in range(self.size)) / self.size
        return evidence - float(self._cost[list(chosen)].sum())

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
        size = self.count + 1
        mean, second, variance = np.zeros(size), np.zeros((size, size)), 0.0
        for (model, kind), times in _counted(drawn):
            value, covariance = self.coefficients(model, displacement, kind)
            index = np.array([*model, self.count])
            mean[index] += times * value
            second[index[:, None], index] += times * (covariance + np.outer(value, value))
            variance += times * self.residual_um[displacement][kind] ** 2
        mean, second = mean / len(drawn), second / len(drawn)
        return Average(mean, second - np.outer(mean, mean), float(np.sqrt(variance / len(drawn))))


def _with_constant(times: float | np.ndarray, count: int) -> np.ndarray:
    """Return a factor for each coefficient, one for the constant, which is the last."""
    return np.append(np.broadcast_to(times, count - 1), 1.0)


def _counted(drawn: Sequence[tuple[tuple[int, ...], int]]) -> list[tuple[tuple[tuple[int, ...], int], int]]:
    counts: dict[tuple[tuple[int, ...], int], int] = {}
    for one in drawn:
        counts[one] = counts.get(one, 0) + 1
    return list(counts.items())
