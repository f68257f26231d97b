"""Input that once caused a traceback or did not terminate: each is read, or refused with file and line. See also `test_fuzz`."""

from __future__ import annotations

import io
import os
import resource
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.cli.commands import TWIN, refused
from tests.cli.hostile import sample
from twin import cli
from twin._common import resources as pipes
from twin._common.errors import InputError, printable
from twin.compensation.programs.words import axis_words
from twin.compute.native import compiler
from twin.compute.parallel import Workers
from twin.controls import read_tables
from twin.diagnosis import text as words
from twin.diagnosis.candidates.calibration import flaw
from twin.identification.axis_layout import AxisLayout, load_readings
from twin.identification.solve import FitStatistics
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.motion_curve import Curve
from twin.nc.heidenhain.dialect import Heidenhain
from twin.numerics.curves import POWER, CurveSpace
from twin.planning import Kit
from twin.reporting.identified import Identified

HEAD = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\n"
LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)


@pytest.mark.sample(29)  # of 31
@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("source: !!int foo\n", 3, "a whole number"),
        ("source: !!int\n", 3, "a whole number"),
        ("source: !!bool foo\n", 3, "true or false"),
        ("source: !!timestamp foo\n", 3, "unsupported tag"),
        ("source: !foo bar\n", 3, "unsupported tag: '!foo bar'"),
        ("source: !foo {a: 1}\n", 3, "unsupported tag: '!foo'"),
        ("source: !!python/object/apply:os.system [ls]\n", 3, "unsupported tag"),
        ("source: x\n? [a, b]\n: 3\n", 4, "list or mapping used as a key"),
        ("source: x\n{a: 1}: 3\n", 4, "list or mapping used as a key"),
        (f"source: x\nsquareness: {{E_C0Y: {'9' * 5000}}}\n", 4, "number of 5000 characters"),
        (f"source: x\nsquareness: {{E_C0Y: 0x{'9' * 350}}}\n", 4, "number too large"),
        (f"source: x\nsquareness: {{E_C0Y: 1{':59' * 5000}}}\n", 4, "number of 15001 characters"),
        ("source: x\nlocation: {E_X0C: 1e308}\n", 4, "number too large"),
        ("source: x\nlocation: {E_X0C: -1.0e+16}\n", 4, "number too large"),
        ("source: x\nlocation: {E_X0C: 1e400}\n", 4, "a finite number"),
        (
            "source: x\nsquareness: {E_C0Y: 1}\ncovariance: {parameters: [E_C0Y], lower: '1e300'}\n",
            5,
            "too large a number",
        ),
        ("source: &a [*a]\n", 3, "alias inside its own anchor"),
        ("source: &a {b: [*a]}\n", 3, "alias inside its own anchor"),
        (f"source: {'[' * 5000}\n", 3, "more than 32 levels"),
        (f"source:\n{''.join(' ' * i + 'a:' + chr(10) for i in range(1, 200))}", 34, "more than 32 levels"),
        (f"source: x\n{LAUGHS}", None, "entries with aliases expanded"),
        (f"source: [{'1, ' * 60_000}]\n", 3, "more than 50000 entries"),
        (f"source: {'a' * 9_000_000}\n", None, "at most 8 MB"),
        ('source: "\\e]0;x\\a"\n', 3, "control character"),
        ('source: "\\ud800"\n', 3, "control character"),
        ('source: "a\\0b"\n', 3, "control character"),
        ("source: a\0b\n", 3, "without NUL"),
        ("source: a\x07b\n", 3, "control character"),
        ("source: x\n<<: {a: 1}\n", 4, "`<<` is invalid"),
        ("source: x\n~: 1\n", 4, "key that is not text"),
        ("source: x\nsquareness: {1: 2}\n", 4, "key that is not text"),
    ],
)
def test_yaml_that_is_refused(dmu50: twin.Machine, tmp_path: Path, text: str, line: int | None, said: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(HEAD + text)
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        twin.Calibration.load(path, dmu50)
    assert time.process_time() - begin < 5.0  # a second at most, on a machine that is not busy
    assert said in str(caught.value) and caught.value.file == str(path)
    assert line is None or caught.value.line == line


@pytest.mark.parametrize("date", ["2001-13-45", "2001-12-14", "2001-12-14 25:61:00"])
def test_a_date_is_text(dmu50: twin.Machine, tmp_path: Path, date: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(f"{HEAD}source: {date}\n")
    assert twin.Calibration.load(path, dmu50).source == date


def test_an_alias_is_read_as_what_it_stands_for(dmu50: twin.Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(f"{HEAD}source: x\nsquareness: {{E_C0Y: &a 3.0}}\nlocation: {{E_X0C: *a}}\n")
    read = twin.Calibration.load(path, dmu50)
    assert (read.squareness["E_C0Y"], read.location["E_X0C"]) == (3.0, 3.0)


def test_every_loader_takes_the_path_as_text(dmu50: twin.Machine, tmp_path: Path) -> None:
    for name in ("calibration", "table", "kit", "layout", "readings"):
        (tmp_path / name).write_text(sample(name))
    folder = str(tmp_path)
    assert twin.Calibration.load(f"{folder}/calibration", dmu50).source == "a test"
    assert len(Measurements.load(f"{folder}/table", dmu50)) == 20
    assert Kit.load(f"{folder}/kit", dmu50).targets
    layout = AxisLayout.load(f"{folder}/layout", dmu50)
    assert len(load_readings(f"{folder}/readings", layout)) == 36
    twin.Calibration.load(f"{folder}/calibration", dmu50).save(f"{folder}/again.yaml")
    Measurements.load(f"{folder}/table", dmu50).save(f"{folder}/again.csv", dmu50)


@pytest.mark.parametrize(
    ("change", "line", "said"),
    [
        (('K,tool,50.01', '"K\n2",tool,50.01'), 4, "line break in a cell"),
        (("K,tool,50.01", '"K,tool,50.01'), 4, "unexpected end of data"),
        (("K,tool,50.01", "K" * 131_100 + ",tool,50.01"), 4, "field larger than field limit"),
        (("K,tool,50.01", '"K"2,tool,50.01'), 4, "not a table row"),
        (("K,tool,50.01", "K\0,tool,50.01"), 4, "NUL"),
        (("K,tool,50.01", "K\x1b[2J,tool,50.01"), 4, "control character"),
        (("K,tool,50.01", "K\x85,tool,50.01"), 4, "control character"),
        (("K,tool,50.01", "K,tool,1e300"), 4, "x_mm is too large"),
        (("u_z_mm", ",".join(f"c{i}" for i in range(200_000))), 1, "columns"),
        (("X_mm", "Y_mm"), 1, "duplicate column"),
    ],
)  # fmt: skip
def test_tables_that_are_refused(
    dmu50: twin.Machine, tmp_path: Path, change: tuple[str, str], line: int, said: str
) -> None:
    path = tmp_path / "m.csv"
    path.write_text(sample("table").replace(*change, 1))
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        Measurements.load(path, dmu50)
    assert time.process_time() - begin < 5.0
    assert said in str(caught.value) and caught.value.line == line


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_another_encoding_is_named_with_its_line(dmu50: twin.Machine, tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(sample("table").replace("# a comment", "# µ").encode(encoding))
    with pytest.raises(InputError, match="UTF-8") as caught:
        Measurements.load(path, dmu50)
    assert caught.value.line == (1 if encoding == "utf-16" else 2)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_are_counted_as_an_editor_does(dmu50: twin.Machine, tmp_path: Path, end: str) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(sample("table").replace("K,tool,50.01", "K,tool,x").replace("\n", end).encode())
    with pytest.raises(InputError) as caught:
        Measurements.load(path, dmu50)
    assert caught.value.line == 4


def test_rows_that_no_instrument_reads_are_set_aside(dmu50: twin.Machine, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    text = sample("table").replace("K,tool,50.01", "K,tool,1e9").replace("0.01,0.01,0.02", "1e-200,0.01,0.02", 1)
    path.write_text(text)
    assert [(note.line, note.text) for note in Measurements.load(path, dmu50).set_aside] == [
        (3, "a standard uncertainty is below 1e-09 mm"),
        (4, "a measured coordinate exceeds 1e+06 mm"),
        (14, "a measured coordinate exceeds 1e+06 mm"),
    ]


def test_a_curve_with_more_terms_than_its_readings_have_stops() -> None:
    """The origin of a curve with nine coefficients cannot be judged from readings at four positions."""
    curve = Curve("E_XX", "um", (0.0, 500.0), "power", tuple(range(1, 10)))
    space = CurveSpace("E_XX", POWER, (0.0, 500.0), 0, 4)
    assert flaw(space, curve, np.arange(1.0, 5.0), np.eye(4)) == ""


def test_a_number_that_is_not_finite_is_unknown_in_words() -> None:
    nan, inf = float("nan"), float("inf")
    assert words.measured(3.0, inf, "µm") == words.measured(3.0, nan, "µm") == "3 µm, uncertainty unknown"
    assert words.measured(nan, 0.1, "µm") == words.measured(inf, 0.1, "µm") == "not determined"


def test_a_fit_without_degrees_of_freedom_is_written_and_read(dmu50: twin.Machine, tmp_path: Path) -> None:
    from twin.identification.result import _fit_text

    assert "nan" not in _fit_text(FitStatistics(0.0, 0.0, float("nan"), 0.0, 0, float("nan")))
    path = tmp_path / "i.json"
    path.write_text(sample("identified").replace('"reduced_chi2": 1.0', '"reduced_chi2": null').replace("0.4", "null"))
    read = Identified.load(path, twin.Calibration.zero(dmu50))
    assert read.file.misfit.reduced_chi2 is None and read.file.misfit.p_value is None


def test_pictures_that_cannot_be_drawn_are_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "m.csv").write_text(sample("table"))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # an import of it then raises ImportError
    monkeypatch.setattr("twin.diagnosis.diagnose", lambda *_, **__: pytest.fail("the work was done first"))
    said = refused(capsys, "diagnose", tmp_path / "m.csv", "--html", tmp_path / "d.html")
    assert "matplotlib is not installed" in said and "twin[plots]" in said


def test_pictures_of_standard_tests_are_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "m.csv").write_text(sample("table"))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr("twin.standards.evaluate", lambda *_, **__: pytest.fail("the work was done first"))
    assert "matplotlib is not installed" in refused(
        capsys, "evaluate", tmp_path / "m.csv", "--html", tmp_path / "e.html"
    )


def test_pictures_of_a_thermal_model_are_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "m.csv").write_text(sample("table"))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr("twin.thermal.fit_thermal", lambda *_, **__: pytest.fail("the work was done first"))
    assert "matplotlib is not installed" in refused(
        capsys, "thermal", tmp_path / "m.csv", "--html", tmp_path / "t.html"
    )


def test_a_scheduler_without_dask_is_refused_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.compute.parallel.find_spec", lambda name: None)
    with pytest.raises(InputError, match="Dask, which is not installed"):
        Workers(scheduler="tcp://here:8786")


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate-run", "-l", "nine_beams_x.yaml", "-o", "r.csv", "--positions", "0,500,100000000"),
        ("simulate-run", "-l", "nine_beams_x.yaml", "-o", "r.csv", "--positions", "0,500,1e300"),
        ("simulate-run", "-l", "nine_beams_x.yaml", "-o", "r.csv", "--positions", "0,500,nan"),
        ("simulate-run", "-l", "nine_beams_x.yaml", "-o", "r.csv", "--positions", "0,500,inf"),
        ("simulate-run", "-l", "nine_beams_x.yaml", "-o", "r.csv", "--positions", "0,500,9", "--rounds", "999999999"),
        ("plan", "-o", "p.csv", "--minutes", "1e308"),
        ("plan", "-o", "p.csv", "--minutes", "1e6"),
        ("volume", "--trials", "1" + "0" * 21),
        ("compensate", "cone_frustum.nc", "-o", "c.nc", "--tolerance", "1e-300"),
        ("scene", "cone_frustum.nc", "-o", "s.html", "--tool-length", "1e308"),
        ("compare", "a.yaml", "b.yaml", "--tool-length", "1e308"),
        ("info", "--machine", "a\0b"),
        ("info", "--calibration", "a\0b.yaml"),
    ],
)
def test_implausible_sizes_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: Sequence[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.yaml").write_text(sample("calibration"))
    Path("b.yaml").write_text(sample("calibration"))
    assert "expected" in refused(capsys, *arguments)
    assert {path.name for path in tmp_path.iterdir()} == {"a.yaml", "b.yaml"}


@pytest.mark.parametrize("named", ['g++ "', "'", "g++ \\"])
def test_a_compiler_whose_name_cannot_be_split_is_none(monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.setenv("CXX", named)
    assert compiler.find_compiler() is None


def test_text_of_a_file_is_not_markup(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(f"{HEAD}source: 'measured [/1], [red]see[/] :smile: [2]'\n")
    with pytest.raises(SystemExit) as stopped:
        cli.main(["info", "--calibration", str(path)])
    assert stopped.value.code == 0
    assert "measured [/1], [red]see[/] :smile: [2]" in capsys.readouterr().out


def test_control_characters_are_shown_not_sent() -> None:
    error = InputError("bad \x1b[2J", expected="a\nb", file="\x1b]0;x\x07.csv", value="\x1b")
    assert str(error) == "\\x1b]0;x\\x07.csv: bad \\x1b[2J: '\\x1b'; expected a\\nb"
    assert printable("a\tb\nµ → \u202e\udcff") == "a\tb\nµ → \\u202e\\udcff"


def run(*arguments: object, **more: Any) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*TWIN, *map(str, arguments)], timeout=120, check=False, **more)


@pytest.mark.parametrize("name", ["\x1b]0;x\x07.csv", "\udcff.csv"])
def test_names_that_would_steer_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    escaped = name.encode("unicode_escape").decode()
    assert f"{escaped}: " in refused(capsys, "identify", tmp_path / name, "-o", tmp_path / "x.yaml")
    (tmp_path / name).write_text(sample("plan"))
    with pytest.raises(SystemExit) as stopped:
        cli.main(["simulate", str(tmp_path / name), "-o", str(tmp_path / f"m{name}")])
    assert stopped.value.code == 0 and f"m{escaped}" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_an_output_that_is_full() -> None:
    with open("/dev/full", "wb") as full:
        done = run("doc", "programs", stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"No space left" in done.stderr


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("arguments", [("doc", "programs"), ("--help",)])
def test_an_output_that_nothing_reads(arguments: tuple[str, ...]) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with open(write_end, "wb") as closed:
        done = run(*arguments, stdout=closed, stderr=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.parametrize(
    ("encoding", "shown"), [("utf-8", "−→µ.csv"), ("cp1252", "-->µ.csv"), ("ascii", "-->u.csv"), ("utf-16", "−→µ.csv")]
)
def test_a_terminal_of_another_encoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, encoding: str, shown: str
) -> None:
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2))
    monkeypatch.setattr("sys.stdout", out)
    monkeypatch.setattr("sys.stderr", err)
    for line in (["doc", "speed"], ["identify", str(tmp_path / "−→µ.csv"), "-o", str(tmp_path / "x.yaml")]):
        with pytest.raises(SystemExit):
            cli.main(line)
    out.flush()
    assert len(out.buffer.getvalue().decode(encoding)) > 500  # type: ignore[attr-defined]
    assert shown in err.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_disk_that_is_full_leaves_nothing(tmp_path: Path) -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    # Python would leave truncated bytecode of modules that have none yet, for other tests to read.
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = run(
        "simulate", "thesis_plan.csv", "-o", tmp_path / "m.csv", capture_output=True, preexec_fn=limited, env=env
    )
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"cannot be written" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_folder_for_temporary_files_that_cannot_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/proc")  # where nothing can be made, by root either
    assert "/proc" in refused(capsys, "control", "--to", "linuxcnc", "-o", tmp_path / "tables", "--tolerance", "0.05")
    assert not (tmp_path / "tables").exists() or list((tmp_path / "tables").iterdir()) == []


