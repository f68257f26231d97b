"""Small pictures as inline SVG: a curve over an axis with its 95 % band, and a histogram. No library: every display has them."""

from __future__ import annotations

import html
from typing import Final

import numpy as np

from twin.display.markup import ACCENT, Html
from twin.display.numbers import ceiling, ticks

_WIDTH: Final = 380
_HEIGHT: Final = 190
_LEFT: Final = 52
_BOTTOM: Final = 40
_TOP: Final = 12
_RIGHT: Final = 14
_HOLLOW: Final = f"fill='none' stroke='{ACCENT}' stroke-width='1.6' vector-effect='non-scaling-stroke'"
_FAINT: Final = "stroke='currentColor' stroke-opacity='.35' vector-effect='non-scaling-stroke'"


def strip(values: np.ndarray, half: np.ndarray | None, limit: float, says: str) -> Html:
    """A curve as a strip, a line through zero; its scale is said beside it.

    Args:
        values: (n,) at equal steps.
        half: (n,) half widths of its interval; None or NaN where they are not known.
        limit: what the upper edge is, in the unit of the values; the lower edge is as far below zero.
        says: for whoever cannot see it.
    """
    x = np.linspace(0.0, 100.0, len(values))

    def y(v: np.ndarray) -> np.ndarray:
        return np.asarray(18.0 - 17.0 * np.clip(v / limit, -1.0, 1.0))

    band = ""
    if half is not None and np.isfinite(half).all():
        ring = np.concatenate([np.column_stack([x, y(values + half)]), np.column_stack([x, y(values - half)])[::-1]])
        band = f"<polygon points='{_points(ring)}' fill='{ACCENT}' fill-opacity='.28'/>"
    return Html(
        "<svg viewBox='0 0 100 36' preserveAspectRatio='none' role='img' style='width:100%;height:36px;display:block'>"
        f"<title>{html.escape(says)}</title><line x1='0' x2='100' y1='18' y2='18' {_FAINT}/>{band}"
        f"<polyline points='{_points(np.column_stack([x, y(values)]))}' {_HOLLOW}/></svg>"
    )


def graph(q: np.ndarray, values: np.ndarray, half: np.ndarray | None, across: str, up: str) -> Html:
    """A curve with axes.

    Args:
        q: (n,) positions, ascending.
        values: (n,) there.
        half: (n,) half widths of its 95 % interval; None or NaN where they are not known.
        across: what the horizontal axis is, with its unit.
        up: what the vertical one is, with its unit.
    """
    known = half is not None and bool(np.isfinite(half).all())
    spread = half if known and half is not None else np.zeros_like(values)
    limit = ceiling(float(np.max(np.abs(values) + spread)))
    low, high = float(q[0]), float(q[-1])

    def place(at: np.ndarray, value: np.ndarray) -> np.ndarray:
        x = _LEFT + (at - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT)
        return np.column_stack([x, _height(value, -limit, limit)])

    band = ""
    if known:
        ring = np.concatenate([place(q, values + spread), place(q, values - spread)[::-1]])
        band = f"<polygon points='{_points(ring)}' fill='{ACCENT}' fill-opacity='.28'/>"
    line = f"<polyline points='{_points(place(q, values))}' {_HOLLOW}/>"
    return _framed(low, high, -limit, limit, across, up, f"{up} over {across}", band + line)


def histogram(values: np.ndarray, across: str, up: str = "poses", bins: int = 20) -> Html:
    """How values are spread, from zero on; nothing where there is none that is a number.

    Args:
        values: (n,) none negative.
        across: what they are, with unit.
        up: what is counted.
        bins: how many columns.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return Html("")
    top = max(float(known.max()), 1e-9)
    counts, edges = np.histogram(known, bins=bins, range=(0.0, top))
    most = float(counts.max())
    inner = (_WIDTH - _LEFT - _RIGHT) / top
    columns = []
    for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
        y = float(_height(np.array(float(count)), 0.0, most))
        x, width = _LEFT + low * inner, (high - low) * inner
        columns.append(
            f"<rect x='{x:.1f}' y='{y:.1f}' width='{max(width - 1.0, 0.5):.1f}' height='{_HEIGHT - _BOTTOM - y:.1f}' fill='{ACCENT}'/>"
        )
    return _framed(0.0, top, 0.0, most, across, up, f"{up} by {across}", "".join(columns))


def _height(value: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.asarray(_HEIGHT - _BOTTOM - (value - low) / (high - low) * (_HEIGHT - _BOTTOM - _TOP))


def _framed(low: float, high: float, bottom: float, top: float, across: str, up: str, says: str, inside: str) -> Html:
    """What is drawn, with ticks, and a name and unit for both axes."""
    text = "fill='currentColor' font-size='11' font-family='inherit'"
    parts = []
    for value in ticks(low, high):
        x = _LEFT + (value - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT)
        parts.append(
            f"<line x1='{x:.1f}' x2='{x:.1f}' y1='{_HEIGHT - _BOTTOM}' y2='{_HEIGHT - _BOTTOM + 4}' {_FAINT}/>"
        )
        parts.append(
            f"<text x='{x:.1f}' y='{_HEIGHT - _BOTTOM + 15}' text-anchor='middle' {text}>{_number(value)}</text>"
        )
    for value in ticks(bottom, top):
        y = float(_height(np.array(value), bottom, top))
        parts.append(f"<line x1='{_LEFT}' x2='{_WIDTH - _RIGHT}' y1='{y:.1f}' y2='{y:.1f}' {_FAINT}/>")
        parts.append(f"<text x='{_LEFT - 5}' y='{y + 4:.1f}' text-anchor='end' {text}>{_number(value)}</text>")
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    height = (_HEIGHT - _BOTTOM + _TOP) / 2
    parts.append(f"<text x='{middle}' y='{_HEIGHT - 6}' text-anchor='middle' {text}>{html.escape(across)}</text>")
    parts.append(
        f"<text transform='translate(12 {height}) rotate(-90)' text-anchor='middle' {text}>{html.escape(up)}</text>"
    )
    return Html(
        f"<svg viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img' style='width:{_WIDTH}px;max-width:100%;height:auto;display:block'>"
        f"<title>{html.escape(says)}</title>{''.join(parts)}{inside}</svg>"
    )


def _number(value: float) -> str:
    return f"{value + 0.0:.6g}".replace("-", "−")


def _points(points: np.ndarray) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
