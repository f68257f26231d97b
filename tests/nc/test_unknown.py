"""Statements whose effect is not known: nothing is known after them until every axis has a position in machine coordinates."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc.nc_support import AXES, read_moves
from twin._common.errors import InputError
from twin.compensation import Compensator, Options, Report
from twin.compensation.fewer_blocks import Refitter
from twin.compensation.programs.execute import execute_file
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS, dialect_for, read_program
from twin.nc.apt.reader import _PASSED as APT_PASSED
from twin.nc.dialect import Dialect
from twin.nc.heidenhain import vocabulary as plain
from twin.nc.iso import vocabulary as iso

ISO, PLAIN, APT = (next(one for one in DIALECTS if one.name == name) for name in ("iso", "heidenhain", "apt"))
TCP = iso.TCP_ON | iso.TCP_OFF | set(AXES.tcp_on) | set(AXES.tcp_off)

G_CODES = [
    f"G{number}"
    for number in (*map(str, range(1000)), *(f"{whole}.{tenth}" for whole in range(1000) for tenth in range(1, 10)))
    if not {f"G{number}"} & TCP and number not in iso.GROUP_OF and number not in iso.REFUSED_CODES
]
REFUSED_OR_KNOWN_M = iso.HARMLESS_M | iso.CALLING_M | iso.REFUSED_M | iso.SAVING_M | {"M73"} | TCP
SWITCHING = (21, 22, 23, 24, 91, 92, 128, 129, 428, 429, 430)
M_CODES = [f"M{number}" for number in SWITCHING if f"M{number}" not in TCP]
AUXILIARY_M = [f"M{i}" for i in range(1000) if f"M{i}" not in REFUSED_OR_KNOWN_M and i not in SWITCHING]
NAMES = [
    "TRAOOF",
    "TRAORY(1)",
    "TOOLCHANGE_MACRO",
    "SPECIAL(1,2)",
    "ROTATE_PART",
    "GOHOME(3)",
    "DELDTG",
    "ORIRESET(0)",
    "REPOSL",
]
WORDS = ["E5", "M2=21", "T2=5", "DL=2", "$TC_DP3[1,1]=120", "$MC_AXIS=1", "#1601=5", "#5023=4", "G[8]=54", "#1999=1"]
KNOWN_NAMES = iso.PASSED | iso.CONTROL_FLOW | iso.TRANSFORMS | iso.CURVES | TCP

KNOWN_PLAIN_M = plain.HARMLESS_M | plain.REFUSED_M | plain.CALLING_M | {94, 128, 129, 428, 429}
PLAIN_M = [f"M{i}" for i in (*SWITCHING, *range(89, 150), *range(200, 205)) if i not in KNOWN_PLAIN_M]
PLAIN_AUXILIARY = [f"M{i}" for i in range(1000) if i not in KNOWN_PLAIN_M and f"M{i}" not in PLAIN_M]
PLAIN_CYCLES = [
    f"CYCL DEF {i} SOMETHING"
    for i in range(1000)
    if i not in plain.HARMLESS_CYCLES | plain.RUN_AT_ONCE and i not in plain.TRANSFORM_CYCLES
]
PLAIN_FN = [f"FN {i}: Q1 = +5" for i in range(100) if i not in plain.HARMLESS_FN and not 9 <= i <= 12]
PLAIN_STATEMENTS = [
    *(
        "TCH PROBE 410 DATUM INSIDE RECTAN.",
        "FUNCTION PARAXCOMP DISPLAY Z",
        "FUNCTION PROG PATH IS CONTOUR",
        "FUNCTION NEW",
    ),
    *("TABDATA WRITE CORR-TCS", "ROTATE", "PRESET SELECT #3", "INCLUDE", "SECTION", "TOOL WEAR 5", "POTATO 5"),
    *("QGXZV", "QX(1)", "Q", "QS", "Q5", "QUIT 5"),
]
KINDS = {
    "G codes": (ISO, G_CODES),
    "M codes": (ISO, M_CODES),
    "names and calls": (ISO, NAMES),
    "words and variables": (ISO, WORDS),
    "M functions of plain language": (PLAIN, PLAIN_M),
    "cycles": (PLAIN, PLAIN_CYCLES),
    "parameter functions": (PLAIN, PLAIN_FN),
    "statements of plain language": (PLAIN, PLAIN_STATEMENTS),
}
BLOCKS = {
    ISO: ("G0 X1 Y2 Z3 B4 C5", "G1 X6 F500", "G53 G0 X0 Y0 Z0 B0 C0"),
    PLAIN: ("L X+1 Y+2 Z+3 B+4 C+5 FMAX", "L X+6 F500", "L X+0 Y+0 Z+0 B+0 C+0 FMAX M91"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_statement_outside_the_vocabulary(kind: str) -> None:
    """All of a kind in one program, each followed by a feed, every axis in machine coordinates, and blocks that are known again."""
    dialect, statements = KINDS[kind]
    start, feed, machine = BLOCKS[dialect]
    assert len(statements) > 8
    text = "\n".join(f"{start}\n{one}\n{feed}\n{machine}\n{start}\n{feed}" for one in statements) + "\n"
    moves = read_moves(dialect, text).moves
    assert len(moves) == 5 * len(statements)
    for i, statement in enumerate(statements):
        before, lost, placed, again, cut = moves[5 * i : 5 * i + 5]
        assert not before.unknown and not before.machine, statement
        assert lost.unknown and all(map(math.isnan, lost.position)), statement
        assert placed.machine
        assert [one.unknown for one in (again, cut)] == ["", ""]
        assert cut.position == (6.0, 2.0, 3.0, 4.0, 5.0)


@pytest.mark.parametrize(("dialect", "words"), [(ISO, AUXILIARY_M), (PLAIN, PLAIN_AUXILIARY)])
def test_auxiliary_functions_of_the_builder_pass_with_a_notice(dialect: Dialect, words: list[str]) -> None:
    start, feed, _ = BLOCKS[dialect]
    assert len(words) > 700
    text = start + "\n" + "\n".join(f"{word}\n{feed} {word}" for word in words) + "\n"
    reading = read_moves(dialect, text)
    assert len(reading.moves) == 1 + len(words) and not any(move.unknown for move in reading.moves)
    said = [(notice.line, notice.text.split()[0]) for notice in reading.notices if notice.text[0] in "MA"]
    assert said == [(1 + i, words[i // 2]) for i in range(2 * len(words))]


@pytest.mark.parametrize("many", [1, 60])
@pytest.mark.parametrize(
    ("dialect", "start", "turn"),
    [(ISO, "G0 X1 Y2 Z3 B4 C5", "G1 X6 B{} F500"), (PLAIN, "L X+1 Y+2 Z+3 B+4 C+5 FMAX", "L X+6 B+{} F500")],
)
def test_a_feed_that_turns_behind_an_unknown_function_is_refused(
    dialect: Dialect, start: str, turn: str, many: int
) -> None:
    """The function may be the machine's word for tool centre point control; single blocks and runs of many alike."""
    turns = "\n".join(turn.format(5 + i) for i in range(many))
    read_moves(dialect, f"{start}\n{turns}\nM77\n")
    read_moves(dialect, f"{start}\nM77\n{turn.format(4)}\n{start}\n")
    on = "M428" if dialect is ISO else "M128"
    read_moves(dialect, f"{start}\nM77\n{on}\n{start}\n{turns}\n")
    with pytest.raises(InputError, match="effect of M77 \\(line 2\\) is not known: it may switch") as caught:
        read_moves(dialect, f"{start}\nM77\nM78\n{turns}\n")
    assert caught.value.line == 4


