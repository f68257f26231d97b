"""Feed, spindle speed and dwell of an APT statement."""

from __future__ import annotations

import re
from math import nan
from typing import Final

from twin.nc.technology import NOTHING, FeedUnit, LineWords
from twin.nc.text import MM_PER_INCH, number

_STATEMENT: Final = re.compile(r"[ \t]*(UNITS|FEDRAT|SPINDL|DELAY|FINI)\b[ \t]*/?([^$\r\n]*)", re.ASCII | re.IGNORECASE)
_UNITS: Final = {"MMPR": FeedUnit.TURN, "IPR": FeedUnit.TURN, "PERREV": FeedUnit.TURN, "INVERS": FeedUnit.INVERSE}
_SURFACE: Final = frozenset({"SFM", "SMM", "SURF"})


def line_words(text: str) -> LineWords:
    """Return what a line says."""
    found = _STATEMENT.match(text)
    if found is None:
        return NOTHING
    word, arguments = found[1].upper(), [part.strip().upper() for part in found[2].split(",")]
    numbers = [value for value in map(number, arguments) if value == value]
    first = numbers[0] if numbers else nan
    if word == "UNITS":
        return LineWords(inch=arguments[0].startswith("INCH"))
    if word == "DELAY":
        return LineWords(dwell_s=first)
    if word == "FEDRAT":
        unit = next((_UNITS[one] for one in arguments if one in _UNITS), FeedUnit.MINUTE)
        inch, metric = (bool(set(arguments) & those) for those in ({"IPM", "IPR"}, {"MMPM", "MMPR"}))
        return LineWords(feed=first * (MM_PER_INCH if inch else 1.0), unit=unit, metric=inch or metric)
    if word == "FINI" or "OFF" in arguments:
        return LineWords(off_after=word == "FINI", turning=None if word == "FINI" else False)
    varying = next((one for one in arguments if one in _SURFACE), None)
    return LineWords(speed_rpm=first if numbers else None, turning=True, varying=varying)
