"""Records of a control beside the checks: temperatures of checks without any, and whether the correction was on."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.monitoring.folder import START, write_check
from tests.truth.machine import TruthMachine
from twin._common.errors import InputError
from twin.compensation.live import make_module, write_module
from twin.monitoring.record import ControlRecord, state_at

CALIBRATION = Path(__file__).resolve().parents[2] / "urdf" / "dmu50.calibration.yaml"
HEAD = "# record of the control: DMU 50 eVolution\n# date: {}\ntime_s,X_mm,T_bed_degC,spindle_rpm,fade,out_of_range,stale\n"
PER_KELVIN_UM = 3.0


def write_record(path: Path, begin: str, rows: list[tuple[float, str, float, int]]) -> Path:
    """Write a record; rows: seconds, temperature, fade, stale."""
    lines = [f"{time:.1f},12.0,{bed},0.0,{fade},0,{stale}" for time, bed, fade, stale in rows]
    path.write_text(
        HEAD.format(begin) + "\n".join([*lines[:1], "# 3.0 s: twin: sensor bed: no number", *lines[1:]]) + "\n"
    )
    return path


def bed(i: int) -> float:
    return 20.0 + 0.25 * i + 0.7 * float(np.sin(2.3 * i))


def dates(count: int) -> list[datetime]:
    return [START + timedelta(days=2 * i) for i in range(count)]


def test_the_temperature_of_the_record_explains_what_follows_it(tmp_path: Path, dmu50: twin.Machine) -> None:
    """Checks without a temperature: the record of the day has it, and only around the time of the check."""
    folder, rng = tmp_path / "checks", np.random.default_rng(3)
    folder.mkdir()
    for i, day in enumerate(dates(18)):
        truth = TruthMachine(CALIBRATION)
        truth.location["E_X0C"] += PER_KELVIN_UM * (bed(i) - 20.0)
        write_check(folder / f"c{i}.csv", truth, rng, comment=f"measured {day.isoformat()}")
        at = (day - day.replace(hour=6, minute=0)).total_seconds()
        begin = day.replace(hour=6, minute=0).isoformat() + "+05:00"
        rows = [
            (1.0, "35.0", 0.0, 0),
            *((at + 60.0 * k, f"{bed(i):.3f}", 0.0, 0) for k in range(31)),
            (at + 2000.0, "35.0", 0.0, 0),
        ]
        write_record(folder / f"control_{day:%Y-%m-%d}.csv", begin, rows)
    found = twin.watch(folder, dmu50, twin.Calibration.load(CALIBRATION, dmu50))
    assert len(found.checks) == 18
    assert [check.temperature_degC["bed"] for check in found.checks] == pytest.approx(
        [bed(i) for i in range(18)], abs=1e-3
    )
    (one,) = found.following
    assert one.series.name == "E_X0C" and abs(one.temperatures[0].per_kelvin - PER_KELVIN_UM) < 0.5
    assert any("18 records of the control; control_" in text for text in found.notices)


def test_checks_with_the_correction_are_compared_with_a_corrected_machine(tmp_path: Path, dmu50: twin.Machine) -> None:
    """The module holds the errors of the machine: off, the checks show them; on, none; both agree with its calibration."""
    folder, rng = tmp_path / "checks", np.random.default_rng(4)
    folder.mkdir()
    write_module(make_module(twin.Calibration.load(CALIBRATION, dmu50)), tmp_path / "live")
    live = twin.Calibration.load(tmp_path / "live" / "calibration.yaml", dmu50)
    for i, day in enumerate(dates(14)):
        truth = TruthMachine(CALIBRATION)
        if i % 2:
            truth.curves, truth.squareness, truth.location = {}, {}, {}
        if i >= 9:
            truth.location["E_X0C"] = truth.location.get("E_X0C", 0.0) + 12.0
        write_check(folder / f"c{i}.csv", truth, rng, comment=f"measured {day.isoformat()}")
        rows = [(10.0 * k, "21", float(i % 2), 0) for k in range(100)]
        write_record(folder / f"control_{day:%Y-%m-%d}.csv", (day - timedelta(seconds=60)).isoformat() + "+00:00", rows)
    found = twin.watch(folder, dmu50, live, settings=twin.WatchSettings(tolerance_mm=0.05))
    assert {check.instruments for check in found.checks} == {"probe", "probe with the correction in the control"}
    values = np.array([check.value[check.errors.index("E_X0C")] for check in found.checks])
    assert np.abs(values - np.where(np.arange(14) >= 9, 12.0, 0.0)).max() < 2.5
    assert [one.series.name for one in found.alarms] == ["E_X0C"] and found.good
    # The same checks with a calibration that does not know of the module.
    plain = twin.watch(folder, dmu50, twin.Calibration.load(CALIBRATION, dmu50))
    assert any("does not know of it" in text for text in plain.notices)


def test_without_a_record_a_live_calibration_is_taken_as_on(tmp_path: Path, dmu50: twin.Machine) -> None:
    folder, rng = tmp_path / "checks", np.random.default_rng(5)
    folder.mkdir()
    write_module(make_module(twin.Calibration.load(CALIBRATION, dmu50)), tmp_path / "live")
    live = twin.Calibration.load(tmp_path / "live" / "calibration.yaml", dmu50)
    truth = TruthMachine(CALIBRATION)
    truth.curves, truth.squareness, truth.location = {}, {}, {}
    write_check(folder / "one_2026-03-02.csv", truth, rng)
    write_check(folder / "two_2026-03-04T0810.csv", truth, rng)
    write_record(
        folder / "control_2026-03-04.csv",
        "2026-03-04T08:00:00+00:00",
        [(10.0 * k, "", k / 99.0, 1) for k in range(100)],
    )
    found = twin.watch(folder, dmu50, live)
    assert np.abs(found.checks[0].value).max() < 10.0
    assert "taken as on" in str(found.checks[0].notices)
    assert found.checks[1].instruments.endswith("while the correction was switched") and "repeat it" in str(
        found.checks[1].notices
    )


def test_the_record_is_that_of_the_time(tmp_path: Path) -> None:
    rows = [(0.0, "20", 1.0, 0), (100.0, "22", 1.0, 0), (200.0, "", 0.0, 1)]
    path = write_record(tmp_path / "control_2026-03-02.csv", "2026-03-02T08:00:00+01:00", rows)
    local = datetime(2026, 3, 2, 8, 0)
    state = state_at([path], local, timedelta(seconds=250), utc=False)
    assert state is not None and state.temperature_degC == {"bed": 21.0}
    assert (state.rows, state.on, state.off, state.stale) == (
        3,
        pytest.approx(2 / 3),
        pytest.approx(1 / 3),
        pytest.approx(1 / 3),
    )
    assert state_at([path], local, None, utc=True) is None
    hour = timedelta(hours=1)
    assert state_at([path], local - hour, timedelta(seconds=250), utc=True) == state
    assert state_at([path], local + 2 * hour, None, utc=False) is None
    assert state_at([path], local + timedelta(days=30), None, utc=False) is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("+01:00", "", "no beginning"),
        ("fade", "fad", "a column is missing"),
        (",1.0,0,0", ",x,0,0", "fade is not a number"),
        (",22,", ",NaN,", "T_bed_degC cannot be used"),
    ],
)
def test_a_record_that_cannot_be_used_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    rows = [(0.0, "20", 1.0, 0), (100.0, "22", 1.0, 0)]
    path = write_record(tmp_path / "control_2026-03-02.csv", "2026-03-02T08:00:00+01:00", rows)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=says) as raised:
        ControlRecord.load(path)
    assert raised.value.file == str(path)
