"""Evaluate the thermal tests of ISO 230-3 from a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from twin._common.errors import InputError, require_type
from twin._common.provenance import SIMULATED
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.standards.drift.record import DriftRecord, is_displacement_record, load_displacements
from twin.standards.drift.relative import relative_displacements
from twin.standards.drift.sensors import SensorMap
from twin.standards.drift.tests import drift_tests
from twin.standards.readings import NotPossible
from twin.standards.result import EvaluationResult, NotEvaluated, StandardTest, check_limits, check_tolerances

TITLE: Final = "thermal tests (ISO 230-3)"
BUDGET: Final = (
    "U (95 %) contains the noise of two readings only: no drift of the instrument, no expansion of mandrel or fixture."
)


def evaluate_drift(
    path: str | Path,
    machine: Machine,
    *,
    tolerances: Mapping[str, float] | None = None,
    instrument: Instrument | None = None,
    sensors: Sequence[str] = (),
) -> EvaluationResult:
    """Evaluate the tests of ISO 230-3: environment, rotating spindle, moving linear axes.

    Args:
        path: a record of displacement sensors (``time_s``, ``<name>_um``), or a measurement table with ``time_s``.
        machine: the machine that was measured.
        tolerances: largest permitted values by key (``d_Z_t``) or name of the test and key (``spindle:d_Z_t``); µm, µrad.
        instrument: instrument whose noise model gives the uncertainty of a table's readings.
        sensors: directions of displacement sensors (``d1=X1``), distances (``X1-X2=76``), ambient sensor (``t5=ambient``).

    Raises:
        InputError: a file that is neither, directions that cannot be read, a negative tolerance.
    """
    require_type("machine", machine, Machine)
    check_limits(tolerances or {})
    directions = SensorMap.parse(sensors)
    record = _record(path, machine, directions, instrument)
    tests: list[StandardTest] = []
    missing: list[NotEvaluated] = []
    try:
        tests += drift_tests(record, machine)
    except NotPossible as reason:
        missing.append(NotEvaluated(TITLE, str(reason)))
    return EvaluationResult(
        data=record,
        machine=machine.name,
        tests=tuple(tests),
        not_evaluated=tuple(missing),
        assumptions=(),
        uncertainty=BUDGET if np.isfinite(record.u_um) else "",
        checks=check_tolerances(tolerances or {}, tests),
        warnings=(SIMULATED,) if record.simulated else (),
    )


def _record(path: str | Path, machine: Machine, directions: SensorMap, instrument: Instrument | None) -> DriftRecord:
    if is_displacement_record(path):
        if instrument is not None:
            raise InputError(
                "a record of displacement sensors has no noise model", expected="no instrument", value=instrument.name
            )
        return load_displacements(path, machine, directions)
    if directions.sensor or directions.distance_mm:
        raise InputError(
            "directions of sensors are for records with columns <name>_um", expected="such a record", file=Path(path)
        )
    data = Measurements.load(path, machine)
    if directions.ambient:
        directions.check([], list(data.temperature_degC))
    return relative_displacements(data, machine, instrument, directions.ambient_of(data.temperature_degC))