@pytest.mark.parametrize(
    ("text", "line"), [("G0 X1\nG1 X2\n", 0), ("G0 X1\nG21\nX2\n", 0), ("(A)\nX1\n" * 60, 1), ("G20\nX1\n", None)]
)
def test_a_program_that_states_no_unit_is_noted(text: str, line: int | None) -> None:
    notices = [notice.line for notice in read_moves(ISO, text).notices if "does not state its unit" in notice.text]
    assert notices == ([] if line is None else [line])


def test_names_are_outside_the_vocabulary() -> None:
    assert not {re.split(r"\W", name)[0] for name in NAMES} & KNOWN_NAMES


@pytest.mark.parametrize(
    ("dialect", "blocks"),
    [
        (ISO, ["G53 G0 Z0", "G53 X0 Y0", "G53 B0", "G53 C0"]),
        (ISO, ["SUPA G0 Z=0 D0", "SUPA G0 X=1 Y=2 B=3 C=4"]),
        (PLAIN, ["L Z+0 FMAX M91", "L X+0 Y+0 FMAX M91", "L B+0 C+0 FMAX M91"]),
    ],
)
def test_nothing_is_known_before_the_last_axis(dialect: Dialect, blocks: list[str]) -> None:
    start, feed, _ = BLOCKS[dialect]
    head = f"{start}\n{'G777' if dialect is ISO else 'POTATO 5'}\n{feed}\n"
    for count in range(len(blocks) + 1):
        text = head + "".join(f"{block}\n" for block in blocks[:count]) + f"{start}\n{feed}\n"
        assert bool(read_moves(dialect, text).moves[-1].unknown) is (count < len(blocks))


