"""Outliers: a cause that moved rows is named, rows of a lost beam are set aside and listed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin.diagnosis import Diagnosis, diagnose
from twin.diagnosis import search as rows
from twin.diagnosis.readings import readings
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

POSES = 40
SIGMA_MM = 3e-3
BUMP = Hidden("target_shift", "P from round 3", {"shift_x": 70.0, "shift_y": 20.0, "shift_z": -50.0})
SETTLED = Hidden("thermal_drift", "Z", {"amplitude": 120.0, "time_constant": 400.0})


def look(
    folder: Path, machine: Machine, calibration: Calibration, effects: list[Hidden], lost: int, *, stated: bool
) -> tuple[Diagnosis, set[int]]:
    """A diagnosis, and the lines of the rows whose beam was lost: half a millimetre off in some direction."""
    rng = np.random.default_rng(11)
    plan = hidden.rounded(hidden.plan(rng, poses=POSES))
    read = hidden.noisy(hidden.points(plan, effects), rng, "isotropic", SIGMA_MM)
    rows = rng.choice(len(read), lost, replace=False)
    away = rng.standard_normal((lost, 3))
    read[rows] += 0.5 * away / np.linalg.norm(away, axis=1, keepdims=True)
    path = hidden.write(folder / "measured.csv", plan, read, u_mm=SIGMA_MM if stated else None)
    data = Measurements.load(path, machine)
    return diagnose(data, machine, calibration), {int(data.lines[row]) for row in rows}


@pytest.mark.sample(1)  # of 3
@pytest.mark.parametrize(
    ("lost", "stated"),
    [
        (5, True),
        pytest.param(0, True, marks=pytest.mark.slow),
        pytest.param(0, False, marks=pytest.mark.slow),
        pytest.param(5, False, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("truth", [BUMP, SETTLED, None], ids=["bump", "warm-up", "nothing"])
def test_rows_that_one_cause_moved_are_no_outliers_and_a_lost_beam_is(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, truth: Hidden | None, lost: int, stated: bool
) -> None:
    result, lines = look(tmp_path, dmu50, calibration, [] if truth is None else [truth], lost, stated=stated)
    assert {note.line for note in result.data.set_aside} == lines
    if truth is None:
        assert result.verdict == "consistent"
        return
    assert [(cause.effect, cause.where) for cause in result.causes] == [truth.key]
    for q in result.causes[0].parameters:
        # Three standard uncertainties, on seeded draws.
        assert abs(q.value - truth.numbers[q.name]) < 3.0 * q.u


def test_the_first_reading_of_a_target_and_of_a_station_may_be_bad(
    tmp_path: Path, dmu50: Machine, calibration: Calibration
) -> None:
    """Without it stations and targets come in another order: each keeps its own place."""
    rng = np.random.default_rng(12)
    plan = hidden.rounded(hidden.plan(rng, poses=20, stations=2))
    read = hidden.noisy(hidden.points(plan), rng, "isotropic", SIGMA_MM)
    read[:2] += 0.4
    data = Measurements.load(hidden.write(tmp_path / "measured.csv", plan, read, u_mm=SIGMA_MM), dmu50)
    placed = readings(data, dmu50, calibration)
    assert placed.bad[:2].all()
    problem = placed.without(placed.bad).problem
    assert list(dict.fromkeys(problem.network.data.target)) != list(placed.setup.targets)
    assert list(dict.fromkeys(problem.network.data.station)) != list(placed.setup.stations)
    # Before anything is fitted again: what the set-up of all rows leaves.
    assert np.sqrt(np.mean(problem.residual**2)) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_of_very_many_rows_some_show_why_others_are_off(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows, "OUTLIER_SAMPLE", 800)
    result, lines = look(tmp_path, dmu50, calibration, [BUMP], 5, stated=True)
    assert {note.line for note in result.data.set_aside} == lines
    assert [(cause.effect, cause.where) for cause in result.causes] == [BUMP.key]
