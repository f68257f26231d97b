"""Axis-mode programs made from cutter locations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.nc.nc_support import AXES, iso_positions, new_positions, plain_positions, read_moves
from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin.nc import dialect_for, read_program
from twin.nc.blocks import Kind

APT = dialect_for(Path("a.cls"))
TEXT = (
    "TOOL PATH/FINISH,TOOL,BALL (R5)\nLOADTL/3\nSPINDL/RPM,5000,CLW\nRAPID\nGOTO/0,0,10,0,0,1\nFEDRAT/MMPM,500\n"
    "GOTO/1,2,3,0,0.6,0.8\nFEDRAT/250.5,MMPM\nGOTO/4,5,6\nGOTO/4,5,6\nEND-OF-PATH\n"
)
ROWS = [
    [(0, 0, 10, 0, 0)],
    [(1, 1, 5, 10, 20), (1.5, 1.25, 4, 36.8699, 90)],
    [(1.5, 4, 4, 36.87, 90)],
    [(1.5, 4, 4, 36.87, 90)],
]


def posted(to):
    program = APT.read(TEXT.encode(), "dir/my part.cls")
    reading = APT.moves(program, AXES, tcp=True)
    new = {i: (np.array(rows, dtype=float), None) for i, rows in enumerate(ROWS)}
    writer = APT.poster(program.source, AXES, dialect_for(Path(to)))
    return APT.written(writer, program, AXES, reading, new_positions(reading, new))


WANTED = [(0, 0, 10, 0, 0), (1, 1, 5, 10, 20), (1.5, 1.25, 4, 36.87, 90), (1.5, 4, 4, 36.87, 90)]


def test_iso():
    text = posted("a.nc")
    assert text.splitlines()[:3] == ["%", "(axis positions from cutter locations of dir/my part.cls)", "G21 G90 G94"]
    assert "(TOOL PATH/FINISH,TOOL,BALL  R5)" in text
    assert "(SPINDL/RPM,5000,CLW)" in text
    assert "G0 X0. Y0. Z10. B0. C0.\nG1 X1. Y1. Z5. B10. C20. F500.\nX1.5 Y1.25 Z4. B36.87 C90.\nY4. F250.5\n" in text
    assert text.endswith("M30\n%\n")
    np.testing.assert_allclose([p for _, p in iso_positions(text)], WANTED)
    kinds = [move.kind for move in read_moves(dialect_for(Path("a.nc")), text).moves]
    assert kinds == [Kind.RAPID, Kind.LINEAR, Kind.LINEAR, Kind.LINEAR]


def test_heidenhain():
    text = posted("a.h")
    lines = text.splitlines()
    assert lines[0] == "0 BEGIN PGM MY_PART MM"
    assert lines[-1].endswith("END PGM MY_PART MM")
    assert [int(line.split()[0]) for line in lines] == list(range(len(lines)))
    assert any(line.endswith("L X+0 Y+0 Z+10 B+0 C+0 R0 FMAX") for line in lines)
    assert any(line.endswith("L X+1 Y+1 Z+5 B+10 C+20 R0 F500") for line in lines)
    np.testing.assert_allclose(plain_positions(text), WANTED)
    np.testing.assert_allclose([m.position for m in read_moves(dialect_for(Path("a.h")), text).moves], WANTED)


def test_a_move_nobody_solved_is_not_left_out_in_silence():
    program = APT.read(TEXT.encode(), "a.cls")
    reading = APT.moves(program, AXES, tcp=True)
    with pytest.raises(ValueError, match="line 5"):
        new = new_positions(reading, {1: (np.zeros((1, 5)), None)})
        APT.written(APT.poster("a.cls", AXES, dialect_for(Path("a.nc"))), program, AXES, reading, new)


def test_programs_by_name(tmp_path):
    path = tmp_path / "a.nc"
    path.write_bytes(b"G0 X1\n")
    program, dialect = read_program(path)
    assert (program.text, dialect.name) == ("G0 X1\n", "iso")
    with pytest.raises(InputError, match="no such program"):
        find_program(tmp_path / "b.nc")
