"""The change in the series of one error: step or drift, its date and size, and whether a temperature explains it.

The test is an e-process: the likelihood ratio of "something changed" to "nothing changed", averaged over the possible changes. While
nothing changed its expectation is one, so it exceeds 1/α at any time with a probability of at most α (Ville's inequality), whatever the
number of looks. The change after check c has the share w_c = a/((a + c − 1)(a + c)) of the alarm rate. Level, repeatability and further
nuisance columns are eliminated by invariance to shift and scale (right Haar priors, as in a t-test), for which the bound is exact for
normal deviations of unknown variance (Pérez-Ortiz et al. 2024; Lai 1976); the size of the change has normal priors of several widths
(Robbins 1970). The likelihood of no change is at least `OUTLIER_WEIGHT` times that with an inflated variance of any one check, and the
deviations are whitened for a first-order autoregression. That and the floor of the variance (`least`) only make the ratio smaller.

The date is estimated by maximum likelihood, its 95 % interval by dof (RSS − RSS_min)/RSS_min ≤ 7.35. This limit holds for a small
change; for a large one the interval is too wide, never too narrow (Hansen 2000, table 1). A change counts as one of the machine if the
e-process with each temperature sensor among the nuisance columns passes the limit. Manual: `twin doc watch`.

B. E. Hansen: Sample splitting and threshold estimation, Econometrica 68 (2000) 575-603.
H. Robbins: Statistical methods related to the law of the iterated logarithm, Ann. Math. Statist. 41 (1970) 1397-1409.
T. L. Lai: On confidence sequences, Ann. Statist. 4 (1976) 265-280.
M. F. Pérez-Ortiz, T. Lardy, R. de Heide, P. D. Grünwald: E-statistics, group invariance and anytime-valid testing, Ann. Statist. 52
(2024) 1410-1432.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import first_largest, largest_first, read_only
from twin._common.distributions import student_isf
from twin.display.numbers import COVERAGE

PRIOR_VARIANCES: Final = (1.0, 10.0, 100.0)
"""Prior variances of the change, in squares of the standard deviation of one check."""
POSSIBLE_DATES: Final = 20.0
"""Number of possible dates of a change over which half of the alarm rate is spent."""
MONTH_DAYS: Final = 30.0
"""Time over which a drift is measured, days."""
OUTLIER_VARIANCES: Final = (10.0, 100.0)
"""Additional variances of one check that is far off, in squares of the standard deviation of one check."""
OUTLIER_WEIGHT: Final = 0.1
RANK_TOLERANCE: Final = 1e-9
"""Relative size of singular values that count as zero."""


def spent_share(checks: int) -> float:
    """Return the share of the alarm rate that belongs to changes between the first check and the last of a number of checks."""
    dates = max(checks - 1, 0)
    return dates / (POSSIBLE_DATES + dates)


def change_shapes(days: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (n, n − 1) regressors of a step and of a drift after each check; ``days``: (n,) ascending.

    Column c − 1 belongs to a change after check c. A step is 0 before and 1 after it; a drift is the time since check c in
    `MONTH_DAYS`, 0 before it.
    """
    count = len(days)
    after = np.arange(count)[:, None] > np.arange(count - 1)
    since = np.maximum(days[:, None] - days[None, :-1], 0.0) / MONTH_DAYS
    return after.astype(float), since


def remover(nuisance: np.ndarray) -> tuple[np.ndarray, int]:
    """Return an orthonormal basis (n, r) of the nuisance columns, and its rank r."""
    left, size, _ = np.linalg.svd(nuisance, full_matrices=False)
    rank = int(np.count_nonzero(size > RANK_TOLERANCE * max(float(size.max(initial=0.0)), 1e-300)))
    return left[:, :rank], rank


def whitening(count: int, correlation: float) -> np.ndarray:
    """Return the (n, n) matrix that makes a first-order autoregression of unit variance, ``correlation`` below 1, independent."""
    scale = np.sqrt(1.0 - correlation**2)
    whitening = (np.eye(count) - correlation * np.eye(count, k=-1)) / scale
    whitening[:1, :1] = 1.0
    return np.asarray(whitening)


