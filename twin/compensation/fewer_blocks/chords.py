"""Blocks from a curve: as few straight ones as keep to the polyline the curve was fitted to.

The vertices are spread so that every chord asks the same of the tolerance, and moved off the curve to the outside until vertex and
middle of a chord are as far from it: chords with their ends on the curve lie wholly to one side and use half of what they may.
Half the mean height of its two chords outside, every vertex is as far from the curve as the middles are then left. At the ends, which
stay, the chord next to them has more left and is a little shorter.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.compensation.fewer_blocks.distance import apart
from twin.compensation.fewer_blocks.fit import Polyline, Tool

OUTWARD: Final = 0.25
"""Of the heights of both chords at a vertex: half their mean."""
END: Final = 0.845
"""√(5/7): first and last chord against the others, for the same left in the middle of each: e²(1 − 1/8) − 1/8 = 1/2."""
SAMPLES: Final = 16
"""Places a chord at which its distance is taken."""
GROWTH: Final = 1.15


def few_blocks(
    line: Polyline, curve: np.ndarray, curve_at: np.ndarray, tool: Tool, allowed_mm: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """The vertices behind the first of the fewest straight blocks that stay near a polyline.

    Args:
        line: the polyline; its vertices in the words in which the blocks are straight.
        curve: (n, axes) such words of a curve near it, dense; it begins and ends where the line does.
        curve_at: (n,) their parameters along the line.
        tool: such words to places at the tool.
        allowed_mm: how far blocks and polyline may be apart.

    Returns:
        (m, axes) words, the last that of the line itself, their (m+1,) parameters from the start on, and how far apart they are, mm;
        None where that takes as many blocks as the line has.
    """
    most = len(line.words) - 2
    sums = _demand(curve, curve_at, tool)
    still = np.ptp(line.words, axis=0) == 0.0
    low, high, best = 0, most + 1, None
    # A chord may take twice the tolerance from its outside to its middle: √(c/(16 a)) chords a unit.
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
    """Places on straight blocks, ``parts`` a block, and their parameters."""
    share = np.arange(parts) / parts
    dense = words[:-1, None, :] + share[:, None] * np.diff(words, axis=0)[:, None, :]
    dense_at = at[:-1, None] + share * np.diff(at)[:, None]
    return np.concatenate([dense.reshape(-1, words.shape[1]), words[-1:]]), np.append(dense_at.ravel(), at[-1])


def _demand(curve: np.ndarray, at: np.ndarray, tool: Tool) -> np.ndarray:
    """(n,) ∫ √|c|, c what a short straight block is off at the tool, in its middle, by h²/8: the second derivative across."""
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
    # Where nothing bends a block still has to go somewhere: a thousandth of all it takes, spread evenly.
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
    """So many blocks, if they stay within the tolerance."""
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
    off = apart(places, dense_at, line.dense_tool, line.dense_at, allowed_mm, allowed_mm)
    return (words[1:], at, off) if off <= allowed_mm else None


def _spread(sums: np.ndarray, curve_at: np.ndarray, count: int) -> np.ndarray:
    """(count+1,) parameters of vertices that share the demand out evenly, the first and last chord a little less."""
    shares = np.full(count, 1.0)
    if count > 2:
        shares[[0, -1]] = END
    at = np.interp(np.append(0.0, np.cumsum(shares)) / shares.sum() * sums[-1], sums, curve_at)
    at[0], at[-1] = curve_at[0], curve_at[-1]
    return np.asarray(at)


def _points(curve: np.ndarray, curve_at: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(at, curve_at, column) for column in curve.T], axis=1)
