"""Catalogue of candidate causes: every effect of machine, instrument and calibration that these data allow to be tested."""

from __future__ import annotations

from typing import Final

from twin.diagnosis.candidates import misplaced
from twin.diagnosis.candidates.candidate import CandidateInputs, CandidateSource, Catalogue
from twin.diagnosis.candidates.displaced import ALIGNMENT_SOURCE
from twin.diagnosis.candidates.instrument import (
    AFFINE_SCALE_SOURCE,
    BEAM_BENDING_SOURCE,
    PROBE_LOBING_SOURCE,
    REFRACTION_SCALE_SOURCE,
    SENSOR_LINEARITY_SOURCE,
    STATION_DRIFT_SOURCE,
    TIME_SKEW_SOURCE,
)
from twin.diagnosis.candidates.machine import (
    ADDED_PAYLOAD_SOURCE,
    CURVES_SOURCE,
    FOLLOWING_ERROR_SOURCE,
    MACHINE_EFFECTS_SOURCE,
    REVERSAL_SPIKE_SOURCE,
)
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, StationInstruments
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import MACHINE_EFFECTS, Specification

SOURCES: Final[tuple[CandidateSource, ...]] = (
    MACHINE_EFFECTS_SOURCE,
    ADDED_PAYLOAD_SOURCE,
    CURVES_SOURCE,
    ALIGNMENT_SOURCE,
    REFRACTION_SCALE_SOURCE,
    AFFINE_SCALE_SOURCE,
    BEAM_BENDING_SOURCE,
    SENSOR_LINEARITY_SOURCE,
    STATION_DRIFT_SOURCE,
    TIME_SKEW_SOURCE,
    REVERSAL_SPIKE_SOURCE,
    FOLLOWING_ERROR_SOURCE,
    PROBE_LOBING_SOURCE,
    misplaced.SOURCE,
)
SPECIFICATIONS: Final[dict[str, Specification]] = {
    one.name: one for one in (*MACHINE_EFFECTS, *(own for source in SOURCES for own in source.specifications))
}
"""Every effect by its name."""


def catalogue(
    machine: Machine, data: Measurements, calibration: Calibration, instruments: StationInstruments | None = None
) -> Catalogue:
    """Return every effect of contract §5 that the machine, the columns of the data and the instruments (None: not known) allow.

    The curve of a rotary axis is a candidate only where the calibration's is a polynomial.
    """
    inputs = CandidateInputs(machine, data, calibration)
    by_source = [source.candidates(inputs) for source in SOURCES]
    others: set[str] = set()
    if instruments is not None:
        others = {name for instrument in INSTRUMENTS for name in instrument.specification.effects}
        others -= {name for one in instruments.every for name in one.specification.effects}
    return Catalogue(
        tuple(candidate for one in by_source for candidate in one.candidates if candidate.effect not in others),
        tuple(missing for one in by_source for missing in one.not_evaluated if missing[0] not in others),
    )
