"""Words of smoothing, of ended modes and of program names change no position and stay as they are; words beside them count."""

from __future__ import annotations

import pytest

from tests.nc.nc_support import AXES
from twin._common.errors import InputError
from twin.nc import DIALECTS

ISO = DIALECTS[0]
START = "G90 G21 G17\nG0 X300. Y200. Z-300. B0. C0.\n"
HARMLESS = (
    *(
        "G5.1 Q1",
        "G05.1 Q1 R5",
        "G05 P10000",
        "G5P2",
        "G08 P1",
        "G187 P3 E0.01",
        "G187 E.01",
        "G61.1",
        "G64 P.01 Q.01",
        "G5.4 Q1",
    ),
    *(
        "G54.2 P0",
        "G54.4 P0",
        "G40.1",
        "G50.2",
        "G80.5",
        "<PART-1>",
        "<PART> (BRACKET)",
        "COMPCAD",
        "FGROUP(X,Y,Z)",
        "FIFOCTRL",
    ),
    *("CYCLE832(0.01,3,1)", "CTOL=0.01", "G642 ADIS=0.01", "FFWON SOFT", "ORISON", "UPATH", "COMPOF"),
)


@pytest.mark.parametrize("word", HARMLESS)
def test_smoothing_leaves_positions_alone(word: str) -> None:
    moves = ISO.moves(ISO.read(f"{START}{word}\nG1 X310. F100\nG91 X5.\n".encode(), "p"), AXES, tcp=False).moves
    assert not any(move.unknown for move in moves)
    assert [move.position[:3] for move in moves] == [(300, 200, -300), (310, 200, -300), (315, 200, -300)]


@pytest.mark.parametrize(
    "word", ["G5.1 Q1 X0 Y0", "G54.2 P1", "G54.4", "G5 X1 Y1 I1 J1 P1 Q1", "G1 <PART>", "G1 X5. R5."]
)
def test_what_is_no_smoothing_is_refused(word: str) -> None:
    with pytest.raises(InputError) as caught:
        ISO.moves(ISO.read(f"{START}{word}\n".encode(), "p"), AXES, tcp=False)
    assert caught.value.line == 3
