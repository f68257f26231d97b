"""Instruments: what they read, how well, and what air does to a length."""

from __future__ import annotations

import numpy as np
import pytest

from twin._common.errors import InputError
from twin.measurement.instruments import (
    INSTRUMENTS,
    Air,
    Instrument,
    LaserTracker,
    TrackingInterferometer,
    refractive_index,
)
from twin.measurement.instruments.refraction import length_scale
from twin.measurement.instruments.tracker import AT960_ABSOLUTE

POINTS = np.array([[2.0, 0.0, 0.0], [1.0, -1.5, 0.5], [0.3, 0.2, -2.2]])


@pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda instrument: instrument.name)
def test_noise_has_the_stated_covariance(instrument: Instrument) -> None:
    """200,000 draws: sample covariance within 1.5 % of the largest entry (three times its own standard error)."""
    rng = np.random.default_rng(7)
    n = 200_000
    for point in POINTS:
        stated = instrument.covariance(point[None])[0]
        draws = instrument.noise(np.tile(point, (n, 1)), rng)
        assert np.abs(np.cov(draws.T) - stated).max() <= 0.015 * np.abs(stated).max()
        assert np.abs(draws.mean(axis=0)).max() <= 4.0 * np.sqrt(np.abs(stated).max() / n)


@pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda instrument: instrument.name)
def test_jacobian_is_the_derivative(instrument: Instrument) -> None:
    h = 1e-6
    found = instrument.jacobian(POINTS)
    for k in range(3):
        step = np.zeros(3)
        step[k] = h
        slope = (instrument.read(POINTS + step) - instrument.read(POINTS - step)) / (2 * h)
        assert np.abs(found[:, :, k] - np.nan_to_num(slope)).max() < 1e-9


def test_the_at960_of_the_data_sheet() -> None:
    """At two metres: half of 0.4 + 0.6 µm along the beam, half of 15 + 12 µm across it; ±10 µm absolute."""
    covariance = LaserTracker().covariance(POINTS[:1])[0]
    assert np.sqrt(np.diag(covariance)) * 1e6 == pytest.approx([0.5, 13.5, 13.5])
    absolute = AT960_ABSOLUTE.covariance(POINTS[:1])[0]
    assert np.sqrt(absolute[0, 0]) * 1e6 == pytest.approx(5.0)


def test_the_interferometer_reads_lengths_from_its_zero() -> None:
    readings = TrackingInterferometer(dead_path_m=0.5).read(POINTS)
    assert readings[:, 0] == pytest.approx(np.linalg.norm(POINTS, axis=1) - 0.5)
    assert np.isnan(readings[:, 1:]).all()


def test_air() -> None:
    """Printed value of NIST's engineering metrology toolbox form of the equation, and the thesis's rules of thumb."""
    # 633 nm, 20 °C, 101.325 kPa, 50 % humidity: 1.00027137 (NIST, Stone and Zimmerman).
    standard = Air(20.0, 1013.25, 0.5)
    assert refractive_index(standard) == pytest.approx(1.00027137, abs=2e-8)
    per_degree = (length_scale(Air(21.0, 1013.25, 0.5), standard) - 1.0) * 1e6
    per_hpa = (length_scale(Air(20.0, 1014.25, 0.5), standard) - 1.0) * 1e6
    per_tenth = (length_scale(Air(20.0, 1013.25, 0.6), standard) - 1.0) * 1e6
    assert per_degree == pytest.approx(-1.0, abs=0.1)
    assert per_hpa == pytest.approx(0.3, abs=0.05)
    assert per_tenth == pytest.approx(-0.1, abs=0.05)
    with pytest.raises(InputError, match="hPa"):
        Air(20.0, 101325.0, 0.5)
