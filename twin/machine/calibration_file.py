"""Entries of a calibration file as pydantic models, and their conversion to effects."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from twin._common.errors import InputError
from twin._common.provenance import MODEL_NOT_TESTED, NOISE_CONTRADICTED, SYSTEMATIC_RESIDUALS, SourceWarning
from twin._common.yaml_files import yaml_text
from twin.machine.classes import BasicClass
from twin.machine.effects import Effect, GravityCompliance, Payload
from twin.machine.effects.entries import effect_named, payload_named
from twin.machine.effects.gravity_compliance import CARRIED_LOAD, PAYLOAD
from twin.machine.effects.table_load import TableLoad
from twin.machine.empirical_entry import NAME as EMPIRICAL
from twin.machine.empirical_entry import ColumnSpec, empirical_named
from twin.machine.machine import Machine
from twin.numerics.covariance import Covariance

READABLE: Final = 20
"""Largest number of parameters whose joint covariance is written as readable rows."""


class CurveEntry(BaseModel):
    """One error motion."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    unit: str
    domain: tuple[float, float]
    basis: str
    knots: tuple[float, ...] = ()
    coefficients: Annotated[tuple[float, ...], Field(min_length=1)]
    covariance: tuple[tuple[float, ...], ...] | None = None
    illustrative: bool = False
    source: str = ""


class ColumnEntry(BaseModel):
    """One column of an empirical effect."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    column: str
    functions: Literal["half_waves", "whole_turns", "direction"]
    order: int | None = None
    range: tuple[float, float] | None = None


class EffectEntry(BaseModel):
    """One effect; the last four fields apply only to an empirical effect."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    effect: str
    where: str
    parameters: dict[str, float]
    cause: Literal["unknown"] | None = None
    note: str = ""
    along: Literal["base", "tool", "work"] | None = None
    columns: tuple[ColumnEntry, ...] = ()


class CovarianceEntry(BaseModel):
    """Joint covariance of all parameters: its lower triangle in rows, or compressed with its SHA-256 (`Covariance.to_compressed`)."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    parameters: tuple[str, ...]
    lower: str | None = None
    compressed: str | None = None
    sha256: str = ""


class TableFileEntry(BaseModel):
    """One table of the control."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    file: str
    format: str
    classes: tuple[BasicClass, ...]
    sha256: str


class ControlEntry(BaseModel):
    """Correction tables and kinematics active in the control."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    errors_are: Literal["uncorrected", "remaining"]
    tables: tuple[TableFileEntry, ...] = ()
    kinematics: Annotated[tuple[TableFileEntry, ...], Field(max_length=1)] = ()

    @model_validator(mode="after")
    def _not_empty(self) -> ControlEntry:
        if not self.tables and not self.kinematics:
            raise ValueError("tables or kinematics are required")
        return self


class UnidentifiedEntry(BaseModel):
    """An error that the readings did not determine.

    Attributes:
        name: ISO 230-1 name.
        why: the reason, and what would change it; one sentence.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    name: str
    why: Annotated[str, Field(min_length=1)]


class MisfitEntry(BaseModel):
    """Residuals of the identification, compared with the noise stated for the readings.

    Attributes:
        verdict: ``consistent``; ``systematic`` (a repeatable part is left); ``larger`` than stated; ``untested`` (too few readings).
        says: the verdict as a sentence.
        rms_um: RMS of the residuals of a coordinate, µm.
        reduced_chi2: chi² per degree of freedom.
        dof: degrees of freedom.
        p_value: probability of a chi² at least as large if the stated noise holds.
        lack_of_fit_p_value: p-value of the residuals compared with repeats.
        held_out_rms_um: RMS of the residuals at positions that were not used, µm.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    verdict: Literal["consistent", "systematic", "larger", "untested"]
    says: str = ""
    rms_um: Annotated[float, Field(ge=0.0)] | None = None
    reduced_chi2: Annotated[float, Field(ge=0.0)] | None = None
    dof: Annotated[float, Field(ge=0.0)] | None = None
    p_value: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    lack_of_fit_p_value: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    held_out_rms_um: Annotated[float, Field(ge=0.0)] | None = None

    @property
    def warning(self) -> SourceWarning | None:
        """Warning that every file made from the calibration repeats; None if the residuals are consistent with the noise."""
        return MISFIT_WARNINGS[self.verdict]


MISFIT_WARNINGS: Final[dict[str, SourceWarning | None]] = {
    "consistent": None,
    "systematic": SYSTEMATIC_RESIDUALS,
    "larger": NOISE_CONTRADICTED,
    "untested": MODEL_NOT_TESTED,
}


class MeasuredWith(BaseModel):
    """Set-up of the measurement.

    Attributes:
        stations: number of stations.
        targets_on_tool, targets_on_work: number of reflectors, balls or spheres on either side.
        points: number of points used.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    stations: Annotated[int, Field(ge=0)]
    targets_on_tool: Annotated[int, Field(ge=0)]
    targets_on_work: Annotated[int, Field(ge=0)]
    points: Annotated[int, Field(ge=0)]


