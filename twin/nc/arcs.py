"""Geometry of circular blocks: from centre or radius, sense and full turns to an `Arc`."""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.nc.blocks import Arc

SLACK_MM = 0.02
SLACK_RATIO = 1e-3
SLACK_MOST_MM = 0.5
"""Tolerance of an arc's end point: 0.02 mm or 0.1 % of the radius, whichever is larger, but less than 0.5 mm."""

MOST_TURNS = 400
"""Full turns of an arc beyond which it is refused: threads and ramps have fewer, and each turn becomes many blocks."""

PLANES: dict[int, tuple[int, int, int]] = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}


CIRCLE_MM = 1e-6
"""Distance of the ends of a full circle that rounding may leave."""
HALF_CIRCLE_MM = 2e-11
"""Difference of a radius and half the chord that rounding may leave of half a circle."""


class ArcMisfit(NamedTuple):
    """Why a circular block has no valid arc: what is wrong, and what was expected."""

    what: str
    expected: str


def _misses(difference: float, radius: float) -> bool:
    return difference > SLACK_MOST_MM or (difference > SLACK_MM and difference > SLACK_RATIO * radius)


def arc_by_centre(
    plane: tuple[int, int, int],
    start: tuple[float, float],
    end: tuple[float, float],
    centre: tuple[float, float],
    clockwise: bool,
    turns: int = 0,
) -> Arc | ArcMisfit:
    """Return the arc about a centre with additional full turns; equal start and end make a full circle. Points are in the plane, mm."""
    ax, ay = start[0] - centre[0], start[1] - centre[1]
    bx, by = end[0] - centre[0], end[1] - centre[1]
    first, last = math.hypot(ax, ay), math.hypot(bx, by)
    if not (math.isfinite(first) and math.isfinite(last)):
        return ArcMisfit("circular block with an unknown start position", "an absolute position before it")
    if first < 1e-9:
        return ArcMisfit("arc of radius zero", "a centre different from the start point")
    if _misses(abs(first - last), max(first, last)):
        return ArcMisfit(
            f"the end point of the arc is {abs(first - last):.4f} mm off its circle of radius {first:.4f} mm",
            f"equal distances of start and end from the centre, within {SLACK_MM} mm or {100 * SLACK_RATIO:g} %"
            + _other_meaning(start, end, centre),
        )
    if math.hypot(bx - ax, by - ay) < 1e-9:
        sweep = 2 * math.pi
    else:
        sweep = (math.atan2(by, bx) - math.atan2(ay, ax)) % (2 * math.pi)
        if clockwise:
            sweep = 2 * math.pi - sweep
    sweep += 2 * math.pi * turns
    return Arc(plane, centre, -sweep if clockwise else sweep)


def _other_meaning(start: tuple[float, float], end: tuple[float, float], centre: tuple[float, float]) -> str:
    """Return which other meaning of a centre, of some postprocessors, would make the arc fit; empty if none does."""
    offset = centre[0] - start[0], centre[1] - start[1]
    meanings = {
        "the way from the centre to the start": (start[0] - offset[0], start[1] - offset[1]),
        "the place of the centre": offset,
    }
    for meaning, about in meanings.items():
        first, last = math.dist(start, about), math.dist(end, about)
        if first > 10 * SLACK_MM and not _misses(abs(first - last), max(first, last)):
            return f" (it would fit if I, J, K were {meaning})"
    return ""


def moved_centre(
    arc: Arc, end: tuple[float, float], new_start: tuple[float, float], new_end: tuple[float, float]
) -> tuple[float, float]:
    """Return the centre of an arc whose ends are moved by small amounts: by their mean, and then equally far from both new ends."""
    c, s = math.cos(arc.angle_rad), math.sin(arc.angle_rad)
    u, v = end[0] - arc.centre_mm[0], end[1] - arc.centre_mm[1]
    start = (arc.centre_mm[0] + c * u + s * v, arc.centre_mm[1] - s * u + c * v)
    guess = [arc.centre_mm[i] + 0.5 * (new_start[i] - start[i] + new_end[i] - end[i]) for i in (0, 1)]
    way = (new_end[0] - new_start[0], new_end[1] - new_start[1])
    length = math.hypot(*way)
    if length < CIRCLE_MM or math.hypot(end[0] - start[0], end[1] - start[1]) < CIRCLE_MM:
        return guess[0], guess[1]
    off = sum((guess[i] - 0.5 * (new_start[i] + new_end[i])) * way[i] for i in (0, 1)) / length**2
    return guess[0] - off * way[0], guess[1] - off * way[1]


def arc_by_radius(
    plane: tuple[int, int, int],
    start: tuple[float, float],
    end: tuple[float, float],
    radius: float,
    clockwise: bool,
    turns: int = 0,
) -> Arc | ArcMisfit:
    """Return the arc with a radius, mm: positive for up to half a circle, negative for more; see `arc_by_centre`."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    chord = math.hypot(dx, dy)
    if not math.isfinite(chord):
        return ArcMisfit("circular block with an unknown start position", "an absolute position before it")
    if chord < 1e-9:
        return ArcMisfit("arc by radius that ends where it starts", "a full circle given by its centre")
    size = abs(radius)
    if chord / 2 > size and _misses(chord / 2 - size, size):
        return ArcMisfit(f"radius {size:g} mm is too small for a chord of {chord:.4f} mm", "at least half the chord")
    gap = size - chord / 2
    # Half a circle: the ends are rounded, and the root would make nanometres of it.
    height = math.sqrt(gap * (size + chord / 2)) if gap > HALF_CIRCLE_MM else 0.0
    left = (radius > 0) != clockwise  # the centre lies left of the chord for a short counter-clockwise arc
    sign = 1.0 if left else -1.0
    centre = (start[0] + dx / 2 - sign * height * dy / chord, start[1] + dy / 2 + sign * height * dx / chord)
    return arc_by_centre(plane, start, end, centre, clockwise, turns)
