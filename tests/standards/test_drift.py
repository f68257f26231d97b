"""Thermal tests after ISO 230-3: figures by hand, tables from the chain of `motions`, which shares no code with `twin`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import refused
from tests.standards.motions import positions, to_machine, write
from twin import cli
from twin.machine.machine import Machine
from twin.standards import StandardTest, evaluate_drift

REAL = Path("/work/shared/data/real/spindle-thermal/first-half.csv")
TABLE = {"carrier": "tool"}


def record(path: Path, columns: dict[str, np.ndarray], comment: str = "") -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join("" if v != v else repr(float(v)) for v in row) for row in rows)]
    path.write_text((f"# {comment}\n" if comment else "") + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def value(test: StandardTest, key: str) -> float:
    return next(one.value for one in test.values if one.key == key)


def spindle_record(path: Path, comment: str = "") -> Path:
    """Return five sensors around a mandrel that moves 10 µm in X, tilts 50 µrad about Y and grows by 20 µm, in proportion to time."""
    minutes = np.arange(0.0, 301.0, 10.0)
    share = np.clip((minutes - 30.0) / 240.0, 0.0, 1.0)
    return record(
        path,
        {
            "time_s": 60.0 * minutes,
            "spindle_rpm": np.where((minutes > 30.0) & (minutes <= 270.0), 8000.0, 0.0),
            "d1_um": 10.0 * share,
            "d2_um": (10.0 + 50e-6 * 100.0 * 1e3) * share,
            "d3_um": 3.0 * share,
            "d4_um": np.where(minutes < 5.0, np.nan, 3.0 * share),
            "d5_um": -20.0 * share - 4.0,
            "T_room_degC": 20.0 + 0.01 * minutes,
        },
        comment,
    )


def test_spindle_by_hand(dmu50: Machine, tmp_path: Path) -> None:
    path = spindle_record(tmp_path / "r.csv", "sensors: d1=X1 d2=X2 d3=Y1 d4=Y2 d5=-Z X1-X2=100 Y1-Y2=100")
    (test,) = evaluate_drift(path, dmu50).tests
    assert test.kind == "rotating spindle" and test.name == "spindle"
    wanted = {
        "d_X1_end": 10.0,
        "d_X1_t": 10.0,
        "d_X1_60": 2.5,
        "d_X2_end": 15.0,
        "d_B_end": 50.0,
        "d_A_t": 0.0,
        "d_Z_end": 20.0,
    }
    for key, expected in wanted.items():
        assert value(test, key) == pytest.approx(expected, abs=1e-9), key
    assert any("not checked" in text for text in test.remarks)


def test_directions_are_never_guessed(dmu50: Machine, tmp_path: Path) -> None:
    (test,) = evaluate_drift(spindle_record(tmp_path / "r.csv"), dmu50).tests
    assert {one.key for one in test.values} == {f"d_d{k}_{end}" for k in range(1, 6) for end in ("end", "60", "t")}
    assert any("direction of d1, d2, d3, d4, d5 is not given" in text for text in test.remarks)
    (test,) = evaluate_drift(tmp_path / "r.csv", dmu50, sensors=["d1=X1", "d2=X2"]).tests
    assert "d_B_t" not in {one.key for one in test.values}
    assert any("the distance X1-X2" in text for text in test.remarks)


def test_environment_by_hand(dmu50: Machine, tmp_path: Path) -> None:
    hours = np.arange(0.0, 24.5, 0.5)
    wave = np.sin(2.0 * np.pi * hours / 24.0)
    columns = {"time_s": 3600.0 * hours, "dz_um": 6.0 * wave, "T_room_degC": 21.0 + 1.5 * wave}
    found = evaluate_drift(record(tmp_path / "r.csv", columns), dmu50, sensors=["dz=Z", "room=ambient"])
    (test,) = found.tests
    assert test.name == "ETVE"
    assert value(test, "ETVE_Z") == pytest.approx(12.0) and value(test, "T_ambient") == pytest.approx(3.0)
    assert value(test, "ETVE_Z_per_K") == pytest.approx(4.0)
    assert any("taken as stopped" in text for text in test.remarks)


def test_a_level_beside_a_sensor(dmu50: Machine, tmp_path: Path) -> None:
    """An angle keeps its name and unit, also one named like a tilt, and a record of angles alone is enough."""
    hours = np.arange(0.0, 24.5, 0.5)
    wave = np.sin(2.0 * np.pi * hours / 24.0)
    columns = {"time_s": 3600.0 * hours, "dz_um": 6.0 * wave, "B_urad": 20.0 * wave}
    for names in (("time_s", "dz_um", "B_urad"), ("time_s", "B_urad")):
        path = record(tmp_path / "r.csv", {name: columns[name] for name in names})
        (test,) = evaluate_drift(path, dmu50).tests
        (angle,) = [one for one in test.values if one.unit == "urad"]
        assert angle.key == "ETVE_angle_B" and angle.value == pytest.approx(40.0)
        assert len(test.values) == len(names) - 1


def test_a_long_rest_separates_spindle_tests(dmu50: Machine, tmp_path: Path) -> None:
    minutes = np.arange(0.0, 601.0, 10.0)
    speed = np.where(
        (minutes > 0) & (minutes <= 120), 1000.0, np.where((minutes > 300) & (minutes <= 500), 2000.0, 0.0)
    )
    columns = {"time_s": 60.0 * minutes, "spindle_rpm": speed, "a_um": minutes}
    first, second = evaluate_drift(record(tmp_path / "r.csv", columns), dmu50).tests
    assert (first.name, second.name) == ("spindle1", "spindle2")
    assert (value(first, "d_a_end"), value(second, "d_a_end")) == (120.0, 200.0)


def test_probe_and_r_test_show_the_same_displacement(dmu50: Machine, tmp_path: Path) -> None:
    """The tool moves by `drift` in the machine's directions: a nest turned with the table reads it, a probe's positions take it out."""
    minutes = np.arange(0.0, 121.0, 5.0)
    drift = np.outer(minutes / 120.0, [0.004, -0.003, 0.012])
    q = positions(len(minutes), B=np.full(len(minutes), 30.0), C=np.full(len(minutes), 70.0))
    axes = np.eye(3)
    origin = to_machine(np.zeros((1, 3)), q[:1, 3], q[:1, 4])[0]
    turned = np.array([to_machine(axes[i : i + 1], q[:1, 3], q[:1, 4])[0] - origin for i in range(3)])
    nest = write(
        tmp_path / "nest.csv", q, drift @ turned.T + 0.3,
        station=["n"] * len(q), station_carrier=["work"] * len(q), time_s=60.0 * minutes,
        spindle_rpm=np.where(minutes > 0.0, 5000.0, 0.0),
    )  # fmt: skip
    moved = q.copy()
    moved[:, :3] -= drift
    probe = write(
        tmp_path / "probe.csv", moved, np.zeros((len(q), 3)), carrier="work",
        station=["p"] * len(q), station_carrier=["tool"] * len(q), time_s=60.0 * minutes,
        spindle_rpm=np.where(minutes > 0.0, 5000.0, 0.0),
    )  # fmt: skip
    for path in (nest, probe):
        (test,) = evaluate_drift(path, dmu50).tests
        ends = [value(test, f"d_{name}_end") for name in "XYZ"]
        assert ends == pytest.approx([4.0, -3.0, 12.0], abs=1e-6), path.name


def test_tracker_subtracts_the_target_on_the_work(dmu50: Machine, tmp_path: Path) -> None:
    minutes = np.repeat(np.arange(0.0, 61.0, 10.0), 2)
    work = np.arange(len(minutes)) % 2 == 1
    times = 60.0 * minutes + 30.0 * work
    shift = np.where(work, 0.002, 0.007) * times / times[-1]
    path = write(
        tmp_path / "t.csv", positions(len(minutes)), 1000.0 + np.column_stack([shift, 0.0 * shift, 0.0 * shift]),
        time_s=times,
    )  # fmt: skip
    lines = path.read_text().splitlines()
    lines = [lines[0], *(t.replace(",K,tool,", ",P,work,") if w else t for t, w in zip(lines[1:], work, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    (test,) = evaluate_drift(path, dmu50).tests
    share = times[~work][-1] / times[-1]
    first = 0.002 * times[1] / times[-1]  # the work before its first reading is taken as at that reading
    assert value(test, "ETVE_x") == pytest.approx(1e3 * (0.005 * share + first), rel=1e-6)
    assert any("target P on the work" in text for text in test.remarks)


def test_axes_by_hand(dmu50: Machine, tmp_path: Path) -> None:
    """A scale of 400 mm that grows by 12 µm while the near end moves by 3 µm; two axes in rounds."""
    k = np.arange(12)
    far = k % 2 == 1
    columns = {
        "time_s": 300.0 * np.arange(24),
        "round": np.repeat([1.0, 2.0], 12),
        "X_mm": np.r_[np.where(far, 450.0, 50.0), np.full(12, 250.0)],
        "Y_mm": np.r_[np.full(12, 200.0), np.where(far, 400.0, 50.0)],
        "dx_um": np.r_[np.where(far, 15.0 * (k - 1) / 10.0, 3.0 * k / 10.0), np.zeros(12)],
    }
    x, y = evaluate_drift(record(tmp_path / "r.csv", columns), dmu50, sensors=["dx=X"]).tests
    assert (x.name, y.name) == ("X", "Y")
    assert value(x, "e_X_1") == pytest.approx(3.0) and value(x, "e_X_2_end") == pytest.approx(15.0)
    assert value(x, "e_X_21") == pytest.approx(12.0)
    assert value(y, "e_X_2") == 0.0


@pytest.mark.parametrize(
    ("given", "what"),
    [
        (["d1=Q"], "directions cannot be read"),
        (["d9=X"], "no such sensor"),
        (["d1=X1", "d1=X2"], "directions cannot be read"),
        (["d1=X", "d2=X1"], "both given"),
        (["X1-X2=0"], "distance of two sensors"),
        (["dusk=ambient"], "no such sensor"),
    ],
)
def test_directions_that_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], given: list[str], what: str
) -> None:
    path = spindle_record(tmp_path / "r.csv")
    assert what in refused(capsys, "evaluate", path, "--iso230-3", "--sensors", *given)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--iso230-3", "--length", "100"], "evaluates one record"),
        (["--iso230-3", "--instrument", "tracker"], "no noise model"),
        (["--sensors", "d1=X"], "--sensors needs --iso230-3"),
    ],
)
def test_options_that_exclude_each_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], what: str
) -> None:
    assert what in refused(capsys, "evaluate", spindle_record(tmp_path / "r.csv"), *words)


def test_records_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = {"time_s": np.array([0.0, 60.0, 120.0]), "a_um": np.zeros(3)}
    for changed, what in (
        ({"time_s": np.array([0.0, 60.0, 60.0])}, "r.csv:4"),
        ({"time_s": np.array([0.0, np.nan, 60.0])}, "time_s is empty"),
        ({"a_um": np.full(3, np.nan)}, "no displacement was read"),
        ({"spindle_rpm": np.array([0.0, -5.0, 0.0])}, "0 or above"),
    ):
        path = record(tmp_path / "r.csv", good | changed)
        assert what in refused(capsys, "evaluate", path, "--iso230-3")


def test_command_with_tolerances_page_and_json(tmp_path: Path) -> None:
    path = spindle_record(tmp_path / "r.csv", "sensors: d5=-Z")
    page, report = tmp_path / "p.html", tmp_path / "p.json"
    with pytest.raises(SystemExit) as ended:
        words = ["--tolerance", "spindle:d_Z_t=15", "d_d1_t=11", "--html", str(page), "--json", str(report)]
        cli.main(["evaluate", str(path), "--iso230-3", *words])
    assert ended.value.code == 3
    found = json.loads(report.read_text())
    assert [check["met"] for check in found["tolerances"]] == [False, True]
    assert "data:image" in page.read_text() and "FAIL" in page.read_text()


@pytest.mark.skipif(not REAL.exists(), reason="the record of a real spindle is not on this machine")
def test_real_record_has_three_periods(dmu50: Machine) -> None:
    tests = evaluate_drift(REAL, dmu50).tests
    rows = np.genfromtxt(REAL, delimiter=",", names=True)
    assert [test.name for test in tests] == ["spindle1", "spindle2", "spindle3"]
    for test, speed in zip(tests, (1250, 2500, 3750), strict=True):
        ran = np.flatnonzero(rows["spindle_rpm"] == speed)
        d = rows["d4_um"][ran[0] - 1 : ran[-1] + 1]
        assert value(test, "d_d4_end") == pytest.approx(d[-1] - d[0]) and value(test, "d_d4_t") == pytest.approx(
            np.ptp(d)
        )
        assert value(test, "d_d4_60") == pytest.approx(np.ptp(d[:61]))


def test_simulated_readings_keep_their_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for comment, wanted in (("simulated readings", True), ("", False)):
        path, report = spindle_record(tmp_path / "r.csv", comment), tmp_path / "r.json"
        with pytest.raises(SystemExit):
            cli.main(["evaluate", str(path), "--iso230-3", "--json", str(report)])
        assert ("SIMULATED READINGS" in capsys.readouterr().out) is wanted
        assert bool(json.loads(report.read_text())["warnings"]) is wanted


def test_range_of_noise_alone_is_stated(dmu50: Machine, tmp_path: Path) -> None:
    """The remark against drawn noise: the mean range of 97 readings."""
    n = 97
    drawn = np.ptp(np.random.default_rng(5).normal(0.0, 1.4, (4000, n)), axis=1).mean()
    path = write(
        tmp_path / "t.csv", positions(n), np.zeros((n, 3)) + 1.0, station_carrier=["work"] * n,
        time_s=300.0 * np.arange(n), u_x_mm=[0.0014] * n, u_y_mm=[0.0014] * n, u_z_mm=[0.0014] * n,
    )  # fmt: skip
    (test,) = evaluate_drift(path, dmu50).tests
    (said,) = [text for text in test.remarks if "noise alone" in text]
    assert float(said.partition("about ")[2].split()[0]) == pytest.approx(drawn, rel=0.02)
    assert test.values[0].u == pytest.approx(1.4 * np.sqrt(2.0))
