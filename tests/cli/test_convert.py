"""`twin convert`: from another program's file to a calibration; what it prints, and what it refuses."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import refused
from tests.measurement.formats.cases import CASES
from tests.measurement.test_contacts import NOISE, contacts, probed
from twin import cli
from twin.machine.machine import Machine
from twin.measurement.contacts import Contacts
from twin.measurement.table import Measurements


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(word) for word in words])
    return int(ended.value.code or 0)


def write_contacts(path: Path, found: Contacts, comment: str = "") -> Path:
    rows = [f"{comment}contact_x_mm,contact_y_mm,contact_z_mm,B_deg,C_deg"]
    rows += [",".join(f"{value:.5f}" for value in row) for row in found.positions]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_from_contacts_to_a_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The contacts of a simulator that shares no code with twin; the eccentricity of C is 40 µm."""
    errors = {"L_C": np.array([0.040, 0.0, 0.0, 0.0, 0.0, 0.0])}
    path = write_contacts(tmp_path / "c.csv", probed(errors, np.random.default_rng(7)))
    measured, report = tmp_path / "m.csv", tmp_path / "m.json"
    assert run("convert", path, "-o", measured, "--json", report) == 0
    said = capsys.readouterr().out
    assert "24 rows" in said and "standard uncertainty of a contact" in said and "from the residuals" in said
    found = json.loads(report.read_text())
    assert found["schema"] == "twin.conversion/1" and found["rows"] == len(found["centres"]) == 24
    covariance = np.array([centre["covariance_mm2"] for centre in found["centres"]])
    table = Measurements.load(measured, Machine.load("dmu50"))
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), table.u_mm, rtol=1e-6)
    assert run("identify", measured, "-o", tmp_path / "c.yaml", "--only", "E_X0C", "--json", tmp_path / "i.json") == 0
    errors_found = {one["name"]: one for one in json.loads((tmp_path / "i.json").read_text())["errors"]}
    assert errors_found["E_X0C"]["value"] == pytest.approx(40.0, abs=2.0)


def test_a_warning_about_simulated_contacts_travels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    positions = np.array([[250.0, 225.0, -200.0]]) + 10.0 * np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    )
    path = write_contacts(tmp_path / "c.csv", contacts(positions, np.zeros((5, 2))), "# simulated by hand\n")
    assert (
        run("convert", path, "-o", tmp_path / "m.csv", "--json", tmp_path / "m.json", "--contact-uncertainty", NOISE)
        == 0
    )
    assert "simulated" in capsys.readouterr().out
    assert "\n# SIMULATED READINGS" in (tmp_path / "m.csv").read_text()
    assert [one["name"] for one in json.loads((tmp_path / "m.json").read_text())["warnings"]] == ["simulated_readings"]


def test_options_that_may_be_missing_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("x.rtl", "circle.b5r", "Round 1.csv"):
        case = next(case for case in CASES.values() if name == case.FILE)
        (tmp_path / name).write_text(case.GOOD)
    m = tmp_path / "m.csv"
    assert "(--at)" in refused(capsys, "convert", tmp_path / "x.rtl", "-o", m)
    assert "(--at)" in refused(capsys, "convert", tmp_path / "circle.b5r", "-o", m)
    said = refused(capsys, "import", tmp_path / "x.rtl", "-o", m)
    assert f"`twin convert {tmp_path / 'x.rtl'} -o {m} --at …`" in said and not m.exists()
    assert "(--plan)" in refused(capsys, "convert", tmp_path / "Round 1.csv", "-o", m)
    text = CASES["renishaw-laser"].GOOD.replace("Axis:X", "Axis:")
    (tmp_path / "x.rtl").write_text(text)
    at = ("--at", "Y=225", "Z=-200", "B=0", "C=0")
    assert "(--axis)" in refused(capsys, "convert", tmp_path / "x.rtl", "-o", m, *at)
    assert run("convert", tmp_path / "x.rtl", "-o", m, "--axis", "X", *at) == 0
    assert "Q=1" in refused(capsys, "convert", tmp_path / "x.rtl", "-o", tmp_path / "n.csv", "--at", "Q=1")
    (tmp_path / "a.txt").write_text("hello\n")
    assert "(--format)" in refused(capsys, "convert", tmp_path / "a.txt", "-o", tmp_path / "n.csv")
    assert not (tmp_path / "n.csv").exists()


def test_hostile_xml_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Entities that expand, entities that read files, deep nesting: refused at once."""
    bomb = '<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "' + "&b;" * 100 + '">]>'
    file = '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>'
    for start in (bomb, file):
        (tmp_path / "a.b5r").write_text(
            CASES["renishaw-ballbar"].GOOD.replace("<TEST_DOCUMENT>", start + "<TEST_DOCUMENT>")
        )
        said = refused(capsys, "convert", tmp_path / "a.b5r", "-o", tmp_path / "m.csv")
        assert "document type declaration" in said and "a.b5r:2" in said
    (tmp_path / "a.b5r").write_text("<BALLBAR_RUN>" * 100_000)
    assert "nested too deeply" in refused(capsys, "convert", tmp_path / "a.b5r", "-o", tmp_path / "m.csv")


def test_long_lines_are_read_in_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No pattern takes more than linear time: 200 kB of blanks, brackets and digits in one line."""
    started = time.process_time()
    for start in (
        "HEADER::\nFile type",
        "SYSCALIBFITADDRECORD",
        "CONTACT ",
        "<BALLBAR_RUN>",
        "1 2 3 4",
        "a, 1, 2",
        "contact_x_mm,",
    ):
        for filling in (" ", "(", "1", "V.", "<a/>"):
            (tmp_path / "a.txt").write_text(start + filling * (200_000 // len(filling)))
            refused(capsys, "convert", tmp_path / "a.txt", "-o", tmp_path / "m.csv")
    assert time.process_time() - started < 35 * 0.5  # quadratic time would be minutes


def test_a_file_that_is_too_large_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.rtl"
    with path.open("wb") as stream:
        stream.truncate(2**26 + 2**20)
    assert "too large" in refused(capsys, "convert", path, "-o", tmp_path / "m.csv")
