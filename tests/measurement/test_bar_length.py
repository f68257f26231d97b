"""The nominal length of a ball bar: from the other program's file or the plan, through the table, to the evaluation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.cli.commands import refused
from tests.cli.test_convert import run
from tests.measurement.formats.cases import CASES
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

HEADER = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,station,station_carrier\n"
ROWS = "".join(f"{250 + i},225,-200,0,0,ball,tool,{{{i}}},,,pivot,work\n" for i in range(3))


def written(path: Path, comments: str, lengths: tuple[float, ...] = (150.001, 149.998, 150.002)) -> Path:
    path.write_text(comments + HEADER + ROWS.format(*lengths))
    return path


def test_converted_file_needs_no_option(tmp_path: Path, capsys: pytest.CaptureFixture[str], dmu50: Machine) -> None:
    """The deviations of the file's two runs, whose feeds differ slightly: one test; D is the mean of the deviations given."""
    (tmp_path / "circle.b5r").write_text(CASES["renishaw-ballbar"].GOOD)
    at = ("--at", "X=250", "Y=225", "Z=-200", "B=0", "C=0")
    assert run("convert", tmp_path / "circle.b5r", "-o", tmp_path / "m.csv", *at) == 0
    data = Measurements.load(tmp_path / "m.csv", dmu50)
    np.testing.assert_array_equal(data.bar_mm, 100.0)
    (test,) = twin.evaluate(data, dmu50).tests
    found = {one.key: one.value for one in test.values}
    deviations = CASES["renishaw-ballbar"].DEVIATIONS
    for key, way in (("forward", "CCW"), ("backward", "CW")):
        assert found[f"F_max_{key}"] <= max(deviations[way]) and found[f"F_min_{key}"] >= min(deviations[way])
    # D is counted after the centre is removed, which changes the mean of nine readings by a fraction of a micrometre.
    assert found["D"] == pytest.approx(np.mean(deviations["CCW"] + deviations["CW"]), abs=0.1)
    capsys.readouterr()
    assert "100 mm in the table, 150 mm given" in refused(capsys, "evaluate", tmp_path / "m.csv", "--length", "150")


def test_length_of_a_plan_travels(tmp_path: Path, capsys: pytest.CaptureFixture[str], dmu50: Machine) -> None:
    plan, measured = tmp_path / "p.csv", tmp_path / "m.csv"
    assert run("plan", "--instrument", "ball-bar", "--radius", "120", "-o", plan) == 0
    assert run("simulate", plan, "-o", measured, "--instrument", "ball-bar") == 0
    assert "\n# ball bar length: 120 mm\n" in measured.read_text()
    assert set(Measurements.load(measured, dmu50).bar_mm) == {120.0}
    assert run("evaluate", measured, "--length", "120") == 0
    capsys.readouterr()


def test_deviations_become_lengths(tmp_path: Path, dmu50: Machine) -> None:
    table = Measurements.load(written(tmp_path / "m.csv", "# Ball bar length: 150 mm\n", (0.001, -0.002, 0.002)), dmu50)
    np.testing.assert_allclose(table.point_mm[:, 0], [150.001, 149.998, 150.002], rtol=1e-12)
    assert any("deviations" in text and "150 mm" in text for text in table.notices)
    (tmp_path / "n.csv").write_text(table.to_csv(dmu50))
    again = Measurements.load(tmp_path / "n.csv", dmu50)
    np.testing.assert_array_equal(again.point_mm, table.point_mm)
    np.testing.assert_array_equal(again.bar_mm, 150.0)


def test_only_readings_of_a_bar_have_its_length(tmp_path: Path, dmu50: Machine) -> None:
    """An interferometer on the table also reads x_mm alone, from an arbitrary zero."""
    path = written(tmp_path / "m.csv", "# ball bar length: 150 mm\n", (0.0, 1.0, 2.0))
    text = path.read_text().replace("station_carrier\n", "station_carrier,instrument\n")
    path.write_text(text.replace(",work\n", ",work,linear-interferometer\n"))
    table = Measurements.load(path, dmu50)
    np.testing.assert_array_equal(table.point_mm[:, 0], [0.0, 1.0, 2.0])
    assert np.isnan(table.bar_mm).all()


@pytest.mark.parametrize(
    ("comments", "said"),
    [
        ("# ball bar length: 150 mm\n# ball bar length: 100 mm\n", ("150 mm and 100 mm",)),
        ("# ball bar length: 150\n", ("ball bar length: 150", "cannot be read")),
        ("# ball bar length: -150 mm\n", ("cannot be read",)),
        ("# ball bar length 150 in\n", ("cannot be read",)),
    ],
)
def test_lengths_that_are_refused(tmp_path: Path, dmu50: Machine, comments: str, said: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        Measurements.load(written(tmp_path / "m.csv", comments), dmu50)
    assert all(text in str(error.value) for text in (*said, "m.csv"))


def test_bars_of_different_length_are_not_written_to_one_table(tmp_path: Path, dmu50: Machine) -> None:
    table = Measurements.load(written(tmp_path / "m.csv", "# ball bar length: 150 mm\n"), dmu50)
    other = replace(table, bar_mm=np.full(3, 100.0))
    both = Measurements.join([table, other])
    assert both.bar_mm.tolist() == [150.0] * 3 + [100.0] * 3
    with pytest.raises(InputError, match="100 mm and 150 mm"):
        both.to_csv(dmu50)


@pytest.mark.parametrize(
    "words",
    [
        ("identify", "{}", "-o", "{}.yaml"),
        ("diagnose", "{}"),
        ("evaluate", "{}"),
        ("plan", "--judge", "{}"),
        ("simulate", "{}", "-o", "{}.csv"),
        ("report", "--measured", "{}", "-o", "{}.html"),
        ("axis-run", "{}", "-o", "{}.yaml", "--layout", "nine_beams_x.yaml"),
    ],
)
def test_single_contacts_are_not_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    path = tmp_path / "c.csv"
    path.write_text("# probe\ncontact_x_mm,contact_y_mm,contact_z_mm,B_deg,C_deg\n1,2,3,0,0\n")
    said = refused(capsys, *(word.format(path) for word in words))
    assert "single contacts" in said and "`twin convert`" in said and "c.csv:2" in said
