"""Catalogue of candidate causes: every effect of machine, instrument and calibration that these data allow to be tested."""

from __future__ import annotations

from typing import Final

from twin.diagnosis.candidates import (
    added_payload,
    affine_scale,
    alignment,
    curves,
    following_error,
    machine_effects,
    misplaced,
    probe_lobing,
    refraction_scale,
    reversal_spike,
    station_drift,
    time_skew,
)
from twin.diagnosis.candidates.candidate import CandidateInputs, CandidateSource, Catalogue
from twin.machine.calibration import Calibration
from twin.machine.effects import MACHINE_EFFECTS, Specification
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, StationInstruments
from twin.measurement.table import Measurements

SOURCES: Final[tuple[CandidateSource, ...]] = (
    machine_effects.SOURCE,
    added_payload.SOURCE,
    curves.SOURCE,
    alignment.SOURCE,
    refraction_scale.SOURCE,
    affine_scale.SOURCE,
    station_drift.SOURCE,
    time_skew.SOURCE,
    reversal_spike.SOURCE,
    following_error.SOURCE,
    probe_lobing.SOURCE,
    misplaced.SOURCE,
)
SPECIFICATIONS: Final[dict[str, Specification]] = {
    one.name: one for one in (*MACHINE_EFFECTS, *(own for source in SOURCES for own in source.specifications))
}
"""Every effect by its name."""


def catalogue(
    machine: Machine, data: Measurements, calibration: Calibration, instruments: StationInstruments | None = None
) -> Catalogue:
    """Return every effect of contract §5 that the machine, the columns of the data and the instruments allow.

    Args:
        machine: the machine.
        data: the measurements.
        calibration: the model under test; the curve of a rotary axis is a candidate only where it is a polynomial.
        instruments: those of the stations; errors that none of them can have are left out. None: not known.
    """
    inputs = CandidateInputs(machine, data, calibration)
    found = [source.candidates(inputs) for source in SOURCES]
    others: set[str] = set()
    if instruments is not None:
        others = {name for one in INSTRUMENTS for name in one.specification.effects}
        others -= {name for one in instruments.every for name in one.specification.effects}
    return Catalogue(
        tuple(candidate for one in found for candidate in one.candidates if candidate.effect not in others),
        tuple(missing for one in found for missing in one.not_evaluated if missing[0] not in others),
    )
