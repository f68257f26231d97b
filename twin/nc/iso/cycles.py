"""Drilling cycles, expanded into the strokes that a control executes, or left to it at a corrected place.

Sources: Fanuc Series 30i operator's manual, Haas mill operator's manual and LinuxCNC G-code reference, "Canned cycles" (G73, G74, G76,
G81 to G89); SINUMERIK 840D sl, Programming Manual Cycles (CYCLE81 to CYCLE89, CYCLE840, CYCLE801, HOLES1, HOLES2). The control itself
executes cycles that tap, or turn or stop the spindle in between: the tool goes to the corrected place of the height at which feeding
begins, and the heights of the cycle are shifted by the correction there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from twin.nc.blocks import Kind
from twin.nc.patterns import Point, circle, grid, turned

CLEARANCE_MM: Final = 0.5
"""Distance above the bottom of the hole at which a control begins to feed after a retract for chips (G73, G83, CYCLE83). Each control
has a parameter for it; the drilled hole does not depend on it.
"""
MOST_STROKES: Final = 400


class Kept(NamedTuple):
    """A cycle that the control executes from a height, and from which it returns to that height or to a level of its own.

    Attributes:
        top: height at which feeding begins, mm.
        parts: the text of the cycle: what is written as it is, and heights in mm.
        relative: the same where words are increments; None if the heights are absolute there, too.
        thread: whether it taps a thread of Fanuc, which may be rigid.
        exact: place of the height that is not rounded: its sum with another argument is the height at which feeding begins.
    """

    top: float
    parts: tuple[str | float, ...]
    relative: tuple[str | float, ...] | None = None
    thread: bool = False
    exact: int | None = None


class Stroke(NamedTuple):
    """One stroke of a cycle.

    Attributes:
        height: where it ends, mm; NaN if the axis does not move.
        feed: its feed word, if it differs from that of the block.
        after: a block to write after it (dwell).
        kept: the control's own cycle to execute instead of a move.
    """

    height: float
    kind: Kind
    feed: str = ""
    after: str = ""
    kept: Kept | None = None


class Drilling(NamedTuple):
    """A drilling cycle executed at every following position: its strokes, with heights in mm in program coordinates.

    ``level``: height at which a cycle ends that is left to the control (SINUMERIK); NaN: that of the last stroke.
    """

    strokes: tuple[Stroke, ...]
    level: float = math.nan


FANUC: Final = frozenset({"73", "81", "82", "83", "85", "89"})
FANUC_TAPPING: Final = frozenset({"74", "84", "84.2", "84.3"})
FANUC_KEPT: Final = FANUC_TAPPING | {"76", "86", "87", "88"}
"""Cycles left to the control: threads, and boring with a spindle that is turned or stopped at the bottom."""
FANUC_PECKING: Final = frozenset({"73", "83"})
"""Cycles in steps of Q; with Q0, of which a parameter of the control decides, they are left to it."""
FROM_INITIAL: Final = "87"
"""Cycle left to the control from the initial level on: back boring (Fanuc), whose R lies below the hole, or boring with a retract by
hand (Haas).
"""
FANUC_WORDS: Final[Mapping[str, str]] = {"76": "IJ", "87": "IJ"}
"""Words of a cycle beside Z, R, Q and P: the shift from the wall."""


def pecked(top: float, depth: float, step: float, *, full: bool) -> list[Stroke]:
    """Return the strokes from a height to the bottom of a hole in steps, mm; raise `ValueError` for more than `MOST_STROKES`.

    ``full``: whether the drill leaves the hole after each step (G83), or only breaks the chip (G73).
    """
    if (top - depth) / step > MOST_STROKES:
        raise ValueError(f"more than {MOST_STROKES} steps")
    strokes: list[Stroke] = []
    reached = top
    while True:
        reached = max(reached - step, depth)
        strokes.append(Stroke(reached, Kind.LINEAR))
        if reached <= depth + 1e-9:
            return strokes
        above = min(reached + CLEARANCE_MM, top)
        strokes += [Stroke(top, Kind.RAPID), Stroke(above, Kind.RAPID)] if full else [Stroke(above, Kind.RAPID)]


def of_fanuc(code: str, height: Mapping[str, float], dwell: str, retract: float, words: tuple[str, str]) -> Drilling:
    """Return a cycle of Fanuc, Haas or LinuxCNC; raise `ValueError`, in words, if a value is missing or contradicts another.

    ``code``: one of `FANUC` or `FANUC_KEPT`; ``height``: ``R``, the depth ``Z`` and the step ``Q`` of G73 and G83, mm; ``dwell``: ``P``
    as written, or empty; ``retract``: height at which it ends (G98: initial level, G99: R); ``words``: name of the drilling axis, and
    the words of a kept cycle other than depth and R.
    """
    top, depth = height.get("R", math.nan), height.get("Z", math.nan)
    if not (math.isfinite(top) and math.isfinite(depth)):
        raise ValueError("R and Z")
    if code == FROM_INITIAL:
        parts = (f"G98 G87 {words[0]}", depth, " R", top, f" {words[1]}" if words[1] else "")
        return Drilling((Stroke(math.nan, Kind.LINEAR, kept=Kept(retract, parts)),))
    if depth >= top:
        raise ValueError("Z below R")
    step = height.get("Q", math.nan)
    if code in FANUC_KEPT or (code in FANUC_PECKING and step == 0.0):
        head, tail = f"G99 G{code} {words[0]}", f" {words[1]}" if words[1] else ""
        relative = (f"{head}", depth - top, f" R0{tail}")
        kept = Kept(top, (head, depth, " R", top, tail), relative, code in FANUC_TAPPING)
        down = [Stroke(math.nan, Kind.LINEAR, kept=kept)]
    elif code in FANUC_PECKING:
        if not step > 0.0:
            raise ValueError("Q, the depth of a step")
        down = pecked(top, depth, step, full=code == "83")
    else:
        down = [Stroke(depth, Kind.LINEAR)]
    if code in ("82", "89") and dwell:
        down[-1] = down[-1]._replace(after=f"G4 P{dwell}")
    up = [Stroke(top, Kind.LINEAR)] if code in ("85", "89") else []
    return Drilling((Stroke(top, Kind.RAPID), *down, *up, Stroke(retract, Kind.RAPID)))


def _sinumerik_81(top: float, depth: float, values: Sequence[float], texts: Sequence[str]) -> list[Stroke]:
    return [Stroke(depth, Kind.LINEAR, after=f"G4 F{texts[5]}" if values[5] > 0.0 else "")]


def _sinumerik_83(top: float, depth: float, values: Sequence[float], texts: Sequence[str]) -> list[Stroke]:
    first, relative, less, dwell, start_dwell, factor, full = values[5:12]
    if less or dwell or start_dwell or factor not in (0.0, 1.0) or full not in (0.0, 1.0) or any(texts[12:]):
        return []
    reference = values[1]
    step = reference - first if texts[5] else abs(relative)
    if not step > 0.0:
        raise ValueError("FDEP or FDPR, the depth of the first step")
    start = [Stroke(max(reference - step, depth), Kind.LINEAR)]
    if start[0].height <= depth:
        return start
    above = min(start[0].height + CLEARANCE_MM, top)
    out = [Stroke(top, Kind.RAPID)] if full else []
    rest = pecked(start[0].height, depth, step, full=False)
    strokes = [*start, *out, Stroke(above, Kind.RAPID)]
    for stroke in rest:
        between = [Stroke(top, Kind.RAPID)] if full and stroke.kind is Kind.RAPID else []
        strokes += [*between, stroke]
    return strokes


def _sinumerik_85(top: float, depth: float, values: Sequence[float], texts: Sequence[str]) -> list[Stroke]:
    after = f"G4 F{texts[5]}" if values[5] > 0.0 else ""
    down, up = (f"F{text}" if text else "" for text in texts[6:8])
    return [Stroke(depth, Kind.LINEAR, down, after), Stroke(top, Kind.LINEAR, up)]


def _sinumerik_89(top: float, depth: float, values: Sequence[float], texts: Sequence[str]) -> list[Stroke]:
    return _sinumerik_85(top, depth, values, [*texts[:6], "", ""])


_SINUMERIK: Final[Mapping[str, tuple[int, Callable[[float, float, Sequence[float], Sequence[str]], list[Stroke]]]]] = {
    "CYCLE81": (5, _sinumerik_81),
    "CYCLE82": (6, _sinumerik_81),
    "CYCLE83": (16, _sinumerik_83),
    "CYCLE85": (8, _sinumerik_85),
    "CYCLE89": (6, _sinumerik_89),
}
"""Most arguments with which a cycle is expanded, and its strokes between the approach and the retract, none for other forms."""
_DRILLING_AXIS: Final[Mapping[str, int]] = {"CYCLE83": 12, "CYCLE84": 12, "CYCLE840": 11}
"""Place of the argument for the drilling axis: 1 or 2 is another axis than the third one of the plane."""
MOST_ARGUMENTS: Final = 40
_LENGTHS: Final = 7
"""Arguments that are lengths: those of every cycle, and the first depth of CYCLE83 (a dwell in its place is only compared with 0)."""
SINUMERIK: Final = frozenset({f"CYCLE{number}" for number in (*range(81, 90), 840)})


def of_sinumerik(name: str, arguments: str, value_of: Callable[[str], float], unit_mm: float) -> Drilling:
    """Return a cycle of SINUMERIK: ``CYCLE81(RTP, RFP, SDIS, DP, DPR, …)``; raise `ValueError`, in words, if it is not one.

    ``value_of``: value of an argument in the program's units of length (``unit_mm``), NaN if unknown.
    """
    texts = [part.strip() for part in arguments.split(",")]
    if name not in SINUMERIK:
        raise ValueError("CYCLE81 to CYCLE89, or CYCLE840")
    if not 4 <= len(texts) <= MOST_ARGUMENTS:
        raise ValueError(f"4 to {MOST_ARGUMENTS} arguments")
    count = len(texts)
    texts += [""] * (MOST_ARGUMENTS - count)
    values = [value_of(text) if text else 0.0 for text in texts]
    values[:_LENGTHS] = [value * unit_mm for value in values[:_LENGTHS]]
    if not all(map(math.isfinite, values[:5])):
        raise ValueError("arguments with known values")
    retract, reference, distance, depth = values[:4]
    top = reference + abs(distance)
    if not texts[3]:
        depth = reference - abs(values[4])
    if retract < top:
        raise ValueError("a retraction plane at the safety distance or above")
    place = _DRILLING_AXIS.get(name)
    if place is not None and values[place] not in (0.0, 3.0):
        raise ValueError("drilling along the third axis of the plane")
    most, inside = _SINUMERIK.get(name, (0, None))
    down: list[Stroke] = []
    if inside is not None and count <= most and all(map(math.isfinite, values)):
        if depth >= reference:
            raise ValueError("a depth below the reference plane, and a retraction plane above both")
        down = inside(top, depth, values, texts)
    approach = Stroke(top, Kind.RAPID)
    if not down:
        return Drilling((approach, _kept(name, texts[:count], values, top)), retract)
    return Drilling((approach, *down, Stroke(retract, Kind.RAPID)))


def _kept(name: str, texts: Sequence[str], values: Sequence[float], top: float) -> Stroke:
    """Return a cycle of SINUMERIK that is left to the control: its absolute heights are shifted, the other arguments are kept."""
    absolute = {0, 1, 3} | ({5} if name == "CYCLE83" else set())
    parts: list[str | float] = [f"{name}("]
    exact: int | None = None
    for place, text in enumerate(texts):
        parts.append(", " if place else "")
        if place in absolute and (text or place < 2):  # 0 is meant where the first two are empty
            if not math.isfinite(values[place]):
                raise ValueError("arguments with known values")
            exact = len(parts) if place == 1 else exact
            parts.append(values[place])
        else:
            parts.append(text)
    return Stroke(math.nan, Kind.LINEAR, kept=Kept(top, (*parts, ")"), exact=exact))


def _row(values: Sequence[float]) -> list[Point]:
    x, y, angle, first, step, count = values[:6]
    return turned((x, y), angle, [(first + i * step, 0.0) for i in range(int(count))])


def _circle(values: Sequence[float]) -> list[Point]:
    x, y, radius, first, step, count = values[:6]
    return circle((x, y), radius, first, step or 360.0 / count, int(count))


def _grid(values: Sequence[float]) -> list[Point]:
    x, y, angle, step, line, columns, rows = values[:7]
    return grid((x, y), angle, step, line, int(columns), int(rows))


_PATTERNS: Final[Mapping[str, tuple[int, Callable[[Sequence[float]], list[Point]]]]] = {
    "HOLES1": (6, _row),
    "HOLES2": (6, _circle),
    "CYCLE801": (7, _grid),
}
"""Number of arguments and places, in the plane, of a pattern of SINUMERIK."""
PATTERNS: Final = frozenset(_PATTERNS)


def places_of(name: str, arguments: str, value_of: Callable[[str], float], unit_mm: float) -> list[tuple[float, float]]:
    """Return the places of a pattern of holes in mm: ``HOLES1(SPCA, SPCO, STA1, FDIS, DBH, NUM)``, ``HOLES2``, ``CYCLE801``.

    Arguments and errors as for `of_sinumerik`.
    """
    texts = [part.strip() for part in arguments.split(",")]
    count, places = _PATTERNS[name]
    values = [value_of(text) if text else 0.0 for text in texts]
    values += [0.0] * (count - len(values))
    counts = values[5:count]
    if not all(map(math.isfinite, values[:count])) or any(set(texts[count:]) - {"", "0"}):
        raise ValueError(f"{count} arguments with known values")
    if not all(value == int(value) and 1 <= value <= MOST_STROKES for value in counts):
        raise ValueError(f"whole numbers of holes, 1 to {MOST_STROKES}")
    return [(u * unit_mm, v * unit_mm) for u, v in places(values)]
