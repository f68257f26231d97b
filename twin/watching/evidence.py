"""Sequential test for a change in a series of checks, valid whatever the number of looks.

The test statistic is an e-process: the likelihood ratio of "something changed" to "nothing changed", averaged over the possible
changes. While nothing changed its expectation is one, so it exceeds 1/α at any time with a probability of at most α (Ville's
inequality). The number of looks need not be fixed in advance, and a further look costs nothing. The alarm rate is spent over the
dates of the change instead of over the looks: the change after check c has the share w_c = a/((a + c − 1)(a + c)) of it, and all
shares sum to one. A group sequential boundary (Lan and DeMets 1983) would need the last look, or an information time, which a watch
does not have; and its levels would have to be computed anew for every repeatability.

Neither the level nor the repeatability of the checks is known. Both are eliminated: the ratio is that of the data reduced by
invariance to shift and scale (right Haar priors, as in a t-test), for which the bound is exact for normal deviations of unknown
variance (Pérez-Ortiz et al. 2024; Lai 1976). Further nuisance columns are eliminated in the same way: the level of each kind of
check, and a temperature with an unknown coefficient. The change is a step, or a drift from its date on; its size in standard
deviations has normal priors of several widths (Robbins 1970).

Two departures from independent, normal deviations are allowed for. The unchanged machine may have one check far off: the likelihood
of no change is at least `OUTLIER_WEIGHT` times that with an inflated variance of any one check. A single check is then hardly
evidence, the second one of a step is. And the deviations may be correlated from check to check (first-order autoregression); they
are then whitened. The first only makes the ratio smaller. With the second, the bound is as good as the estimate of the correlation.

The floor of the variance (`least`) is a small part of the instrument's. It only makes the ratio smaller, so the bound is kept.

K. K. G. Lan, D. L. DeMets: Discrete sequential boundaries for clinical trials, Biometrika 70 (1983) 659-663.
H. Robbins: Statistical methods related to the law of the iterated logarithm, Ann. Math. Statist. 41 (1970) 1397-1409.
T. L. Lai: On confidence sequences, Ann. Statist. 4 (1976) 265-280.
M. F. Pérez-Ortiz, T. Lardy, R. de Heide, P. D. Grünwald: E-statistics, group invariance and anytime-valid testing, Ann. Statist. 52
(2024) 1410-1432.
"""

from __future__ import annotations

from typing import Final

import numpy as np

PRIOR_VARIANCES: Final = (1.0, 10.0, 100.0)
"""Prior variances of the change, in squares of the standard deviation of one check."""
DATES: Final = 20.0
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
    return dates / (DATES + dates)


def change_shapes(days: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the regressors of a step and of a drift after each check.

    Args:
        days: (n,) dates in days, ascending.

    Returns:
        Two arrays (n, n − 1): column c − 1 belongs to a change after check c. A step is 0 before and 1 after it; a drift is the time
        since check c in `MONTH_DAYS`, 0 before it.
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
    """Return the matrix (n, n) that makes a first-order autoregression of unit variance independent.

    Args:
        count: number of checks.
        correlation: from one check to the next, below 1.
    """
    scale = np.sqrt(1.0 - correlation**2)
    found = (np.eye(count) - correlation * np.eye(count, k=-1)) / scale
    found[:1, :1] = 1.0
    return np.asarray(found)


def log_evidence(
    values: np.ndarray,
    days: np.ndarray,
    nuisance: np.ndarray,
    sd: np.ndarray | None = None,
    least: float = 0.0,
    correlation: float = 0.0,
) -> np.ndarray:
    """Return the logarithm of the e-process after each check.

    Args:
        values: (n,) or (n, series) deviations in the order of their dates.
        days: (n,) dates in days, ascending.
        nuisance: (n, p) columns with unknown coefficients, whose influence is eliminated; one of them is the level.
        sd: (n,) relative standard deviations of the checks; equal if None.
        least: floor of the variance, in units of ``sd`` squared.
        correlation: of the deviations from one check to the next.

    Returns:
        (n,) or (n, series) logarithms; 0 means that nothing is known.
    """
    sd = np.ones(len(days)) if sd is None else sd
    white = whitening(len(days), correlation)
    y = white @ (values.T / sd).T.reshape(len(days), -1)
    x = white @ (nuisance / sd[:, None])
    # Relative to the first check, so that the priors of the size are in standard deviations whatever the unit of ``sd``.
    shapes = [white @ (shape * (sd[0] / sd)[:, None]) for shape in change_shapes(days)]
    found = np.zeros_like(y)
    for n in range(3, len(days) + 1):
        found[n - 1] = _log_ratio(y[:n], x[:n], [shape[:n, : n - 1] for shape in shapes], white[:n, :n], least)
    return found.reshape(np.shape(values))


def _log_ratio(
    y: np.ndarray, x: np.ndarray, shapes: list[np.ndarray], outliers: np.ndarray, least: float
) -> np.ndarray:
    """Return (series,) the logarithm of the averaged likelihood ratio of the checks so far.

    Args:
        y: (n, series) white deviations.
        x: (n, p) white nuisance columns.
        shapes: white regressors of steps and drifts.
        outliers: (n, n) white regressors of a single check.
        least: floor of the variance.
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
    weight = DATES / ((DATES + dates - 1.0) * (DATES + dates))
    top = np.maximum(each.max(axis=(0, 1)), 0.0)
    inside = np.einsum("c,kcs->s", weight, np.exp(each - top))
    later = DATES / (DATES + count - 1.0)
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
