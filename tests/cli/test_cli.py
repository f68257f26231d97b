"""Tests of the command line: printed text, error messages, and files on disk."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import TWIN, refused, status, twin
from tests.truth.machine import run_iso
from twin import cli

PROGRAM = "G21 G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X120 F500\nY150 C20\nM30\n"
CALIBRATION = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\n"


@pytest.fixture
def part(tmp_path: Path) -> Path:
    path = tmp_path / "part.nc"
    path.write_text(PROGRAM)
    return path


def test_the_main_job_from_any_directory(tmp_path: Path) -> None:
    """Compensate a bundled program by name with the default machine and calibration, with all outputs."""
    done = twin(
        *("compensate", "cone_frustum.nc", "-o", "out.nc", "--tool-length", 120, "--json", "r.json"),
        *("--report", "r.txt"),
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.nc", "r.json", "r.txt"]
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["complete"] is True
    assert report["after"]["rms_um"] < 0.6 < 60 < report["before"]["rms_um"]
    assert (tmp_path / "r.txt").read_text() in done.stdout
    assert "ILLUSTRATIVE" in done.stdout
    assert len(run_iso((tmp_path / "out.nc").read_text())) == 365


def test_the_language_is_that_of_the_content_or_as_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same program under other names gives the same output, alone, in a folder, and with fewer blocks."""
    (tmp_path / "in").mkdir()
    outputs = []
    for name in ("part.nc", "PART", "part.ptp", "part.h"):
        (tmp_path / "in" / name).write_text(PROGRAM)
        output = tmp_path / f"new-{name}"
        assert status("compensate", tmp_path / "in" / name, "-o", output) == 0
        outputs.append(output.read_text())
    assert len(set(outputs)) == 1 and outputs[0] != PROGRAM
    assert status("compensate", *(tmp_path / "in").iterdir(), "-o", tmp_path / "out", "--workers", 1) == 0
    assert {(tmp_path / "out" / name).read_text() for name in ("part.nc", "PART", "part.ptp", "part.h")} == set(outputs)
    for name in ("path", "scene"):
        assert status(name, tmp_path / "in" / "PART", "-o", tmp_path / ("b" if name == "path" else "b.html")) == 0
    alone = tmp_path / "alone.txt"
    alone.write_text("X+100 FMAX\nY+100 FMAX\nZ-100 FMAX\nB+30 FMAX\nC+10 FMAX\nX+120 F500\nM30\n")
    for name, output in (("compensate", "a.txt"), ("path", "a.txt"), ("scene", "a.html")):
        assert "(--language)" in refused(capsys, name, alone, "-o", tmp_path / output)
        assert status(name, alone, "-o", tmp_path / output, "--language", "heidenhain") in (0, 3)


def test_info(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["info", "--tool-length", "100"])
    assert stopped.value.code == 0
    printed = capsys.readouterr().out
    for word in ("DMU 50 eVolution", "0 … 500 mm", "unlimited", "E_ZC", "L-ANG", "E_X0B", "illustrative", "100 mm"):
        assert word in printed


@pytest.mark.slow
def test_options_that_take_several_words(part: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.nc"
    done = twin(
        *("compensate", part, "-o", out, "--work-offset", "X=10", "Y=-20.5", "C=5", "--scope", "L-POS", "l-str"),
        *("--json", tmp_path / "r.json"),
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["scope"] == "L-POS L-STR"
    spaced = twin(
        "compensate", part, "-o", tmp_path / "b.nc", "--work-offset", "X=10,Y=-20.5,C=5", "--scope", "L-POS L-STR"
    )
    assert spaced.returncode == 0, spaced.stderr
    assert (tmp_path / "b.nc").read_text() == out.read_text()


def test_exit_3_when_something_could_not_be_met(tmp_path: Path) -> None:
    part = tmp_path / "part.nc"
    part.write_text("G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X700 F500\n")
    done = twin("compensate", part, "-o", tmp_path / "out.nc")
    assert done.returncode == 3
    assert "1 block (line 3): outside the range of X: left as written; worst 200 mm (line 3)" in done.stdout
    assert (tmp_path / "out.nc").is_file()


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("G90\nG0 X100 Y\n", [":2", "Y"]),
        ("G90\nG0 X100 A5\n", [":2", "A"]),
        ("G90\nG0 XNAN Y5 Z5\n", [":2"]),
        ("", ["empty"]),
        ("G90\nG43.5\nG1 X1 Y1 Z1 I0 J0 K0 F1\n", [":3"]),
        ("G90\nG0 X1 Y1 Z-1 B10 C0\nG81 Z-5 R2\n", [":3", "G81"]),
        ("G90\nM98 P100\n", [":2"]),
    ],
)
def test_bad_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str], program: str, words: list[str]) -> None:
    part, out = tmp_path / "part.nc", tmp_path / "out.nc"
    part.write_text(program)
    message = refused(capsys, "compensate", part, "-o", out)
    assert str(part) in message
    assert "expected" in message
    for word in words:
        assert word in message
    assert not out.exists()


def test_binary_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = tmp_path / "part.nc"
    part.write_bytes(bytes(range(256)) * 8)
    assert "binary" in refused(capsys, "compensate", part, "-o", tmp_path / "out.nc")
    assert not (tmp_path / "out.nc").exists()


