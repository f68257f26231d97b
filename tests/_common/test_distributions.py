"""Tail probabilities from `scipy.special` compared with `scipy.stats`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from twin._common import distributions


def test_tails_are_those_of_scipy_stats() -> None:
    rng = np.random.default_rng(1)
    value, dof, other = rng.uniform(0.01, 200.0, 2000), rng.integers(1, 60, 2000), rng.integers(2, 4000, 2000)
    chance = 10.0 ** rng.uniform(-30.0, -1e-3, 2000)
    # The underlying functions are the same except for the last digits.
    close = {"rtol": 1e-10, "atol": 1e-300}
    np.testing.assert_allclose(distributions.chi2_sf(value, dof), stats.chi2.sf(value, dof), **close)
    np.testing.assert_allclose(distributions.chi2_isf(chance, dof), stats.chi2.isf(chance, dof), **close)
    np.testing.assert_allclose(distributions.f_sf(value, dof, other), stats.f.sf(value, dof, other), **close)
    np.testing.assert_allclose(distributions.normal_isf(chance), stats.norm.isf(chance), **close)
    np.testing.assert_allclose(distributions.normal_sf(value / 20), stats.norm.sf(value / 20), **close)
    # Near zero the logarithm of a value close to one has no significant digits.
    logs = {"rtol": 1e-9, "atol": 1e-14}
    np.testing.assert_allclose(distributions.chi2_log_sf(value, dof), stats.chi2.logsf(value, dof), **logs)
    np.testing.assert_allclose(distributions.f_log_sf(value, dof, other), stats.f.logsf(value, dof, other), **logs)


@pytest.mark.parametrize("chance", [0.9, 0.05, 1e-9, 1e-60])
def test_a_value_is_exceeded_with_its_chance(chance: float) -> None:
    """Also for probabilities at which `scipy.stats.f.isf` loses its digits."""
    for dof, other in ((1, 2), (3, 40), (20, 3500)):
        again = distributions.f_sf(distributions.f_isf(chance, dof, other), dof, other)
        assert again == pytest.approx(chance, rel=1e-8)
        assert distributions.chi2_sf(distributions.chi2_isf(chance, dof), dof) == pytest.approx(chance, rel=1e-8)


def test_no_chance_at_all() -> None:
    assert np.isneginf(distributions.chi2_log_sf(1e6, 3)) and np.isneginf(distributions.f_log_sf(1e300, 3, 5))
    assert np.isinf(distributions.f_isf(0.0, 3, 5)) and np.isinf(distributions.chi2_isf(0.0, 3))
