"""Feed, spindle speed and dwell of a line of ISO code."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from twin.nc.iso import vocabulary
from twin.nc.technology import NOTHING, FeedUnit, LineWords
from twin.nc.text import number

_UNITS: Final = {"93": FeedUnit.INVERSE, "94": FeedUnit.MINUTE, "95": FeedUnit.TURN}
_INCH: Final = {"20": True, "70": True, "700": True, "21": False, "71": False, "710": False}
_VARYING: Final = frozenset({"96", "961", "962"})
_SWITCHES: Final = {3: True, 4: True}
_OFF: Final = frozenset({2, 5, 30})
MILLISECONDS: Final = 100.0
"""Least whole number after P of a dwell that counts milliseconds; controls that count seconds do not wait that long."""


def line_words(text: str) -> LineWords:
    """Return what a line says. A dwell (G4) has its time in F, X, U or P; revolutions (S) are not counted."""
    found = [_word(match) for match in vocabulary.TOKEN.finditer(text)]
    codes = [vocabulary.canonical(f"G{value}")[1:] for name, value in found if name == "G"]
    switches = [int(value) for name, value in found if name == "M" and value.isdigit()]
    values = dict(found)
    if "4" in codes:
        return LineWords(dwell_s=_dwell(values))
    words = LineWords(
        feed=_number(values, "F"),
        unit=next((_UNITS[code] for code in codes if code in _UNITS), None),
        inch=next((_INCH[code] for code in codes if code in _INCH), None),
        speed_rpm=_number(values, "S"),
        turning=next((_SWITCHES[code] for code in switches if code in _SWITCHES), None),
        off_after=any(code in _OFF for code in switches),
        varying=next((f"G{code}" for code in codes if code in _VARYING), None),
    )
    return NOTHING if words == NOTHING else words


def _word(match: re.Match[str]) -> tuple[str, str]:
    """Return letter and value of a word, of ``S1=8000`` too; empty for any other token."""
    kind = match.lastgroup
    name, value = {"word": (2, 3), "given": (6, 8), "late": (14, 15)}.get(kind or "", (0, 0))
    letter = match[name].upper() if name else ""
    return (letter[:1], match[value]) if len(letter) == 1 or letter[1:].isdigit() else ("", "")


def _number(values: Mapping[str, str], name: str) -> float | None:
    return number(values[name]) if name in values else None


def _dwell(values: Mapping[str, str]) -> float:
    seconds = next((_number(values, name) for name in "FXU" if name in values), None)
    if seconds is not None:
        return seconds
    pause = _number(values, "P")
    if pause is None:
        return 0.0
    return pause / 1000.0 if "." not in values["P"] and pause >= MILLISECONDS else pause
