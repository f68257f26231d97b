"""The change in the series of one error: step or drift, its date and size, and whether a temperature explains it.

The date of a change is estimated by maximum likelihood over all dates, its 95 % interval by the profile likelihood: all dates with
dof (RSS − RSS_min)/RSS_min ≤ 7.35. This limit holds for a small change; for a large one the interval is too wide, never too narrow
(Hansen 2000, table 1).

A change counts as one of the machine if it is evident even if any one of the temperature sensors may have any linear influence: of
the e-processes with each sensor among the nuisance columns, the least must pass the limit. If only the test without temperature
passes it, the likelihoods decide: a temperature explains the series if it is `RATIO` times as likely as every step and every drift.
Otherwise the series is undecided: time and temperature changed together.

B. E. Hansen: Sample splitting and threshold estimation, Econometrica 68 (2000) 575-603.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
import scipy

from twin._common.arrays import first_largest, largest_first, read_only
from twin.display.numbers import COVERAGE
from twin.watching.evidence import change_shapes, log_evidence, remover, whitening

Verdict = Literal["steady", "changed", "follows temperature", "undecided"]
DATE_LIMIT: Final = 7.35
"""Largest profile likelihood ratio inside the 95 % interval of the date (Hansen 2000)."""
RATIO: Final = 20.0
"""Likelihood ratio from which one explanation counts as better than another."""
LEAST_SHARE: Final = 0.8
"""Share of the checks that must give a temperature, so that it is considered as an explanation."""
LEAST_RANGE_K: Final = 0.2
"""Range of a temperature, K, below which it is not considered."""
LEAST_NOISE: Final = 0.1
"""Least standard deviation between checks, relative to the instrument's stated noise: equal readings do not mean that there is none."""
FIRST_CHECKS: Final = 6
"""Number of checks from which the repeatability is estimated where their instruments' noise differs."""
FEWEST_CHECKS: Final = 8
"""Number of checks from which a correlation from check to check is estimated."""
LAG_BIAS: Final = 2.5
LAG_SCALE: Final = 1.3
"""Constants of the bias of a lag-1 correlation about the most likely change: (LAG_BIAS/n + r) LAG_SCALE."""
MOST_CORRELATION: Final = 0.6


@final
@dataclass(frozen=True)
class ErrorSeries:
    """The deviations of one error from the calibration, one for each check that determines it, in the order of their dates.

    Attributes:
        name: ISO 230-1 name of the error.
        unit: ``um``, ``urad`` or ``um/m``.
        checks: (n,) indices of the checks in the watch.
        days: (n,) dates in days.
        value: (n,) deviations.
        u: (n,) standard uncertainties from the instrument's noise.
        kind: (n,) instruments of the check; each kind has its own level.
        temperature_degC: by sensor, (n,); NaN where not given.
        correlation: of the deviations from one check to the next, which is allowed for.
    """

    name: str
    unit: str
    checks: np.ndarray
    days: np.ndarray
    value: np.ndarray
    u: np.ndarray
    kind: np.ndarray
    temperature_degC: Mapping[str, np.ndarray]
    correlation: float = 0.0

    @property
    def root(self) -> np.ndarray:
        """(n, n) matrix that makes the deviations independent, of unit variance."""
        return np.asarray(whitening(len(self.days), self.correlation) / self.sd)

    @property
    def levels(self) -> np.ndarray:
        """(n, kinds) columns of the levels."""
        kinds = list(dict.fromkeys(self.kind.tolist()))
        return np.stack([self.kind == kind for kind in kinds], axis=1).astype(float)

    @property
    def sensors(self) -> dict[str, np.ndarray]:
        """The temperatures that are considered, without missing values: those of the other checks get the mean."""
        found = {}
        for name, values in self.temperature_degC.items():
            given = np.isfinite(values)
            if given.mean() >= LEAST_SHARE and np.ptp(values[given]) >= LEAST_RANGE_K:
                found[name] = np.where(given, values, values[given].mean())
        return found

    @property
    def sd(self) -> np.ndarray:
        """(n,) standard deviation of each check: instrument noise and the standard deviation between the first checks."""
        first = slice(0, FIRST_CHECKS)
        basis, rank = remover(self.levels[first])
        residual = self.value[first] - basis @ (basis.T @ self.value[first])
        dof = len(residual) - rank
        between = float(residual @ residual) / dof - float(np.mean(self.u[first] ** 2)) if dof > 0 else 0.0
        return np.sqrt(self.u**2 + max(between, 0.0))


