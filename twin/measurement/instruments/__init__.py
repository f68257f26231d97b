"""Instruments: what each reads of a point, and with which uncertainty.

A new instrument is one specification, one class and one entry in `twin._common.families.INSTRUMENTS`. The multi-axis interferometer
(`twin.measurement.instruments.multi_axis`) reads the pose of a carriage, not points, and has its own command; it has the same
`InstrumentSpecification`.

Examples:
    >>> tracker, probe = twin.instruments.LaserTracker(), twin.instruments.TouchProbe()
    >>> tracker.name, probe.name
    ('tracker', 'probe')
    >>> twin.instruments.instrument_named("ball-bar").specification.reads
    'length'
"""

from typing import Final

import numpy as np

from twin._common import families
from twin._common.errors import require_name
from twin.measurement.instruments.base import (
    SIDES,
    STANDARD_AIR,
    Air,
    Instrument,
    InstrumentSpecification,
    Reads,
    StationInstruments,
    length_scale,
    refractive_index,
)
from twin.measurement.instruments.lengths import BallBar, LinearInterferometer, TrackingInterferometer
from twin.measurement.instruments.multi_axis import Displacement, MultiAxis, measure
from twin.measurement.instruments.points import LaserTracker, Level, RTest, TouchProbe

INSTRUMENTS: Final[tuple[Instrument, ...]] = families.members(__name__, families.INSTRUMENTS)
"""Instruments whose readings a measurement table can contain; the first of several alike is the default (`default_instrument`)."""


def instrument_named(name: str) -> Instrument:
    """Return the instrument of a name. Raises `InputError`: an unknown name."""
    require_name("instrument", name, families.INSTRUMENTS)
    return next(instrument for instrument in INSTRUMENTS if instrument.name == name)


def default_instrument(reads: Reads, side: str = SIDES[0], largest_mm: float = np.inf) -> Instrument:
    """Return the instrument for readings of a kind: the one of the smallest range that includes them, the first of several."""
    fitting = [
        instrument
        for instrument in INSTRUMENTS
        if instrument.specification.reads == reads
        and side in instrument.specification.rides_on
        and largest_mm <= instrument.specification.range_mm
    ]
    return min(fitting, key=lambda one: one.specification.range_mm)


def others_alike(instrument: Instrument) -> tuple[str, ...]:
    """Return the names of the other instruments whose readings look the same: same columns, same kind, same side."""
    own = instrument.specification
    return tuple(
        one.name
        for one in INSTRUMENTS
        if one.name != own.name
        and (one.specification.reads, one.specification.columns, one.specification.rides_on)
        == (own.reads, own.columns, own.rides_on)
    )


__all__ = [
    "INSTRUMENTS",
    "SIDES",
    "STANDARD_AIR",
    "Air",
    "BallBar",
    "Displacement",
    "Instrument",
    "InstrumentSpecification",
    "LaserTracker",
    "Level",
    "LinearInterferometer",
    "MultiAxis",
    "RTest",
    "Reads",
    "StationInstruments",
    "TouchProbe",
    "TrackingInterferometer",
    "default_instrument",
    "instrument_named",
    "length_scale",
    "measure",
    "others_alike",
    "refractive_index",
]
