"""Kinematics of the control, with or without tables: make them, write the folder, and account for what remains after every stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.files import write_atomic
from twin._common.provenance import (
    ILLUSTRATIVE,
    SourceWarning,
    merge_warnings,
    warning_texts,
    warnings_to_json,
)
from twin._common.records import json_form
from twin.compensation.tables.account import CALIBRATION, README, SCHEMA, Account, outputs_of, write_folder, written_by
from twin.compensation.tables.axis_tables import ConstantKinematics, make_kinematics, real_geometry
from twin.compensation.tables.design import Request, RequiredCorrections
from twin.compensation.tables.make import ControlTables, Stages, check_no_module, make, stages_of
from twin.controls import ControlSection, TableEntry, format_named
from twin.controls.kinematics import kinematics_named
from twin.controls.kinematics.format import TableGeometry, linear_shift
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.unknown_errors import check_locations_identified, nominal_locations
from twin.tool.uncertainty import volume

CLASSES: Final = ("R-POR",)
ACTIVE: Final = (
    "The kinematics act only while the transformation is active (tool centre point mode); a program in axis coordinates is corrected "
    "for these errors by twin alone. Compensate with tool centre point mode on from the start to the end of the program, and with the "
    "calibration.yaml in this folder."
)


@final
@dataclass(frozen=True)
class KinematicsRequest:
    """Kinematics to be written, and the tables beside them."""

    kind: str  # name of a format of `twin.controls.kinematics`
    tables: Request | None = None  # format and settings of the tables; None for kinematics alone
    tool_length_mm: float | None = None  # tool length of the functional point; None: that of the machine file
    conditions: Conditions = field(default_factory=Conditions)  # temperatures and time
    unidentified: bool = False  # whether kinematics are written although locations of rotary axes were not identified
    notes: tuple[str, ...] = ()  # lines for the comments of the file


@final
@dataclass(frozen=True)
class KinematicsAccount:
    """Kinematics of the control and what remains after every stage."""

    kinematics: ConstantKinematics  # the kinematics, as written and as read back
    stages: Stages  # error at the tool after every stage
    errors: Calibration  # the calibration they were made from
    tool_length_mm: float  # tool length of the functional point
    tables: Account | None  # account of the tables; None without tables

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Warnings about the source of the numbers."""
        return merge_warnings(self.errors.warnings, nominal_locations(self.errors))

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        return (*self.kinematics.unmet, *(() if self.tables is None else self.tables.unmet))

    def to_text(self) -> str:
        """Return the text that is printed and written into the folder."""
        made, form = self.kinematics, self.kinematics.form
        lines = [f"Kinematics of the control for {made.machine.name}: {form.name} ({form.title}, {form.what})"]
        lines += [
            *warning_texts(self.warnings),
            f"calibration: {self.errors.path or 'no file: the nominal machine'}",
        ]
        lines += [
            f"tool length {self.tool_length_mm:g} mm; file: {form.file}",
            "",
            f"  holds: {form.carries}",
            f"  does not hold: {form.leaves}",
            f"  the location errors of the calibration displace the tool centre point by {made.displaced_rms_um:.2f} µm RMS, "
            f"{made.displaced_max_um:.2f} µm at most; {made.left_rms_um:.3f} µm RMS, {made.left_max_um:.3f} µm at most, remain with "
            "this file",
            f"  read back: rounding in the file displaces the point by {made.round_trip_um:.4f} µm at most",
            "",
            *self.stages.to_lines(),
            "",
            "How to enter the kinematics",
            *(f"  {i}. {text}" for i, text in enumerate(form.loading(made.machine), start=1)),
        ]
        if form.unchecked:
            lines += [
                "",
                "NOT CHECKED against public documentation of the control:",
                *(f"  - {one}" for one in form.unchecked),
            ]
        lines += [
            "",
            "Before cutting, check the signs with a sphere on the table: keep the probe or a gauge at its centre with the "
            "transformation active and move one rotary axis after the other, first with the old values, then with the new ones. The "
            "deviation must become smaller.",
            ACTIVE,
        ]
        if made.unmet:
            lines += ["", "Not met:", *(f"  - {one}" for one in made.unmet)]
        text = "\n".join(lines) + "\n"
        return text if self.tables is None else f"{text}\n{'-' * 100}\n\n{self.tables.to_text()}"

    def to_dict(self) -> dict[str, Any]:
        """Return the account as JSON (``schema: twin.compensation.tables/1``)."""
        made, form = self.kinematics, self.kinematics.form
        entry: dict[str, Any] = {
            "schema": SCHEMA,
            "machine": made.machine.name,
            "calibration": str(self.errors.path or "no file: the nominal machine"),
            "illustrative": ILLUSTRATIVE in self.errors.warnings,
            "warnings": warnings_to_json(self.warnings),
            "tool_length_mm": self.tool_length_mm,
        }
        entry |= {} if self.tables is None else self.tables.to_dict()
        figures = ("displaced_rms_um", "displaced_max_um", "left_rms_um", "left_max_um", "round_trip_um")
        kinematics = {
            "format": form.name,
            "file": form.file,
            "holds": form.carries,
            "does_not_hold": form.leaves,
            **{name: getattr(made, name) for name in figures},
            "geometry": json_form(made.geometry),
            "error_at_tool": self.stages.to_dict(),
            "unchecked": list(form.unchecked),
            "load": list(form.loading(made.machine)),
        }
        return entry | {"kinematics": kinematics, "unmet": list(self.unmet)}