@final
@dataclass(frozen=True)
class Change:
    """A change of an error.

    Attributes:
        shape: ``step``, or ``drift`` that grows in proportion to time.
        sure_shape: whether the other shape is less likely by `RATIO`.
        after: number of the last check before the change, as an index into the series.
        day: most likely day: halfway between two checks for a step, a check's for a drift.
        earliest_day, latest_day: limits of its 95 % interval.
        size: change until the last check, in the unit of the error.
        expanded: U of it (95 %, Student).
        per_month: rate of a drift, per 30 days; NaN for a step.
    """

    shape: Literal["step", "drift"]
    sure_shape: bool
    after: int
    day: float
    earliest_day: float
    latest_day: float
    size: float
    expanded: float
    per_month: float


@final
@dataclass(frozen=True)
class TemperatureEffect:
    """A linear influence of a temperature: coefficient per kelvin with U (95 %, Student), log likelihood ratio to the best change."""

    sensor: str
    per_kelvin: float
    expanded: float
    log_ratio: float


@final
@dataclass(frozen=True)
class WatchedError:
    """An error over the checks.

    Attributes:
        series: the series.
        verdict: ``steady``, ``changed`` (whatever a temperature did), ``follows temperature`` or ``undecided``.
        log_evidence: (n,) of a change after each check, temperatures ignored.
        log_evidence_apart: (n,) the same, whatever one of the temperatures explains; NaN without temperatures.
        alarm: index into the series of the check that first passed the limit; None if none did.
        change: the most likely change; None for a steady series.
        temperatures: the sensors that explain a series that follows one, or is undecided; the first is the most likely.
        repeatability: standard deviation of one check about the model of the verdict; NaN if unknown.
        level: deviation from the calibration at the last check, by that model.
        weights: (n,) of the checks in that level.
        fitted: (n,) that model at every check.
    """

    series: ErrorSeries
    verdict: Verdict
    log_evidence: np.ndarray
    log_evidence_apart: np.ndarray
    alarm: int | None
    change: Change | None
    temperatures: tuple[TemperatureEffect, ...]
    repeatability: float
    level: float
    weights: np.ndarray
    fitted: np.ndarray

    @property
    def alarming(self) -> bool:
        """Whether the verdict is an alarm: a change, or one that a temperature could explain."""
        return self.verdict in ("changed", "undecided")


@final
@dataclass(frozen=True)
class _Fit:
    """Weighted least squares.

    Attributes:
        value: coefficients.
        cofactor: their covariance per unit variance.
        rss: weighted sum of squares of the residuals.
        dof: degrees of freedom.
        weights: (n,) of the values in the fit of the last one.
        fitted: (n,) the fit.
    """

    value: np.ndarray
    cofactor: np.ndarray
    rss: float
    dof: int
    weights: np.ndarray
    fitted: np.ndarray


