"""An electronic level, or an autocollimator: the tilt of its target about two axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, final

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


@final
@dataclass(frozen=True)
class Level(IsotropicNoise):
    """A level: rotations of its target about x and y of the station's frame, ``a_urad`` and ``b_urad`` in a file.

    Rotations (a, b) move the end of a vertical line of 1 m by (b, −a): that is the point which it reads here. A
    rotation about the vertical does not move it.

    ``sigma_um``: standard uncertainty, µm/m; ``specification``: see `Instrument`.
    """

    sigma_um: float = 1.0
    specification: InstrumentSpecification = LEVEL
    sees: ClassVar[tuple[bool, bool, bool]] = (True, True, False)
