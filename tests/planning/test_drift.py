"""Drift tests as sequences: schedules, poses from an independent chain, and evaluation of the filled plan."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import refused
from tests.truth.reference import dmu50_pose
from twin import cli
from twin._common.families import DRIFT_INSTRUMENTS
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.drift import DRIFTS, DriftPlan, drift_plan
from twin.planning.sequences.specification import InstrumentSizes
from twin.standards import evaluate_drift

LENGTH = 120.0
OPTIONS = {"environment": {}, "spindle": {"highest_rpm": 12000.0}, "axes": {"axis": "Y"}}
every_pair = pytest.mark.parametrize(
    ("name", "instrument"), [(one.name, tool) for one in DRIFTS for tool in DRIFT_INSTRUMENTS]
)


def planned(machine: Machine, name: str, instrument: str, **more: object) -> DriftPlan:
    options = {**OPTIONS[name], **more}
    return drift_plan(machine, name, instrument, sizes=InstrumentSizes(LENGTH), options=options)


def status(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(word) for word in words])
    return int(ended.value.code or 0)


@every_pair
def test_the_tool_is_at_the_parts_and_the_times_fit(dmu50: Machine, name: str, instrument: str) -> None:
    made = planned(dmu50, name, instrument)
    table, places = made.table, np.array(list(made.task.base.places_mm.values()))
    at = np.array([dmu50_pose([*q[:3], *np.radians(q[3:])], {}, LENGTH)[:3, 3] for q in table.positions])
    assert np.linalg.norm(at - places[made.schedule.pose], axis=1).max() < 1.5e-3
    assert np.all(np.diff(table.time_s) > 0.0) and table.time_s[0] == 0.0
    assert table.time_s[-1] <= 60.0 * made.sequence.minutes + 1.0
    assert any("not checked against the text" in text for text in made.notices())
    assert len({tuple(q) for q in table.positions}) == made.sequence.targets


@pytest.mark.parametrize(("axis", "angles"), [("C", 4), ("B", 5)])
def test_readings_of_a_rotary_axis_follow_the_sphere(dmu50: Machine, axis: str, angles: int) -> None:
    made = planned(dmu50, "axes", "probe", axis=axis)
    (place,) = made.task.base.places_mm.values()
    at = np.array([dmu50_pose([*q[:3], *np.radians(q[3:])], {}, LENGTH)[:3, 3] for q in made.table.positions])
    assert np.linalg.norm(at - place, axis=1).max() < 1.5e-3
    turned = made.table.positions[:, "XYZBC".index(axis)]
    assert len(set(turned)) == angles and np.ptp(turned) >= 150.0
    assert np.all(np.diff(made.table.time_s) > 0.0) and any("E_X0" in text for text in made.notices())


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize(("axis", "wanted"), [("C", "axial_C_end"), ("Z", "e_Z_1_end")])
def test_filled_plans_of_a_rotary_axis_and_of_z_are_evaluated(
    dmu50: Machine, tmp_path: Path, axis: str, wanted: str
) -> None:
    """The recorded Z falls by 12 µm until the end: the tool moved up relative to the work."""
    path = tmp_path / "p.csv"
    planned(dmu50, "axes", "probe", axis=axis).save(path)
    lines = path.read_text().splitlines()
    first = next(i for i, text in enumerate(lines) if not text.startswith("#"))
    header, rows = lines[first].split(","), [text.split(",") for text in lines[first + 1 :]]
    time, z = header.index("time_s"), header.index("Z_mm")
    start, end = (float(rows[k][time]) for k in (0, -4 if axis == "C" else -2))
    for row in rows:
        row[z] = repr(float(row[z]) - 0.012 * min(max(float(row[time]) - start, 0.0) / (end - start), 1.0))
        row += ["0", "0", "0"]
    (tmp_path / "m.csv").write_text("\n".join([lines[first] + ",x_mm,y_mm,z_mm", *map(",".join, rows)]) + "\n")
    (test,) = evaluate_drift(tmp_path / "m.csv", dmu50).tests
    assert test.name == axis
    value = next(one.value for one in test.values if one.key == wanted)
    assert abs(value) == pytest.approx(12.0, abs=0.3)
    if axis == "Z":
        assert value > 0.0 and any("mm apart between the target positions" in text for text in test.remarks)


def test_speed_steps_end_in_rest(dmu50: Machine) -> None:
    made = planned(dmu50, "spindle", "r-test")
    minutes, speed = made.table.time_s / 60.0, made.table.channels["spindle_rpm"]
    assert speed[0] == 0.0 and np.all(speed[minutes > 240.0] == 0.0)
    for k, rpm in enumerate((3000.0, 6000.0, 9000.0, 12000.0)):
        assert np.all(speed[(minutes > 60.0 * k) & (minutes <= 60.0 * (k + 1))] == rpm)


def test_spectrum_depends_on_the_seed_only(dmu50: Machine) -> None:
    first, again, other = (
        planned(dmu50, "spindle", "r-test", spectrum=True, seed=seed).schedule.speed_rpm for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert set(first) <= {0.0, 3000.0, 6000.0, 9000.0, 12000.0} and first[1] > 0.0


def test_a_probe_says_how_long_the_spindle_stands(dmu50: Machine) -> None:
    notes = " ".join(planned(dmu50, "spindle", "probe").notices())
    assert "needs the spindle stopped: about 90 s" in notes and "15% of the time" in notes and "cool meanwhile" in notes
    assert "spindle stopped" not in " ".join(planned(dmu50, "spindle", "displacement").notices())


def test_filled_plan_of_a_probe_is_evaluated(dmu50: Machine, tmp_path: Path) -> None:
    """The spindle grows by 18 µm: the recorded Z rises with it."""
    path = tmp_path / "p.csv"
    planned(dmu50, "spindle", "probe").save(path)
    lines = path.read_text().splitlines()
    first = next(i for i, text in enumerate(lines) if not text.startswith("#"))
    header, filled = lines[first].split(","), []
    for text in lines[first + 1 :]:
        row = dict(zip(header, text.split(","), strict=True))
        growth = 0.018 * min(float(row["time_s"]) / 14400.0, 1.0)
        row["Z_mm"] = repr(float(row["Z_mm"]) + growth)
        filled.append(",".join([*row.values(), "0", "0", "0"]))
    (tmp_path / "m.csv").write_text("\n".join([lines[first] + ",x_mm,y_mm,z_mm", *filled]) + "\n")
    (test,) = evaluate_drift(tmp_path / "m.csv", dmu50).tests
    values = {one.key: one.value for one in test.values}
    assert test.name == "spindle"
    assert values["d_Z_end"] == pytest.approx(-18.0, abs=1e-6) and values["d_Z_60"] == pytest.approx(4.5, abs=1e-6)


def test_filled_record_of_axes_is_evaluated(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    planned(dmu50, "axes", "displacement").save(path)
    lines = path.read_text().splitlines()
    first = next(i for i, text in enumerate(lines) if not text.startswith("#"))
    cells = [text.split(",") for text in lines[first + 1 :]]
    y = lines[first].split(",").index("Y1_um")
    for k, row in enumerate(cells):
        row[y] = repr(20.0 * (k - 1) / (len(cells) - 2)) if k % 2 else "0"
    path.write_text("\n".join([*lines[: first + 1], *(",".join(row) for row in cells)]) + "\n")
    (test,) = evaluate_drift(path, dmu50).tests
    assert test.name == "Y"
    values = {one.key: one.value for one in test.values}
    assert values["e_Y1_2_end"] == pytest.approx(20.0) and values["e_Y_21"] == pytest.approx(20.0)
    assert any("without any reading: X1, X2, Y2, Z" in text for text in test.remarks)


def test_plan_reads_back_as_a_plan(dmu50: Machine, tmp_path: Path) -> None:
    path, report = tmp_path / "p.csv", tmp_path / "p.json"
    words = ["--tool-length", LENGTH, "-o", path, "--json", report]
    assert status("plan", "--drift", "environment", "--instrument", "r-test", *words) == 0
    table = Measurements.load(path, dmu50, plan=True)
    assert len(table) == json.loads(report.read_text())["points"] == 289 and not table.set_aside
    assert not table.channels["spindle_rpm"].any()


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--drift", "spindel"], "spindle"),
        (["--drift", "spindle"], "no highest spindle speed"),
        (["--drift", "axes", "--axis", "A"], "one of X, Y, Z, B, C"),
        (["--drift", "axes", "--axis", "C", "--instrument", "displacement"], "do not follow a rotary axis"),
        (["--drift", "axes", "--axis", "Z", "--tool-length", "400"], "no default places for Z"),
        (["--drift", "axes", "--feed", "100"], "no time to heat"),
        (["--drift", "environment", "--instrument", "tracker"], "displacement"),
        (["--drift", "environment", "--minutes", "5"], "too little time"),
        (["--drift", "environment", "--sequence", "turns"], "no option of another plan"),
        (["--highest-rpm", "9000"], "need --drift"),
        (["--drift", "spindle", "--highest-rpm", "1e9"], "impossible spindle speed"),
    ],
)
def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], what: str) -> None:
    assert what in refused(capsys, "plan", "-o", tmp_path / "p.csv", *words)
    assert not (tmp_path / "p.csv").exists()
