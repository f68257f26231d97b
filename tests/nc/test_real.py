"""Real programs from elsewhere: read, written back, moved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import beside
from tests.nc.nc_support import AXES as ONE_TOOL
from tests.nc.nc_support import iso_positions, new_positions
from twin.nc import dialect_for
from twin.nc.blocks import Kind
from twin.nc.text import printed

AXES = replace(ONE_TOOL, one_tool=False)  # some of the programs use several tools
PROGRAMS = {
    "linuxcnc_boat-xyzbc.ngc": (1821, 1819),
    "spinnerU5_Bottle_opener_Flaschenoeffner.txt": (2692, 2678),
    "spinnerU5_Keychain_Schluesselanhaenger.mpf": (579, 569),
}


def load(name):
    data = (beside("data", "programs") / name).read_bytes()
    dialect = dialect_for(Path(name), data)
    program = dialect.read(data, name)
    return data, dialect, program, dialect.moves(program, AXES, tcp=False)


@pytest.mark.parametrize("name", PROGRAMS)
def test_written_back_unchanged(name):
    data, dialect, program, reading = load(name)
    assert dialect.rewrite(program, AXES, reading, new_positions(reading, {})).encode("latin-1") == data
    moves, words = PROGRAMS[name]
    assert len(reading.moves) == moves
    assert sum(not move.machine for move in reading.moves) == words


@pytest.mark.parametrize("name", PROGRAMS)
def test_shifted_and_read_again(name):
    _, dialect, program, reading = load(name)
    new, intended = {}, []
    for index, move in enumerate(reading.moves):
        if move.machine:
            continue
        x, y, z, b, c = move.position
        row = [printed(v, 0.001) for v in (x + 0.1 * np.sin(y), y + 0.05, z - 0.01 * np.cos(x), b + 0.002, c - 0.003)]
        row = [v if np.isfinite(v) else o for v, o in zip(row, move.position, strict=True)]
        intended.append(row)
        new[index] = (np.array([row]), None)
    text = dialect.rewrite(program, AXES, reading, new_positions(reading, new))
    again = dialect.moves(dialect.read(text.encode("latin-1"), name), AXES, tcp=False)
    found = [move for move in again.moves if not move.machine]
    assert all(move.kind is not Kind.ARC for move in found)
    np.testing.assert_allclose([m.position for m in found], intended, rtol=0, atol=1e-9, equal_nan=True)
    assert [m.tcp for m in found] == [m.tcp for m in reading.moves if not m.machine]


def test_the_boat_by_an_independent_reader():
    data, _, _, reading = load("linuxcnc_boat-xyzbc.ngc")
    assert all(move.tcp for move in reading.moves[:-2])
    found = [position for _, position in iso_positions(data.decode("latin-1"))]
    ours = np.array([move.position for move in reading.moves[:-2]])
    known = np.isfinite(ours)
    np.testing.assert_allclose(ours[known], np.array(found)[: len(ours)][known], rtol=0, atol=1e-9)