def log_evidence(
    values: np.ndarray,
    days: np.ndarray,
    nuisance: np.ndarray,
    sd: np.ndarray | None = None,
    least: float = 0.0,
    correlation: float = 0.0,
) -> np.ndarray:
    """Return the logarithm of the e-process after each check, in the shape of ``values``; 0 means that nothing is known.

    ``values``: (n,) or (n, series) deviations by ascending ``days``; ``nuisance``: (n, p) columns, one the level, whose influence is
    eliminated; ``sd``: (n,) relative standard deviations, equal if None; ``least``: floor of the variance, in units of ``sd``
    squared.
    """
    sd = np.ones(len(days)) if sd is None else sd
    white = whitening(len(days), correlation)
    y = white @ (values.T / sd).T.reshape(len(days), -1)
    x = white @ (nuisance / sd[:, None])
    # Relative to the first check, so that the priors of the size are in standard deviations whatever the unit of ``sd``.
    shapes = [white @ (shape * (sd[0] / sd)[:, None]) for shape in change_shapes(days)]
    evidence = np.zeros_like(y)
    for n in range(3, len(days) + 1):
        evidence[n - 1] = _log_ratio(y[:n], x[:n], [shape[:n, : n - 1] for shape in shapes], white[:n, :n], least)
    return evidence.reshape(np.shape(values))


def _log_ratio(
    y: np.ndarray, x: np.ndarray, shapes: list[np.ndarray], outliers: np.ndarray, least: float
) -> np.ndarray:
    """Return (series,) the logarithm of the averaged likelihood ratio of the checks so far; all arguments are whitened.

    ``y``: (n, series); ``x``: (n, p) nuisance columns; ``shapes`` of steps and drifts; ``outliers``: (n, n), one a check; ``least``:
    floor of the variance.
    """
    count = len(y)
    basis, rank = remover(x)
    dof = count - rank
    y = y - basis @ (basis.T @ y)
    if dof < 2:
        return np.zeros(y.shape[1])
    logs = np.concatenate([_log_ratios(y, basis, dof, shape, PRIOR_VARIANCES, least) for shape in shapes])
    each = logs - np.log(len(logs))
    dates = np.arange(1.0, count)
    weight = POSSIBLE_DATES / ((POSSIBLE_DATES + dates - 1.0) * (POSSIBLE_DATES + dates))
    top = np.maximum(each.max(axis=(0, 1)), 0.0)
    inside = np.einsum("c,kcs->s", weight, np.exp(each - top))
    later = POSSIBLE_DATES / (POSSIBLE_DATES + count - 1.0)
    changed = top + np.log(inside + later * np.exp(-top))
    far_off = _log_ratios(y, basis, dof, outliers, OUTLIER_VARIANCES, least).max(axis=(0, 1))
    return np.asarray(changed - np.maximum(far_off + np.log(OUTLIER_WEIGHT), 0.0))


def _log_ratios(
    y: np.ndarray, basis: np.ndarray, dof: int, shape: np.ndarray, variances: tuple[float, ...], least: float
) -> np.ndarray:
    """Return (variances, columns, series) the logarithms of the likelihood ratios of a random multiple of each column to none."""
    rss = np.sum(y**2, axis=0) + least
    z = shape - basis @ (basis.T @ shape)
    strength = np.sum(z**2, axis=0)[:, None]
    along = (z.T @ y) ** 2
    logs = []
    for variance in variances:
        gain = 1.0 + variance * strength
        explained = np.divide(variance * along / gain, rss, out=np.zeros_like(along), where=rss > 0.0)
        share = np.minimum(explained, 1.0 - 1e-12)
        logs.append(-0.5 * np.log(gain) - 0.5 * dof * np.log1p(-share))
    return np.stack(logs)


