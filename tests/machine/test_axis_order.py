"""Independence of all results from the order in which a machine file lists the axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from tests.identification.plans import four_stations, volumetric
from tests.machine.reordered import columns, reordered
from tests.model.errors import random_calibration
from tests.tool.test_uncertainty import with_covariance
from twin._common.arrays import read_only
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker, TrackingInterferometer
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse
from twin.tool.uncertainty import ToolUncertainty, random_approach, volume


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return reordered(tmp_path_factory.mktemp("reordered"))


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    rng = np.random.default_rng(3)
    # Squareness is counted from the first linear axis, so its names depend on the order.
    square = random_calibration(dmu50, rng, 200.0)
    drawn = with_covariance(replace(square, squareness=MappingProxyType({})), rng, 2.0)
    wave = effect_named("pitch_error", "Y", {"amplitude": 4.0, "period": 10.0, "phase": 0.3}, dmu50)
    lost = effect_named("reversal", "B", {"size": 30.0}, dmu50)
    cross = effect_named("cross_axis", "E_ZY by X", {"coefficient": 25.0}, dmu50)
    return replace(drawn, extra=(wave, lost, cross))


@pytest.fixture(scope="module")
def same(errors: Calibration, other: Machine, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """The same errors, read from the file for the other machine."""
    path = tmp_path_factory.mktemp("same") / "c.yaml"
    errors.save(path)
    return Calibration.load(path, other)


def test_poses_inverse_and_uncertainty(dmu50: Machine, errors: Calibration, other: Machine, same: Calibration) -> None:
    q = volume(dmu50, 200, seed=4)
    sides, at = random_approach(q), columns(dmu50)
    one, two = Kinematics(dmu50, errors, tool_length_mm=120.0), Kinematics(other, same, tool_length_mm=120.0)
    poses, again = one.forward(q, sides), two.forward(q[:, at], sides[:, at])
    # Files have all digits; the sums are in another order.
    np.testing.assert_allclose(again.point_mm, poses.point_mm, atol=1e-9)
    np.testing.assert_allclose(again.rotation, poses.rotation, atol=1e-12)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=120.0).forward(q)
    solved, other_solved = Inverse(one).solve(nominal, q), Inverse(two).solve(nominal, q[:, at])
    np.testing.assert_allclose(other_solved.positions, solved.positions[:, at], atol=1e-7)
    first, second = ToolUncertainty(one).at(q, sides), ToolUncertainty(two).at(q[:, at], sides[:, at])
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-6, atol=1e-9)
    grid, permuted = (
        ToolUncertainty(own).on_grid(counts, {"B": 30.0}) for own, counts in ((one, (2, 3, 4)), (two, (4, 3, 2)))
    )
    place = {tuple(row): u for row, u in zip(grid.positions.tolist(), grid.uncertainty.standard_um, strict=True)}
    back = np.argsort(at)
    for row, u in zip(permuted.positions[:, back].tolist(), permuted.uncertainty.standard_um, strict=True):
        # Random directions of approach turn B by 30 µrad: a change of the derivatives in the fifth digit.
        np.testing.assert_allclose(u, place[tuple(row)], rtol=1e-4)


def permuted(table: Measurements, at: list[int]) -> Measurements:
    return replace(
        table,
        positions=read_only(table.positions[:, at]),
        approach=read_only(table.approach[:, at]),
        readback=read_only(table.readback[:, at]),
    )


@pytest.mark.parametrize("lengths", [False, True])
def test_a_simulated_measurement(
    dmu50: Machine, errors: Calibration, other: Machine, same: Calibration, tmp_path: Path, lengths: bool
) -> None:
    """The readings of a plan are the same, and the written table is read back by the other machine with its columns permuted."""
    plan = (
        four_stations(dmu50, np.random.default_rng(1), 8)
        if lengths
        else volumetric(dmu50, np.random.default_rng(1), 40)
    )
    plan = replace(plan, approach=read_only(random_approach(plan.positions)))
    at, instrument = columns(dmu50), TrackingInterferometer() if lengths else LaserTracker()
    one, _ = simulate(plan, dmu50, errors, instrument, np.random.default_rng(2))
    two, _ = simulate(permuted(plan, at), other, same, instrument, np.random.default_rng(2))
    # nm: the last digits of the same sums in another order, and of the noise's own factor.
    np.testing.assert_allclose(two.point_mm, one.point_mm, atol=1e-6)
    one.save(tmp_path / "m.csv", dmu50)
    read = Measurements.load(tmp_path / "m.csv", other)
    np.testing.assert_array_equal(read.positions, one.positions[:, at])
    np.testing.assert_array_equal(read.approach, one.approach[:, at])
