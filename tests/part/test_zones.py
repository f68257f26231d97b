"""Association of datums and tolerance zones, against linear programmes and minimisers of scipy and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize

from twin.part.zones import FeaturePoints, align, around_axis_um, band_um, both_sides_um, chebyshev, enclosing_radius

SEEDS = st.integers(0, 10_000)


def grid(normal: tuple[float, float, float], deviation: np.ndarray, *, offset: float = 0.0) -> FeaturePoints:
    """Points of a square of 80 mm across a direction."""
    n = np.array(normal, dtype=float)
    e = np.linalg.svd(n[None])[2][1:]
    at = np.stack(np.meshgrid(*[np.linspace(-40.0, 40.0, 7)] * 2), axis=-1).reshape(-1, 2) @ e + offset * n
    return FeaturePoints(
        at, np.tile(n, (len(at), 1)), np.broadcast_to(deviation, (len(at), deviation.shape[-1])).copy()
    )


def moved(points: FeaturePoints, shift_um: np.ndarray, turn_mrad: np.ndarray) -> FeaturePoints:
    """The same feature after a small rigid motion of the part."""
    displacement = shift_um + np.cross(turn_mrad, points.place_mm)
    return points.with_deviation(points.deviation_um + (displacement * points.normal).sum(axis=1)[:, None])


@given(SEEDS)
def test_the_smallest_largest_deviation_is_that_of_a_linear_programme(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k, n = int(rng.integers(1, 5)), int(rng.integers(6, 40))
    columns, values = rng.normal(size=(n, k)), rng.normal(size=(n, 3))
    if rng.random() < 0.5:  # regular points: the programme is degenerate
        columns = np.column_stack([np.ones(n), np.round(columns[:, 1:])])
    steps, size = chebyshev(columns, values)
    ones = np.ones((n, 1))
    for m in range(3):
        found = linprog(
            [0.0] * columns.shape[1] + [1.0],
            np.vstack([np.hstack([-columns, -ones]), np.hstack([columns, -ones])]),
            np.concatenate([-values[:, m], values[:, m]]),
            bounds=(None, None),
        )
        assert size[m] == pytest.approx(found.fun, rel=3e-4)
        assert np.abs(values[:, m] - columns @ steps[:, m]).max() == pytest.approx(size[m], rel=1e-9)


@given(SEEDS)
def test_the_smallest_circle_is_that_of_a_minimiser(seed: int) -> None:
    across = np.random.default_rng(seed).normal(size=(7, 2, 1))
    found = minimize(
        lambda c: np.linalg.norm(across[:, :, 0] - c, axis=1).max(), across[:, :, 0].mean(axis=0), method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-9, "maxiter": 4000},
    )  # fmt: skip
    assert enclosing_radius(across)[0] == pytest.approx(found.fun, rel=1e-4)


@given(SEEDS)
def test_a_motion_of_the_whole_part_changes_nothing_that_three_datums_fix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    features = [grid(n, rng.normal(size=(49, 1))) for n in ((0, 0, 1), (0, 1, 0), (1, 0, 0))]
    judged = grid((0.6, 0.0, 0.8), rng.normal(size=(49, 1)), offset=30.0)
    shift, turn = 50.0 * rng.normal(size=3), 0.5 * rng.normal(size=3)
    before = align(features, 1).seen(judged)
    after = align([moved(one, shift, turn) for one in features], 1).seen(moved(judged, shift, turn))
    none = np.zeros((49, 0))
    assert both_sides_um(after, none)[0] == pytest.approx(both_sides_um(before, none)[0], abs=2e-2)


def test_datums_take_their_freedoms_in_order() -> None:
    exact = np.zeros((49, 1))
    a, b, c = (grid(n, exact) for n in ((0, 0, 1), (0, 1, 0), (1, 0, 0)))
    assert [align(some, 1).free.shape[1] for some in ([], [a], [a, b], [a, b, c])] == [6, 3, 1, 0]
    axis = axis_of(np.zeros((3, 2)))
    assert align([a, axis], 1).free.shape[1] == 1  # the rotation about the axis
    assert align([axis], 1).free.shape[1] == 2


def test_a_tilted_plane_is_flat_and_not_parallel() -> None:
    tilted = moved(
        grid((0, 0, 1), np.zeros((49, 1))), np.zeros(3), np.array([0.0, 0.1, 0.0])
    )  # 100 µrad over 80 mm: 8 µm
    assert band_um(tilted, tilted.motion[:, 2:5])[0] == pytest.approx(0.0, abs=1e-6)
    assert band_um(tilted, np.ones((49, 1)))[0] == pytest.approx(8.0, rel=1e-3)


def test_the_datum_plane_touches_the_highest_points() -> None:
    """ISO 5459: from outside the material. A ridge of 6 µm along the middle of the datum lowers what is measured from it."""
    ridge = np.where(np.abs(grid((0, 0, 1), np.zeros((49, 1))).place_mm[:, :1]) < 1.0, 6.0, 0.0)
    datum, judged = grid((0, 0, 1), ridge), grid((0, 0, 1), np.zeros((49, 1)), offset=20.0)
    assert align([datum], 1).seen(judged).deviation_um.mean() == pytest.approx(-6.0, abs=0.01)


def axis_of(lateral: np.ndarray) -> FeaturePoints:
    """An axis along z with points every 10 mm."""
    place = np.repeat(np.column_stack([np.zeros((len(lateral), 2)), -10.0 * np.arange(len(lateral))]), 2, axis=0)
    return FeaturePoints(place, np.tile(np.eye(3)[:2], (len(lateral), 1)), lateral.reshape(-1, 1), axis=True)


def test_position_is_twice_the_largest_distance_and_direction_ignores_place() -> None:
    lateral = np.array([[3.0, 4.0], [3.0, 4.0], [3.0, 10.0]])
    none = np.zeros((6, 0))
    assert around_axis_um(axis_of(lateral), none, placed=True)[0] == pytest.approx(2.0 * np.hypot(3.0, 10.0))
    assert around_axis_um(axis_of(lateral), none, placed=False)[0] == pytest.approx(6.0)


@given(SEEDS)
def test_a_pattern_that_may_move_is_placed_best(seed: int) -> None:
    """Against a minimiser from several starts: the largest distance of four holes that may move in their plane."""
    rng = np.random.default_rng(seed)
    at = np.array([[-40.0, -30.0, 0.0], [40.0, -30.0, 0.0], [40.0, 30.0, 0.0], [-40.0, 30.0, 0.0]])
    off = 10.0 * rng.normal(size=(4, 2))
    pattern = FeaturePoints(np.repeat(at, 2, axis=0), np.tile(np.eye(3)[:2], (4, 1)), off.reshape(-1, 1), axis=True)
    free = pattern.motion[:, [0, 1, 5]]
    scale = np.linalg.norm(free, axis=0)
    value = around_axis_um(pattern, free / scale, placed=True)[0]

    def inside(x: np.ndarray) -> np.ndarray:
        left = (off.ravel() - free / scale @ x[:3]).reshape(4, 2)
        return x[3] ** 2 - (left**2).sum(axis=1)

    start = np.append(np.zeros(3), np.linalg.norm(off, axis=1).max() + 1.0)
    found = minimize(
        lambda x: x[3],
        start,
        constraints={"type": "ineq", "fun": inside},
        method="SLSQP",
        options={"ftol": 1e-10, "maxiter": 500},
    )
    assert value == pytest.approx(2.0 * found.fun, rel=0.01)
    assert value > 2.0 * found.fun * (1.0 - 1e-4)
