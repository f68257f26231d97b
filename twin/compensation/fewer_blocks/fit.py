"""Fit piecewise fg-Bernstein curves to a polyline, with as few control points as keep within a tolerance.

All fits of a degree use the same nodes, so the matrix from points to control points is computed once per degree with high relative
accuracy (`twin.numerics.curves.fg_bernstein`; Díaz Pérez et al. 2019, eq. 13–14), and a fit is a matrix product. End points, and the
tangent at a joint, are exact constraints: the least-squares curve with some control points fixed is c + G Cᵀ (C G Cᵀ)⁻¹ (b − C c),
G = (AᵀA)⁻¹ = A⁺A⁺ᵀ (Björck 1996, ch. 5).

A curve is cut into as few straight blocks as keep within a tolerance of the polyline to which it was fitted. Their vertices are spread
so that every chord needs the same tolerance. Chords with both end points on the curve lie on one side of it and use only half of the
tolerance band. The vertices are therefore moved off the curve to the outside by half the mean height of their two chords, so that
vertices and chord middles are equally far from it. The end points of the curve stay fixed; the chords next to them deviate more and are
made slightly shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin.numerics.curves.fg_bernstein import FGBernstein

WINDOWS: Final = (1, 4, 16, 64, 256)
"""Segments searched on either side of a point's parameter; the wider windows only for points still too far away."""
LINES_DIFFER: Final = (16, 0.1)
"""If more than this share of the points is too far away after this window, the lines differ and the search ends."""
MOST_PAIRS: Final = 500_000
"""Pairs of points and segments evaluated at once: about 50 MB."""
LEAST_SQUARED_LENGTH: Final = 1e-30
"""Least squared length of a segment, for segments of length zero."""


