"""Entries of a calibration file as pydantic models, and their conversion to effects.

An empirical effect:

    effects:
    - effect: empirical
      where: tool by X_mm, Y_mm
      cause: unknown
      along: base
      columns:
      - {column: X_mm, functions: half_waves, order: 8, range: [0.0, 500.0]}
      - {column: Y_mm, functions: half_waves, order: 8, range: [0.0, 450.0]}
      parameters: {'x[1,0]': 0.42, 'x[1,3]': -1.7}

The shift of that side along x, y, z of `along` in µm is the sum of the parameters times their functions. `x[1,3]` belongs to function 1
of the first column times function 3 of the second. 0 is the constant function; `c2` and `s2` are cosine and sine of twice the angle.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from math import pi
from typing import Annotated, Any, Final, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field, PlainValidator, model_validator

from twin._common.errors import InputError, closest_name
from twin._common.families import BasicClass
from twin._common.messages import joined, message_data, message_from
from twin._common.provenance import MODEL_NOT_TESTED, NOISE_CONTRADICTED, SYSTEMATIC_RESIDUALS, SourceWarning
from twin._common.records import APPROACH, is_temperature
from twin._common.yaml_files import yaml_text
from twin.machine.machine import ErrorFrame, Machine
from twin.machine.machine_file import FileEntry
from twin.model.effects import Effect, Empirical, Frame, GravityCompliance, Payload
from twin.model.effects.base import numbered, rest_orientation
from twin.model.effects.empirical import FrameRotation, channel_name
from twin.model.effects.entries import effect_named, entry_of, payload_named
from twin.model.effects.gravity_compliance import CARRIED_LOAD, PAYLOAD
from twin.model.effects.harmonic import Kind, Waves
from twin.model.effects.spindle_growth import LARGEST_EXPONENT
from twin.model.effects.table_load import TableLoad
from twin.model.effects.thermal_drift import LARGEST_DRIFT_UM, LONGEST_S
from twin.model.effects.thermal_response import NAME as RESPONSE
from twin.model.effects.thermal_response import ResponseTerm, ThermalResponse, thermal_response
from twin.numerics.covariance import Covariance

NAME: Final = "empirical"
NOTE: Final = (
    "Measured, cause unknown. Valid only inside these ranges. "
    "x[j,k] is um along x, times function j of the first column, times function k of the second; 0 means 1. "
    "half_waves k: cos(k pi (value - low)/(high - low)); whole_turns ck, sk: cos, sin of k times the angle; direction: +1 or -1."
)
"""Explanation for readers of the file; not evaluated."""
MAX_COEFFICIENT_UM: Final = 20_000.0
MAX_ORDER: Final = 64
"""Largest coefficient and highest order accepted in a file."""
Along = Literal["base", "tool", "work"]


def empirical_named(
    where: str, along: Along, columns: Sequence[ColumnEntry], numbers: Mapping[str, float], machine: Machine
) -> Empirical:
    """Create an empirical effect from its entry in a calibration file."""
    match = re.fullmatch(r"(tool|work) by (.+?)( \(\d+\))?", where)
    named = ", ".join(column.column for column in columns)
    if match is None or match[2] != named:
        raise InputError(
            f"no such place for {NAME}", expected=f"tool or work by the columns, such as tool by {named}", value=where
        )
    side = match[1]
    if along not in ("base", side):
        raise InputError(f"{NAME} {where} along the axes of the other side", expected=f"base or {side}", value=along)
    if len(columns) not in (1, 2) or len({column.column for column in columns}) < len(columns):
        raise InputError(f"columns of {NAME} {where}", expected="one column, or two", value=named)
    waves = [_waves(where, column, machine) for column in columns]
    known = [name for own in Empirical.names(waves) for name in own]
    for name, value in numbers.items():
        if name not in known:
            expected = f"{known[0]} … {known[-1]}"
            raise InputError(
                f"no such parameter of {NAME} {where}", expected=expected, value=name, nearest=closest_name(name, known)
            )
        if abs(value) > MAX_COEFFICIENT_UM:
            expected = f"at most {MAX_COEFFICIENT_UM:g} µm"
            raise InputError(f"{name} of {NAME} {where} is no error of a machine", expected=expected, value=value)
    if not numbers:
        raise InputError(f"{NAME} {where} has no parameters", expected=f"some of {known[0]} … {known[-1]}")
    frame, turning = acting_frame(side, along, machine)
    return Empirical(where, along, waves, numbers, frame, turning)


def acting_frame(side: str, along: Along, machine: Machine) -> tuple[Frame, FrameRotation]:
    """Return the error frame in which a shift of one side acts, and the rotation to it from the axes along which the shift is given.

    With ``along`` base it is the error frame nearest the base, which does not turn; else the last one before the targets of that side.
    """
    target = machine.tool_frame if side == "tool" else machine.work_frame
    supports = machine.model.supports[machine.model.frames[target].parentJoint].tolist()
    frames = [frame for frame in machine.frames if machine.by_name[frame.axis].side == side]
    if not frames:
        raise InputError(f"no axis of {machine.name} moves the {side}", expected="an error frame on that side")
    order = [supports.index(frame.joint) for frame in frames]
    if along == "base":
        first = frames[int(np.argmin(order))]
        turns = [a.name for a in machine.axes if not a.linear and a.side == "both"]
        if turns:
            raise InputError(
                f"{', '.join(turns)} turns both sides of {machine.name}",
                expected="a machine whose base directions are fixed on both sides",
            )
        none = np.zeros((3, 3))
        return Frame(first.axis, first.role), FrameRotation(rest_orientation(machine, first.joint).T, None, none, none)
    last = frames[int(np.argmax(order))]
    axis = machine.by_name[last.axis]
    start, half, quarter = (_seen_from(machine, last, target, angle) for angle in (0.0, pi, pi / 2.0))
    constant = 0.5 * (start + half)
    if axis.linear:
        return Frame(last.axis, last.role), FrameRotation(start, None, np.zeros((3, 3)), np.zeros((3, 3)))
    return Frame(last.axis, last.role), FrameRotation(constant, axis.name, 0.5 * (start - half), quarter - constant)


def unused_place(side: str, columns: Sequence[Waves], taken: Sequence[str]) -> str:
    """Return the place of a new effect, with a number if the place is in use by one of the ``taken`` names."""
    where = f"{side} by {', '.join(column.column for column in columns)}"
    number, found = 1, where
    while f"{NAME}:{found}" in taken:
        number += 1
        found = f"{where} ({number})"
    return found


def entry_of_empirical(effect: Empirical) -> dict[str, Any]:
    """Return the entry of an empirical effect, as `empirical_named` reads it."""
    columns: list[dict[str, Any]] = []
    for column in effect.columns:
        entry: dict[str, Any] = {"column": column.column, "functions": column.kind}
        if column.kind != "direction":
            entry["order"] = column.order
        if column.range is not None:
            entry["range"] = [float(bound) for bound in column.range]
        columns.append(entry)
    return {
        "effect": NAME,
        "where": effect.where,
        "cause": "unknown",
        "note": NOTE,
        "along": effect.along,
        "columns": columns,
        "parameters": {name: float(value) for name, value in effect.coefficients.items()},
    }


def effect_entry(effect: Effect) -> dict[str, Any]:
    """Return the entry of any effect, as `effects_of` reads it."""
    if isinstance(effect, Empirical):
        return entry_of_empirical(effect)
    return effect.entry if isinstance(effect, ThermalResponse) else entry_of(effect)


def available_in_programs(column: str, machine: Machine) -> bool:
    """Return whether a column is available when a program is compensated: positions, directions of approach, temperatures; not time."""
    axes = [f"{axis.name}_{axis.unit}" for axis in machine.axes]
    return column in axes or column.removeprefix(APPROACH) in machine.names or is_temperature(column)


def _waves(where: str, given: ColumnEntry, machine: Machine) -> Waves:  # noqa: C901, PLR0912
    """Return one column after checking it."""
    name, what = given.column, f"{given.column} of {NAME} {where}"
    axis = machine.by_name.get(channel_name(name))
    if not available_in_programs(name, machine):
        columns = [f"{axis_entry.name}_{axis_entry.unit}" for axis_entry in machine.axes]
        columns += [f"{APPROACH}{axis_name}" for axis_name in machine.names]
        raise InputError(
            f"no such column for {NAME} {where}",
            expected=f"{', '.join(columns)} or T_<sensor>_degC",
            value=name,
            nearest=closest_name(name, columns),
        )
    allowed: tuple[Kind, ...] = ("half_waves",)
    if name.startswith(APPROACH):
        allowed = ("direction",)
    elif axis is not None and not axis.linear:
        allowed = ("half_waves", "whole_turns")
    if given.functions not in allowed:
        raise InputError(f"functions of {what}", expected=" or ".join(allowed), value=given.functions)
    if given.functions == "direction":
        if given.order is not None or given.range is not None:
            raise InputError(
                f"{what} is a direction", expected="neither order nor range", value=given.order or given.range
            )
        return Waves(name, "direction", 1)
    if given.order is None or not 1 <= given.order <= MAX_ORDER:
        raise InputError(f"order of {what}", expected=f"1 to {MAX_ORDER}", value=given.order)
    if given.functions == "whole_turns":
        if given.range is not None:
            raise InputError(f"{what} is periodic", expected="no range", value=list(given.range))
        return Waves(name, "whole_turns", given.order)
    if given.range is None or not given.range[0] < given.range[1]:
        value = None if given.range is None else list(given.range)
        raise InputError(f"range of {what}", expected="[low, high] with low < high", value=value)
    wrapped = axis is not None and axis.lower is None
    if wrapped and given.range[1] - given.range[0] >= 360.0:
        raise InputError(
            f"range of {what}", expected="less than one turn, or functions whole_turns", value=list(given.range)
        )
    return Waves(name, "half_waves", given.order, given.range, wrapped)


def _seen_from(machine: Machine, frame: ErrorFrame, target: int, angle: float) -> np.ndarray:
    """Return the orientation (3, 3) of a frame in an error frame, with that error frame's axis at ``angle`` and all others at zero."""
    q = np.zeros(len(machine.axes))
    if not machine.by_name[frame.axis].linear:
        q[machine.names.index(frame.axis)] = angle
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, machine.configuration(q))
    return np.asarray(data.oMi[frame.joint].rotation.T @ data.oMf[target].rotation)


