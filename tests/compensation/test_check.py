"""`twin check`: its predictions agree with the compensation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import status
from tests.compensation.test_frames import OFFSETS, ROWS, TOOLS
from tests.compensation.test_tilted_planes import PLANES, REFUSED
from tests.model.errors import random_calibration
from twin._common.errors import InputError
from twin.compensation import Compensator, Options
from twin.compensation.programs.check import check_program
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration

TABLES = Options(setup=Setup(offsets=OFFSETS, tools=TOOLS))
PLAIN = Options(setup=Setup(work_offset={"X": 250.0, "Y": 225.0, "Z": -390.0}), tool_length_mm=80.0)
HEAD = "G90 G21\nG0 X0 Y0 Z60 B20 C5\n"
PROGRAMS = {
    "plain": (PLAIN, f"{HEAD}G1 X5 F500\nG3 X10 Y5 R5\nG99 G81 X5 Z10 R20 F100\nX15\nG80\n"),
    "two tools": (TABLES, f"T1 M6\nG54\nG43 H1\n{ROWS}T2 M6\nG55\nG43 H2\n{ROWS}".format(30, 40)),
    "two tools without tables": (PLAIN, f"T1 M6\nG54\nG43 H1\n{ROWS}T2 M6\nG55\nG43 H2\n{ROWS}".format(30, 40)),
    "beyond the range": (PLAIN, f"{HEAD}G1 X400 F500\nX5\nG0 Y-400\nG1 Y5\n"),
    "unknown statement": (PLAIN, f"{HEAD}G1 X5 F500\nFOO(1)\nG1 X6\nG0 X7\n"),
    "unknown start": (PLAIN, f"G90 G21\nG1 Z50 F500\n{HEAD}G1 X5\n"),
    "another machine's axis": (PLAIN, f"T3\n{HEAD}G1 X5 F500\nG1 A5 W3\n"),
    "no motion": (PLAIN, "G90\nM30\n"),
    "a loop": (PLAIN, f"{HEAD}#1=0\nWHILE[#1 LT 3]DO1\nG1 X[#1] F500\n#1=#1+1\nEND1\n"),
    "no feed": (PLAIN, f"{HEAD}G1 X5\n"),
    **{f"plane {i}": (TABLES, text) for i, (text, *_) in enumerate(PLANES.values()) if text.startswith("G90")},
    **{f"refused plane {i}": (TABLES, text) for i, (text, *_) in enumerate(REFUSED) if text.startswith("G90")},
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(5), size=1.0)


@pytest.mark.parametrize("name", PROGRAMS)
def test_it_predicts_the_compensation(dmu50: Machine, errors: Calibration, tmp_path: Path, name: str) -> None:
    options, text = PROGRAMS[name]
    source = tmp_path / "part.nc"
    source.write_text(text)
    check = check_program(source, dmu50, options=options)
    try:
        report = Compensator(dmu50, errors, options).compensate_file(source, tmp_path / "out.nc")
    except InputError as refused:
        assert str(check.error) == str(refused) and check.verdict == "refused"
        return
    assert check.error is None
    assert sum(one.lines != () for one in check.left) == sum(one.kind == "unknown" for one in report.not_corrected)
    left = {line for one in check.left for line in one.lines}
    assert left == {line for one in report.not_corrected if one.kind == "unknown" for line in one.lines}
    beyond = {line for axis in check.travel.values() for line in axis.beyond}
    assert beyond == {line for one in report.not_corrected if one.kind == "range" for line in one.lines}
    assert (check.verdict == "ready") is report.complete or beyond
    assert [one.sentence for one in check.frames] == [one.sentence for one in report.frames]
    assert {(one.line, one.text) for one in check.notes} <= {(one.line, one.text) for one in report.notes}
    assert check.lines == report.lines


def test_what_a_program_needs_is_said_even_if_it_is_refused(dmu50: Machine, tmp_path: Path) -> None:
    for name, tools, offsets, lacks in (
        ("two tools", {"1": 1, "2": 9}, {"G54": 2, "G55": 10}, ()),
        ("two tools without tables", {"1": 1, "2": 9}, {"G54": 2, "G55": 10}, ()),
        ("another machine's axis", {}, {}, ("A", "W")),
    ):
        options, text = PROGRAMS[name]
        source = tmp_path / "part.nc"
        source.write_text(text)
        check = check_program(source, dmu50, options=options)
        assert (dict(check.tools), dict(check.offsets), check.lacks) == (tools, offsets, lacks)
    assert "the machine lacks A W" in check.to_text() and "A is an axis of trunnion_ac" in check.brief


def test_counts_and_times(dmu50: Machine, tmp_path: Path) -> None:
    options, text = PROGRAMS["plain"]
    source = tmp_path / "part.nc"
    source.write_text(text + "G4 P2.5\n")
    check = check_program(source, dmu50, options=options)
    assert check.blocks == {"rapid": 1, "linear": 1, "arc": 1, "hole": 2}
    assert check.uses == {"cycles": 5} and check.language == "iso"
    # 5 mm, a quarter of a circle of 5 mm radius, two holes of 10 mm; rapids take less than a second.
    feeds = 60.0 * ((5.0 + 5.0 * np.pi / 2) / 500.0 + 20.0 / 100.0)
    assert check.time_s is not None and feeds + 2.5 < check.time_s < feeds + 3.5
    assert check.travel["X"].low == 250.0 and check.travel["X"].high == 265.0
    source.write_text(PROGRAMS["no feed"][1])
    assert check_program(source, dmu50, options=options).time_s is None


def test_the_command_says_one_line_for_each_of_several(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, word in (("a", "G1 X5 F500"), ("b", "FOO(1)\nG1 X5 F500"), ("c", "G1 W5")):
        Path(f"{name}.nc").write_text(f"{HEAD}{word}\n")
    offset = ["--work-offset", "X=250", "Y=225", "Z=-390"]
    for programs, wanted in ((["a.nc"], 0), (["a.nc", "b.nc"], 3), (["b.nc", "c.nc", "a.nc"], 2)):
        assert status("check", *programs, *offset, "--json", "c.json") == wanted
        said = capsys.readouterr().out
        found = json.loads(Path("c.json").read_text())
        assert found["schema"] == "twin.checks/1" and found["exit_status"] == wanted
        assert [one["program"] for one in found["programs"]] == programs
        if len(programs) > 1:
            assert [line.split()[0] for line in said.splitlines()[: len(programs)]] == programs
    assert [one["verdict"] for one in found["programs"]] == ["in part", "refused", "ready"]
    assert found["programs"][1]["lacks"] == ["W"] and not list(tmp_path.glob("*.txt"))
