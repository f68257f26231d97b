"""Sines and cosines of many frequencies: values, interpolation and spectral window, against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from twin.numerics.functions import _window, waves


@pytest.mark.parametrize(("low", "high", "first", "step"), [(0.0, 500.0, 0.02, 0.0063), (-1.9, 6.3, 1.0, 1.0)])
def test_waves_and_their_interpolation(low: float, high: float, first: float, step: float) -> None:
    """The values to rounding; the interpolation to the error of its kernel, 2e-12."""
    q = np.random.default_rng(1).uniform(low, high, 700)
    functions = waves(q, first, step, 230)
    angles = np.outer(q, first + step * np.arange(230))
    truth = np.concatenate([np.sin(angles), np.cos(angles)], axis=1)
    np.testing.assert_allclose(functions.values(slice(None)), truth, atol=1e-11)
    interpolation = functions.interpolation
    assert interpolation is not None
    np.testing.assert_allclose(interpolation.weights @ interpolation.table, truth, atol=1e-11)


@pytest.mark.parametrize("count", [1, 2, 77])
def test_the_spectral_window_is_the_mean_phase_of_the_positions(count: int) -> None:
    places = np.random.default_rng(2).uniform(-100.0, 400.0, 60)
    frequencies = 0.01 + 0.003 * np.arange(count)
    truth = np.abs(np.mean(np.exp(2j * np.pi * np.outer(frequencies, places)), axis=1))
    np.testing.assert_allclose(_window(frequencies, places), truth, atol=1e-12)