READABLE: Final = 20
"""Largest number of parameters whose joint covariance is written as readable rows."""


class CurveEntry(FileEntry):
    """One error motion."""

    unit: str
    domain: tuple[float, float]
    basis: str
    knots: tuple[float, ...] = ()
    coefficients: Annotated[tuple[float, ...], Field(min_length=1)]
    covariance: tuple[tuple[float, ...], ...] | None = None
    illustrative: bool = False
    source: str = ""


class ColumnEntry(FileEntry):
    """One column of an empirical effect."""

    column: str
    functions: Kind
    order: int | None = None
    range: tuple[float, float] | None = None


class ResponseEntry(FileEntry):
    """One term of a thermal response."""

    columns: tuple[str, ...]
    time_constant: Annotated[float, Field(ge=0.0, le=LONGEST_S)]
    exponent: Annotated[float, Field(ge=0.0, le=LARGEST_EXPONENT)]
    coefficient: Annotated[float, Field(ge=-LARGEST_DRIFT_UM, le=LARGEST_DRIFT_UM)]


class EffectEntry(FileEntry):
    """One effect; four fields apply only to an empirical effect, the last three only to a thermal response."""

    effect: str
    where: str
    parameters: dict[str, float]
    cause: Literal["unknown"] | None = None
    note: str = ""
    along: Along | None = None
    columns: tuple[ColumnEntry, ...] = ()
    ranges: dict[str, tuple[float, float]] = Field(default_factory=dict)
    reference_degC: dict[str, float] = Field(default_factory=dict)
    terms: tuple[ResponseEntry, ...] = ()


