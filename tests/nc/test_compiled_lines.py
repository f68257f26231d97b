"""Tests of the compiled reader and writer of simple ISO lines: the same as those with arrays, for any text."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.nc.nc_support import AXES, iso_program
from tests.nc.test_iso_stream import check
from tests.nc.test_simple_blocks import LONG, ODD, SWAPPED, mixed_iso
from twin.compute.native import compiler
from twin.nc import chunks as line_chunks
from twin.nc.blocks import AxisWords
from twin.nc.lines import ARRAYS, Scan, line_code, scan

NAMES = st.sampled_from([("X", "Y", "Z", "B", "C"), ("X", "Y", "Z"), ("Z", "Y", "X", "a", "c"), ("X1", "Y"), ()])
PIECES = [
    *"XYZBCNGFxyg0123456789.+-% \t;()\r\n",
    "\r\n",
    "\n",
    "G1 X1",
    "N10 ",
    "X-0.",
    "Y.5",
    "F1e3",
    "X1234567890",
    "é",
]
COMPILED = line_code(10**9)
needs_compiler = pytest.mark.skipif(compiler.find_compiler() is None, reason="no C++ compiler")


def differences(ours: Scan, theirs: Scan) -> list[str]:
    found = []
    for mine, other in ((ours, theirs), (ours.words, theirs.words)):
        for field in dataclasses.fields(mine):
            a, b = getattr(mine, field.name), getattr(other, field.name)
            if isinstance(a, np.ndarray) and not (a.dtype == b.dtype and np.array_equal(a, b)):
                found.append(f"{field.name}: {a} {b}")
            if field.name == "value" and not np.array_equal(np.signbit(a), np.signbit(b)):
                found.append("sign of zero")
    return found


@needs_compiler
@given(st.one_of(mixed_iso(), iso_program(), st.lists(st.sampled_from(PIECES), max_size=60).map("".join)), NAMES)
@example("", ("X",))
@example("X1", ("X",))
@example("X1\r", ("X",))
@example("X1\r\rX2\r\n\nX3", ("X",))
@example("X0.1234567890123 X1\n", ("X",))
@example("X123456789.123456\nX1234567890\nX-.\nX--1\nX1.2.3\nG01X1\nG001X1\nG-1X1\nN1.5X1\n", ("X",))
def test_the_compiled_scanner_reads_the_same(text: str, names: tuple[str, ...]) -> None:
    data = text.encode("latin-1", "replace")
    assert differences(COMPILED.scan(data, names), scan(data, names)) == []


@pytest.fixture(autouse=True, scope="module")
def every_run_at_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(line_chunks, "SHORTEST_RUN", 1)
        yield


@needs_compiler
def test_the_code_is_compiled() -> None:
    assert COMPILED is not ARRAYS


@pytest.mark.slow
@needs_compiler
@settings(max_examples=200)
@given(
    text=st.one_of(mixed_iso(), iso_program()),
    seed=st.integers(0, 10**6),
    axes=st.sampled_from([AXES, SWAPPED, LONG, ODD]),
    size=st.sampled_from([1, 3, 100]),
)
def test_the_compiled_writer_writes_the_same_as_the_tokeniser(text: str, seed: int, axes: AxisWords, size: int) -> None:
    if text.strip():
        check(text, seed, axes, size=size, code=COMPILED)


@needs_compiler
def test_numbers_are_those_of_the_text() -> None:
    """Every number is the double nearest to its text."""
    rng = random.Random(1)
    texts = [
        f"{rng.choice('+- ').strip()}{rng.randint(0, 10**9 - 1)}.{rng.randint(0, 10**6 - 1):06d}" for _ in range(20_000)
    ]
    found = COMPILED.scan("".join(f"X{text}\n" for text in texts).encode(), ("X",))
    assert found.words.value.tolist() == [float(text) for text in texts]


def test_short_programs_and_computers_without_a_compiler_use_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    assert line_code(compiler.WORTH_COMPILING - 1) is ARRAYS
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, "0")
    assert line_code(10**6) is ARRAYS
