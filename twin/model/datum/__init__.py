"""The datum of a calibration: different numbers can describe the same machine; this is how to compare them.

Manual: `twin doc datum`.
"""

from twin.model.datum.conditions import AS_GIVEN, DATUMS, END_POINTS, EXPLANATION, MEAN_LINES, Datum, Numbers
from twin.model.datum.convert import Converted, convert, datum_of, violation

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
