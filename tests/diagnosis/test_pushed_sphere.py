"""A sphere that was pushed while a touch probe went round: named with its line and its way, in readings by plain numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.identification.test_curves_that_predict import LENGTH, NOISE_MM, SPHERES, at, reachable
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

POSES = 12
PUSH_MM = np.array([0.020, -0.015, 0.0])
HEAD = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,station,station_carrier,instrument,x_mm,y_mm,z_mm"
FIRST_LINE = 2


def probed(folder: Path, machine: Machine, pushed: int | None, seed: int) -> Measurements:
    """Return spheres found in turn on a machine without errors; the second is pushed before its pose ``pushed``."""
    rng, lines = np.random.default_rng(seed), [HEAD]
    none = {"scale": np.zeros(3)}
    for name, place in SPHERES.items():
        count = 0
        while count < POSES:
            rotary = np.round(rng.uniform([0.0, 0.0], [120.0, 360.0]) / 15.0) * 15.0
            shift = PUSH_MM if name == "K2" and pushed is not None and count >= pushed else np.zeros(3)
            q = at(np.array(place) + shift + rng.normal(0.0, NOISE_MM, 3), rotary, none, LENGTH)
            if reachable(q):
                count += 1
                lines.append(",".join(f"{v:.6f}" for v in q) + f",{name},work,probe,tool,probe,0,0,0")
    (folder / "probed.csv").write_text("\n".join(lines) + "\n")
    return Measurements.load(folder / "probed.csv", machine)


@pytest.mark.parametrize(
    "pushed", [6, pytest.param(3, marks=pytest.mark.slow), pytest.param(9, marks=pytest.mark.slow)]
)
def test_a_pushed_sphere_is_named(dmu50: Machine, tmp_path: Path, pushed: int) -> None:
    found = diagnose(probed(tmp_path, dmu50, pushed, 1), dmu50, Calibration.zero(dmu50))
    (cause,) = found.causes
    assert (cause.effect, cause.where) == ("target_shift", "K2 within round 1")
    sizes = {one.name: one.value for one in cause.parameters}
    assert sizes["line"] == FIRST_LINE + POSES + pushed
    assert f"from line {FIRST_LINE + POSES + pushed} of the table on" in found.to_text()
    assert np.allclose([sizes[f"shift_{axis}"] for axis in "xyz"], 1e3 * PUSH_MM, atol=2.5)


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 8))])
def test_spheres_at_rest_raise_no_alarm(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    found = diagnose(probed(tmp_path, dmu50, None, seed), dmu50, Calibration.zero(dmu50))
    assert not found.causes
