"""Catalogue of candidate causes: every effect of machine, instrument and calibration that these data allow to be tested.

Candidates of the machine come from the effects' specifications (`twin.model.effects`); those of the instrument and of the calibration
are specified here. To add one, write it beside its like and add it to `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from twin.diagnosis.candidates import calibration as of_calibration
from twin.diagnosis.candidates import instrument as of_instrument
from twin.diagnosis.candidates import machine as of_machine
from twin.diagnosis.candidates.candidate import CandidateInputs, Catalogue
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, StationInstruments
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import MACHINE_EFFECTS, Specification

SOURCES: Final[tuple[tuple[Callable[[CandidateInputs], Catalogue], *tuple[Specification, ...]], ...]] = (
    (of_machine.machine_effects,),
    (of_machine.added_payloads,),
    (of_machine.curves,),
    (of_instrument.alignments, of_instrument.FRAME_SHIFT, of_instrument.TARGET_SHIFT),
    (of_instrument.refraction_scale, of_instrument.REFRACTION_SCALE),
    (of_instrument.affine_scales, of_instrument.AFFINE_SCALE),
    (of_instrument.beam_bendings, of_instrument.BEAM_BENDING),
    (of_instrument.sensor_linearities, of_instrument.SENSOR_LINEARITY),
    (of_instrument.station_drifts, of_instrument.STATION_DRIFT),
    (of_instrument.time_skews, of_instrument.TIME_SKEW),
    (of_machine.reversal_spikes, of_machine.REVERSAL_SPIKE),
    (of_machine.following_errors, of_machine.FOLLOWING_ERROR, of_machine.READ_BACK),
    (of_instrument.probe_lobings, of_instrument.PROBE_LOBING),
    (of_calibration.misplaced, of_calibration.MISPLACED),
)
"""Functions that return candidates, each with the effects that are not among those of the machine."""
SPECIFICATIONS: Final[dict[str, Specification]] = {
    one.name: one for one in (*MACHINE_EFFECTS, *(own for _, *others in SOURCES for own in others))
}
"""Every effect by its name."""


def catalogue(
    machine: Machine, data: Measurements, calibration: Calibration, instruments: StationInstruments | None = None
) -> Catalogue:
    """Return every effect of contract §5 that the machine, the columns of the data and the instruments (None: not known) allow.

    The curve of a rotary axis is a candidate only where the calibration's is a polynomial.
    """
    inputs = CandidateInputs(machine, data, calibration)
    by_source = [candidates(inputs) for candidates, *_ in SOURCES]
    others: set[str] = set()
    if instruments is not None:
        others = {name for instrument in INSTRUMENTS for name in instrument.specification.effects}
        others -= {name for one in instruments.every for name in one.specification.effects}
    return Catalogue(
        tuple(candidate for one in by_source for candidate in one.candidates if candidate.effect not in others),
        tuple(missing for one in by_source for missing in one.not_evaluated if missing[0] not in others),
    )
