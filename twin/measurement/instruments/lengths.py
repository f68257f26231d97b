"""Instruments that read a length along one line: ball bar, tracking interferometer, linear interferometer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.messages import Message
from twin._common.units import UM
from twin.measurement.instruments.base import SIDES, InstrumentSpecification, LengthReading, SetUpWords

BALL_BAR: Final = InstrumentSpecification(
    name="ball-bar",
    title=Message("telescoping ball bar"),
    columns=("x_mm",),
    reads="length",
    free_start=False,
    rides_on=("work", "tool"),
    effects=("frame_shift", "target_shift", "time_skew"),
    source="data sheet of the Renishaw QC20: ±(0.7 µm + 0.3 % of the deviation), taken as two standard deviations",
    range_mm=2000.0,
    nominal_length=True,
    set_up=SetUpWords(
        station="place of",
        target="offset of",
        station_place="the pivot's place on the table (station_x_mm …)",
        target_place="the ball's offset from the spindle nose (place_x_mm …)",
    ),
)


@final
@dataclass(frozen=True)
class BallBar(LengthReading):
    """A ball bar: the absolute length from the pivot to the ball, in the table's ``x_mm``.

    ``length_um``: expanded uncertainty (k = 2) of a length; ``specification``: see `Instrument`.
    """

    length_um: float = 0.7
    specification: InstrumentSpecification = BALL_BAR

    def sigma_m(self, points: np.ndarray) -> np.ndarray:
        """See `LengthReading.sigma_m`."""
        return np.full(len(points), self.length_um * UM / 2.0)


DATA_SHEET_FACTOR: Final = 2.0
"""Coverage factor of the expanded uncertainty in the data sheet."""
TRACKING: Final = InstrumentSpecification(
    name="interferometer",
    title=Message("tracking interferometer (LaserTRACER-NG)"),
    columns=("x_mm",),
    reads="length",
    free_start=True,
    rides_on=SIDES,
    effects=("frame_shift", "refraction_scale", "station_drift", "target_shift", "time_skew"),
    source="expanded uncertainty (k = 2) of the data sheet",
)


@final
@dataclass(frozen=True)
class TrackingInterferometer(LengthReading):
    """A tracking interferometer; LaserTRACER-NG by default, U = 0.2 µm + 0.3 µm/m (thesis 2.8).

    Its reading is the distance minus the dead path. An evaluation has to identify the dead path; a simulation sets it.

    ``dead_path_m``: length at which the counter was set to zero; ``specification``: see `Instrument`.
    """

    length_um: float = 0.2
    length_um_per_m: float = 0.3
    dead_path_m: float = 0.0
    specification: InstrumentSpecification = TRACKING

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        return super().read(points) - np.array([self.dead_path_m, 0.0, 0.0])

    def sigma_m(self, points: np.ndarray) -> np.ndarray:
        """See `LengthReading.sigma_m`."""
        length = np.linalg.norm(points, axis=1)
        return np.asarray((self.length_um + self.length_um_per_m * length) * UM / DATA_SHEET_FACTOR)


LINEAR: Final = InstrumentSpecification(
    name="linear-interferometer",
    title=Message("linear interferometer"),
    columns=("x_mm",),
    reads="coordinate",
    free_start=False,
    rides_on=SIDES,
    effects=("frame_shift", "refraction_scale", "station_drift", "time_skew"),
    source="data sheet of the Renishaw XL-80: ±0.5 ppm with compensated air, taken as two standard deviations; 0.1 µm setting noise",
)


@final
@dataclass(frozen=True)
class LinearInterferometer(LengthReading):
    """A linear interferometer: the coordinate of the reflector along the beam, in the table's ``x_mm``.

    The Abbe offset is the reflector's place on its carrier: enter it, or the angular errors of the axis are taken for its positioning
    error (ISO 230-2, 4.2; ISO 230-1, 3.4.3).

    ``floor_um``: standard uncertainty at zero length; ``ppm``: expanded uncertainty (k = 2) that grows with the length;
    ``specification``: see `Instrument`.
    """

    floor_um: float = 0.1
    ppm: float = 0.5
    specification: InstrumentSpecification = LINEAR

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        readings = np.full((len(points), 3), np.nan)
        readings[:, 0] = points[:, 0]
        return readings

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        return np.broadcast_to(np.diag([1.0, 0.0, 0.0]), (len(points), 3, 3))

    def sigma_m(self, points: np.ndarray) -> np.ndarray:
        """See `LengthReading.sigma_m`."""
        return np.hypot(self.floor_um * UM, 0.5e-6 * self.ppm * points[:, 0])


CMM: Final = LinearInterferometer(
    floor_um=0.9,
    ppm=3.3,
    specification=replace(
        LINEAR,
        name="cmm",
        title="coordinate measuring machine, on a part that was cut here",
        rides_on=("work",),
        effects=("frame_shift",),
        source="assumed: E = 1.8 µm + L/300 (ISO 10360-2, data sheets of usual machines), taken as two standard deviations",
        beam=False,
        aligned=True,
        set_up=SetUpWords(station="place of", target="point"),
    ),
)
"""The coordinate of a point of a part along the surface's normal. The part is the station: it sits on the work side, its place on the
machine is unknown; the point of the tool that cut it is the target."""
