"""An electronic level, or an autocollimator: the tilt of its target about two axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import SIDES, InstrumentSpecification, IsotropicNoise

LEVEL: Final = InstrumentSpecification(
    name="level",
    title="electronic level",
    columns=("x_mm", "y_mm"),
    reads="angle",
    free_start=False,
    rides_on=SIDES,
    effects=("frame_shift", "station_drift"),
    source="assumed: 1 µm/m (resolution and repeatability of electronic levels of 1 µm/m, data sheets)",
    beam=False,
)
BLIND: Final = np.array([1.0, 1.0, 0.0])
"""Coordinates of the end of the line that it reads; a rotation about the vertical does not move it."""


@final
@dataclass(frozen=True)
class Level(IsotropicNoise):
    """A level: rotations of its target about x and y of the station's frame, ``a_urad`` and ``b_urad`` in a file.

    Rotations (a, b) move the end of a vertical line of 1 m by (b, −a): that is the point which it reads here.

    Attributes:
        sigma_um: standard uncertainty, µm/m.
        specification: see `Instrument`.
    """

    sigma_um: float = 1.0
    specification: InstrumentSpecification = LEVEL

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        return np.where(BLIND > 0.0, points, np.nan)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        return np.broadcast_to(np.diag(BLIND), (len(points), 3, 3))

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.covariance`."""
        return np.broadcast_to((self.sigma_um * UM) ** 2 * np.diag(BLIND), (len(points), 3, 3))

    def pooled(self, readings: np.ndarray, deviations: np.ndarray, dof: int) -> np.ndarray:
        """See `Instrument.pooled`: one variance for both angles."""
        variance = float(np.sum(deviations[:, :2] ** 2)) / (2.0 * dof)
        return np.broadcast_to(variance * np.diag(BLIND), (len(readings), 3, 3))
