"""`twin machine`: questions, files, flags; statements; comparison with the control and its display; nothing half written."""

from __future__ import annotations

import io
import json
import os
import shlex
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.cli.commands import TWIN, refused, status
from tests.machine.test_description import TRUNNION, changed, commands, made, poses
from twin._common.yaml_files import yaml_text

HEAD = {
    "name": "BC head",
    "tool": ["Y", "X", "Z", "C", "B"],
    "table": {"X": 1000, "Y": 500, "Z": -800},
    "axes": {
        "X": {"range": [0, 2000]},
        "Y": {"range": [0, 1000]},
        "Z": {"range": [-800, 0]},
        "C": {"range": [-360, 360], "at": "B 0 25 0"},
        "B": {"range": [-110, 110], "at": "nose 0 0 210.5"},
    },
}
ANSWERS = [
    "shop mill",
    "4",
    "Y Z B",
    "X Y C",
    "",
    "",
    "0 600",
    "0 500",
    "-400 0",
    "x",
    "-100 100",
    "unlimited",
    "0.001",
]
ANSWERS += ["300", "250", "", "", "", "nose 0 0 170", "", "reversed", "machine 300 250 -390", "80"]
"""Answers to all questions: head B and table C, with some defaults, and one that is asked again."""


def written(folder: Path, data: dict, name: str = "answers.yaml") -> Path:
    (folder / name).write_text(yaml_text({"schema": "twin.answers/1", **data}))
    return folder / name


def test_questions_make_a_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(ANSWERS) + "\n"))
    assert status("machine", "new", "-o", "mill.yaml", "--html", "mill.html", "--json", "mill.json") == 0
    out = capsys.readouterr().out
    assert out.count("expected lower upper with zero inside, or unlimited") == 1 and "axis Y twice" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("mill.answers.yaml", "mill.html", "mill.json", "mill.urdf", "mill.yaml")
    ]
    machine = twin.Machine.load("mill.yaml")
    assert machine.name == "shop mill" and machine.tool_length_mm == 80.0
    assert [(axis.name, axis.side, axis.lower) for axis in machine.axes] == [
        *(("X", "work", 0.0), ("Y", "tool", 0.0), ("Z", "tool", -400.0), ("B", "tool", -100.0), ("C", "work", None))
    ]
    assert "Assumed" in out and "B to 90" in out and "reversed" in (tmp_path / "mill.answers.yaml").read_text()
    report = json.loads((tmp_path / "mill.json").read_text())
    assert len(report["statements"]) == 7 and report["schema"] == "twin.machine-check/1"
    assert (tmp_path / "mill.html").read_text().count("<svg") == 7
    # The answers make the same machine again, under the same name.
    before = (tmp_path / "mill.urdf").read_text()
    assert status("machine", "new", "--answers", "mill.answers.yaml", "-o", "mill.yaml") == 0
    assert (tmp_path / "mill.urdf").read_text() == before


def test_answers_that_end_and_an_interrupt_leave_nothing_but_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(ANSWERS[:7]) + "\n"))
    assert "the answers end here" in refused(capsys, "machine", "new", "-o", "mill.yaml")
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(ANSWERS[:7]) + "\n"))
    assert status("machine", "new", "-o", "mill.yaml", "--keep", "kept.yaml") == 2
    assert [path.name for path in tmp_path.iterdir()] == ["kept.yaml"]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(ANSWERS[7:]) + "\n"))
    assert status("machine", "new", "--answers", "kept.yaml", "--ask", "-o", "mill.yaml") == 0
    assert twin.Machine.load("mill.yaml").name == "shop mill"


