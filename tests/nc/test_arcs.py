"""Circular blocks compared with a closed form: the middle of the arc, for every way of programming it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.nc.nc_support import read_moves
from twin._common.errors import InputError
from twin.compensation import Compensator, Options
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import dialect_for, read_program
from twin.nc.blocks import Kind

ISO = dialect_for(Path("a.nc"))
PLAIN = dialect_for(Path("a.h"))

PLANES = {17: ("X", "Y", "I", "J", (0, 1, 2)), 18: ("Z", "X", "K", "I", (2, 0, 1)), 19: ("Y", "Z", "J", "K", (1, 2, 0))}
angles = st.integers(-359, 359)


def place(move, fraction, start):
    """Return a point of an arc from its start, centre and sweep alone."""
    a, b = start[0] - move.arc.centre_mm[0], start[1] - move.arc.centre_mm[1]
    turn = fraction * move.arc.angle_rad
    c, s = math.cos(turn), math.sin(turn)
    return (move.arc.centre_mm[0] + c * a - s * b, move.arc.centre_mm[1] + s * a + c * b)


@given(
    st.sampled_from([17, 18, 19]), angles, st.integers(1, 359), st.booleans(), st.sampled_from([0, 1, 3]), st.booleans()
)
def test_centre_arcs(plane, first, sweep, clockwise, turns, absolute):
    u, v, i, j, indices = PLANES[plane]
    radius, centre = 40.0, (7.0, -3.0)
    signed = -sweep if clockwise else sweep
    ends = [
        (centre[0] + radius * math.cos(math.radians(t)), centre[1] + radius * math.sin(math.radians(t)))
        for t in (first, first + signed)
    ]
    offsets = (centre[0] - ends[0][0], centre[1] - ends[0][1])
    words = (
        f"{i}=AC({centre[0]:.6f}) {j}=AC({centre[1]:.6f})" if absolute else f"{i}{offsets[0]:.6f} {j}{offsets[1]:.6f}"
    )
    turn = f" TURN={turns}" if turns else ""
    text = (
        f"G{plane} G0 X0 Y0 Z0 B0 C0\n{u}{ends[0][0]:.6f} {v}{ends[0][1]:.6f}\n"
        f"G{2 if clockwise else 3} {u}{ends[1][0]:.6f} {v}{ends[1][1]:.6f} {words}{turn}\n"
    )
    move = read_moves(ISO, text).moves[-1]
    assert move.kind is Kind.ARC
    assert move.arc.plane == indices
    wanted = math.radians(signed) + math.copysign(2 * math.pi * turns, signed)
    assert move.arc.angle_rad == pytest.approx(wanted, abs=1e-6)
    middle = place(move, 1.0, ends[0])
    assert middle == pytest.approx(ends[1], abs=1e-4)


@given(angles, st.integers(1, 359), st.booleans())
def test_radius_arcs(first, sweep, clockwise):
    if abs(sweep - 180) < 3:
        sweep = 90  # near half a circle the radius does not determine the side
    radius, centre = 40.0, (7.0, -3.0)
    signed = -sweep if clockwise else sweep
    a, b = (
        (centre[0] + radius * math.cos(math.radians(t)), centre[1] + radius * math.sin(math.radians(t)))
        for t in (first, first + signed)
    )
    word = f"R{radius}" if sweep < 180 else f"R-{radius}"
    sense = f"G{2 if clockwise else 3}"
    move = read_moves(ISO, f"G0 X{a[0]:.9f} Y{a[1]:.9f} Z0 B0 C0\n{sense} X{b[0]:.9f} Y{b[1]:.9f} {word}\n").moves[-1]
    assert move.arc.angle_rad == pytest.approx(math.radians(signed), abs=1e-4)
    assert move.arc.centre_mm == pytest.approx(centre, abs=1e-3)
    siemens = word.replace("R", "CR=")
    again = read_moves(ISO, f"G0 X{a[0]:.9f} Y{a[1]:.9f} Z0 B0 C0\n{sense} X{b[0]:.9f} Y{b[1]:.9f} {siemens}\n").moves[
        -1
    ]
    assert again.arc == move.arc
    plain = (
        f"BEGIN PGM A MM\nL X{a[0]:+.9f} Y{a[1]:+.9f} Z+0 B+0 C+0 FMAX\n"
        f"CR X{b[0]:+.9f} Y{b[1]:+.9f} R{radius if sweep < 180 else -radius:+} DR{'-' if clockwise else '+'}\n"
    )
    assert read_moves(PLAIN, plain).moves[-1].arc == move.arc


@pytest.mark.parametrize(("sense", "angle"), [("G2", -2 * math.pi), ("G3", 2 * math.pi)])
def test_full_circles(sense, angle):
    text = f"G0 X10 Y0 Z0\n{sense} I-10 J0 Z-1\n{sense} X10 Y0 I-10\nG17 {sense} I-10. P3\n"
    moves = read_moves(ISO, text).moves
    assert moves[1].arc.angle_rad == pytest.approx(angle)
    assert moves[1].position[2] == -1.0  # a helix
    assert moves[2].arc.angle_rad == pytest.approx(angle)
    assert moves[2].arc.centre_mm == (0.0, 0.0)
    assert moves[3].arc.angle_rad == pytest.approx(3 * angle)  # P needs no axis word


@pytest.mark.parametrize(("sense", "angle"), [("G2", -2 * math.pi), ("G3", 2 * math.pi)])
def test_a_full_circle_from_a_place_reached_by_increments(sense, angle):
    """0.1 + 0.1 + 0.1 is not 0.3 in binary numbers: the circle is still a full one, not a point."""
    text = f"G0 X0 Y0 Z0\nG91 X0.1\nX0.1\nX0.1\nG90 {sense} X0.3 Y0 I0.05\n"
    assert read_moves(ISO, text).moves[-1].arc.angle_rad == pytest.approx(angle)


def test_plain_centre_arcs():
    text = "BEGIN PGM A MM\nL X+10 Y+0 Z+0\nCC X+0 Y+0\nC X+0 Y+10 DR-\nCC IX+0 IY-10\nC X+0 Y+10 DR+\n"
    first, second = read_moves(PLAIN, text).moves[1:]
    assert first.arc.angle_rad == pytest.approx(-1.5 * math.pi)
    assert second.arc.angle_rad == pytest.approx(2 * math.pi)
    assert second.arc.centre_mm == (0.0, 0.0)


def test_absolute_centres_and_inches():
    text = "G20 G90.1 G0 X1 Y0 Z0\nG3 X0 Y1 I0 J0\nG91.1 G3 X-1 Y0 I0 J-1\n"
    moves = read_moves(ISO, text).moves
    for move in moves[1:]:
        assert move.arc.centre_mm == pytest.approx((0.0, 0.0), abs=1e-12)
        assert move.arc.angle_rad == pytest.approx(math.pi / 2)


OTHER_WAYS = {
    "the way from the centre to the start": lambda start, centre: start - centre,
    "the place of the centre": lambda start, centre: centre,
}


@given(
    st.sampled_from(list(OTHER_WAYS)),
    st.lists(st.tuples(st.integers(5, 350), st.integers(10, 60), st.booleans()), min_size=1, max_size=6),
    angles,
)
def test_the_first_arc_shows_how_centres_are_written(way, arcs, heading):
    """Some postprocessors write I, J from the centre to the start, or the centre's place: the arcs are the same, and it is stated."""
    at, lines, misfits, wanted = complex(3.0, -7.0), {True: [], False: []}, [], []
    for sweep, radius, clockwise in arcs:
        centre = at + radius * complex(math.cos(math.radians(heading)), math.sin(math.radians(heading)))
        turn = math.radians(-sweep if clockwise else sweep)
        end = centre + (at - centre) * complex(math.cos(turn), math.sin(turn))
        word = [OTHER_WAYS[way](s, c) for s, c in ((at.real, centre.real), (at.imag, centre.imag))]
        sense = 2 if clockwise else 3
        lines[True].append(f"G{sense} X{end.real:.6f} Y{end.imag:.6f} I{word[0]:.6f} J{word[1]:.6f}\n")
        lines[False].append(
            f"G{sense} X{end.real:.6f} Y{end.imag:.6f} I{centre.real - at.real:.6f} J{centre.imag - at.imag:.6f}\n"
        )
        third = complex(*word) if "start" in way else at - complex(*word)
        misfits.append([abs(abs(c - end) - abs(c - at)) for c in (at + complex(*word), third)])
        wanted.append((centre.real, centre.imag, turn))
        at, heading = end, heading + 77
    assume(min(misfits[0]) > 0.6)  # beyond the tolerance of an arc
    start = "G0 X3 Y-7 Z0 B0 C0\n"
    other, plain = (read_moves(ISO, start + "".join(lines[kind])) for kind in (True, False))
    for reading in (other, plain):
        found = [value for move in reading.moves[1:] for value in (*move.arc.centre_mm, move.arc.angle_rad)]
        assert found == pytest.approx([value for arc in wanted for value in arc], abs=1e-4)
    assert [note.text for note in plain.notices if "I, J, K" in note.text] == []
    said = [note for note in other.notices if way in note.text]
    assert len(said) == 1 and said[0].line == 1  # counted from 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G91.1 G3 X0 Y10 I10 J0", "it would fit if I, J, K were the way from the centre to the start"),
        ("G3 X10 Y0 I-10 J0\nG3 X0 Y10 I10 J0", "it would fit if"),  # a full circle would meet its ends in any way
        ("G3 X0 Y10 I-10 J0\nG3 X-10 Y0 I0 J10", "it would fit if"),
        ("G3 X0 Y10 I10 J0\nG3 X-10 Y0 I0 J-10", "off its circle"),
        ("G3 X0 Y10 I=IC(10) J=IC(0)", "off its circle"),
    ],
)
def test_centres_that_are_not_all_written_alike_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        read_moves(ISO, f"G0 X10 Y0 Z0 B0 C0\n{text}\n")