def test_a_defect_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("twin.cli.commands.app", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main(["info"])


MOTIONLESS = {
    "end.nc": "M30\n",
    "tape.nc": "%\n",
    "comments.nc": "(nothing)\n; but comments\n",
    "home.nc": "G28 X0\nG28\nM30\n",
    "machine.nc": "G53 X10 Y10 Z-10\nM30\n",
    "one_axis.nc": "G0 X10\nM30\n",
    "empty.h": "BEGIN PGM A MM\nEND PGM A MM\n",
    "empty.cls": "UNITS/MM\nEND-OF-PATH\n",
    "rapid.apt": "RAPID\nFEDRAT/100\n",
}


@pytest.mark.sample(9)  # of 27
@pytest.mark.parametrize("command", ["scene", "compensate", "path"])
@pytest.mark.parametrize("name", MOTIONLESS)
def test_a_program_without_motion_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, command: str
) -> None:
    """Every command that reads a program."""
    program = tmp_path / name
    program.write_text(MOTIONLESS[name])
    output = tmp_path / ("out.html" if command == "scene" else f"out{program.suffix}")
    assert "no block moves an axis to a known position" in refused(capsys, command, program, "-o", output)
    assert not output.exists()


@pytest.mark.parametrize("command", ["scene", "path"])
def test_a_program_larger_than_the_memory_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """Before it is interpreted: by the size of its file, or by its lines."""
    program = tmp_path / "p.h"
    program.write_text("BEGIN PGM A MM\n" + "L X+1\n" * 1000 + "END PGM A MM\n")
    for most in (1000.0, 2e6):
        monkeypatch.setattr("twin.nc.memory_bytes", lambda most=most: most)
        output = tmp_path / ("o.html" if command == "scene" else "o.h")
        assert "too large to be held in memory" in refused(capsys, command, program, "-o", output)


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("G1 X900000000 F100", "too long"),
        ("G1 C90000000 F100", "too long"),
        ("G2 X103 Y100 I100000000 J0", "too long"),
        ("G2 X100 Y100 I10 J0 P999999", "whole number up to 400"),
        ("M98 P9 L999999999", "no subprogram"),
    ],
)
@pytest.mark.parametrize("command", ["scene", "compensate"])
def test_a_motion_that_needs_all_memory_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, block: str, said: str
) -> None:
    program = tmp_path / "p.nc"
    program.write_text(f"G21 G90 G17\nG0 X100 Y100 Z-100 B0 C0\nG1 X101 F100\nX102\nX103\n{block}\nM30\n")
    error = refused(capsys, command, program, "-o", tmp_path / ("o.html" if command == "scene" else "o.nc"))
    assert said in error and "p.nc:6: " in error