def test_bad_calibrations(part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.yaml"
    out = tmp_path / "out.nc"
    for text, words in (
        (CALIBRATION.replace("DMU 50 eVolution", "Hermle C 30"), ["bad.yaml:2", "Hermle C 30", "DMU 50 eVolution"]),
        (
            CALIBRATION + "curves: {E_XX: {unit: inch, domain: [0, 500], basis: power, coefficients: [1]}}\n",
            [":4", "inch", "um"],
        ),
        (
            CALIBRATION
            + "curves:\n  E_XX:\n    unit: um\n    domain: [0, 500]\n    basis: power\n    coefficients: [1, 1]\n"
            + "    covariance: [[1, 2], [2, 1]]\n",
            ["bad.yaml:10", "positive semi-definite"],
        ),
    ):
        bad.write_text(text)
        message = refused(capsys, "compensate", part, "-o", out, "--calibration", bad)
        for word in words:
            assert word in message
        assert not out.exists()


def test_a_curve_that_ends_short_of_the_program(part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A program outside the domain of a curve is refused."""
    short = tmp_path / "short.yaml"
    short.write_text(CALIBRATION + "curves: {E_XX: {unit: um, domain: [0, 110], basis: power, coefficients: [5]}}\n")
    for command in ("compensate", "scene"):
        out = tmp_path / ("out.nc" if command == "compensate" else "out.html")
        message = refused(capsys, command, part, "-o", out, "--calibration", short)
        for word in ("part.nc:3", "X 120", "0 to 110 mm", "short.yaml"):
            assert word in message
        assert not out.exists()


def test_bad_arguments(part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.nc"
    for arguments, word in (
        (["compensate", part, "-o", tmp_path / "none" / "out.nc"], "folder"),
        (["compensate", part, "-o", part], "another file"),
        (["compensate", part, "-o", tmp_path / "out.h"], ".nc"),
        (["compensate", part, "-o", tmp_path / "out.doc"], ".cls"),
        (["compensate", tmp_path / "none.nc", "-o", out], "cone_frustum.nc"),
        (["compensate", part, "-o", out, "--machine", "dmu60"], "dmu50"),
        (["compensate", part, "-o", out, "--scope", "L-PUS"], "L-POS"),
        (["compensate", part, "-o", out, "--tolerance", "-1"], "positive"),
        (["compensate", part, "-o", out, "--tolerance", "nan"], "positive"),
        (["compensate", part, "-o", out, "--tool-length", "nan"], "finite"),
        (["compensate", part, "-o", out, "--work-offset", "Q=1"], "X, Y, Z, B, C"),
        (["compensate", part, "-o", out, "--work-offset", "X=wide"], "finite"),
        (["compensate", part, "-o", out, "--work-origin", "1,2"], "x,y,z"),
        (["compensate", part, "-o", out, "--json", out], "two outputs are the same file"),
        (["scene", part, "-o", tmp_path / "none" / "s.html"], "folder"),
    ):
        assert word in refused(capsys, *arguments), arguments
        assert sorted(path.name for path in tmp_path.iterdir()) == ["part.nc"]


def test_unwritable_output_is_found_before_the_work(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out.nc").mkdir()
    assert "not a folder" in refused(capsys, "compensate", part, "-o", tmp_path / "out.nc")


def test_a_run_killed_at_any_step_leaves_the_old_output_or_the_new_one(tmp_path: Path) -> None:
    """The output is complete when the run is killed before any of its file operations."""
    part, out = tmp_path / "part.nc", tmp_path / "out.nc"
    rng = np.random.default_rng(8)
    part.write_text(
        "G90\nG0 X100 Y100 Z-100 B30 C10\n"
        + "".join(f"G1 X{x:.3f} Y{y:.3f} F500\n" for x, y in rng.uniform(100, 300, (300, 2)))
    )
    old = "(the old one)\n"
    out.write_text(old)
    done = subprocess.run(
        [sys.executable, "-m", "tests.cli.killed", *map(str, (tmp_path, out, "compensate", part, "-o", out))],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    found = json.loads(done.stdout)
    new = found[-1]
    assert new.count("\n") > 300
    assert set(found) == {old, new}
    # If killed before reading, the probe, opening the new file, setting its mode or renaming it, the old output remains.
    assert found.count(old) >= 5


def test_interrupt_leaves_nothing(tmp_path: Path) -> None:
    part, out = tmp_path / "part.nc", tmp_path / "out.nc"
    part.write_text("G90\nG0 X100 Y100 Z-100 B30 C10\n" + "G1 X110 F500\nX100\n" * 500_000)
    process = subprocess.Popen(
        [*TWIN, "compensate", str(part), "-o", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A shell that runs the tests in the background makes its children ignore the signal.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    # During the work, when a part of the output exists under another name.
    while process.poll() is None and not any(path.stat().st_size for path in tmp_path.glob(".twin-*")):
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.decode().strip() == "twin: interrupted, nothing half written"
    assert [path.name for path in tmp_path.iterdir()] == ["part.nc"]


@pytest.mark.slow
def test_apt_is_posted(tmp_path: Path) -> None:
    for name in ("posted.nc", "posted.h"):
        done = twin("compensate", "cone_frustum.cls", "-o", tmp_path / name, "--tool-length", 120)
        assert done.returncode == 0, done.stderr
    assert len(run_iso((tmp_path / "posted.nc").read_text())) > 365
    assert "BEGIN PGM" in (tmp_path / "posted.h").read_text()
