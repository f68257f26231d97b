"""Arbitrary input gives a result or one clear error, in time proportional to its length."""

from __future__ import annotations

import itertools
import random
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import beside
from tests.nc.nc_support import AXES, apt_program, iso_program, new_positions, plain_program
from twin._common.errors import InputError
from twin.nc import dialect_for

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
    """Read, interpret and rewrite; return the output if all of it succeeds."""
    try:
        program = dialect.read(data, "fuzz")
        assert program.text.encode("latin-1") == data
        reading = dialect.moves(program, AXES, tcp=False)
        assert dialect.rewrite(program, AXES, reading, new_positions(reading, {})) == program.text
        new = {}
        for index, move in enumerate(reading.moves):
            if not move.machine:
                end = np.array(move.position) + 0.0125
                tool = None if move.vector is None else np.array([move.vector] * 2)
                new[index] = (np.array([end - 0.5, end]), tool)
        return dialect.rewrite(program, AXES, reading, new_positions(reading, new))
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


SIZE = 300_000
HOSTILE = {
    "dots": ("G1 X", ".", ""),
    "digits": ("G1 X", "1", ""),
    "spaces": ("G1 X", " ", "1"),
    "parentheses": ("MSG", "(", ""),
    "open comments": ("", "( ", ""),
    "comments": ("", "(a)", ""),
    "brackets": ("X", "[", ""),
    "nested": ("X=A", "((", ""),
    "quotes": ("", 'T="', ""),
    "sums": ("R1=1", "+1", ""),
    "minus": ("X", "-", ""),
    "names": ("", "A_", ""),
    "hashes": ("", "#<", ""),
    "words": ("", "S1 ", ""),
    "calls": ("", "AB(", ""),
    "equals": ("", "A1=", ""),
    "signs": ("L X", "+ ", ""),
    "tildes": ("CYCL DEF 200 ~\n", "Q1=5 ~\n", ""),
    "dollars": ("", "GOTO/1,$\n", ""),
    "commas": ("GOTO/", ",", ""),
    "pgm": ("BEGIN PGM ", "A ", ""),
    "lines": ("", "\n", "M30"),
    "blocks": ("", "N1 G1 X1\n", ""),
    "slashes": ("", "/", ""),
    "high": ("", "\xff", ""),
    "m words": ("L ", "M94 ", ""),
    "tabs and blanks": ("", "\t ", "G0 X1"),
    "wraps": ("G1 X=AC(", " ", ")"),
    "tool call": ("TOOL CALL", " ", ""),
    "fn": ("FN", " ", "9"),
}
"""Beginning, what is repeated, end."""


def grows_in_proportion(work, data_of):
    """Return whether four times the input takes much less than sixteen times as long, once in three times (a busy computer)."""
    for _ in range(3):
        seconds = []
        for size in (SIZE // 4, SIZE):
            data = data_of(size).encode("latin-1")
            begin = time.process_time()
            work(data)
            seconds.append(time.process_time() - begin)
        if seconds[1] < max(8.0 * seconds[0], 0.2):  # too short to be measured
            return True
    return False


@pytest.mark.sample(80)  # of 90
@ALL
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_input_in_linear_time(dialect, name):
    head, part, tail = HOSTILE[name]
    assert grows_in_proportion(lambda data: run(dialect, data), lambda size: head + part * (size // len(part)) + tail)


ISO_START = "G21 G90\nG0 X0 Y0 Z0 B0 C0\n"
ORDINARY = {
    "nine bytes": ("a.nc", ISO_START, "G1 X#.5\n"),
    "five axes": ("a.nc", ISO_START, "N#0 G1 X#.125 Y-#.375 Z1.# B0.# C#.5 F500\n"),
    "modal": ("a.nc", ISO_START, "X#.125 Y-#.375\n", "Z1.#\n", "N5 M8\n", "G1 F500 (feed)\n", "G0 Z5. M9\n"),
    "incremental": ("a.nc", ISO_START + "G91\n", "G1 X0.# Y-0.#\n"),
    "arcs": ("a.nc", ISO_START, "G2 X10 Y0 I5 J0\n", "G1 X0 Y0 Z#\n"),
    "vectors": ("a.nc", ISO_START + "G43.5\n", "X#.1 Y1 Z1 I0 J0.6 K0.8\n"),
    "siemens": ("a.nc", ISO_START + "TRAORI\n", "N# X#.1 Y1 Z1 A3=0 B3=0.6 C3=0.8\n"),
    "plain language": ("a.h", "BEGIN PGM A MM\n", "# L X+#.125 Y-#,375 R0 F500\n", "L Z+# FMAX M3\n"),
    "short plain language": ("a.h", "BEGIN PGM A MM\n", "L X+#.5\n"),
    "LN": ("a.h", "BEGIN PGM A MM\nM128\n", "LN X+# Y+1 Z+1 NX+0 NY+0 NZ+1 TX+0 TY+0.6 TZ+0.8\n"),
    "locations": ("a.cls", "UNITS/MM\n", "GOTO/#.1234,2.5,3.75,0.0,0.6,0.8\n", "FEDRAT/MMPM,500.\n"),
    "short locations": ("a.cls", "UNITS/MM\n", "GOTO/#,2,3\n"),
}


def repeated(size, head, *blocks):
    """Return a program of numbered variations of some blocks, of about a number of bytes."""
    parts = [head]
    size -= len(head)
    for number in itertools.count():
        if size <= 0:
            return "".join(parts)
        parts.append(blocks[number % len(blocks)].replace("#", str(number % 90)))
        size -= len(parts[-1])


@pytest.mark.sample(4)  # of 12
@pytest.mark.parametrize("name", ORDINARY)
def test_ordinary_programs_in_linear_time(name):
    kind, *texts = ORDINARY[name]
    dialect = DIALECTS[kind]

    def read(data):
        assert len(dialect.moves(dialect.read(data, "fuzz"), AXES, tcp=False).moves) > 1000

    assert grows_in_proportion(read, lambda size: repeated(size, *texts))


@pytest.mark.parametrize("suffix", [".txt", ".mpf", ".ngc"])
def test_mutated_real_programs(suffix):
    (path,) = beside("data", "programs").glob(f"*{suffix}")
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
    assert outcomes == {True, False}  # both errors and results occur