@pytest.mark.parametrize(
    ("dialect", "block"),
    [
        *(
            (ISO, block)
            for block in ("G0 X0 Y0 Z0 B0 C0", "G28 X0 Y0 Z0 B0 C0", "G54", "G90", "TRAFOOF", "G49", "G69", "G500")
        ),
        *((ISO, block) for block in ("G53 X0 Y0 Z0 B0", "G91 G53 X0 Y0 Z0 B0 C0\nG90", "SUPA X=R9 Y0 Z0 B0 C0")),
        *((PLAIN, block) for block in ("L X+0 Y+0 Z+0 B+0 C+0 FMAX", "L X+0 Y+0 Z+0 B+0 C+0 M92", "PLANE RESET STAY")),
        (PLAIN, "L IX+0 Y+0 Z+0 B+0 C+0 M91"),
    ],
)
def test_what_does_not_make_anything_known(dialect: Dialect, block: str) -> None:
    start, feed, machine = BLOCKS[dialect]
    head = f"{start}\n{'G777' if dialect is ISO else 'POTATO 5'}\n{block}\n{start}\n{feed}\n"
    assert read_moves(dialect, head).moves[-1].unknown
    assert not read_moves(dialect, f"{head}{machine}\n{start}\n{feed}\n").moves[-1].unknown


PLANE_OF = {ISO: "G68.2 X0 Y0 Z0 I0 J30 K0\nG53.1", PLAIN: "PLANE SPATIAL SPA+0 SPB+35 SPC+0 TURN FMAX"}


@pytest.mark.parametrize(
    ("dialect", "frame", "machine", "known"),
    [
        (ISO, "G10 L2 P1 R30", "G53 G0 X0", "XZ"),
        (ISO, "G10 L2 P1 R30", "G28 X0", "XZ"),
        (ISO, "G10 L2 P1 R30", "G28.2 X0", "XZ"),
        (ISO, "G10 L2 P1 R30", "G53 G0 Z0", "XY"),
        (ISO, "G10 L2 P1 R0", "G53 G0 X0", "XYZ"),
        (ISO, "ROT Z30", "SUPA G0 X0", "XZ"),
        (ISO, "ROT Y30", "T1 M6\nG43 H1\nG0 Z9", "YZ"),
        (ISO, PLANE_OF[ISO], "T1 M6\nG43 H1", "XY"),
        (ISO, PLANE_OF[ISO], "G53 G0 Z0", "X"),
        (PLAIN, "CYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT+30", "L X+0 FMAX M91", "XZ"),
        (PLAIN, PLANE_OF[PLAIN], "L Z+0 FMAX M91", "X"),
    ],
)
def test_every_word_that_changes_with_a_machine_axis_is_unknown(
    dialect: Dialect, frame: str, machine: str, known: str
) -> None:
    """An axis of the machine, or a length along it, is several axes of coordinates that are turned or tilted."""
    word = "G0 X{} Y2 Z3\n{}\n{}\nG0 X5\n" if dialect is ISO else "L X+{} Y+2 Z+3 FMAX\n{}\n{}\nL X+5 FMAX\n"
    word = word.replace("X5", "B0") if "ROT Y" in frame else word
    start = "G54\nG0 B0 C0\n" if dialect is ISO else "L B+0 C+0 FMAX\n"
    at = word.replace("{}\n{}\n", f"{frame}\n{word.splitlines()[0].format(1)}\n{machine}\n").format(1)
    last = read_moves(dialect, start + at).moves[-1].position
    assert "".join(name for name, value in zip("XYZ", last[:3], strict=True) if value == value) == known