@pytest.mark.slow
def test_ctrl_c_keeps_the_answers(tmp_path: Path) -> None:
    with subprocess.Popen(
        [*TWIN, "machine", "new", "-o", "mill.yaml", "--keep", "kept.yaml"],
        **{
            "stdin": subprocess.PIPE,
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "text": True,
            "cwd": tmp_path,
        },
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write("my mill\n2\n")
        process.stdin.flush()
        shown = b""
        while b"Axes that move the tool" not in shown:
            more = os.read(process.stdout.fileno(), 4096)  # not readline: a question does not end with a new line
            assert more, "the command ended"
            shown += more
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(20) == 130
        assert process.stderr is not None and process.stderr.read() == "twin: interrupted, nothing half written\n"
    assert [path.name for path in tmp_path.iterdir()] == ["kept.yaml"]
    assert "my mill" in (tmp_path / "kept.yaml").read_text()


def test_flags_alone_describe_a_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ["name=router", "tool=[Y, X, Z]", "table={X: 0, Y: 0, Z: -90}"]
    flags += [f"axes.{name}.range=[{low}, 300]" for name, low in (("X", 0), ("Y", 0), ("Z", -90))]
    assert status("machine", "new", "-o", "r.yaml", *(word for flag in flags for word in ("--set", flag))) == 0
    assert twin.Machine.load("r.yaml").names == ("X", "Y", "Z")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("new", ["no output given"]),
        ("new -o mill.txt", ["wrong suffix"]),
        ("new mill.yaml -o mill.yaml", ["MACHINE is not for new"]),
        ("check", ["no machine given"]),
        ("check nosuch.yaml", ["nosuch.yaml"]),
        ("check trunnion_ac -o x.yaml", ["--output is not for check"]),
        ("check trunnion_ac --no 9", ["no such statement", "1 to 7", "--no"]),
        ("new --answers answers.yaml -o answers.yaml", ["output file is also an input"]),
        ("new --answers answers.yaml -o a.yaml --html answers.yaml.html --keep answers.yaml", ["also an input"]),
        ("new --answers answers.yaml -o hand.yaml", ["hand.urdf", "not made by `twin machine new`"]),
        ("new --answers answers.yaml -o bad.yaml", ["bad.yaml", "not made by `twin machine new`"]),
        ("new --answers bad.yaml -o mill.yaml", ["bad.yaml:", "axes.A.range", "reversed"]),
        ("new --answers answers.yaml --set axes.A.at='table 0 0 61' -o mill.yaml", ["--set contradicts `axes.A.at`"]),
        ("new --answers answers.yaml --set axes.B=3 -o mill.yaml", ["`axes` cannot be read"]),
        ("new --answers answers.yaml --set axes.B.range=3 -o mill.yaml", ["`axes` cannot be read", "[lower, upper]"]),
        ("new --set tool=X -o mill.yaml", ["`tool` cannot be read", "[X, Y, Z]"]),
        ("new --set table=3 --ask -o mill.yaml", ["`table` cannot be read"]),
        ("new --answers answers.yaml --set name.x=3 -o mill.yaml", ["--set names no answer"]),
        ("new --answers answers.yaml --control five.csv -o mill.yaml", ["no kinematics of a control"]),
        ("check trunnion_ac --positions five.csv", ["five.csv:1", "X Y Z A C x y z"]),
        ("check trunnion_ac --positions short.csv", ["short.csv", "too few positions"]),
        ("check trunnion_ac --positions text.csv", ["text.csv:3", "column Y", "'o'"]),
    ],
)
def test_refusals_name_what_is_wrong(
    line: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path, TRUNNION)
    written(tmp_path, changed(TRUNNION, A__range=[30, -120]), "bad.yaml")
    (tmp_path / "five.csv").write_text("X,Y\n1,2\n")
    (tmp_path / "short.csv").write_text("X,Y,Z,A,C,x,y,z\n1,2,3,4,5,6,7,8\n")
    (tmp_path / "text.csv").write_text("X,Y,Z,A,C,x,y,z\n1,2,3,4,5,6,7,8\n1,o,3,4,5,6,7,8\n")
    (tmp_path / "hand.urdf").write_text("<robot/>")
    before = {path: path.read_text() for path in tmp_path.iterdir()}
    message = refused(capsys, "machine", *shlex.split(line))
    assert all(word in message for word in words), message
    assert {path: path.read_text() for path in tmp_path.iterdir()} == before


def test_a_no_names_the_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("machine", "check", "trunnion_ac", "--no", "4", "5", "--json", tmp_path / "c.json") == 3
    out = capsys.readouterr().out
    assert (
        "No to 4: this contradicts the answer axes.A.positive" in out
        and "No to 5: this contradicts the answer axes.A.at" in out
    )
    assert json.loads((tmp_path / "c.json").read_text())["met"] is False


def table(folder: Path, machine: twin.Machine, zero: tuple[float, ...], *, axis: bool = True, **turned: float) -> Path:
    """Write five positions that a control of this machine displays, with some axes turning the other way."""
    q = commands(machine, 5)
    sent = q * [turned.get(name, 1.0) for name in machine.names]
    tip, line = poses(machine, sent, 75.0)
    header = [*machine.names, *"xyz", *("ijk" if axis else "")]
    rows = np.hstack([q, tip - zero, line] if axis else [q, tip - zero])
    (folder / "five.csv").write_text(
        ",".join(header) + "\n" + "".join(",".join(f"{v:.4f}" for v in row) + "\n" for row in rows)
    )
    return folder / "five.csv"


