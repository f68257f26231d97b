"""Thermal model files: YAML with ``schema: twin.thermal-model/1``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.yaml_files import load_yaml, yaml_text
from twin.thermal.evidence import Inputs, TermCandidate
from twin.thermal.model import SCHEMA, DisplacementModel, ThermalModel, ThermalTerm

Effect = Literal["thermal_lag", "spindle_growth", "spindle_shift", "thermal_drift"]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class ModelEntry(BaseModel):
    """Any entry: no unknown keys, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CandidateEntry(ModelEntry):
    """One candidate term."""

    effect: Effect
    sensors: tuple[str, ...] = ()
    time_constant_s: NotNegative
    exponent: NotNegative = 0.0
    prior: Positive
    end_state: float
    end_input: float
    unsettled: NotNegative


class TermEntry(ModelEntry):
    """One named term."""

    effect: Effect
    name: str
    input: str
    coefficient: float
    standard_uncertainty: NotNegative
    time_constant_s: NotNegative
    u_time_constant_s: NotNegative
    exponent: float | None = None
    share: float
    alternatives: tuple[str, ...] = ()
    contribution_um: NotNegative
    matters: bool


class DisplacementEntry(ModelEntry):
    """One displacement."""

    name: str
    terms: tuple[TermEntry, ...]
    residual_um: NotNegative
    held_out_um: float | None
    forward_um: tuple[float, ...]
    calibration: Positive
    coefficients: tuple[float, ...]
    directions: tuple[tuple[float, ...], ...]


class SensorEntry(ModelEntry):
    """One sensor with its range in the fitted record."""

    reference_degC: float
    lowest_degC: float
    highest_degC: float


class ModelFile(ModelEntry):
    """The whole file."""

    schema_: str = Field(alias="schema")
    source: str
    start_s: float
    end_s: float
    interval_s: Positive
    highest_rpm: NotNegative
    sensors: dict[str, SensorEntry]
    groups: tuple[tuple[str, ...], ...]
    displacements: Annotated[tuple[DisplacementEntry, ...], Field(min_length=1)]
    candidates: Annotated[tuple[CandidateEntry, ...], Field(min_length=1)]
    notices: tuple[str, ...] = ()


def save_model(model: ThermalModel, path: str | Path) -> None:
    """Write a model atomically.

    Raises:
        InputError: it cannot be written.
    """
    data = {
        "schema": SCHEMA,
        "source": model.source,
        "start_s": model.inputs.start_s,
        "end_s": model.end_s,
        "interval_s": model.interval_s,
        "highest_rpm": model.inputs.highest_rpm,
        "sensors": {
            name: {
                "reference_degC": model.inputs.reference_degC[name],
                "lowest_degC": float(low),
                "highest_degC": float(high),
            }
            for name, (low, high) in zip(model.sensors, model.temperature_range_degC, strict=True)
        },
        "groups": [list(group) for group in model.groups],
        "displacements": [_displacement(displacement) for displacement in model.displacements],
        "candidates": [
            {
                "effect": term.effect,
                "sensors": list(term.sensors),
                "time_constant_s": term.time_constant_s,
                "exponent": term.exponent,
                "prior": term.prior,
                "end_state": float(state),
                "end_input": float(last),
                "unsettled": float(unsettled),
            }
            for term, state, last, unsettled in zip(
                model.candidates, model.end_state, model.end_input, model.unsettled, strict=True
            )
        ],
        "notices": list(model.notices),
    }
    text = yaml_text(data)
    write_atomic(Path(path), text, check=load_model)


def _displacement(one: DisplacementModel) -> dict[str, Any]:
    keys = TermEntry.model_fields
    return {
        "name": one.name,
        "terms": [
            {key: list(value) if isinstance(value := getattr(term, key), tuple) else value for key in keys}
            for term in one.terms
        ],
        "residual_um": one.residual_um,
        "held_out_um": one.held_out_um if np.isfinite(one.held_out_um) else None,
        "forward_um": list(one.forward_um),
        "calibration": one.calibration,
        "coefficients": [float(value) for value in one.coefficients],
        "directions": [[float(f"{value:.6g}") for value in row] for row in one.directions],
    }


def load_model(path: str | Path) -> ThermalModel:
    """Read a model.

    Raises:
        InputError: with the line, on anything that does not match; a candidate of an unknown sensor; a wrong number of coefficients.
    """
    file = Path(path)
    data, lines = load_yaml(file, ModelFile, SCHEMA)
    for i, term in enumerate(data.candidates):
        unknown = [name for name in term.sensors if name not in data.sensors]
        if unknown:
            line = lines.get(("candidates", i))
            raise InputError("unknown sensor", expected="one of `sensors`", file=file, line=line, value=unknown[0])
    size = len(data.candidates) + 1
    for i, one in enumerate(data.displacements):
        if {size} != {len(one.coefficients), *map(len, one.directions)}:
            expected = (
                f"{size} numbers in `coefficients` and in each of `directions`: one a candidate, and the constant"
            )
            raise InputError(
                f"{one.name} does not match `candidates`",
                expected=expected,
                file=file,
                line=lines.get(("displacements", i)),
            )
    return ThermalModel(
        source=data.source,
        candidates=tuple(
            TermCandidate(term.effect, term.sensors, term.time_constant_s, term.exponent, term.prior)
            for term in data.candidates
        ),
        inputs=Inputs(
            {name: sensor.reference_degC for name, sensor in data.sensors.items()}, data.highest_rpm, data.start_s
        ),
        displacements=tuple(_read_displacement(displacement) for displacement in data.displacements),
        temperature_range_degC=_array(
            [(sensor.lowest_degC, sensor.highest_degC) for sensor in data.sensors.values()], 2
        ),
        sensors=tuple(data.sensors),
        groups=data.groups,
        end_s=data.end_s,
        interval_s=data.interval_s,
        end_state=read_only(np.array([term.end_state for term in data.candidates])),
        end_input=read_only(np.array([term.end_input for term in data.candidates])),
        unsettled=read_only(np.array([term.unsettled for term in data.candidates])),
        notices=data.notices,
    )


def _read_displacement(one: DisplacementEntry) -> DisplacementModel:
    return DisplacementModel(
        name=one.name,
        terms=tuple(ThermalTerm(**dict(term)) for term in one.terms),
        coefficients=read_only(np.array(one.coefficients)),
        residual_um=one.residual_um,
        held_out_um=float("nan") if one.held_out_um is None else one.held_out_um,
        forward_um=one.forward_um,
        calibration=one.calibration,
        directions=_array(one.directions, len(one.coefficients)),
    )


def _array(rows: Sequence[Sequence[float]], width: int) -> np.ndarray:
    return read_only(np.array(rows, dtype=float).reshape(len(rows), width))