def test_arcs_and_incremental_words_pass_where_nothing_is_known() -> None:
    text = "G0 X1 Y2 Z3 B4 C5\nFOO\nG2 X5 Y5 I1\nG91 X1\nG90 G1 X2\n"
    assert [move.kind.value for move in read_moves(ISO, text).moves if move.unknown] == ["arc", "arc", "linear"]
    text = "L X+1 Y+2 Z+3 B+4 C+5 FMAX\nPOTATO\nCC IX+3 Y+0\nC X+5 Y+5 DR+\nL IX+1\n"
    assert [move.kind.value for move in read_moves(PLAIN, text).moves if move.unknown] == ["arc", "linear"]


def test_a_cycle_in_force_is_refused_where_nothing_is_known() -> None:
    text = "G0 X1 Y2 Z3 B4 C5\nG81 X2 Z-5 R1 F100\nFOO\n{}X3\n"
    with pytest.raises(InputError, match="a cycle in force where the effect of FOO"):
        read_moves(ISO, text.format(""))
    assert read_moves(ISO, text.format("G80\n")).moves[-1].unknown


def test_m94_is_known_below_one_turn_only() -> None:
    text = "L X+1 Y+2 Z+3 B+4 C{} FMAX\nL C+10 M94\nL X+6 F500\n"
    assert [bool(read_moves(PLAIN, text.format(angle)).moves[-1].unknown) for angle in (350, 370, -10)] == [
        False,
        True,
        True,
    ]


@pytest.mark.parametrize(
    ("statement", "known"),
    [("M51", False), ("AIRBLAST", False), ("AIRBLAST(3)", False), ("G777", False), ("M21", True)],
)
def test_the_machine_file_names_harmless_words(statement: str, known: bool) -> None:
    axes = replace(AXES, harmless=("M51", "AIRBLAST", "G777"))
    text = f"G21 G0 X1 Y2 Z3 B4 C5\n{statement}\nG1 X6\n"
    assert not ISO.moves(ISO.read(text.encode(), "t"), axes, tcp=False).notices or known
    assert bool(ISO.moves(ISO.read(text.encode(), "t"), axes, tcp=False).moves[-1].unknown) is known
    if "(" not in statement and statement[0] != "G":
        text = f"L X+1 Y+2 Z+3 B+4 C+5\n{statement}\nL X+6\n"
        assert bool(PLAIN.moves(PLAIN.read(text.encode(), "t"), axes, tcp=False).moves[-1].unknown) is known


APT_HEAD = "PARTNO A\nUNITS/MM\nGOTO/1,2,3,0,0,1\nGOTO/2,2,3\n"


@pytest.mark.parametrize(
    "statement", ["FOOBAR/3", "PREFUN/254", "INSERT G254", "TLAXIS/0,0,1", "AUXFUN/21", "AUXFUN/X", "FRAME"]
)
def test_nothing_is_known_after_an_unknown_statement_of_apt(statement: str) -> None:
    assert statement.split("/")[0] not in APT_PASSED
    reading = read_moves(APT, f"{APT_HEAD}{statement}\n" + "GOTO/3,2,3\n" * 20)
    assert [bool(move.unknown) for move in reading.moves] == [False] * 2 + [True] * 20
    for code in (8, 51):
        reading = read_moves(APT, f"{APT_HEAD}AUXFUN/{code}\nGOTO/3,2,3\n")
        assert not any(move.unknown for move in reading.moves)
        assert [notice.text[:21] for notice in reading.notices] == ["AUXFUN/51 is not know"] * (code == 51)


