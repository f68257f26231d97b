"""Instruments: what each reads of a point, and how well."""

from twin.measurement.instruments.base import Instrument
from twin.measurement.instruments.interferometer import TrackingInterferometer
from twin.measurement.instruments.multi_axis import MultiAxis, nine_beams, six_beams
from twin.measurement.instruments.multi_axis_solve import Displacement, SelfCalibration, measure, self_calibrate
from twin.measurement.instruments.refraction import STANDARD_AIR, Air, length_scale, refractive_index
from twin.measurement.instruments.tracker import LaserTracker

INSTRUMENTS: tuple[Instrument, ...] = (LaserTracker(), LaserTracker(absolute=True), TrackingInterferometer())
"""By name: ``tracker`` (AT960, interferometer), ``tracker-absolute``, ``interferometer``."""

__all__ = [
    "INSTRUMENTS",
    "STANDARD_AIR",
    "Air",
    "Displacement",
    "Instrument",
    "LaserTracker",
    "MultiAxis",
    "SelfCalibration",
    "TrackingInterferometer",
    "length_scale",
    "measure",
    "nine_beams",
    "refractive_index",
    "self_calibrate",
    "six_beams",
]
