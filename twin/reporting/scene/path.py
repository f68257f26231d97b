"""Arrays for the animation of a program: keyframes, exaggerated path with colours, arrows at selected blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.errors import InputError

MAX_KEYFRAMES = 600
MAX_POINTS = 4000
"""Largest number of points of the drawn path, for smooth rotation in a browser and a small file."""
STEP = 5.0
"""Largest travel of an axis between two points of the drawn path, mm or degrees."""
CHORD_MM = 0.01
"""Largest distance of a point that is not drawn from the line between its neighbours."""
RAPID_SPEED = 3.0
"""Speed of a rapid move in the animation, relative to a cutting move."""
JUMP_SHARE = 1e-5
"""Duration of a gap in the animation, as a share of the whole: less than a frame of a browser."""
SHOWN_SHARE = 0.08
"""Approximate length of the largest deviation as drawn, as a share of the path's extent."""

# Viridis (CC0, Smith and van der Walt) at 0, 1/8 … 1: perceptually uniform and readable without colour vision.
_VIRIDIS = "440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725"


@final
@dataclass(frozen=True)
class ScenePath:
    """Tool path to show, point by point."""

    positions: np.ndarray  # (n, axes) commands, mm and degrees, command order
    nominal_mm: np.ndarray  # (n, 3) intended tool points in the work frame
    actual_mm: np.ndarray  # (n, 3) tool points reached, in the work frame
    cutting: np.ndarray  # (n,) whether the move that ends at a point cuts; False for rapids
    lines: np.ndarray  # (n,) program line numbers
    gaps: np.ndarray  # (n,) whether the way to a point from the one before is unknown; it is neither drawn nor animated

    def check(self, axes: int) -> None:
        """Raise `InputError` unless there are points, all finite, and the arrays fit each other and the number of axes."""
        count = len(self.positions)
        if count == 0:
            raise InputError("nothing to show", expected="a program with at least one motion")
        rest = {"positions": (axes,), "nominal_mm": (3,), "actual_mm": (3,), "cutting": (), "lines": (), "gaps": ()}
        for name, of_one in rest.items():
            array, shape = np.asarray(getattr(self, name)), (count, *of_one)
            if array.shape != shape:
                raise InputError(f"{name} has the wrong shape", expected=str(shape), value=array.shape)
            if not np.all(np.isfinite(array)):
                wrong = array[~np.isfinite(array)][0]
                raise InputError(f"{name} contains a value that is not finite", expected="finite values", value=wrong)

    @cached_property
    def deviation_um(self) -> np.ndarray:
        """(n,) distance of the point reached from the intended one, µm."""
        return np.asarray(np.linalg.norm(self.actual_mm - self.nominal_mm, axis=1) * 1e3)

    @cached_property
    def counted(self) -> np.ndarray:
        """(n,) whether a point counts for the statistics: points of cutting moves, or all if there are none."""
        return self.cutting.astype(bool) if np.any(self.cutting) else np.ones(len(self.cutting), dtype=bool)

    @cached_property
    def worst(self) -> int:
        """Index of the counted point with the largest deviation."""
        return int(np.argmax(np.where(self.counted, self.deviation_um, -1.0)))

    @property
    def max_um(self) -> float:
        """Largest deviation of the counted points, µm."""
        return float(self.deviation_um[self.worst])

    @property
    def rms_um(self) -> float:
        """Root mean square deviation of the counted points, µm."""
        return float(np.sqrt(np.mean(self.deviation_um[self.counted] ** 2)))

    @cached_property
    def extent_mm(self) -> float:
        """Diagonal of the bounding box of the counted nominal points, mm."""
        return float(np.linalg.norm(np.ptp(self.nominal_mm[self.counted], axis=0)))

    def drawn(self) -> ScenePath:
        """Return the points needed to draw the path: ends of lines and gaps, points every `STEP` or off the chord, the worst."""
        last = np.append(np.flatnonzero(np.diff(self.lines)), len(self.lines) - 1)
        of = np.searchsorted(last, np.arange(len(self.lines)))
        begin, end = self.nominal_mm[np.append(0, last[:-1])[of]], self.nominal_mm[last[of]]
        chord, way = end - begin, self.nominal_mm - begin
        share = np.einsum("ij,ij->i", way, chord) / np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-12)
        off = np.linalg.norm(way - share[:, None] * chord, axis=1)
        far = np.abs(np.diff(self.positions, axis=0, prepend=self.positions[:1])).max(axis=1)
        keep = (off > CHORD_MM) | (np.diff(np.floor(np.cumsum(far) / STEP), prepend=-1.0) > 0)
        keep[last] = keep[self.worst] = keep[0] = True
        keep |= self.gaps | np.append(self.gaps[1:], False)
        return ScenePath(
            self.positions[keep],
            self.nominal_mm[keep],
            self.actual_mm[keep],
            self.cutting[keep],
            self.lines[keep],
            self.gaps[keep],
        )

    def shown_mm(self, exaggeration: float) -> np.ndarray:
        """Return (n, 3) nominal points plus the exaggerated deviation, mm."""
        return np.asarray(self.nominal_mm + exaggeration * (self.actual_mm - self.nominal_mm))


