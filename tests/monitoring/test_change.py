"""The date, the size and the cause of a change, on drawn series of one error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t

from twin.monitoring.change import (
    ErrorSeries,
    WatchedError,
    _change,
    _temperatures,
    _with_best_sensor,
    examine,
    lag_correlation,
)
from twin.monitoring.watched import date_text

LIMIT = float(np.log(2 * 14 / 0.05))
CHECKS = 26
AFTER = 12
"""Number of checks before the change."""


def series(
    value: np.ndarray, days: np.ndarray, *, kind: np.ndarray | None = None, u: float = 0.4, **degrees: np.ndarray
) -> ErrorSeries:
    count = len(days)
    kinds = np.full(count, "probe", dtype=object) if kind is None else kind
    return ErrorSeries("E_C0Y", "urad", np.arange(count), days, value, np.full(count, u), kinds, degrees)


def dates(rng: np.random.Generator, count: int = CHECKS) -> np.ndarray:
    return 20500.0 + np.cumsum(rng.uniform(2.0, 5.0, count))


def test_days_are_those_of_the_calendar() -> None:
    assert [date_text(day) for day in (0.0, 20_000.0, 20_000.9)] == ["1970-01-01", "2024-10-04", "2024-10-04"]


def test_date_and_size_of_steps_are_covered() -> None:
    """Intervals of 95 % for the date and the size, over 60 series; 0.85 is the 0.5 % limit of 95 % in 60."""
    rng = np.random.default_rng(1)
    inside, sized, found = [], [], 0
    for _ in range(60):
        days = dates(rng)
        noise = rng.normal(0.0, 1.0, CHECKS)
        one = examine(series(noise + 3.0 * (np.arange(CHECKS) >= AFTER), days), LIMIT)
        if one.change is None:
            continue
        found += one.verdict == "changed" and one.change.shape == "step"
        inside.append(one.change.earliest_day <= days[AFTER - 1] and one.change.latest_day >= days[AFTER])
        sized.append(abs(one.change.size - 3.0) <= one.change.expanded)
        assert one.alarm is not None and one.alarm >= AFTER
    assert found >= 45 and np.mean(inside) >= 0.85 and np.mean(sized) >= 0.85


def test_drift() -> None:
    rng = np.random.default_rng(2)
    days = dates(rng)
    ramp = 8.0 * np.maximum(days - days[AFTER], 0.0) / 30.0
    one = examine(series(rng.normal(0.0, 0.5, CHECKS) + ramp, days), LIMIT)
    assert one.verdict == "changed" and one.change is not None
    assert one.change.shape == "drift" and one.change.sure_shape
    assert one.change.per_month == pytest.approx(8.0, abs=1.5)
    assert one.change.earliest_day <= days[AFTER] <= one.change.latest_day
    assert one.level == pytest.approx(ramp[-1], abs=1.0)


def influenced(rng: np.random.Generator, days: np.ndarray, degrees: np.ndarray, **others: np.ndarray) -> WatchedError:
    value = 4.0 * (degrees - 20.0) + rng.normal(0.0, 0.5, len(days))
    return examine(series(value, days, bed=degrees, **others), LIMIT)


def test_growth_with_a_temperature_is_no_change() -> None:
    rng = np.random.default_rng(3)
    days = dates(rng)
    rising = 20.0 + 0.04 * (days - days[0]) + rng.normal(0.0, 0.5, CHECKS)
    one = influenced(rng, days, rising, hall=21.0 + rng.normal(0.0, 0.5, CHECKS))
    assert one.verdict == "follows temperature" and not one.alarming
    assert [effect.sensor for effect in one.temperatures] == ["bed"]
    assert abs(one.temperatures[0].per_kelvin - 4.0) <= one.temperatures[0].expanded


def test_sensors_that_are_alike_are_named_together() -> None:
    rng = np.random.default_rng(4)
    days = dates(rng)
    degrees = 20.0 + 0.04 * (days - days[0]) + rng.normal(0.0, 0.5, CHECKS)
    one = influenced(rng, days, degrees, column=1.5 * degrees - 9.0)
    assert one.verdict == "follows temperature"
    assert {effect.sensor for effect in one.temperatures} == {"bed", "column"}


def test_time_and_temperature_together_are_undecided() -> None:
    rng = np.random.default_rng(5)
    days = dates(rng)
    one = influenced(rng, days, 20.0 + 0.05 * (days - days[0]))
    assert one.verdict == "undecided" and one.alarming
    assert one.temperatures[0].sensor == "bed" and one.change is not None and one.change.shape == "drift"


def test_a_step_beside_a_temperature_is_a_change() -> None:
    rng = np.random.default_rng(6)
    days = dates(rng)
    degrees = 20.0 + 1.5 * np.sin(days / 6.0) + rng.normal(0.0, 0.3, CHECKS)
    value = 3.0 * degrees + 6.0 * (np.arange(CHECKS) >= AFTER) + rng.normal(0.0, 0.5, CHECKS)
    one = examine(series(value, days, bed=degrees), LIMIT)
    assert one.verdict == "changed" and one.change is not None
    assert abs(one.change.size - 6.0) <= one.change.expanded < 1.2, "the temperature's part is removed"


def test_instruments_have_levels_of_their_own() -> None:
    rng = np.random.default_rng(7)
    days = dates(rng)
    value = rng.normal(0.0, 0.5, CHECKS)
    late = np.where(np.arange(CHECKS) < AFTER, "probe", "ball-bar").astype(object)
    other = value + 9.0 * (late == "ball-bar")
    assert examine(series(other, days, kind=late), LIMIT).verdict == "steady"
    assert examine(series(other, days), LIMIT).verdict == "changed"


def test_equal_checks_are_no_evidence() -> None:
    """Checks of a coarse instrument may be equal; the next one that differs by a fraction of its noise is no change."""
    days = dates(np.random.default_rng(8), 8)
    value = np.zeros(8)
    value[-1] = 0.05
    assert examine(series(value, days, u=1.0), LIMIT).verdict == "steady"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_checks(count: int) -> None:
    days = dates(np.random.default_rng(9), count)
    one = examine(series(np.arange(count) * 9.0, days, bed=np.arange(count) * 1.0), LIMIT)
    assert one.verdict == "steady" and one.change is None and len(one.weights) == count
    assert np.isfinite(one.repeatability) == (count > 1)


@pytest.mark.parametrize("wanted", [0.0, 0.3, 0.5])
def test_the_correlation_from_check_to_check_is_estimated(wanted: float) -> None:
    """The mean over 40 watches of six errors, one of which has a step and one a temperature."""
    rng, found = np.random.default_rng(10), []
    for _ in range(40):
        days, degrees = dates(rng), 20.0 + rng.normal(0.0, 1.0, CHECKS)
        noise = rng.normal(0.0, 1.0, (CHECKS, 6))
        for n in range(1, CHECKS):
            noise[n] = wanted * noise[n - 1] + np.sqrt(1.0 - wanted**2) * noise[n]
        noise[AFTER:, 0] += 6.0
        noise[:, 1] += 4.0 * degrees
        found.append(lag_correlation([series(noise[:, k], days, u=0.01, bed=degrees) for k in range(6)]))
    assert np.mean(found) == pytest.approx(wanted, abs=0.1)


def test_a_step_has_the_size_and_the_interval_of_least_squares() -> None:
    """Two means, their difference, Student's t with the degrees of freedom that level, step and date leave; dates by the profile."""
    rng, days = np.random.default_rng(1), 20500.0 + 3.0 * np.arange(CHECKS)
    value = rng.normal(0.0, 1.0, CHECKS) + 2.2 * (np.arange(CHECKS) >= AFTER)
    change = examine(series(value, days), LIMIT).change
    assert change is not None and change.shape == "step"
    profile, dof = [], CHECKS - 3
    for after in range(1, CHECKS):
        parts = value[:after], value[after:]
        profile.append(sum(float(np.sum((part - part.mean()) ** 2)) for part in parts))
    rss, split = min(profile), int(np.argmin(profile)) + 1
    assert change.after == split - 1
    assert change.size == pytest.approx(value[split:].mean() - value[:split].mean(), rel=1e-9)
    expected = student_t.ppf(0.975, dof) * np.sqrt(rss / dof * (1.0 / split + 1.0 / (CHECKS - split)))
    assert change.expanded == pytest.approx(expected, rel=1e-9)
    # Dates whose profile is within 7.35 of the best, with these degrees of freedom (Hansen 2000).
    inside = np.flatnonzero(dof * (np.array(profile) / rss - 1.0) <= 7.35)
    assert inside[0] < change.after < inside[-1], "the interval is longer than its middle on both sides"
    assert change.earliest_day == days[inside[0]] and change.latest_day == days[inside[-1] + 1]


