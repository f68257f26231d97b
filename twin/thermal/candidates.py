"""TermCandidate terms of a thermal model: which inputs they follow, with which lag, and their values over a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin.numerics.first_order_lag import follow
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

    Attributes:
        reference_degC: temperature of each sensor at the start of the fitted record.
        highest_rpm: highest speed of the fitted record; 0 without speeds.
        start_s: time of the first row.
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
    found: dict[int, list[str]] = {}
    for name, number in zip(names, label, strict=True):
        found.setdefault(int(number), []).append(name)
    return [tuple(group) for group in found.values()]


def averaged(values: np.ndarray, length: int) -> np.ndarray:
    """Return means over consecutive ``length`` rows (n, m) → (n // length, m); a shorter last part is not used."""
    count = len(values) // length
    return values[: count * length].reshape(count, length, -1).mean(axis=1)


def time_constants(duration_s: float) -> list[float]:
    """Return the time constants of the candidates: doubling from 1/140 to about 1/9 of the duration.

    Shorter lags do not show in averages over 1/140 of the duration; a record holds too few responses with longer ones.
    """
    return [float(f"{duration_s / 139.0 * 2.0**k:.2g}") for k in range(5)]


def candidates(groups: Sequence[tuple[str, ...]], speeds: bool, duration_s: float) -> list[TermCandidate]:
    """Return all candidate terms."""
    lags = time_constants(duration_s)
    found = [TermCandidate("thermal_lag", group, tau, 0.0, PRIOR_UM_PER_K) for group in groups for tau in (0.0, *lags)]
    if speeds:
        found += [TermCandidate("spindle_shift", (), 0.0, power, PRIOR_SPEED_UM) for power in EXPONENTS]
        found += [
            TermCandidate("spindle_growth", (), tau, power, PRIOR_SPEED_UM) for power in EXPONENTS for tau in lags
        ]
    found += [TermCandidate("thermal_drift", (), tau, 0.0, PRIOR_DRIFT_UM) for tau in (*lags[1:], 2.0 * lags[-1])]
    return found


def lagged(values: np.ndarray, time_s: np.ndarray, time_constant_s: float, state: float | None = None) -> np.ndarray:
    """Return the first-order lag of an input that is linear between rows; (n,).

    Args:
        values: the input (n,).
        time_s: times (n,).
        time_constant_s: 0 returns the input.
        state: state at the first row; the first value (steady state) if None.
    """
    if time_constant_s == 0.0:
        return np.array(values, dtype=float)
    first = float(values[0]) if state is None else state
    return np.r_[first, follow(np.diff(time_s), values[:-1], values[1:], time_constant_s, first)]


def drivers(record: ThermalRecord, terms: Sequence[TermCandidate], inputs: Inputs) -> np.ndarray:
    """Return the input of every term before its lag (n, terms): K above the reference, or relative speed to its exponent, or 0."""
    index = {name: i for i, name in enumerate(record.sensors)}
    found = np.zeros((len(record), len(terms)))
    for j, term in enumerate(terms):
        if term.sensors:
            columns = [record.temperature_degC[:, index[name]] - inputs.reference_degC[name] for name in term.sensors]
            found[:, j] = np.mean(columns, axis=0)
        elif term.exponent and record.speed_rpm is not None:
            found[:, j] = (record.speed_rpm / max(inputs.highest_rpm, 1e-9)) ** term.exponent
    return found


def features(
    record: ThermalRecord, terms: Sequence[TermCandidate], inputs: Inputs, states: np.ndarray | None = None
) -> np.ndarray:
    """Return the value of every term for coefficient 1, (n, terms).

    Args:
        record: the rows.
        terms: the terms.
        inputs: what they are relative to.
        states: state of every lag at the first row; steady state if None.
    """
    found = drivers(record, terms, inputs)
    for j, term in enumerate(terms):
        if term.effect == "thermal_drift":
            found[:, j] = -np.expm1(-(record.time_s - inputs.start_s) / term.time_constant_s)
        else:
            state = None if states is None else float(states[j])
            found[:, j] = lagged(found[:, j], record.time_s, term.time_constant_s, state)
    return found