class CovarianceEntry(FileEntry):
    """Joint covariance of all parameters: its lower triangle in rows, or compressed with its SHA-256 (`Covariance.to_compressed`)."""

    parameters: tuple[str, ...]
    lower: str | None = None
    compressed: str | None = None
    sha256: str = ""


class TableFileEntry(FileEntry):
    """One table of the control."""

    file: str
    format: str
    classes: tuple[BasicClass, ...]
    sha256: str


class ControlEntry(FileEntry):
    """Correction tables and kinematics active in the control."""

    errors_are: Literal["uncorrected", "remaining"]
    tables: tuple[TableFileEntry, ...] = ()
    kinematics: Annotated[tuple[TableFileEntry, ...], Field(max_length=1)] = ()
    live: tuple[TableFileEntry, ...] = ()
    tool_length_mm: Annotated[float, Field(ge=0.0, lt=1e4)] | None = None  # for which tables and kinematics were made

    @model_validator(mode="after")
    def _not_empty(self) -> ControlEntry:
        if not (self.tables or self.kinematics or self.live):
            raise ValueError("tables, kinematics or live are required")
        return self


Sentence = Annotated[str, PlainValidator(message_from)]


class UnidentifiedEntry(FileEntry):
    """An error that the readings did not determine."""

    name: str  # ISO 230-1 name
    why: Sentence  # the reason; text, or a format string `text` and the values of its places
    remedy: Sentence | Literal[""] = (
        ""  # what to enter or to measure, the same; empty if that is unknown or part of `why`
    )

    @property
    def text(self) -> str:
        """Reason and remedy."""
        return joined("; ", [self.why, self.remedy]) if self.remedy else self.why

    def to_file(self) -> dict[str, Any]:
        """Return the entry of the file, whose sentences can be read in another language."""
        remedy = {"remedy": message_data(self.remedy)} if self.remedy else {}
        return {"name": self.name, "why": message_data(self.why), **remedy}


