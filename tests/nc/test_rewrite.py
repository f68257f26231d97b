"""Rewritten programs contain the intended positions, for their own reader and an independent one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.nc.nc_support import (
    AXES,
    NAMES,
    apt_program,
    distinct,
    iso_positions,
    iso_program,
    new_positions,
    plain_positions,
    plain_program,
    read_moves,
    rewritten,
)
from twin.nc import dialect_for
from twin.nc.blocks import Kind
from twin.nc.text import printed

ISO = dialect_for(Path("a.nc"))
PLAIN = dialect_for(Path("a.h"))
APT = dialect_for(Path("a.cls"))
HALF_INCH_STEP = 0.5e-5 * 25.4 * 1.001
"""An inch program has 5 decimals: positions come back to half of the last one."""


def same(move, start, end):
    return end[None, :]


def shifted(row):
    """Return a position with a position-dependent shift, as errors of a machine give, at the increment."""
    x, y, z, b, c = row
    moved = np.array(
        [
            x + 0.05 * np.sin(y / 17) + 0.01 * np.cos(z / 5),
            y + 0.04 * np.cos(x / 13),
            z + 0.03 * np.sin((x + y) / 11),
            b + 0.004 * np.sin(x / 9),
            c - 0.003 * np.cos(y / 7),
        ]
    )
    return np.array([printed(value, 0.001) for value in moved])


def shift(move, start, end):
    return shifted(end)[None, :]


def in_three(move, start, end):
    ends = [start + (end - start) * t for t in (1 / 3, 2 / 3)] if np.all(np.isfinite(start + end)) else []
    return np.array([shifted(row) for row in [*ends, end]])


def close(found, wanted, tolerance):
    """Compare sequences of positions, ignoring blocks without motion."""
    found, wanted = moving(found, tolerance), moving(wanted, tolerance)
    assert len(found) == len(wanted)
    np.testing.assert_allclose(np.array(found), np.array(wanted), rtol=0, atol=tolerance, equal_nan=True)


def moving(rows, tolerance):
    kept = []
    for row in rows:
        row = np.asarray(row, dtype=float)
        if not kept or not np.allclose(kept[-1], row, rtol=0, atol=max(3 * tolerance, 1e-6), equal_nan=True):
            kept.append(row)
    return kept


def tolerance_of(text):
    return HALF_INCH_STEP if "20" in text.upper().split("G17")[0] and "G20" in text.upper() else 1e-6


@pytest.mark.slow
@given(iso_program())
def test_own_positions_come_back_iso(text):
    out, intended = rewritten(ISO, text, same)
    found = [move.position for move in read_moves(ISO, out).moves]
    tolerance = max(tolerance_of(text), 0.0005 + 1e-9)  # words may have more decimals than the increment
    assert len(found) == len(intended)
    np.testing.assert_allclose(found, intended, rtol=0, atol=tolerance)


@pytest.mark.parametrize("rows", [shift, in_three])
@given(text=iso_program())
def test_every_axis_is_where_it_should_be_iso(rows, text):
    out, intended = rewritten(ISO, text, rows)
    tolerance = tolerance_of(text)
    close([move.position for move in read_moves(ISO, out).moves], intended, tolerance)
    close([position for _, position in iso_positions(out)], intended, tolerance)


@pytest.mark.parametrize("rows", [shift, in_three])
@given(text=plain_program())
def test_every_axis_is_where_it_should_be_plain(rows, text):
    def with_vectors(move, start, end):
        end = end.copy()
        min_decimals = np.isnan(end)
        segments = rows(move, start, np.nan_to_num(end))
        segments[:, min_decimals] = np.nan
        return segments

    def tools(move, count):
        return np.tile(np.array(move.vector), (count, 1))

    out, intended = rewritten(PLAIN, text, with_vectors, vectors=tools)
    tolerance = HALF_INCH_STEP if " IN" in text else 1e-6
    moves = read_moves(PLAIN, out).moves
    close([move.position for move in moves], intended, tolerance)
    modal = plain_positions(out)
    for row, move in zip(modal, moves, strict=True):
        known = np.isfinite(move.position)
        np.testing.assert_allclose(np.array(row)[known], np.array(move.position)[known], rtol=0, atol=1e-6)


@given(apt_program())
def test_every_location_is_where_it_should_be_apt(text):
    def rows(move, start, end):
        segments = np.array([end, end + 0.123456])
        return segments

    def tools(move, count):
        tilted = np.add(move.vector, (0.01, 0.0, 0.0))
        return np.array([move.vector, tilted / np.linalg.norm(tilted)])

    out, intended = rewritten(APT, text, rows, vectors=tools)
    moves = read_moves(APT, out).moves
    assert len(moves) == len(intended)
    for index, (move, row) in enumerate(zip(moves, intended, strict=True)):
        np.testing.assert_allclose(move.position[:3], row[:3], rtol=0, atol=0.5e-5 + 1e-12)
        original = read_moves(APT, text).moves[index // 2]
        np.testing.assert_allclose(move.vector, tools(original, 2)[index % 2], rtol=0, atol=1e-9)
        assert move.kind is original.kind


def test_the_classic_defect():
    """The original omits Y by modality; the output must have it."""
    text = "G21 G90\nG0 X0 Y0 Z0 B0 C0\nG1 X100. F500\nY50.\nX0\n"
    out, _ = rewritten(ISO, text, shift)
    lines = out.splitlines()
    assert "Y" in lines[2] and "Z" in lines[2] and "F500" in lines[2]
    assert "X" in lines[3]
    for (_, found), move in zip(iso_positions(out), read_moves(ISO, text).moves, strict=True):
        np.testing.assert_allclose(found, shifted(np.array(move.position)), rtol=0, atol=1e-9)


@pytest.mark.slow
@given(st.lists(st.tuples(*[st.integers(-500, 500)] * 3), min_size=200, max_size=400))
def test_incremental_programs_do_not_accumulate(steps):
    text = "G21 G90 G0 X0 Y0 Z0 B0 C0\nG91 G1 F100\n"
    text += "".join(f"X{x / 1000:.3f} Y{y / 1000:.3f} Z{z / 1000:.3f}\n" for x, y, z in steps)
    out, intended = rewritten(ISO, text, shift)
    found = iso_positions(out)[-1][1]
    np.testing.assert_allclose(found, intended[-1], rtol=0, atol=1e-7)


def test_incremental_plain_language_counts_from_what_was_said():
    text = "BEGIN PGM A MM\nL X+0 Y+0 Z+0 B+0 C+0 FMAX\n" + "L IX+0.0004\n" * 50 + "END PGM A MM\n"
    out, _ = rewritten(PLAIN, text, lambda m, s, e: np.array([[printed(v, 0.001) for v in e]]))
    assert plain_positions(out)[-1][0] == pytest.approx(0.02, abs=1e-9)


def test_untouched_incremental_block_counts_from_the_rewritten_one():
    program = ISO.read(b"G90 G0 X0 Y0 Z0 B0 C0\nG1 X10\nG91 X1\nG90 Y5\n", "t")
    reading = ISO.moves(program, AXES, tcp=False)
    new = {1: (np.array([[10.5, 0, 0, 0, 0]]), None), 3: (np.array([[11.5, 5, 0, 0, 0]]), None)}
    assert ISO.rewrite(program, AXES, reading, new_positions(reading, new)).splitlines()[1:] == [
        "G1 X10.5",
        "G91 X1",
        "G90 Y5",
    ]


def piece(text, *rows, dialect=ISO, tcp=False, vectors=None):
    """Return the lines that replace the last move of a program."""
    program = dialect.read(text.encode(), "t")
    reading = dialect.moves(program, AXES, tcp=tcp)
    tool = None if vectors is None else np.array(vectors)
    new = {len(reading.moves) - 1: (np.array(rows, dtype=float), tool)}
    lines = dialect.rewrite(program, AXES, reading, new_positions(reading, new)).splitlines()
    return lines[reading.moves[-1].line :]


START = "G21 G90 G17 G94\nG0 X0 Y0 Z0 B0 C0\n"


@pytest.mark.parametrize(
    ("block", "row", "expected"),
    [
        ("G1 X5. Y5.", (6, 7.25, 0, 0, 0), "G1 X6. Y7.25"),
        ("G1 X5 Y5", (6, 7.25, 0, 0, 0), "G1 X6 Y7.25"),
        ("G1 X5.000 Y5.120", (6, 7.25, 0, 0, 0), "G1 X6.000 Y7.250"),
        ("G1 X.5 Y-.5", (0.25, -0.75, 0, 0, 0), "G1 X.25 Y-.75"),
        ("G1 X0.5 Y-0.5", (0.25, -0.75, 0, 0, 0), "G1 X0.25 Y-0.75"),
        ("G1 X+5.0 Y+1.5", (6, 7, 0, 0, 0), "G1 X+6.0 Y+7.0"),
        ("G1X5.Y6.F100", (5, 6, 1.5, 0, 0), "G1X5.Y6.Z1.5F100"),
        ("g1 x5. f100", (5, 0.1, 0, 0, 0), "g1 x5. y0.1 f100"),
        ("G1 X=5.5 Y=-6", (5.25, -6.125, 0, 0, 0), "G1 X=5.25 Y=-6.125"),
        ("N30 X5. (X9)", (5.001, 0, 0, 0, 0), "N30 X5.001 (X9)"),
        ("G1 X- 5.", (-0.0001, 0, 0, 0, 0), "G1 X0."),
        ("G1 X=AC(5.) Y=IC(2.)", (5.1, 2.2, 0, 0, 0), "G1 X=AC(5.1) Y=IC(2.2)"),
        ("G1 C=DC(350.)", (0, 0, 0, 0, -10.5), "G1 C=DC(349.5)"),
        ("G91 G1 X5.", (5.5, 0.25, 0, 0, 0), "G91 G1 X5.5 Y0.25"),
        ("Z5.", (0, 0, 5.5, 0.01, 0), "Z5.5 B0.01"),
    ],
)
def test_words_in_their_own_style(block, row, expected):
    assert piece(START + block, row) == [expected]


def test_a_variable_gives_way_to_its_number():
    assert piece(START + "_H=5. R1=3\nG1 X=_H Y=R1", (5.5, 3.25, 0, 0, 0)) == ["G1 X=5.5 Y=3.25"]


def test_pieces_carry_only_what_changes():
    text = START + "N5 G1 X30. F100 S500 M3 (cut)\r\nM30"
    lines = piece(text, (10, 0.1, 0, 0, 0), (20, 0.1, 0, 0, 0), (30, 0, 0, 0, 0))
    assert lines == ["N5 G1 X10. Y0.1 F100 S500 M3 (cut)", "X20.", "X30. Y0.", "M30"]


@pytest.mark.parametrize("word", ["M5", "M0", "M30", "M01", "M9"])
def test_what_acts_at_the_end_goes_last(word):
    lines = piece(START + f"G1 X30. F100 {word}", (10, 0, 0, 0, 0), (30, 0, 0, 0, 0))
    assert lines == ["G1 X10. F100", f"X30. {word}"]


def test_inverse_time_is_shared_out():
    lines = piece(START + "G93\nG1 X30. F2.5", (10, 0, 0, 0, 0), (20, 0, 0, 0, 0), (30, 0, 0, 0, 0))
    assert lines == ["G1 X10. F7.5", "X20. F7.5", "X30. F7.5"]


def test_a_skipped_block_is_skipped_whole_and_trusted_for_nothing():
    text = START + "/G1 X10. Y10.\nX20.\n"
    program = ISO.read(text.encode(), "t")
    reading = ISO.moves(program, AXES, tcp=False)
    rows = [[(5, 5, 0, 0, 0), (10, 10, 0, 0, 0)], [(20, 10, 0, 0, 0)]]
    new = {i: (np.array(r, dtype=float), None) for i, r in enumerate(rows, 1)}
    lines = ISO.rewrite(program, AXES, reading, new_positions(reading, new)).splitlines()[2:]
    assert lines[:2] == ["/G1 X5. Y5.", "/X10. Y10."]
    assert lines[2].startswith("G1 X20.")
    assert all(name in lines[2] for name in NAMES)


def test_after_machine_coordinates_everything_named_is_said_again():
    text = START + "G53 G0 Z100\nG1 X5. Z2.\n"
    assert piece(text, (5, 0, 2, 0, 0)) == ["G1 X5. Z2."]
    text = START + "G28 X0 Y0 Z0\nG1 X5. Y1. Z2.\nSUPA X=500\nG1 Y6.\n"
    program = ISO.read(text.encode(), "t")
    reading = ISO.moves(program, AXES, tcp=False)
    assert np.isnan(reading.moves[-1].position[0])
    new = {len(reading.moves) - 1: (np.array([[5.0, 6.0, 2.0, 0.0, 0.0]]), None)}
    assert ISO.rewrite(program, AXES, reading, new_positions(reading, new)).splitlines()[-1] == "G1 Y6. X5."


def test_an_arc_becomes_straight_pieces():
    text = START + "G2 X10. Y0 I5. J0 F100\nX20. I5. J0\nG1 X0\nY3\n"
    program = ISO.read(text.encode(), "t")
    reading = ISO.moves(program, AXES, tcp=False)
    arc = reading.moves[1]
    assert arc.kind is Kind.ARC
    new = {1: (np.array([[5.0, 5.0, 0, 0, 0], [10.0, 0.0, 0, 0, 0]]), None)}
    lines = ISO.rewrite(program, AXES, reading, new_positions(reading, new)).splitlines()[2:]
    assert lines == ["G1 X5. Y5. F100", "X10. Y0.", "G2 X20. I5. J0", "G1 X0", "Y3"]


def test_a_full_circle_without_words():
    text = START + "G1 X10 Y0\nG03 I-10. J0\n"
    rows = [(10 * np.cos(a), 10 * np.sin(a), 0, 0, 0) for a in np.deg2rad([90, 180, 270, 360])]
    assert piece(text, *rows) == ["G01 X0 Y10", "X-10 Y0", "X0 Y-10", "X10 Y0"]


def test_arc_pieces_in_increments():
    text = START + "G91\nG2 X10 R5\n"
    assert piece(text, (5, 5, 0, 0, 0), (10, 0, 0, 0, 0)) == ["G1 X5 Y5", "X5 Y-5"]


def test_vectors_keep_their_words():
    text = START + "G43.4 H1\nG43.5 X0 Y0 Z0 I0 J0 K1\nG1 X5. I0 J0.6 K0.8\n"
    lines = piece(text, (5, 1, 2, np.nan, np.nan), vectors=[(0, 0.8, 0.6)], tcp=False)
    assert lines == ["G1 X5. Y1. Z2. I0 J0.8 K0.6"] or lines == ["G1 X5. I0 J0.8 K0.6 Y1. Z2."]
    text = START + "TRAORI\nG1 X0 Y0 Z0 A3=0 B3=0 C3=1\nG1 X5. A3=0.6 C3=0.8\n"
    assert piece(text, (5, 0, 0, np.nan, np.nan), vectors=[(0.6, 0.0, 0.8)]) == ["G1 X5. A3=0.6 C3=0.8"]


def test_inch_programs_are_converted_both_ways():
    text = "G20 G90\nG0 X1. Y1. Z1. B10. C0\n"
    move = read_moves(ISO, text).moves[0]
    assert move.position == (25.4, 25.4, 25.4, 10.0, 0.0)
    (line,) = piece(text, (25.4 * 1.00001, 25.4, 25.4, 10.001, 0))
    assert line == "G0 X1.00001 Y1. Z1. B10.001 C0"
    assert printed(25.4 * 1.000013, 0.001, inch=True) == pytest.approx(25.4 * 1.00001, abs=1e-12)


# -------------------------------------------------------------------- plain language

HEAD = "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+0 B+0 C+0 R0 FMAX\n"


def test_rapid_pieces_stay_rapid_and_blocks_are_renumbered():
    text = HEAD + "3 L X+30 R0 FMAX M5\n4 END PGM A MM\n"
    lines = piece(text, (10, 0.5, 0, 0, 0), (30, 0.25, 0, 0, 0), dialect=PLAIN)
    assert lines == ["3 L X+10 Y+0.5 R0 FMAX", "4 L X+30 Y+0.25 FMAX M5", "5 END PGM A MM"]


def test_plain_arcs_become_lines():
    text = HEAD + "3 CC X+5 Y+0\n4 C X+10 Y+0 DR- R0 F100\n"
    lines = piece(text, (5, 5, 0, 0, 0), (10, 0, 0, 0, 0), dialect=PLAIN)
    assert lines == ["4 L X+5 Y+5 R0 F100", "5 L X+10 Y+0"]
    text = HEAD + "3 CR X+10 Y+0 R+5 DR-\n"
    assert piece(text, (5, 5, 0, 0, 0), (10, 0, 0, 0, 0), dialect=PLAIN) == ["3 L X+5 Y+5", "4 L X+10 Y+0"]


def test_plain_vectors_and_normals():
    text = HEAD + "3 M128\n4 LN X+1,5 Y+2 Z+3 NX+0 NY+0 NZ+1 TX+0 TY+0,6 TZ+0,8 F100\n"
    lines = piece(
        text,
        (1, 2, 3, np.nan, np.nan),
        (1.25, 2, 3, np.nan, np.nan),
        dialect=PLAIN,
        vectors=[(0, 0.6, 0.8), (0, 0.8, 0.6)],
    )
    assert lines == [
        "4 LN X+1 Y+2 Z+3 NX+0 NY+0 NZ+1 TX+0 TY+0,6 TZ+0,8 F100",
        "5 LN X+1,25 NX+0 NY+0 NZ+1 TX+0 TY+0,8 TZ+0,6",
    ]


def test_a_vector_added_to_a_straight_block_makes_it_ln():
    text = HEAD + "3 M128\n4 LN X+1 Y+2 Z+3 TX+0 TY+0.6 TZ+0.8\n5 L X+5 FMAX\n"
    lines = piece(text, (5, 2, 3, np.nan, np.nan), dialect=PLAIN, vectors=[(0, 0.8, 0.6)])
    assert lines == ["5 LN X+5 Y+2 Z+3 TX+0 TY+0.8 TZ+0.6 FMAX"] or lines == ["5 LN X+5 TX+0 TY+0.8 TZ+0.6 FMAX"]


@pytest.mark.parametrize(("target", "word"), [(29.999, "DC(29.999)"), (30.001, "DC(30.001)"), (270, "ACP(270.)")])
def test_no_turn_more_than_was_meant(target, word):
    assert piece(START + "C30.\nC=ACP(30.)\n", (0, 0, 0, 0, target))[0] == f"C={word}"


def test_distinct_is_not_vacuous():
    assert len(distinct([np.zeros(5), np.zeros(5), np.ones(5)])) == 2


@pytest.mark.parametrize("value", [0.0, 0.0004, -0.0004, 1.0005, -1.2345, 123.4565, 25.4 / 3])
@pytest.mark.parametrize("increment", [0.001, 0.0001, 0.005, 0.01, 0.00025])
def test_printed_is_a_multiple_of_the_increment(value, increment):
    got = printed(value, increment)
    assert abs(got - value) <= increment / 2 + 1e-12
    assert got / increment == pytest.approx(round(got / increment), abs=1e-6)
    assert str(got) != "-0.0"