def examine(series: ErrorSeries, limit: float) -> WatchedError:
    """Return what a series shows.

    Args:
        series: the deviations of one error.
        limit: logarithm of the evidence from which it is an alarm, for each of the two tests.
    """
    sd, sensors, levels, correlation = series.sd, series.sensors, series.levels, series.correlation
    least = float(np.min((LEAST_NOISE * series.u / sd) ** 2))
    plain = log_evidence(series.value, series.days, levels, sd, least, correlation)
    apart = np.full(len(plain), np.nan)
    if sensors:
        every = [
            log_evidence(series.value, series.days, np.column_stack([levels, sensor]), sd, least, correlation)
            for sensor in sensors.values()
        ]
        apart = np.min(every, axis=0)
    decisive = apart if sensors else plain
    passed, moved = decisive >= limit, (decisive >= limit) | (plain >= limit)
    alarm = int(np.argmax(moved)) if moved.any() else None
    change = None if alarm is None else _change(series, least, levels)
    temperatures: tuple[TemperatureEffect, ...] = ()
    verdict: Verdict = "steady"
    if passed.any():
        verdict = "changed"
        if sensors:
            change = _change(series, least, _with_best_sensor(series, levels, sensors))
    elif moved.any():
        temperatures = _temperatures(series, least)
        verdict = "follows temperature" if temperatures[0].log_ratio >= np.log(RATIO) else "undecided"
    columns = _model(series, verdict, change, temperatures)
    fit = _fit(series.value, series.root, columns)
    variance = max(fit.rss / fit.dof, least) if fit.dof > 0 else np.nan
    return WatchedError(
        series,
        verdict,
        read_only(plain),
        read_only(apart),
        alarm,
        change,
        temperatures,
        float(np.sqrt(variance * np.mean(sd**2))),
        float(fit.weights @ series.value),
        read_only(fit.weights),
        read_only(fit.fitted),
    )


def _model(
    series: ErrorSeries, verdict: Verdict, change: Change | None, temperatures: tuple[TemperatureEffect, ...]
) -> np.ndarray:
    """Return the columns of the model of a verdict."""
    columns = [series.levels]
    if verdict in ("changed", "undecided") and change is not None:
        columns.append(_shape(series, change.shape, change.after)[:, None])
    if verdict == "follows temperature":
        columns.append(series.sensors[temperatures[0].sensor][:, None])
    return np.concatenate(columns, axis=1)


def _shape(series: ErrorSeries, shape: str, after: int) -> np.ndarray:
    step, drift = change_shapes(series.days)
    return np.asarray((step if shape == "step" else drift)[:, after])


def _fit(value: np.ndarray, root: np.ndarray, columns: np.ndarray) -> _Fit:
    """Fit columns to a series; the last column is the one of interest."""
    x = root @ columns
    inverse = np.linalg.pinv(x, rcond=1e-9)
    found = inverse @ root @ value
    residual = root @ value - x @ found
    dof = len(value) - int(np.linalg.matrix_rank(x, tol=1e-9 * np.abs(x).max()))
    return _Fit(
        found,
        inverse @ inverse.T,
        float(residual @ residual),
        dof,
        columns[-1] @ inverse @ root,
        columns @ found,
    )


