"""Programs processed in stretches from file to file: same bytes and same report as in one piece, in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.model.errors import random_calibration
from tests.nested import alike
from twin._common import resources
from twin._common.errors import InputError, OutputError
from twin.compensation import Compensator, Options
from twin.compensation.programs import parts
from twin.compensation.programs.uncorrected import CLASS_POSES
from twin.compensation.programs.words import Setup
from twin.controls.offsets import OffsetTable, ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import chunks, dialect_for, read_program
from twin.nc.iso.dialect import IsoRewriter
from twin.tool.forward import Kinematics

SAMPLES = Path(__file__).resolve().parents[2] / "twin" / "samples"
LENGTH = 120.0
SUMS = 1e-9
"""The same numbers summed in another order; thousands of them lose some digits of sixteen."""
SOLVER = 1e-9
"""µm and µrad: the noise of a pose's arithmetic (1e-16 of a metre), which differs with its place in a batch."""
STRETCHES = [(30, 1, 1), (200, 1, 1), (200, 1, 17), (3000, 12, 10**6)]
"""Bytes read at once, of lines of some 30, the fewest lines edited at once, and the fewest solved at once: borders before and behind
every line, and inside runs; parts of one stretch, of several, and of all."""


@pytest.fixture
def both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Compensate a program in one piece and in stretches of some bytes, assert equal results, and return them.

    The least number of lines edited and solved together is set to the stretch.
    """

    def cut(size: int, shortest: int, lines: int) -> None:
        monkeypatch.setattr(parts, "STRETCH_BYTES", size)
        monkeypatch.setattr(chunks, "SHORTEST_RUN", shortest)
        monkeypatch.setattr(parts, "PART_LINES", lines)

    def run(text: str | bytes, compensator: Compensator, *stretches: tuple[int, int, int]) -> str:
        source, output = tmp_path / "p.nc", tmp_path / "out.nc"
        source.write_bytes(text.encode("latin-1") if isinstance(text, str) else text)
        try:
            whole = compensator.compensate(*read_program(source))
        except InputError as error:
            for one in stretches:
                cut(*one)
                with pytest.raises(InputError) as refused:
                    compensator.compensate_file(source, output)
                assert str(refused.value) == str(error)
            assert [path.name for path in tmp_path.iterdir()] == ["p.nc"]
            return f"refused: {error}"
        for one in stretches:
            cut(*one)
            report = compensator.compensate_file(source, output)
            assert output.read_bytes() == whole.text.encode("latin-1")
            alike(report.to_dict(), whole.report.to_dict(), rel=SUMS, least=SOLVER)
            assert sorted(path.name for path in tmp_path.iterdir()) == ["out.nc", "p.nc"]
        return whole.text

    return run


@pytest.fixture(scope="module")
def usual(dmu50: Machine, calibration: Calibration) -> Compensator:
    return Compensator(dmu50, calibration, Options(tool_length_mm=LENGTH))


def curve(blocks: int, words: str = "XYZBC") -> str:
    """Return a path over most of the machine, with every axis moving."""
    t = np.linspace(0.0, 1.0, blocks)
    place = {
        "X": 250 + 150 * np.cos(40 * t),
        "Y": 225 + 120 * np.sin(43 * t),
        "Z": -200 + 80 * np.sin(9 * t),
        "B": 45 + 30 * np.sin(5 * t),
        "C": 180 + 150 * np.cos(7 * t),
    }
    return "".join("G1 " + " ".join(f"{w}{place[w][i]:.3f}" for w in words) + "\n" for i in range(blocks))


HEAD = "%\nO1 (part)\nG21 G90\nG0 X250 Y225 Z-100 B30 C10\nG1 F2000\n"
PROGRAMS = {
    "five axes": HEAD + curve(60) + "M30\n%\n",
    "three axes": "G21 G90\nG0 X250 Y225 Z-100\nG1 F2000\n" + curve(60, "XYZ") + "M30\n",
    "two words": HEAD + curve(40, "XY") + curve(40, "XZ") + "M30\n",
    "long blocks": "G21 G90\nG0 X10 Y20 Z-100 B40 C0\nG1 X490 F500\n"
    + "G1 Y400\nX20\nG1 C300\nG1 X100 Y50 Z-300 B70 C20\n" * 3,
    "arcs": HEAD + "G17\n" + "G2 X300 Y225 I25 J0\nG1 X250\nX255 Y226\nG3 X250 Y225 R80\nX251\nG1 X252\nG0 Z-90\n" * 4,
    "numbers and comments": HEAD + "".join(f"N{i} G01 X{i}. Y{i}.50 (c)\nN{i} X{i}.5Z-{i}\n\n" for i in range(10, 40)),
    "comments on lines of their own": HEAD
    + "".join(
        f"G1 X{200 + i}.5 Y{100 + i / 8}\n{note}\n"
        for note in ("(X1)", " ; G1 X2", "N20 (Z3)", "n30;Y4", "%", "%PM X5", "( )\t", "N40", "(\xe9)", ";", "(a)(b)")
        for i in range(9)
    )
    + curve(10),
    "returns alone": (HEAD + curve(30)).replace("\n", "\r"),
    "returns and newlines": (HEAD + curve(30)).replace("\n", "\r\n"),
    "no ending": (HEAD + curve(30)).rstrip("\n"),
    "a byte order mark": "\xef\xbb\xbf" + HEAD + curve(20),
    "rotary axes only later": "G21 G90\nG0 X250 Y225 Z-100\n" + curve(40, "XYZ") + curve(20),
    "out of range": HEAD + curve(20) + "G1 X499.999\nX502\nX505 Y300\nX400\n" + curve(20),
    "after machine coordinates": HEAD + "G1 X120\nG53 G0 Z-20.\nG1 X140\nX160\nG53 G0 X30. Y20.\nG1 Z-150\n" * 3,
    "past a singularity": HEAD + "".join(f"G1 X{200 + i} B{abs(i - 20) / 40:.3f} C{i}\n" for i in range(40)),
    "machine coordinates": HEAD + curve(15) + "G53 G0 Z-1\n" + curve(15) + "G28 Z0\n" + curve(15),
    "inverse time": HEAD + "G93\n" + "G1 X100 F5\nG1 X450 F3.5\n" * 5 + "G94\nG1 X20 F500\n" + curve(20),
    "inches": "G20 G90\nG0 X10 Y9 Z-4 B30 C10\n" + "".join(f"G1 X{i / 10} Y{i / 9:.4f}\n" for i in range(80, 120)),
    "incremental": HEAD + "G91\n" + "G1 X1 Y-.5\n" * 30 + "G90\n" + curve(10),
    "skipped blocks": HEAD + curve(15) + "/G1 X100\nX110\n/X120\n" + curve(15),
    "tool-tip coordinates": HEAD.replace("F2000", "F2000\nG43.4 H1\nG1 X10 Y10 Z50 B20 C10")
    + "".join(f"G1 X{i} Y{i / 2} Z{50 + i / 10} B{20 + i / 4} C{10 + i}\n" for i in range(30))
    + "G49\nG0 X250 Y225 Z-100\n"
    + curve(10),
    "tool vectors": HEAD
    + "TRAORI\nG1 X0 Y0 Z50 A3=0.1 B3=0 C3=1\n"
    + "".join(f"X{i} A3={0.1 + i / 99:.5f} B3=0.05 C3=1\nY{i}\n" for i in range(15))
    + "TRAFOOF\nG0 X250 Y225 Z-100 B30 C10\n"
    + curve(10),
    "a cycle": HEAD + curve(10) + "MCALL CYCLE81(-50,-60,2,-70)\nX100 Y100\nX120\nMCALL\n" + curve(10),
    "nothing moves at first": "(c)\n" * 100 + HEAD + curve(20),
    "a block far away that is wrong": HEAD + curve(40) + "G1 X1.2.3\n" + curve(10),
    "a block far away that is refused": HEAD + curve(40) + "G81 X1 R5\n" + curve(10),
    "beyond the curves": HEAD + curve(30) + "G1 Z-0.5\nG1 Z-1\n",
    "no motion": "(nothing)\nM3\n" * 20,
    "empty": "\n \n",
    "binary": HEAD + curve(30) + "\0\n",
    "control characters": HEAD + "\x01" * 500,
}


VARIED = {
    "three axes",
    "two words",
    "returns alone",
    "no ending",
    "a byte order mark",
    "rotary axes only later",
    "inverse time",
    "inches",
    "incremental",
    "skipped blocks",
    "nothing moves at first",
    "machine coordinates",
    "comments on lines of their own",
    "beyond the curves",
}
"""Programs run only with slow tests, because others test the same in another form."""


@pytest.mark.sample(7)  # of 17
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in VARIED else name for name in PROGRAMS]
)
def test_the_same_in_stretches(name: str, usual: Compensator, both: Callable[..., str]) -> None:
    assert both(PROGRAMS[name], usual, *STRETCHES) != PROGRAMS[name]


@pytest.mark.parametrize("size", [1, 2, 3, 5, 11])
def test_stretch_borders_inside_words(size: int, usual: Compensator, both: Callable[..., str]) -> None:
    """Reading few bytes at once ends inside words and between carriage return and newline."""
    both((HEAD + curve(8)).replace("\n", "\r\n"), usual, (size, 1, 1))
    both("\r".join(["G21 G90", "", "G0 X250 Y225 Z-100 B30 C10", "G1 X251", "X252\r\n\rX253"]), usual, (size, 1, 1))


@pytest.mark.sample(1)  # of 5
@pytest.mark.parametrize(
    "options",
    [
        {"method": "thesis"},
        {"tolerance_mm": 2e-5},
        {"setup": Setup(work_offset={"X": 20.0, "C": 3.0})},
        {"tcp": True, "setup": Setup(work_origin_mm=(1.0, 2.0, 3.0))},
        {"rotary_limit_deg": 0.01},
    ],
    ids=lambda options: next(iter(options)),
)
def test_whatever_the_options(
    options: dict[str, Any], dmu50: Machine, calibration: Calibration, both: Callable[..., str]
) -> None:
    compensator = Compensator(dmu50, calibration, Options(tool_length_mm=LENGTH, **options))
    text = "G21 G90\nG0 X10 Y20 Z60 B30 C10\n" if options.get("tcp") else HEAD
    moves = "".join(f"G1 X{i} Y{i / 2} Z{60 + i / 10} B{20 + i / 4} C{10 + i}\n" for i in range(30))
    assert "refused" not in both(text + (moves if options.get("tcp") else curve(40)), compensator, (200, 1, 1))


def test_machines_of_another_design(both: Callable[..., str]) -> None:
    machine = Machine.load("xyzbc_trunnion")
    errors = random_calibration(machine, np.random.default_rng(1), size=30.0)
    compensator = Compensator(machine, errors, Options(tool_length_mm=50.0))
    moves = "".join(f"G1 X{i} Y{i / 2} Z{-20 - i / 10} B{i / 4} C{10 + i}\n" for i in range(40))
    both("G21 G90\nG0 X0 Y0 Z0 B0 C0\n" + moves, compensator, (200, 1, 1))


def test_nothing_to_correct_changes_nothing(dmu50: Machine, both: Callable[..., str]) -> None:
    compensator = Compensator(dmu50, Calibration.zero(dmu50), Options(tool_length_mm=LENGTH))
    text = HEAD + curve(40) + "/G1 X3\nG2 X4 R9\n"
    assert both(text, compensator, (200, 1, 1)) == text


@pytest.mark.sample(2)  # of 3
@pytest.mark.parametrize(
    "name",
    [
        "linuxcnc_boat-xyzbc.ngc",
        "spinnerU5_Bottle_opener_Flaschenoeffner.txt",
        "spinnerU5_Keychain_Schluesselanhaenger.mpf",
    ],
)
def test_programs_of_others(name: str, programs: Path, both: Callable[..., str]) -> None:
    machine = Machine.load("xyzbc_trunnion")
    errors = random_calibration(machine, np.random.default_rng(1), size=30.0)
    data = (programs / name).read_bytes()
    both(data, Compensator(machine, errors, Options(tool_length_mm=50.0)), (20_000, 12, 600))


def test_samples(usual: Compensator, both: Callable[..., str]) -> None:
    for path in sorted(SAMPLES.glob("*.nc")):
        both(path.read_bytes(), usual, (3000, 12, 200))


def test_shares_over_a_program_longer_than_the_sample(
    dmu50: Machine, calibration: Calibration, usual: Compensator, both: Callable[..., str], tmp_path: Path
) -> None:
    """Blocks sampled without knowing the program's length are those sampled from the whole, and are representative."""
    both(HEAD + curve(3000), usual, (40_000, 12, 1000))
    source = tmp_path / "p.nc"
    source.write_text(HEAD + curve(3000))
    result = usual.compensate(*read_program(source))
    ends, nominal = result.nominal, usual.prepared.space.nominal
    positioning = calibration.where(lambda name: name in {"E_XX", "E_YY", "E_ZZ"})
    alone = Kinematics(dmu50, positioning, tool_length_mm=LENGTH)
    size = np.linalg.norm(alone.forward(ends).point_mm - nominal.forward(ends).point_mm, axis=1) * 1e3
    share = next(share for share in result.report.classes if share.name == "L-POS")
    assert result.report.before.points > 3 * CLASS_POSES
    # The share over about 4000 of 18,000 poses, sampled evenly, against all 3000 end points: equal to one per cent for a smooth error.
    assert share.before_rms_um == pytest.approx(float(np.sqrt(np.mean(size**2))), rel=0.01)


