"""Measured data of other programs as measurement tables: contacts of a probe, ball bar, interferometer, tracker.

Manual: `twin doc convert`.
"""

from twin.measurement.formats.base import Conversion, FormatSpecification, Given, MeasuredFormat
from twin.measurement.formats.convert import FORMATS, ConvertedFiles, convert, format_named, format_of, other_format

__all__ = [
    "FORMATS",
    "Conversion",
    "ConvertedFiles",
    "FormatSpecification",
    "Given",
    "MeasuredFormat",
    "convert",
    "format_named",
    "format_of",
    "other_format",
]
