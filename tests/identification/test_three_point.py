"""The thesis's three-point solution: exact on exact data, equal to its printed closed form, and noisier than all nine equations."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin._common.errors import InputError
from twin.identification.thesis import three_point

PLACES = np.array([[0.10, -0.05, -0.03], [-0.08, 0.06, -0.07], [0.02, 0.11, -0.12]])  # K, P, Q


def moved(errors: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return Δ = e + ω × p, written out."""
    return errors[:, None, :3] + np.cross(errors[:, None, 3:], places[None])


def closed_form(d: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return thesis eq. 33-34 for X, from the printed formulas with lost brackets restored by derivation."""
    (xK, yK, zK), (xP, yP, zP), (xQ, yQ, zQ) = places
    (_, dyK, dzK), (dxP, dyP, _), (dxQ, _, dzQ) = d
    M = (dxQ - dxP) * (xK - xQ) * (zP - zK) + ((dyP - dyK) * (yK - yQ) + (dzK - dzQ) * (zP - zK)) * (zQ - zP)
    N = (xK - xQ) * (yP - yQ) * (zP - zK) - (xK - xP) * (yK - yQ) * (zQ - zP)
    c = M / N
    a = (dyK - dyP) / (zP - zK) + (xP - xK) / (zP - zK) * c
    b = (dxQ - dxP) / (zQ - zP) + (yQ - yP) / (zQ - zP) * c
    return np.array([dxP + yP * c - zP * b, dyP - xP * c + zP * a, dzQ - yQ * a + xQ * b, a, b, c])


@pytest.mark.parametrize("axis", ["X", "Y", "Z", "rotary"])
@pytest.mark.parametrize("equations", ["six", "nine"])
@given(seed=st.integers(0, 2**32 - 1))
def test_exact_data_give_the_errors_back(
    axis: Literal["X", "Y", "Z", "rotary"], equations: Literal["six", "nine"], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    errors = rng.normal(size=(7, 6)) * 1e-5
    found = three_point(moved(errors, PLACES), PLACES, axis, equations=equations)
    assert np.abs(found - errors).max() <= 1e-15 / 1e-2  # rounding over the smallest lever in use, 1 cm


def test_the_printed_closed_form() -> None:
    rng = np.random.default_rng(2)
    deviations = rng.normal(size=(20, 3, 3)) * 1e-5
    found = three_point(deviations, PLACES, "X")
    for d, row in zip(deviations, found, strict=True):
        assert closed_form(d, PLACES) == pytest.approx(row, rel=1e-9, abs=1e-16)


def test_six_equations_throw_information_away() -> None:
    """Same noise in every coordinate: the nine equations by least squares are at least as good in every error motion."""
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(20_000, 3, 3)) * 5e-6
    six = three_point(noise, PLACES, "X").std(axis=0)
    nine = three_point(noise, PLACES, "X", equations="nine").std(axis=0)
    assert np.all(nine <= six * 1.02)  # 2 %: three standard errors of a standard deviation from 20,000 draws
    assert np.any(nine < 0.8 * six)


def test_reflectors_in_a_line_are_refused() -> None:
    line = np.outer([0.0, 1.0, 2.0], [0.05, 0.02, -0.03])
    for equations in ("six", "nine"):
        with pytest.raises(InputError, match="not on a line"):
            three_point(np.zeros((1, 3, 3)), line, "X", equations=equations)  # type: ignore[arg-type]