def test_displayed_positions_agree_or_name_the_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = made(tmp_path, HEAD)
    run = ("machine", "check", machine.path, "--tool-length", 75, "--positions")
    assert status(*run, table(tmp_path, machine, (10.0, -20.0, 30.0))) == 0
    assert "shift by 10.0000 -20.0000 30.0000 mm" in capsys.readouterr().out
    assert status(*run, tmp_path / "five.csv", "--work-origin", "10,-20,30") == 0
    assert status(*run, tmp_path / "five.csv", "--work-origin", "10,-20,30.1") == 3
    for turned in ({"B": -1.0}, {"C": -1.0}, {"B": -1.0, "C": -1.0}):
        capsys.readouterr()
        assert status(*run, table(tmp_path, machine, (0.0, 0.0, 0.0), axis=False, **turned)) == 3
        cure = " and ".join(f"axes.{name}.positive: the other answer" for name in sorted(turned))
        assert f"all rows would agree with {cure}\n" in capsys.readouterr().out
    # A pivot that is 1.25 mm longer than it was answered.
    longer = made(tmp_path, changed(HEAD, B__at="nose 0 0 211.75"))
    path = table(tmp_path, longer, (0.0, 0.0, 0.0), axis=False)
    made(tmp_path, HEAD)
    capsys.readouterr()
    assert status(*run, path) == 3
    assert "axes.B.at: changed by +0.000 +0.000 +1.250 mm" in capsys.readouterr().out
    # A tool that is 2 mm longer than stated.
    path = table(tmp_path, made(tmp_path, HEAD), (0.0, 0.0, 0.0), axis=False)
    assert status(*run[:4], 73, "--positions", path) == 3
    assert "the length of the tool: changed by +2.000 mm" in capsys.readouterr().out
    # Both axes of a head together, and the axis of a table: the C axis is 0.4 mm further to the back than answered.
    both = made(tmp_path, changed(HEAD, B__at="nose 0.5 0 210.5"))
    path = table(tmp_path, both, (0.0, 0.0, 0.0), axis=False)
    made(tmp_path, HEAD)
    assert status(*run, path) == 3
    assert "axes.B.at and axes.C.at: changed by +0.500 +0.000 +0.000 mm" in capsys.readouterr().out
    path = table(
        tmp_path, made(tmp_path, changed(TRUNNION, C__at="machine 300 250.4 -450")), (0.0, 0.0, 0.0), axis=False
    )
    made(tmp_path, TRUNNION)
    assert status(*run, path) == 3
    assert "axes.C.at: changed by +0.000 +0.400 +0.000 mm" in capsys.readouterr().out


def test_the_control_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hal = "setp xyzac-trt-kins.x-rot-point 300\nsetp xyzac-trt-kins.y-rot-point 250.02\nsetp xyzac-trt-kins.z-rot-point -390\n"
    (tmp_path / "k.hal").write_text(hal + "setp xyzac-trt-kins.conventional-directions 1\n")
    assert status("machine", "check", "trunnion_ac", "--control", tmp_path / "k.hal") == 3
    out = capsys.readouterr().out
    assert (
        "A: direction differs by 0.0000°, place by 0.0200 mm (+0.0000 +0.0200 +0.0000)  DIFFERS" in out
        and "Not checked" in out
    )
    assert status("machine", "check", "trunnion_ac", "--control", tmp_path / "k.hal", "--tolerance", "0.05") == 0


@pytest.mark.slow
def test_a_made_machine_works_in_every_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path, HEAD)
    (tmp_path / "part.nc").write_text("G21 G90\nG0 X900 Y400 Z-300 B20 C10\nG1 X1000 Y500 Z-310 B30 C40 F1000\nM30\n")
    mine = ("--machine", "mill.yaml")
    for line in (
        ("machine", "new", "--answers", "answers.yaml", "-o", "mill.yaml"),
        ("plan", *mine, "-o", "plan.csv", "--minutes", 90),
        ("simulate", "plan.csv", *mine, "-o", "measured.csv", "--seed", 3),
        ("identify", "measured.csv", *mine, "-o", "mine.yaml", "--json", "identified.json"),
        ("diagnose", "measured.csv", *mine, "-c", "mine.yaml", "--json", "diagnosis.json"),
        ("scene", "part.nc", *mine, "-c", "mine.yaml", "-o", "scene.html"),
        ("report", *mine, "-c", "mine.yaml", "--identified", "identified.json", "-o", "report.html"),
        ("info", *mine, "-c", "mine.yaml"),
    ):
        assert status(*line) in (0, 3), line
    assert status("compensate", "part.nc", *mine, "-c", "mine.yaml", "-o", "out.nc") in (0, 3)
    assert (tmp_path / "out.nc").exists() and (tmp_path / "report.html").exists()
