"""The sequential test: its definition by quadrature, and its alarm rate and power on drawn series."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, multivariate_normal

from twin.monitoring.change import (
    MONTH_DAYS,
    OUTLIER_VARIANCES,
    OUTLIER_WEIGHT,
    POSSIBLE_DATES,
    PRIOR_VARIANCES,
    log_evidence,
    remover,
    spent_share,
    whitening,
)

LOOKS = 30
SERIES = 1000


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the dates of checks and series of an unchanged machine."""
    rng = np.random.default_rng(seed)
    days = 20500.0 + np.cumsum(rng.uniform(1.0, 9.0, LOOKS))
    return days, 7.0 + 3.0 * rng.normal(size=(LOOKS, SERIES))


def marginal(x: np.ndarray, covariance: np.ndarray) -> float:
    """Return the density of x integrated over the level (uniform) and the standard deviation (1/σ), by quadrature."""
    log_sd = np.linspace(np.log(x.std()) - 5.0, np.log(x.std()) + 9.0, 240)
    total = 0.0
    for sd in np.exp(log_sd):
        level = np.linspace(-40.0, 40.0, 401) * sd * np.sqrt(covariance.max()) + x.mean()
        density = multivariate_normal(np.zeros(len(x)), sd**2 * covariance).pdf(x - level[:, None])
        total += float(np.sum(density) * (level[1] - level[0]))
    return total * float(log_sd[1] - log_sd[0])


def test_the_evidence_is_the_ratio_of_the_densities_without_level_and_scale() -> None:
    days, x = np.array([0.0, 4.0, 11.0, 13.0]), np.array([0.3, -0.5, 4.1, 3.2])
    found = np.exp(log_evidence(x, days, np.ones((4, 1))))
    nothing = marginal(x, np.eye(4))
    expected, rest = 0.0, 1.0
    for after in (1, 2, 3):
        weight = POSSIBLE_DATES / ((POSSIBLE_DATES + after - 1) * (POSSIBLE_DATES + after))
        rest -= weight
        step = (np.arange(4) >= after).astype(float)
        drift = np.maximum(days - days[after - 1], 0.0) / MONTH_DAYS
        ratios = [marginal(x, np.eye(4) + g * np.outer(z, z)) / nothing for z in (step, drift) for g in PRIOR_VARIANCES]
        expected += weight * float(np.mean(ratios))
    assert found[-1] == pytest.approx(expected + rest, rel=2e-3)
    assert np.all(found[:2] == 1.0)


@pytest.mark.slow
def test_one_check_far_off_is_no_evidence_by_itself() -> None:
    """The denominator is the larger of the densities of no change and of one check with an inflated variance, by quadrature."""
    days, x = np.arange(5.0), np.array([0.1, -0.2, 0.0, 0.2, 9.0])
    nothing = marginal(x, np.eye(5))
    sizes = [g * np.diag(np.eye(5)[k]) for k in range(5) for g in OUTLIER_VARIANCES]
    far = OUTLIER_WEIGHT * max(marginal(x, np.eye(5) + size) / nothing for size in sizes)
    assert far > 1.0
    expected, rest = 0.0, 1.0
    for after in (1, 2, 3, 4):
        weight = POSSIBLE_DATES / ((POSSIBLE_DATES + after - 1) * (POSSIBLE_DATES + after))
        rest -= weight
        shapes = [(np.arange(5) >= after).astype(float), np.maximum(days - days[after - 1], 0.0) / MONTH_DAYS]
        ratios = [marginal(x, np.eye(5) + g * np.outer(z, z)) / nothing for z in shapes for g in PRIOR_VARIANCES]
        expected += weight * float(np.mean(ratios))
    assert np.exp(log_evidence(x, days, np.ones((5, 1))))[-1] == pytest.approx((expected + rest) / far, rel=5e-3)