def test_repeating_nothing_ends_at_once(dmu50: Machine) -> None:
    """A part without a block, a thousand million times; a subprogram called from many places is looked for once."""
    text = "BEGIN PGM A MM\nL X+1 Y+1 Z+1\nLBL 1\nCALL LBL 1 REP 999999999\nEND PGM A MM\n"
    program = Heidenhain().expanded(Heidenhain().read(text.encode(), "p.h"), ())
    assert len(program.texts) == 5


LONG_NUMBER = "9" * 5000
"""More digits than Python converts to an integer."""


@pytest.mark.parametrize("block", ["L X+10 M{}", "M{}", "CYCL DEF {}", "CYCL DEF 7.{}", "FN {}: Q1=5"])
def test_a_code_with_thousands_of_digits_in_plain_language(dmu50: Machine, block: str) -> None:
    text = f"0 BEGIN PGM A MM\n1 {block.format(LONG_NUMBER)}\n2 END PGM A MM\n"
    with pytest.raises(InputError) as refused:
        Heidenhain().moves(Heidenhain().read(text.encode(), "p.h"), axis_words(dmu50), tcp=False)
    assert (refused.value.file, refused.value.line) == ("p.h", 2)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (f"$AN_CEC[{LONG_NUMBER},0]=0\n", 1),
        (f"$AN_CEC[0,{LONG_NUMBER}]=0\n", 1),
    ],
)
def test_an_index_with_thousands_of_digits_in_a_table(dmu50: Machine, tmp_path: Path, text: str, line: int) -> None:
    (tmp_path / "cec.mpf").write_text(text)
    with pytest.raises(InputError, match="not a line of a compensation table") as refused:
        read_tables("siemens", [tmp_path / "cec.mpf"], dmu50)
    assert refused.value.line == line


