"""Programs processed in chunks, with runs of simple lines processed together: same moves and bytes as in one piece and line by line."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.nc.nc_support import AXES, iso_program
from tests.nc.test_simple_blocks import (
    EOL,
    HANDED_ON,
    ISO,
    LONG,
    ODD,
    SWAPPED,
    axis_words,
    mixed_iso,
    new_positions,
    outcome,
    shown,
    way,
)
from twin.nc import chunks as line_chunks
from twin.nc.blocks import AxisWords, Interpretation, MoveColumns, Program
from twin.nc.chunks import Chunk
from twin.nc.iso.dialect import IsoRewriter
from twin.nc.iso.interpreter import IsoInterpreter
from twin.nc.lines import ARRAYS, LineCode, scan
from twin.nc.text import Style, newline_of, style_in

SEED = st.integers(0, 10**6)
MANY = settings(max_examples=200)


@pytest.fixture(autouse=True, scope="module")
def every_run_at_once() -> Iterator[None]:
    """Process runs of any length together; `pytest.MonkeyPatch` by hand, since hypothesis rejects function-scoped fixtures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(line_chunks, "SHORTEST_RUN", 1)
        yield


def chunks(program: Program, names: tuple[str, ...], size: int, code: LineCode = ARRAYS) -> Iterator[Chunk]:
    for first in range(0, len(program.texts), size):
        yield Chunk("".join(program.texts[first : first + size]).encode("latin-1"), first, names, code)


def read(
    program: Program, axes: AxisWords, size: int, tcp: bool, code: LineCode = ARRAYS
) -> tuple[list[tuple[Chunk, MoveColumns]], Interpretation, bool]:
    reader = ISO.reader(program.source, axes, tcp=tcp)
    parts = [(chunk, reader.read(chunk)) for chunk in chunks(program, axes.names, size, code)]
    moves = tuple(move for _, columns in parts for move in columns)
    return parts, Interpretation(moves, reader.notices, tuple(reader.lost_positions())), bool(reader.drilled())


def check(
    text: str, seed: int, axes: AxisWords = AXES, *, tcp: bool = False, size: int = 5, code: LineCode = ARRAYS
) -> None:
    program = ISO.read(text.encode("latin-1"), "test")
    with way("tokens"):
        whole = outcome(lambda: ISO.moves(program, axes, tcp=tcp))
    found = outcome(lambda: read(program, axes, size, tcp, code))
    if isinstance(whole, str) or isinstance(found, str):
        assert whole == found
        return
    parts, reading, drills = found
    assert shown(whole) == shown(reading)
    assert whole.lost_positions == reading.lost_positions
    new = new_positions(whole, seed, len(axes.names))
    if drills or not new.count.any():  # a program with cycles is not written in stretches
        return

    def written() -> str:
        style = style_in(program.texts, Style(point=True))
        rewriter = IsoRewriter(
            program.source, axes, newline_of(program.texts), style, tcp=whole.moves[0].tcp, code=code
        )
        out, at = [], 0
        for chunk, moves in parts:
            out.append(rewriter.write(chunk, moves, new.part(at, at + len(moves))))
            at += len(moves)
        return b"".join(out).decode("latin-1")

    found = outcome(written)
    with way("tokens"):
        assert found == outcome(lambda: ISO.rewrite(program, axes, whole, new))


@MANY
@given(text=st.one_of(mixed_iso(), iso_program()), seed=SEED, tcp=st.booleans(), size=st.sampled_from([1, 3, 7, 100]))
def test_any_program(text: str, seed: int, tcp: bool, size: int) -> None:
    if text.strip():
        check(text, seed, tcp=tcp, size=size)


@pytest.mark.slow
@MANY
@given(data=st.data(), seed=SEED, axes=st.sampled_from([SWAPPED, LONG, ODD]), size=st.sampled_from([3, 100]))
def test_on_other_machines(data: st.DataObject, seed: int, axes: AxisWords, size: int) -> None:
    text = data.draw(mixed_iso(names=("X", "Y", "Z", *(name for name in axes.rotary if len(name) == 1))))
    if text.strip():
        check(text, seed, axes, size=size)


