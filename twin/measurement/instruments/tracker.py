"""A laser tracker: one length and two angles, given as coordinates in its own frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import SIDES, Instrument, InstrumentSpecification, along_and_across

DATA_SHEET_FACTOR: Final = 2.0
"""Maximum permissible errors are taken as two standard deviations (typical errors are about half of them)."""
INTERFEROMETER: Final = InstrumentSpecification(
    name="tracker",
    title="laser tracker, lengths by its interferometer (AT960)",
    columns=("x_mm", "y_mm", "z_mm"),
    reads="point",
    free_start=False,
    rides_on=SIDES,
    effects=(
        "frame_shift",
        "refraction_scale",
        "station_drift",
        "target_shift",
        "affine_scale",
        "beam_bending",
        "time_skew",
    ),
    source="maximum permissible errors of the data sheet, taken as two standard deviations",
)
ABSOLUTE: Final = replace(
    INTERFEROMETER, name="tracker-absolute", title="laser tracker, lengths by its absolute distance meter (AT960)"
)


@final
@dataclass(frozen=True)
class LaserTracker(Instrument):
    """A laser tracker; Leica AT960 by default, with the maximum permissible errors a + b·L of its data sheet (thesis 2.8).

    Attributes:
        length_um, length_um_per_m: along the beam.
        across_um, across_um_per_m: across the beam, from the two angles.
        specification: see `Instrument`.
    """

    length_um: float = 0.4
    length_um_per_m: float = 0.3
    across_um: float = 15.0
    across_um_per_m: float = 6.0
    specification: InstrumentSpecification = INTERFEROMETER

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        return np.array(points, dtype=float)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        return np.broadcast_to(np.eye(3), (len(points), 3, 3))

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.covariance`."""
        length = np.linalg.norm(points, axis=1)
        along = self.length_um + self.length_um_per_m * length
        across = self.across_um + self.across_um_per_m * length
        return along_and_across(points, along * UM / DATA_SHEET_FACTOR, across * UM / DATA_SHEET_FACTOR)

    def pooled(self, readings: np.ndarray, deviations: np.ndarray, dof: int) -> np.ndarray:
        """See `Instrument.pooled`: one variance along the beam, one across it."""
        beam = readings / np.linalg.norm(readings, axis=1, keepdims=True)
        along = np.sum(np.sum(deviations * beam, axis=1) ** 2)
        across = np.sum(deviations**2) - along
        n = len(readings)
        return along_and_across(readings, np.full(n, np.sqrt(along / dof)), np.full(n, np.sqrt(across / (2.0 * dof))))


AT960: Final = LaserTracker()
AT960_ABSOLUTE: Final = LaserTracker(length_um=10.0, length_um_per_m=0.0, specification=ABSOLUTE)