@final
@dataclass(frozen=True)
class ReadKinematics:
    """Kinematics of a control compared with the location errors of a calibration."""

    kind: str  # name of the format
    file: Path  # the file that was read
    geometry: TableGeometry
    calibration: Calibration
    differs_rms_um: float  # differs_rms_um, differs_max_um: difference at the functional point over the volume
    differs_max_um: float

    def to_text(self) -> str:
        """Return the text that is printed."""
        rows = [f"{self.kind}: {self.file.name}", *warning_texts(self.calibration.warnings)]
        for name, point, line in zip(("first", "second"), self.geometry.points, self.geometry.directions, strict=True):
            place, direction = (" ".join(f"{value:.6f}" for value in vector) for vector in (point, line))
            rows.append(f"  {name} rotary axis: through {place} mm, the table turns about {direction}")
        rows.append(f"  shift of the workpiece: {' '.join(f'{value:.6f}' for value in self.geometry.shift)} mm")
        rows.append(f"  tilt of the workpiece: {' '.join(f'{value * 1e6:.3f}' for value in self.geometry.turn)} µrad")
        rows.append(
            f"Compared with {self.calibration.path or 'the nominal machine'}: the tool centre point differs by "
            f"{self.differs_rms_um:.3f} µm RMS, {self.differs_max_um:.3f} µm at most over the volume"
        )
        return "\n".join(rows) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as JSON (``schema: twin.compensation.tables-read/1``)."""
        return {
            "schema": "twin.compensation.tables-read/1",
            "format": self.kind,
            "files": [str(self.file)],
            "calibration": str(self.calibration.path or "the nominal machine"),
            "illustrative": ILLUSTRATIVE in self.calibration.warnings,
            "warnings": warnings_to_json(self.calibration.warnings),
            "geometry": json_form(self.geometry),
            "differs_rms_um": self.differs_rms_um,
            "differs_max_um": self.differs_max_um,
        }


def compare_kinematics(calibration: Calibration, kind: str, file: Path, tool_length_mm: float | None) -> ReadKinematics:
    """Read the kinematics of a control and compare them with the location errors of a calibration (in the datum mean lines)."""
    errors, machine = calibration.in_datum("mean lines"), calibration.machine
    geometry = kinematics_named(kind).read(file, machine)
    length = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
    q = volume(machine)
    one, two = (linear_shift(machine, held, q, length) for held in (geometry, real_geometry(errors)))
    off = np.linalg.norm(one - two, axis=1)
    return ReadKinematics(kind, file, geometry, calibration, float(np.sqrt(np.mean(off**2))), float(off.max()))


def kinematics_outputs(folder: Path, request: KinematicsRequest, made: ConstantKinematics) -> list[Path]:
    """Return every file that may be written into a folder."""
    tables = [] if request.tables is None else outputs_of(folder, request.tables.kind, made.machine)
    return list(dict.fromkeys([*tables, *(folder / name for name in (made.form.file, README, CALIBRATION))]))


def make_both(
    errors: Calibration, known: Calibration, request: KinematicsRequest
) -> tuple[ConstantKinematics, ControlTables | None]:
    """Return the kinematics, and the tables beside them if requested; ``known``: ``errors`` without effects whose channel is not given.

    `InputError` also for tables that correct the location errors themselves, or locations not identified, unless the request accepts
    them.
    """
    errors.check_settled()
    check_no_module(errors)
    if not request.unidentified:
        check_locations_identified(errors)
    if request.tables is not None and format_named(request.tables.kind).knows_machine:
        raise InputError(
            "these tables correct the location of the rotary axes themselves: with kinematics in addition it would be corrected twice",
            expected="kinematics alone, or tables of linuxcnc, heidenhain, siemens or grid",
            setting="kinematics",
            value=request.tables.kind,
        )
    kinematics = make_kinematics(
        known,
        request.kind,
        request.tool_length_mm,
        (*request.notes, *warning_texts(merge_warnings(errors.warnings, nominal_locations(errors)))),
    )
    return kinematics, None if request.tables is None else make(errors.machine, known, request.tables)


def write_kinematics(
    made: tuple[ConstantKinematics, ControlTables | None],
    errors: Calibration,
    known: Calibration,
    missing: Mapping[str, tuple[str, ...]],
    request: KinematicsRequest,
    folder: Path,
) -> KinematicsAccount:
    """Write the folder, `calibration.yaml` last; ``missing``: effects that ``known`` leaves out; errors of `write_folder`."""
    kinematics, tables = made
    for path in kinematics_outputs(folder, request, kinematics):
        if errors.path is not None and path.resolve() == errors.path.resolve():
            raise InputError("an output is one of the inputs", expected="another folder", file=path)
    length = errors.machine.tool_length_mm if request.tool_length_mm is None else request.tool_length_mm
    required = RequiredCorrections(errors.machine, known, {}, length, frozenset(BASIC), request.conditions)
    old = () if errors.control is None else errors.control.tables
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / kinematics.form.file
    write_atomic(path, kinematics.text)
    entry = (TableEntry.of(path, kinematics.form.name, CLASSES),)
    account = None if tables is None else write_folder(tables, errors, known, missing, folder, alone=False)
    if tables is not None:
        written = Calibration.load(folder / CALIBRATION, errors.machine).control
        old = () if written is None else written.tables
    same = tables is None and errors.control is not None
    section = ControlSection(
        errors.control.errors_are if same and errors.control else "uncorrected", old, entry, (), length
    )
    found = KinematicsAccount(kinematics, stages_of(required, known, section), errors, length, account)
    write_atomic(folder / README, found.to_text())
    what = f"the control has the kinematics {kinematics.form.name}"
    if tables is not None:
        what = f"{what} and compensation tables ({tables.request.kind})"
    replace(errors, source=f"{errors.source}; {what}").with_control(section).save(folder / CALIBRATION)
    return found


def kinematics_written(made: tuple[ConstantKinematics, ControlTables | None]) -> tuple[str, ...]:
    """Return the names of the files written into the folder."""
    kinematics, tables = made
    own = (README, CALIBRATION) if tables is None else written_by(tables)
    return (kinematics.form.file, *own)