def test_increments_of_zero_under_g2_move_nothing():
    """A reference return in G91 and axes one by one, where an arc was the last motion (a post of NX)."""
    head, tail = "G21 G90\nG0 X0 Y0 Z0 B0 C0\nG2 X4 Y4 I4 J0\n", "G90\nG1 X9 Y1\n"
    still, plain = (read_moves(ISO, head + text + tail).moves for text in ("G91\nX0. Y0.\nB0.\n", ""))
    assert [move.position for move in still] == [move.position for move in plain]
    for block in ("G91 X0 Y1", "G90 X0 Y0"):
        with pytest.raises(InputError, match="without centre or radius"):
            read_moves(ISO, f"{head}{block}\n")


FROM_UNKNOWN = {
    "iso": ("O1\nG21 G90 G1 F100\nG3 X260 Y235 I0 J10\nG1 Z-290\nX270\nM30\n", "G3 X260 Y235 I0 J10", 2),
    "heidenhain": (
        "BEGIN PGM A MM\nCC X+250 Y+235\nC X+260 Y+235 DR+\nL Z-290 F100\nL X+270\nEND PGM A MM\n",
        "C X+260 Y+235 DR+",
        2,
    ),
}


@pytest.mark.parametrize("language", FROM_UNKNOWN)
def test_an_arc_from_an_unknown_start_is_left_as_written(dmu50: Machine, tmp_path: Path, language: str) -> None:
    """Correct what follows its known end; refuse it behind corrected blocks, because its start has moved."""
    text, arc, line = FROM_UNKNOWN[language]
    path = tmp_path / "a"
    path.write_text(text)
    compensator = Compensator(dmu50, Calibration.default(dmu50), Options(language=language))
    result = compensator.compensate(*read_program(path, language))
    (left,) = result.report.not_corrected
    assert left.lines == (line + 1,) and "has not given a position of X, Y" in left.reason
    assert f"{arc}\n" in result.text and not result.report.complete
    assert result.nominal[-1][:3] == pytest.approx([270, 235, -290])
    assert "Y234.9" in result.text.replace("+", "") or "Y235.0" in result.text.replace("+", "")
    back = {"iso": "G91 G28 Z0\nG90 G2 X280 Y225 R10\n", "heidenhain": "M77\nL M140 MB MAX\nC X+280 Y+235 DR+\n"}[
        language
    ]
    end = "M30" if language == "iso" else "END"
    path.write_text(text.replace(end, back + end))
    with pytest.raises(InputError, match=r"arc where the program has not given a position of"):
        compensator.compensate(*read_program(path, language))