def test_a_table_without_a_name_in_an_ini_file(dmu50: Machine, tmp_path: Path) -> None:
    ini = tmp_path / "joints.ini"
    ini.write_text(
        "[TRAJ]\nCOORDINATES = X Y Z B C\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\n[JOINT_0]\nCOMP_FILE =\n"
    )
    with pytest.raises(InputError, match="COMP_FILE is empty") as refused:
        read_tables("linuxcnc", [ini], dmu50)
    assert refused.value.line == 6 and refused.value.expected


@pytest.mark.sample(3)  # of 9
@pytest.mark.parametrize(
    ("words", "status"),
    [(["info", "--machine", "trunnion_ac"], 0), (["info", "--machine", "absent"], 2), (["report"], 2)],
)
@pytest.mark.parametrize("closed", [(2,), (1,), (0, 1, 2)])
def test_closed_streams_change_no_exit_status(
    tmp_path: Path, words: list[str], status: int, closed: tuple[int, ...]
) -> None:
    """As after ``2>&-`` in a shell: nothing can be printed, and no file that is opened later takes the place of the stream."""

    def close() -> None:
        for number in closed:
            os.close(number)

    done = subprocess.run([*TWIN, *words], cwd=tmp_path, preexec_fn=close, timeout=120, check=False)
    assert done.returncode == status


