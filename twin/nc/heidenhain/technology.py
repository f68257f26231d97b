"""Feed, spindle speed and dwell of a block of plain language."""

from __future__ import annotations

import re
from math import nan
from typing import Final

from twin.nc.technology import NOTHING, FeedUnit, LineWords
from twin.nc.text import number

_ASIDE: Final = re.compile(r"\"[^\"]*\"|;.*", re.ASCII)
_VALUE: Final = r"[+-]?[ \t]*[\d.,]+"
_FEED: Final = re.compile(rf"(?<![A-Z\d])F[ \t]*(?:MAX|(U)?[ \t]*({_VALUE})|([A-Z]))", re.ASCII | re.IGNORECASE)
_MISC: Final = re.compile(r"(?<![A-Z\d])M(\d+)", re.ASCII | re.IGNORECASE)
_TOOL: Final = re.compile(rf"TOOL[ \t]+CALL\b.*?[ \t]S[ \t]*(?:({_VALUE})|([A-Z]))", re.ASCII | re.IGNORECASE)
_DWELL: Final = re.compile(rf"CYCL[ \t]+DEF[ \t]+9\.1[ \t]+\D*({_VALUE})", re.ASCII | re.IGNORECASE)
_UNIT: Final = re.compile(r"BEGIN[ \t]+PGM\b.*[ \t](MM|INCH)[ \t]*[\r\n]*$", re.ASCII | re.IGNORECASE)
_TURNING: Final = frozenset({3, 4, 13, 14})
_OFF: Final = frozenset({2, 5, 30})
_UNITS: Final = {136: FeedUnit.TURN, 137: FeedUnit.MINUTE}


def line_words(text: str) -> LineWords:
    """Return what a line says. A feed per tooth, an automatic feed and a Q parameter are not a number."""
    bare = _ASIDE.sub(" ", text)
    if (dwell := _DWELL.search(bare)) is not None:
        return LineWords(dwell_s=number(dwell[1]))
    if (unit := _UNIT.search(bare)) is not None:
        return LineWords(inch=unit[1].upper() == "INCH")
    codes = [int(code) for code in _MISC.findall(bare)]
    feed = next((match for match in _FEED.finditer(bare) if match[2] or match[3]), None)
    tool = _TOOL.search(bare)
    words = LineWords(
        feed=None if feed is None else number(feed[2]) if feed[2] else nan,
        unit=FeedUnit.TURN
        if feed is not None and feed[1]
        else next((_UNITS[code] for code in codes if code in _UNITS), None),
        speed_rpm=None if tool is None else number(tool[1]) if tool[1] else nan,
        turning=True if _TURNING & set(codes) else None,
        off_after=bool(_OFF & set(codes)),
    )
    return NOTHING if words == NOTHING else words
