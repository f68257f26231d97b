"""Feed, spindle speed and dwell of a line of ISO code."""

from __future__ import annotations

import re
from math import nan
from typing import Final

from twin.nc.technology import NOTHING, FeedUnit, LineWords
from twin.nc.text import number

_ASIDE: Final = re.compile(r"\([^()]*\)|\"[^\"]*\"|;.*", re.ASCII)
_VALUE: Final = r"[+-]?[ \t]*[\d.]+"
_START: Final = r"(?<![A-Z\d_$])"
_WORD: Final = re.compile(
    rf"{_START}(?:G[ \t]*(?P<g>[\d.]+)|M(?:[1-9][ \t]*=)?[ \t]*(?P<m>\d+)|(?P<of>[FSPXU])(?:"
    rf"[ \t]*(?:(?P<value>{_VALUE})(?![\d.]*[ \t]*=)|[#\[])|[1-9]?[ \t]*=[ \t]*(?:(?P<given>{_VALUE})(?![\d.]*[ \t]*[-+*/])|\S)))",
    re.ASCII | re.IGNORECASE,
)
_UNITS: Final = {"93": FeedUnit.INVERSE, "94": FeedUnit.MINUTE, "95": FeedUnit.TURN}
_INCH: Final = {"20": True, "70": True, "700": True, "21": False, "71": False, "710": False}
_VARYING: Final = frozenset({"96", "961", "962"})
_SWITCHES: Final = {3: True, 4: True}
_OFF: Final = frozenset({2, 5, 30})
MILLISECONDS: Final = 100.0
"""Least whole number after P of a dwell that counts milliseconds; controls that count seconds do not wait that long."""


def line_words(text: str) -> LineWords:
    """Return what a line says. A dwell (G4) has its time in F, X, U or P; revolutions (S) are not counted."""
    found = list(_WORD.finditer(_ASIDE.sub(" ", text)))
    codes = [(match["g"].lstrip("0") or "0").removesuffix(".") for match in found if match["g"]]
    switches = [int(match["m"]) for match in found if match["m"]]
    values = {match["of"].upper(): match["value"] or match["given"] for match in found if match["of"]}
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


def _number(values: dict[str, str | None], name: str) -> float | None:
    if name not in values:
        return None
    text = values[name]
    return nan if text is None else number(text)


def _dwell(values: dict[str, str | None]) -> float:
    seconds = next((_number(values, name) for name in "FXU" if name in values), None)
    if seconds is not None:
        return seconds
    pause = _number(values, "P")
    if pause is None:
        return 0.0
    whole = "." not in (values["P"] or "")
    return pause / 1000.0 if whole and pause >= MILLISECONDS else pause