@pytest.mark.parametrize("heavy", [3.0, 4.0])
def test_heavy_tails_do_not_raise_the_alarm_rate(heavy: float) -> None:
    """At the limit of 14 errors and two tests: 1000 series of Student's t are an alarm in 0.05/28 or fewer of them, at 99.9 %."""
    days, _ = drawn(8)
    x = np.random.default_rng(9).standard_t(heavy, (LOOKS, SERIES))
    found = log_evidence(x, days, np.ones((LOOKS, 1))).max(axis=0)
    assert np.count_nonzero(found >= np.log(2 * 14 / 0.05)) <= binom.ppf(0.999, SERIES, 0.05 / 28)
    assert np.mean(found >= np.log(20.0)) <= 0.05


def test_correlated_checks_are_whitened() -> None:
    """White noise passed through an autoregression, filtered here, gives the evidence of white noise where only noise is."""
    days, white = drawn(10)
    x = white.copy()
    for n in range(1, LOOKS):
        x[n] = 0.6 * x[n - 1] + 0.8 * (white[n] - 7.0) + 7.0 * 0.4
    known = log_evidence(x, days, np.ones((LOOKS, 1)), correlation=0.6).max(axis=0)
    assert np.mean(known >= np.log(20.0)) <= 0.05
    assert np.mean(log_evidence(x, days, np.ones((LOOKS, 1))).max(axis=0) >= np.log(20.0)) > 0.15, "it matters"


@pytest.mark.parametrize("rate", [0.05, 0.2])
def test_alarm_rate_holds_over_all_looks(rate: float) -> None:
    """At most the stated share of unchanged series ever passes the limit; the bound is that of 1000 draws at 99.9 %."""
    days, x = drawn(1)
    found = log_evidence(x, days, np.ones((LOOKS, 1)))
    alarms = int(np.count_nonzero(found.max(axis=0) >= np.log(1.0 / rate)))
    assert 0 < alarms <= binom.ppf(0.999, SERIES, rate)


def test_alarm_rate_holds_whatever_a_temperature_does() -> None:
    days, x = drawn(2)
    degrees = 20.0 + 0.08 * (days - days[0]) + np.random.default_rng(3).normal(0.0, 0.4, LOOKS)
    columns = np.column_stack([np.ones(LOOKS), degrees])
    influenced = x + 6.0 * degrees[:, None]
    assert np.mean(log_evidence(influenced, days, columns).max(axis=0) >= np.log(20.0)) <= 0.05
    assert np.mean(log_evidence(influenced, days, columns[:, :1]).max(axis=0) >= np.log(20.0)) > 0.9, "it matters"


def test_alarm_rate_holds_with_a_floor_and_checks_of_different_noise() -> None:
    days, x = drawn(4)
    sd = np.where(np.arange(LOOKS) % 3 == 0, 2.0, 0.5)
    found = log_evidence((x - 7.0) * sd[:, None], days, np.ones((LOOKS, 1)), sd, least=0.01)
    assert np.mean(found.max(axis=0) >= np.log(20.0)) <= 0.05


def test_a_look_does_not_depend_on_later_checks() -> None:
    days, x = drawn(5)
    whole = log_evidence(x[:, 0], days, np.ones((LOOKS, 1)))
    for n in (3, 10, 29):
        assert log_evidence(x[:n, 0], days[:n], np.ones((n, 1))) == pytest.approx(whole[:n], abs=1e-9)


def test_a_step_is_found() -> None:
    """A step of four standard deviations is found within 12 checks in 9 of 10 series, at the limit of 14 errors and two tests."""
    days, x = drawn(6)
    x[12:] += 4.0 * 3.0
    passed = log_evidence(x, days, np.ones((LOOKS, 1))) >= np.log(2 * 14 / 0.05)
    assert np.mean(passed[:24].any(axis=0)) > 0.9 and np.mean(passed[:12].any(axis=0)) < 0.01


def test_all_of_the_alarm_rate_is_spent_in_the_end_only() -> None:
    shares = [spent_share(n) for n in (0, 1, 2, 21, 10**9)]
    assert shares == pytest.approx([0.0, 0.0, 1 / 21, 0.5, 1.0]) and np.all(np.diff(shares) >= 0.0)


