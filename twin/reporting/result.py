"""Compute every number of a machine report, and its JSON."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.messages import Message, Quoted
from twin._common.provenance import SIMULATED, SourceWarning, merge_warnings, warnings_to_json
from twin._common.records import json_form
from twin._common.resources import Progress, silent
from twin.compensation.tables.axis_tables import ConstantKinematics, make_kinematics
from twin.compute.parallel import versions
from twin.controls import ControlSection, file_sha256
from twin.display import figure
from twin.display.numbers import COVERAGE_FACTOR
from twin.display.results import Result
from twin.machine.machine import Axis, Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.calibration_file import UnidentifiedEntry
from twin.model.conditions import Conditions
from twin.model.datum import EXPLANATION, MEAN_LINES, Datum
from twin.model.display import uncertainty_of
from twin.model.effects import split_name, unit_of
from twin.reporting.advice import MachineAdvice, advise
from twin.reporting.compensation import CompensationForecast, TablesLeft, forecast_compensation, tables_left
from twin.reporting.contributions import Budget, Field, Motion, budget, field, motions
from twin.reporting.identified import Identified, PointComparison
from twin.reporting.names import named
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import BUDGET_SEED, DEFINITION, without_missing_channels

MORE: Final = ("matplotlib", "meshcat")
MISSING: Final = Message("not installed")
DATUM_NAMES: Final[Mapping[Datum, Message]] = {
    "mean lines": Message("mean lines"),
    "end points": Message("end points"),
    "as given": Message("as given"),
}


@final
@dataclass(frozen=True)
class Source:
    """One source file."""

    role: str  # kind of file, in words
    path: str
    sha256: str  # SHA-256 digest of its bytes, in hexadecimal


@final
@dataclass(frozen=True)
class Sources:
    """Files, programs and seeds from which a report was made."""

    files: tuple[Source, ...]
    programs: Mapping[str, str]  # version by name
    seeds: Mapping[str, int]  # by their use
    made: datetime

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, leave_out=("made",)) | {"made": self.made.isoformat(timespec="seconds")}


def sources(
    calibration: Calibration, identified: Path | None, measured: Sequence[Path], seed: int, made: datetime
) -> Sources:
    """Return the sources of a report; ``identified``: JSON file of the identification; ``measured``: tables; ``seed`` of the draws."""
    machine = calibration.machine
    files = [(Message("machine file"), machine.path), ("URDF", machine.urdf)]
    if calibration.path is not None:
        files.append((Message("calibration"), calibration.path))
    if identified is not None:
        files.append((Message("identification"), identified))
    files += [(Message("measured"), path) for path in measured]
    # The control's tables as listed in the calibration: they are not read, so the files may be absent.
    tables = () if calibration.control is None else calibration.control.entries
    return Sources(
        files=(
            *(Source(role, str(path), file_sha256(path)) for role, path in files),
            *(
                Source(Message("table in the control ({format})", format=table.format), str(table.file), table.sha256)
                for table in tables
            ),
        ),
        programs=MappingProxyType(
            versions() | {"python": platform.python_version()} | {name: _version(name) for name in MORE}
        ),
        seeds=MappingProxyType(
            {Message("poses and directions of approach"): BUDGET_SEED, Message("uncertainty of the calibration"): seed}
        ),
        made=made,
    )


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return MISSING


SCHEMA: Final = "twin.reporting/1"
SEED: Final = 0


@final
@dataclass(frozen=True)
class Constant:
    """A squareness error, or a location error of a rotary axis."""

    name: str  # ISO 230-1
    words: str  # name in words
    unit: str  # ``um`` or ``urad``
    value: float
    half: float  # half width of its 95 % interval; NaN if unknown
    axis: str
    to: str  # for squareness, the reference axis or base direction; else empty
    leans: float  # direction in which a positive squareness tilts the axis: towards ``to`` (1) or away from it (−1); 0 for a location
    travel_mm: float | None  # travel of the tilted linear axis; None for a location
    rms_um: float  # RMS error at the tool from this error alone, over the volume

    @property
    def known(self) -> bool:
        """Whether its uncertainty is known."""
        return bool(np.isfinite(self.half))

    @property
    def over_travel_um(self) -> float | None:
        """Displacement of the end of travel by a squareness, µm; None for a location."""
        return None if self.travel_mm is None else self.value * self.travel_mm * 1e-3

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        entry = json_form(self, rename={"half": "half_95"}, leave_out=("axis", "to", "leans", "travel_mm", "rms_um"))
        return entry | {"over_travel_um": self.over_travel_um, "rms_um": self.rms_um}


@final
@dataclass(frozen=True)
class Gaps:
    """Errors that the report does not cover."""

    absent: tuple[str, ...]  # error motions, squareness and locations that are not in the calibration and count as zero
    not_identified: tuple[UnidentifiedEntry, ...]  # which the readings could not determine
    without_uncertainty: tuple[str, ...]  # errors with a value but no uncertainty
    left_out: Mapping[str, tuple[str, ...]]  # effects omitted because no value was given for their channel, by channel
    unused: tuple[str, ...]  # channels that were given but that no effect needs

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        entry = json_form(self, rename={"absent": "absent_counted_as_zero"}, leave_out=("not_identified",))
        return entry | {"not_identified": [error.model_dump() for error in self.not_identified]}


@final
@dataclass(frozen=True, repr=False)
class MachineReport(Result):
    """Content of the report of a machine."""

    machine: Machine
    calibration: Calibration  # in the datum of mean lines, if it can be converted
    datum: str  # sentence that names the datum of the numbers
    kinematics: Kinematics  # with the errors that can be evaluated under the conditions
    budget: Budget
    motions: tuple[Motion, ...]
    constants: tuple[Constant, ...]
    field: Field
    compensation: CompensationForecast
    identified: Identified | None
    comparisons: tuple[PointComparison, ...]  # one a table
    gaps: Gaps
    tables: tuple[TablesLeft, ...]  # remaining errors with tables in the control, by format
    kinematics_of_control: (
        ConstantKinematics | None
    )  # what the control holds and should hold; None if its format was not given
    advice: MachineAdvice
    sources: Sources

    @property
    def brief(self) -> str:
        """Error at the tool before compensation."""
        before = self.compensation.start
        error = "no errors known"
        if before is not None:
            error = f"error at the tool {figure(before.rms_um, 'µm')} RMS, {figure(before.max_um, 'µm')} largest"
        return f"report of {self.machine.name}: {error}"

    @property
    def control(self) -> ControlSection | None:
        """Tables in the machine's control, as listed in the calibration."""
        return self.calibration.control

    @property
    def illustrative(self) -> tuple[str, ...]:
        """Names of error motions that are assumed, not measured."""
        return tuple(curve.name for curve in self.calibration.curves.values() if curve.illustrative)

    @property
    def simulated(self) -> bool:
        """Whether the calibration or a table compared with it is based on simulated readings."""
        identified = () if self.identified is None else self.identified.file.notices
        notices = (*identified, *(text for comparison in self.comparisons for text in comparison.notices))
        return self.calibration.simulated or any("simulated" in notice for notice in notices)

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Warnings about the source of the numbers: of the calibration and of the readings compared with it."""
        return merge_warnings(self.calibration.warnings, (SIMULATED,) if self.simulated else ())

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requested content that could not be shown, in words."""
        reasons = [
            Message("{names} omitted: needs {channel}", names=", ".join(names), channel=channel)
            for channel, names in self.gaps.left_out.items()
        ]
        if self.identified is not None and self.identified.others:
            file, names = self.identified.path.name, ", ".join(self.identified.others)
            reasons.append(Message("{file} and the calibration differ in {names}", file=file, names=names))
        return (
            *reasons,
            *(
                Message("{file}: rows excluded: {count}", file=Path(comparison.source).name, count=len(comparison.rows))
                for comparison in self.comparisons
                if comparison.rows
            ),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON (``schema: twin.reporting/1``); null for unknown numbers."""
        control, calibration = self.control, self.calibration
        return json_form(
            {
                "schema": SCHEMA,
                "machine": self.machine.name,
                "calibration": {
                    "path": None if calibration.path is None else str(calibration.path),
                    "source": calibration.source,
                    "datum": calibration.datum,
                    "illustrative": self.illustrative,
                    "simulated_readings": self.simulated,
                    "instruments": calibration.instruments,
                    "set_up": None if calibration.set_up is None else calibration.set_up.model_dump(),
                    "misfit": None if calibration.misfit is None else calibration.misfit.model_dump(),
                    "warnings": warnings_to_json(self.warnings),
                },
                "tool_length_mm": self.kinematics.tool_length_mm,
                "conditions": self.kinematics.conditions.channels,
                "control": control
                and {
                    "errors_are": control.errors_are,
                    "tables": [{"file": str(table.file), "classes": table.classes} for table in control.tables],
                    "live": [str(entry.file) for entry in control.live],
                },
                "definition_of_U": DEFINITION,
                "summary": self.advice,
                "budget": {
                    "poses": len(self.budget.positions),
                    "total": self.budget.total,
                    "worst_at": self.budget.worst,
                    "errors": self.budget.errors,
                    "classes": self.budget.classes,
                },
                "motions": self.motions,
                "constants": self.constants,
                "field": self.field,
                "compensation": self.compensation,
                "control_tables": self.tables,
                "control_kinematics": None if self.kinematics_of_control is None else _held(self.kinematics_of_control),
                "identification": self.identified,
                "measured": self.comparisons,
                "gaps": self.gaps,
                "unmet": self.unmet,
                "sources": self.sources,
            }
        )


def machine_report(  # noqa: PLR0913
    machine: Machine,
    calibration: Calibration,
    *,
    made: datetime,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
    identified: Path | None = None,
    measured: Sequence[tuple[Path, Measurements]] = (),
    kinematics: str | None = None,
    present: Path | None = None,
    seed: int = SEED,
    progress: Progress = silent,
) -> MachineReport:
    """Compute the report of a machine.

    Args:
        calibration: its errors.
        made: date and time of the report.
        tool_length_mm: None for the machine file's own.
        conditions: temperatures and time; effects whose channel is not given are omitted and listed.
        identified: JSON file that ``twin identify`` wrote with the calibration.
        measured: measurement tables of the same machine with their files, to be compared with the calibration.
        kinematics: format of the control's kinematics (`twin.controls.kinematics`), to be compared with the calibration.
        present: file of the control with its present kinematics; None for the machine file's geometry.
        seed: random seed of the draws from the covariance.
        progress: progress callback: called with stage and completed fraction.

    Raises:
        InputError: a temperature that no effect knows; invalid files; no pose inside the domains of all curves.

    Examples:
        >>> from datetime import datetime
        >>> machine = twin.Machine.load("dmu50")
        >>> calibration = twin.Calibration.default(machine)
        >>> found = twin.report(machine, calibration, made=datetime(2026, 3, 1), tool_length_mm=120)
        >>> [contribution.name for contribution in found.budget.errors[:3]]  # the largest
        ['E_AZ', 'E_AX', 'E_Y0B']
    """
    at = Conditions() if conditions is None else conditions
    at.check(calibration)
    identification = None if identified is None else Identified.load(identified, calibration)
    calibration, datum = _in_mean_lines(calibration)
    origin = sources(calibration, identified, [path for path, _ in measured], seed, made)
    known, left_out = without_missing_channels(at, calibration)
    real = Kinematics(machine, known, tool_length_mm=tool_length_mm, conditions=at)
    progress("budget", 0.05)
    error_budget = budget(real)
    progress("curves", 0.3)
    error_motions = motions(real)
    progress("field", 0.35)
    error_field = field(real)
    progress("compensation", 0.4)
    outcome = forecast_compensation(error_budget, seed)
    comparisons = tuple(_comparisons(measured, known, progress))
    gaps = Gaps(
        _absent(known), known.not_identifiable, error_budget.without_uncertainty, left_out, at.unused(calibration)
    )
    progress("control's tables", 0.9)
    tables = tables_left(real, calibration, left_out)
    held = None if kinematics is None else make_kinematics(known, kinematics, real.tool_length_mm, present=present)
    progress("words", 0.95)
    return MachineReport(
        machine=machine,
        calibration=calibration,
        datum=datum,
        kinematics=real,
        budget=error_budget,
        motions=error_motions,
        constants=_constants(real, error_budget),
        field=error_field,
        compensation=outcome,
        identified=identification,
        comparisons=comparisons,
        gaps=gaps,
        tables=tables,
        kinematics_of_control=held,
        advice=advise(calibration, error_budget, outcome, identification, left_out, comparisons, tables),
        sources=origin,
    )


def _held(found: ConstantKinematics) -> dict[str, Any]:
    """Return the control's kinematics for JSON."""
    rows = [
        {"name": found.form.label(name, found.machine), "now": found.present[name], "should": value, "u": found.u[name]}
        for name, value in found.values.items()
    ]
    return {"format": found.form.name, "values": json_form(rows)}


def _comparisons(
    measured: Sequence[tuple[Path, Measurements]], known: Calibration, progress: Progress
) -> Iterator[PointComparison]:
    if not measured:
        return
    from twin.reporting.compensation import compare_points  # imports the diagnosis: slow, and needed only here

    for i, (path, data) in enumerate(measured):
        progress("measured", 0.5 + 0.35 * i / len(measured))
        yield compare_points(data, known.machine, known, path)


def _in_mean_lines(calibration: Calibration) -> tuple[Calibration, str]:
    """Return the calibration converted to the datum of mean lines, if possible, and a sentence on the datum.

    Errors absent from the calibration stay absent, because their uncertainty is unknown.
    """
    given = calibration.datum
    named = {*calibration.curves, *calibration.squareness, *calibration.location}
    try:
        found = calibration.in_datum(MEAN_LINES, named)
    except InputError as error:
        return calibration, Message("{datum}; not converted: {why}", datum=EXPLANATION[given], why=Quoted(error.what))
    if found is calibration:
        return calibration, EXPLANATION[given]
    datum = Message("{datum}; converted from: {given}", datum=EXPLANATION[MEAN_LINES], given=DATUM_NAMES[given])
    return replace(found, path=calibration.path), datum


def _constants(real: Kinematics, error_budget: Budget) -> tuple[Constant, ...]:
    calibration, machine = real.calibration, real.machine
    made = {error.name: error.rms_um for error in error_budget.errors}
    constants = []
    for name, value in (*calibration.squareness.items(), *calibration.location.items()):
        half = COVERAGE_FACTOR * uncertainty_of(name, calibration.covariance)
        component, _, letter = split_name(name)
        axis = machine.by_name[letter]
        to, leans, travel = "", 0.0, None
        if name in calibration.squareness:
            to, leans = _square_to(machine, axis, component - 3)
            travel = axis.domain[1] - axis.domain[0]
        constants.append(
            Constant(name, named(name, machine), unit_of(name), value, half, letter, to, leans, travel, made[name])
        )
    return tuple(constants)


def _square_to(machine: Machine, axis: Axis, about: int) -> tuple[str, float]:
    """Return the reference axis of a squareness about x, y or z, and whether the axis tilts towards (1) or away from it (−1)."""
    towards = np.cross(np.eye(3)[about], axis.machine_direction)
    others = [one for one in machine.axes if one.linear and one.name != axis.name]
    best = max(others, key=lambda one: abs(float(towards @ one.machine_direction)), default=None)
    if best is None or abs(float(towards @ best.machine_direction)) < 0.5:
        along = int(np.argmax(np.abs(towards)))
        return "xyz"[along], float(np.sign(towards[along]))
    return best.name, float(np.sign(towards @ best.machine_direction))


def _absent(calibration: Calibration) -> tuple[str, ...]:
    machine = calibration.machine
    named_ = {effect.name for effect in calibration.effects} | {error.name for error in calibration.not_identifiable}
    every = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    return tuple(name for name in every if name not in named_)
