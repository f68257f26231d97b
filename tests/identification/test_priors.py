"""The noise by which the priors of an identification are scaled."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from twin.identification.fitting import _noise


def solution(chi2: float, incomplete: bool = False) -> SimpleNamespace:
    return SimpleNamespace(determined=20, chi2=chi2, incomplete=incomplete)


@pytest.mark.parametrize(
    ("readings", "chi2", "expected"),
    [
        (30, 2.5, 0.5),
        (120, 25.0, 0.5),
        (29, 2.25, 1.0),  # nine degrees of freedom do not determine the noise
        (20, 0.0, 1.0),
        (120, 400.0, 1.0),  # residuals beyond the stated noise are no noise
        (30, 0.0, 1e-9),
    ],
)
def test_noise_from_residuals(readings: int, chi2: float, expected: float) -> None:
    assert _noise(solution(chi2), readings) == pytest.approx(expected)  # type: ignore[arg-type]


def test_an_incomplete_model_does_not_show_its_noise() -> None:
    assert _noise(solution(25.0, incomplete=True), 120) == 1.0  # type: ignore[arg-type]
