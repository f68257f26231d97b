"""Sphere fit: published points, another formulation, coverage of the covariance, contacts that determine no centre."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import binom, chi2, f

from tests.measurement.formats.cases.tf5245 import CENTRE, CONTACTS
from twin._common.errors import InputError
from twin.measurement.contacts import fit_sphere
from twin.numerics.spatial import algebraic_sphere

HEMISPHERE = np.array(
    [
        (np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t))
        for t, count, turn in ((0.0, 1, 0.0), (np.pi / 4, 4, 0.2), (np.pi / 2, 4, 0.9))
        for p in turn + 2 * np.pi * np.arange(count) / count
    ]
)
"""Nine normals on a hemisphere: pole, 45° and equator."""


def test_the_algebraic_fit_gives_the_published_centre() -> None:
    """Beckhoff TF5245: the six contacts and the centre stand on two pages of its documentation."""
    centre, radius = algebraic_sphere(CONTACTS)
    np.testing.assert_allclose(centre, CENTRE, atol=1e-6)  # half of its last printed digit in X and Y, 5e-8 in Z
    assert radius == pytest.approx(14.924, abs=1e-3)


def test_the_geometric_fit_of_the_published_points_has_the_smaller_distances() -> None:
    sphere = fit_sphere(CONTACTS)
    distance = np.linalg.norm(CONTACTS - CENTRE, axis=1)
    assert sphere.residuals_mm @ sphere.residuals_mm < ((distance - distance.mean()) ** 2).sum()
    np.testing.assert_allclose(sphere.centre_mm, CENTRE, atol=2e-5)
    assert sphere.dof == 2 and sphere.noise_mm == pytest.approx(7.52e-3, abs=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_another_formulation(seed: int) -> None:
    """The centre that minimises the variance of the distances, by a method without derivatives, on a cap of 50°."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(12, 3)) * 0.4 + [0.0, 0.0, 1.0]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = rng.uniform(-300, 300, 3) + 12.5 * normals + rng.normal(0, 0.02, (12, 3))
    sphere = fit_sphere(points)
    near = points.mean(axis=0)
    found = minimize(
        lambda x: np.linalg.norm(points - near - x, axis=1).var() * 1e4,
        sphere.centre_mm - near + 0.5,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-15, "maxiter": 5000, "maxfev": 5000},
    )
    np.testing.assert_allclose(sphere.centre_mm, near + found.x, atol=2e-6)
    assert sphere.radius_mm == pytest.approx(np.linalg.norm(points - sphere.centre_mm, axis=1).mean(), abs=1e-9)


def test_a_known_radius_makes_the_centre_of_a_cap_more_certain() -> None:
    cap = HEMISPHERE[:5]
    free, known = fit_sphere(10.0 * cap), fit_sphere(10.0 * cap, 10.0)
    np.testing.assert_allclose(known.centre_mm, 0.0, atol=1e-9)
    assert known.cofactor.shape == (3, 3) and known.dof == 2
    assert known.covariance_mm2(1.0)[2, 2] < 0.1 * free.covariance_mm2(1.0)[2, 2]


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("stated", [False, True])
def test_the_covariance_covers_the_true_centre(known: bool, stated: bool) -> None:
    """95 % of the 95 % ellipsoids contain the centre: χ² for a stated noise, Hotelling's T² for one from the residuals."""
    rng, draws, noise, radius = np.random.default_rng(20), 1500, 0.004, 12.5
    inside = 0
    for _ in range(draws):
        points = radius * HEMISPHERE + HEMISPHERE * rng.normal(0, noise, len(HEMISPHERE))[:, None]
        sphere = fit_sphere(points, radius if known else None)
        covariance = sphere.covariance_mm2(noise if stated else sphere.noise_mm)
        distance = sphere.centre_mm @ np.linalg.solve(covariance, sphere.centre_mm)
        inside += distance <= (chi2.ppf(0.95, 3) if stated else 3.0 * f.ppf(0.95, 3, sphere.dof))
    low, high = binom.ppf([5e-4, 1 - 5e-4], draws, 0.95)
    assert low <= inside <= high


@pytest.mark.parametrize(
    "points",
    [
        HEMISPHERE[5:] * 10.0,  # on the equator: a great circle
        HEMISPHERE[1:5] * 10.0,  # on a small circle
        np.outer([0.0, 1.0, 2.0, 3.0], [1.0, 1.0, 0.0]),  # on a line
        np.ones((5, 3)),  # one point
    ],
)
@pytest.mark.parametrize("radius", [None, 10.0])
def test_contacts_in_one_plane_are_refused(points: np.ndarray, radius: float | None) -> None:
    with pytest.raises(InputError, match="do not determine the sphere's centre"):
        fit_sphere(points + np.array([200.0, 100.0, -50.0]), radius)


@pytest.mark.parametrize("seed", range(20))
def test_contacts_in_one_plane_with_noise_are_refused(seed: int) -> None:
    """The fit of noise gives some sphere; its uncertainty shows that the contacts do not determine it."""
    rng = np.random.default_rng(seed)
    circle = np.array([[np.cos(p), np.sin(p), 0.0] for p in np.arange(8) * np.pi / 4]) * 10.0
    with pytest.raises(InputError, match="do not determine the sphere's centre"):
        fit_sphere(circle + rng.normal(0, 0.003, (8, 3))).check_determined(0.003)


def test_too_few_or_invalid_contacts() -> None:
    with pytest.raises(InputError, match="3 contacts on a sphere"):
        fit_sphere(HEMISPHERE[:3])
    with pytest.raises(InputError, match="not finite"):
        fit_sphere(np.where(np.eye(9, 3) == 1.0, np.nan, HEMISPHERE))