def lengths(points: np.ndarray) -> np.ndarray:
    """Return (n,) the distance along (n, d) points, from 0, in their unit."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def distances_near(
    points: np.ndarray, at: np.ndarray, line: np.ndarray, line_at: np.ndarray, near: float, limit: float
) -> np.ndarray:
    """Return (n,) distances of points (n, d) from a polyline (m, d), searched near each point's parameter; never too small.

    ``at``, ``line_at``: (n,) and (m,) parameters of points and vertices. No closer point is searched for below ``near``, nor if more
    than a few are farther than ``limit``.
    """
    here = np.clip(np.searchsorted(line_at, at, side="right") - 1, 0, len(line) - 2)
    distances_near = np.full(len(points), np.inf)
    start, way = line[:-1], np.diff(line, axis=0)
    square = np.maximum(np.einsum("ij,ij->i", way, way), LEAST_SQUARED_LENGTH)
    for window in WINDOWS:
        far = np.flatnonzero(distances_near > near)
        beyond = np.count_nonzero(distances_near > limit)
        if not far.size or (window > LINES_DIFFER[0] and beyond > max(LINES_DIFFER[1] * len(points), 1.0)):
            break
        step = max(1, MOST_PAIRS // (2 * window + 1))
        for first in range(0, far.size, step):
            some = far[first : first + step]
            segment = here[some, None] + np.arange(-window, window + 1)
            np.minimum(np.maximum(segment, 0, out=segment), len(way) - 1, out=segment)
            distances_near[some] = _distances(points[some, None, :], start[segment], way[segment], square[segment]).min(
                axis=1
            )
    return distances_near


def distances_anywhere(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return (n,) distances of points from the nearest point anywhere on a polyline."""
    start, way = line[:-1], np.diff(line, axis=0)
    square = np.maximum(np.einsum("ij,ij->i", way, way), LEAST_SQUARED_LENGTH)
    distances_anywhere = np.empty(len(points))
    step = max(1, MOST_PAIRS // len(way))
    for first in range(0, len(points), step):
        some = slice(first, first + step)
        distances_anywhere[some] = _distances(points[some, None, :], start[None], way[None], square[None]).min(axis=1)
    return distances_anywhere


def _distances(points: np.ndarray, start: np.ndarray, way: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Return (n, m) distances of points (n, 1, d) from segments (n or 1, m, d); ``square``: squared lengths of the segments."""
    gap = points - start
    share = np.einsum("...i,...i->...", gap, way) / square
    np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
    gap -= share[..., None] * way
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", gap, gap)))


def largest_distance(
    one: np.ndarray,
    one_at: np.ndarray,
    other: np.ndarray,
    other_at: np.ndarray,
    near: float,
    limit: float,
    *,
    anywhere: bool = False,
) -> float:
    """Return the largest distance between two polylines of dense vertices, from the vertices (n or m, d) of each to the other.

    ``one_at``, ``other_at``: (n or m,) parameters, equal at corresponding points; ``near``, ``limit``: as for `distances_near`. With
    ``anywhere``, points still beyond the limit are compared with the whole other line; otherwise the search may end beyond the limit.
    """
    worst = 0.0
    for points, at, line, line_at in ((one, one_at, other, other_at), (other, other_at, one, one_at)):
        found = distances_near(points, at, line, line_at, near, limit)
        far = np.flatnonzero(found > limit)
        if anywhere and far.size:
            found[far] = distances_anywhere(points[far], line)
        worst = max(worst, float(found.max()))
        if worst > limit and not anywhere:
            break
    return worst


# --- Fit piecewise fg-Bernstein curves to a polyline, with as few control points as keep within a tolerance

Kind = Literal["polynomial", "trigonometric"]
CANDIDATES: Final[tuple[tuple[Kind, int], ...]] = (
    ("polynomial", 1),
    ("trigonometric", 2),
    *(("polynomial", degree) for degree in (2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26)),
)
"""Bases and degrees tried from every joint. The trigonometric functions of degree 2 describe a circular arc, here over the angle
through which the blocks turn.
"""
HOPELESS_FIT: Final = 5
"""If no curve up to this degree saves a block per control point, higher degrees are not tried."""
MOST_SKIPPED: Final = 8
"""Most blocks left unchanged before a curve is tried again: where one start fails, the next few usually do too."""
LEAST_REST: Final = 3
"""Control points assumed for the rest of a smooth stretch, at least."""
LEAST_HALF_ANGLE_RAD: Final = 0.01
MOST_HALF_ANGLE_RAD: Final = 2.4
"""Half the angle of one arc; towards π its control points diverge (f/g has a pole there)."""
NODES_A_POINT: Final = 6
"""Nodes per control point; more nodes change a fit by less than the rounding of a program's words."""
POINTS_PER_BLOCK: Final = 4
"""Points per input block at which distances are evaluated."""

Tool = Callable[[np.ndarray], np.ndarray]
"""Function from (n, axes) words to (n, k) coordinates at the tool, mm: the point, and rotary words times the lever."""


@lru_cache(maxsize=256)
def _solver(basis: FGBernstein) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for a basis: Chebyshev nodes (m,), A⁺ (degree+1, m), and G = A⁺A⁺ᵀ."""
    count = NODES_A_POINT * (basis.degree + 1)
    nodes = (1.0 - np.cos(np.pi * (np.arange(count) + 0.5) / count)) / 2.0
    inverse = basis.least_squares(nodes, np.eye(count))
    return read_only(nodes), inverse, read_only(inverse @ inverse.T)


@lru_cache(maxsize=512)
def _values(basis: FGBernstein, count: int) -> np.ndarray:
    """Return (count+1, degree+1) values of the basis functions at equal steps."""
    return basis.collocation(np.linspace(0.0, 1.0, count + 1))


@final
@dataclass(frozen=True)
class Polyline:
    """A polyline with derived quantities that are needed repeatedly."""

    words: np.ndarray  # (n, axes) its vertices
    at: np.ndarray  # (n,) their parameters, from 0
    size: np.ndarray  # (n−1,) lengths of its blocks at the tool, mm
    turned: np.ndarray  # (n,) sum of the bends up to and including each vertex, rad
    dense: np.ndarray  # ((n−1)·PARTS+1, axes) vertices and points between
    dense_at: np.ndarray  # their parameters
    dense_tool: np.ndarray  # their coordinates at the tool

    @classmethod
    def of(cls, words: np.ndarray, tool: Tool, power: float = 1.0) -> Polyline:
        """Create a polyline from (n, axes) vertices, n ≥ 2, consecutive ones distinct at the tool.

        The parameter grows from vertex to vertex by the distance at the tool to the power ``power``.
        """
        share = np.arange(POINTS_PER_BLOCK) / POINTS_PER_BLOCK
        between = words[:-1, None, :] + share[:, None] * np.diff(words, axis=0)[:, None, :]
        dense = np.concatenate([between.reshape(-1, words.shape[1]), words[-1:]])
        places = tool(dense)
        way = lengths(places)
        at = np.append(0.0, np.cumsum(np.diff(way[::POINTS_PER_BLOCK]) ** power))
        dense_at = np.append((at[:-1, None] + share * np.diff(at)[:, None]).ravel(), at[-1:])
        chords = np.diff(places[::POINTS_PER_BLOCK], axis=0)
        size = np.linalg.norm(chords, axis=1)
        unit = chords / size[:, None]
        bend = np.zeros(len(words))
        bend[1:-1] = 2.0 * np.arcsin(np.clip(np.linalg.norm(np.diff(unit, axis=0), axis=1) / 2.0, 0.0, 1.0))
        return cls(words, at, size, np.cumsum(bend), dense, dense_at, places)

    def turning_rad(self, first: int, last: int) -> float:
        """Return the angle through which the line turns between two vertices, extrapolated over half of the first and last block."""
        if last - first < 2:
            return 0.0
        whole = float(self.size[first:last].sum())
        inner = whole - float(self.size[first] + self.size[last - 1]) / 2.0
        return float(self.turned[last - 1] - self.turned[first]) * whole / inner

    def points(self, at: np.ndarray) -> np.ndarray:
        """Return (k, axes) words at parameters along the line."""
        return np.stack([np.interp(at, self.dense_at, column) for column in self.dense.T], axis=1)


@final
@dataclass(frozen=True)
class CurvePiece:
    """One fg-Bernstein curve between two vertices."""

    first: int  # first, last: indices of its first and last vertex
    last: int
    basis: FGBernstein  # its basis functions
    control: np.ndarray  # (degree+1, axes) control points, words
    fit_mm: float  # largest distance from the polyline at the tool, in both directions

    @property
    def degree(self) -> int:
        """Degree of the curve."""
        return self.basis.degree

    @property
    def blocks(self) -> int:
        """Number of input blocks it replaces."""
        return self.last - self.first


@final
class Fitter:
    """Fits curves to one smooth stretch, at most ``allowed_mm`` from it; ``tool``: function from words to coordinates at the tool."""

    def __init__(self, line: Polyline, tool: Tool, allowed_mm: float) -> None:
        self.line = line
        self.tool = tool
        self.allowed = allowed_mm
        self.end = len(line.words) - 1
        self._reach: dict[tuple[str, int], int] = {}

    def pieces(self) -> list[CurvePiece]:
        """Return consecutive curves over the whole stretch, with common tangents at their joints.

        From every joint, each degree is extended as long as it stays within the tolerance. The candidate with the most blocks per
        control point is taken, unless one that ends the stretch needs fewer control points than that candidate and the estimated rest.
        """
        pieces: list[CurvePiece] = []
        first, tangent, skip = 0, None, 0
        while first < self.end:
            best = self._best(first, tangent)
            if best is None:
                # No curve saves blocks, or none keeps the tangent: keep some blocks, then start without a tangent.
                skip = min(max(2 * skip, 1), MOST_SKIPPED)
                pieces += [self._block(vertex) for vertex in range(first, min(first + skip, self.end))]
                first, tangent = pieces[-1].last, None
                continue
            pieces.append(best)
            first, tangent, skip = best.last, self._end_tangent(best), 0
        while len(pieces) > 1 and pieces[-2].blocks > 1:
            before = self._end_tangent(pieces[-3]) if len(pieces) > 2 else None
            cost = pieces[-2].degree + pieces[-1].degree
            joined = self._lowest_degree(pieces[-2].first, before, most=cost - 1)
            if joined is None:
                break
            pieces[-2:] = [joined]
        return pieces

    def curve(self, pieces: list[CurvePiece], steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return words of the whole curve at ``steps`` or more points per block, and their parameters."""
        words, at = [self.line.words[:1]], [self.line.at[:1]]
        for piece in pieces:
            count = _rounded_up(max(16, steps * piece.blocks))
            words.append((_values(piece.basis, count) @ piece.control)[1:])
            share = np.linspace(0.0, 1.0, count + 1)[1:]
            at.append(self.line.at[piece.first] + share * self._way(piece.first, piece.last))
        return np.concatenate(words), np.concatenate(at)

    def _block(self, first: int) -> CurvePiece:
        """Return an unchanged block as a piece."""
        return CurvePiece(first, first + 1, FGBernstein(1), self.line.words[first : first + 2], 0.0)

    def _best(self, first: int, tangent: np.ndarray | None) -> CurvePiece | None:
        """Return the best next piece from a vertex; None if none replaces more blocks than it has control points."""
        candidates: list[CurvePiece] = []
        for kind, degree in CANDIDATES:
            piece = self._longest(first, kind, degree, tangent)
            if piece is None or (piece.blocks <= degree and piece.last < self.end):
                if degree >= HOPELESS_FIT and not candidates:
                    break
                continue
            candidates.append(piece)
            if piece.last == self.end:
                break
        if not candidates:
            return None
        if candidates[-1].last == self.end:
            candidates[-1] = self._lowest_degree(first, tangent, most=candidates[-1].degree) or candidates[-1]

        def cost(piece: CurvePiece) -> float:
            """Return the control points needed to the end if the rest costs as much per block as this piece."""
            left = self.end - piece.last
            return piece.degree + (max(left * piece.degree / piece.blocks, LEAST_REST) if left else 0.0)

        return min(candidates, key=cost)

    def _end_tangent(self, piece: CurvePiece) -> np.ndarray:
        """Return the (axes,) derivative of the words by the parameter at a piece's end."""
        slope = piece.basis.derivative(piece.control, np.array([1.0]))[0]
        return np.asarray(slope / self._way(piece.first, piece.last))

    def _way(self, first: int, last: int) -> float:
        return float(self.line.at[last] - self.line.at[first])

    def _longest(self, first: int, kind: Kind, degree: int, tangent: np.ndarray | None) -> CurvePiece | None:
        """Return the longest piece of a degree, searched from the length last reached with that degree."""
        most = self.end - first
        low, high, best = 0, most + 1, None
        step = min(self._reach.get((kind, degree), 4 * degree), most)
        while low < step < high:
            piece = self._fit(first, first + step, kind, degree, tangent)
            if piece is None:
                high = step
            else:
                best, low = piece, step
            step = min(2 * low, most) if high > most else (low + high) // 2
        self._reach[kind, degree] = max(low, 1)
        return best

    def _lowest_degree(self, first: int, tangent: np.ndarray | None, *, most: int) -> CurvePiece | None:
        """Return a piece from a vertex to the end, of the lowest sufficient degree up to ``most``, by bisection."""
        if most < 1:
            return None
        arc = self._fit(first, self.end, "trigonometric", 2, tangent) if most >= 2 else None
        best = arc or self._fit(first, self.end, "polynomial", most, tangent)
        low = 0
        while best is not None and best.degree - low > 1:
            middle = (low + best.degree) // 2
            piece = self._fit(first, self.end, "polynomial", middle, tangent)
            low, best = (middle, best) if piece is None else (low, piece)
        return best

    def _fit(self, first: int, last: int, kind: Kind, degree: int, tangent: np.ndarray | None) -> CurvePiece | None:
        """Return the curve of a degree between two vertices; None if it exceeds the tolerance."""
        line = self.line
        half_angle = line.turning_rad(first, last) / 2.0 if kind == "trigonometric" else 0.0
        if kind == "trigonometric" and not LEAST_HALF_ANGLE_RAD < half_angle < MOST_HALF_ANGLE_RAD:
            return None
        basis = FGBernstein(degree, kind=kind, half_angle_rad=half_angle)
        ends = line.words[[first, last]]
        way = self._way(first, last)
        fixed, values = [0, degree], [ends[0], ends[1]]
        if tangent is not None:
            second = _second(basis, ends[0], way * tangent)
            if degree > 1:
                fixed.insert(1, 1)
                values.insert(1, second)
            elif float(np.linalg.norm(self.tool(second[None])[0] - self.tool(ends[1:])[0])) > self.allowed:
                return None
        if len(fixed) > degree:
            control = np.array(values)
        else:
            nodes, inverse, weights = _solver(basis)
            control = inverse @ line.points(line.at[first] + way * nodes)
            fixed_weights = weights[:, fixed]
            control = control + fixed_weights @ np.linalg.solve(fixed_weights[fixed], np.array(values) - control[fixed])
        still = np.ptp(line.words[first : last + 1], axis=0) == 0.0
        if kind == "polynomial":
            control[:, still] = ends[0, still]  # an axis at rest stays exactly at rest
        control[[0, -1]] = ends
        part = slice(first * POINTS_PER_BLOCK, last * POINTS_PER_BLOCK + 1)
        count = _rounded_up(max(32, POINTS_PER_BLOCK * (last - first)))
        curve = self.tool(_values(basis, count) @ control)
        at = line.at[first] + way * np.linspace(0.0, 1.0, count + 1)
        input_line, input_at, limit = line.dense_tool[part], line.dense_at[part], self.allowed
        off = largest_distance(curve, at, input_line, input_at, limit, limit)
        return CurvePiece(first, last, basis, read_only(control), off) if off <= self.allowed else None


def _second(basis: FGBernstein, start: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the second control point from start point and derivative: y'(0) = n (f'(0) c_1 + g'(0) c_0)."""
    unit = np.zeros((basis.degree + 1, 2))
    unit[0, 0] = unit[1, 1] = 1.0
    back, forward = basis.derivative(unit, np.array([0.0]))[0]
    return np.asarray((slope - back * start) / forward)


def _rounded_up(count: int) -> int:
    """Return the next power of two, to limit the number of cached tables."""
    return 1 << (count - 1).bit_length()


# --- Cut a curve into as few straight blocks as keep within a tolerance of the polyline to which the curve was fitted

OUTWARD: Final = 0.25
"""Outward shift of a vertex, as a fraction of the sum of both chord heights: half their mean."""
END_CHORD: Final = 0.845
"""√(5/7): length of first and last chord relative to the others, for the same deviation in the middle: e²(1 − 1/8) − 1/8 = 1/2."""
POINTS_PER_CHORD: Final = 16
"""Points per chord at which its distance is evaluated."""
GROWTH: Final = 1.15


def few_blocks(
    line: Polyline, curve: np.ndarray, curve_at: np.ndarray, tool: Tool, allowed_mm: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return the fewest straight blocks near a polyline: (m, axes) vertices but the first, (m+1,) parameters, largest distance in mm.

    None if as many blocks as the line has are needed. ``curve``: (n, axes) dense points of a curve near the line, with the same end
    points, and ``curve_at`` (n,) their parameters along the line; ``tool``: function from words to coordinates at the tool.
    """
    most = len(line.words) - 2
    sums = _demand(curve, curve_at, tool)
    still = np.ptp(line.words, axis=0) == 0.0
    low, high, best = 0, most + 1, None
    # A chord may use twice the tolerance from its vertices to its middle: √(c/(16 a)) chords per unit.
    step = min(max(int(0.8 * sums[-1] / np.sqrt(16.0 * allowed_mm)), 1), most)
    while low < step < high:
        blocks = _blocks(line, curve, curve_at, sums, step, tool, allowed_mm, still)
        if blocks is None:
            low = step
            step = min(max(int(GROWTH * step), step + 1), most) if high > most else (low + high) // 2
        else:
            high, best = step, blocks
            step = (low + high) // 2 if low else min(int(step / GROWTH), step - 1)
    return best


def between(words: np.ndarray, at: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points on straight blocks, ``parts`` per block, and their parameters."""
    share = np.arange(parts) / parts
    dense = words[:-1, None, :] + share[:, None] * np.diff(words, axis=0)[:, None, :]
    dense_at = at[:-1, None] + share * np.diff(at)[:, None]
    return np.concatenate([dense.reshape(-1, words.shape[1]), words[-1:]]), np.append(dense_at.ravel(), at[-1])


def _demand(curve: np.ndarray, at: np.ndarray, tool: Tool) -> np.ndarray:
    """Return (n,) ∫ √|c|, with c the second derivative across the curve: the deviation of a short block's middle divided by h²/8."""
    places = tool(curve)
    before, behind = np.diff(at)[:-1], np.diff(at)[1:]
    share = (before / (before + behind))[:, None]
    middle = tool(curve[:-2] + share * (curve[2:] - curve[:-2]))
    way = places[2:] - places[:-2]
    gap = middle - places[1:-1]
    square = np.einsum("ij,ij->i", way, way)
    along = np.einsum("ij,ij->i", gap, way) / np.where(square == 0.0, 1.0, square)
    bend = np.linalg.norm(gap - along[:, None] * way, axis=1) * 2.0 / (before * behind)
    rate = np.sqrt(np.concatenate([bend[:1], bend, bend[-1:]]))
    steps = (rate[1:] + rate[:-1]) / 2.0 * np.diff(at)
    # Straight parts need vertices too: a thousandth of the total, spread evenly, keeps the integral strictly increasing.
    steps += 1e-3 * max(float(steps.sum()), 1e-12) * np.diff(at) / (at[-1] - at[0])
    return np.append(0.0, np.cumsum(steps))


def _blocks(
    line: Polyline,
    curve: np.ndarray,
    curve_at: np.ndarray,
    sums: np.ndarray,
    count: int,
    tool: Tool,
    allowed_mm: float,
    still: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return ``count`` blocks; None if they exceed the tolerance."""
    at = _spread(sums, curve_at, count)
    if np.any(np.diff(at) <= 0.0):
        return None
    words = _points(curve, curve_at, at)
    rise = _points(curve, curve_at, (at[1:] + at[:-1]) / 2.0) - (words[1:] + words[:-1]) / 2.0
    words[1:-1] += OUTWARD * (rise[1:] + rise[:-1])
    words[[0, -1]] = line.words[[0, -1]]
    words[:, still] = line.words[0, still]
    dense, dense_at = between(words, at, POINTS_PER_CHORD)
    places = tool(dense)
    off = largest_distance(places, dense_at, line.dense_tool, line.dense_at, allowed_mm, allowed_mm)
    return (words[1:], at, off) if off <= allowed_mm else None


def _spread(sums: np.ndarray, curve_at: np.ndarray, count: int) -> np.ndarray:
    """Return (count+1,) parameters of vertices with equal shares of the demand, slightly less for the first and last chord."""
    shares = np.full(count, 1.0)
    if count > 2:
        shares[[0, -1]] = END_CHORD
    at = np.interp(np.append(0.0, np.cumsum(shares)) / shares.sum() * sums[-1], sums, curve_at)
    at[0], at[-1] = curve_at[0], curve_at[-1]
    return np.asarray(at)


def _points(curve: np.ndarray, curve_at: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(at, curve_at, column) for column in curve.T], axis=1)
