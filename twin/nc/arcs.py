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


class CentreWords(NamedTuple):
    """Meaning of I, J and K of an arc: the centre is ``of_start`` times its start plus ``sign`` times the words.

    Some postprocessors write the way from the centre to the start, others the place of the centre.
    """

    of_start: float
    sign: float
    meaning: str

    def centre(self, start: float, word: float) -> float:
        """Return a coordinate of the centre, mm."""
        return self.of_start * start + self.sign * word

    def word(self, start: float, centre: float) -> float:
        """Return the word of a coordinate of the centre, mm."""
        return (centre - self.of_start * start) / self.sign


FROM_START = CentreWords(1.0, 1.0, "the way from the start to the centre")
TO_START = CentreWords(1.0, -1.0, "the way from the centre to the start")
ABSOLUTE = CentreWords(0.0, 1.0, "the place of the centre")


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
    if not meets(start, end, centre):
        return ArcMisfit(
            f"the end point of the arc is {abs(first - last):.4f} mm off its circle of radius {first:.4f} mm",
            f"equal distances of start and end from the centre, within {SLACK_MM} mm or {100 * SLACK_RATIO:g} %",
        )
    if math.hypot(bx - ax, by - ay) < 1e-9:
        sweep = 2 * math.pi
    else:
        sweep = (math.atan2(by, bx) - math.atan2(ay, ax)) % (2 * math.pi)
        if clockwise:
            sweep = 2 * math.pi - sweep
    sweep += 2 * math.pi * turns
    return Arc(plane, centre, -sweep if clockwise else sweep)


def meets(start: tuple[float, float], end: tuple[float, float], centre: tuple[float, float]) -> bool:
    """Return whether both ends of an arc are equally far from its centre."""
    first, last = math.dist(start, centre), math.dist(end, centre)
    return not _misses(abs(first - last), max(first, last))


def centres_that_fit(
    start: tuple[float, float], end: tuple[float, float], words: tuple[float | None, float | None]
) -> list[CentreWords]:
    """Return the meanings of I, J, K under which an arc meets both of its ends, of the two which are not the usual one."""
    fitting = []
    for meaning in (TO_START, ABSOLUTE):
        about = [at if word is None else meaning.centre(at, word) for at, word in zip(start, words, strict=True)]
        if math.dist(start, about) > 10 * SLACK_MM and meets(start, end, (about[0], about[1])):
            fitting.append(meaning)
    return fitting


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


def arc_by_angle(
    plane: tuple[int, int, int], start: tuple[float, float], end: tuple[float, float], angle_deg: float, clockwise: bool
) -> Arc | ArcMisfit:
    """Return the arc between two points of the plane, mm, that turns by an angle between 0 and 360 degrees."""
    chord = math.dist(start, end)
    if not 0.0 < angle_deg < 360.0 or not chord > CIRCLE_MM:
        return ArcMisfit("arc by its angle", "an angle between 0 and 360 degrees, and an end apart from the start")
    way = (end[0] - start[0], end[1] - start[1])
    left = 0.5 / math.tan(math.radians(angle_deg) / 2.0) * (-1.0 if clockwise else 1.0)
    centre = (start[0] + 0.5 * way[0] - left * way[1], start[1] + 0.5 * way[1] + left * way[0])
    return arc_by_centre(plane, start, end, centre, clockwise)


def arc_through(
    plane: tuple[int, int, int], start: tuple[float, float], middle: tuple[float, float], end: tuple[float, float]
) -> Arc | ArcMisfit:
    """Return the arc from one point of the plane through another to a third, mm."""
    (ax, ay), (bx, by) = ((point[0] - start[0], point[1] - start[1]) for point in (middle, end))
    twice = 2.0 * (ax * by - ay * bx)
    if not abs(twice) > CIRCLE_MM * max(math.hypot(ax, ay), math.hypot(bx, by)):
        return ArcMisfit("arc through three points on a line, or two of them at one place", "three points of a circle")
    u = (by * (ax * ax + ay * ay) - ay * (bx * bx + by * by)) / twice
    v = (ax * (bx * bx + by * by) - bx * (ax * ax + ay * ay)) / twice
    return arc_by_centre(plane, start, end, (start[0] + u, start[1] + v), clockwise=twice < 0.0)


def turned_about(centre: tuple[float, float], point: tuple[float, float], angle_deg: float) -> tuple[float, float]:
    """Return a point of the plane turned about another, counterclockwise."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    x, y = point[0] - centre[0], point[1] - centre[1]
    return centre[0] + c * x - s * y, centre[1] + s * x + c * y
