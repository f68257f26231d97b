"""Pose comparison of many commands, checked against poses evaluated one by one, for all ways of computing them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.compute.test_native import compiled, eager, libraries  # noqa: F401
from twin.compensation.programs.comparison import Commands, PoseComparison
from twin.compensation.programs.words import Setup, WordSpace
from twin.compute import along as batch
from twin.compute.native import compiler
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import Reversal
from twin.tool.forward import Kinematics, angle_between_rad
from twin.tool.inverse import Inverse

LENGTH = 60.0
LIMITS = np.array([[50.0, 450.0], [50.0, 400.0], [-350.0, -50.0], [10.0, 80.0], [10.0, 300.0]])
ROUNDING_MM, ROUNDING_RAD = 1e-11, 1e-14
"""About a hundred successive roundings of lengths of a metre and cosines of at most one."""


def lines(n: int, seed: int) -> Commands:
    """Return points on a hundred lines: n together."""
    rng = np.random.default_rng(seed)
    begin = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (100, 5))
    points = np.random.default_rng(n).multinomial(n, np.full(100, 0.01))  # the same for all seeds
    return Commands(begin, rng.normal(size=(100, 5)), points)


@pytest.mark.sample(2)  # of 3
@pytest.mark.parametrize(
    "n, switch",
    [(50, "0"), (batch.MANY + 3, "0"), pytest.param(compiler.PORTION + 5, "1", marks=compiled)],
    ids=["CasADi", "NumPy", "compiled"],
)
@pytest.mark.usefixtures("eager")
def test_poses_compared_with_nominal_ones(
    n: int, switch: str, dmu50: Machine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, switch)
    real = Kinematics(dmu50, calibration, tool_length_mm=LENGTH)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=LENGTH)
    comparison = PoseComparison(real, nominal)
    meant, given = lines(n, 5), lines(n, 6)
    q, written = meant.as_array(), given.as_array()
    found = comparison.poses(q, written)
    reached, target = real.forward(written), nominal.forward(q)
    distance = np.linalg.norm(reached.point_mm - target.point_mm, axis=1)
    angle = angle_between_rad(reached.axis, target.axis)
    assert np.abs(found.distance_mm - distance).max() <= ROUNDING_MM
    assert np.abs(found.angle_rad - angle).max() <= ROUNDING_RAD
    assert found.known.all()
    worst = np.zeros(100)
    line = np.repeat(np.arange(100), meant.counts)
    np.maximum.at(worst, line, distance)
    assert np.abs(comparison.distance_mm(meant, given) - worst).max() <= ROUNDING_MM
    # Totals, with nominal commands and with written ones, of distance, angle and tilts.
    at_nominal = real.forward(q)
    for totals, poses in zip(comparison.totals(meant, given, None, None), (at_nominal, reached), strict=True):
        apart = np.linalg.norm(poses.point_mm - target.point_mm, axis=1) * 1e3
        turned = angle_between_rad(poses.axis, target.axis) * 1e6
        x, y, z = np.einsum("nij,ni->jn", target.rotation, poses.axis)
        size = np.stack([apart, turned, *(np.abs(np.arctan2([-y, x], z)) * 1e6)])
        assert totals.count == n and totals.squares == pytest.approx((size**2).sum(axis=1), rel=1e-9)
        at = size.argmax(axis=1)
        assert totals.largest == pytest.approx(size[:, at].T, abs=ROUNDING_RAD * 1e6)
        assert totals.line.tolist() == line[at].tolist()
    # The same as single points, and for some of the lines.
    single = comparison.distance_mm(Commands(q), Commands(written))
    assert np.abs(single - distance).max() <= ROUNDING_MM
    which = np.array([3, 1, 40])
    expected = np.concatenate([written[line == i] for i in which])
    assert np.array_equal(given.of(which).as_array(), expected)


def test_unknown_poses(dmu50: Machine, calibration: Calibration) -> None:
    """Values that are not finite, or outside a curve's domain by more than rounding, give ``known`` False and never an error."""
    comparison = PoseComparison(Kinematics(dmu50, calibration), Kinematics(dmu50, Calibration.zero(dmu50)))
    lower, upper = calibration.domains()[0]
    q = np.tile(LIMITS.mean(axis=1), (7, 1))
    q[1, 2], q[2, 0], q[3, 0], q[4, 0], q[5, 0] = np.nan, upper + 1e-10, upper + 1e-8, lower - 1e-8, np.inf
    known = [True, False, True, False, False, False, True]
    assert comparison.poses(q, q).known.tolist() == comparison.known(q).tolist() == known
    # Nominal commands belong to the machine without errors, which has no curves.
    assert comparison.poses(q, q[:1].repeat(7, axis=0)).known.tolist() == [
        True, False, True, True, True, False, True,
    ]  # fmt: skip
    assert [one.count for one in comparison.totals(Commands(q), Commands(q), None, None)] == [3, 3]


