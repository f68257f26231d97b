"""Interpolation of a function along a path of many points: accuracy, number of evaluations, and paths that are not smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.compensation.test_compensate import LENGTH, compensate, uncertain
from tests.compensation.test_parts import HEAD, curve
from twin.compensation.programs.uncorrected import ACCURACY, EVALUATED_POINTS, FIRST_INTERVAL, interpolated
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty

NEAR = np.array([1.0, 0.3])


def grown(places: np.ndarray) -> np.ndarray:
    """Return (n, 2, 2): two groups, each with a large and a small value, all of which change by half over 100 mm and degrees."""
    x, c = places.T
    large = 3.0 + np.sin(x / 60.0) + np.cos(c / 60.0)
    return np.stack([np.stack([large, 0.01 * x], axis=1), np.stack([7.0 * large, c - c], axis=1)], axis=1)


class Counted:
    """Function that records which points it was evaluated at."""

    def __init__(self, places: np.ndarray) -> None:
        self.places = places
        self.asked: list[int] = []

    def __call__(self, which: np.ndarray) -> np.ndarray:
        self.asked += which.tolist()
        return grown(self.places[which])


def off(found: np.ndarray, places: np.ndarray) -> float:
    """Return the largest difference, relative to the largest value of the group."""
    truth = grown(places)
    return float((np.abs(found - truth) / np.abs(truth).max(axis=2, keepdims=True)).max())


def test_a_smooth_path() -> None:
    """About one hundredth of the points is evaluated, none twice."""
    t = np.linspace(0.0, 1.0, 40_000)
    places = np.stack([250 + 150 * np.cos(9 * t), 100 * t**2], axis=1)
    values = Counted(places)
    assert off(interpolated(values, places, NEAR), places) <= ACCURACY
    assert len(values.asked) == len(set(values.asked)) <= 3 * len(t) / FIRST_INTERVAL


def test_steps_of_many_lengths() -> None:
    """On one straight line with uneven steps, interpolation goes by distance."""
    places = np.cumsum(np.random.default_rng(3).exponential(0.02, 9000))[:, None] * np.array([1.0, 0.1])
    values = Counted(places)
    assert off(interpolated(values, places, NEAR), places) <= ACCURACY
    assert len(values.asked) <= 5 * len(places) / FIRST_INTERVAL


@pytest.mark.parametrize("period", [2, 3, FIRST_INTERVAL, FIRST_INTERVAL // 2])
def test_back_and_forth_is_not_smooth(period: int) -> None:
    """Two distant positions in turn, where the nodes of stretches of 2, 4, 8 … blocks could all be at the same one."""
    places = np.zeros((3 * EVALUATED_POINTS, 2))
    places[::period, 0] = 200.0
    assert off(interpolated(Counted(places), places, NEAR), places) <= ACCURACY


def test_a_jump_and_standing_still() -> None:
    places = np.zeros((3 * EVALUATED_POINTS, 2))
    places[EVALUATED_POINTS + 77 :] = 150.0, 40.0
    values = Counted(places)
    # The function changes at one point only.
    assert off(interpolated(values, places, NEAR), places) == 0.0
    assert len(values.asked) <= 2 * len(places) / FIRST_INTERVAL + 3 + 2 * np.log2(FIRST_INTERVAL)


def test_noise_is_evaluated_everywhere() -> None:
    places = np.random.default_rng(4).uniform(0.0, 300.0, (EVALUATED_POINTS + 500, 2))
    assert off(interpolated(Counted(places), places, NEAR), places) == 0.0


@pytest.mark.parametrize("count", [1, 2, EVALUATED_POINTS])
def test_few_places_are_evaluated(count: int) -> None:
    places = np.linspace(0.0, 1.0, count)[:, None] * np.array([100.0, 10.0])
    values = Counted(places)
    assert off(interpolated(values, places, NEAR), places) == 0.0
    assert values.asked == list(range(count))


@pytest.mark.slow
def test_uncertainty_of_a_long_program(dmu50: Machine, calibration: Calibration) -> None:
    """The reported uncertainty compared with evaluation at every end point: U to two digits; relative to the largest direction."""
    known = uncertain(calibration, 0.3)
    result = compensate(HEAD + curve(2 * EVALUATED_POINTS), dmu50, known)
    point, axis = result.report.uncertainty.point, result.report.uncertainty.axis
    assert point is not None and axis is not None
    at = ToolUncertainty(Kinematics(dmu50, known, tool_length_mm=LENGTH)).at(result.nominal)
    assert point.expanded_rms == pytest.approx(np.sqrt(np.mean(at.expanded_um**2)), rel=ACCURACY / 4)
    assert point.expanded_max == pytest.approx(at.expanded_um.max(), rel=ACCURACY)
    assert axis.expanded_max == pytest.approx(at.axis_expanded_urad.max(), rel=ACCURACY)
    assert point.standard_rms == pytest.approx(
        np.sqrt(np.mean(at.standard_um**2, axis=0)), abs=ACCURACY * point.expanded_rms
    )
    nowhere = compensate(
        HEAD + curve(2 * EVALUATED_POINTS), dmu50, replace(known, joint=calibration.joint)
    ).report.uncertainty.point
    assert nowhere is not None and not nowhere.known and np.isnan(nowhere.expanded_rms)
