"""`twin import`: exit statuses, nothing half written, the mapping confirmed, the table used by other commands."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from tests.cli.commands import refused, status
from tests.measurement.importing import shop_files


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shop.csv").write_bytes(shop_files.cmm_report())
    (tmp_path / "points.txt").write_bytes(shop_files.analyser_points())
    (tmp_path / "plan.csv").write_text(shop_files.analyser_plan())
    shop_files.workbook(tmp_path / "shop.xlsx")
    return tmp_path


def test_a_table_without_assumptions_is_written(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("import", "points.txt", "-o", "measured.csv", "--plan", "plan.csv", "--json", "i.json") == 0
    captured = capsys.readouterr()
    assert captured.err == "" and captured.out.endswith("\nwritten: measured.csv, i.json\n")
    report = json.loads((shop / "i.json").read_text())
    assert report["schema"] == "twin.import/1" and report["written"] is True and report["rows"] == 24
    text = (shop / "measured.csv").read_text()
    assert (
        text.startswith("# imported from points.txt, ") and "# x_mm: 'X [mm]' in mm\n" in text and "simulated" in text
    )
    assert not list(shop.glob("*.yaml"))


@pytest.mark.slow
def test_a_proposal_is_confirmed(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path.name for path in shop.iterdir()}
    assert status("import", "shop.csv", "-o", "measured.csv", "--json", "i.json") == 2
    captured = capsys.readouterr()
    again = "twin import shop.csv -o measured.csv --columns measured.csv.columns.yaml"
    assert captured.err == (
        "twin: shop.csv: no table written: 4 items to confirm in measured.csv.columns.yaml; "
        f"expected a confirmed mapping: {again}\n"
    )
    assert "First rows as understood:\n" in captured.out and "written" not in captured.out
    for text in ("all rows are of one target, named 1", "B stood at 0 deg in all rows", "not used: 'Nr.', 'Messpunkt'"):
        assert f"  {text}" in captured.out
    assert {path.name for path in shop.iterdir()} - before == {"measured.csv.columns.yaml", "i.json"}
    assert json.loads((shop / "i.json").read_text())["written"] is False
    mapping = (shop / "measured.csv.columns.yaml").read_text()
    assert f"# Then: {again}\n" in mapping and '  carrier: {value: "tool"}    # tool or work\n' in mapping
    # A second run does not replace a mapping that a person may have changed.
    assert "4 items to confirm, and a mapping exists" in refused(capsys, "import", "shop.csv", "-o", "measured.csv")
    assert (shop / "measured.csv.columns.yaml").read_text() == mapping
    assert status(*shlex.split(again)[1:]) == 0
    assert status("evaluate", "measured.csv") in (0, 3)
    assert status("diagnose", "measured.csv", "--json", "d.json") == 0
    assert json.loads((shop / "d.json").read_text())["warnings"][0]["name"]


def test_the_sample_is_imported_and_identified(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("import", "shop_table.csv", "-o", "measured.csv") == 0
    assert "Assumed" not in capsys.readouterr().out
    assert status("identify", "measured.csv", "-o", "mine.yaml", "--only", "E_*X") in (0, 3)
    assert "SIMULATED READINGS" in capsys.readouterr().out


def test_the_mapping_is_written_where_it_is_named(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("import", "shop.xlsx", "-o", "out.csv", "--sheet", "Messung", "--columns", "mine.yaml")
    assert status(*words) == 2
    assert "--columns mine.yaml --sheet Messung" in capsys.readouterr().err
    assert (shop / "mine.yaml").exists() and not (shop / "out.csv").exists()
    assert status(*words) == 0 and (shop / "out.csv").exists()
    capsys.readouterr()
    assert status(*words, "--quiet") == 0 and capsys.readouterr() == ("", "")


def test_the_other_direction(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Messages about tables of another form name `twin import`, and those of `twin import` name the option or `twin convert`."""
    for words in ("identify shop.csv -o m.yaml", "identify shop.xlsx -o m.yaml", "convert shop.csv -o m.csv"):
        assert "`twin import` reads" in refused(capsys, *shlex.split(words)), words
    assert "(--plan)" in refused(capsys, "import", "points.txt", "-o", "m.csv")
    assert "one of Deckblatt, Messung (--sheet)" in refused(capsys, "import", "shop.xlsx", "-o", "m.csv")
    (shop / "ball.b5r").write_text("<?xml version='1.0'?><BALLBAR_RUN/>\n")
    assert "ball.b5r" in refused(capsys, "import", "ball.b5r", "-o", "m.csv")
    assert "wrong kind of file" in refused(capsys, "import", "shop.csv", "-o", "m.csv", "--columns", _other(shop))
    assert not (shop / "m.csv").exists()


def _other(folder: Path) -> Path:
    path = folder / "other.yaml"
    path.write_text("schema: twin.calibration/1\n")
    return path
