"""The datum of a calibration: different numbers can describe the same machine; this is how to compare them.

Manual: `twin doc datum`.
"""

from twin.machine.datum.conditions import AS_GIVEN, DATUMS, END_POINTS, EXPLANATION, MEAN_LINES, Datum
from twin.machine.datum.convert import Converted, convert, datum_of, violation
from twin.machine.datum.links import Numbers

__all__ = [
    "AS_GIVEN",
    "DATUMS",
    "END_POINTS",
    "EXPLANATION",
    "MEAN_LINES",
    "Converted",
    "Datum",
    "Numbers",
    "convert",
    "datum_of",
    "violation",
]
