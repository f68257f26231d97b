"""A drilled plate: holes in a circle, read in x and y only. The truth is plain arithmetic: no code of the package."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.real import plates
from twin.diagnosis.diagnose import diagnose
from twin.identification.identify import identify
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

HALF_X, HALF_Y = 320.0, 260.0  # travel of the drill about its middle, mm
SQUARENESS = ("squareness", "E_C0Y")


@pytest.fixture
def drill(tmp_path: Path) -> Machine:
    return Machine.load(plates.write_machine(tmp_path))


def plate(drill: Machine, path: Path, seed: int, *, square_urad: float, waves_um: float = 0.0) -> Measurements:
    """Return 600 holes within 235 mm of the middle of a plate that lies turned.

    X tilts about z as a curve that has no mean over these holes, weighted with their levers, and Y is straight but for a curve without
    slope over them; both have much of either over the whole travel.
    """
    rng = np.random.default_rng(seed)
    radius, angle = 235.0 * np.sqrt(rng.uniform(0.0, 1.0, 600)), rng.uniform(0.0, 2.0 * np.pi, 600)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    tilt = 400e-6 * (x / HALF_X) ** 2
    tilt -= np.sum(tilt * y**2) / np.sum(y**2)
    bow = 0.045 * (y / HALF_Y) ** 3
    bow -= np.polyval(np.polyfit(y, bow, 1), y)
    at_x = x - tilt * y + bow - 1e-6 * square_urad * y + 1e-3 * waves_um * np.sin(x / 23.0) * np.cos(y / 31.0)
    read = np.column_stack([at_x, y]) + 0.0037 * rng.standard_normal((600, 2))
    c, s = np.cos(0.3), np.sin(0.3)
    holes = np.column_stack([read @ [[c, s], [-s, c]] + [100.0, -50.0], x, y])
    return Measurements.load(plates.write_table(holes, path / f"plate{seed}.csv"), drill)


@pytest.mark.parametrize("seed", [2, 3])
def test_a_mean_line_over_unmeasured_travel_is_no_squareness(seed: int, drill: Machine, tmp_path: Path) -> None:
    """The curves are found, and a squareness only where the holes have one, with its size there."""
    for square in (0.0, 40.0):
        found = diagnose(plate(drill, tmp_path, seed, square_urad=square), drill, Calibration.zero(drill))
        causes = {(cause.effect, cause.where): cause for cause in found.causes}
        assert {("angular_error_motion", "E_CX"), ("straightness", "E_XY")} <= causes.keys()
        assert found.gain is not None and found.gain.rms_after_um < 4.2
        assert (SQUARENESS in causes) == bool(square)
        if square:
            said = re.search(r"over the measured positions alone (\d+\.?\d*) µrad", causes[SQUARENESS].evidence)
            assert said is not None and abs(float(said[1]) - square) < 6.0


def test_a_given_place_makes_no_error_less_certain(drill: Machine, tmp_path: Path) -> None:
    """Two turns of the plate out of its plane look like a squareness, to second order: nothing determines them."""
    given = plate(drill, tmp_path, 3, square_urad=20.0, waves_um=12.0)
    free = replace(given, place_mm=np.full_like(given.place_mm, np.nan))
    u = []
    for data in (given, free):
        found = identify(data, drill)
        assert found.converged and found.misfit.reduced > 2.0
        covariance = found.calibration.covariance
        at = covariance.names.index("E_C0Y")
        u.append(float(np.sqrt(covariance.matrix[at, at])))
    assert u[0] <= 1.02 * u[1] and u[1] < 40.0
