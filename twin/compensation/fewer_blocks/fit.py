"""Curves near a polyline: piecewise fg-Bernstein, as few control points as stay within a tolerance of it.

One least-squares fit differs from the next in its points only: the nodes are the same for every fit of a degree, so the matrix that
makes control points of points is found once a degree, with high relative accuracy (`twin.numerics.curves.fg_bernstein`; Díaz Pérez
et al. 2019, eq. 13–14), and a fit is a product. End points, and the tangent at a joint, are held exactly: the least-squares curve
with some control points given is c + G Cᵀ (C G Cᵀ)⁻¹ (b − C c), G = (AᵀA)⁻¹ = A⁺A⁺ᵀ (Björck 1996, ch. 5).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import locked
from twin.compensation.fewer_blocks.distance import apart, lengths
from twin.numerics.curves.fg_bernstein import FGBernstein

Kind = Literal["polynomial", "trigonometric"]
CANDIDATES: Final[tuple[tuple[Kind, int], ...]] = (
    ("polynomial", 1),
    ("trigonometric", 2),
    *(("polynomial", degree) for degree in (2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 26)),
)
"""What is tried from every joint. The trigonometric functions of degree 2 are those of a circle, through as much as the blocks turn."""
HOPELESS: Final = 5
"""Where no curve up to this degree takes a block a control point, none of a higher one is tried."""
MOST_SKIPPED: Final = 8
"""Blocks left as they are before a curve is tried again, at most: where one is hopeless, the next few are."""
AT_LEAST: Final = 3
"""Control points a smooth rest of the stretch takes."""
LEAST_HALF_ANGLE_RAD: Final = 0.01
MOST_HALF_ANGLE_RAD: Final = 2.4
"""Half the angle of one arc; towards π its control points run away (f/g has a pole there)."""
NODES_A_POINT: Final = 6
"""Nodes a control point: more change a fit by less than the rounding of a program's words."""
PARTS: Final = 4
"""Places a block of the input at which distances are taken."""

Tool = Callable[[np.ndarray], np.ndarray]
"""(n, axes) words to (n, k) places at the tool, mm: the point, and rotary words times the lever."""