class MisfitEntry(FileEntry):
    """Residuals of the identification, compared with the noise stated for the readings."""

    # ``consistent``; ``systematic`` (a repeatable part is left); ``larger`` than stated; ``untested`` (too few readings)
    verdict: Literal["consistent", "systematic", "larger", "untested"]
    says: str = ""
    rms_um: Annotated[float, Field(ge=0.0)] | None = None  # RMS of the residuals of a coordinate, µm
    reduced_chi2: Annotated[float, Field(ge=0.0)] | None = None  # chi² per degree of freedom
    dof: Annotated[float, Field(ge=0.0)] | None = None
    # probability of a chi² at least as large if the stated noise holds
    p_value: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    # p-value of the residuals compared with repeats
    lack_of_fit_p_value: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    # RMS of the residuals at positions that were not used, µm
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


class MeasuredWith(FileEntry):
    """Set-up of the measurement."""

    stations: Annotated[int, Field(ge=0)]
    # targets_on_tool, targets_on_work: number of reflectors, balls or spheres on either side
    targets_on_tool: Annotated[int, Field(ge=0)]
    targets_on_work: Annotated[int, Field(ge=0)]
    points: Annotated[int, Field(ge=0)]


class CalibrationFile(FileEntry):
    """A calibration file."""

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
    curves: dict[str, CurveEntry] = Field(default_factory=dict)
    squareness: dict[str, float] = Field(default_factory=dict)
    location: dict[str, float] = Field(default_factory=dict)
    covariance: CovarianceEntry | None = None
    effects: tuple[EffectEntry, ...] = ()
    control: ControlEntry | None = None


