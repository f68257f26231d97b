"""The causes that are tried: every effect that the machine, the instrument and the calibration can have on these data."""

from __future__ import annotations

from typing import Final

from twin.diagnosis.candidates import (
    affine_scale,
    alignment,
    curves,
    following_error,
    machine_effects,
    misplaced,
    refraction_scale,
    station_drift,
    time_skew,
)
from twin.diagnosis.candidates.candidate import CandidateSource, Catalogue, Given
from twin.machine.calibration import Calibration
from twin.machine.effects import MACHINE_EFFECTS, Specification
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

SOURCES: Final[tuple[CandidateSource, ...]] = (
    machine_effects.SOURCE,
    curves.SOURCE,
    alignment.SOURCE,
    refraction_scale.SOURCE,
    affine_scale.SOURCE,
    station_drift.SOURCE,
    time_skew.SOURCE,
    following_error.SOURCE,
    misplaced.SOURCE,
)
SPECIFICATIONS: Final[dict[str, Specification]] = {
    one.name: one for one in (*MACHINE_EFFECTS, *(own for source in SOURCES for own in source.specifications))
}
"""Every effect by its name."""


def catalogue(machine: Machine, data: Measurements, calibration: Calibration) -> Catalogue:
    """Every effect of contract §5 that can be there, on data that have the columns for it.

    Args:
        machine: the machine.
        data: the measurements.
        calibration: the model that is judged: a rotary axis's curve can be wrong as a whole only where it has a polynomial.
    """
    given = Given(machine, data, calibration)
    found = [source.candidates(given) for source in SOURCES]
    return Catalogue(
        tuple(candidate for one in found for candidate in one.candidates),
        tuple(missing for one in found for missing in one.not_evaluated),
    )
