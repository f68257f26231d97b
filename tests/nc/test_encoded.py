"""Lines of a program kept as bytes: the same as those split by Python, whatever the line endings."""

from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.nc.blocks import Lines, encoded

PIECES = st.sampled_from([b"\n", b"\r", b"\r\n", b"G1 X1", b"\x85\x0b\x0c\x1c", b"(\xe4)", b" "])
DATA = st.lists(PIECES, max_size=12).map(b"".join)


def split(data: bytes) -> tuple[str, ...]:
    """Return the lines by `bytes.splitlines`."""
    return tuple(line.decode("latin-1") for line in data.splitlines(keepends=True))


@given(DATA)
def test_lines_are_those_of_splitlines(data: bytes) -> None:
    """Length, iteration, single lines from either end, and equality."""
    lines, expected = Lines(data), split(data)
    assert len(lines) == len(expected)
    assert tuple(lines) == expected
    assert tuple(lines[i] for i in range(len(expected))) == expected
    assert tuple(lines[-i - 1] for i in range(len(expected))) == expected[::-1]
    assert lines == expected
    assert lines == Lines(data)
    assert hash(lines) == hash(expected)
    assert pickle.loads(pickle.dumps(lines)) == lines


@given(DATA, st.slices(12))
def test_slices_are_those_of_a_tuple(data: bytes, part: slice) -> None:
    """Any slice, with steps and from either end."""
    assert Lines(data)[part] == split(data)[part]


@given(DATA, st.integers(0, 12), st.integers(0, 15))
def test_bytes_of_a_range_are_those_of_its_lines(data: bytes, first: int, count: int) -> None:
    """For lines as bytes and for lines of text; past the end there are none."""
    expected = "".join(split(data)[first : first + count]).encode("latin-1")
    assert encoded(split(data), first, first + count) == expected
    if first <= len(split(data)):
        assert encoded(Lines(data), first, first + count) == expected


def test_no_line_beyond_the_last() -> None:
    """As for any sequence."""
    with pytest.raises(IndexError):
        Lines(b"a\nb")[2]
    assert encoded(("a\n", "", "b"), 0, 3, ";\n") == b"a\n;\nb"