@final
@dataclass(frozen=True)
class Keyframes:
    """Keyframes of the animation."""

    share: np.ndarray  # (m,) time as a share of the duration, 0 … 1, strictly increasing
    positions: np.ndarray  # (m, axes) commands, mm and degrees
    deviation_um: np.ndarray  # (m,) deviation at the tool
    block: np.ndarray  # (m,) index of the next point of the path


def keyframes(path: ScenePath, linear: tuple[int, ...], rotary: tuple[int, ...]) -> Keyframes:
    """Return at most `MAX_KEYFRAMES` keyframes at constant speed, rapid moves `RAPID_SPEED` times faster.

    The points of the path are kept if they do not exceed that number, else those at gaps. Further keyframes are spread evenly between
    them. One degree counts as one millimetre, so that a pure rotation also takes time. The machine jumps over gaps.
    """
    steps = np.diff(path.positions, axis=0)
    way = np.linalg.norm(steps[:, list(linear)], axis=1) + np.linalg.norm(steps[:, list(rotary)], axis=1)
    way = np.where(path.gaps[1:], 0.0, np.where(path.cutting[1:], way, way / RAPID_SPEED))
    along = np.concatenate([[0.0], np.cumsum(np.where(path.gaps[1:], JUMP_SHARE * way.sum(), way))])
    # A step below the rounding of the sum would give two keyframes at the same time.
    kept = np.concatenate([[0], 1 + np.flatnonzero(np.diff(along) > 1e-12 * max(along[-1], 1e-300))])
    if len(kept) < 2:
        return Keyframes(np.zeros(1), path.positions[:1], path.deviation_um[:1], np.zeros(1, dtype=int))
    knots = along[kept]
    jumps = path.gaps[kept[1:]]
    at_gaps = np.append(True, jumps) | np.append(jumps, True)
    fixed = next(some for some in (knots, knots[at_gaps], knots[[0, -1]]) if len(some) <= MAX_KEYFRAMES)
    inner = np.floor((MAX_KEYFRAMES - len(fixed)) * np.diff(fixed) / knots[-1]).astype(int)
    parts = [np.linspace(a, b, n + 1, endpoint=False) for a, b, n in zip(fixed[:-1], fixed[1:], inner, strict=True)]
    moments = np.concatenate([*parts, fixed[-1:]])
    positions = np.column_stack([np.interp(moments, knots, column) for column in path.positions[kept].T])
    following = np.minimum(np.searchsorted(knots, moments, side="left"), len(kept) - 1)
    return Keyframes(
        moments / knots[-1], positions, np.interp(moments, knots, path.deviation_um[kept]), kept[following]
    )


def chosen_exaggeration(path: ScenePath) -> float:
    """Return the factor, 1, 2 or 5 · 10ⁿ ≥ 1, that draws the largest deviation at about `SHOWN_SHARE` of the path's extent."""
    if path.max_um <= 0.0 or path.extent_mm <= 0.0:
        return 1.0
    return max(1.0, rounded_125(SHOWN_SHARE * path.extent_mm / (path.max_um * 1e-3)))


def rounded_125(value: float) -> float:
    """Return the number of the series 1, 2, 5, 10 … with the ratio to a positive value closest to 1."""
    decade = 10.0 ** math.floor(math.log10(value))
    return min((step * decade for step in (1.0, 2.0, 5.0, 10.0)), key=lambda step: abs(math.log(step / value)))


def scale_top_um(largest_um: float) -> float:
    """Return the end of the colour scale, a round number at or above the largest deviation; 1 µm for zero deviation."""
    if largest_um <= 0.0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(largest_um))
    # Tolerance of 1e-9: a maximum that equals a round number, except for rounding errors, is the end of the scale.
    steps = (1.0, 1.2, 1.6, 2.0, 2.4, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * decade for step in steps if step * decade >= largest_um * (1 - 1e-9))


def viridis(share: np.ndarray) -> np.ndarray:
    """Return (n, 3) colours, 0 … 1, for (n,) shares of the scale."""
    colours = np.array([list(bytes.fromhex(colour)) for colour in _VIRIDIS.split()]) / 255.0
    at = np.linspace(0.0, 1.0, len(colours))
    return np.column_stack([np.interp(share, at, channel) for channel in colours.T])


