"""Errors with line and value, blocks that pass, and notices."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.nc.nc_support import AXES, new_positions, read_moves
from twin._common.errors import InputError
from twin.nc import dialect_for

ISO = dialect_for(Path("a.nc"))
PLAIN = dialect_for(Path("a.h"))
APT = dialect_for(Path("a.cls"))

ISO_START = "G21 G90 G17 G94\nG0 X0 Y0 Z0 B0 C0\n"
PLAIN_START = "BEGIN PGM A MM\nL X+0 Y+0 Z+0 B+0 C+0 FMAX\n"
APT_START = "UNITS/MM\nGOTO/0,0,0,0,0,1\n"


def refused(dialect, start, block, what, tcp=False):
    with pytest.raises(InputError) as caught:
        read_moves(dialect, start + block + "\n", tcp=tcp)
    error = caught.value
    assert error.line == start.count("\n") + 1 + block.count("\n")
    assert error.file == "test"
    assert what.lower() in str(error).lower()
    assert error.value
    assert error.expected
    assert f"test:{error.line}: " in str(error)


@pytest.mark.parametrize(
    ("block", "what"),
    [
        ("G1 X", "'X'"),
        ("G28 B0\nG0 X5 B=IC(R1)", "value of B"),
        ("(A (B) X5)", "comment within a comment"),
        ("G1 X1 (A (B (C) Y#1) D)", "comment within a comment"),
        ("(A (B)", "without closing parenthesis"),
        ("$A.MIN%\nG55 H1", "of Okuma"),
        ("$A.MIN%\nG81 X1 Z-5 R1 F100", "of Okuma"),
        ("$A=5%", "unexpected character"),
        ("G74 A1=0", "canned cycle G74"),
        ("G1 @5 X3", "polar words beside X, Y"),
        ("G1 @5 @3", "polar words beside X, Y"),
        ("G53 G0 @5 ^3", "without G53"),
        ("G1 @5", "from the zero of the coordinates"),
        ("G91 G1 @5 ^3", "from the zero of the coordinates"),
        ("G28 X0\nG1 @5", "from an unknown position"),
        ("G1 @ X3", "unexpected character"),
        ("G33.1 X1 Z-5 K1", "with Z and K alone"),
        ("G33.1 Z-5", "with Z and K alone"),
        ("G33.1 Z-5 K1\nZ3", "where G33.1 is in force"),
        ("M72", "M70 before it"),
        ("M70\nG91\nM72 X5", "in a block of its own"),
        ("M70\nG43 H1\nM72", "restores a work offset, a tool length"),
        ("M73", "restored at a return"),
        ("G43.1 H1", "G43.1 with Z alone"),
        ("G1 G43.1 Z5", "G43.1 with Z alone"),
        ("G2 X5 Y5 I5 J0 K1", "K outside the plane"),
        ("G28 X0\nG92 X5", "which is unknown"),
        ("G74 X1=0 Y5", "canned cycle G74"),
        ("G74 X1", "canned cycle G74"),
        ("TRAORI\nG74 X1=0", "under tool centre point control"),
        ("ORIWKS\nTRAORI\nORIMKS\nG1 X1 Y1 Z1 A3=0 B3=0.6 C3=0.8", "coordinates of the machine (ORIMKS)"),
        ("G15 H1\nG56 H1 X5 Y5 Z5\nG81 X1 Z-5 R1 F100", "of Okuma"),
        ("G0 X1 Y1 Z1\nG169 HA=1\nG1 X1 Y1 Z1\nG170\nG1 X5", "behind G170 is not stated"),
        ("G1 X1=5", "unknown axis"),
        ("G75 G1 X1=0", "unknown axis"),
        ("TRAORI\nG1 X1 A5=0 B5=0 C5=1", "surface normal A5"),
        ("TRAORI\nG1 X1 A3=0 B3=0 C3=1 A6=1", "tool orientation by A6"),
        ("G1 X Y5", "X has no number"),
        ("G1 Xabc", "'Xabc'"),
        ("G1 XNAN", "'XNAN'"),
        ("G1 X1.2.3", "X1.2.3"),
        ("G1 X.", "X has no number"),
        ("G1 X--5", "X has no number"),
        ("G1 X1e999", "exponent"),
        ("G83 Z-150 R-105 Q1e-9 F100", "exponent"),
        ("G83 X1 Z-150 R-105 Q1 E-9", "unknown word"),
        ("G83 Z-150 R-105 Q1 E-9", "unknown word"),
        ("G83 X1 Z-150 R-105 Q0.1", "more than 400 steps"),
        ("G73 X1 Z-150 R-105 Q0.1", "more than 400 steps"),
        ("G99 G82 X1 Z-15 R-10 P1\nG83", "no place"),
        ("S1e3", "exponent"),
        ("G4 P1.e-3", "exponent"),
        ("G1 X1 F1E3", "exponent"),
        ("#1=1e3", "exponent"),
        ("R1=1EX3", "exponent"),
        ("MCALL CYCLE81(10,0,1,-1e1)", "known values"),
        ("MCALL CYCLE81(1_0,0,1,-10)", "known values"),
        ("G68.2 X0 Y0 Z0 I0 J10 K0 R5", "tilted plane"),
        ("G68.2 I0 J10 K0\nG53.1 X5", "tilted plane"),
        ("G2 X0 Y0 I10 J0 P999999", "whole number up to 400"),
        ("G2 X0 Y0 I10 J0 TURN=401", "whole number up to 400"),
        ("G1 X" + "9" * 400, "X has no number"),
        ("G1 X5 F", "F has no number"),
        ("G1 A5", "unknown axis: 'A5'"),
        ("G1 X5 U1.", "unknown axis"),
        ("G1 X=5 V=3", "unknown axis"),
        ("G1 X5 X6", "twice"),
        ("G0 G1 X5", "modal group"),
        ("G90 G91 X5", "modal group"),
        ("G2 X5 Y0", "centre or radius"),
        ("G2 X10 Y0 I4 J0", "off its circle"),
        ("G91.1 G1 X7 Y3\nG2 X2 Y8 I5 J0", "it would fit if I, J, K were the way from the centre to the start"),
        ("G91.1 G1 X7 Y3\nG3 X2 Y8 I2 J3", "it would fit if I, J, K were the place of the centre"),
        ("G2 X10 Y0 R2", "too small"),
        ("G2 X0 Y0 R5", "ends where it starts"),
        ("G2 X10 I5 K1", "outside the plane"),
        ("G1 X5 I2", "outside a circular block"),
        ("CIP X5 Y5 I1=2 J1=3 K1=1", "circle in space"),
        ("CIP X5 Y5 I1=2.5 J1=2.5", "on a line"),
        ("POLY PO[X]=(5,1)", "curve"),
        ("G01 Z-5 F1000 *", "in plain language"),
        ("INVCW X5 Y5 I1 J1 CR=9", "curve"),
        ("G1 X5 AP=30 RP=5", "other words of the plane"),
        ("G1 AP=30", "without the other one"),
        ("G1 X5 ANG=90", "not across it"),
        ("G1 X5 AR=30", "in this block"),
        ("G2 X5 AR=400", "by its angle"),
        ("G2 X5 Y5 I5 J0 AR=90", "determine it twice"),
        ("G111 X5 Z5", "other words"),
        ("G21 G111 X5 Y5", "other words"),
        ("G2.2 X5", "curve"),
        ("G5 X1 Y1 I1 J1 P0 Q0", "curve"),
        ("G33 Z-5 K1", "thread"),
        ("G76 P1", "cycle"),
        ("G68 X0 Y0 R30", "transformation"),
        ("G51 X0 Y0 P2", "transformation"),
        ("G51.1 X0", "transformation"),
        ("G52 X5 P1", "with other words"),
        ("G92 A0", "with other words"),
        ("G10 L50 P1 X5", "transformation"),
        ("ROTS Z30", "transformation"),
        ("AROTS Z30", "transformation"),
        ("CTRANS X5", "transformation"),
        ("MIRROR X0", "transformation"),
        ("SCALE X2", "transformation"),
        ("G41.1 X5 D1", "radius compensation"),
        ("G42 D1\nG1 X5 B9", "radius compensation"),
        ("G81 X5 Y5 Z-5 R2", "canned cycle G81"),
        ("G83 X5 Z-5 R2 Q1", "canned cycle"),
        ("G73 X5 Z-5 R2 Q1", "canned cycle"),
        ("MCALL CYCLE83(10.,0.,3.,-6.)", "canned cycle"),
        ("CYCLE72(10.,0.,3.,-6.)", "canned cycle"),
        ("HOLES1(0,0,0,10,10,5)", "canned cycle"),
        ("IF R1>5 GOTOF END", "control flow"),
        ("WHILE TRUE", "control flow"),
        ("GOTOB START", "control flow"),
        ("REPEAT LBL P=3", "control flow"),
        ("O100 call", "control flow"),
        ("o<sub> call", "no subprogram O<sub>"),
        ("M98 P1000", "no subprogram O1000"),
        ("M98 P1000 X5", "in a block of its own"),
        ("G65 A1", "with the number of a program"),
        ('CALL "DRESS"', "no subprogram DRESS"),
        ("M198 P1000", "subprogram"),
        ("G65 P9000 A1", "no subprogram O9000"),
        ("L100", "subprogram"),
        ("X=R1", "the value of X"),
        ("X=_NOWHERE", "the value of X"),
        ("X#101", "the value of X"),
        ("X[#9+2]", "the value of X"),
        ("X=5+R1", "the value of X"),
        ("G1 X5 ,R2", "unexpected character"),
        ("G1 X5 RND=2 OEMIPO1", "rounding"),
        ("G1 X5 FOO", "unknown word"),
        ("G1 X5 (open", "parenthesis"),
        ("G1 X5 G777", "unknown G word"),
        ("TRAORI\nG1 X1 Y1 Z1 A3=0 B3=0 C3=0", "zero length"),
        ("G43.5 H1\nX0 Y0 Z0 I0 J0 K0", "zero length"),
        ("G1 X1 A3=1 B3=0 C3=0", "point control is off"),
        ("TRAORI\nG1 X1 A2=30 B2=0 C2=0", "orientation by A2"),
        ("TRAORI\nG1 X1 B10 A3=1", "one of them"),
        ("$P_UIFR[1]=CTRANS(X,5)", "transformation"),
        ("POS[X]=5", "curve"),
        ("\xe9", "unexpected character"),
    ],
)
def test_iso(block, what):
    refused(ISO, ISO_START, block, what)


def test_a_second_work_offset_is_refused_where_it_is_chosen():
    with pytest.raises(InputError, match="second work offset") as caught:
        read_moves(ISO, "G54\nG0 X0 Y0 Z0\n( )\nG55\nG1 X1\n")
    assert caught.value.line == 4
    assert read_moves(ISO, "G55\nG54\nG0 X0\nG500\nSUPA X5\n").moves[-1].machine
    with pytest.raises(InputError, match=r"G54\.1 P2"):
        read_moves(ISO, "G54.1 P1\nG0 X0\nG54.1 P2\nG1 X1\n")


@pytest.mark.parametrize(
    "block",
    [
        *(
            "G69",
            "G50",
            "G40",
            "G80",
            "CYCLE800()",
            "CYCLE832(0.02,1,1)",
            'MSG("X5 (Y6")',
            "DEF REAL _A, _B=5",
            "G64 P0.01",
        ),
        *(
            "G61",
            "G90 G90",
            "G1 G01 G54 G54 G0017 G17",
            "G60 G601 FNORM",
            "COMPOF",
            "G4 X5",
            "G4 F2",
            "G54",
            "S1000 M3",
            "TRANS",
            "ROT",
        ),
        *(
            "M8 (X5 Y5)",
            ";X5",
            "/M1",
            "LABEL1:",
            "R1=5 R2=R1",
            "#100=5",
            "#<a>=[1+2]",
            "SPOS=90",
            "O1234",
        ),
        *("G05.1 Q1", "G5 P10000", "SOFT FFWON", "G25 X0 Y0", "MCALL", "STOPRE", 'T="A"', "_X_HOME=-365. _Y_HOME=224."),
    ],
)
def test_iso_passes(block):
    reading = read_moves(ISO, f"{ISO_START}{block}\nG91 X1 Y1 Z1 B1 C1\n")
    assert [move.position for move in reading.moves] == [(0.0,) * 5, (1.0,) * 5]
    assert reading.notices == ()


@pytest.mark.parametrize("block", ["G28 Z0", "G30 P2 Z0", "G38.2 Z-5", "TOOLCHANGE_MACRO", "SPECIAL(1,2)", "G777"])
def test_iso_notes_what_it_cannot_follow(block):
    reading = read_moves(ISO, f"{ISO_START}{block}\nG1 X1\n")
    assert reading.notices[0].line == 2
    assert bool(reading.moves[-1].unknown) is not block.startswith(("G28", "G30", "G38"))
    assert math.isnan(reading.moves[-1].position[2])


def test_a_declared_start_and_its_end():
    """G92 before anything else says where the program's zero is; behind its end only rapids can pass."""
    reading = read_moves(ISO, "G21 G90\nG92 X1 Y2 Z3\nG91 G1 X1\nG90 Y5\nG92.1\nG0 X7\n")
    assert [move.position[:3] for move in reading.moves[:2]] == [(2.0, 2.0, 3.0), (2.0, 5.0, 3.0)]
    assert "not known" in reading.moves[2].unknown and any("G92" in notice.text for notice in reading.notices)
    refused(ISO, "G21 G90\nG92 X1 Y2 Z3\nG1 X5\nG92.1\n", "G1 X7", "coordinates before it are not known")
    refused(ISO, "G21 G90\nG54\n", "G92 X1 Y2 Z3", "which is unknown")