def test_sides_of_a_reversal(dmu50: Machine) -> None:
    """Half of the reversal value in either direction, zero where the direction is unknown."""
    reversed_ = replace(Calibration.zero(dmu50), extra=(Reversal(dmu50.by_name["X"], 6.0),))
    comparison = PoseComparison(Kinematics(dmu50, reversed_), Kinematics(dmu50, Calibration.zero(dmu50)))
    q = Commands(np.tile(LIMITS.mean(axis=1), (3, 1)))
    sides = np.zeros((3, 5))
    sides[:, dmu50.names.index("X")] = 1.0, -1.0, 0.0
    assert comparison.distance_mm(q, q, sides) * 1e3 == pytest.approx([3.0, 3.0, 0.0], abs=1e-9)
    assert comparison.distance_mm(q, q) * 1e3 == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("tips", [(True, True), (True, False), (False, True)], ids=["both", "nominal", "written"])
def test_lines_of_words_of_the_tool_tip(tips: tuple[bool, bool], dmu50: Machine, calibration: Calibration) -> None:
    """As many points, converted to commands one by one by the solver."""
    setup = Setup(work_offset={"X": 5.0, "B": 1.0, "C": -2.0}, work_origin_mm=(12.0, -7.0, 30.0))
    space = WordSpace(dmu50, setup, LENGTH)
    comparison = PoseComparison(Kinematics(dmu50, calibration, tool_length_mm=LENGTH), space.nominal, space.commands_at)

    def converted(words: np.ndarray) -> np.ndarray:
        return space.commands(words, np.ones(len(words), dtype=bool))

    def tool_tip(points: Commands) -> Commands:
        words = space.words(points.begin, np.ones(len(points.begin), dtype=bool))
        return Commands(words, points.way, points.points, converted)

    given = [tool_tip(one) if tip else one for one, tip in zip((lines(60, 5), lines(60, 6)), tips, strict=True)]
    single = [Commands(one.as_array()) for one in given]
    worst, line = np.zeros(100), np.repeat(np.arange(100), given[0].counts)
    np.maximum.at(worst, line, comparison.distance_mm(*single))
    assert np.abs(comparison.distance_mm(given[0], given[1]) - worst).max() <= ROUNDING_MM
    for found, expected in zip(
        comparison.totals(*given, None, None), comparison.totals(*single, None, None), strict=True
    ):
        assert found.count == expected.count == 60
        assert found.squares == pytest.approx(expected.squares, rel=1e-9)
        assert found.line.tolist() == line[expected.line].tolist()
    few = np.array([3, 1, 40])
    assert np.array_equal(given[0].of(few).as_array(), np.concatenate([single[0].begin[line == i] for i in few]))


@compiled
@pytest.mark.usefixtures("eager")
def test_small_deviations_are_confirmed(dmu50: Machine, calibration: Calibration) -> None:
    """Angles of tenths of a microradian have a tenth of a nanoradian of rounding: no reason to refuse the compiled code."""
    real, nominal = Kinematics(dmu50, calibration), Kinematics(dmu50, Calibration.zero(dmu50))
    q = np.tile([100.0, 100.0, -100.0, 30.0, 10.0], (400, 1))
    way = np.zeros_like(q)
    q[1::2, 0], way[:, 0] = 110.0, np.tile([10.0, -10.0], 200)
    meant = Commands(q, way, np.full(400, 5))
    begin, end = (Inverse(real).solve(nominal.forward(at), at).positions for at in (q, q + way))
    comparison = PoseComparison(real, nominal)
    _, after = comparison.totals(meant, Commands(begin, end - begin, meant.points), None, None)
    assert comparison._function(comparison._totals, meant, meant)._confirmed
    assert after.count == 2000 and after.largest[1, 1] < 1.0
