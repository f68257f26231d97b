"""Pose comparison of many commands, checked against poses evaluated one by one, for all ways of computing them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.compute.test_native import compiled, eager, libraries  # noqa: F401
from twin.compensation.comparison import Commands, PoseComparison
from twin.compute import batch
from twin.compute.native import loading
from twin.kinematics.forward import Kinematics, angle_between_rad
from twin.machine.calibration import Calibration
from twin.machine.effects import Reversal
from twin.machine.machine import Machine
from twin.numerics.spatial import tilt

LENGTH = 60.0
LIMITS = np.array([[50.0, 450.0], [50.0, 400.0], [-350.0, -50.0], [10.0, 80.0], [10.0, 300.0]])
ROUNDING_MM, ROUNDING_RAD = 1e-11, 1e-14
"""About a hundred successive roundings of lengths of a metre and cosines of at most one."""


def lines(n: int, seed: int) -> Commands:
    """Return points on a hundred lines."""
    rng = np.random.default_rng(seed)
    begin = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (100, 5))
    return Commands(begin, rng.normal(size=(100, 5)), np.sort(rng.integers(0, 100, n)), rng.uniform(0.0, 1.0, n))


@pytest.mark.parametrize(
    "n, switch",
    [(50, "0"), (batch.MANY + 3, "0"), pytest.param(loading.PORTION + 5, "1", marks=compiled)],
    ids=["CasADi", "NumPy", "compiled"],
)
@pytest.mark.usefixtures("eager")
def test_poses_compared_with_nominal_ones(
    n: int, switch: str, dmu50: Machine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(loading.SWITCH_VARIABLE, switch)
    real = Kinematics(dmu50, calibration, tool_length_mm=LENGTH)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=LENGTH)
    comparison = PoseComparison(real, nominal)
    meant, given = lines(n, 5), lines(n, 6)
    found = comparison.poses(meant, given)
    reached, target = real.forward(given.as_array()), nominal.forward(meant.as_array())
    distance = np.linalg.norm(reached.point_mm - target.point_mm, axis=1)
    assert np.abs(found.distance_mm - distance).max() <= ROUNDING_MM
    assert np.abs(found.angle_rad - angle_between_rad(reached.axis, target.axis)).max() <= ROUNDING_RAD
    leaning = np.einsum("nij,ni->nj", target.rotation, reached.axis)
    assert np.abs(found.axis_in_nominal_frame - leaning).max() <= ROUNDING_RAD
    assert found.known.all()
    assert np.abs(comparison.distance_mm(meant, given) - distance).max() <= ROUNDING_MM
    # The same as arrays; with nominal commands as input, the deviation is that of the errors alone.
    plain = comparison.poses(Commands(meant.as_array()), Commands(given.as_array()))
    assert np.abs(plain.distance_mm - distance).max() <= ROUNDING_MM
    errors = comparison.poses(given, given)
    small = real.forward(given.as_array())
    truth = nominal.forward(given.as_array())
    assert np.abs(np.linalg.norm(small.point_mm - truth.point_mm, axis=1) - errors.distance_mm).max() <= ROUNDING_MM
    assert tilt(errors.axis_in_nominal_frame) == pytest.approx(small.tilt_urad(truth) * 1e-6, abs=ROUNDING_RAD)
    which = np.array([3, 1, 40])
    assert np.array_equal(given.as_array(which), given.as_array()[which])


def test_unknown_poses(dmu50: Machine, calibration: Calibration) -> None:
    """Values that are not finite, or outside a curve's domain by more than rounding, give ``known`` False and never an error."""
    comparison = PoseComparison(Kinematics(dmu50, calibration), Kinematics(dmu50, Calibration.zero(dmu50)))
    lower, upper = calibration.domains()[0]
    q = np.tile(LIMITS.mean(axis=1), (7, 1))
    q[1, 2], q[2, 0], q[3, 0], q[4, 0], q[5, 0] = np.nan, upper + 1e-10, upper + 1e-8, lower - 1e-8, np.inf
    known = [True, False, True, False, False, False, True]
    assert comparison.poses(Commands(q), Commands(q)).known.tolist() == known
    # Nominal commands belong to the machine without errors, which has no curves.
    assert comparison.poses(Commands(q), Commands(q[:1].repeat(7, axis=0))).known.tolist() == [
        True, False, True, True, True, False, True,
    ]  # fmt: skip
    assert comparison.poses(Commands(q), Commands(q)).where(np.array(known)).known.all()


def test_sides_of_a_reversal(dmu50: Machine) -> None:
    """Half of the reversal value in either direction, zero where the direction is unknown."""
    reversed_ = replace(Calibration.zero(dmu50), extra=(Reversal(dmu50.by_name["X"], 6.0),))
    comparison = PoseComparison(Kinematics(dmu50, reversed_), Kinematics(dmu50, Calibration.zero(dmu50)))
    q = Commands(np.tile(LIMITS.mean(axis=1), (3, 1)))
    sides = np.zeros((3, 5))
    sides[:, dmu50.names.index("X")] = 1.0, -1.0, 0.0
    assert comparison.distance_mm(q, q, sides) * 1e3 == pytest.approx([3.0, 3.0, 0.0], abs=1e-9)
    assert comparison.distance_mm(q, q) * 1e3 == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
