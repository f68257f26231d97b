"""Instruments: what each reads of a point, and with which uncertainty. A new instrument is one file and one entry in `INSTRUMENTS`.

The multi-axis interferometer (`twin.measurement.instruments.multi_axis`) reads the pose of a carriage, not points, and has its own
command; it has the same `InstrumentSpecification`.
"""

from typing import Final

from twin.measurement.instruments.base import SIDES, Instrument, InstrumentSpecification
from twin.measurement.instruments.interferometer import TrackingInterferometer
from twin.measurement.instruments.multi_axis import MultiAxis
from twin.measurement.instruments.multi_axis_solve import Displacement, measure
from twin.measurement.instruments.refraction import STANDARD_AIR, Air, length_scale, refractive_index
from twin.measurement.instruments.tracker import AT960, AT960_ABSOLUTE, LaserTracker

INSTRUMENTS: Final[tuple[Instrument, ...]] = (AT960, AT960_ABSOLUTE, TrackingInterferometer())
"""Instruments whose readings a measurement table can contain, default ones first (`default_instrument`)."""


def default_instrument(*, lengths_only: bool) -> Instrument:
    """Return the default instrument: the first that reads lengths only, or the first that reads coordinates."""
    return next(one for one in INSTRUMENTS if one.lengths_only == lengths_only)


__all__ = [
    "INSTRUMENTS",
    "SIDES",
    "STANDARD_AIR",
    "Air",
    "Displacement",
    "Instrument",
    "InstrumentSpecification",
    "LaserTracker",
    "MultiAxis",
    "TrackingInterferometer",
    "length_scale",
    "measure",
    "refractive_index",
    "usual",
]
