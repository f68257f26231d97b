"""The entries of a calibration file, as pydantic checks them, and the effects they stand for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError
from twin.machine.control import BasicClass
from twin.machine.effects import Effect, GravityCompliance, Payload
from twin.machine.effects.entries import effect_named, payload_named
from twin.machine.effects.gravity_compliance import PAYLOAD
from twin.machine.empirical_entry import NAME as EMPIRICAL
from twin.machine.empirical_entry import ColumnSpec, empirical_named
from twin.machine.machine import Machine


class CurveEntry(BaseModel):
    """One error motion."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
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

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    column: str
    functions: Literal["half_waves", "whole_turns", "direction"]
    order: int | None = None
    range: tuple[float, float] | None = None


class EffectEntry(BaseModel):
    """One effect; the last four only of an empirical one."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    effect: str
    where: str
    parameters: dict[str, float]
    cause: Literal["unknown"] | None = None
    note: str = ""
    along: Literal["base", "tool", "work"] | None = None
    columns: tuple[ColumnEntry, ...] = ()


class CovarianceEntry(BaseModel):
    """Covariance of all parameters together."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    parameters: tuple[str, ...]
    lower: str


class TableFileEntry(BaseModel):
    """One table of the control."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    file: str
    format: str
    classes: tuple[BasicClass, ...]
    sha256: str


class ControlEntry(BaseModel):
    """What the control corrects."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    errors_are: Literal["uncorrected", "remaining"]
    tables: Annotated[tuple[TableFileEntry, ...], Field(min_length=1)]


class CalibrationFile(BaseModel):
    """A calibration file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    schema_: Literal["twin.calibration/1"] = Field(alias="schema")
    machine: str
    source: str
    datum: str | None = None
    settled: bool = True
    simulated: bool = False
    curves: dict[str, CurveEntry] = {}
    squareness: dict[str, float] = {}
    location: dict[str, float] = {}
    covariance: CovarianceEntry | None = None
    effects: tuple[EffectEntry, ...] = ()
    control: ControlEntry | None = None


def effects_of(entries: Sequence[EffectEntry], machine: Machine, fail: Callable[..., InputError]) -> tuple[Effect, ...]:
    """The effects of a calibration file.

    Args:
        entries: as they stand there.
        machine: the machine.
        fail: place in the file, what, what was expected, value and nearest → the error.

    Raises:
        InputError: an effect that the machine cannot have, or a payload that acts on nothing.
    """
    payloads: dict[int, Payload] = {}
    found: list[Effect] = []
    # The payloads first: every joint that gives way does so under them as well.
    for index, entry in sorted(enumerate(entries), key=lambda one: (one[1].effect != PAYLOAD.name, one[0])):
        try:
            if entry.effect == PAYLOAD.name:
                payloads[index] = payload_named(entry.where, entry.parameters, machine)
            else:
                found.append(_effect(entry, machine, list(payloads.values())))
        except InputError as error:
            raise fail(("effects", index), error.what, str(error.expected), error.value, error.nearest) from None
    last = max(payloads, default=0)
    if payloads and not any(isinstance(effect, GravityCompliance) for effect in found):
        expected = "a gravity_compliance of the joints that give way under it"
        raise fail(("effects", last), "a payload that acts on nothing", expected, "none in the file")
    if len({payload.side for payload in payloads.values()}) < len(payloads):
        raise fail(("effects", last), "more than one payload on a side", "one", len(payloads))
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
    columns = [ColumnSpec(one.column, one.functions, one.order, one.range) for one in entry.columns]
    return empirical_named(entry.where, entry.along, columns, entry.parameters, machine)