class CalibrationFile(BaseModel):
    """A calibration file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
    schema_: Literal["twin.calibration/1"] = Field(alias="schema")
    machine: str
    source: str
    datum: str | None = None
    settled: bool = True
    simulated: bool = False
    instruments: tuple[str, ...] = ()
    set_up: MeasuredWith | None = None
    misfit: MisfitEntry | None = None
    not_identifiable: tuple[UnidentifiedEntry, ...] = ()
    not_estimated: tuple[str, ...] = ()
    curves: dict[str, CurveEntry] = {}
    squareness: dict[str, float] = {}
    location: dict[str, float] = {}
    covariance: CovarianceEntry | None = None
    effects: tuple[EffectEntry, ...] = ()
    control: ControlEntry | None = None


def effects_of(entries: Sequence[EffectEntry], machine: Machine, fail: Callable[..., InputError]) -> tuple[Effect, ...]:
    """Return the effects of a calibration file.

    Args:
        entries: entries of the file.
        machine: the machine.
        fail: place in the file, what is wrong, what was expected, value and nearest valid name → the error.

    Raises:
        InputError: the machine cannot have an effect, a payload or carried load acts on no compliant joint, a side has more than one
            payload, or there is more than one carried load.
    """
    masses = {one.name: one for one in (PAYLOAD, CARRIED_LOAD)}
    payloads: dict[int, Payload] = {}
    found: list[Effect] = []
    # Payloads first, because they load every compliant joint.
    for index, entry in sorted(enumerate(entries), key=lambda item: (item[1].effect not in masses, item[0])):
        try:
            if entry.effect in masses:
                payloads[index] = payload_named(masses[entry.effect], entry.where, entry.parameters, machine)
            else:
                found.append(_effect(entry, machine, list(payloads.values())))
        except InputError as error:
            raise fail(("effects", index), error.what, str(error.expected), error.value, error.nearest) from None
    last = max(payloads, default=0)
    if payloads and not any(
        isinstance(effect, GravityCompliance) or (isinstance(effect, TableLoad) and effect.payloads) for effect in found
    ):
        expected = "a gravity_compliance of a joint that it loads, or a table_load with a moment"
        raise fail(("effects", last), f"a {entries[last].effect} that loads no joint", expected, "none in the file")
    constant = [payload.side for payload in payloads.values() if not payload.carried]
    if len(set(constant)) < len(constant):
        raise fail(("effects", last), "more than one payload on a side", "one", len(constant))
    if len(payloads) - len(constant) > 1:
        raise fail(("effects", last), f"more than one {CARRIED_LOAD.name}", "one", len(payloads) - len(constant))
    return tuple(found)


def _effect(entry: EffectEntry, machine: Machine, payloads: Sequence[Payload]) -> Effect:
    if entry.effect != EMPIRICAL:
        if entry.cause is not None or entry.along is not None or entry.columns:
            what = f"{entry.effect} has a known cause and form"
            raise InputError(what, expected=f"cause, along and columns only with {EMPIRICAL}")
        return effect_named(entry.effect, entry.where, entry.parameters, machine, payloads)
    if entry.cause is None or entry.along is None:
        raise InputError(
            f"{EMPIRICAL} {entry.where} without cause or along",
            expected="cause: unknown, and along: base, tool or work",
        )
    columns = [ColumnSpec(column.column, column.functions, column.order, column.range) for column in entry.columns]
    return empirical_named(entry.where, entry.along, columns, entry.parameters, machine)


def measurement_entries(
    instruments: Sequence[str],
    set_up: MeasuredWith | None,
    misfit: MisfitEntry | None,
    not_identifiable: Sequence[UnidentifiedEntry],
    not_estimated: Sequence[str],
) -> dict[str, Any]:
    """Return the entries on how a calibration was measured and what is not known; those without content are left out."""
    found: dict[str, Any] = {
        "instruments": list(instruments),
        "set_up": None if set_up is None else set_up.model_dump(),
        "misfit": None if misfit is None else misfit.model_dump(exclude_none=True),
        "not_identifiable": [one.model_dump() for one in not_identifiable],
        "not_estimated": list(not_estimated),
    }
    return {name: value for name, value in found.items() if value}


def covariance_text(covariance: Covariance) -> str:
    """Return the entry of a joint covariance, the last of a calibration file: readable rows if it is small, compressed otherwise."""
    names = yaml_text(list(covariance.names)).replace("\n", "\n    ").rstrip()
    if len(covariance.names) <= READABLE:
        form, lines = "lower", covariance.to_text().splitlines()
        head = ""
    else:
        text, sha256 = covariance.to_compressed()
        form, lines = "compressed", textwrap.wrap(text, 120)
        head = f"  sha256: {sha256}\n"
    return f"covariance:\n  parameters: {names}\n{head}  {form}: |\n" + "".join(f"    {line}\n" for line in lines)


def covariance_of(entry: CovarianceEntry) -> Covariance:
    """Return the joint covariance of an entry.

    Raises:
        ValueError: neither or both forms, or numbers that are not a covariance.
    """
    if (entry.lower is None) == (entry.compressed is None):
        raise ValueError("needs one of lower and compressed")
    if entry.lower is not None:
        return Covariance.from_text(entry.parameters, entry.lower)
    return Covariance.from_compressed(entry.parameters, entry.compressed or "", entry.sha256)
