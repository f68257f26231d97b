"""A tracking interferometer, which reads lengths from an unknown zero (multilateration, thesis eq. 26)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import SIDES, InstrumentSpecification, LengthReading

DATA_SHEET_FACTOR: Final = 2.0
"""Coverage factor of the expanded uncertainty in the data sheet."""
TRACKING: Final = InstrumentSpecification(
    name="interferometer",
    title="tracking interferometer (LaserTRACER-NG)",
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