def test_a_centre_word_of_zero_outside_the_plane_is_said():
    reading = read_moves(ISO, f"{ISO_START}G2 X5 Y5 I5 J0 K0\n")
    assert reading.moves[-1].arc.centre_mm == (5.0, 0.0) and "K0 outside" in reading.notices[-1].text


def test_machine_coordinates_and_variables():
    text = "_XH=-365. R2=7\nSUPA G0 X=_XH Z=_ZH D0\nG0 B0 C=R2\nG53 Y0\nG1 X1 Y1 Z1\n"
    home, rotary, machine, last = read_moves(ISO, text).moves
    assert home.machine and home.position[0] == -365.0 and math.isnan(home.position[2])
    assert home.named == {"X", "Z"}
    assert not rotary.machine and rotary.position[3:] == (0.0, 7.0) and math.isnan(rotary.position[0])
    assert machine.machine and machine.position[1] == 0.0
    assert last.position == (1.0, 1.0, 1.0, 0.0, 7.0)


def test_tcp_switches():
    text = (
        "G0 X1 Y1 Z1 B5 C6\nG43.4 H1\nX2 Y2\nZ3\nG49\nX1\nM428\nG49\nX1 Y1 Z1\nM429\nX3\nTRAORI(1)\nX1\nTRAFOOF\nZ2\n"
    )
    moves = read_moves(ISO, text).moves
    assert [m.tcp for m in moves] == [False, True, True, False, True, False, True, False]
    assert math.isnan(moves[1].position[2]) and moves[1].position[3:] == (5.0, 6.0)
    assert moves[2].position == (2.0, 2.0, 3.0, 5.0, 6.0)
    assert math.isnan(moves[3].position[1])
    given = read_moves(ISO, "G0 X1 Y1 Z1\nTRAFOOF\nX2\n", tcp=True)
    assert [m.tcp for m in given.moves] == [True, False]
    assert "TRAFOOF" in given.notices[0].text