Verdict = Literal["steady", "changed", "follows temperature", "undecided"]
DATE_LIMIT: Final = 7.35
"""Largest profile likelihood ratio inside the 95 % interval of the date (Hansen 2000)."""
BETTER_LIKELIHOOD_RATIO: Final = 20.0
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
    """The deviations of one error from the calibration, one for each check that determines it, in the order of their dates."""

    name: str  # ISO 230-1
    unit: str  # ``um``, ``urad`` or ``um/m``
    checks: np.ndarray  # (n,) indices of the checks in the watch
    days: np.ndarray  # (n,) dates in days
    value: np.ndarray  # (n,) deviations
    u: np.ndarray  # (n,) standard uncertainties from the instrument's noise
    kind: np.ndarray  # (n,) instruments of the check; each kind has its own level
    temperature_degC: Mapping[str, np.ndarray]  # by sensor, (n,); NaN where not given
    correlation: float = 0.0  # of the deviations from one check to the next, which is allowed for

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
        sensors = {}
        for name, values in self.temperature_degC.items():
            given = np.isfinite(values)
            if given.mean() >= LEAST_SHARE and np.ptp(values[given]) >= LEAST_RANGE_K:
                sensors[name] = np.where(given, values, values[given].mean())
        return sensors

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
    """A change of an error."""

    shape: Literal["step", "drift"]  # ``step``, or ``drift`` that grows in proportion to time
    sure_shape: bool  # whether the other shape is less likely by `BETTER_LIKELIHOOD_RATIO`
    after: int  # number of the last check before the change, as an index into the series
    day: float  # most likely day: halfway between two checks for a step, a check's for a drift
    earliest_day: float  # limits of its 95 % interval
    latest_day: float
    size: float  # change until the last check, in the unit of the error
    expanded: float  # U of it (95 %, Student)
    per_month: float  # rate of a drift, per 30 days; NaN for a step


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
    """An error over the checks."""

    series: ErrorSeries
    verdict: Verdict  # ``steady``, ``changed`` (whatever a temperature did), ``follows temperature`` or ``undecided``
    log_evidence: np.ndarray  # (n,) of a change after each check, temperatures ignored
    log_evidence_apart: np.ndarray  # (n,) the same, whatever one of the temperatures explains; NaN without temperatures
    alarm: int | None  # index into the series of the check that first passed the limit; None if none did
    change: Change | None  # the most likely change; None for a steady series
    temperatures: tuple[TemperatureEffect, ...]  # that explain a series, most likely first
    repeatability: float  # standard deviation of one check about the model of the verdict; NaN if unknown
    level: float  # deviation from the calibration at the last check, by that model
    weights: np.ndarray  # (n,) of the checks in that level
    fitted: np.ndarray  # (n,) that model at every check

    @property
    def alarming(self) -> bool:
        """Whether the verdict is an alarm: a change, or one that a temperature could explain."""
        return self.verdict in ("changed", "undecided")


@final
@dataclass(frozen=True)
class _Fit:
    """Weighted least squares."""

    value: np.ndarray  # coefficients
    cofactor: np.ndarray  # their covariance per unit variance
    rss: float  # weighted sum of squares of the residuals
    dof: int  # degrees of freedom
    weights: np.ndarray  # (n,) of the values in the fit of the last one
    fitted: np.ndarray  # (n,) the fit


def examine(series: ErrorSeries, limit: float) -> WatchedError:
    """Return what a series shows; ``limit``: logarithm of the evidence from which it is an alarm, for each of the two tests."""
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
        verdict = "follows temperature" if temperatures[0].log_ratio >= np.log(BETTER_LIKELIHOOD_RATIO) else "undecided"
    columns = levels
    if verdict in ("changed", "undecided") and change is not None:
        columns = np.column_stack([levels, _shape(series, change.shape, change.after)])
    elif verdict == "follows temperature":
        columns = np.column_stack([levels, sensors[temperatures[0].sensor]])
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


def _shape(series: ErrorSeries, shape: str, after: int) -> np.ndarray:
    step, drift = change_shapes(series.days)
    return np.asarray((step if shape == "step" else drift)[:, after])


