"""Instruments that read points: laser tracker, touch probe and sphere, R-test, electronic level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final, final

import numpy as np

from twin._common.messages import Message
from twin._common.units import UM
from twin.measurement.instruments.base import (
    SIDES,
    Instrument,
    InstrumentSpecification,
    IsotropicNoise,
    SetUpWords,
    along_and_across,
)

DATA_SHEET_FACTOR: Final = 2.0
"""Maximum permissible errors are taken as two standard deviations (typical errors are about half of them)."""
INTERFEROMETER: Final = InstrumentSpecification(
    name="tracker",
    title=Message("laser tracker, lengths by its interferometer (AT960)"),
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
    INTERFEROMETER,
    name="tracker-absolute",
    title=Message("laser tracker, lengths by its absolute distance meter (AT960)"),
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


PROBE: Final = InstrumentSpecification(
    name="probe",
    title=Message("touch probe and calibration sphere"),
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


R_TEST: Final = InstrumentSpecification(
    name="r-test",
    title=Message("R-test (nest of three sensors and ball)"),
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


LEVEL: Final = InstrumentSpecification(
    name="level",
    title=Message("electronic level"),
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
