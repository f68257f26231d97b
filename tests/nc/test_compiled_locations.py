"""Tests of the compiled writer of APT locations: the same bytes as with Python strings, for any numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.nc.nc_support import AXES
from twin.compute.native import compiler
from twin.nc.apt.dialect import TogetherJob, together_code, written
from twin.nc.apt.reader import scan
from twin.nc.lines import ARRAYS

COMPILED = together_code(10**9)
needs_compiler = pytest.mark.skipif(compiler.find_compiler() is None, reason="no C++ compiler")

ODD = [
    5e-10,
    1.5e-9,
    -5e-10,
    -0.0,
    0.0,
    1e-12,
    -1e-12,
    999999.9999995,
    0.9999999995,
    -0.9999999996,
    5e-324,
    1e9,
    -4503.6,
]
TIES = st.tuples(st.integers(-(2**40), 2**40), st.integers(0, 45)).map(lambda v: v[0] / 2 ** v[1])
NEAR_TIES = st.tuples(st.integers(-(10**8), 10**8), st.integers(5, 12)).map(lambda v: (v[0] + 0.5) / 10 ** v[1])
COORDINATES = st.one_of(st.sampled_from(ODD), TIES, NEAR_TIES, st.floats(-1e4, 1e4))
COMPONENTS = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 0.6, -0.8, 1e-10, -1e-10, *ODD[:6]]), NEAR_TIES.map(np.sin), st.floats(-1, 1)
)
NUMBERS = st.integers(0, 14).map(lambda places: f"{1.25:.{places}f}")
VECTORS = st.lists(st.sampled_from([(0.0, 0.0, 1.0), (0.6, -0.0, 0.8)]) | st.tuples(COMPONENTS, COMPONENTS, COMPONENTS))


def job_of(text: str, count: np.ndarray, positions: np.ndarray, vectors: np.ndarray) -> TogetherJob:
    found = scan(text.encode(), AXES.names, ARRAYS)
    lines = np.flatnonzero(found.simple)
    return TogetherJob(found, slice(0, len(text)), lines, count[: len(lines)], positions, vectors)


@st.composite
def jobs(draw: st.DrawFn) -> TogetherJob:
    """Draw statements with and without tool vectors, with comments between them, and their segments."""
    newline = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    lines, count = [], []
    for _ in range(draw(st.integers(1, 8))):
        words = [draw(NUMBERS) for _ in range(3)] + draw(st.sampled_from([[], ["0", "0.6", "0.80"]]))
        lines.append(draw(st.sampled_from(["GOTO/", "goto/"])) + ",".join(words) + newline)
        lines += draw(st.sampled_from([[], [], [], [f"$$ note, x{newline}"], [newline]]))
        count.append(draw(st.integers(1, 3)))
    rows = sum(count)
    positions = np.array([[draw(COORDINATES) for _ in range(3)] + [np.nan] for _ in range(rows)])
    pool = draw(VECTORS) or [(0.0, 0.0, 1.0)]
    vectors = np.array([draw(st.sampled_from(pool)) for _ in range(rows)])
    return job_of("".join(lines), np.array(count), positions, vectors)


def one(values: list[float], places: int = 5) -> TogetherJob:
    """Return a statement with these coordinates, written with some decimals, and components of the tool vector."""
    text = f"GOTO/{','.join([f'{1.25:.{places}f}'] * 3)},0,0,1\n"
    return job_of(text, np.array([1]), np.array([values]), np.array([values]))


@pytest.mark.slow
@needs_compiler
@settings(max_examples=400)
@given(jobs(), st.sampled_from([None, ("0", "0", "1"), ("0.6", "0", "0.8"), ("1" * 50,) * 3]))
@example(one([5e-10, 1.5e-9, -5e-10], 9), None)
@example(one([999999.9999995, -0.0, 1e-12], 6), None)
@example(one([999999.9999995, -0.0, 1e-12], 12), None)
@example(one([0.000005, 0.5**6, -(0.5**6)]), None)
@example(one([1e16, 4503599627.370496, -1e300]), None)
def test_the_compiled_writer_writes_the_same(job: TogetherJob, said: tuple[str, ...] | None) -> None:
    assert COMPILED(job, said) == written(job, said)


@needs_compiler
def test_numbers_are_those_of_python() -> None:
    """Random numbers of all sizes, and the doubles next to ties, with all numbers of decimals."""
    rng = np.random.default_rng(1)
    ties = (rng.integers(-(10**9), 10**9, 3000) + 0.5) / 10.0 ** rng.integers(5, 13, 3000)
    sizes = rng.normal(size=3000) * 10.0 ** rng.integers(-14, 4, 3000)
    values = np.concatenate([ties, np.nextafter(ties, np.inf), np.nextafter(ties, -np.inf), sizes]).reshape(-1, 3)
    values = values[np.abs(values).max(axis=1) < 4000.0]
    lines = [f"GOTO/{','.join([f'{1.25:.{5 + i % 8}f}'] * 3)}\n" for i in range(len(values))]
    job = job_of("".join(lines), np.ones(len(values), dtype=int), values, values / 4000.0)
    text, _ = COMPILED(job, None)
    found = [line.removeprefix("GOTO/").split(",")[:3] for line in text.splitlines()]
    expected = [[f"{v:.{5 + i % 8}f}" for v in row] for i, row in enumerate(values.tolist())]
    assert [[v.lstrip("-") for v in row] for row in found] == [[v.lstrip("-") for v in row] for row in expected]
    assert text == written(job, None)[0]


@needs_compiler
def test_the_code_is_compiled() -> None:
    assert COMPILED is not written


def test_short_programs_and_computers_without_a_compiler_use_python(monkeypatch: pytest.MonkeyPatch) -> None:
    assert together_code(compiler.WORTH_COMPILING - 1) is written
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, "0")
    assert together_code(10**6) is written