def _fit(value: np.ndarray, root: np.ndarray, columns: np.ndarray) -> _Fit:
    """Fit columns to a series; the last column is the one of interest."""
    x = root @ columns
    inverse = np.linalg.pinv(x, rcond=1e-9)
    estimate = inverse @ root @ value
    residual = root @ value - x @ estimate
    dof = len(value) - int(np.linalg.matrix_rank(x, tol=1e-9 * np.abs(x).max()))
    return _Fit(
        estimate, inverse @ inverse.T, float(residual @ residual), dof, columns[-1] @ inverse @ root, columns @ estimate
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
    needed = float(student_isf(0.005 / len(sensors), dof)) ** 2
    significant = (plain - rss[best]) * dof > needed * max(rss[best], 1e-300)
    return both[best] if significant else levels


def _profile(series: ErrorSeries, nuisance: np.ndarray) -> dict[str, np.ndarray]:
    """Return the residual sums of squares for a step and for a drift after each check but the last."""
    root = series.root
    basis, _ = remover(root @ nuisance)
    y = root @ series.value
    y = y - basis @ (basis.T @ y)
    profile = {}
    for name, shape in zip(("step", "drift"), change_shapes(series.days), strict=True):
        z = root @ shape
        z = z - basis @ (basis.T @ z)
        strength = np.sum(z**2, axis=0)
        along = np.divide((z.T @ y) ** 2, strength, out=np.zeros_like(strength), where=strength > 1e-12)
        profile[name] = np.maximum(float(y @ y) - along, 0.0)
    return profile


def _best(rss: Mapping[str, np.ndarray]) -> str:
    """Return the name with the least sum of squares; the first of equal ones."""
    return list(rss)[first_largest(-np.array([np.min(own) for own in rss.values()]))]


def _change(series: ErrorSeries, least: float, nuisance: np.ndarray) -> Change:
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
    expanded = float(student_isf((1.0 - COVERAGE) / 2.0, dof) * np.sqrt(variance * fit.cofactor[-1, -1]))
    return Change(
        shape=shape,
        sure_shape=bool(0.5 * dof * np.log(other.min() / own[after]) >= np.log(BETTER_LIKELIHOOD_RATIO)),
        after=after,
        day=float((days[after] + days[after + 1]) / 2.0 if shape == "step" else days[after]),
        earliest_day=float(days[first] if shape == "step" else days[max(first - 1, 0)]),
        latest_day=float(days[min(final_ + 1, last)]),
        size=float(fit.value[-1] * whole),
        expanded=expanded * whole,
        per_month=float(fit.value[-1]) if shape == "drift" else np.nan,
    )


def _temperatures(series: ErrorSeries, least: float) -> tuple[TemperatureEffect, ...]:
    """Return the sensors by likelihood, without those that are less likely than the first by `BETTER_LIKELIHOOD_RATIO`."""
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
                float(student_isf((1.0 - COVERAGE) / 2.0, dof) * u),
                float(0.5 * dof * np.log(change / (fit.rss + least))),
            )
        )
    ranked = [found[i] for i in largest_first(np.array([one.log_ratio for one in found]))]
    return tuple(one for one in ranked if one.log_ratio >= ranked[0].log_ratio - np.log(BETTER_LIKELIHOOD_RATIO))


def lag_correlation(every: Sequence[ErrorSeries]) -> float:
    """Return the correlation of the deviations from one check to the next, estimated from the series of all errors together.

    It is the mean lag-1 correlation of the residuals about the most likely change beside levels and temperatures, corrected for its
    bias, and not less than zero. Constants of the correction were fitted to drawn series; those of fewer than `FEWEST_CHECKS` do not
    count.
    """
    correlations = []
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
            correlations.append(LAG_SCALE * (float(residual[1:] @ residual[:-1]) / whole + bias))
    return float(np.clip(np.mean(correlations), 0.0, MOST_CORRELATION)) if correlations else 0.0