def runs(wanted: np.ndarray) -> list[np.ndarray]:
    """Return the point indices of every run of moves that are (n,) wanted, the point before the first included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wanted[1:], [False]]).astype(int)))
    return [np.arange(start, stop + 1) for start, stop in edges.reshape(-1, 2)]


def thinned(pieces: list[np.ndarray], limit: int, keep: int) -> list[np.ndarray]:
    """Return the runs reduced to about ``limit`` points in total; end points and the point ``keep`` are retained."""
    total = sum(len(piece) for piece in pieces)
    if total <= limit:
        return pieces
    thinned = []
    for piece in pieces:
        count = max(2, round(limit * len(piece) / total))
        chosen = piece[np.unique(np.round(np.linspace(0, len(piece) - 1, min(count, len(piece)))).astype(int))]
        thinned.append(np.unique(np.append(chosen, keep)) if piece[0] <= keep <= piece[-1] else chosen)
    return thinned


def arrow_blocks(path: ScenePath, count: int) -> np.ndarray:
    """Return indices of at most ``count`` counted points, evenly spaced along the path, including the worst."""
    counted = np.flatnonzero(path.counted)
    if count < 1:
        return counted[:0]
    steps = np.linalg.norm(np.diff(path.nominal_mm, axis=0, prepend=path.nominal_mm[:1]), axis=1)
    along = np.cumsum(np.where(path.counted & ~path.gaps, steps, 0.0))[counted]
    at = along[-1] * (np.arange(count - 1) + 0.5) / max(count - 1, 1)
    nearest = counted[np.minimum(np.searchsorted(along, at), len(counted) - 1)]
    return np.unique(np.append(nearest, path.worst))


@final
@dataclass(frozen=True)
class Mesh:
    """Triangle mesh with a colour at each vertex."""

    vertices: np.ndarray  # (v, 3) in the unit of the source points
    faces: np.ndarray  # (f, 3) vertex indices
    colours: np.ndarray  # (v, 3), 0 … 1


def joined(meshes: list[Mesh]) -> Mesh:
    """Return several meshes as one mesh."""
    if not meshes:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((0, 3)))
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
        np.concatenate([mesh.colours for mesh in meshes]),
    )


def tube(points: np.ndarray, radii: np.ndarray, colours: np.ndarray, sides: int) -> Mesh:
    """Return a tube along (k, 3) points with (k,) radii and (k, 3) colours, since lines in WebGL are always one pixel wide."""
    moves = np.diff(points, axis=0)
    lengths = np.linalg.norm(moves, axis=1)
    directions = np.where(lengths[:, None] > 0, moves / np.maximum(lengths, 1e-300)[:, None], 0.0)
    tangents = np.concatenate([directions[:1], directions[:-1] + directions[1:], directions[-1:]])
    frame = np.zeros((len(points), 2, 3))
    tangent = next((d for d in directions if np.any(d)), np.array([0.0, 0.0, 1.0]))
    side = np.cross(tangent, np.eye(3)[int(np.argmin(np.abs(tangent)))])
    for index, candidate in enumerate(tangents):
        size = float(np.linalg.norm(candidate))
        # At a full reversal or a repeated point the tangent is undefined: use the previous one.
        tangent = candidate / size if size > 1e-6 else tangent
        side = side - (side @ tangent) * tangent
        if np.linalg.norm(side) < 1e-6:
            side = np.cross(tangent, np.eye(3)[int(np.argmin(np.abs(tangent)))])
        side = side / np.linalg.norm(side)
        frame[index] = side, np.cross(tangent, side)
    angles = 2 * np.pi * np.arange(sides) / sides
    circle = np.cos(angles)[:, None] * frame[:, None, 0] + np.sin(angles)[:, None] * frame[:, None, 1]
    vertices = points[:, None] + radii[:, None, None] * circle
    first = (np.arange(len(points) - 1)[:, None] * sides + np.arange(sides)).ravel()
    turned = (np.arange(len(points) - 1)[:, None] * sides + (np.arange(sides) + 1) % sides).ravel()
    faces = np.concatenate(
        [np.column_stack([first, turned, turned + sides]), np.column_stack([first, turned + sides, first + sides])]
    )
    return Mesh(vertices.reshape(-1, 3), faces, np.repeat(colours, sides, axis=0))


def arrow(start: np.ndarray, end: np.ndarray, radius: float, colour: ArrayLike) -> Mesh:
    """Return an arrow from (3,) start to (3,) end."""
    length = float(np.linalg.norm(end - start))
    neck = start + (end - start) * max(0.4, 1.0 - 7.0 * radius / max(length, 1e-300))
    points = np.array([start, neck, neck, end])
    # The base of the head is slightly beyond the neck, so that the tube has a direction there.
    points[2] += 1e-4 * (end - start)
    return tube(points, radius * np.array([1.0, 1.0, 2.6, 0.0]), np.tile(colour, (4, 1)), 7)
