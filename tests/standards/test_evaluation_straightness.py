"""Straightness about three reference lines: compared with linear programming, polyfit and brute force, and its properties."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import linprog

from twin._common.errors import InputError
from twin.standards.iso230_1 import Straightness, straightness

SEEDS = st.integers(0, 2**32 - 1)
KINDS = ("noise", "walk", "steps", "bow", "line")


def drawn(seed: int, count: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return random positions in mm, unevenly spaced, and deviations of some µm: smooth, rough, with many equal values, or none."""
    rng = np.random.default_rng(seed)
    position = np.sort(rng.choice(5000, count, replace=False)) * 0.1 - 100.0
    if kind == "noise":
        return position, rng.normal(0.0, 5.0, count)
    if kind == "walk":
        return position, np.cumsum(rng.normal(0.0, 1.0, count))
    if kind == "steps":  # a dial gauge that reads whole µm: parallel edges, collinear points
        return position, rng.integers(-3, 4, count).astype(float)
    if kind == "bow":
        return position, 1e-4 * (position - 150.0) ** 2
    return position, 3.0 + 0.02 * position


CASE = {"seed": SEEDS, "count": st.integers(3, 40), "kind": st.sampled_from(KINDS)}


@given(**CASE)
def test_minimum_zone_agrees_with_linear_programming(seed: int, count: int, kind: str) -> None:
    position, deviation = drawn(seed, count, kind)
    result = straightness(position, deviation).minimum_zone
    # Least w with |d − a − b·p| ≤ w; positions scaled to ±1 for the solver's sake.
    scaled = (position - position.mean()) / np.ptp(position)
    ones = np.ones(count)
    rows = np.block(
        [[ones[:, None], scaled[:, None], -ones[:, None]], [-ones[:, None], -scaled[:, None], -ones[:, None]]]
    )
    found = linprog([0, 0, 1], A_ub=rows, b_ub=np.concatenate([deviation, -deviation]), bounds=[(None, None)] * 3)
    assert found.status == 0
    assert result.value_um == pytest.approx(2.0 * found.fun, abs=1e-6)  # the solver holds constraints to 1e-7


@given(seed=SEEDS, count=st.integers(3, 12), kind=st.sampled_from(KINDS))
def test_minimum_zone_is_the_best_of_all_pairs(seed: int, count: int, kind: str) -> None:
    position, deviation = drawn(seed, count, kind)
    result = straightness(position, deviation).minimum_zone
    slopes = [(deviation[j] - deviation[i]) / (position[j] - position[i]) for i, j in combinations(range(count), 2)]
    best = min(np.ptp(deviation - slope * position) for slope in slopes)
    assert result.value_um == pytest.approx(best, abs=1e-10)  # deviations of 100 µm at most, in doubles


@given(**CASE)
def test_minimum_zone_touches_two_points_and_one(seed: int, count: int, kind: str) -> None:
    position, deviation = drawn(seed, count, kind)
    zone = straightness(position, deviation).minimum_zone
    half = zone.value_um / 2.0
    on_border = zone.residual_um[list(zone.contacts)]
    assert np.abs(np.abs(on_border) - half).max() < 1e-10
    assert np.abs(zone.residual_um).max() <= half + 1e-10
    if half > 1e-9:  # not on a straight line
        # The one of its border lies between the two of the other: that is what makes it a minimum.
        assert len(zone.contacts) == 3
        assert list(np.sign(on_border)) in ([1, -1, 1], [-1, 1, -1])


@given(**CASE)
def test_least_squares_agrees_with_polyfit(seed: int, count: int, kind: str) -> None:
    position, deviation = drawn(seed, count, kind)
    line = straightness(position, deviation).least_squares
    middle = position.mean()
    slope, height = np.polyfit(position - middle, deviation, 1)
    assert line.slope_urad == pytest.approx(slope * 1e3, rel=1e-9, abs=1e-9)
    assert line.offset_um == pytest.approx(height - slope * middle, rel=1e-9, abs=1e-9)
    assert line.residual_um == pytest.approx(deviation - height - slope * (position - middle), abs=1e-9)
    assert line.residual_um.sum() == pytest.approx(0.0, abs=1e-9)
    assert line.value_um == pytest.approx(line.residual_um.max() - line.residual_um.min(), abs=1e-9)


@given(**CASE)
def test_end_point_line_goes_through_the_ends(seed: int, count: int, kind: str) -> None:
    position, deviation = drawn(seed, count, kind)
    line = straightness(position, deviation).end_point
    assert line.residual_um[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-10)
    assert line.slope_urad == pytest.approx(
        1e3 * (deviation[-1] - deviation[0]) / (position[-1] - position[0]), abs=1e-9
    )
    assert line.value_um == pytest.approx(np.ptp(line.residual_um), abs=1e-10)
    assert line.contacts == (0, count - 1)


