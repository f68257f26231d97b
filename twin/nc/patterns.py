"""Patterns of holes: rows, grids and circles; cycles 220 and 221 and ``PATTERN DEF`` of HEIDENHAIN.

Source: HEIDENHAIN TNC 640 and TNC 320, user's manuals "Cycle programming", chapters "Pattern definitions" and "Pattern definition
PATTERN DEF". The order of holes of ``PAT`` and ``FRAME`` may be another one on the control.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final

Places = list[tuple[float, float, float]]
"""Places of holes in the plane, and the shift of the surface there, mm."""

CYCLES: Final = frozenset({220, 221})
MOST_HOLES: Final = 400
_ELEMENT: Final = re.compile(r"(POS|ROW|PAT|FRAME|PITCHCIRC|CIRC)\d+[ \t]*\(([^()]*)\)", re.ASCII | re.IGNORECASE)
_WORD: Final = re.compile(
    r"(NUM[XY]?|ROT[XY]?|START|STEP|END|D[XY]?|[XYZ])[ \t]*([+-]?[ \t]*(?:[\d.,]+|Q[LR]?\d+))[ \t]*",
    re.ASCII | re.IGNORECASE,
)
_WORDS: Final[Mapping[str, frozenset[str]]] = {
    "POS": frozenset({"X", "Y", "Z"}),
    "ROW": frozenset({"X", "Y", "Z", "D", "NUM", "ROT"}),
    **dict.fromkeys(("PAT", "FRAME"), frozenset({"X", "Y", "Z", "DX", "DY", "NUMX", "NUMY", "ROT", "ROTX", "ROTY"})),
    "CIRC": frozenset({"X", "Y", "Z", "D", "START", "NUM"}),
    "PITCHCIRC": frozenset({"X", "Y", "Z", "D", "START", "STEP", "END", "NUM"}),
}


def of_cycle(number: int, values: Mapping[str, float], unit_mm: float) -> Places:
    """Return the places of a pattern 220 or 221 by its parameters; raise `ValueError`, in words, for one that is not known."""
    wanted = (
        ("Q216", "Q217", "Q244", "Q245", "Q246", "Q247", "Q241", "Q200", "Q203", "Q204")
        if number == 220
        else ("Q225", "Q226", "Q237", "Q238", "Q242", "Q243", "Q224", "Q200", "Q203", "Q204")
    )
    missing = [name for name in wanted if not math.isfinite(values.get(name, math.nan))]
    if missing:
        raise ValueError(f"{', '.join(missing)} in its definition, with known values")
    if values.get("Q365", 0.0) != 0.0:
        raise ValueError("Q365=0: straight moves between the holes")
    x, y, *rest = (values[name] for name in wanted[:7])
    if number == 220:
        diameter, start, stop, step, count = rest
        _count(count)
        if not step:
            whole = abs(abs(stop - start) - 360.0) < 1e-9
            step = (stop - start) / (count if whole else max(count - 1.0, 1.0))
        places = circle((x, y), 0.5 * diameter, start, step, int(count))
    else:
        dx, dy, columns, rows, turn = rest
        _count(columns, rows)
        places = grid((x, y), turn, dx, dy, int(columns), int(rows))
    return [(one * unit_mm, other * unit_mm, 0.0) for one, other in places]


def of_points(text: str, value_of: Callable[[str], float], unit_mm: float) -> Places:
    """Return the places of ``PATTERN DEF``; ``value_of``: of a number or a Q parameter. Errors as for `of_cycle`."""
    found = _ELEMENT.findall(text)
    if not found or _ELEMENT.sub("", text).split() != ["PATTERN", "DEF"]:
        raise ValueError("PATTERN DEF with POS, ROW, PAT, FRAME, CIRC or PITCHCIRC before it, and nothing else")
    places: Places = []
    for kind, body in found:
        words = {name.upper(): value_of(written) for name, written in _WORD.findall(body)}
        if _WORD.sub("", body).strip() or not words.keys() <= _WORDS[kind.upper()] or not {"X", "Y"} <= words.keys():
            raise ValueError(f"{kind} with X, Y and its own words")
        if not all(map(math.isfinite, words.values())) or words.get("ROTX") or words.get("ROTY"):
            raise ValueError(f"{kind} with known values, without ROTX and ROTY")
        places += _element(kind.upper(), words)
    return [(x * unit_mm, y * unit_mm, shift * unit_mm) for x, y, shift in places]


def _element(kind: str, words: Mapping[str, float]) -> Places:
    value = {
        name: words.get(name, 0.0) for name in ("Z", "D", "DX", "DY", "NUM", "NUMX", "NUMY", "ROT", "START", "STEP")
    }
    first, places = (words["X"], words["Y"]), [(words["X"], words["Y"])]
    if kind == "ROW":
        _count(value["NUM"])
        places = grid(first, value["ROT"], value["D"], 0.0, int(value["NUM"]), 1)
    elif kind in ("PAT", "FRAME"):
        _count(value["NUMX"], value["NUMY"])
        columns, rows = int(value["NUMX"]), int(value["NUMY"])
        places = grid(first, value["ROT"], value["DX"], value["DY"], columns, rows)
        order = [(column, row) for row in range(rows) for column in _columns(columns, row)]
        edge = ({0, columns - 1}, {0, rows - 1})
        frame = [place for place, at in zip(places, order, strict=True) if at[0] in edge[0] or at[1] in edge[1]]
        places = frame if kind == "FRAME" else places
    elif kind != "POS":
        _count(count := value["NUM"])
        step = value["STEP"] if kind == "PITCHCIRC" else 360.0 / count
        if kind == "PITCHCIRC" and "STEP" not in words:
            step = (words.get("END", math.nan) - value["START"]) / max(count - 1.0, 1.0)
        if step != step:
            raise ValueError("PITCHCIRC with STEP or END")
        places = circle(first, 0.5 * value["D"], value["START"], step, int(count))
    return [(x, y, value["Z"]) for x, y in places]


def _count(*counts: float) -> None:
    if not all(count == int(count) and 1 <= count <= MOST_HOLES for count in counts):
        raise ValueError(f"whole numbers of holes, 1 to {MOST_HOLES}")


# --- Places in the plane; angles in degrees

Point = tuple[float, float]


def circle(centre: Point, radius: float, start_deg: float, step_deg: float, count: int) -> list[Point]:
    """Return the places on a circle."""
    return [turned(centre, start_deg + i * step_deg, [(radius, 0.0)])[0] for i in range(count)]


def grid(first: Point, angle_deg: float, step: float, line: float, columns: int, rows: int) -> list[Point]:
    """Return the places of rows, every second one backwards, turned about the first place."""
    return turned(first, angle_deg, [(i * step, row * line) for row in range(rows) for i in _columns(columns, row)])


def _columns(count: int, row: int) -> range:
    return range(count) if row % 2 == 0 else range(count - 1, -1, -1)


def turned(origin: Point, angle_deg: float, points: Sequence[Point]) -> list[Point]:
    """Return points given from an origin, turned about it."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return [(origin[0] + c * u - s * v, origin[1] + s * u + c * v) for u, v in points]
