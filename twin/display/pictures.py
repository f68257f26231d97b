"""Small pictures as inline SVG, without matplotlib: a curve with its 95 % band, and a histogram."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.display.markup import Html, part
from twin.display.numbers import ceiling, signed, ticks


@final
@dataclass(frozen=True)
class _Frame:
    """Size of a picture and position of its axes, in pixels."""

    width: int = 380
    height: int = 190
    left: int = 52
    right: int = 366
    top: int = 12
    bottom: int = 150


FRAME: Final = _Frame()


def strip(values: np.ndarray, half: np.ndarray | None, limit: float, says: str) -> Html:
    """Return a curve as a narrow strip with a zero line; the caller states the scale.

    Args:
        values: (n,) at equal steps.
        half: (n,) half widths of its 95 % interval; None or NaN if unknown.
        limit: value at the upper edge; the lower edge is its negative.
        says: alternative text.
    """
    x = np.linspace(0.0, 100.0, len(values))

    def place(v: np.ndarray) -> np.ndarray:
        return np.column_stack([x, 18.0 - 17.0 * np.clip(v / limit, -1.0, 1.0)])

    return part("strip", _points(place(values)), _band(place, values, half), says)


def graph(q: np.ndarray, values: np.ndarray, half: np.ndarray | None, across: str, up: str) -> Html:
    """Return a curve with axes.

    Args:
        q: (n,) positions, ascending.
        values: (n,) values at these positions.
        half: (n,) half widths of its 95 % interval; None or NaN if unknown.
        across: label of the horizontal axis, with unit.
        up: label of the vertical axis, with unit.
    """
    known = half is not None and bool(np.isfinite(half).all())
    spread = half if known and half is not None else np.zeros_like(values)
    limit = ceiling(float(np.max(np.abs(values) + spread)))
    low, high = float(q[0]), float(q[-1])

    def place(value: np.ndarray) -> np.ndarray:
        return np.column_stack([_across(q, low, high), _height(value, -limit, limit)])

    inside = part("curve", _points(place(values)), _band(place, values, half))
    return _framed((low, high), (-limit, limit), across, up, f"{up} over {across}", inside)


def histogram(values: np.ndarray, across: str, up: str = "poses", bins: int = 20) -> Html:
    """Return a histogram of values from zero on, or empty text if no value is finite.

    Args:
        values: (n,) non-negative values.
        across: label of the horizontal axis, with unit.
        up: label of the counts.
        bins: number of columns.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return Html("")
    top = max(float(known.max()), 1e-9)
    counts, edges = np.histogram(known, bins=bins, range=(0.0, top))
    most = float(counts.max())
    left, y = _across(edges, 0.0, top), _height(counts, 0.0, most)
    width, height = np.maximum(np.diff(left) - 1.0, 0.5), FRAME.bottom - y
    places = [tuple(f"{v:.1f}" for v in place) for place in zip(left[:-1], y, width, height, strict=True)]
    return _framed((0.0, top), (0.0, most), across, up, f"{up} by {across}", part("columns", places))


def _across(value: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.asarray(FRAME.left + (value - low) / (high - low) * (FRAME.right - FRAME.left))


def _height(value: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.asarray(FRAME.bottom - (value - low) / (high - low) * (FRAME.bottom - FRAME.top))


def _framed(
    ends: tuple[float, float], edges: tuple[float, float], across: str, up: str, says: str, inside: Html
) -> Html:
    """Return drawn content inside axes with ticks and labels."""
    x = [(f"{float(_across(np.array(v), *ends)):.1f}", _number(v)) for v in ticks(*ends)]
    heights = [(float(_height(np.array(v), *edges)), _number(v)) for v in ticks(*edges)]
    y = [(f"{at:.1f}", f"{at + 4:.1f}", text) for at, text in heights]
    return part("graph", FRAME, across, up, says, x, y, inside)


def _number(value: float) -> str:
    return signed(f"{value + 0.0:.6g}")


def _band(place: Callable[[np.ndarray], np.ndarray], values: np.ndarray, half: np.ndarray | None) -> str:
    """Return the outline of an interval band, or empty text if unknown."""
    if half is None or not np.isfinite(half).all():
        return ""
    return _points(np.concatenate([place(values + half), place(values - half)[::-1]]))


def _points(points: np.ndarray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
