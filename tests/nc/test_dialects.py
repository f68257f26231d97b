"""Requirements on every NC language."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.nc.nc_support import AXES, new_positions
from twin._common.errors import InputError
from twin._common.families import ProgramLanguage
from twin.nc import DIALECTS, dialect_for, dialect_to_write
from twin.nc.blocks import Kind, Program
from twin.nc.dialect import Dialect

EVERY = pytest.mark.parametrize("dialect", DIALECTS, ids=lambda one: one.name)
POINTS = np.array([[1.0, 2.0, 3.0], [1.5, -2.25, 3.0], [0.0, 0.0, -0.125]])


def points_text(dialect: Dialect) -> str:
    return dialect.from_points(AXES.linear, POINTS, 500.0, "points of a table", "part-1")


def positions(dialect: Dialect, text: str) -> np.ndarray:
    program = dialect.read(text.encode("latin-1"), "test")
    return np.array([move.position[:3] for move in dialect.moves(program, AXES, tcp=True).moves])


def test_names_are_different_and_suffixes_written_alike() -> None:
    assert len({one.name for one in DIALECTS}) == len(DIALECTS)
    assert {one.name for one in DIALECTS} == {one.value for one in ProgramLanguage}
    for suffix in (suffix for one in DIALECTS for suffix in one.suffixes):
        assert suffix.startswith(".") and suffix == suffix.lower()


@EVERY
def test_found_by_suffix_or_by_content(dialect: Dialect) -> None:
    own = [suffix for suffix in dialect.suffixes if sum(suffix in one.suffixes for one in DIALECTS) == 1]
    assert own
    for suffix in own:
        assert dialect_for(Path(f"A{suffix.upper()}")) is dialect
    assert dialect_for(Path("a"), points_text(dialect).encode()) is dialect


CONTENT = {
    "iso": [
        b"%\nO1234(PART)\nX1 Y2\n",
        b"N10 G21 G90\n",
        b"/N10 T1 M6 G54\n",
        b"(TOOL CALL 5 BEGIN PGM GOTO/1,2,3)\nX10 G0\n",
        b"; BEGIN PGM\nN10 TRAORI\nN20 CYCLE832(0.01,1,1)\n",
        b'MSG("GOTO/1,2,3")\nR1=5\n',
        b"DEF REAL _X_HOME\n",
        b"$PART.MIN%\nO100\n",
        b"\xef\xbb\xbfG0 X1\r\n",
        b"#100=5\n",
    ],
    "heidenhain": [
        b"0 BEGIN PGM PART MM\r\n1 X+10\r\n",
        b"; G0 X1\nTOOL CALL 5 Z S1000\n",
        b"N10 L X+1 Y+2 R0 FMAX\n",
        b"12 CC X+0 Y+0 ; G2\n",
        b"CYCL DEF 7.0 DATUM SHIFT\n",
    ],
    "apt": [
        b"PARTNO G1 X1\nGOTO/1,2,3\n",
        b"$$ G0 X1\nRAPID\nGOTO / 1,2,3\n",
        b"PPRINT/G0 X1\nFEDRAT/100,MMPM\n",
    ],
}
"""Beginnings of programs, with words of the other languages in comments."""


@pytest.mark.parametrize("suffix", ["", ".ptp", ".PTP", ".cnc", ".min", ".txt", ".nc", ".h", ".apt", ".unheard-of"])
@pytest.mark.parametrize("name", CONTENT)
def test_the_content_decides_whatever_the_suffix(name: str, suffix: str) -> None:
    for text in CONTENT[name]:
        assert dialect_for(Path(f"a{suffix}"), text).name == name, text


def test_what_fits_several_languages_needs_a_suffix_or_is_refused() -> None:
    """One axis word in a block moves an axis in ISO and in plain language, in modes that differ (G91, inches, radius compensation)."""
    alone, mixed = b"X+10\nM30\n", b"G1 X5\nL X+5 FMAX\n"
    for suffix in ("", ".txt", ".unheard-of"):
        with pytest.raises(InputError, match="unknown NC program type") as caught:
            dialect_for(Path(f"a{suffix}"), alone)
        assert caught.value.setting == "language" and "iso or heidenhain or apt" in str(caught.value)
        with pytest.raises(InputError, match="blocks of several languages") as caught:
            dialect_for(Path(f"a{suffix}"), mixed)
        assert caught.value.setting == "language" and "iso or heidenhain)" in str(caught.value)
        for text in (alone, mixed):
            for dialect in DIALECTS:
                assert dialect_for(Path(f"a{suffix}"), text, dialect.name) is dialect
    for text in (alone, mixed):
        assert dialect_for(Path("a.nc"), text).name == "iso"
        assert dialect_for(Path("a.h"), text).name == "heidenhain"
    with pytest.raises(InputError, match="blocks of several languages"):
        dialect_for(Path("a.cls"), mixed)


def test_begin_pgm_decides_over_a_stray_g_word() -> None:
    text = b"0 BEGIN PGM 100 MM\n10 L X0 FMAX\n20 G91 G28 Z0.0\n"
    assert dialect_for(Path("a.ptp"), text).name == dialect_for(Path("a.nc"), text).name == "heidenhain"


def test_a_language_given_decides_over_content_and_suffix() -> None:
    for dialect in DIALECTS:
        for text in (text for texts in CONTENT.values() for text in texts):
            assert dialect_for(Path("a.nc"), text, dialect.name) is dialect
    with pytest.raises(InputError, match="unknown language") as caught:
        dialect_for(Path("a.nc"), None, "fanuc")
    assert caught.value.setting == "language"


def test_an_output_keeps_the_language_unless_its_suffix_is_of_one_other() -> None:
    iso, heidenhain, apt = DIALECTS
    for source, output in (("a.nc", "b.nc"), ("a.min", "b.min"), ("a.h", "b.txt"), ("a", "b"), ("a", "b.h")):
        assert dialect_to_write(Path(output), Path(source), heidenhain) is heidenhain
    assert dialect_to_write(Path("b.nc"), Path("a.cls"), apt) is iso
    assert dialect_to_write(Path("b.h"), Path("a.cls"), apt) is heidenhain
    assert dialect_to_write(Path("b.txt"), Path("a.cls"), apt) is apt
    for other in ("b.png", "b"):
        with pytest.raises(InputError, match="unknown NC program type"):
            dialect_to_write(Path(other), Path("a.min"), iso)


@EVERY
def test_points_come_back_with_their_feed(dialect: Dialect) -> None:
    text = points_text(dialect)
    np.testing.assert_allclose(positions(dialect, text), POINTS, atol=1e-9)
    lines = dialect.read(text.encode(), "test").texts
    program = dialect.read(text.encode(), "test")
    moving = {move.line for move in dialect.moves(program, AXES, tcp=True).moves}
    first = min(moving)
    assert all(dialect.is_motion_only(lines[line], AXES.names) for line in moving - {first})
    assert any(dialect.is_comment(line) and "points of a table" in line for line in lines)
    assert not any(dialect.is_comment(lines[line]) for line in moving)
    assert "500" in text and dialect.technology(program).feed[first] == 500.0


@EVERY
def test_a_move_is_rewritten_and_every_other_byte_kept(dialect: Dialect) -> None:
    text = points_text(dialect)
    program = dialect.read(text.encode(), "test")
    reading = dialect.moves(program, AXES, tcp=True)
    assert dialect.rewrite(program, AXES, reading, new_positions(reading, {})) == text
    move = reading.moves[1]
    row = np.array([[1.75, -2.5, 3.5, np.nan, np.nan]])
    written = dialect.rewrite(program, AXES, reading, new_positions(reading, {1: (row, None)}))
    assert written != text
    np.testing.assert_allclose(positions(dialect, written)[1], row[0, :3])
    changed = [a != b for a, b in zip(program.texts, dialect.read(written.encode(), "test").texts, strict=True)]
    assert changed[move.line] and not any(changed[: move.line])


@EVERY
def test_comments_stand_once_and_change_no_move(dialect: Dialect) -> None:
    text = points_text(dialect)
    once = dialect.with_comments(text, ["made by a test"])
    assert "made by a test" in once.lower()
    assert dialect.with_comments(once, ["made by a test"]) == once
    np.testing.assert_array_equal(positions(dialect, once), positions(dialect, text))
    assert dialect.with_comments(text, []) == text


@EVERY
def test_a_new_program_or_cutter_locations(dialect: Dialect) -> None:
    """A language either has axis words, or its cutter locations can be posted to another language."""
    if dialect.cutter_locations:
        assert all(dialect.can_post_to(other) for other in DIALECTS)
        with pytest.raises(ValueError, match="no axis words"):
            dialect.new_program(AXES)
        return
    assert [other for other in DIALECTS if dialect.can_post_to(other)] == [dialect]
    writer = dialect.new_program(AXES)
    writer.start("part.cls")
    writer.comment("a remark ~()")
    writer.move([0.0, 0.0, 10.0, 0.0, 90.0], rapid=True)
    writer.feed = 250.0
    writer.move([1.0, 0.0, 10.0, 0.0, 90.0], rapid=False)
    writer.finish()
    text = "".join(writer.out)
    program = dialect.read(text.encode(), "test")
    reading = dialect.moves(program, AXES, tcp=False)
    moves = reading.moves
    assert [move.kind for move in moves] == [Kind.RAPID, Kind.LINEAR]
    np.testing.assert_allclose([move.position for move in moves], [[0, 0, 10, 0, 90], [1, 0, 10, 0, 90]])
    assert dialect.renumbered(program, text) == text
    with pytest.raises(ValueError, match="cannot be written"):
        dialect.poster("a", AXES, dialect)


@EVERY
def test_lines_taken_out_leave_the_others_their_numbers(dialect: Dialect) -> None:
    """A program may contain empty texts in place of deleted lines (`twin path`); they stay empty, and count as lines."""
    program = dialect.read(points_text(dialect).encode(), "test")
    gone = dialect.moves(program, AXES, tcp=True).moves[1].line
    texts = tuple("" if index == gone else text for index, text in enumerate(program.texts))
    left = Program(program.source, program.dialect, texts)
    before, after = (dialect.moves(one, AXES, tcp=True) for one in (program, left))
    assert [move.line for move in after.moves] == [move.line for move in before.moves if move.line != gone]
    row = np.array([[0.0, 0.0, -0.25, np.nan, np.nan]])
    text = dialect.rewrite(left, AXES, after, new_positions(after, {len(after.moves) - 1: (row, None)}))
    assert text.count("\n") == len(texts) - 1
    np.testing.assert_allclose(positions(dialect, text), [POINTS[0], row[0, :3]], atol=1e-9)