def test_vectors_are_normalised_and_noted():
    reading = read_moves(ISO, "TRAORI\nG1 X1 Y1 Z1 A3=0 B3=3 C3=4\nX2\nB10 C0\nX3\n")
    assert [m.vector for m in reading.moves] == [(0.0, 0.6, 0.8), (0.0, 0.6, 0.8), None, None]
    assert all(math.isnan(v) for v in reading.moves[1].position[3:])
    assert reading.moves[3].position[3:] == (10.0, 0.0)
    assert "length 5" in reading.notices[0].text


def test_rotary_the_short_way():
    text = "G0 X0 Y0 Z0 B0 C350\nC=DC(10)\nC=ACN(350)\nC=ACP(10)\nG91 C=AC(5)\nC=DC(125)\nC=DC(350)\n"
    assert [m.position[4] for m in read_moves(ISO, text).moves] == [350, 370, 350, 370, 5, 125, -10]


def test_drilling_written_out():
    text = ISO_START + "MCALL CYCLE82(10.,0.,3.,-6.,,0.5)\nX5. Y5.\nX9.\nMCALL\nG1 X0.\n"
    program = ISO.read(text.encode(), "t")
    reading = ISO.moves(program, AXES, tcp=False)
    assert [m.position[2] for m in reading.moves] == [0, 0, 3, -6, 10, 10, 3, -6, 10, 10]
    new = {i: (np.add([m.position], (0.1, 0, 0, 0, 0)), None) for i, m in enumerate(reading.moves) if i}
    lines = ISO.rewrite(program, AXES, reading, new_positions(reading, new)).splitlines()[2:]
    assert lines == [
        ";MCALL CYCLE82(10.,0.,3.,-6.,,0.5)",
        *("X5.1 Y5.", "Z3.", "G1 Z-6.", "G4 F0.5", "G0 Z10."),
        *("X9.1", "Z3.", "G1 Z-6.", "G4 F0.5", "G0 Z10."),
        ";MCALL",
        "G1 X0.1",
    ]


