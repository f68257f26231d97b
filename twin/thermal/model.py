"""A thermal model: few named inputs for each displacement, their uncertainty, and predictions for other records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin._common.arrays import read_only
from twin._common.errors import InputError, closest_name
from twin._common.files import write_atomic
from twin._common.records import SPEED, json_form
from twin._common.units import count_with_noun
from twin._common.yaml_files import load_yaml, yaml_text
from twin.display import figure
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects.thermal_response import NAME as RESPONSE
from twin.model.effects.thermal_response import ResponseTerm, ThermalResponse, thermal_response
from twin.numerics.covariance import Covariance
from twin.thermal.evidence import Inputs, TermCandidate, drivers, features, lagged
from twin.thermal.record import ThermalRecord

SCHEMA: Final = "twin.thermal-model/1"
FOLLOWS: Final = 5.0
"""A record continues the fitted one if it begins within this many of its intervals."""
LEAST_TERM_UM: Final = 1e-3
"""A term that moves less than this over the fitted range is left out of an effect."""


@final
@dataclass(frozen=True)
class ThermalTerm:
    """The response of one displacement to one input: sensors, spindle speed or a drift.

    Attributes:
        effect: ``thermal_lag``, ``spindle_growth``, ``spindle_shift`` (no lag) or ``thermal_drift``.
        name: what moves with what: ``d1 by t4``, ``d1 by group t6, t7``, ``d1``.
        input: the input alone: ``t4``, ``group t6, t7``, ``speed``, ``drift``.
        coefficient: in the steady state: µm/K, µm at the highest speed, or µm of a drift.
        standard_uncertainty: of the coefficient, with what the choice of models leaves open.
        time_constant_s: mean time constant, weighted by the squared coefficients; 0 without lag.
        u_time_constant_s: standard deviation of the time constant in the same weights.
        exponent: mean exponent of the speed; None for other effects.
        share: share of the models allowed by the data that follow the same input, 0 to 1.
        alternatives: inputs that the models without this one follow instead.
        contribution_um: RMS change of the displacement by this term over the fitted record.
        matters: whether the term is listed: its contribution exceeds the standard deviation of the residual.
    """

    effect: str
    name: str
    input: str
    coefficient: float
    standard_uncertainty: float
    time_constant_s: float
    u_time_constant_s: float
    exponent: float | None
    share: float
    alternatives: tuple[str, ...]
    contribution_um: float
    matters: bool

    @property
    def unit(self) -> str:
        """Unit of the coefficient."""
        return "µm/K" if self.effect == "thermal_lag" else "µm"


@final
@dataclass(frozen=True)
class DisplacementModel:
    """The model of one displacement and the error that it leaves.

    Attributes:
        terms: by falling contribution.
        coefficients: (candidates + 1,), the constant last: their sum over the candidates is the prediction.
        held_out_um: RMS error on blocks of time that were not fitted; NaN if not validated.
        forward_um: RMS error on what follows the fitted part, for each share of `FORWARD`; empty if not validated.
        calibration: factor from the uncertainty computed to the error found on what follows fitted parts.
        directions: (k, candidates + 1): the sum of the squares of their products with the candidates' values is a variance, µm².
    """

    name: str
    terms: tuple[ThermalTerm, ...]
    coefficients: np.ndarray
    residual_um: float
    held_out_um: float
    forward_um: tuple[float, ...]
    calibration: float
    directions: np.ndarray

    @property
    def listed(self) -> tuple[ThermalTerm, ...]:
        """Terms that matter."""
        return tuple(term for term in self.terms if term.matters)


@final
@dataclass(frozen=True, repr=False)
class ThermalPrediction(Result):
    """Displacements predicted for a record.

    Attributes:
        displacements: names.
        time_s: (n,).
        displacement_um: (n, displacements).
        standard_uncertainty_um: (n, displacements).
        warnings: what the uncertainty was widened for.
        residual_um: measured minus predicted (n, displacements), NaN where the record has no such displacement.
        fitted: whether the record begins as the fitted one did: its residuals are no errors on later data.
    """

    displacements: tuple[str, ...]
    time_s: np.ndarray
    displacement_um: np.ndarray
    standard_uncertainty_um: np.ndarray
    warnings: tuple[str, ...]
    residual_um: np.ndarray
    fitted: bool = False

    @property
    def brief(self) -> str:
        """Displacements and number of rows."""
        return f"{', '.join(self.displacements)} predicted for {count_with_noun(len(self.time_s), 'row')}"

    @property
    def expected_rms_um(self) -> np.ndarray:
        """RMS error that the model expects over these rows (displacements,)."""
        return read_only(np.sqrt((self.standard_uncertainty_um**2).mean(axis=0)))

    @property
    def rms_um(self) -> np.ndarray:
        """RMS of the residuals (displacements,), NaN without measured values."""
        return read_only(np.sqrt((self.residual_um**2).mean(axis=0)))


@final
@dataclass(frozen=True, repr=False)
class ThermalModel(Result):
    """Displacements as sums of lagged temperatures, lagged speed, immediate speed and drift.

    Attributes:
        source: the fitted record.
        candidates: all candidate terms, chosen or not: the uncertainty counts them all.
        inputs: reference temperatures and highest speed.
        displacements: the model of each displacement.
        temperature_range_degC: (sensors, 2), as ``sensors``.
        sensors: sensors needed by a prediction, in the order of the ranges.
        groups: groups of sensors that the record cannot distinguish.
        end_s: time of the last fitted row.
        interval_s: median interval of the fitted record.
        end_state: state of every candidate's lag at that time.
        end_input: input of every candidate at that time.
        unsettled: standard deviation of each candidate's input minus its lag: the uncertainty of an unknown state.
        notices: what was not used.
    """

    source: str
    candidates: tuple[TermCandidate, ...]
    inputs: Inputs
    displacements: tuple[DisplacementModel, ...]
    temperature_range_degC: np.ndarray
    sensors: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    end_s: float
    interval_s: float
    end_state: np.ndarray
    end_input: np.ndarray
    unsettled: np.ndarray
    notices: tuple[str, ...] = ()

    @property
    def brief(self) -> str:
        """Terms and held-out error of every displacement."""
        parts = [
            f"{displacement.name}: {len(displacement.listed)} terms, {figure(displacement.held_out_um, 'µm')} held-out RMS"
            for displacement in self.displacements
        ]
        return f"thermal model of {self.source}; {'; '.join(parts)}"

    @property
    def needs_speed(self) -> bool:
        """Whether a prediction needs the spindle speed."""
        return any(term.exponent for term in self.candidates)

    def predict(self, record: ThermalRecord, *, continues: bool | None = None) -> ThermalPrediction:
        """Predict the displacements of a record, relative to the start of the fitted record.

        Args:
            record: temperatures and speeds.
            continues: whether the record follows the fitted one without a break, so that its lags go on; None decides by its times.

        Raises:
            InputError: a sensor or the speed is missing.
        """
        self._check(record)
        gap = float(record.time_s[0]) - self.end_s
        goes_on = 0.0 < gap <= FOLLOWS * self.interval_s if continues is None else continues
        rows = self._shifted(record, goes_on and continues is True)
        values = self._values(rows, goes_on)
        warnings = [] if goes_on else self._start_warning(rows)
        doubt = np.zeros_like(values)
        if warnings:
            tau = np.array([max(term.time_constant_s, 1e-9) for term in self.candidates])
            doubt = self.unsettled * np.exp(-(rows.time_s - rows.time_s[0])[:, None] / tau)
        beyond, range_warnings = self._beyond(rows)
        found, u = [], []
        for displacement in self.displacements:
            full = np.c_[values, np.ones(len(values))]
            found.append(full @ displacement.coefficients)
            variance = ((full @ displacement.directions.T) ** 2).sum(axis=1) + (doubt**2) @ (
                displacement.coefficients[:-1] ** 2 + (displacement.directions[:, :-1] ** 2).sum(axis=0)
            )
            u.append(displacement.calibration * np.sqrt(variance + (displacement.residual_um * (1.0 + beyond)) ** 2))
        predicted = np.stack(found, axis=1)
        return ThermalPrediction(
            tuple(displacement.name for displacement in self.displacements),
            record.time_s,
            read_only(predicted),
            read_only(np.stack(u, axis=1)),
            tuple([*warnings, *range_warnings]),
            read_only(self._measured(record) - predicted),
            fitted=not goes_on and not warnings,
        )

    def error_um(self, later: ThermalPrediction | None = None) -> dict[str, float]:
        """Return the RMS error of each displacement that was measured on later data, µm; NaN where there are none.

        ``later``: prediction of a later record; where that has no displacement, or is the fitted one, the error on what followed parts
        of the fitted record.
        """
        inside = {
            one.name: float(np.sqrt(np.mean(np.square(one.forward_um or (np.nan,))))) for one in self.displacements
        }
        if later is None or later.fitted:
            return inside
        found = zip(later.displacements, later.rms_um, strict=True)
        return {name: float(value) if np.isfinite(value) else inside[name] for name, value in found}

    def extend(
        self, calibration: Calibration, along: Mapping[str, str], later: ThermalPrediction | None = None
    ) -> Calibration:
        """Return a calibration with the displacements added as effects, for programs and live kinematics.

        The standard uncertainty of each is the RMS error on later data (`error_um`), taken as constant over a program. Each effect is
        refused outside the temperatures and speeds that were fitted. A drift counts as decayed.

        Args:
            calibration: the calibration.
            along: direction of the base frame, X, Y or Z → the displacement that is measured along it, of the tool side; with a minus
                sign before its name if it counts against the direction.
            later: prediction of a later record with displacements.

        Raises:
            InputError: no displacement, no such direction or displacement, one that was not validated.
        """
        if not along:
            raise InputError(
                "no displacement along an axis of the base frame", expected="X, Y or Z with a displacement"
            )
        errors, effects, variances, texts = self.error_um(later), [], [], []
        for direction, name in along.items():
            one = next((one for one in self.displacements if one.name == name.removeprefix("-")), None)
            if one is None:
                known = [one.name for one in self.displacements]
                raise InputError(
                    f"no such displacement in the model of {self.source}",
                    expected=f"one of {', '.join(known)}, with a minus sign if it counts against {direction}",
                    value=name,
                    nearest=closest_name(name, known),
                )
            if not np.isfinite(errors[one.name]):
                raise InputError(f"the error of {one.name} on later data is unknown", expected="a fit with validation")
            if any(effect.name == f"{RESPONSE}:{direction}" for effect in calibration.extra):
                raise InputError(
                    f"the calibration has a thermal response along {direction}",
                    expected="the calibration before that was added",
                    file=calibration.path,
                )
            effects.append(self._effect(calibration.machine, direction, one, -1.0 if name.startswith("-") else 1.0))
            variances.append(errors[one.name] ** 2)
            texts.append(f"along {direction} {name}, RMS error on later data {errors[one.name]:.2g} µm")
        names = tuple(parameter.name for effect in effects for parameter in effect.parameters)
        source = f"thermal response fitted to {Path(self.source).name}: {'; '.join(texts)}"
        return calibration.extended(effects, Covariance(names, read_only(np.diag(variances))), source)

    def _effect(self, machine: Machine, direction: str, one: DisplacementModel, sign: float) -> ThermalResponse:
        limits = {
            f"T_{name}_degC": (float(low), float(high))
            for name, (low, high) in zip(self.sensors, self.temperature_range_degC, strict=True)
        }
        reference = {f"T_{name}_degC": value for name, value in self.inputs.reference_degC.items()}
        terms, offset = [], float(one.coefficients[-1])
        for term, coefficient in zip(self.candidates, one.coefficients[:-1].tolist(), strict=True):
            columns = tuple(f"T_{name}_degC" for name in term.sensors) or (SPEED,)
            if term.effect == "thermal_drift":
                offset += coefficient
            elif abs(coefficient) * max(np.ptp(limits.get(column, (0.0, 1.0))) for column in columns) > LEAST_TERM_UM:
                terms.append(ResponseTerm(columns, term.time_constant_s, term.exponent, sign * coefficient))
        used = dict.fromkeys(column for term in terms for column in term.columns)
        ranges = {column: limits.get(column, (0.0, self.inputs.highest_rpm)) for column in used}
        return thermal_response(
            machine, direction, sign * offset, terms, {name: reference[name] for name in used if name != SPEED}, ranges
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the terms, groups, ranges and errors for JSON."""
        return {
            "schema": SCHEMA,
            "source": self.source,
            "highest_rpm": self.inputs.highest_rpm,
            "temperature_range_degC": {
                name: [float(low), float(high)]
                for name, (low, high) in zip(self.sensors, self.temperature_range_degC, strict=True)
            },
            "groups": [list(group) for group in self.groups if len(group) > 1],
            "displacements": [_displacement_dict(displacement) for displacement in self.displacements],
            "notices": list(self.notices),
        }

    def _check(self, record: ThermalRecord) -> None:
        missing = [name for name in self.sensors if name not in record.sensors]
        if missing:
            expected = (
                f"columns {', '.join(f'T_{name}_degC' for name in missing)}: the model of {self.source} needs them"
            )
            raise InputError(
                f"{len(missing)} of {len(self.sensors)} sensors missing", expected=expected, file=record.path
            )
        if self.needs_speed and record.speed_rpm is None:
            raise InputError(
                f"no column {SPEED}", expected="the spindle speed, which the model needs", file=record.path
            )

    def _shifted(self, record: ThermalRecord, follow: bool) -> ThermalRecord:
        """Return the record with its times moved behind the fitted ones, if it must follow them."""
        if not follow or record.time_s[0] > self.end_s:
            return record
        moved = record.time_s - record.time_s[0] + self.end_s + self.interval_s
        return ThermalRecord(
            record.path,
            read_only(moved),
            record.temperature_degC,
            record.sensors,
            record.displacement_um,
            record.displacements,
            record.speed_rpm,
        )

    def _values(self, record: ThermalRecord, goes_on: bool) -> np.ndarray:
        if not goes_on:
            return features(record, self.candidates, self.inputs)
        now = drivers(record, self.candidates, self.inputs)[0]
        times = np.array([self.end_s, float(record.time_s[0])])
        states = [
            lagged(np.array([last, first]), times, term.time_constant_s, float(state), held=term.exponent > 0.0)[1]
            for term, last, first, state in zip(self.candidates, self.end_input, now, self.end_state, strict=True)
        ]
        return features(record, self.candidates, self.inputs, np.array(states))

    def _start_warning(self, record: ThermalRecord) -> list[str]:
        start = drivers(record, self.candidates, self.inputs)[0]
        if record.time_s[0] == self.inputs.start_s and np.allclose(start, 0.0, atol=1e-9):
            return []  # the fitted record itself, or one that begins with it
        return [
            "the record does not continue the fitted one: lags start in steady state, and the uncertainty is larger until they settle; "
            "displacements count from the start of the fitted record"
        ]

    def _beyond(self, record: ThermalRecord) -> tuple[np.ndarray, list[str]]:
        """Return how far each row lies outside the fitted ranges, in widths of the range, and warnings on it."""
        far = np.zeros(len(record))
        outside, largest = [], 0.0
        for name, (low, high) in zip(self.sensors, self.temperature_range_degC, strict=True):
            values = record.temperature_degC[:, record.sensors.index(name)]
            excess = np.maximum(np.maximum(low - values, values - high), 0.0)
            far = np.maximum(far, excess / max(high - low, 1e-9))
            if excess.max() > 0.0:
                outside.append(name)
                largest = max(largest, float(excess.max()))
        warnings = []
        if outside:
            warnings.append(
                f"{len(outside)} of {len(self.sensors)} sensors leave the fitted range, by at most {largest:.2g} K "
                f"({', '.join(outside)}): extrapolated with larger uncertainty"
            )
        if record.speed_rpm is not None and self.needs_speed:
            excess = np.maximum(record.speed_rpm - self.inputs.highest_rpm, 0.0)
            far = np.maximum(far, excess / max(self.inputs.highest_rpm, 1e-9))
            if excess.max() > 0.0:
                warnings.append(
                    f"speed up to {record.speed_rpm.max():g} rpm, fitted up to {self.inputs.highest_rpm:g} rpm: extrapolated with "
                    "larger uncertainty"
                )
        return far, warnings

    def _measured(self, record: ThermalRecord) -> np.ndarray:
        measured = np.full((len(record), len(self.displacements)), np.nan)
        for k, one in enumerate(self.displacements):
            if one.name in record.displacements:
                measured[:, k] = record.displacement_um[:, record.displacements.index(one.name)]
        return measured


def _displacement_dict(one: DisplacementModel) -> dict[str, Any]:
    return {
        "name": one.name,
        "residual_um": one.residual_um,
        "held_out_rms_um": one.held_out_um,
        "forward_rms_um": list(one.forward_um),
        "uncertainty_factor": one.calibration,
        "terms": [{**json_form(term), "unit": term.unit} for term in one.terms],
    }


# --- The file of a thermal model -----------------------------------------------------------------

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
    """Write a model atomically. Raises `InputError`: it cannot be written."""
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