@pytest.mark.parametrize("raised", [KeyboardInterrupt, MemoryError])
def test_an_interrupt_leaves_nothing(
    raised: type[BaseException],
    usual: Compensator,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Interrupted in the middle, it leaves no output and no temporary files, and an existing file stays unchanged."""
    monkeypatch.setattr(parts, "STRETCH_BYTES", 2000)
    monkeypatch.setattr(parts, "PART_LINES", 50)
    source, output = tmp_path / "p.nc", tmp_path / "out.nc"
    source.write_text(HEAD + curve(1000))
    output.write_text("before")
    seen: list[float] = []

    def stop(stage: str, fraction: float) -> None:
        seen.append(fraction)
        if fraction > 0.3:
            raise raised

    with pytest.raises(raised):
        usual.compensate_file(source, output, stop)
    assert 0.0 < seen[0] < seen[-1] < 0.5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.nc", "p.nc"]
    assert output.read_text() == "before"


def test_an_error_comes_before_a_later_one(usual: Compensator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading runs ahead of solving, but the first error of the program is raised."""
    monkeypatch.setattr(parts, "STRETCH_BYTES", 2000)
    monkeypatch.setattr(parts, "PART_LINES", 50)
    source = tmp_path / "p.nc"
    source.write_text(HEAD + curve(100) + "G1 X1.2.3\n" + curve(100) + "G81 X1\n")
    with pytest.raises(InputError, match=r"p\.nc:106: X has no number"):
        usual.compensate_file(source, tmp_path / "out.nc")
    assert not (tmp_path / "out.nc").exists()


def test_output_that_differs_is_not_written(
    usual: Compensator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The output is read back and compared: a writer that changes one word is detected, with its line."""
    right = IsoRewriter.write

    def wrong(self: IsoRewriter, *given: Any) -> bytes:
        data = right(self, *given)
        at = data.rindex(b"X") + 1
        return data[:at] + (b"1" if data[at : at + 1] != b"1" else b"2") + data[at + 1 :]

    monkeypatch.setattr(IsoRewriter, "write", wrong)
    source = tmp_path / "p.nc"
    source.write_text(HEAD + curve(100))
    with pytest.raises(OutputError, match=r"p\.nc:10[45]: the output has"):
        usual.compensate_file(source, tmp_path / "out.nc")
    assert [path.name for path in tmp_path.iterdir()] == ["p.nc"]


# --- Split anywhere, over languages and what a program may hold ---------------------------------------------------------

TABLES = Setup(
    offsets=OffsetTable(
        Path("o.csv"),
        {
            "G54": {"X": 250.0, "Y": 225.0, "Z": -390.0},
            "G55": {"X": 200.0, "Y": 180.0, "Z": -350.0, "C": 12.5},
            "7": {"X": 250.0, "Y": 225.0, "Z": -390.0},
            "8": {"X": 200.0, "Y": 180.0, "Z": -350.0, "C": 12.5},
        },
    ),
    tools=ToolTable(Path("t.csv"), {"1": 80.0, "2": 131.5}),
)
ROWS = tuple(
    zip(range(-20, 40, 4), range(30, -30, -4), range(12, 42, 2), range(0, 45, 3), range(5, 95, 6), strict=True)
)
"""X, Y, Z, B, C of the blocks of a feature."""


def rows(form: str, count: int) -> str:
    return "".join(form.format(*row) for row in ROWS[:count])


FEATURES = {
    "p.nc": {
        "head": "G90 G21 G17\nT1 M6\nG54\nG43 H1\nG0 X0. Y0. Z60. B0. C0.\nG1 F500.\n",
        "axes": rows("G1 X{0}. Y{1}.5 Z{2}. B{3}. C{4}.\n", 9),
        "three axes": rows("X{0}.25 Y{1}. Z{2}.\n", 9),
        "arcs": "G0 X0. Y0. Z60.\n" + "G2 X10. Y0. I5. J0.\nG3 X0. Y0. R6.\n(note)\n" * 3 + "G1 X1.\n",
        "another tool": "G0 Z60.\nG49\nT2 M6\nG55\nG43 H2\n\nG0 X0. Y0. Z60. B0. C0.\nG1 X5. Y5.\n",
        "the first tool": "G0 Z60.\nG49\nT1 M6\nG54\nG43 H1\nG0 X0. Y0. Z60. B0. C0.\nG1 X5. Y5.\n",
        "machine coordinates": "G53 G0 Z-1.\nG0 X0. Y0. Z60. B0. C0.\nG53 G0 X100.\n(x)\nG0 X3. Y0. Z60. B0. C0.\nG1 X4.\n",
        "tilted plane": "G0 X0. Y0. Z60. B0. C0.\nG68.2 X1. Y2. Z3. I30. J20. K-40.\nG53.1\nG0 X0. Y0. Z20.\nG1 Z0.\nX9. Y3.\n"
        "G2 X12. Y3. R2.\nG69\nG0 X0. Y0. Z60. B0. C0.\nG1 X1.\n",
        "tip": "G49\nG43.4 H1\nG0 X0. Y0. Z60. B0. C0.\n"
        + rows("G1 X{0}. Y{1}. Z{2}. B{3}. C{4}.\n", 7)
        + "G49\nG43 H1\n"
        "G0 X0. Y0. Z60. B0. C0.\nG1 X1.\n",
        "holes": "G0 X0. Y0. Z60. B0. C0.\nG99 G81 X1. Y2. Z10. R20. F100.\n"
        + rows("X{0}. Y{1}.\n", 12)
        + "G80\nG1 X2.\n",
        "threads": "G0 X0. Y0. Z60. B0. C0.\n(a)\nM29 S500\n(b)\nG99 G84 X1. Y2. Z10. R20. F1.\nX3.\nG80\nG1 X2.\n",
        "inverse time": "G93\nG1 X1. Y2. F9.\nX30. F3.\nG94\nG1 X2. F500.\n",
        "increments": "G91\nG1 X1. Y-1.\nX-1.\nG90\nG1 X0.\n",
        "end": "M30\n",
    },
    "p.h": {
        "head": "BEGIN PGM A MM\nTOOL CALL 1 Z S5000\nCYCL DEF 247 DATUM SETTING ~\n  Q339=+7 ;NUMBER\n"
        "L X+0 Y+0 Z+60 B+0 C+0 FMAX\nL X+1 F500\n",
        "axes": rows("L X{0:+} Y{1:+} Z{2:+} B{3:+} C{4:+}\n", 9),
        "three axes": rows("L X{0:+}.25 Y{1:+} Z{2:+}\n", 9),
        "arcs": "L X+0 Y+0 Z+60 FMAX\n" + "CC X+5 Y+0\nC X+10 Y+0 DR-\n; note\nL X+0 Y+0\n" * 3,
        "another tool": "TOOL CALL 2 Z S5000 DL+0.25\nCYCL DEF 247 DATUM SETTING ~\n  Q339=+8 ;NUMBER\n"
        "L X+0 Y+0 Z+60 B+0 C+0 FMAX\nL X+5\n",
        "machine coordinates": "L Z-1 R0 FMAX M91\nL X+0 Y+0 Z+60 B+0 C+0 FMAX\nL X+4\n",
        "tilted plane": "L X+0 Y+0 Z+60 B+0 C+0 FMAX\nPLANE SPATIAL SPA+20 SPB-30 SPC+15 TURN FMAX\nL X+0 Y+0 Z+20 FMAX\n"
        "L Z+0\nL X+9 Y+3\n"
        "PLANE RESET STAY\nL X+0 Y+0 Z+60 B+0 C+0 FMAX\nL X+1\n",
        "tip": "M128\nL X+0 Y+0 Z+60 B+0 C+0 FMAX\n" + rows("L X{0:+} Y{1:+} Z{2:+} B{3:+} C{4:+}\n", 7) + "M129\n"
        "L X+0 Y+0 Z+60 B+0 C+0 FMAX\nL X+1\n",
        "long ways": "M126\nL C+300 FMAX\nL C+10 FMAX\nM127\nL X+2\n",
        "increments": "L IX+1 IY-1\nL IX-1\n",
        "end": "END PGM A MM\n",
    },
    "p.cls": {
        "head": "PARTNO A\nUNITS/MM\nFEDRAT/500,MMPM\nGOTO/0,0,60,0,0,1\n",
        "vectors": rows("GOTO/{0}.5,{1},{2},0.28,0,0.96\n", 9) + "GOTO/0,0,50,0,0,1\n",
        "points": rows("GOTO/{0},{1},{2}\n", 9),
        "continued": "GOTO/1,2, $\n 30,0,0.6,0.8\nGOTO/4,5,30, $\n 0, $\n 0,1\n",
        "rapids": "RAPID\nGOTO/5,5,60\n$$ note\nFEDRAT/100,MMPM\nGOTO/6,6,50\nPPRINT X\n",
        "inches": "UNITS/INCHES\nGOTO/1,0.5,2\nUNITS/MM\nGOTO/0,0,50\n",
        "end": "FINI\n",
    },
}


@pytest.fixture(scope="module")
def tabled(dmu50: Machine) -> Compensator:
    return Compensator(dmu50, random_calibration(dmu50, np.random.default_rng(5), size=30.0), Options(setup=TABLES))


def numbered(text: str) -> str:
    """Return plain language with its blocks numbered consecutively."""
    lines = text.splitlines(keepends=True)
    number, out = 0, []
    for before, line in zip(("", *lines), lines, strict=False):
        continues = before.rstrip().endswith("~")
        out.append(line if continues else f"{number} {line}")
        number += not continues
    return "".join(out)


class Division(NamedTuple):
    """A program, and how it is divided: bytes read at once, fewest lines solved together, suffix of the output of an APT program."""

    name: str
    features: tuple[str, ...]
    numbers: bool
    stretch: int
    lines: int
    into: str


@st.composite
def divisions(draw: st.DrawFn) -> Division:
    name = draw(st.sampled_from([*FEATURES]))
    chosen = draw(st.lists(st.sampled_from([*FEATURES[name]][1:-1]), min_size=2, max_size=6))
    how = [
        draw(st.sampled_from(values)) for values in ([False, True], [30, 90, 400], [1, 7, 40], [".cls", ".nc", ".h"])
    ]
    return Division(name, tuple(chosen), *how)


@pytest.mark.parametrize("name", [*FEATURES])
def test_one_thread_at_a_time_builds_expressions(
    name: str, dmu50: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CasADi counts references without a lock while another thread runs: two threads that built at once ended the process, rarely."""
    alone: list[bool] = []
    make = ca.Function.__init__

    def made(*args: Any, **kwargs: Any) -> None:
        alone.append(resources._expressions._is_owned())  # type: ignore[attr-defined]  # of an RLock
        make(*args, **kwargs)

    source = tmp_path / name
    source.write_text("".join(FEATURES[name].values()))
    calibration = random_calibration(dmu50, np.random.default_rng(7), size=50.0)
    compensator = Compensator(dmu50, calibration, Options(setup=TABLES))
    monkeypatch.setattr(parts, "STRETCH_BYTES", 90)
    monkeypatch.setattr(parts, "PART_LINES", 7)
    monkeypatch.setattr(ca.Function, "__init__", made)
    compensator.compensate_file(source, tmp_path / f"out{source.suffix}")
    assert len(alone) > 5 and all(alone)


@settings(max_examples=settings.default.max_examples // 8)  # 3; 25 in a slow run
@example(division=Division("p.nc", ("threads", "holes", "tilted plane", "another tool"), False, 30, 1, ""))
@example(division=Division("p.h", ("arcs", "another tool", "tilted plane", "long ways"), True, 30, 1, ""))
@example(division=Division("p.cls", ("continued", "inches"), False, 30, 1, ".h"))
@given(division=divisions())
def test_split_anywhere(division: Division, tabled: Compensator, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Any features in any order, divided after any line: the same bytes and the same report as in one part."""
    name = division.name
    text = "".join(FEATURES[name][feature] for feature in ("head", *division.features, "end"))
    folder = tmp_path_factory.mktemp("split")
    source = folder / name
    output = folder / f"out{division.into if name == 'p.cls' else source.suffix}"
    source.write_text(numbered(text) if name == "p.h" and division.numbers else text)
    target = dialect_for(output)
    outcomes = []
    with pytest.MonkeyPatch.context() as patch:
        for run in ("whole", "parts"):
            try:
                if run == "whole":
                    result = tabled.compensate(*read_program(source), into=target)
                    outcomes.append((result.text.encode("latin-1"), result.report.to_dict()))
                    continue
                patch.setattr(parts, "STRETCH_BYTES", division.stretch)
                patch.setattr(chunks, "SHORTEST_RUN", 1)
                patch.setattr(parts, "PART_LINES", division.lines)
                report = tabled.compensate_file(source, output, into=target)
                outcomes.append((output.read_bytes(), report.to_dict()))
            except InputError as error:
                outcomes.append((str(error).encode(), {}))
    (whole, whole_report), (split, split_report) = outcomes
    assert split.decode("latin-1") == whole.decode("latin-1")
    for report in (split_report, whole_report):
        for name in {"before", "after"} & report.keys():
            # Several lines may have the largest distance, to the solver's accuracy: which one is named is arbitrary.
            del report[name]["worst_line"]
    alike(split_report, whole_report, rel=SUMS, least=SOLVER)


PEAK = """
import sys
from pathlib import Path
from tests.benchmarks.timing import peak_mb
from twin import Calibration, Compensator, Machine, Options
machine = Machine.load("dmu50")
Compensator(machine, Calibration.default(machine), Options(tool_length_mm=120.0)).compensate_file(*map(Path, sys.argv[1:]))
print(peak_mb())
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_program(tmp_path: Path) -> None:
    """Peak memory of a process for 200,000 blocks and for three times as many: both have stretches in every stage at once."""
    peaks = []
    for blocks in (200_000, 600_000):
        source = tmp_path / "p.nc"
        source.write_text(HEAD + curve(blocks))
        done = subprocess.run(
            [sys.executable, "-c", PEAK, source, tmp_path / "out.nc"],
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).resolve().parents[2],
        )
        peaks.append(float(done.stdout))
    # MB. Which stages have their arrays at once differs from run to run, by some 60 MB; the text, moves and positions of 400,000 blocks
    # more, were they kept, would be more than 200.
    assert peaks[1] <= 500.0
    assert peaks[1] - peaks[0] <= 100.0