def effects_of(entries: Sequence[EffectEntry], machine: Machine, fail: Callable[..., InputError]) -> tuple[Effect, ...]:
    """Return the effects of a calibration file.

    ``fail`` makes the error from place in the file, what is wrong, what was expected, value and nearest valid name. An error is raised
    if the machine cannot have an effect, a payload or carried load acts on no compliant joint, a side has more than one payload, or
    there is more than one carried load.
    """
    masses = {one.name: one for one in (PAYLOAD, CARRIED_LOAD)}
    payloads: dict[int, Payload] = {}
    effects: list[Effect] = []
    # Payloads first, because they load every compliant joint.
    for index, entry in sorted(enumerate(entries), key=lambda item: (item[1].effect not in masses, item[0])):
        try:
            if entry.effect in masses:
                payloads[index] = payload_named(masses[entry.effect], entry.where, entry.parameters, machine)
            else:
                effects.append(_effect(entry, machine, list(payloads.values())))
        except InputError as error:
            raise fail(("effects", index), error.what, str(error.expected), error.value, error.nearest) from None
    last = max(payloads, default=0)
    if payloads and not any(
        isinstance(effect, GravityCompliance) or (isinstance(effect, TableLoad) and effect.payloads)
        for effect in effects
    ):
        expected = "a gravity_compliance of a joint that it loads, or a table_load with a moment"
        raise fail(("effects", last), f"a {entries[last].effect} that loads no joint", expected, "none in the file")
    constant = [payload.side for payload in payloads.values() if not payload.carried]
    if len(set(constant)) < len(constant):
        raise fail(("effects", last), "more than one payload on a side", "one", len(constant))
    if len(payloads) - len(constant) > 1:
        raise fail(("effects", last), f"more than one {CARRIED_LOAD.name}", "one", len(payloads) - len(constant))
    return numbered(effects)


def _effect(entry: EffectEntry, machine: Machine, payloads: Sequence[Payload]) -> Effect:
    if entry.effect != NAME and (entry.cause is not None or entry.along is not None or entry.columns):
        what = f"{entry.effect} has a known cause and form"
        raise InputError(what, expected=f"cause, along and columns only with {NAME}")
    if entry.effect == RESPONSE:
        terms = [ResponseTerm(**dict(term)) for term in entry.terms]
        if tuple(entry.parameters) != ("offset",):
            raise InputError(
                f"parameters of {RESPONSE} {entry.where}",
                expected="offset",
                value=", ".join(entry.parameters) or "none",
            )
        offset = entry.parameters["offset"]
        return thermal_response(machine, entry.where, offset, terms, entry.reference_degC, entry.ranges)
    if entry.ranges or entry.reference_degC or entry.terms:
        raise InputError(
            f"{entry.effect} has no terms", expected=f"ranges, reference_degC and terms only with {RESPONSE}"
        )
    if entry.effect != NAME:
        return effect_named(entry.effect, entry.where, entry.parameters, machine, payloads)
    if entry.cause is None or entry.along is None:
        raise InputError(
            f"{NAME} {entry.where} without cause or along", expected="cause: unknown, and along: base, tool or work"
        )
    return empirical_named(entry.where, entry.along, entry.columns, entry.parameters, machine)


def measurement_entries(
    instruments: Sequence[str],
    set_up: MeasuredWith | None,
    misfit: MisfitEntry | None,
    not_identifiable: Sequence[UnidentifiedEntry],
    not_estimated: Sequence[str],
) -> dict[str, Any]:
    """Return the entries on how a calibration was measured and what is not known; those without content are left out."""
    entries: dict[str, Any] = {
        "instruments": list(instruments),
        "set_up": None if set_up is None else set_up.model_dump(),
        "misfit": None if misfit is None else misfit.model_dump(exclude_none=True),
        "not_identifiable": [error.to_file() for error in not_identifiable],
        "not_estimated": list(not_estimated),
    }
    return {name: value for name, value in entries.items() if value}


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
    """Return the joint covariance of an entry; raise `ValueError` for neither or both forms, or numbers that are not a covariance."""
    if (entry.lower is None) == (entry.compressed is None):
        raise ValueError("needs one of lower and compressed")
    if entry.lower is not None:
        return Covariance.from_text(entry.parameters, entry.lower)
    return Covariance.from_compressed(entry.parameters, entry.compressed or "", entry.sha256)
