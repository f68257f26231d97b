"""A laser tracker: one length and two angles, given as coordinates in its own frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import Instrument, along_and_across

COVERAGE: Final = 2.0
"""A maximum permissible error is taken as two standard deviations (typical is about half of it)."""


@final
@dataclass(frozen=True)
class LaserTracker(Instrument):
    """Leica AT960 by default: maximum permissible errors of its data sheet (thesis 2.8), a + b·L.

    Attributes:
        length_um, length_um_per_m: along the beam with the interferometer.
        across_um, across_um_per_m: across it, from the two angles.
        absolute: whether lengths come from the absolute distance meter (``absolute_um`` whatever the length).
        absolute_um: its maximum permissible error.
    """

    length_um: float = 0.4
    length_um_per_m: float = 0.3
    across_um: float = 15.0
    across_um_per_m: float = 6.0
    absolute: bool = False
    absolute_um: float = 10.0

    @property
    def name(self) -> str:  # type: ignore[override]
        """``tracker``, or ``tracker-absolute``."""
        return "tracker-absolute" if self.absolute else "tracker"

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        return np.array(points, dtype=float)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        return np.broadcast_to(np.eye(3), (len(points), 3, 3))

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.covariance`."""
        length = np.linalg.norm(points, axis=1)
        along = (
            np.full_like(length, self.absolute_um) if self.absolute else self.length_um + self.length_um_per_m * length
        )
        across = self.across_um + self.across_um_per_m * length
        return along_and_across(points, along * UM / COVERAGE, across * UM / COVERAGE)
