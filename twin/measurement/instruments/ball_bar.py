"""A ball bar: the distance between a pivot on the table and a ball in the spindle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.measurement.instruments.base import InstrumentSpecification, LengthReading, SetUpWords

BALL_BAR: Final = InstrumentSpecification(
    name="ball-bar",
    title="telescoping ball bar",
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