# --------------------------------------------------------------------------------------------- whole programs

SETUP = Setup(work_offset={"X": 250.0, "Y": 225.0, "Z": -300.0})
OPTIONS = Options(tool_length_mm=120.0, setup=SETUP)


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(46), size=20.0)


def compensated(
    folder: Path, text: str, machine: Machine, errors: Calibration, suffix: str = ".nc"
) -> tuple[str, Report]:
    """Return the output and its report, made in memory, and in stretches if it is an ISO program; both are the same."""
    source, out = folder / f"a{suffix}", folder / f"out{suffix}"
    source.write_text(text)
    compensator = Compensator(machine, errors, OPTIONS)
    result = compensator.compensate(*read_program(source))
    report = compensator.compensate_file(source, out)
    assert out.read_text(encoding="latin-1") == result.text
    assert report.not_corrected == result.report.not_corrected
    assert report.notes == result.report.notes and report.complete is result.report.complete
    return result.text, result.report


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize(
    ("statement", "suffix"), [("TRAOOF", ".nc"), ("G777", ".nc"), ("M428", ".nc"), ("POTATO 5", ".h")]
)
def test_blocks_between_are_left_as_written_and_counted(
    dmu50: Machine, errors: Calibration, tmp_path: Path, statement: str, suffix: str
) -> None:
    start, feed, machine = BLOCKS[ISO if suffix == ".nc" else PLAIN]
    start = start.replace("B4", "B30").replace("B+4", "B+30")
    machine = re.sub(
        r"([XYZ])\+?0",
        lambda m: f"{m[1]}{'+' if suffix == '.h' else ''}{dict(X=250, Y=225)[m[1]]}" if m[1] != "Z" else f"{m[1]}-1",
        machine,
    )
    plain_blocks = "".join(
        f"{'X' if suffix == '.nc' else 'L X+'}{7 + i}\n" for i in range(39)
    )  # read together elsewhere
    many = f"{feed}\n{plain_blocks}"
    tail = f"{machine}\n{start}\n{feed}\n"
    text, report = compensated(tmp_path, f"{start}\n{feed}\n{statement}\n{many}{tail}", dmu50, errors, suffix)
    assert many in text and not report.complete
    (lost,) = [one for one in report.not_corrected if one.kind == "unknown"]
    assert lost.lines == lost.missed == tuple(range(4, 44)) and statement in lost.reason
    assert report.cutting == 42 and "40 of 42 cutting blocks are left as written" in report.headline
    alone, whole = compensated(tmp_path, f"{start}\n{feed}\n{tail}", dmu50, errors, suffix)
    assert whole.complete
    assert text.split(f"{machine}\n")[1] == alone.split(f"{machine}\n")[1]


