"""Measured data in programs for the cycles of Beckhoff TF5245 (TwinCAT 3 CNC Cycles, kinematic optimisation).

Public description (infosys.beckhoff.com, tf5245_tc3_cnc_cycles_kinopt): the pages "Direct input of measurement data" (contacts
``V.L.X[i]``, ``V.L.Y[i]``, ``V.L.Z[i]`` of the linear axes in mm, ``V.L.N`` of them, reduced by ``SysCalcSphere.ecy`` into
``V.L.RESULT_V``) and "Sphere centre points already calculated" (``SysCalibFitAddRecord.ecy`` with the centre in @P1 to @P3 and the
angles of A, B, C in @P4 to @P6; ``SysCalibFitInit.ecy`` with the number of poses in @P3).

A record whose centre is ``V.L.RESULT_V`` is reduced here from its contacts, with a covariance; the control's own fit is algebraic.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.machine.machine import Machine
from twin.measurement.contacts import linear_columns, numbered_rounds, probe_table
from twin.measurement.formats.base import (
    ContactRow,
    Conversion,
    FormatSpecification,
    Given,
    MeasuredFormat,
    file_lines,
    number_in,
    reduced,
    whole_number_in,
)
from twin.measurement.table import Measurements

ASSIGNMENT: Final = re.compile(r"(V\.\w+\.\w+(?:\[\d+\])?)\s*=\s*(V\.\w+\.\w+(?:\[\d+\])?|[-+.\deE]+)(?=\s|$)")
CALL: Final = re.compile(r"L\s+CYCLE\s*\[\s*NAME\s*=\s*\"?([\w.]+)\"?(.*)\]\s*$", re.I)
PARAMETER: Final = re.compile(r"@P(\d+)\s*=\s*([^@\s]+)")
FLOW: Final = re.compile(r"\$(IF|FOR|WHILE|DO|SWITCH|GOTO|REPEAT)\b", re.I)
RESULT: Final = "V.L.RESULT_V"
CONTACTS: Final = ("V.L.X", "V.L.Y", "V.L.Z")
ANGLES: Final = ("A", "B", "C")
MOST: Final = 100_000
"""Largest number of contacts of a sphere, and of records."""


@final
@dataclass(frozen=True)
class _Record:
    """One sphere centre: as a point, or as the contacts that it follows from."""

    line: int
    point: tuple[float, ...]
    angles: dict[str, float]
    contacts: tuple[tuple[float, float, float], ...] = ()


@final
class Tf5245(MeasuredFormat):
    """Program with calls of ``SysCalibFitAddRecord``."""

    specification = FormatSpecification(
        name="tf5245",
        title="Beckhoff TF5245: SysCalibFitAddRecord",
        suffixes=(".nc", ".ecy", ".txt", ".ngc"),
        gives="sphere centres",
        instrument="probe",
        needs="",
        source="Beckhoff Infosys, TF5245: Direct input of measurement data; Sphere centre points already calculated",
        unverified=("that the coordinates are axis positions with no offset and no tool length active",),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        return "SYSCALIBFITADDRECORD" in text.upper()

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        records = list(_records(path))
        if not records:
            raise InputError("no record", expected="calls of SysCalibFitAddRecord.ecy", file=path)
        rotary = [machine.axes[i].name for i in machine.rotary]
        for record in records:
            for name, angle in record.angles.items():
                if name not in rotary and angle != 0.0:
                    raise InputError(
                        f"the machine has no rotary axis {name}",
                        expected=f"an angle of zero; the rotary axes are {' '.join(rotary) or 'none'}",
                        file=path,
                        line=record.line,
                        value=f"{angle:g}",
                    )
        given.positions(machine, (*ANGLES, "X", "Y", "Z"))
        poses = np.array([[record.angles[name] for name in ANGLES] for record in records])
        rounds = numbered_rounds(np.full(len(records), "sphere", dtype=object), poses, 1)
        return _converted(records, rounds, path, machine, given)


def _converted(records: list[_Record], rounds: np.ndarray, path: Path, machine: Machine, given: Given) -> Conversion:
    """Return the table of all records, in their order."""
    rows, tables, notes = [], [], []
    centres = [k for k, record in enumerate(records) if not record.contacts]
    for record, name in zip(records, rounds, strict=True):
        angles = {axis: angle for axis, angle in record.angles.items() if axis in machine.names}
        rows += [
            ContactRow(record.line, dict(zip("XYZ", point, strict=True)) | angles, "sphere", round=str(name))
            for point in record.contacts
        ]
    conversion = reduced(rows, path, machine, given) if rows else None
    if conversion is not None:
        tables.append(conversion.measurements)
        notes += list(conversion.notes)
    if centres:
        positions = np.zeros((len(centres), len(machine.axes)))
        for i, k in enumerate(centres):
            values = dict(zip("XYZ", records[k].point, strict=True)) | records[k].angles
            positions[i] = [values.get(name, given.at.get(name, 0.0)) for name in machine.names]
        linear_columns(machine)
        tables.append(
            probe_table(
                machine,
                positions + given.offsets(machine),
                source=str(path),
                lines=np.array([records[k].line for k in centres]),
                target=np.full(len(centres), "sphere", dtype=object),
                round_name=rounds[centres],
                u_mm=np.full((len(centres), 3), np.nan),
            )
        )
        notes.append(f"{count_with_noun(len(centres), 'centre')} as the file states them, without uncertainty")
    joined = Measurements.join(tables)
    table = joined.select(np.argsort(joined.lines, kind="stable"))
    return Conversion(
        table, (*notes, "assumed: one sphere in all poses"), conversion.centres if conversion is not None else ()
    )


def _records(path: Path) -> Iterator[_Record]:
    """Yield the records of a program.

    Raises:
        InputError: control flow, a variable without a value, a parameter that is missing, a number of records that is not the stated
        one.
    """
    known: dict[str, float] = {}
    contacts: tuple[tuple[float, float, float], ...] = ()
    stated: int | None = None
    count, last = 0, 1
    for line, text in _statements(path):
        last = line
        if FLOW.search(text):
            raise InputError("control flow", expected="statements in a sequence", file=path, line=line, value=text)
        call = CALL.search(text)
        if call is None:
            if re.search(r"\bCYCLE\s*\[", text, re.I):
                raise InputError(
                    "a call without its end", expected='L CYCLE [NAME="…" …]', file=path, line=line, value=text
                )
            for name, value in ASSIGNMENT.findall(text):
                known[name] = _value(value, known, path, line)
            continue
        name = call[1].upper().removesuffix(".ECY")
        parameters = {int(number): value for number, value in PARAMETER.findall(call[2])}
        if name == "SYSCALIBFITINIT" and 3 in parameters:
            poses = _value(parameters[3], known, path, line)
            stated = whole_number_in(f"{poses:g}", "the number of poses", path, line, MOST)
        elif name == "SYSCALCSPHERE":
            contacts = _contacts(known, path, line)
        elif name == "SYSCALIBFITADDRECORD":
            count += 1
            yield _record(parameters, known, contacts, path, line)
    if stated is not None and stated != count:
        raise InputError(
            count_with_noun(count, "record"),
            expected=f"{stated}, the number of poses in SysCalibFitInit",
            file=path,
            line=last,
        )


def _record(
    parameters: dict[int, str],
    known: dict[str, float],
    contacts: tuple[tuple[float, float, float], ...],
    path: Path,
    line: int,
) -> _Record:
    missing = [f"@P{k}" for k in range(1, 7) if k not in parameters]
    if missing:
        raise InputError(f"{' '.join(missing)} missing", expected="@P1 to @P6", file=path, line=line)
    angles = {name: _value(parameters[4 + k], known, path, line) for k, name in enumerate(ANGLES)}
    if [parameters[k] for k in (1, 2, 3)] != [f"{RESULT}[{k}]" for k in range(3)]:
        return _Record(line, tuple(_value(parameters[k], known, path, line) for k in (1, 2, 3)), angles)
    if not contacts:
        raise InputError(
            f"{RESULT} has no value", expected="a call of SysCalcSphere.ecy before it", file=path, line=line
        )
    return _Record(line, (), angles, contacts)


def _contacts(known: dict[str, float], path: Path, line: int) -> tuple[tuple[float, float, float], ...]:
    n = whole_number_in(f"{_value('V.L.N', known, path, line):g}", "V.L.N", path, line, MOST)
    points = []
    for i in range(n):
        x, y, z = (_value(f"{name}[{i}]", known, path, line) for name in CONTACTS)
        points.append((x, y, z))
    return tuple(points)


def _value(text: str, known: dict[str, float], path: Path, line: int) -> float:
    if text in known:
        return known[text]
    if text.upper().startswith("V."):
        raise InputError(
            "a variable without a value", expected="a number assigned before", file=path, line=line, value=text
        )
    return number_in(text, "a parameter", path, line)


def _statements(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the statements, each with its first line; comments are removed and continued lines joined."""
    pending, first = "", 0
    for line, text in file_lines(path):
        plain = re.sub(r"\([^()]*\)", " ", text).split(";", 1)[0].strip()
        first = first if pending else line
        if plain.endswith("\\"):
            pending += plain[:-1] + " "
            continue
        if pending or plain:
            yield first, pending + plain
        pending = ""
    if pending:
        yield first, pending
