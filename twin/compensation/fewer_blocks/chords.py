"""Cut a curve into as few straight blocks as keep within a tolerance of the polyline to which the curve was fitted.

The vertices are spread so that every chord needs the same tolerance. Chords with both end points on the curve lie on one side of it and
use only half of the tolerance band. The vertices are therefore moved off the curve to the outside by half the mean height of their two
chords, so that vertices and chord middles are equally far from it. The end points of the curve stay fixed; the chords next to them
deviate more and are made slightly shorter.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.compensation.fewer_blocks.distance import largest_distance
from twin.compensation.fewer_blocks.fit import Polyline, Tool

OUTWARD: Final = 0.25
"""Outward shift of a vertex, as a fraction of the sum of both chord heights: half their mean."""
END_CHORD: Final = 0.845
"""√(5/7): length of first and last chord relative to the others, for the same deviation in the middle: e²(1 − 1/8) − 1/8 = 1/2."""
SAMPLES: Final = 16
"""Points per chord at which its distance is evaluated."""
GROWTH: Final = 1.15


def few_blocks(
    line: Polyline, curve: np.ndarray, curve_at: np.ndarray, tool: Tool, allowed_mm: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Return the vertices, without the first, of the fewest straight blocks that stay near a polyline.

    Args:
        line: the polyline; its vertices in the words in which the blocks are straight.
        curve: (n, axes) dense points of a curve near it in such words, with the same end points.
        curve_at: (n,) their parameters along the line.
        tool: function from such words to coordinates at the tool.
        allowed_mm: largest distance allowed between blocks and polyline.

    Returns:
        (m, axes) words, the last one that of the line; (m+1,) parameters from the start; largest distance in mm. None if as many blocks
        as the line has are needed.
    """
    most = len(line.words) - 2
    sums = _demand(curve, curve_at, tool)
    still = np.ptp(line.words, axis=0) == 0.0
    low, high, best = 0, most + 1, None
    # A chord may use twice the tolerance from its vertices to its middle: √(c/(16 a)) chords per unit.
    step = min(max(int(0.8 * sums[-1] / np.sqrt(16.0 * allowed_mm)), 1), most)
    while low < step < high:
        found = _blocks(line, curve, curve_at, sums, step, tool, allowed_mm, still)
        if found is None:
            low = step
            step = min(max(int(GROWTH * step), step + 1), most) if high > most else (low + high) // 2
        else:
            high, best = step, found
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
    dense, dense_at = between(words, at, SAMPLES)
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