def _with_best_sensor(series: ErrorSeries, levels: np.ndarray, sensors: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the levels, with the sensor whose influence beside a change is significant at 1 %, if one is."""
    plain = min(_profile(series, levels)[shape].min() for shape in ("step", "drift"))
    dof = len(levels) - levels.shape[1] - 3
    if dof < 2:
        return levels
    both = {name: np.column_stack([levels, values]) for name, values in sensors.items()}
    rss = {name: min(p.min() for p in _profile(series, columns).values()) for name, columns in both.items()}
    best = _best(rss)
    needed = float(scipy.stats.t.ppf(1.0 - 0.005 / len(sensors), dof)) ** 2
    significant = (plain - rss[best]) * dof > needed * max(rss[best], 1e-300)
    return both[best] if significant else levels


def _profile(series: ErrorSeries, nuisance: np.ndarray) -> dict[str, np.ndarray]:
    """Return the residual sums of squares for a step and for a drift after each check but the last."""
    root = series.root
    basis, _ = remover(root @ nuisance)
    y = root @ series.value
    y = y - basis @ (basis.T @ y)
    found = {}
    for name, shape in zip(("step", "drift"), change_shapes(series.days), strict=True):
        z = root @ shape
        z = z - basis @ (basis.T @ z)
        strength = np.sum(z**2, axis=0)
        along = np.divide((z.T @ y) ** 2, strength, out=np.zeros_like(strength), where=strength > 1e-12)
        found[name] = np.maximum(float(y @ y) - along, 0.0)
    return found


def _best(rss: Mapping[str, np.ndarray]) -> str:
    """Return the name with the least sum of squares; the first of equal ones."""
    return list(rss)[first_largest(-np.array([np.min(own) for own in rss.values()]))]


def _change(series: ErrorSeries, least: float, nuisance: np.ndarray) -> Change:
    """Return the most likely change, with its interval, beside the nuisance columns."""
    profile = {name: rss + least for name, rss in _profile(series, nuisance).items()}
    # A step and a drift in the last interval are the same change.
    shape: Literal["step", "drift"] = "step" if _best(profile) == "step" else "drift"
    own, other = profile[shape], profile["drift" if shape == "step" else "step"]
    after = first_largest(-own)
    fit = _fit(series.value, series.root, np.column_stack([nuisance, _shape(series, shape, after)]))
    dof = max(fit.dof - 1, 1)  # the date is estimated too
    inside = np.flatnonzero(dof * (own - own[after]) / own[after] <= DATE_LIMIT)
    days, last = series.days, len(series.days) - 1
    first, final_ = int(inside[0]), int(inside[-1])
    whole = 1.0 if shape == "step" else float(_shape(series, shape, after)[-1])
    variance = max(fit.rss / dof, least)
    expanded = float(scipy.stats.t.ppf((1.0 + COVERAGE) / 2.0, dof) * np.sqrt(variance * fit.cofactor[-1, -1]))
    return Change(
        shape=shape,
        sure_shape=bool(0.5 * dof * np.log(other.min() / own[after]) >= np.log(RATIO)),
        after=after,
        day=float((days[after] + days[after + 1]) / 2.0 if shape == "step" else days[after]),
        earliest_day=float(days[first] if shape == "step" else days[max(first - 1, 0)]),
        latest_day=float(days[min(final_ + 1, last)]),
        size=float(fit.value[-1] * whole),
        expanded=expanded * whole,
        per_month=float(fit.value[-1]) if shape == "drift" else np.nan,
    )


def _temperatures(series: ErrorSeries, least: float) -> tuple[TemperatureEffect, ...]:
    """Return the sensors by likelihood, without those that are less likely than the first by `RATIO`."""
    profile = _profile(series, series.levels)
    change = min(float(rss.min()) for rss in profile.values()) + least
    found = []
    for name, values in series.sensors.items():
        fit = _fit(series.value, series.root, np.column_stack([series.levels, values]))
        dof = max(fit.dof, 1)
        u = np.sqrt(max(fit.rss / dof, least) * fit.cofactor[-1, -1])
        found.append(
            TemperatureEffect(
                name,
                float(fit.value[-1]),
                float(scipy.stats.t.ppf((1.0 + COVERAGE) / 2.0, dof) * u),
                float(0.5 * dof * np.log(change / (fit.rss + least))),
            )
        )
    ranked = [found[i] for i in largest_first(np.array([one.log_ratio for one in found]))]
    return tuple(one for one in ranked if one.log_ratio >= ranked[0].log_ratio - np.log(RATIO))


def lag_correlation(every: Sequence[ErrorSeries]) -> float:
    """Return the correlation of the deviations from one check to the next, estimated from the series of all errors together.

    It is the mean lag-1 correlation of the residuals about the most likely change beside levels and temperatures, corrected for its
    bias, and not less than zero. Constants of the correction were fitted to drawn series.

    Args:
        every: the series; those of fewer than `FEWEST_CHECKS` do not count.
    """
    found = []
    for series in every:
        count = len(series.days)
        columns = np.column_stack([series.levels, *series.sensors.values()])
        if count < FEWEST_CHECKS + columns.shape[1] - 1:
            columns = series.levels
        if count < FEWEST_CHECKS + columns.shape[1] - 1:
            continue
        profile = _profile(series, columns)
        shape = _best(profile)
        changed = _shape(series, shape, first_largest(-profile[shape]))
        fit = _fit(series.value, series.root, np.column_stack([columns, changed]))
        residual = series.root @ (series.value - fit.fitted)
        whole = float(residual @ residual)
        if whole > 0.0:
            bias = (LAG_BIAS + columns.shape[1] - 1) / count
            found.append(LAG_SCALE * (float(residual[1:] @ residual[:-1]) / whole + bias))
    return float(np.clip(np.mean(found), 0.0, MOST_CORRELATION)) if found else 0.0
