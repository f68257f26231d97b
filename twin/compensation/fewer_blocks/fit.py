"""Fit piecewise fg-Bernstein curves to a polyline, with as few control points as keep within a tolerance.

All fits of a degree use the same nodes, so the matrix from points to control points is computed once per degree with high relative
accuracy (`twin.numerics.curves.fg_bernstein`; Díaz Pérez et al. 2019, eq. 13–14), and a fit is a matrix product. End points, and the
tangent at a joint, are exact constraints: the least-squares curve with some control points fixed is c + G Cᵀ (C G Cᵀ)⁻¹ (b − C c),
G = (AᵀA)⁻¹ = A⁺A⁺ᵀ (Björck 1996, ch. 5).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin.compensation.fewer_blocks.distance import largest_distance, lengths
from twin.numerics.curves.fg_bernstein import FGBernstein

Kind = Literal["polynomial", "trigonometric"]
CANDIDATES: Final[tuple[tuple[Kind, int], ...]] = (
    ("polynomial", 1),
    ("trigonometric", 2),
    *(("polynomial", degree) for degree in (2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26)),
)
"""Bases and degrees tried from every joint. The trigonometric functions of degree 2 describe a circular arc, here over the angle
through which the blocks turn.
"""
HOPELESS: Final = 5
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
PARTS: Final = 4
"""Points per input block at which distances are evaluated."""

Tool = Callable[[np.ndarray], np.ndarray]
"""Function from (n, axes) words to (n, k) coordinates at the tool, mm: the point, and rotary words times the lever."""


@lru_cache(maxsize=256)
def _solver(basis: FGBernstein) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for a basis: nodes (m,), A⁺ (degree+1, m), and G = A⁺A⁺ᵀ.

    With Chebyshev nodes, least squares is close to the smallest maximum deviation.
    """
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
    """A polyline with derived quantities that are needed repeatedly.

    Attributes:
        words: (n, axes) its vertices.
        at: (n,) their parameters, from 0.
        size: (n−1,) lengths of its blocks at the tool, mm.
        turned: (n,) sum of the bends up to and including each vertex, rad.
        dense: ((n−1)·PARTS+1, axes) vertices and points between.
        dense_at: their parameters.
        dense_tool: their coordinates at the tool.
    """

    words: np.ndarray
    at: np.ndarray
    size: np.ndarray
    turned: np.ndarray
    dense: np.ndarray
    dense_at: np.ndarray
    dense_tool: np.ndarray

    @classmethod
    def of(cls, words: np.ndarray, tool: Tool, power: float = 1.0) -> Polyline:
        """Create a polyline from (n, axes) vertices, n ≥ 2, consecutive ones distinct at the tool.

        Args:
            words: the vertices.
            tool: function from words to coordinates at the tool.
            power: the parameter grows from vertex to vertex by the distance at the tool to this power.
        """
        share = np.arange(PARTS) / PARTS
        between = words[:-1, None, :] + share[:, None] * np.diff(words, axis=0)[:, None, :]
        dense = np.concatenate([between.reshape(-1, words.shape[1]), words[-1:]])
        places = tool(dense)
        way = lengths(places)
        at = np.append(0.0, np.cumsum(np.diff(way[::PARTS]) ** power))
        dense_at = np.append((at[:-1, None] + share * np.diff(at)[:, None]).ravel(), at[-1:])
        chords = np.diff(places[::PARTS], axis=0)
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
    """One fg-Bernstein curve between two vertices.

    Attributes:
        first, last: indices of its first and last vertex.
        basis: its basis functions.
        control: (degree+1, axes) control points, words.
        fit_mm: largest distance from the polyline at the tool, in both directions.
    """

    first: int
    last: int
    basis: FGBernstein
    control: np.ndarray
    fit_mm: float

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
    """Fits curves to one smooth stretch.

    Args:
        line: its blocks.
        tool: function from words to coordinates at the tool.
        allowed_mm: largest distance allowed between curve and polyline.
    """

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
        found: list[CurvePiece] = []
        first, tangent, skip = 0, None, 0
        while first < self.end:
            best = self._best(first, tangent)
            if best is None:
                # No curve saves blocks, or none keeps the tangent: keep some blocks, then start without a tangent.
                skip = min(max(2 * skip, 1), MOST_SKIPPED)
                found += [self._block(vertex) for vertex in range(first, min(first + skip, self.end))]
                first, tangent = found[-1].last, None
                continue
            found.append(best)
            first, tangent, skip = best.last, self._end_tangent(best), 0
        while len(found) > 1 and found[-2].blocks > 1:
            before = self._end_tangent(found[-3]) if len(found) > 2 else None
            cost = found[-2].degree + found[-1].degree
            joined = self._lowest_degree(found[-2].first, before, most=cost - 1)
            if joined is None:
                break
            found[-2:] = [joined]
        return found

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
                if degree >= HOPELESS and not candidates:
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
            found = self._fit(first, self.end, "polynomial", middle, tangent)
            low, best = (middle, best) if found is None else (low, found)
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
        part = slice(first * PARTS, last * PARTS + 1)
        count = _rounded_up(max(32, PARTS * (last - first)))
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
