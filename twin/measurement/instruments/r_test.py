"""An R-test: a nest of three displacement sensors that reads the position of a ball."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

from twin.measurement.instruments.base import InstrumentSpecification, IsotropicNoise, SetUpWords

R_TEST: Final = InstrumentSpecification(
    name="r-test",
    title="R-test (nest of three sensors and ball)",
    columns=("x_mm", "y_mm", "z_mm"),
    reads="point",
    free_start=False,
    rides_on=("work", "tool"),
    effects=("frame_shift", "target_shift", "affine_scale", "time_skew"),
    source="assumed: 0.5 to 1 µm for a measuring range of some millimetres (Weikert 2004, CIRP Annals 53, 429)",
    range_mm=10.0,
    beam=False,
    set_up=SetUpWords(
        station="place of",
        target="offset of",
        station_place="the nest's place on the table (station_x_mm …)",
        target_place="the ball's offset from the spindle nose (place_x_mm …)",
    ),
)


@final
@dataclass(frozen=True)
class RTest(IsotropicNoise):
    """An R-test: x, y and z of the ball's centre in the frame of the nest, within a few millimetres of its zero.

    ``specification``: see `Instrument`.
    """

    sigma_um: float = 0.7
    specification: InstrumentSpecification = R_TEST
