"""Curves and blocks of `twin path`, checked against SciPy's Bernstein polynomials, closed forms and distances over all pairs."""

from __future__ import annotations

from itertools import pairwise
from math import acos, ceil, pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Chebyshev
from scipy.interpolate import BPoly

from tests.compensation.test_path import from_line
from twin.compensation.fewer_blocks.fit import (
    CurvePiece,
    Fitter,
    Polyline,
    distances_anywhere,
    distances_near,
    few_blocks,
)


def tool(words: np.ndarray) -> np.ndarray:
    return words


def fitted(words: np.ndarray, allowed: float, power: float) -> tuple[Polyline, Fitter, list[CurvePiece]]:
    line = Polyline.of(words, tool, power)
    fitter = Fitter(line, tool, allowed)
    return line, fitter, fitter.pieces()


def cycloid(t: np.ndarray) -> np.ndarray:
    return np.stack([t - np.sin(t), 1.0 - np.cos(t)], axis=1)


@pytest.mark.slow
def test_the_papers_cycloid() -> None:
    """Díaz Pérez et al. (2019), table 4: 1001 points of a cycloid of 1 mm within 0.05 µm with 11 control points (CAD: 38).

    Here 10 are enough, because the distance from the curve counts, not from the point of the same parameter, and the nodes are
    Chebyshev's.
    """
    t = np.linspace(0.0, 2.0 * pi, 1001)
    tolerance = 5e-5
    _, _, pieces = fitted(cycloid(t), tolerance, 0.0)
    assert len(pieces) == 1
    control = pieces[0].control
    assert len(control) <= 11
    assert pieces[0].basis.kind == "polynomial"
    curve = BPoly(control[:, None, :], [0.0, 1.0])(np.linspace(0.0, 1.0, 3001))
    exact = cycloid(np.linspace(0.0, 2.0 * pi, 6001))
    # The tolerance plus the height of the points' own chords (0.005 µm at the top).
    assert from_line(curve, exact).max() <= tolerance + 6e-6
    assert from_line(exact, curve).max() <= tolerance + 6e-6
    assert control[[0, -1]] == pytest.approx(cycloid(t[[0, -1]]), abs=0.0)


def test_two_control_points_fewer_exceed_the_tolerance() -> None:
    """The best polynomials of a degree, from Chebyshev series of the cycloid, exceed the tolerance two degrees lower."""
    t = np.linspace(0.0, 2.0 * pi, 1001)
    pieces = fitted(cycloid(t), 5e-5, 0.0)[2]
    degree = pieces[0].degree - 2
    dense = np.linspace(0.0, 2.0 * pi, 4001)
    best = np.stack([Chebyshev.fit(dense, column, degree)(dense) for column in cycloid(dense).T], axis=1)
    assert from_line(best[::4], cycloid(dense)).max() > 5e-5


@pytest.mark.slow
@pytest.mark.parametrize("power", [pytest.param(0.0, marks=pytest.mark.slow), 0.5, 1.0])
def test_pieces_meet_with_one_tangent(power: float) -> None:
    t = np.linspace(0.0, 1.0, 5000)
    words = np.stack([200.0 * t, 30.0 * np.sin(40.0 * t) * np.cos(7.0 * t), 5.0 * np.sin(90.0 * t)], axis=1)
    _, _, pieces = fitted(words, 5e-3, power)
    assert len(pieces) > 1 and sum(piece.degree for piece in pieces) < 300
    assert [(piece.first, piece.last) for piece in pieces] == list(
        pairwise([0, *(piece.last for piece in pieces)])
    ) and pieces[-1].last == len(words) - 1
    for before, after in pairwise(pieces):
        assert np.array_equal(before.control[-1], after.control[0])
        assert np.array_equal(after.control[0], words[after.first])
        left, right = before.control[-1] - before.control[-2], after.control[1] - after.control[0]
        assert left / np.linalg.norm(left) == pytest.approx(right / np.linalg.norm(right), abs=1e-9)
    for piece in pieces:
        if piece.basis.kind == "polynomial":
            # Ten points per block: the error is a hundredth of the height of the chords, which is within the tolerance.
            curve = BPoly(piece.control[:, None, :], [0.0, 1.0])(np.linspace(0.0, 1.0, 10 * piece.blocks))
            part = words[piece.first : piece.last + 1]
            assert max(from_line(curve[::7], part).max(), from_line(part[::5], curve).max()) <= 5e-3 * (1.0 + 1e-2)


def test_straight_points_are_one_block() -> None:
    words = np.linspace([0.0, 0.0], [10.0, 5.0], 50)
    line, fitter, pieces = fitted(words, 1e-3, 1.0)
    assert [piece.degree for piece in pieces] == [1]
    found = few_blocks(line, *fitter.curve(pieces, 16), tool, 1e-3)
    assert found is not None
    assert found[0].tolist() == [[10.0, 5.0]]


@pytest.mark.parametrize("tolerance", [0.003, 0.03])
def test_blocks_lie_on_both_sides_of_the_curve(tolerance: float) -> None:
    """On a circle, vertices are outside and middles inside by the same distance.

    The number of blocks is hardly above that of the polygon with both at the tolerance.
    """
    radius = 30.0
    angle = np.linspace(0.0, 2.0 * pi, 4001)
    line, fitter, pieces = fitted(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), tolerance / 20.0, 1.0)
    found = few_blocks(line, *fitter.curve(pieces, 4), tool, tolerance)
    assert found is not None
    vertices = np.concatenate([line.words[:1], found[0]])
    out = np.linalg.norm(vertices, axis=1)[2:-2] - radius
    inside = radius - np.linalg.norm((vertices[1:] + vertices[:-1]) / 2.0, axis=1)[2:-2]
    assert np.all(out > 0.5 * tolerance) and np.all(inside > 0.5 * tolerance)
    assert max(out.max(), inside.max()) <= tolerance * (1.0 + 1e-6)
    least = ceil(pi / acos((radius - tolerance) / (radius + tolerance)))
    assert least <= len(vertices) - 1 <= 1.1 * least + 2


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(2, 60), st.integers(1, 60))
def test_distances_are_never_too_small(seed: int, vertices: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    line = np.cumsum(rng.normal(size=(vertices, 3)), axis=0)
    at = np.sort(rng.uniform(0.0, vertices - 1.0, count))
    places = np.stack([np.interp(at, np.arange(vertices), column) for column in line.T], axis=1)
    points = places + rng.normal(size=places.shape) * rng.choice([1e-3, 0.3])
    exact = from_line(points, line)
    assert distances_anywhere(points, line) == pytest.approx(exact, abs=1e-9)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.compensation.fewer_blocks.fit.MOST_PAIRS", 3 * vertices)
        assert distances_anywhere(points[::-1], line) == pytest.approx(exact[::-1], abs=1e-9)
        few = distances_near(points, at, line, np.arange(vertices, dtype=float), 0.0, np.inf)
    near = distances_near(points, at, line, np.arange(vertices, dtype=float), 0.0, np.inf)
    assert few == pytest.approx(near, abs=1e-12)
    assert np.all(near >= exact - 1e-9)
    assert near == pytest.approx(exact, abs=1e-9)  # the widest window is wider than the line