@pytest.mark.parametrize(
    ("block", "what"),
    [
        ("L X", "X has no number"),
        ("L X+Q7", "the value of X"),
        ("L X+1.2.3", "X has no number"),
        ("L A+5", "unknown axis"),
        ("L X+5 X+6", "twice"),
        ("L XABC", "X has no number"),
        ("CTP PR+5 PA+30", "CTP"),
        ("CYCL DEF 7.1 #5", "datum table"),
        ("DEP PCT CCA90 R5", "APPR or DEP"),
        ("LP PR+5 PA+30", "LP"),
        ("CP IPA+30 DR+", "CP"),
        ("/L X+5", "block skip"),
        ("/L X+5 M30", "block skip"),
        ("12 /L X+5", "block skip"),
        ("N10 G1 X+5", "block of an ISO program"),
        ("L X+5 M3.5", "M3.5"),
        ("L X+5 S", "unknown word"),
        ("APPR PLT PR+5 PA+5 LEN10", "APPR"),
        ("DEP PLT LEN10", "DEP"),
        ("FL X+5", "FL"),
        ("SPLINE X+5 K3X1", "SPLINE"),
        ("FL X+5", "FL"),
        ("FC DR+ R5", "FC"),
        ("L X+5 R+ F100", "radius compensation"),
        ("L X+5 RR B+9", "radius compensation"),
        ("C X+10 Y+0 DR+", "without its centre"),
        ("CC X+3 Y+0\nC X+10 Y+0 DR+", "off its circle"),
        ("CC X+5 Y+0\nC X+10 Y+0", "without its sense"),
        ("CR X+10 Y+0 R+2 DR+", "too small"),
        ("CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 #6", "CYCL DEF 7"),
        ("CYCL DEF 8.0 MIRROR IMAGE\nCYCL DEF 8.1 X", "mirror"),
        ("CYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT", "without an angle"),
        ("CYCL DEF 11.0 SCALING\nCYCL DEF 11.1 SCL 0.9", "scaling"),
        ("CYCL DEF 19.0 WORKING PLANE\nCYCL DEF 19.1 A+30 X+0", "CYCL DEF 19 with other words"),
        ("CYCL DEF 26.1 X1.5", "scaling"),
        ("PLANE SPATIAL SPA+30 SPB+0 SPC+0", "PLANE"),
        ("TRANS DATUM TABLE", "TRANS"),
        ("CYCL CALL", "cycle call"),
        ("L X+5 M99", "cycle call without a cycle"),
        ("L X+5 M89", "cycle call without a cycle"),
        ("CALL LBL 1 REP 2", "subprogram"),
        ("CALL PGM SUB", "subprogram"),
        ("FN 9: IF +Q1 EQU +Q2 GOTO LBL 5", "control flow"),
        ("FN 12: IF +Q1 LT +Q2 GOTO LBL 5", "control flow"),
        ("M128\nLN X+1 Y+1 Z+1 TX+0 TY+0 TZ+0", "tool vector of zero length"),
        ("M128\nLN X+1 Y+1 Z+1 NX+0 NY+0 NZ+0 TX+0 TY+0 TZ+1", "surface normal of zero length"),
        ("LN X+1 Y+1 Z+1 TX+0 TY+0 TZ+1", "point control is off"),
        ("L X+5 WOBBLE", "unknown axis"),
        ("L X+5 F1e3", "unknown word"),
        ("Q1 = 1e3", "exponent"),
        ("FN 0: Q1 = +1E3", "exponent"),
        ("TOOL CALL 1 Z DL+1e-1", "exponent"),
        ("PLANE SPATIAL SPA+1e1 SPB+0 SPC+0 TURN", "exponent"),
        ("CYCL DEF 247 Q339=1e1", "exponent"),
        ("L X+5 Potato", "unknown word"),
        ("BEGIN PGM B CM", "unit"),
        ("=", "unknown block"),
    ],
)
def test_plain(block, what):
    refused(PLAIN, PLAIN_START, block, what)


