"""A linear interferometer, or a scale: the displacement of a reflector along one beam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import SIDES, InstrumentSpecification, LengthReading

LINEAR: Final = InstrumentSpecification(
    name="linear-interferometer",
    title="linear interferometer",
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
