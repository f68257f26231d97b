"""Segments of a block written together have the bytes of those written one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.nc import writer
from twin.nc.blocks import AxisWords, NewPositions, Program
from twin.nc.dialect import Dialect
from twin.nc.heidenhain.dialect import Heidenhain
from twin.nc.iso.dialect import Iso
from twin.nc.text import Style
from twin.nc.writer import Formatting, Grids, OutputState, lines_of_words

NAMES = ("X", "Y", "Z", "B", "C")
AXES = AxisWords(NAMES[:3], NAMES[3:], {"X": 0.001, "Y": 0.005, "Z": 0.001, "B": 0.0001, "C": 0.00025})
VALUES = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 0.0004, -0.25, 120.5]), st.floats(-2e4, 2e4))
STYLES = st.builds(Style, st.booleans(), st.integers(0, 5), st.booleans(), st.booleans(), st.just(False))
FORMATTINGS = st.builds(Formatting, STYLES, st.booleans(), st.booleans())


def one_by_one(rows: np.ndarray, said: OutputState, formatting: Formatting, begin: str, ending: str) -> str:
    """Return the lines of the positions after the first by the functions for single words."""
    text = ""
    for row in rows[1:].tolist():
        words = []
        for axis in said.axes_to_write(row, 0, False):
            name = NAMES[axis].lower() if formatting.lower else NAMES[axis]
            words.append(name + said.number_for(axis, row[axis], False, False, formatting.style))
        if words:
            text += begin + (" " if formatting.spaced else "").join(words) + ending
    return text


def state_at(row: np.ndarray) -> OutputState:
    """Return the state of an output in which the axes with a target stand there."""
    said = OutputState(AXES)
    for axis, value in enumerate(row.tolist()):
        if value == value:
            said.number_for(axis, value, False, False, Style())
    return said


@given(
    st.lists(st.lists(VALUES, min_size=5, max_size=5), min_size=1, max_size=6),
    st.sets(st.integers(0, 4), max_size=4),
    FORMATTINGS,
    st.sampled_from(["", "/", "12 L "]),
    st.sampled_from(["\n", "\r\n", "\r"]),
)
def test_lines_are_those_written_word_by_word(
    values: list[list[float]], bare: set[int], formatting: Formatting, begin: str, ending: str
) -> None:
    """Whatever the values, number format, line ending, and axes without a target; and the state after them is the same."""
    rows = np.array(values)
    rows[:, sorted(bare)] = math.nan
    one, together = state_at(rows[0]), state_at(rows[0])
    expected = one_by_one(rows, one, formatting, begin, ending)
    grids = Grids(NAMES, [AXES.increment[name] for name in NAMES])
    assert lines_of_words(rows, together, formatting, grids, begin, ending) == expected
    assert repr(together.value) == repr(one.value)
    assert together.stale == one.stale


@pytest.mark.parametrize("doubt", ["unknown", "stale", "now and then", "comma", "large"])
def test_what_is_left_to_single_words(doubt: str) -> None:
    """An unknown or uncertain last value, a target now and then, decimal commas, values beyond exact decimals."""
    rows = np.array([[1.0, 2.0, 3.0, 4.0, 5.0], [1.5, 2.0, 3.0, 4.0, 5.0]])
    said, style = state_at(rows[0]), Style(comma=doubt == "comma")
    if doubt == "unknown":
        said.mark_unknown((1,))
    if doubt == "stale":
        said.mark_stale((4,))
    if doubt == "now and then":
        rows[1, 2] = math.nan
    if doubt == "large":
        rows[1, 0] = 2e8
    grids = Grids(NAMES, [AXES.increment[name] for name in NAMES])
    before = repr(said.value)
    assert lines_of_words(rows, said, Formatting(style, True, False), grids, "", "\n") is None
    assert repr(said.value) == before


BLOCKS = {
    "iso": (
        "G1 X1. Y2. Z0 B0 C0 F500{end}",
        ["G2 X5. I2.{end}", "/G03X1.Y4.J1.M8{end}", "g1 x3. m5{end}", "G1 Z-4.125"],
    ),
    "heidenhain": (
        "1 L X+1 Y+2 Z+0 B+0 C+0 F500{end}",
        ["2 CC X+3 Y+2{end}3 C X+5 Y+2 DR-{end}", "4 L Z-4,125 FMAX M5"],
    ),
}


@pytest.mark.parametrize("dialect", [Iso(), Heidenhain()], ids=lambda one: one.name)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_blocks_with_many_segments(dialect: Dialect, end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arcs and lines become many segments: with skip signs, M words, small letters, no spaces, and no ending at the end."""
    first, others = BLOCKS[dialect.name]
    for other in others:
        text = "".join([first, other]).replace("{end}", end)
        program = Program("p", dialect.name, tuple(text.splitlines(keepends=True)))
        reading = dialect.moves(program, AXES, tcp=False)
        count = np.full(len(reading.moves), 7)
        steps = np.random.default_rng(3).integers(-2, 3, (7 * len(count), 5))
        positions = np.cumsum(steps, axis=0) * 0.0137
        new = NewPositions(np.cumsum(count) - count, count, positions, np.full((len(positions), 3), np.nan))
        found = []
        for many in (2, 1000):
            monkeypatch.setattr(writer, "MANY", many)
            found.append(dialect.rewrite(program, AXES, reading, new))
        assert found[0] == found[1]
        assert len(found[0].splitlines()) > 7
