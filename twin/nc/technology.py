"""Feed, spindle speed and dwell of every line of a program, for the time that its blocks take and the speed at which they run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import isnan, nan
from typing import NamedTuple, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.nc.blocks import Program
from twin.nc.text import MM_PER_INCH


@final
class FeedUnit(Enum):
    """Unit of a feed word."""

    MINUTE = "mm per minute"
    TURN = "mm per revolution"
    INVERSE = "blocks per minute"


class LineWords(NamedTuple):
    """Feed, speed and dwell in one line; None where it says nothing, NaN for a word whose value is not a number.

    Attributes:
        feed: the number of the feed word, in the units of the program.
        unit: the unit of this and all following feeds.
        inch: whether the program counts in inches from here on.
        metric: whether the feed is in millimetres even if the program counts in inches.
        speed_rpm: the number of the speed word.
        turning: whether the spindle is switched on or off.
        off_after: whether it is switched off at the end of the line.
        dwell_s: time for which the line waits.
        varying: a word after which the speed follows the cutting speed, or None.
    """

    feed: float | None = None
    unit: FeedUnit | None = None
    inch: bool | None = None
    metric: bool = False
    speed_rpm: float | None = None
    turning: bool | None = None
    off_after: bool = False
    dwell_s: float = 0.0
    varying: str | None = None


NOTHING = LineWords()


@final
@dataclass(frozen=True)
class Technology:
    """Feed, speed and dwell of every line, with what earlier lines said carried on.

    Attributes:
        feed: (lines,) mm, degrees or blocks by ``unit``; NaN if unknown.
        unit: (lines,) `FeedUnit` objects.
        speed_rpm: (lines,) spindle speed, 0 while it is switched off, and before the first speed word.
        dwell_s: (lines,) time for which each line waits.
        says_speed: whether any line has a speed word.
    """

    feed: np.ndarray
    unit: np.ndarray
    speed_rpm: np.ndarray
    dwell_s: np.ndarray
    says_speed: bool


def carried(program: Program, words_of: Callable[[str], LineWords]) -> Technology:
    """Return the technology of a program.

    A spindle that the program never switches on or off is taken to turn from the first speed word on: the calling program has switched
    it on.

    Args:
        program: the program.
        words_of: what a line says.

    Raises:
        InputError: a speed that follows the cutting speed, or is not a number.
    """
    lines = [words_of(text) for text in program.texts]
    switched = any(line.turning is not None or line.off_after for line in lines)
    turning, speed, feed, unit, scale = not switched, nan, nan, FeedUnit.MINUTE, 1.0
    feeds, units, speeds = [], [], []
    for i, words in enumerate(lines):
        _check(program, i, words)
        scale = scale if words.inch is None else MM_PER_INCH if words.inch else 1.0
        feed = nan if words.unit not in (None, unit) else feed
        unit = words.unit or unit
        if words.feed is not None:
            feed = words.feed * (1.0 if unit is FeedUnit.INVERSE or words.metric else scale)
        speed = speed if words.speed_rpm is None else words.speed_rpm
        turning = turning if words.turning is None else words.turning
        feeds.append(feed)
        units.append(unit)
        speeds.append(0.0 if isnan(speed) or not turning else speed)
        turning = turning and not words.off_after
    return Technology(
        read_only(np.array(feeds)),
        read_only(np.array(units, dtype=object)),
        read_only(np.array(speeds)),
        read_only(np.array([line.dwell_s for line in lines])),
        any(line.speed_rpm is not None for line in lines),
    )


def _check(program: Program, line: int, words: LineWords) -> None:
    text = program.texts[line].strip()
    if words.varying is not None:
        raise InputError(
            f"the spindle speed follows the cutting speed ({words.varying})",
            expected="a constant speed in every block (G97), or a speed given for the whole program",
            file=program.source,
            line=line + 1,
            value=text,
        )
    if (words.speed_rpm is not None and isnan(words.speed_rpm)) or isnan(words.dwell_s):
        what = "dwell" if isnan(words.dwell_s) else "spindle speed"
        raise InputError(
            f"the {what} is not a number",
            expected="a number, or a speed given for the whole program",
            file=program.source,
            line=line + 1,
            value=text,
        )
