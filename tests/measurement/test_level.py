"""Electronic level: tilts from a machine model that shares no code with `twin`, read, identified and written again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.truth.machine import carried, in_datum, written
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.instruments import Level
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

ZERO = np.array([3.0, -2.0])
"""Rotations (a, b) of the level on its target, mrad."""


@pytest.fixture
def table(tmp_path: Path, dmu50: Machine) -> tuple[Path, Calibration]:
    """A level in the spindle relative to the table, along X, Y and Z: commands, and a and b in µrad with 0.5 µrad of noise."""
    model = written(tmp_path / "truth.yaml", in_datum(np.random.default_rng(1), size=100.0))
    rng = np.random.default_rng(2)
    lines = ["X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,station,station_carrier,a_urad,b_urad,u_a_urad,u_b_urad"]
    for axis, (low, high) in enumerate(((0, 500), (0, 450), (-400, 0))):
        for position in np.linspace(low, high, 25):
            q = np.array([250.0, 225.0, -200.0, 0.0, 0.0])
            q[axis] = position
            up = carried(model, q, "tool", np.array([0.0, 0.0, 1.0])) - carried(model, q, "tool", np.zeros(3))
            axes = np.array([carried(model, q, "work", e) - carried(model, q, "work", np.zeros(3)) for e in np.eye(3)])
            x, y, _ = axes @ up
            a, b = np.array([-y, x]) * 1e6 + 1e3 * ZERO + rng.normal(0.0, 0.5, 2)
            cells = [
                *(f"{value:.4f}" for value in q),
                "nose",
                "tool",
                "table",
                "work",
                f"{a:.4f}",
                f"{b:.4f}",
                "0.5",
                "0.5",
            ]
            lines.append(",".join(cells))
    path = tmp_path / "level.csv"
    path.write_text("\n".join(lines) + "\n")
    return path, Calibration.load(tmp_path / "truth.yaml", dmu50)


def test_tilts_of_linear_axes(table: tuple[Path, Calibration], dmu50: Machine) -> None:
    """E_AX … E_BZ within 4 u at five positions; nothing else is identifiable."""
    data = Measurements.load(table[0], dmu50)
    assert set(data.instrument) == {"level"} and data.u_mm[0, :2].tolist() == [0.0005, 0.0005]
    found = identify(data, dmu50)
    assert found.misfit.p_value > 1e-3 and not found.set_aside
    for axis, q in (
        ("X", [20, 130, 250, 370, 480]),
        ("Y", [20, 120, 230, 330, 430]),
        ("Z", [-380, -280, -200, -100, -20]),
    ):
        for letter in "AB":
            name, at = f"E_{letter}{axis}", np.array(q, dtype=float)
            own, true = (calibration.curves[name](at) for calibration in (found.calibration, table[1]))
            assert np.abs((own - own.mean()) - (true - true.mean())).max() < 2.5
    assert {"E_CX", "E_XX", "E_YZ", "E_C0Y"} <= {one.name for one in found.unidentified}


def test_it_is_written_and_read_again(table: tuple[Path, Calibration], dmu50: Machine, tmp_path: Path) -> None:
    data = Measurements.load(table[0], dmu50)
    data.save(tmp_path / "again.csv", dmu50)
    header = (tmp_path / "again.csv").read_text().splitlines()[0]
    assert "a_urad,b_urad,u_a_urad,u_b_urad" in header
    again = Measurements.load(tmp_path / "again.csv", dmu50)
    assert np.allclose(again.point_mm, data.point_mm, rtol=0.0, atol=1e-15, equal_nan=True)
    assert np.allclose(again.u_mm, data.u_mm, rtol=0.0, atol=1e-15, equal_nan=True)


def test_it_is_simulated(table: tuple[Path, Calibration], dmu50: Machine) -> None:
    """Against the readings of the other model: the mean is the zero of the level."""
    data = Measurements.load(table[0], dmu50)
    plan = replace(data, place_mm=np.tile([0.0, 0.0, 1000.0], (len(data), 1)), station_pose=np.zeros((len(data), 6)))
    exact, _ = simulate(plan, dmu50, table[1], Level(), np.random.default_rng(3), noise=False)
    off = (data.point_mm - exact.point_mm)[:, :2] * 1e3
    assert np.allclose(off.mean(axis=0), [1e3 * ZERO[1], -1e3 * ZERO[0]], atol=0.3)
    assert off.std(axis=0).max() < 0.7
