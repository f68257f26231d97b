"""Alarm rate and power of whole watches on drawn series, with a look after every check; the correlation is estimated at each look."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from twin.monitoring.change import ErrorSeries, examine, lag_correlation

LIMIT = float(np.log(2 * 14 / 0.05))
ERRORS, LOOKS, WATCHES, BEFORE = 14, 30, 60, 12


def drawn(rng: np.random.Generator, count: int, tails: float, correlation: float) -> np.ndarray:
    """Return (count, errors) deviations of unit variance: Student's t or normal (infinite), through an autoregression."""
    normal = not np.isfinite(tails)
    shape = (count + 40, ERRORS)
    white = rng.normal(size=shape) if normal else rng.standard_t(tails, shape) / np.sqrt(tails / (tails - 2.0))
    found = white.copy()
    for n in range(1, len(found)):
        found[n] = correlation * found[n - 1] + np.sqrt(1.0 - correlation**2) * white[n]
    return found[40:]


def alarming(values: np.ndarray, days: np.ndarray, errors: int) -> bool:
    kind = np.full(len(days), "probe", dtype=object)
    u, number = np.full(len(days), 0.01), np.arange(len(days))

    def series(k: int, correlation: float) -> ErrorSeries:
        return ErrorSeries("E_C0Y", "urad", number, days, values[:, k], u, kind, {}, correlation)

    correlation = lag_correlation([series(k, 0.0) for k in range(ERRORS)])
    return any(examine(series(k, correlation), LIMIT).alarming for k in range(errors))


@pytest.mark.slow
@pytest.mark.parametrize(("tails", "correlation"), [(np.inf, 0.0), (4.0, 0.0), (np.inf, 0.3), (np.inf, 0.5)])
def test_share_of_false_alarms(tails: float, correlation: float) -> None:
    """Looks at 10, 20 and 30 checks contain those before; at most what 5 % gives at 99.9 %."""
    rng, alarms = np.random.default_rng(21), 0
    for _ in range(WATCHES):
        days = 20500.0 + np.cumsum(rng.uniform(1.0, 9.0, LOOKS))
        values = drawn(rng, LOOKS, tails, correlation)
        alarms += any(alarming(values[:n], days[:n], ERRORS) for n in (10, 20, LOOKS))
    assert alarms <= binom.ppf(0.999, WATCHES, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "within", "least"), [(4.0, 8, 0.65), (6.0, 5, 0.85)])
def test_share_of_steps_found(size: float, within: int, least: float) -> None:
    rng, found = np.random.default_rng(22), 0
    for _ in range(WATCHES):
        count = BEFORE + within
        days = 20500.0 + np.cumsum(rng.uniform(1.0, 9.0, count))
        values = drawn(rng, count, np.inf, 0.0)
        values[BEFORE:, 0] += size
        found += alarming(values, days, 1)
    assert found >= least * WATCHES
