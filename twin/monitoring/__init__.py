"""Changes of a machine: two calibrations compared, and short check measurements watched over weeks.

Manual: `twin doc compare`.

Watch a folder of short check measurements: which error changed, since when, is it temperature, is the calibration still good.

Manual: `twin doc watch`.
"""

from twin.monitoring.change import Change, ErrorSeries, TemperatureEffect, WatchedError
from twin.monitoring.check import Check
from twin.monitoring.compare import compare
from twin.monitoring.comparison import Changes, Culprits, ErrorChange
from twin.monitoring.tool import DisplacementSize, Remaining, ToolChange, ToolDisplacement
from twin.monitoring.watch import WatchSettings, watch
from twin.monitoring.watched import Watch

__all__ = [
    "Change",
    "Changes",
    "Check",
    "Culprits",
    "DisplacementSize",
    "ErrorChange",
    "ErrorSeries",
    "Remaining",
    "TemperatureEffect",
    "ToolChange",
    "ToolDisplacement",
    "Watch",
    "WatchSettings",
    "WatchedError",
    "compare",
    "watch",
]