def test_the_unit_of_the_deviations_does_not_matter() -> None:
    days, x = drawn(7)
    x[12:] += 12.0
    plain = log_evidence(x, days, np.ones((LOOKS, 1)))
    assert log_evidence(1e3 * x, days, np.ones((LOOKS, 1)), np.full(LOOKS, 70.0)) == pytest.approx(plain, rel=1e-9)


def test_whitening_undoes_the_correlation_from_check_to_check() -> None:
    correlation = 0.45
    lag = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    white = whitening(7, correlation)
    np.testing.assert_allclose(white @ correlation**lag @ white.T, np.eye(7), atol=1e-12)
    # Each check beside earlier ones only: later checks do not change what is known.
    np.testing.assert_array_equal(np.triu(white, 1), 0.0)


def test_columns_equal_up_to_rounding_count_once() -> None:
    """Two sensors on one housing: a factor of 0.1, rounded, is no further unknown; a millionth of a degree between them is one."""
    days, x = drawn(11)
    level, degrees = np.ones(LOOKS), 20.0 + np.random.default_rng(12).normal(0.0, 0.4, LOOKS)
    columns = np.column_stack([level, degrees])
    again = np.column_stack([columns, 3.0 * (0.1 * degrees) + 0.7])
    assert remover(columns)[1] == remover(again)[1] == 2
    assert log_evidence(x, days, again) == pytest.approx(log_evidence(x, days, columns), abs=1e-9)
    noisy = np.column_stack([columns, degrees + 1e-6 * np.random.default_rng(13).normal(size=LOOKS)])
    assert remover(noisy)[1] == 3
    basis, rank = remover(np.zeros((4, 2)))
    assert basis.shape == (4, 0) and rank == 0


def test_the_floor_of_the_variance_is_that_of_the_likelihood_ratio() -> None:
    """The floor is added to the sum of squares, in the ratios for three checks written out here.

    Checks that agree to the last digit are no evidence for a change far below the floor.
    """
    days, x, least = np.arange(3.0), np.array([0.0, 0.0, 1.0]), 0.4
    rss = np.sum((x - x.mean()) ** 2) + least
    step, drift = np.eye(3)[2], np.eye(3)[2] / MONTH_DAYS
    other, late = np.array([0.0, 1.0, 1.0]), np.array([0.0, 1.0, 2.0]) / MONTH_DAYS

    def ratio(shape: np.ndarray, variance: float) -> float:
        z = shape - shape.mean()
        gain = 1.0 + variance * (z @ z)
        return float(gain**-0.5 * (1.0 - variance * (z @ x) ** 2 / gain / rss) ** -1.0)

    expected, rest = 0.0, 1.0
    for after, shapes in ((1, (other, late)), (2, (step, drift))):
        weight = POSSIBLE_DATES / ((POSSIBLE_DATES + after - 1) * (POSSIBLE_DATES + after))
        rest -= weight
        expected += weight * float(np.mean([ratio(z, g) for z in shapes for g in PRIOR_VARIANCES]))
    far = OUTLIER_WEIGHT * max(ratio(z, g) for z in np.eye(3) for g in OUTLIER_VARIANCES)
    found = log_evidence(x, days, np.ones((3, 1)), least=least)
    assert found[-1] == pytest.approx(np.log((expected + rest) / max(far, 1.0)), rel=1e-9)
    quiet = np.repeat([0.0, 1e-3], 10)
    without, with_floor = (log_evidence(quiet, np.arange(20.0), np.ones((20, 1)), least=one)[-1] for one in (0.0, 0.1))
    assert without > 20.0 and with_floor < 0.0


def test_the_evidence_of_an_exact_change_is_finite() -> None:
    """A drift without a residual: its share of the sum of squares is one to rounding, where the prior of its size is very wide."""
    days = np.array([0.0, 1.0, 2.0, 1e9, 2e9])
    found = log_evidence(days, days, np.ones((5, 1)))
    assert np.isfinite(found).all() and found[-1] > 10.0
