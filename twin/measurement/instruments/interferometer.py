"""A tracking interferometer, which reads lengths from an unknown zero (multilateration, thesis eq. 26)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import SIDES, Instrument, InstrumentSpecification

DATA_SHEET_FACTOR: Final = 2.0
"""Coverage factor of the expanded uncertainty in the data sheet."""
TRACKING: Final = InstrumentSpecification(
    name="interferometer",
    title="tracking interferometer (LaserTRACER-NG)",
    columns=("x_mm",),
    free_start=True,
    rides_on=SIDES,
    effects=("frame_shift", "refraction_scale", "station_drift", "target_shift", "time_skew"),
)


@final
@dataclass(frozen=True)
class TrackingInterferometer(Instrument):
    """A tracking interferometer; LaserTRACER-NG by default, U = 0.2 µm + 0.3 µm/m (thesis 2.8).

    Its reading is the distance minus the dead path, in the table's ``x_mm``; y and z stay empty. An evaluation has to identify the dead
    path; a simulation sets it.

    Attributes:
        length_um, length_um_per_m: expanded uncertainty of a length.
        dead_path_m: length at which the counter was set to zero.
        specification: see `Instrument`.
    """

    length_um: float = 0.2
    length_um_per_m: float = 0.3
    dead_path_m: float = 0.0
    specification: InstrumentSpecification = TRACKING

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        readings = np.full((len(points), 3), np.nan)
        readings[:, 0] = np.linalg.norm(points, axis=1) - self.dead_path_m
        return readings

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        rows = np.zeros((len(points), 3, 3))
        rows[:, 0, :] = points / np.linalg.norm(points, axis=1, keepdims=True)
        return rows

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.covariance`."""
        length = np.linalg.norm(points, axis=1)
        matrix = np.zeros((len(points), 3, 3))
        matrix[:, 0, 0] = ((self.length_um + self.length_um_per_m * length) * UM / DATA_SHEET_FACTOR) ** 2
        return matrix

    def pooled(self, readings: np.ndarray, deviations: np.ndarray, dof: int) -> np.ndarray:
        """See `Instrument.pooled`: one variance for all lengths."""
        found = np.zeros((len(readings), 3, 3))
        found[:, 0, 0] = np.sum(deviations[:, 0] ** 2) / dof
        return found
