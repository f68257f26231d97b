"""Drilling cycles, expanded into the strokes that a control executes.

Sources: Fanuc Series 30i operator's manual and LinuxCNC G-code reference, "Canned cycles" (G73, G81 to G89); SINUMERIK 840D sl,
Programming Manual Cycles (CYCLE81 to CYCLE85, CYCLE89). Cycles that turn or stop the spindle in between (G76, G86 to G88, CYCLE86 to
CYCLE88) are not expanded. A thread is tapped by the control's own cycle, at a corrected position; the heights in the cycle are those of
the program with CYCLE84 and CYCLE840, and corrected, too, with G74 and G84.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from twin.nc.blocks import Kind

CLEARANCE_MM: Final = 0.5
"""Distance above the bottom of the hole at which a control begins to feed after a retract for chips (G73, G83, CYCLE83). Each control
has a parameter for it; the drilled hole does not depend on it.
"""
MOST_STROKES: Final = 400


class Thread(NamedTuple):
    """A thread that the control taps by a cycle of Fanuc, from a height and back to it.

    Attributes:
        code: its G code without G, one of `FANUC_TAPPING`.
        depth: height of the bottom, mm.
        top: height at which feeding begins, mm.
        words: the other words of the cycle.
    """

    code: str
    depth: float
    top: float
    words: str


class Stroke(NamedTuple):
    """One stroke of a cycle.

    Attributes:
        height: where it ends, mm; NaN if the axis does not move.
        kind: rapid or feed.
        feed: its feed word, if it differs from that of the block.
        after: a block to write after it (dwell, the cycle of a thread of SINUMERIK).
        thread: the thread to tap instead of a move.
    """

    height: float
    kind: Kind
    feed: str = ""
    after: str = ""
    thread: Thread | None = None


class Drilling(NamedTuple):
    """A drilling cycle executed at every following position.

    Attributes:
        strokes: what the drilling axis does, heights in mm in program coordinates.
        level: height at which a cycle ends that is left to the control (CYCLE84); NaN: that of the last stroke.
    """

    strokes: tuple[Stroke, ...]
    level: float = math.nan


FANUC: Final = frozenset({"73", "81", "82", "83", "85", "89"})
FANUC_TAPPING: Final = frozenset({"74", "84"})


def pecked(top: float, depth: float, step: float, *, full: bool) -> list[Stroke]:
    """Return the strokes of a hole drilled in steps.

    Args:
        top: height at which feeding begins.
        depth: height of the bottom.
        step: depth of a step, mm, positive.
        full: whether the drill leaves the hole after each step (G83), or only breaks the chip (G73).

    Raises:
        ValueError: more than `MOST_STROKES` strokes.
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


def of_fanuc(code: str, height: Mapping[str, float], dwell: str, retract: float, words: str) -> Drilling:
    """Return a cycle of Fanuc or LinuxCNC.

    Args:
        code: its G code without G, one of `FANUC` or `FANUC_TAPPING`.
        height: ``R`` and ``Z`` in mm, and ``Q``, the step of G73 and G83.
        dwell: value of ``P`` as written; empty if there is none.
        retract: height at which it ends (G98: initial level, G99: R).
        words: the words of a thread other than Z and R.

    Raises:
        ValueError: a value is missing or contradicts another, in words.
    """
    top, depth = height.get("R", math.nan), height.get("Z", math.nan)
    if not (math.isfinite(top) and math.isfinite(depth)):
        raise ValueError("R and Z")
    if depth >= top:
        raise ValueError("Z below R")
    step = height.get("Q", math.nan)
    if code in ("73", "83"):
        if not step > 0.0:
            raise ValueError("Q, the depth of a step")
        down = pecked(top, depth, step, full=code == "83")
    elif code in FANUC_TAPPING:
        down = [Stroke(math.nan, Kind.LINEAR, thread=Thread(code, depth, top, words))]
    else:
        down = [Stroke(depth, Kind.LINEAR)]
    if code in ("82", "89"):
        if not dwell:
            raise ValueError("P, the dwell")
        down[-1] = down[-1]._replace(after=f"G4 P{dwell}")
    up = [Stroke(top, Kind.LINEAR)] if code in ("85", "89") else []
    return Drilling((Stroke(top, Kind.RAPID), *down, *up, Stroke(retract, Kind.RAPID)))


def _sinumerik_81(top: float, depth: float, values: Sequence[float], texts: Sequence[str]) -> list[Stroke]:
    return [Stroke(depth, Kind.LINEAR, after=f"G4 F{texts[5]}" if values[5] > 0.0 else "")]


def _sinumerik_83(top: float, depth: float, values: Sequence[float], texts: Sequence[str]) -> list[Stroke]:
    first, relative, less, dwell, start_dwell, factor, full = values[5:12]
    if less or dwell or start_dwell or factor not in (0.0, 1.0) or full not in (0.0, 1.0) or any(texts[12:]):
        raise ValueError("steps of equal depth without dwell: DAM, DTB and DTS 0, FRF 1, VARI 0 or 1, nothing after it")
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
"""Number of arguments and strokes between the approach and the retract, by the cycle's name."""
SINUMERIK: Final = frozenset({*_SINUMERIK, "CYCLE84", "CYCLE840"})
SINUMERIK_TAPPING: Final = frozenset({"CYCLE84", "CYCLE840"})


def of_sinumerik(name: str, arguments: str, value_of: Callable[[str], float], unit_mm: float) -> Drilling:
    """Return a cycle of SINUMERIK: ``CYCLE81(RTP, RFP, SDIS, DP, DPR, …)``.

    Args:
        arguments: what stands between the parentheses.
        value_of: value of an argument in the program's units, NaN if unknown.
        unit_mm: the program's unit of length.

    Raises:
        ValueError: a cycle that is not expanded, or a value that is missing or contradicts another, in words.
    """
    texts = [part.strip() for part in arguments.split(",")]
    tapping = name in SINUMERIK_TAPPING
    if not tapping and name not in _SINUMERIK:
        raise ValueError("CYCLE81, CYCLE82, CYCLE83, CYCLE84, CYCLE85 or CYCLE89")
    most, inside = (30, None) if tapping else _SINUMERIK[name]
    if not 4 <= len(texts) <= most:
        raise ValueError(f"4 to {most} arguments")
    texts += [""] * (max(most, 6) - len(texts))
    values = [value_of(text) if text else 0.0 for text in texts]
    if not all(map(math.isfinite, values[:5] if tapping else values)):
        raise ValueError("arguments with known values")
    retract, reference, distance, depth = values[:4]
    if not texts[3]:
        depth = reference - abs(values[4])
    top = reference + abs(distance)
    if depth >= reference or retract < top:
        raise ValueError("a depth below the reference plane, and a retraction plane above both")
    if inside is None:
        return Drilling((Stroke(math.nan, Kind.RAPID, after=f"{name}({arguments})"),), retract * unit_mm)
    down = inside(top, depth, values, texts)
    scaled = [stroke._replace(height=stroke.height * unit_mm) for stroke in (Stroke(top, Kind.RAPID), *down)]
    return Drilling((*scaled, Stroke(retract * unit_mm, Kind.RAPID)))