@lru_cache(maxsize=256)
def _solver(basis: FGBernstein) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a basis: nodes (m,), A⁺ (degree+1, m), and G = A⁺A⁺ᵀ.

    The nodes are those of Chebyshev: where they are, least squares is near to the least largest deviation.
    """
    count = NODES_A_POINT * (basis.degree + 1)
    nodes = (1.0 - np.cos(np.pi * (np.arange(count) + 0.5) / count)) / 2.0
    inverse = basis.least_squares(nodes, np.eye(count))
    return locked(nodes), inverse, locked(inverse @ inverse.T)


@lru_cache(maxsize=512)
def _values(basis: FGBernstein, count: int) -> np.ndarray:
    """(count+1, degree+1) values of the functions at even steps."""
    return basis.collocation(np.linspace(0.0, 1.0, count + 1))


@final
@dataclass(frozen=True)
class Polyline:
    """A polyline with what is asked of it again and again.

    Attributes:
        words: (n, axes) its vertices.
        at: (n,) their parameters, from 0.
        size: (n−1,) lengths of its blocks at the tool, mm.
        turned: (n,) sum of the bends up to and with each vertex, rad.
        dense: ((n−1)·PARTS+1, axes) vertices and places between.
        dense_at: their parameters.
        dense_tool: their places at the tool.
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
        """Of (n, axes) vertices, n ≥ 2, no two in a row alike at the tool.

        Args:
            words: the vertices.
            tool: words to places at the tool.
            power: from one vertex to the next the parameter grows by the way at the tool to this power.
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
        """The angle the line turns through between two vertices, as if its curvature went on through half the first and last block."""
        if last - first < 2:
            return 0.0
        whole = float(self.size[first:last].sum())
        inner = whole - float(self.size[first] + self.size[last - 1]) / 2.0
        return float(self.turned[last - 1] - self.turned[first]) * whole / inner

    def points(self, at: np.ndarray) -> np.ndarray:
        """(k, axes) words at places along it."""
        return np.stack([np.interp(at, self.dense_at, column) for column in self.dense.T], axis=1)


@final
@dataclass(frozen=True)
class CurvePiece:
    """One fg-Bernstein curve between two vertices.

    Attributes:
        first, last: indices of the vertices it goes from and to.
        basis: its functions.
        control: (degree+1, axes) control points, words.
        fit_mm: largest distance from the polyline at the tool, both ways.
    """

    first: int
    last: int
    basis: FGBernstein
    control: np.ndarray
    fit_mm: float

    @property
    def degree(self) -> int:
        """Its degree."""
        return self.basis.degree

    @property
    def blocks(self) -> int:
        """How many blocks it stands for."""
        return self.last - self.first


@final
class Fitter:
    """Fits one smooth stretch.

    Args:
        line: its blocks.
        tool: words to places at the tool.
        allowed_mm: how far curve and polyline may be apart.
    """

    def __init__(self, line: Polyline, tool: Tool, allowed_mm: float) -> None:
        self.line = line
        self.tool = tool
        self.allowed = allowed_mm
        self.end = len(line.words) - 1
        self._reach: dict[tuple[str, int], int] = {}

    def pieces(self) -> list[CurvePiece]:
        """Curves one after the other over the whole stretch, with common tangents where they meet.

        From every joint each degree is taken as far as it stays within the tolerance; the one that takes most blocks a control
        point goes on, unless one that ends the stretch costs less than that and what would then be left.
        """
        found: list[CurvePiece] = []
        first, tangent, skip = 0, None, 0
        while first < self.end:
            best = self._best(first, tangent)
            if best is None:
                # No curve is worth it, or none keeps the tangent: blocks as they are, and the next piece begins afresh.
                skip = min(max(2 * skip, 1), MOST_SKIPPED)
                found += [self._block(vertex) for vertex in range(first, min(first + skip, self.end))]
                first, tangent = found[-1].last, None
                continue
            found.append(best)
            first, tangent, skip = best.last, self._leaving(best), 0
        while len(found) > 1 and found[-2].blocks > 1:
            before = self._leaving(found[-3]) if len(found) > 2 else None
            cost = found[-2].degree + found[-1].degree
            joined = self._lowest(found[-2].first, before, most=cost - 1)
            if joined is None:
                break
            found[-2:] = [joined]
        return found

    def curve(self, pieces: list[CurvePiece], steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Words of the whole curve at ``steps`` or more steps a block, and the parameters they belong to."""
        words, at = [self.line.words[:1]], [self.line.at[:1]]
        for piece in pieces:
            count = _rounded_up(max(16, steps * piece.blocks))
            words.append((_values(piece.basis, count) @ piece.control)[1:])
            share = np.linspace(0.0, 1.0, count + 1)[1:]
            at.append(self.line.at[piece.first] + share * self._way(piece.first, piece.last))
        return np.concatenate(words), np.concatenate(at)

    def _block(self, first: int) -> CurvePiece:
        """A block as it is."""
        return CurvePiece(first, first + 1, FGBernstein(1), self.line.words[first : first + 2], 0.0)

    def _best(self, first: int, tangent: np.ndarray | None) -> CurvePiece | None:
        """The piece to go on with from a vertex; None if none stands for more blocks than it costs control points."""
        candidates: list[CurvePiece] = []
        for kind, degree in CANDIDATES:
            piece = self._farthest(first, kind, degree, tangent)
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
            candidates[-1] = self._lowest(first, tangent, most=candidates[-1].degree) or candidates[-1]

        def cost(piece: CurvePiece) -> float:
            """Control points to the end, if it went on as this piece does."""
            left = self.end - piece.last
            return piece.degree + (max(left * piece.degree / piece.blocks, AT_LEAST) if left else 0.0)

        return min(candidates, key=cost)

    def _leaving(self, piece: CurvePiece) -> np.ndarray:
        """(axes,) derivative of the words by the parameter at a piece's end."""
        slope = piece.basis.derivative(piece.control, np.array([1.0]))[0]
        return np.asarray(slope / self._way(piece.first, piece.last))

    def _way(self, first: int, last: int) -> float:
        return float(self.line.at[last] - self.line.at[first])

    def _farthest(self, first: int, kind: Kind, degree: int, tangent: np.ndarray | None) -> CurvePiece | None:
        """The longest piece of a degree, looked for from how far the last one of that degree went."""
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

    def _lowest(self, first: int, tangent: np.ndarray | None, *, most: int) -> CurvePiece | None:
        """A piece from a vertex to the end, of the lowest degree up to ``most`` that does, by bisection."""
        if most < 1:
            return None
        round_one = self._fit(first, self.end, "trigonometric", 2, tangent) if most >= 2 else None
        best = round_one or self._fit(first, self.end, "polynomial", most, tangent)
        low = 0
        while best is not None and best.degree - low > 1:
            middle = (low + best.degree) // 2
            found = self._fit(first, self.end, "polynomial", middle, tangent)
            low, best = (middle, best) if found is None else (low, found)
        return best

    def _fit(self, first: int, last: int, kind: Kind, degree: int, tangent: np.ndarray | None) -> CurvePiece | None:
        """The curve of a degree between two vertices, if it stays within the tolerance."""
        line = self.line
        half_angle = line.turning_rad(first, last) / 2.0 if kind == "trigonometric" else 0.0
        if kind == "trigonometric" and not LEAST_HALF_ANGLE_RAD < half_angle < MOST_HALF_ANGLE_RAD:
            return None
        basis = FGBernstein(degree, kind=kind, half_angle_rad=half_angle)
        ends = line.words[[first, last]]
        way = self._way(first, last)
        held, given = [0, degree], [ends[0], ends[1]]
        if tangent is not None:
            second = _second(basis, ends[0], way * tangent)
            if degree > 1:
                held.insert(1, 1)
                given.insert(1, second)
            elif float(np.linalg.norm(self.tool(second[None])[0] - self.tool(ends[1:])[0])) > self.allowed:
                return None
        if len(held) > degree:
            control = np.array(given)
        else:
            nodes, inverse, weights = _solver(basis)
            control = inverse @ line.points(line.at[first] + way * nodes)
            held_weights = weights[:, held]
            control = control + held_weights @ np.linalg.solve(held_weights[held], np.array(given) - control[held])
        still = np.ptp(line.words[first : last + 1], axis=0) == 0.0
        if kind == "polynomial":
            control[:, still] = ends[0, still]  # an axis that stands, stands
        control[[0, -1]] = ends
        part = slice(first * PARTS, last * PARTS + 1)
        count = _rounded_up(max(32, PARTS * (last - first)))
        curve = self.tool(_values(basis, count) @ control)
        at = line.at[first] + way * np.linspace(0.0, 1.0, count + 1)
        meant, meant_at, limit = line.dense_tool[part], line.dense_at[part], self.allowed
        off = apart(curve, at, meant, meant_at, limit, limit)
        return CurvePiece(first, last, basis, locked(control), off) if off <= self.allowed else None


def _second(basis: FGBernstein, start: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The second control point, for a start and a derivative there: y'(0) = n (f'(0) c_1 + g'(0) c_0)."""
    unit = np.zeros((basis.degree + 1, 2))
    unit[0, 0] = unit[1, 1] = 1.0
    back, forward = basis.derivative(unit, np.array([0.0]))[0]
    return np.asarray((slope - back * start) / forward)


def _rounded_up(count: int) -> int:
    """The next power of two, so that few tables of values are made."""
    return 1 << (count - 1).bit_length()