@pytest.mark.parametrize(
    "block",
    [
        *("; X+5", "* - structure", "BLK FORM 0.1 Z X+0 Y+0 Z-20", "TOOL DEF 5 L+0 R+5", "STOP"),
        *(
            "CYCL DEF 32.0 TOLERANCE\nCYCL DEF 32.1 T0.05",
            "CYCL DEF 9.0 DWELL TIME\nCYCL DEF 9.1 DWELL 1",
            "M3",
        ),
        *("CYCL DEF 200 DRILLING ~\n  Q200=2 ;CLEARANCE ~\n  Q201=-20 ;DEPTH", "Q1 = +5", "FN 0: Q1 = +5", "LBL 0"),
        *(
            "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+0\nCYCL DEF 7.2 Y+0",
            "PLANE RESET STAY",
            "TRANS DATUM RESET",
            "M129",
        ),
        "FN 16: F-PRINT TNC:\\10E5.A",
        *("L R0 FMAX M3", "CC X+5 Y+5", "M126"),
    ],
)
def test_plain_passes(block):
    reading = read_moves(PLAIN, f"{PLAIN_START}{block}\nL IX+1 IY+1 IZ+1 IB+1 IC+1\n")
    assert [move.position for move in reading.moves] == [(0.0,) * 5, (1.0,) * 5]
    assert reading.notices == ()