@given(**CASE, offset=st.floats(-1e3, 1e3), slope=st.floats(-1e3, 1e3), factor=st.floats(-50.0, 50.0))
def test_properties(seed: int, count: int, kind: str, offset: float, slope: float, factor: float) -> None:
    position, deviation = drawn(seed, count, kind)
    result = straightness(position, deviation)
    # A straight line more changes no deviation from a line, and every line by itself.
    tilted = straightness(position, deviation + offset + 1e-3 * slope * position)
    scaled = straightness(position, deviation * factor)
    moved = straightness(position + 1000.0, deviation)
    back = straightness(-position, deviation)
    order = np.random.default_rng(seed).permutation(count)
    mixed = straightness(position[order], deviation[order])
    for line, other, times, shifted, mirrored, shuffled in zip(
        result.lines, tilted.lines, scaled.lines, moved.lines, back.lines, mixed.lines, strict=True
    ):
        # 1e-9: values of up to 1e3 µm, some tens of roundings.
        assert other.value_um == pytest.approx(line.value_um, abs=1e-9)
        assert times.value_um == pytest.approx(abs(factor) * line.value_um, abs=1e-9)
        assert shifted.value_um == pytest.approx(line.value_um, abs=1e-9)
        assert mirrored.value_um == pytest.approx(line.value_um, abs=1e-9)
        assert shuffled.value_um == line.value_um
        assert shuffled.slope_urad == line.slope_urad
        assert line.residual_um + line.at_um(position) == pytest.approx(deviation, abs=1e-9)
        assert line.value_um >= result.minimum_zone.value_um - 1e-10
    for line, other in ((result.least_squares, tilted.least_squares), (result.end_point, tilted.end_point)):
        assert other.slope_urad == pytest.approx(line.slope_urad + slope, rel=1e-9, abs=1e-6)  # closest points 0.1 mm
        assert other.residual_um == pytest.approx(line.residual_um, abs=1e-9)


@given(seed=SEEDS, count=st.integers(3, 12), kind=st.sampled_from(("noise", "walk", "bow")))
def test_covariance_is_the_lines_sensitivity(seed: int, count: int, kind: str) -> None:
    """The parameters of each line, recomputed with one deviation changed after another."""
    position, deviation = drawn(seed, count, kind)
    result = straightness(position, deviation, u_um=0.7)
    step = 1e-6  # small beside the deviations, so that the same points carry the zone
    for i, line in enumerate(result.lines):
        columns = []
        for k in range(count):
            ends = []
            for sign in (1.0, -1.0):
                changed = deviation.copy()
                changed[k] += sign * step
                moved = straightness(position, changed).lines[i]
                assume(moved.contacts == line.contacts)  # else a near tie: the zone has two sensitivities there
                ends.append(np.array([moved.offset_um, moved.slope_urad]))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
        sensitivity = np.array(columns).T
        assert line.covariance is not None
        # Differences of numbers of 1e3 over 2e-6: about 1e-7 of the larger entries.
        expected = 0.7**2 * sensitivity @ sensitivity.T
        assert np.allclose(line.covariance, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


def test_covariance_of_least_squares_by_the_textbook() -> None:
    position = np.linspace(0.0, 500.0, 11)
    line = straightness(position, np.sin(position), u_um=0.4).least_squares
    centred = position - 250.0
    slope_variance = 0.4**2 / np.sum(centred**2)
    assert line.u_slope_urad == pytest.approx(1e3 * np.sqrt(slope_variance), rel=1e-12)
    assert line.covariance is not None
    assert line.covariance[0, 0] == pytest.approx(0.4**2 / 11 + slope_variance * 250.0**2, rel=1e-12)
    assert line.covariance[0, 1] == pytest.approx(-1e3 * slope_variance * 250.0, rel=1e-12)


def test_misfit_does_not_rescale_the_uncertainty() -> None:
    position = np.linspace(0.0, 500.0, 11)
    small, large = (straightness(position, size * np.sin(position), u_um=0.4) for size in (0.1, 100.0))
    assert small.least_squares.u_slope_urad == large.least_squares.u_slope_urad
    assert straightness(position, np.sin(position)).least_squares.u_slope_urad is None


def test_worked_by_hand() -> None:
    result: Straightness = straightness([0, 100, 200, 300], [0, 3, 1, 2], name="E_YX")
    # End point: 2 µm in 300 mm; residuals 0, 7/3, −1/3, 0.
    assert result.end_point.slope_urad == pytest.approx(20.0 / 3.0, rel=1e-14)
    assert result.end_point.value_um == pytest.approx(8.0 / 3.0, rel=1e-14)
    # Least squares: slope 4/1000 µm/mm about 1.5 at 150 mm; residuals −0.9, 1.7, −0.7, −0.1.
    assert result.least_squares.slope_urad == pytest.approx(4.0, rel=1e-13)
    assert result.least_squares.residual_um == pytest.approx([-0.9, 1.7, -0.7, -0.1], abs=1e-13)
    assert result.least_squares.value_um == pytest.approx(2.6, rel=1e-13)
    # Minimum zone: the edge from (0, 0) to (200, 1) below, (100, 3) above; width 2.5.
    assert result.minimum_zone.contacts == (0, 1, 2)
    assert result.minimum_zone.slope_urad == pytest.approx(5.0, rel=1e-14)
    assert result.minimum_zone.offset_um == pytest.approx(1.25, rel=1e-13)
    assert result.minimum_zone.value_um == pytest.approx(2.5, rel=1e-13)


def test_results_do_not_change() -> None:
    result = straightness([0, 1, 2], [0, 1, 0], u_um=1.0)
    for array in (result.position_mm, result.minimum_zone.residual_um, result.least_squares.covariance):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 9.0


@pytest.mark.parametrize(
    ("position", "deviation", "more", "words"),
    [
        ([0, 1], [0, 1], {}, "at least 3 points"),
        ([0, 1, 1], [0, 1, 2], {}, "a position occurs twice: '1.0'"),
        ([0, 1, 2], [0, 1], {}, "3 rows"),
        ([0, 1, 2], [0, np.nan, 1], {}, "lack 1 of 3"),
        ([0, 1, 2], [0, 1, 2], {"u_um": -1.0}, "not negative"),
        ([0, 1, 2], [0, 1, 2], {"u_um": np.inf}, "finite"),
    ],
)
def test_bad_input(position: list[float], deviation: list[float], more: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        straightness(position, deviation, **more)