def test_a_rapid_and_a_statement_at_the_end_do_no_harm(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    text = "G0 X1 Y2 Z3 B30 C5\nG1 X6 F500\nPARK(1)\nG0 Z50\nM30\n"
    _, report = compensated(tmp_path, text, dmu50, errors)
    assert report.complete and not report.strictly_complete


def test_a_program_in_which_nothing_is_known_is_refused(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    source = tmp_path / "a.nc"
    source.write_text("M428\nG0 X1 Y2 Z3 B4 C5\nG1 X6 F500\n")
    compensator = Compensator(dmu50, errors, OPTIONS)
    for compensate in (
        lambda: compensator.compensate_file(source, tmp_path / "o.nc"),
        lambda: compensator.compensate(*read_program(source)),
    ):
        with pytest.raises(InputError, match="known position: the effect of M428 is not known") as caught:
            compensate()
        assert caught.value.line == 2


TABLE = {
    "dynamic work offset": (
        "G54\nG0 X0 Y0 Z100\nG254\nG0 X0 Y0 Z50\nG1 X10 F500\nG255\nM30\n",
        ".nc",
        3,
        "G254",
    ),
    "numbers with N": (
        "L X+100 Y+0 Z+50 B+0 C+0 FMAX\nN4 L X120 Y0 Z1 FMAX\nN6 APPR PCT PR45 PA0 R20 RL F220\n",
        ".h",
        3,
        "APPR",
    ),
    "two lengths": (
        "T1 M6\nG43 H1\nG0 X0 Y0 Z100 B30 C0\nG1 X1 F500\nT2 M6\nG43 H2\nG1 X10\n",
        ".nc",
        5,
        "second tool",
    ),
    "length without a tool": ("G43 H1\nG0 X0 Y0 Z100 B30 C0\nG43 H2\nG1 X10 F500\n", ".nc", 3, "second tool length"),
    "a modal length": ("G43 H1\nG0 X0 Y0 Z100 B30 C0\nH2\nG1 X10 F500\n", ".nc", 3, "second tool length"),
    "an edge": ('T="A" M6\nD1\nG0 X0 Y0 Z100 B30 C0\nD2\nG1 X10 F500\n', ".nc", 4, "second tool length"),
    "with and without": ("G43 H1\nG0 X0 Y0 Z100 B30 C0\nG1 X1 F500\nG49\nG1 X10\n", ".nc", 5, "with and without"),
    "TOOL CALL": ("TOOL CALL 1 Z\nL X+0 Y+0 Z+50 B+30 C+0 FMAX\nTOOL CALL 2 Z\nL X+10 F500\n", ".h", 3, "second tool"),
    "DL": (
        "TOOL CALL 1 Z DL+1\nL X+0 Y+0 Z+50 B+30 C+0 FMAX\nTOOL CALL 1 Z DL+2\nL X+10 F500\n",
        ".h",
        3,
        "second tool length",
    ),
    "two presets": (
        "CYCL DEF 247 Q339=+1\nL X+0 Y+0 Z+50 B+0 C+0 FMAX\nCYCL DEF 247 Q339=+2\nL X+10 F500\n",
        ".h",
        3,
        "second work",
    ),
    "LOADTL": (f"{APT_HEAD}LOADTL/1\nGOTO/3,2,3\nLOADTL/2\nGOTO/4,2,3\n", ".cls", 7, "second tool"),
    "restored modes": ("M70\nG0 X0 Y0 Z0 B0 C0\nG91 M72\nG1 X10 F500\n", ".nc", 3, "restored"),
    "axes to smooth": ("G0 X0 Y0 Z0 B0 C0\nG5.1 Q2 X0 Y0 Z0\nG1 X10 F500\n", ".nc", 2, "words of axes"),
    "mirrored axes": ("G0 X0 Y0 Z0 B0 C0\nG50.1 X0\nG1 X10 F500\n", ".nc", 2, "words of axes"),
}


@pytest.mark.parametrize("name", TABLE)
def test_refused_with_its_line(name: str) -> None:
    text, suffix, line, what = TABLE[name]
    dialect = dialect_for(Path(f"a{suffix}"), text.encode())
    for many in ("", "\n" * 30):  # blank lines between, where simple lines could be read together
        with pytest.raises(InputError, match=what) as caught:
            read_moves(dialect, text + many)
        assert caught.value.line == line


@pytest.mark.parametrize(
    "text",
    [
        "T1 M6\nG43 H1\nG0 X0 Y0 Z0 B0 C0\nG1 X1 F5\nT1 M6\nG43 H1\nG1 X10\nG49\nG0 Z5\nT2 M6\nT0 M6\nM30\n",
        "G49\nG43 H1 Z5\nG0 X0 Y0 Z0 B0 C0\nG1 X10 F5\nG53 G49 Z0\nG43 H01\nG1 X0 Y0 Z0\n",
        'T="A"\nM6\nD1\nG0 X0 Y0 Z0 B0 C0\nSUPA Z0 D0\nSUPA X0 Y0 B0 C0 D1\nG1 X1 Y1 Z1 F5\n',
    ],
)
def test_one_tool_is_enough(text: str) -> None:
    assert not any(move.unknown for move in read_moves(ISO, text).moves)


@pytest.mark.parametrize("change", ["G43 H1", "T1 M6", "G49", "D1", "TOOL CALL 1 Z"])
def test_the_position_along_the_tool_is_unknown_after_another_length(
    dmu50: Machine, errors: Calibration, tmp_path: Path, change: str
) -> None:
    """A rapid and a feed of other axes keep their words, the feed is listed, and an absolute word makes the position known."""
    plain = change.startswith("TOOL")
    form = (lambda word: f"L {word[0]}+{word[1:]} F500\n") if plain else (lambda word: f"G1 {word} F500\n")
    rapid, suffix = ("L X+20 FMAX\n", ".h") if plain else ("G0 X20\n", ".nc")
    head = BLOCKS[PLAIN if plain else ISO][0].replace("B4", "B30").replace("B+4", "B+30") + "\n"
    head += "G43 H1 Z3\n" if change == "G49" else ""
    text, report = compensated(tmp_path, f"{head}{change}\n{rapid}{form('Z5')}{form('X30')}", dmu50, errors, suffix)
    assert f"{change}\n{rapid}" in text and report.complete
    text, report = compensated(tmp_path, f"{head}{change}\n{form('X20')}", dmu50, errors, suffix)
    assert text.endswith(f"{change}\n{form('X20')}") and not report.complete
    (lost,) = [one for one in report.not_corrected if one.kind == "unknown"]
    assert lost.missed == (head.count("\n") + 2,) and "position of Z" in lost.reason


def test_tool_centre_point_control_of_haas(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    """G234 keeps the coordinates fixed to the table, as G43.4 does; G49 ends it."""
    text = "G54\nG0 X0 Y0 Z100 B10 C0\n{} H1\nG1 X10 B20 C10 F500\nG49\nG0 X20 Y0 Z50\n"
    found, report = compensated(tmp_path, text.format("G234"), dmu50, errors)
    assert report.complete
    assert found.replace("G234", "G43.4") == compensated(tmp_path, text.format("G43.4"), dmu50, errors)[0]


@pytest.mark.parametrize(
    ("word", "hinted"), [("X100500", True), ("X100500.", False), ("X600", False), ("Z-400500", True)]
)
def test_increments_are_hinted_at(dmu50: Machine, errors: Calibration, tmp_path: Path, word: str, hinted: bool) -> None:
    _, report = compensated(tmp_path, f"G0 X0 Y0 Z100 B10 C0\nG1 X5 F500\n{word}\n", dmu50, errors)
    text = "increments? (no decimal point, outside the axis's range)"
    assert [text in one.reason for one in report.not_corrected if one.kind == "range"] == [hinted]
    assert not report.complete


@pytest.mark.parametrize(
    ("block", "what", "suffix"),
    [
        ("G2 X100500 Y0 I10000 J0", "off its circle", ".nc"),
        ("G3 X5 Y600000 R300000", "the arc ends at Y 600225", ".nc"),
        ("G2 X100500. Y0 I10000 J0", "", ".nc"),
        ("G2 X100 Y0 I1000 J0", "", ".nc"),
        ("C X+100500 Y+0 DR+", "", ".h"),
    ],
)
def test_increments_are_hinted_at_where_a_motion_is_refused(
    dmu50: Machine, errors: Calibration, tmp_path: Path, block: str, what: str, suffix: str
) -> None:
    head = "G0 X0 Y0 Z100 B10 C0\nG1 X5 F500\n" if suffix == ".nc" else "L X+5 Y+0 Z+100 B+10 C+0 F500\nCC X+9 Y+0\n"
    source, compensator = tmp_path / f"a{suffix}", Compensator(dmu50, errors, OPTIONS)
    source.write_text(f"{head}{block}\n")
    every: list[Callable[[], object]] = [
        lambda: compensator.compensate_file(source, tmp_path / f"o{suffix}", into=dialect_for(source)),
        lambda: compensator.compensate(*read_program(source)),
    ]
    if "circle" in what:  # the others run it, beyond the range
        every.append(lambda: execute_file(source, dmu50, errors, setup=SETUP))
        every.append(lambda: Refitter(dmu50, errors, OPTIONS).refit(*read_program(source)))
    for run in every:
        with pytest.raises(InputError, match=what or None) as caught:
            run()
        assert ("; increments? (no decimal point, outside the axis's range)" in str(caught.value)) is bool(what)
        assert caught.value.line == 3
