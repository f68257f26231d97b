"""Arbitrary input: success or one clear error, in time that grows with its length only."""

from __future__ import annotations

import random
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.nc.nc_support import AXES, apt_program, iso_program, plain_program
from twin.errors import InputError
from twin.nc import dialect_for
from twin.nc.blocks import Rewrite

DIALECTS = {name: dialect_for(Path(name)) for name in ("a.nc", "a.h", "a.cls")}
ALL = pytest.mark.parametrize("dialect", DIALECTS.values(), ids=lambda d: d.name)
SNIPPETS = [
    *(
        "X",
        "Y-",
        "(",
        ")",
        ";",
        "=",
        "G",
        "G43.4",
        "TRAORI",
        "A3=",
        "[",
        "]",
        "#1",
        '"',
        "$",
        "/",
        "~",
        "M128",
        "CC",
        "LN",
    ),
    *("GOTO/", ",", "$$", "CYCL DEF ", "MCALL CYCLE81(1,0,1,-1)", "N", "O", "%", "IX+", "Q1", "1e9", "..", "-0", "\t"),
    *(
        "G91 ",
        "G53 ",
        "SUPA ",
        "G2 ",
        "R",
        "DC(",
        "G93 ",
        "M30",
        "\n",
        "\r",
        "FMAX",
        "BEGIN PGM ",
        " MM",
        "TX+1",
        "G20 ",
    ),
]


def run(dialect, data):
    """Read, interpret and rewrite; the output if all of it went well."""
    try:
        program = dialect.read(data, "fuzz")
        assert program.text.encode("latin-1") == data
        reading = dialect.moves(program, AXES, tcp=False)
        assert dialect.rewrite(program, AXES, reading, []) == program.text
        rewrites = []
        for move in reading.moves:
            if not move.machine:
                end = np.array(move.position) + 0.0125
                tool = None if move.vector is None else np.array([move.vector] * 2)
                rewrites.append(Rewrite(move, np.array([end - 0.5, end]), tool))
        return dialect.rewrite(program, AXES, reading, rewrites)
    except InputError as error:
        assert error.expected
        assert error.file == "fuzz"
        return None


@ALL
@given(data=st.binary(max_size=400))
def test_bytes(dialect, data):
    assert run(dialect, data) is None or data


@ALL
@given(data=st.text(st.sampled_from("GXYZBCMNIJKRLTQFPCD0123456789.,+-=()[]#/$;~ \n"), max_size=120))
def test_almost_programs(dialect, data):
    assert run(dialect, data.encode("latin-1")) is None or data


@ALL
@given(text=st.one_of(iso_program(), plain_program(), apt_program()), data=st.data())
def test_mutated_programs(dialect, text, data):
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        drop = data.draw(st.integers(0, 4))
        text = text[:at] + data.draw(st.sampled_from(SNIPPETS)) + text[at + drop :]
    assert run(dialect, text.encode("latin-1")) is None or text


SIZE = 200_000
HOSTILE = {
    "dots": "G1 X" + "." * SIZE,
    "digits": "G1 X" + "1" * SIZE,
    "spaces": "G1 X" + " " * SIZE + "1",
    "parentheses": "MSG" + "(" * SIZE,
    "open comments": "( " * (SIZE // 2),
    "comments": "(a)" * (SIZE // 3),
    "brackets": "X" + "[" * SIZE,
    "nested": "X=A" + "((" * (SIZE // 2),
    "quotes": 'T="' * (SIZE // 3),
    "sums": "R1=1" + "+1" * (SIZE // 2),
    "minus": "X" + "-" * SIZE,
    "names": "A_" * (SIZE // 2),
    "hashes": "#<" * (SIZE // 2),
    "words": "S1 " * (SIZE // 3),
    "calls": "AB(" * (SIZE // 3),
    "equals": "A1=" * (SIZE // 3),
    "signs": "L X" + "+ " * (SIZE // 2),
    "tildes": "CYCL DEF 200 ~\n" + "Q1=5 ~\n" * (SIZE // 7),
    "dollars": "GOTO/1,$\n" * (SIZE // 9),
    "commas": "GOTO/" + "," * SIZE,
    "pgm": "BEGIN PGM " + "A " * (SIZE // 2),
    "lines": "\n" * SIZE + "M30",
    "blocks": "N1 G1 X1\n" * (SIZE // 9),
    "slashes": "/" * SIZE,
    "high": "\xff" * SIZE,
    "m words": "L " + "M94 " * (SIZE // 4),
    "tabs and blanks": "\t " * (SIZE // 2) + "G0 X1",
    "wraps": "G1 X=AC(" + " " * SIZE + ")",
    "tool call": "TOOL CALL" + " " * SIZE,
    "fn": "FN" + " " * SIZE + "9",
}


@ALL
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_input_in_linear_time(dialect, name):
    data = HOSTILE[name].encode("latin-1")
    begin = time.perf_counter()
    run(dialect, data)
    # Reading, splitting every block in two and writing. The rule is 1 s per MB for reading; a quadratic scan of 200 kB
    # takes minutes, and 10 s leaves room for a loaded machine.
    assert time.perf_counter() - begin < 10.0


@pytest.mark.parametrize("suffix", [".txt", ".mpf", ".ngc"])
def test_mutated_real_programs(suffix):
    folder = Path(__file__).resolve().parents[3] / "shared" / "data" / "programs"
    if not folder.is_dir():
        pytest.skip("the real programs of others (shared/data/programs) are not beside this checkout")
    (path,) = folder.glob(f"*{suffix}")
    lines = path.read_bytes().decode("latin-1").splitlines(keepends=True)
    random_ = random.Random(20)
    outcomes = set()
    for _ in range(40):
        part = lines[: random_.randrange(20, 200)]
        for _ in range(random_.randrange(0, 3)):
            at = random_.randrange(len(part))
            column = random_.randrange(len(part[at]))
            part[at] = part[at][:column] + random_.choice(SNIPPETS) + part[at][column + random_.randrange(3) :]
        outcomes.add(run(DIALECTS["a.nc"], "".join(part).encode("latin-1")) is None)
    assert outcomes == {True, False}  # some are refused, some are not