def test_plain_parameters_and_machine_blocks():
    text = "BEGIN PGM A INCH\nQ1 = -2,5\nFN 0: Q2=+30\nL X-Q1 Y+1 Z+0 B+Q2 C0 FMAX\nL Z+0 R0 FMAX M91\nL X+1 M128\n"
    first, machine, last = read_moves(PLAIN, text).moves
    assert first.position == (63.5, 25.4, 0.0, 30.0, 0.0)
    assert machine.machine and math.isnan(machine.position[0])
    assert last.tcp and math.isnan(last.position[2]) and last.position[3] == 30.0


@pytest.mark.parametrize(
    ("block", "what"),
    [
        ("GOTO/1,2", "2 numbers"),
        ("GOTO/1,2,P3", "not a number"),
        ("GOTO/1,2,NAN", "not a number"),
        ("GOTO/1,,3", "not a number"),
        ("GOTO/1_0,2,3", "not a number"),
        ("GOTO/1,2,3,0,0,0", "zero length"),
        ("GODLTA/0,0,5", "GODLTA"),
        ("CIRCLE/0,0,0,0,0,1,10,TIMES", "CIRCLE"),
        ("CYCLE/ON", "cycle"),
        ("ROTATE/TABLE,ATANGL,90", "ROTATE"),
        ("TRANS/1,2,3", "TRANS"),
        ("COPY/1,SAME,1", "COPY"),
        ("CUTCOM/LEFT\nGOTO/5,0,0,0,1,0", "CUTCOM"),
        ("UNITS/CM", "unit"),
        ("MODE/INCR", "incremental"),
        ("CALL/SUB", "control flow"),
    ],
)
def test_apt(block, what):
    refused(APT, APT_START, block, what)


def test_apt_modality():
    text = (
        "TOOL PATH/A,TOOL,B\nMSYS/0,0,5,1,0,0,0,1,0\nMULTAX/ON\nUNITS/INCHES\nFROM/0,0,1\nRAPID\nGOTO/1,0,0,0,0.6,0.8\n"
        "FEDRAT/MMPM,500\nGOTO/2,0,0\nGOTO/3,0,$\n0,1,0,0\nCYCLE/OFF\nGOHOME\nWOBBLE/5\nEND-OF-PATH\n"
    )
    reading = read_moves(APT, text)
    assert [m.kind.value for m in reading.moves] == ["rapid", "rapid", "linear", "linear"]
    assert [m.vector for m in reading.moves] == [(0, 0, 1), (0, 0.6, 0.8), (0, 0.6, 0.8), (1, 0, 0)]
    assert [m.line for m in reading.moves] == [4, 6, 8, 9]
    assert reading.moves[3].position[0] == pytest.approx(76.2)
    assert all(m.tcp and math.isnan(m.position[3]) for m in reading.moves)
    assert [n.line for n in reading.notices] == [1, 12, 13]


