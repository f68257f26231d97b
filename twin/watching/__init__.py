"""Watch a folder of short check measurements: which error changed, since when, is it temperature, is the calibration still good.

Manual: `twin doc watch`.
"""

from twin.watching.change import Change, ErrorSeries, TemperatureEffect, WatchedError
from twin.watching.check import Check
from twin.watching.result import Watch
from twin.watching.watch import WatchSettings, watch
from twin.watching.words import text_of

__all__ = [
    "Change",
    "Check",
    "ErrorSeries",
    "TemperatureEffect",
    "Watch",
    "WatchSettings",
    "WatchedError",
    "text_of",
    "watch",
]
