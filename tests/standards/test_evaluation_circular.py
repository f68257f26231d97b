"""Error motions of a rotary axis: compared with the discrete Fourier transform and a fitted circle, and their invariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from twin._common.errors import InputError
from twin.standards.iso230_4 import error_motion

SEEDS = st.integers(0, 2**32 - 1)
COUNTS = st.integers(8, 90)
KINDS = st.sampled_from(("radial", "axial", "tilt"))


def angles(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return angles over a turn, uneven by up to a fifth of a step."""
    return (np.arange(count) + rng.uniform(-0.1, 0.1, count)) * 360.0 / count


@given(seed=SEEDS, count=st.integers(8, 90), turns=st.integers(1, 6))
def test_harmonics_are_the_discrete_fourier_transform(seed: int, count: int, turns: int) -> None:
    rng = np.random.default_rng(seed)
    readings = rng.normal(0.0, 3.0, (turns, count))
    result = error_motion(np.arange(count) * 360.0 / count, readings, "radial")
    spectrum = np.fft.rfft(readings.mean(axis=0)) / count
    assert len(result.harmonics) == min(12, (count - 1) // 2)
    assert result.constant == pytest.approx(spectrum[0].real, abs=1e-12)
    for harmonic in result.harmonics:
        # Rounding of sums of some hundred numbers of size 3.
        assert harmonic.cos == pytest.approx(2.0 * spectrum[harmonic.order].real, abs=1e-11)
        assert harmonic.sin == pytest.approx(-2.0 * spectrum[harmonic.order].imag, abs=1e-11)


@given(seed=SEEDS, count=st.integers(26, 90), kind=KINDS)
def test_simulated_harmonics_are_found(seed: int, count: int, kind: str) -> None:
    """Uneven angles, harmonics 1 to 5."""
    rng = np.random.default_rng(seed)
    angle = angles(rng, count)
    put = rng.normal(0.0, 5.0, (5, 2))
    phase = np.radians(np.outer(np.arange(1, 6), angle))
    readings = 7.0 + put[:, 0] @ np.cos(phase) + put[:, 1] @ np.sin(phase)
    result = error_motion(angle, readings, kind)  # type: ignore[arg-type]
    assert np.array([[h.cos, h.sin] for h in result.harmonics[:5]]) == pytest.approx(put, abs=1e-9)  # condition < 10
    assert max(h.amplitude for h in result.harmonics[5:]) < 1e-9
    assert result.asynchronous_value is None
    assert result.unit == ("urad" if kind == "tilt" else "um")


@given(seed=SEEDS, count=COUNTS, turns=st.integers(1, 5), eccentricity=st.floats(0.0, 100.0), at=st.floats(0.0, 6.28))
def test_mounting_of_the_artefact(seed: int, count: int, turns: int, eccentricity: float, at: float) -> None:
    """A once-per-turn component and a constant: no error of a radial or tilt motion, but an error of an axial one."""
    rng = np.random.default_rng(seed)
    angle = angles(rng, count)
    readings = rng.normal(0.0, 1.0, (turns, count))
    wave = 12.0 + eccentricity * np.cos(np.radians(angle) - at)
    for kind in ("radial", "tilt", "axial"):
        before, after = (error_motion(angle, r, kind) for r in (readings, readings + wave))  # type: ignore[arg-type]
        # 1e-9: rounding of 100 µm.
        assert after.residual_value == pytest.approx(before.residual_value, abs=1e-9)
        assert after.asynchronous_value == pytest.approx(before.asynchronous_value, abs=1e-9)
        first = (after.once_per_turn.cos - before.once_per_turn.cos, after.once_per_turn.sin - before.once_per_turn.sin)
        assert first == pytest.approx((eccentricity * np.cos(at), eccentricity * np.sin(at)), abs=1e-9)
        if kind != "axial":
            assert after.total == pytest.approx(before.total, abs=1e-9)
            assert after.synchronous_value == pytest.approx(before.synchronous_value, abs=1e-9)
            assert after.synchronous == pytest.approx(after.residual, abs=1e-12)
    pure = error_motion(angle, wave, "axial")
    assert pure.fundamental_value == pytest.approx(2.0 * eccentricity, abs=1e-9)
    assert pure.synchronous_value == pytest.approx(np.ptp(wave), abs=1e-9)
    assert pure.residual_value == pytest.approx(0.0, abs=1e-9)


def test_centre_is_that_of_the_circle_fitted_to_the_polar_plot() -> None:
    """Fitted geometrically, in the plane, at a radius of 50 mm, where the linear circle agrees."""
    rng = np.random.default_rng(2307)
    angle, radius_um = angles(rng, 72), 50_000.0
    readings = 20.0 * np.cos(np.radians(angle) - 1.0) + 3.0 * np.cos(3.0 * np.radians(angle)) + rng.normal(0.0, 0.5, 72)
    result = error_motion(angle, readings, "radial")
    points = (radius_um + readings)[:, None] * np.column_stack([np.cos(np.radians(angle)), np.sin(np.radians(angle))])

    def radial(circle: np.ndarray) -> np.ndarray:
        return np.hypot(*(points - circle[:2]).T) - circle[2]

    x, y, r = least_squares(radial, [0.0, 0.0, radius_um], x_scale=[1.0, 1.0, 1.0], xtol=1e-15, ftol=1e-15).x
    # Second order in 20 µm: 20²/(2·50 000) = 4 nm.
    assert (result.once_per_turn.cos, result.once_per_turn.sin) == pytest.approx((x, y), abs=5e-3)
    assert result.constant == pytest.approx(r - radius_um, abs=5e-3)
    assert result.synchronous_value == pytest.approx(np.ptp(radial(np.array([x, y, r]))), abs=2e-2)


@given(seed=SEEDS, count=COUNTS, turns=st.integers(2, 5), kind=KINDS)
def test_values_and_order(seed: int, count: int, turns: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    angle = angles(rng, count)
    readings = rng.normal(0.0, 1.0, (turns, count))
    result = error_motion(angle, readings, kind)  # type: ignore[arg-type]
    assert result.asynchronous_value is not None
    assert result.asynchronous_value == max(max(column) - min(column) for column in readings.T)
    assert result.synchronous == pytest.approx(result.total.mean(axis=0), abs=1e-12)
    assert result.synchronous_value <= result.total_value + 1e-12
    assert result.asynchronous_value <= result.total_value + 1e-12
    # Neither the order of angles nor of turns matters, nor the turn an angle is counted in.
    order = rng.permutation(count)
    mixed = error_motion(angle[order] - 720.0, readings[::-1, order], kind)  # type: ignore[arg-type]
    for name in ("total_value", "synchronous_value", "fundamental_value", "residual_value", "asynchronous_value"):
        assert getattr(mixed, name) == pytest.approx(getattr(result, name), abs=1e-9), name
    # The same turn again says nothing asynchronous.
    assert error_motion(angle, np.tile(readings[0], (3, 1)), kind).asynchronous_value == 0.0  # type: ignore[arg-type]


def test_results_do_not_change() -> None:
    result = error_motion(np.arange(0, 360, 30), np.arange(12.0), "radial")
    for array in (result.angle_deg, result.readings, result.total, result.synchronous, result.residual):
        with pytest.raises(ValueError, match="read-only"):
            array[..., 0] = 9.0


TURN = np.arange(0.0, 360.0, 30.0)


@pytest.mark.parametrize(
    ("angle", "readings", "kind", "words"),
    [
        (TURN, np.zeros(12), "face", "radial, axial, tilt"),
        (TURN, np.zeros(11), "radial", "12 per turn"),
        (TURN, np.zeros((1, 2, 12)), "radial", "1 or 2 dimension"),
        (TURN, [[0.0] * 12, [0.0]], "radial", "not numbers"),
        (TURN, np.full(12, np.nan), "radial", "lack 12 of 12"),
        (TURN / 2.0, np.zeros(12), "radial", "angles do not cover a turn"),
        ([0.0], [1.0], "radial", "angles do not cover a turn"),
        (np.append(TURN, 360.0), np.zeros(13), "radial", "an angle occurs twice"),
    ],
)
def test_bad_input(angle: np.ndarray, readings: np.ndarray, kind: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        error_motion(angle, readings, kind)  # type: ignore[arg-type]
