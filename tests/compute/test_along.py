"""Functions along lines, reduced while they are evaluated, compared with the same reductions of every single value."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.compute.test_native import compiled, eager, libraries  # noqa: F401
from twin.compute import along
from twin.compute import along as native
from twin.compute.along import AlongFunction, fractions
from twin.compute.native import compiler

SWITCHES = ["0", pytest.param("1", marks=compiled)]


def functions() -> tuple[ca.Function, ca.Function]:
    """Return a function of one output, and one of three values and the amount by which a point lies beyond the known."""
    begin, way, share = ca.SX.sym("begin", 2), ca.SX.sym("way", 2), ca.SX.sym("share")
    x = begin + share * way
    value = ca.sin(3.0 * x[0]) + x[1]
    outputs = [value, ca.fabs(ca.cos(x[0])), ca.fabs(x[1]), ca.fabs(x[0]) - 2.0]
    return ca.Function("f", [begin, way, share], [value]), ca.Function("g", [begin, way, share], outputs)


def lines(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return begin and displacement, number of points, and line and position of every point."""
    rng = np.random.default_rng(41)
    begin, way = rng.normal(size=(count, 4))[:, ::2], rng.normal(size=(count, 2))
    points = rng.integers(0, 9, count)
    line = np.repeat(np.arange(count), points)
    inside = np.concatenate([(np.arange(n) + 0.5) / n for n in points if n] or [np.zeros(0)])
    return begin, way, points, line, begin[line] + inside[:, None] * way[line]


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.parametrize("count", [1, 7, 300, 30_000])
@pytest.mark.usefixtures("eager")
def test_largest_value_of_each_line(switch: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, switch)
    monkeypatch.setattr(along, "AT_ONCE", 5_000)
    begin, way, points, line, x = lines(count)
    begin[count // 2] = np.nan
    if points[count // 2]:
        x[line == count // 2] = np.nan
    value = np.sin(3.0 * x[:, 0]) + x[:, 1]
    function = AlongFunction(functions()[0])
    found = function.largest((begin, way), points)
    expected = np.zeros(count)
    with np.errstate(invalid="ignore"):
        np.maximum.at(expected, line, value)
    assert function._confirmed == (switch == "1")
    assert found == pytest.approx(expected, abs=1e-14, nan_ok=True)


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.parametrize("count", [1, 7, 300, 30_000])
@pytest.mark.usefixtures("eager")
def test_totals_of_the_known_points(switch: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, switch)
    monkeypatch.setattr(along, "AT_ONCE", 5_000)
    begin, way, points, line, x = lines(count)
    function = AlongFunction(functions()[1])
    found = function.totals((begin, way), points, -0.5)
    values = np.stack([np.sin(3.0 * x[:, 0]) + x[:, 1], np.abs(np.cos(x[:, 0])), np.abs(x[:, 1])])
    known = np.abs(x[:, 0]) - 2.0 <= -0.5
    values, line = values[:, known], line[known]
    assert function._confirmed == (switch == "1")
    assert found.count == known.sum()
    assert found.squares == pytest.approx((values**2).sum(axis=1), rel=1e-12)
    if known.any():
        at = values.argmax(axis=1)
        assert found.largest == pytest.approx(values[:, at].T, abs=1e-14)
        assert found.line.tolist() == line[at].tolist()


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.usefixtures("eager")
def test_nothing_known_and_angles_too_large(switch: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not-a-number and points beyond the known do not count; an angle too large for the C++ is evaluated without it."""
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, switch)
    begin, way, points, _, _ = lines(300)
    largest, totals = (AlongFunction(function) for function in functions())
    nothing = totals.totals((np.full_like(begin, np.nan), way), points, 5.0)
    assert nothing.count == 0 and not nothing.squares.any()
    assert totals.totals((begin, way), np.zeros(300, dtype=int), 5.0).count == 0
    shared = largest.largest((begin, np.array([0.3, 0.2])), points)
    assert shared == pytest.approx(largest.largest((begin, np.tile([0.3, 0.2], (300, 1))), points), abs=0.0)
    begin[7, 0] = 4e12
    points[7] = 1
    expected = np.sin(3.0 * (begin[7, 0] + 0.5 * way[7, 0])) + begin[7, 1] + 0.5 * way[7, 1]
    assert largest.largest((begin, way), points)[7] == pytest.approx(max(expected, 0.0), rel=1e-9)


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.usefixtures("eager")
def test_lines_are_numbered_over_all_chunks(switch: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a known point in the first chunks, with equal values in several, and with all points just at the limit of the known."""
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, switch)
    monkeypatch.setattr(along, "AT_ONCE", 500)
    monkeypatch.setattr(native, "POINTS", 500)
    x, share = ca.SX.sym("x", 2), ca.SX.sym("share")
    function = AlongFunction(ca.Function("f", [x, share], [x[0] + 0.0 * share, ca.fabs(x[0]), x[1]]))
    inputs, points = np.tile([1.0, 0.5], (3_000, 1)), np.full(3_000, 2)
    inputs[1_700], inputs[:1_500, 1] = [-4.0, 0.5], 0.6
    found = function.totals((inputs,), points, 0.5)
    assert function._confirmed == (switch == "1")
    assert found.count == 3_000 and found.squares.tolist() == [2_998.0 + 32.0] * 2
    assert found.line.tolist() == [1_500, 1_700] and found.largest.tolist() == [[1.0, 1.0], [-4.0, 4.0]]
    inputs[1_700] = inputs[-1] = [3.0, 0.5]
    assert function.totals((inputs,), points, 0.5).line.tolist() == [1_700, 1_700], "the first of equal ones"


@compiled
@pytest.mark.usefixtures("eager")
def test_the_number_of_processors_changes_no_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    begin, way, points, _, _ = lines(30_000)
    function = AlongFunction(functions()[1])
    threads = function.totals((begin, way), points, 0.0)
    monkeypatch.setattr(native.compiler, "map_parts", lambda parts, work: [work(part) for part in parts])
    alone = function.totals((begin, way), points, 0.0)
    assert all(
        np.array_equal(getattr(threads, name), getattr(alone, name)) for name in ("count", "squares", "largest", "line")
    )


@compiled
@pytest.mark.usefixtures("eager")
def test_values_that_are_rounding_errors_are_no_reason_to_doubt_the_code() -> None:
    """A machine without errors has deviations of 1e-16: any two evaluations differ by all of it."""
    begin, way, points, _, _ = lines(300)
    x, move, share = ca.SX.sym("x", 2), ca.SX.sym("way", 2), ca.SX.sym("share")
    at = x + share * move
    nothing = ca.fabs(ca.sin(at[0]) ** 2 + ca.cos(at[0]) ** 2 - 1.0) + 1e-7 * ca.fabs(ca.sin(3.0 * at[1]) / 3.0)
    for outputs in ([nothing], [nothing, nothing, -1.0 + 0.0 * at[0]]):
        function = AlongFunction(ca.Function("f", [x, move, share], outputs))
        _ = function.largest((begin, way), points) if len(outputs) == 1 else function.totals((begin, way), points, 0.0)
        assert function._confirmed


@compiled
@pytest.mark.usefixtures("eager")
def test_wrong_code_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Code that disagrees on the first lines is refused, with one warning."""
    begin, way, points, _, _ = lines(300)
    function = AlongFunction(functions()[0])
    monkeypatch.setattr(native.CompiledAlong, "largest", lambda self, inputs, points: np.ones(len(points)))
    with pytest.warns(RuntimeWarning, match="wrong"):
        found = function.largest((begin, way), points)
    assert not function._confirmed and not np.all(found == 1.0)


def test_fractions_by_hand() -> None:
    assert fractions(np.array([2, 0, 1])).tolist() == [0.25, 0.75, 0.5]
