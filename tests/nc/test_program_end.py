"""The end of a program in every language: what is behind it stays as it is, or is refused where a control may execute it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.nc.nc_support import AXES, read_moves
from twin._common.errors import InputError
from twin.nc import dialect_for
from twin.nc.blocks import Interpretation

ISO_HEAD = "G21 G90 G94 G54\nG0 X0 Y0 Z0 B0 C0\nG1 X5 F100\n"
PLAIN_HEAD = "BEGIN PGM A MM\nL X+0 Y+0 Z+0 B+0 C+0 FMAX\nL X+5 F100\n"
APT_HEAD = "UNITS/MM\nGOTO/0,0,0\nGOTO/5,0,0\n"
ROWS = 20
"""Enough lines to be processed together."""
BEHIND = {
    "iso": "".join(f"G1 X{i} Y1\n" for i in range(ROWS)),
    "heidenhain": "".join(f"L X+{i} Y+1\n" for i in range(ROWS)),
    "apt": "".join(f"GOTO/{i},1,0\n" for i in range(ROWS)),
}
HEADS = {"iso": ISO_HEAD, "heidenhain": PLAIN_HEAD, "apt": APT_HEAD}
ENDS = {
    "iso": ("M2", "M02", "M30", "N9 M030", "G4 P1 M30", "M17", "M99", "RET", "RET ; back", "%"),
    "heidenhain": ("M2", "M30", "L FMAX M30", "L M2", "END PGM A MM", "12 END PGM A MM"),
    "apt": ("FINI", "FINI $$ end"),
}
NO_ENDS = {
    "iso": ("M0", "M1", "M60", "M20", "M3 (M30)", "M6 ;M30", "G4 P30"),
    "heidenhain": ("M0", "L M3 ; M30", "STOP M1", "; END PGM A MM", "LBL 1"),
    "apt": ("STOP", "$$ FINI", "OPSTOP"),
}


def read(language: str, text: str) -> Interpretation:
    dialect = dialect_for(Path({"iso": "part.nc", "heidenhain": "part.h", "apt": "part.cls"}[language]))
    return dialect.moves(dialect.read(text.encode("latin-1"), "test"), AXES, tcp=language == "apt")


@pytest.mark.parametrize(("language", "end"), [(one, end) for one, ends in ENDS.items() for end in ends])
def test_nothing_behind_the_end_is_read(language: str, end: str) -> None:
    head, behind = HEADS[language], BEHIND[language]
    whole, found = read(language, head), read(language, f"{head}{end}\n{behind}")
    assert [move.position[:3] for move in found.moves] == [move.position[:3] for move in whole.moves]
    (said,) = [notice for notice in found.notices if "behind the end" in notice.text]
    assert said.line == 4 and "in line 4)" in said.text
    # One line after the other, and what no reader knows.
    alone = read(language, f"{head}{end}\n{behind.splitlines()[0]}\n\n?! QWERT/7\n")
    assert len(alone.moves) == len(whole.moves)


@pytest.mark.parametrize(("language", "word"), [(one, word) for one, words in NO_ENDS.items() for word in words])
def test_what_is_no_end(language: str, word: str) -> None:
    head = HEADS[language]
    found = read(language, f"{head}{word}\n{BEHIND[language]}")
    assert len(found.moves) == ROWS + len(read(language, head).moves)
    assert not any("behind the end" in notice.text for notice in found.notices)


def test_marks_and_comments_behind_the_end_are_nothing() -> None:
    for text in (f"%\nO1 (A)\n{ISO_HEAD}M30\n%\n", f"%\n%100\n{ISO_HEAD}M30\n(M30)\nN5\n;\n\n%\n", f"\n%\n{ISO_HEAD}%"):
        found = read("iso", text)
        assert len(found.moves) == 2 and not any("behind" in notice.text for notice in found.notices)
    found = read("heidenhain", f"{PLAIN_HEAD}L M30\n; text\nEND PGM A MM\n")
    assert not any("behind" in notice.text for notice in found.notices)


@pytest.mark.parametrize(
    ("language", "text", "line", "said"),
    [
        (
            "iso",
            f"{ISO_HEAD}M30\nO2000\nG1 X30\nM99\n",
            6,
            "another program behind the end of the program (M30 in line 4)",
        ),
        ("iso", f"{ISO_HEAD}M30\n%\n%\nO2\nG1 X30\n%\n", 8, "which begins with O2"),
        ("iso", f"%_N_A_MPF\n{ISO_HEAD}M17\n%_N_B_MPF\nG1 X30\n", 7, "which begins with %_N_B_MPF"),
        ("iso", f"{ISO_HEAD}RET\nPROC B\nG1 X30\n", 6, "which begins with PROC B"),
        ("iso", f"{ISO_HEAD}/M30\nG4 P1\nG1 X30\n", 6, "switch for block skip"),
        ("iso", f"{ISO_HEAD}M99 P10\nN10 G1 X30\n", 4, "jump at the end"),
        ("heidenhain", f"{PLAIN_HEAD}END PGM A MM\nBEGIN PGM B MM\nL X+7\n", 6, "which begins with BEGIN PGM B MM"),
    ],
)
def test_what_a_control_may_execute_is_refused(language: str, text: str, line: int, said: str) -> None:
    with pytest.raises(InputError) as raised:
        read(language, text)
    assert raised.value.line == line and said in str(raised.value)


@pytest.mark.parametrize(("language", "begin"), [("iso", "%\nO1\n"), ("heidenhain", "BEGIN PGM A MM\n")])
def test_a_listing_above_the_program_is_left_as_written(language: str, begin: str) -> None:
    """As NX saves it: between two lines of equals signs; without the second one there is no program."""
    dialect = dialect_for(Path("a"), None, language)
    rule, block = "=" * 60, "G1 X5 Y6\n" if language == "iso" else "L X+5 Y+6 F100\n"
    reading = read_moves(dialect, f"{rule}\nPart : D:\\a X7.prt\nG1 X9\nL X+9 F1\n{rule}\n{begin}{block}")
    assert [move.position[:2] for move in reading.moves] == [(5, 6)]
    assert reading.notices[0].text.startswith("the listing above the program")
    assert not read_moves(dialect, f"{rule}\nPart : 7\n{begin}{block}").moves
    with pytest.raises(InputError):
        read_moves(dialect, f"{begin}{block}{rule}\nPart : 7\n{rule}\n")


def test_comments_above_the_tape_mark_are_not_a_program() -> None:
    reading = read_moves(dialect_for(Path("a"), None, "iso"), "(TOOLS)\n%\n(T1)\nO1\nG1 X5 Y6\nM30\n%\n")
    assert len(reading.moves) == 1 and not [one for one in reading.notices if "behind" in one.text]
