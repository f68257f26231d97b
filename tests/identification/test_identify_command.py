"""`twin identify` as a user calls it, and the files it writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twin import cli
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty, volume


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("measured") / "m.csv"
    assert status("simulate", "thesis_plan.csv", "-o", path, "--seed", 7) == 0
    return path


@pytest.mark.slow
def test_from_a_plan_to_a_calibration(
    measured: Path, tmp_path: Path, dmu50: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "c.yaml", tmp_path / "r.json"
    assert status("identify", measured, "-o", out, "--json", report) == 0
    text = capsys.readouterr().out
    assert "840 points of 6 targets from 1 station" in text and f"written: {out}, {report}" in text
    found = Calibration.load(out, dmu50)
    assert set(found.curves) == set(dmu50.motion_names) and found.without_uncertainty == ()
    said = json.loads(report.read_text())
    assert said["schema"] == "twin.identification/1" and said["points"] == {"used": 840, "set_aside": 0}
    assert {
        "machine",
        "data",
        "errors",
        "not_identifiable",
        "stations",
        "targets",
        "misfit",
        "orders",
        "notices",
    } <= set(said)
    assert [row["name"] for row in said["errors"]] == [*found.curves, *found.squareness, *found.location]
    assert {row["name"] for row in said["not_identifiable"]} == {"E_X0B", "E_Y0B", "E_Y0C"}
    assert 0.9 < said["misfit"]["reduced_chi2"] < 1.1  # 2300 degrees of freedom: 3.4 standard deviations
    # Reading the file back gives the same uncertainty at the tool; 1e-9 of it is what its digits and the sum's order leave.
    before = identify(Measurements.load(measured, dmu50), dmu50).calibration
    q = volume(dmu50, 20)
    ours, theirs = (
        ToolUncertainty(Kinematics(dmu50, one, tool_length_mm=100.0)).at(q).expanded_um for one in (before, found)
    )
    assert np.all(ours > 0.0) and ours == pytest.approx(theirs, rel=1e-9)


@pytest.mark.slow
def test_outliers_give_exit_status_3(measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = measured.read_text().splitlines()
    header = next(i for i, line in enumerate(lines) if line.startswith("X_mm"))
    column = lines[header].split(",").index("y_mm")
    cells = lines[header + 100].split(",")
    cells[column] = repr(float(cells[column]) + 1.0)
    lines[header + 100] = ",".join(cells)
    bad, out, report = tmp_path / "bad.csv", tmp_path / "c.yaml", tmp_path / "r.json"
    bad.write_text("\n".join(lines) + "\n")
    assert status("identify", bad, "-o", out, "--json", report, "--only", "E_*X", "E_*Y", "E_*Z", "E_*C", "E_*B") == 3
    assert f"line {header + 101}: outlier" in capsys.readouterr().out
    assert [entry["line"] for entry in json.loads(report.read_text())["set_aside"]] == [header + 101]
    assert out.exists()


def test_swapped_columns_leave_nothing(measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad, out, report = tmp_path / "bad.csv", tmp_path / "c.yaml", tmp_path / "r.json"
    bad.write_text(measured.read_text().replace("X_mm,Y_mm,", "Y_mm,X_mm,", 1))
    assert status("identify", bad, "-o", out, "--json", report) == 2
    message = capsys.readouterr().err
    assert "columns X_mm and Y_mm look swapped" in message and "bad.csv" in message and message.count("\n") == 1
    assert not out.exists() and not report.exists()


def test_bad_usage_leaves_nothing(measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "c.yaml"
    for arguments, words in (
        (["--only", "E_QQ"], "--only matches no error"),
        (["--instrument", "ruler"], "one of tracker"),
        (["--instrument", "interferometer"], "reads one number"),
    ):
        assert status("identify", measured, "-o", out, *arguments) == 2
        assert words in capsys.readouterr().err and not out.exists()
    content = measured.read_text()
    assert status("identify", measured, "-o", measured) == 2 and measured.read_text() == content
