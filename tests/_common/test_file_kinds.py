"""Kinds of files, recognised by their beginning, and the messages for a file in another's place."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin import cli
from twin._common.files import kind_of_text, other_kind
from twin.nc import DIALECTS

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = [
    path for path in (ROOT / "twin" / "samples").iterdir() if path.suffix in {s for d in DIALECTS for s in d.suffixes}
]


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_programs_are_recognised(path: Path) -> None:
    assert kind_of_text(path.read_text(encoding="utf-8")) == "an NC program"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("%\nO1000 (PART)\nG0 X1\n", "an NC program"),
        ("N10 ; start\nN20 G0 X1\n", "an NC program"),
        ("N10 G710\n", "an NC program"),
        ("; from a CAM system\nG1 X-3.2 F100\n", "an NC program"),
        ("0 BEGIN PGM A MM\n", "an NC program"),
        ("$$ PART\nPARTNO/A\n", "an NC program"),
        ("schema: twin.calibration/1\nmachine: A\n", "a calibration"),
        ("# made by hand\nschema: twin.machine/1\n", "a machine file"),
        ("X_mm,Y_mm,target,carrier\n1,2,K,tool\n", "a plan"),
        ("# simulated\nX_mm,target,carrier,x_mm\n", "a measurement table"),
        ('{"schema": "twin.diagnosis/1"}', "a JSON file"),
        ("<!DOCTYPE html>\n", "an HTML page"),
        ('<?xml version="1.0"?>\n<!-- one -->\n<robot name="a">', "a URDF"),
        ("PK\x03\x04\x14", "a spreadsheet or zip file"),
        ("G54: {X: 250}\n", None),
        ("time_s,X1_mm,T_bed_degC\n0,1,2\n", None),
        ("X;Y;Z\n1;2;3\n", None),
        ("K,1,2,3\n", None),
        ("X1,Y1\n", None),
        ("", None),
    ],
)
def test_kinds(text: str, kind: str | None) -> None:
    assert kind_of_text(text) == kind
    assert kind_of_text(f"\ufeff{text}") == kind
    assert other_kind(text, "an NC program") == (None if kind == "an NC program" else kind)


MISTAKES = [
    ("identify plan.csv -o x.yaml", "a plan, without readings; expected a measurement table: measure the plan first"),
    ("diagnose cone_frustum.nc", "an NC program, not a table"),
    ("identify calibration.yaml -o x.yaml", "a calibration, not a table"),
    ("compensate plan.csv -o x.nc", "a plan, not an NC program"),
    ("compensate calibration.yaml -o x.nc", "a calibration, not an NC program"),
    ("compensate cone_frustum.nc -o x.nc --calibration plan.csv", "a plan, not a YAML file"),
    ("compensate cone_frustum.nc -o x.nc --calibration cone_frustum.nc", "an NC program, not a YAML file"),
    (
        "compensate cone_frustum.nc -o nowhere/x.nc",
        "its folder does not exist; expected an existing folder: create nowhere first",
    ),
    (
        "compensate cone_frustum.nc",
        "missing option '--output' / '-o'; expected, for example, `twin compensate cone_frustum.nc -o",
    ),
    ("identify", "missing argument 'measured'; expected, for example, `twin identify measured.csv -o"),
    ("identify book.csv -o x.yaml", "a spreadsheet or zip file, not a text file"),
]


@pytest.mark.parametrize(("line", "words"), MISTAKES, ids=[line for line, _ in MISTAKES])
def test_mistakes_have_a_way_out(
    line: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    samples = ROOT / "twin" / "samples"
    for name, source in (("plan.csv", "thesis_plan.csv"), ("cone_frustum.nc", "cone_frustum.nc")):
        Path(name).write_bytes((samples / source).read_bytes())
    Path("calibration.yaml").write_bytes((ROOT / "urdf" / "dmu50.calibration.yaml").read_bytes())
    Path("book.csv").write_bytes(b"PK\x03\x04\x14\x00\x06\x00\x08\xff\xfe")
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(SystemExit) as stopped:
        cli.main(line.split())
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert words in message and message.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == before
