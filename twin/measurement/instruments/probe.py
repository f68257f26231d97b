"""A touch probe in the spindle that finds the centre of a calibration sphere on the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

from twin.measurement.instruments.base import InstrumentSpecification, IsotropicNoise, SetUpWords

PROBE: Final = InstrumentSpecification(
    name="probe",
    title="touch probe and calibration sphere",
    columns=("x_mm", "y_mm", "z_mm"),
    reads="null",
    free_start=False,
    rides_on=("tool",),
    effects=("frame_shift", "target_shift", "probe_lobing"),
    source="assumed: repeatability of touch-trigger probes (0.25 to 1 µm in one direction, data sheets) and lobing after averaging",
    beam=False,
    set_up=SetUpWords(
        station="tip of",
        target="place of",
        station_place="the tip's offset from the spindle nose (station_x_mm …)",
        target_place="the spheres' places on the table (place_x_mm …)",
    ),
)


@final
@dataclass(frozen=True)
class TouchProbe(IsotropicNoise):
    """A touch probe: the axis positions in a row are those at which its tip was at the centre of the sphere.

    The reading is zero. Its noise is that of the centre, from five or more contacts, in the directions of the spindle nose.

    ``sigma_um``: standard uncertainty of a coordinate of the centre; ``specification``: see `Instrument`.
    """

    sigma_um: float = 1.5
    specification: InstrumentSpecification = PROBE