@pytest.mark.parametrize(
    ("blocks", "line", "noted"),
    [
        ("L C+350 FMAX M126\nL C+10 F500\n", 3, 0),
        ("L C+350 FMAX M126\n" + "L C+340 F500\nL C+350\n" * 20 + "L IC-200 F500\n", 43, 0),
        ("L M126\nL C+350 FMAX\nL X+1 F500\nL C+370\nL C+20 FMAX\n", 0, 2),
        ("L C+350 FMAX M126\nL M127\nL C+10 F500\n", 0, 1),
        ("L C+350 FMAX\nL C+10 F500\nL M126\nL C+190\n", 0, 0),
    ],
)
def test_the_shortest_way_of_a_rotary_axis(blocks: str, line: int, noted: int) -> None:
    """With M126 a feed from 350° to 10° turns by 20°; the pieces of the long way would turn by 340°."""
    text = f"{PLAIN_START}{blocks}"
    if line:
        with pytest.raises(InputError, match="opposite direction") as caught:
            read_moves(PLAIN, text)
        assert caught.value.line == line + PLAIN_START.count("\n") - 1
    else:
        notices = [one for one in read_moves(PLAIN, text).notices if "on this rapid" in one.text]
        assert len(notices) == noted


@pytest.mark.parametrize(
    ("block", "positions"),
    [
        ("(A (B) C) G1 X5 (D (E (F)) G) Y6 F100", [(5, 6, 0, 0, 0)]),
        ("$PART.MIN%\nG1 X5 F100", [(5, 0, 0, 0, 0)]),
        ("G74 X1=0 Z1=0\nG0 X5 Z7", [(5, 0, 7, 0, 0)]),
        ("N5 G75 FP=2 Z1=0\nG0 X5\nZ7", [(5, 0, math.nan, 0, 0), (5, 0, 7, 0, 0)]),
        ("TRAORI\nG1 X1 Y2 Z3 A5=0 B5=0.6 C5=.8 A3=0 B3=0 C3=1 A4=1 B4=0 C4=0 F100", [(1, 2, 3, math.nan, math.nan)]),
        ("G91 G28 Z0\nG0 X5 Z0", [(5, 0, math.nan, 0, 0)]),
        (
            "G28 B0 C0\nG91 G0 B0 C=IC(0) X5\nX1\nG90 B10",
            [(x, 0, 0, b, math.nan) for x, b in ((5, math.nan), (6, math.nan), (6, 10))],
        ),
        ("G90 G28 Z0\nG0 X5 Z=IC(-0.)", [(5, 0, math.nan, 0, 0)]),
        ("/X5\nG91 X1", [(5, 0, 0, 0, 0), (6, 0, 0, 0, 0)]),
    ],
)
def test_iso_as_postprocessors_write_it(block: str, positions: list[tuple[float, ...]]) -> None:
    """Positions from the manuals: a control ignores comments, an axis at a reference or fixed point is elsewhere, a surface normal."""
    moves = read_moves(ISO, f"{ISO_START}{block}\n").moves[1:]
    np.testing.assert_array_equal([move.position for move in moves], positions)


@pytest.mark.parametrize("block", ["/G91", "/G54", "/T1 M6", "/R1=5", "/X5", "/M3 S100", "/MSG()"])
def test_block_skip_is_said_wherever_it_matters(block: str) -> None:
    assert [notice.line for notice in read_moves(ISO, f"{ISO_START}{block}\n").notices if "skip" in notice.text] == [2]


def test_plain_language_as_postprocessors_write_it() -> None:
    text = "N0 BEGIN PGM A IN\nN10 L X+1 Y+0 Z+0 B+10 C+0 FMAX\nN20 L Z-2. F10. S6000\nN30 M128. F10000.\nN40 L X+0 Y+0 Z+3 M13.\n"
    moves = read_moves(PLAIN, text).moves
    np.testing.assert_allclose(
        [move.position[:4] for move in moves], [[25.4, 0, 0, 10], [25.4, 0, -50.8, 10], [0, 0, 76.2, 10]]
    )
    assert [move.tcp for move in moves] == [False, False, True]
    technology = PLAIN.technology(PLAIN.read(text.encode(), "test"))
    np.testing.assert_allclose(technology.feed[[2, 4]], [254.0, 254000.0])
