"""A spindle that grows, hidden in readings at several speeds, by a truth machine that shares no code with `twin`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.hidden import Hidden, Plan
from twin._common.errors import InputError
from twin.compensation import compensate
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3
TRUTH = Hidden("spindle_growth", "Z", {"amplitude": 25.0, "exponent": 1.5, "time_constant": 1200.0})
SPEEDS = (0.0, 12000.0, 4000.0, 8000.0, 0.0, 6000.0)


def planned(rng: np.random.Generator) -> Plan:
    """Readings in blocks of one speed each, some half an hour long."""
    of = hidden.rounded(hidden.plan(rng, poses=60))
    block = (len(SPEEDS) * np.arange(len(of.q))) // len(of.q)
    return replace(of, spindle_rpm=np.array(SPEEDS)[block])


def looked(folder: Path, machine: Machine, calibration: Calibration, effects: list[Hidden]) -> Diagnosis:
    rng = np.random.default_rng(8)
    of = planned(rng)
    read = hidden.noisy(hidden.points(of, effects), rng, "isotropic", SIGMA_MM)
    return diagnose(
        Measurements.load(hidden.write(folder / "measured.csv", of, read, u_mm=SIGMA_MM), machine), machine, calibration
    )


@pytest.mark.slow
def test_it_is_found_with_its_size(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    found = looked(tmp_path, dmu50, calibration, [TRUTH])
    (cause,) = found.causes
    assert (cause.effect, cause.where) == TRUTH.key and found.verdict == "explained"
    for quantity in cause.parameters[:3]:
        assert abs(quantity.value - TRUTH.numbers[quantity.name]) < 3.0 * quantity.u
    assert [quantity.name for quantity in cause.parameters] == ["amplitude", "exponent", "time_constant", "highest_rpm"]
    assert (cause.parameters[3].value, cause.parameters[3].unit) == (max(SPEEDS), "rpm")
    assert found.gain is not None and found.gain.held_out is not None
    assert found.gain.held_out.after_um < 1.1 * 1e3 * SIGMA_MM < found.gain.held_out.before_um
    path = tmp_path / "extended.yaml"
    found.extended.save(path)
    again = Calibration.load(path, dmu50)
    assert [effect.name for effect in again.extra] == ["spindle_growth:Z"]
    with pytest.raises(InputError, match="spindle_growth:Z needs time_s"):
        compensate("cone_frustum.nc", dmu50, again)
    cold = compensate("cone_frustum.nc", dmu50, again, time_s=0.0).report
    assert any("spindle 6000 1/min (S words)" in note.text for note in cold.notes)


def test_nothing_is_found_where_nothing_is(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    assert looked(tmp_path, dmu50, calibration, []).verdict == "consistent"


@pytest.mark.slow
def test_without_the_speed_it_cannot_be_told(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    of = planned(rng)
    read = hidden.noisy(hidden.points(of, [TRUTH]), rng, "isotropic", SIGMA_MM)
    table = hidden.write(tmp_path / "measured.csv", of, read, u_mm=SIGMA_MM, without=["spindle_rpm"])
    found = diagnose(Measurements.load(table, dmu50), dmu50, calibration)
    assert ("spindle_growth", "Z", "spindle_rpm") in found.not_evaluated
    assert found.verdict == "unexplained"


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        Hidden("thermal_drift", "Z", {"amplitude": 15.0, "time_constant": 3000.0}),
        Hidden("thermal_growth", "Z by bed", {"coefficient": 6.0}),
    ],
    ids=lambda truth: truth.effect,
)
def test_time_and_temperature_are_not_taken_for_the_speed(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, truth: Hidden
) -> None:
    """The decoy: the speed changes in blocks while the machine warms up."""
    found = looked(tmp_path, dmu50, calibration, [truth])
    (cause,) = found.causes
    assert (cause.effect, cause.where) == truth.key
    # A warm-up may also be that of a scale's sensor, which warms likewise; never the speed.
    assert "spindle_growth" not in {effect for effect, _ in cause.equivalent}
    for quantity in cause.parameters:
        assert abs(quantity.value - truth.numbers[quantity.name]) < 3.0 * quantity.u
