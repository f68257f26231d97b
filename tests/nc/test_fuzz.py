"""Arbitrary input gives a result or one clear error, in time proportional to its length."""

from __future__ import annotations

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


BOUND_SIZE = 300_000
SECONDS_PER_MB = 1.0
ALLOWANCE = 3.0
"""Factor for a slower or busy computer."""


def repeated(head, *blocks):
    """Return a program of numbered variations of some blocks, of about `BOUND_SIZE` bytes."""
    parts = [head]
    size = len(head)
    index = 0
    while size < BOUND_SIZE:
        parts.append(blocks[index % len(blocks)].replace("#", str(index % 90)))
        size += len(parts[-1])
        index += 1
    return "".join(parts)


ISO_START = "G21 G90\nG0 X0 Y0 Z0 B0 C0\n"
ORDINARY = {
    "nine bytes": ("a.nc", repeated(ISO_START, "G1 X#.5\n")),
    "five axes": ("a.nc", repeated(ISO_START, "N#0 G1 X#.125 Y-#.375 Z1.# B0.# C#.5 F500\n")),
    "modal": ("a.nc", repeated(ISO_START, "X#.125 Y-#.375\n", "Z1.#\n", "N5 M8\n", "G1 F500 (feed)\n", "G0 Z5. M9\n")),
    "incremental": ("a.nc", repeated(ISO_START + "G91\n", "G1 X0.# Y-0.#\n")),
    "arcs": ("a.nc", repeated(ISO_START, "G2 X10 Y0 I5 J0\n", "G1 X0 Y0 Z#\n")),
    "vectors": ("a.nc", repeated(ISO_START + "G43.5\n", "X#.1 Y1 Z1 I0 J0.6 K0.8\n")),
    "siemens": ("a.nc", repeated(ISO_START + "TRAORI\n", "N# X#.1 Y1 Z1 A3=0 B3=0.6 C3=0.8\n")),
    "plain language": ("a.h", repeated("BEGIN PGM A MM\n", "# L X+#.125 Y-#,375 R0 F500\n", "L Z+# FMAX M3\n")),
    "short plain language": ("a.h", repeated("BEGIN PGM A MM\n", "L X+#.5\n")),
    "LN": ("a.h", repeated("BEGIN PGM A MM\nM128\n", "LN X+# Y+1 Z+1 NX+0 NY+0 NZ+1 TX+0 TY+0.6 TZ+0.8\n")),
    "locations": ("a.cls", repeated("UNITS/MM\n", "GOTO/#.1234,2.5,3.75,0.0,0.6,0.8\n", "FEDRAT/MMPM,500.\n")),
    "short locations": ("a.cls", repeated("UNITS/MM\n", "GOTO/#,2,3\n")),
}
HOSTILE_BOUND = {
    f"{name} as {dialect}": (dialect, (text * (BOUND_SIZE // len(text) + 1))[:BOUND_SIZE])
    for name, text in HOSTILE.items()
    for dialect in DIALECTS
}


def reading_time(dialect, data):
    """Return the process time of reading and interpreting, and the moves (None: error)."""
    begin = time.process_time()
    moves = None
    try:
        moves = dialect.moves(dialect.read(data, "fuzz"), AXES, tcp=False).moves
    except InputError as error:
        assert error.expected
    return time.process_time() - begin, moves


@pytest.mark.parametrize("name", [*ORDINARY, *HOSTILE_BOUND])
def test_a_megabyte_is_read_in_a_second(name):
    dialect, text = (ORDINARY | HOSTILE_BOUND)[name]
    data = text.encode("latin-1")
    bound = ALLOWANCE * SECONDS_PER_MB * len(data) / 1e6
    for _ in range(3):  # the best of three, since the computer may be busy
        spent, moves = reading_time(DIALECTS[dialect], data)
        if spent <= bound:
            break
    assert spent <= bound
    if name in ORDINARY:
        assert moves is not None and len(moves) > 1000


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