def test_an_interrupt_during_imports_is_one_line(tmp_path: Path) -> None:
    """Ctrl-C while a package is imported, and one that the package turns into another exception."""
    for raised in ("KeyboardInterrupt", "ImportError('stopped') from KeyboardInterrupt()"):
        (tmp_path / "typer.py").write_text(f"raise {raised}\n")
        done = subprocess.run(
            [*TWIN, "info"],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
        )
        assert (done.returncode, done.stderr) == (130, "twin: interrupted, nothing half written\n"), done


def test_inputs_that_are_no_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pipe is read to its end if a program writes to it, also slowly; without one it is refused, as is an endless device."""
    monkeypatch.setattr(pipes, "WRITER_S", 0.2)
    pipe = tmp_path / "p.csv"
    os.mkfifo(pipe)
    assert "a pipe to which no program writes" in refused(capsys, "evaluate", pipe)
    assert "a device or a socket" in refused(capsys, "evaluate", "/dev/zero")

    def write() -> None:
        with pipe.open("w") as stream:
            time.sleep(0.4)
            stream.write(sample("table"))

    writer = threading.Thread(target=write)
    writer.start()
    assert len(Measurements.load(pipe, twin.Machine.load("dmu50"))) == 20
    writer.join()


@pytest.mark.slow
def test_a_workbook_or_table_beyond_any_measurement_is_refused_before_it_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three million cells of a workbook are counted, not read: openpyxl takes minutes for them."""
    row = b"<row>" + b'<c t="n"><v>1</v></c>' * 1000 + b"</row>"
    book = tmp_path / "big.xlsx"
    with zipfile.ZipFile(book, "w", zipfile.ZIP_DEFLATED) as parts:
        parts.writestr("xl/worksheets/sheet1.xml", b"<worksheet><sheetData>" + row * 3100 + b"</sheetData></worksheet>")
    begin = time.process_time()
    assert "a sheet of more than 3,000,000 cells" in refused(capsys, "import", book, "-o", tmp_path / "m.csv")
    assert time.process_time() - begin < 20.0  # a second or two
    table = tmp_path / "big.csv"
    table.write_bytes((b"1," * 999 + b"1\n") * 3100)
    assert "too large: more than" in refused(capsys, "import", table, "-o", tmp_path / "m.csv")
    table.write_bytes(b",".join(b"c%d" % i for i in range(1000)) + b"\n" + b",\n" * 10_000)
    assert "too large: 10,001 rows" in refused(capsys, "evaluate", table)