@st.composite
def plain_only(draw: st.DrawFn) -> str:
    """Draw lines that are nearly all simple, in one style: long runs."""
    glue = draw(st.sampled_from([(" ",), ("",), ("", "", " ", "\t")]))
    small, eol = draw(st.booleans()), draw(EOL)

    def line() -> str:
        head = draw(st.sampled_from(["", "", "N10 ", "N10", "n7\t", " "]))
        code = draw(st.sampled_from(["", "", "G1", "G0 ", "G01 ", "g1", "G00"]))
        text = head + code + draw(axis_words(AXES.names, glue=glue)) + draw(st.sampled_from(["", " F500", "F.5"]))
        return text.lower() if small else text

    lines = [line() if draw(st.integers(0, 20)) else draw(st.sampled_from(["", " ", "(c)"])) for _ in range(25)]
    return eol.join(["G0 X0 Y0 Z0 B0 C0", *lines, ""])


@pytest.mark.slow
@MANY
@given(text=plain_only(), seed=SEED, size=st.sampled_from([4, 100]))
def test_long_runs(text: str, seed: int, size: int) -> None:
    check(text, seed, size=size)


@pytest.mark.sample(5)  # of 13
@pytest.mark.parametrize("name", [name for name, (dialect, _) in HANDED_ON.items() if dialect is ISO])
def test_what_one_way_leaves_to_the_other(name: str) -> None:
    for seed in range(60):
        check(HANDED_ON[name][1], seed, size=(1, 4, 100)[seed % 3])


NUMBER = r"[+-]?(?:\d{1,9}(?:\.\d*)?|\.\d+)"
PLAIN = re.compile(
    r"[ \t]*(?:N\d+[ \t]*)?(?:G(0?[01])[ \t]*)?(?=[XYZBC])"
    + "".join(rf"(?:{name}({NUMBER})[ \t]*)?" for name in AXES.names)
    + rf"(?:F{NUMBER}[ \t]*)?(?:\r\n|\n|\r|\Z)",
    re.ASCII | re.IGNORECASE,
)
"""A plain line, written independently of the package; its groups: motion code, value of each axis."""


def test_what_is_plain_is_what_the_pattern_says() -> None:
    """Compare lines, words and numbers, to the last bit, with a regular expression and with Python's `float`."""
    rng = random.Random(5)
    numbers = ["12.5", "0", "-0", "+5", "5.", "00.5", "0.120", "-0.0004", "12.34567", "007", "-.5", "+0.", "0.1", "8.7"]
    odd = ["1234567890", "1.2.3", ".", "", "- 5", "5,5", "1e3", "123456789.1234567", "+", "-", "12345678.1234567"]
    heads, codes = (
        ["", "", "N10 ", "n7\t", " ", "N1.5", "(c)", ";"],
        ["", "", "G1", "G01 ", "g0", "G2", "G", "G1.0", "G10"],
    )
    tails, ends = [" F500", "", "F.5", " F", " (c)", "  ", "F+5", "M3"], ["\n", "\n", "\r\n", "\r"]
    found = notes = 0
    for _ in range(1500):
        lines = []
        for _ in range(rng.randint(1, 12)):
            axes = [name for name in AXES.names if rng.random() < 0.6]
            if rng.random() < 0.05:
                rng.shuffle(axes)
            words = rng.choice(["", " "]).join(a + rng.choice(odd if rng.random() < 0.03 else numbers) for a in axes)
            lines.append(rng.choice(heads) + rng.choice(codes) + words + rng.choice(tails) + rng.choice(ends))
        text = "".join(lines)
        if rng.random() < 0.3:
            text = text.rstrip("\r\n") + "X1"
        seen = scan(text.encode("latin-1"), AXES.names)
        lines = re.findall(r"[^\r\n]*+(?:\r\n|\n|\r)|[^\r\n]++", text)
        assert [seen.line(i) for i in range(len(seen.start))] == lines
        for i, line in enumerate(lines):
            match = PLAIN.fullmatch(line)
            if not seen.simple[i]:
                digits = max((len(re.sub(r"\D", "", n)) for n in re.findall(r"[\d.]+", line)), default=0)
                assert match is None or digits > 15, line
                assert not seen.blank[i] or IsoInterpreter("p.nc", AXES, tcp=False).step(i, line) is None, line
                notes += bool(seen.blank[i])
                continue
            found += 1
            assert match is not None, line
            code = match.group(1)
            assert (seen.code[i], seen.wide[i]) == ((-1, False) if code is None else (int(code), len(code) > 1))
            own = slice(seen.first[i], seen.first[i + 1])
            values = dict(zip(seen.words.axis[own].tolist(), seen.words.value[own].tolist(), strict=True))
            wanted = {axis: text for axis, text in enumerate(match.groups()[1:]) if text}
            assert {axis: repr(value) for axis, value in values.items()} == {
                axis: repr(float(text)) for axis, text in wanted.items()
            }
    assert found > 1000 and notes > 50