def test_the_standard_deviation_of_a_check_is_that_of_the_first_ones() -> None:
    """Instrument noise and what the first six checks vary beyond it; never less than the instrument's."""
    rng, days = np.random.default_rng(9), 20500.0 + 3.0 * np.arange(10)
    value = rng.normal(0.0, 2.0, 10)
    between = np.var(value[:6], ddof=1) - 0.4**2
    assert series(value, days).sd == pytest.approx(np.full(10, np.sqrt(0.4**2 + between)), rel=1e-9)
    assert series(0.01 * value, days).sd == pytest.approx(np.full(10, 0.4))


def test_a_drift_has_the_size_and_the_interval_of_least_squares() -> None:
    """The change until the last check is the rate times the time since the date, and so is its U."""
    rng, days = np.random.default_rng(2), 20500.0 + 3.0 * np.arange(CHECKS)
    value = rng.normal(0.0, 0.5, CHECKS) + 8.0 * np.maximum(days - days[AFTER], 0.0) / 30.0
    change = examine(series(value, days), LIMIT).change
    assert change is not None and change.shape == "drift"
    months = np.maximum(days - days[change.after], 0.0) / 30.0
    design = np.column_stack([np.ones(CHECKS), months])
    found, (rss,), *_ = np.linalg.lstsq(design, value, rcond=None)
    u = np.sqrt(rss / (CHECKS - 3) * np.linalg.inv(design.T @ design)[1, 1])
    assert change.per_month == pytest.approx(found[1], rel=1e-9)
    assert change.size == pytest.approx(found[1] * months[-1], rel=1e-9)
    assert change.expanded == pytest.approx(student_t.ppf(0.975, CHECKS - 3) * u * months[-1], rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_equal_explanations_are_ranked_by_name_and_not_by_rounding(seed: int) -> None:
    """A step and a drift in the last interval are the same change; sensors that follow each other exactly are the same influence."""
    rng = np.random.default_rng(seed)
    days, value = dates(rng), rng.normal(0.0, 1.0, CHECKS)
    value[-1] += 30.0
    degrees = 20.0 + rng.normal(0.0, 1.0, CHECKS)
    sensors = {"bed": 3.0 * degrees + 0.1, "air": degrees, "column": degrees / 7.0}
    plain = series(value + 2.0 * degrees, days, **sensors)
    levels = np.ones((CHECKS, 1))
    changed = _change(series(value, days), 0.01, levels)
    assert (changed.shape, changed.after, changed.sure_shape) == ("step", CHECKS - 2, False)
    assert [one.sensor for one in _temperatures(plain, 0.01)] == list(sensors)
    beside = _with_best_sensor(plain, levels, sensors)
    assert beside.shape[1] == 2 and np.array_equal(beside[:, 1], sensors["bed"])
