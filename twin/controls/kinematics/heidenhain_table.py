"""HEIDENHAIN iTNC 530: description table of the kinematics, from the tool reference point to the workpiece.

Checked against a public description: Technical Manual iTNC 530 HSCI, p. 722 (www.easymanua.ls/heidenhain/itnc-530-hsci/manual/716772
?p=722): columns NR, KEY, AXIS, COORD; ``MachAxis`` is the place from which on an axis acts, ``Trans`` a shift along (X Y Z) or a
rotation about (A B C) an axis of the current system, ``ToolAxis`` the tool axis; the sequence begins at the tool reference point.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.controls.format import TableLine, fixed_decimals, rotation_about_axis
from twin.controls.kinematics.format import (
    KinematicsFormat,
    TableGeometry,
    Values,
    code_lines,
    rotary_axes,
    rotation_vector,
    table_geometry,
    work_origin,
)
from twin.machine.machine import Machine

_DIGITS: Final = 6
_ANGLE_DIGITS: Final = 8
_ALIGNED: Final = {"A": "BC", "B": "AC", "C": "AB"}
"""Rotations that turn an axis of the system into the direction of a rotary axis of that name."""
_COLUMNS: Final = ("NR", "KEY", "AXIS", "COORD")
Row = tuple[str, str, str]
"""KEY, AXIS, and the name of the value in COORD; empty for none."""


@final
class HeidenhainTable(KinematicsFormat):
    """HEIDENHAIN iTNC 530: kinematics description table."""

    name = "heidenhain-kinematics"
    title = "HEIDENHAIN iTNC 530"
    what = "kinematics description table"
    carries = "positions and directions of both rotary axes; shift and tilt of the workpiece"
    leaves = "nothing of the rotary axes (squareness of linear axes: in the tables)"
    file = "kinematics.tab"
    unchecked = (
        "signs: Trans moves the system from tool to table, with the machine zero (spindle nose with all axes at zero) as origin; a "
        "positive command of a rotary axis moves the tool relative to the workpiece right-handed about the axis of the current system",
        "header and end line of the table, and the number of decimals that the control keeps in COORD (6 for mm, 8 for degrees here)",
        "TNC 640 and TNC7 store the kinematics as configuration objects (Technical Manual MANUALplus 620, 2012, p. 735 to 758, of the "
        "same family: CfgKinComposModel): no public description gives their fields for these controls, so they are not written; enter "
        "the differences of this table there by hand",
    )

    def nominal(self, machine: Machine) -> Values:
        """See `KinematicsFormat.nominal`."""
        nominal = table_geometry(machine)
        first, second = nominal.points
        vectors = (first, second - first, work_origin(machine) - second)
        values = {f"{n}{'XYZ'[i]}": float(v) for n, vector in enumerate(vectors, 1) for i, v in enumerate(vector)}
        for n, (axis, turned) in enumerate(zip(rotary_axes(machine), nominal.directions, strict=True), 1):
            if axis.name not in _ALIGNED:
                what = f"{axis.name} is not a rotary axis of HEIDENHAIN"
                raise InputError(what, expected="A, B or C", file=machine.path)
            letters = _ALIGNED[axis.name]
            values |= {f"{n}{k}": v for k, v in zip(letters, _angles(axis.name, -turned), strict=True)}
        return values | {f"3{letter}": 0.0 for letter in "ABC"}

    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.geometry`."""
        return _followed([(key, axis, _coord(values, name)) for key, axis, name in _rows(machine)], machine)

    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """See `KinematicsFormat.write`."""
        lines = [
            f"BEGIN {self.file} MM",
            *(f"; {note}" for note in notes),
            " ".join(f"{name:<9}" for name in _COLUMNS).rstrip(),
        ]
        for n, (key, axis, name) in enumerate(_rows(machine)):
            digits = _ANGLE_DIGITS if axis in "ABC" else _DIGITS
            text = fixed_decimals(_coord(values, name), digits) if name else ""
            lines.append(f"{n:<9} {key:<9} {axis:<9} {text}".rstrip())
        return "\n".join([*lines, "[END]"]) + "\n"

    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.read`."""
        rows = []
        for line in code_lines(path, ";"):
            words = line.text.split()
            if words[0] in ("BEGIN", "NR", "[END]"):
                continue
            if (
                len(words) < 3
                or not words[0].isdigit()
                or words[1] not in ("MachAxis", "Trans", "ToolAxis", "MachBase")
            ):
                what = "not a row of a kinematics description"
                raise line.error(what, "NR, MachAxis, Trans or ToolAxis, AXIS, COORD", line.text)
            if words[1] == "Trans" and (len(words) < 4 or words[2] not in "XYZABC"):
                raise line.error("a shift or rotation is incomplete", "NR Trans AXIS COORD", line.text)
            value = TableLine(path, line.number, words[3]).decimal("COORD") if words[1] == "Trans" else 0.0
            rows.append((words[1], words[2], value))
        return _followed(rows, machine, path)

    def label(self, name: str, machine: Machine) -> str:
        """See `KinematicsFormat.label`: a row of the description by its transformation and the axis that follows it."""
        before = (*(axis.name for axis in rotary_axes(machine)), "MachBase")[int(name[0]) - 1]
        return f"Trans {name[1]} → {before}" if before != "MachBase" else f"Trans {name[1]} (last)"

    def loading(self, machine: Machine) -> tuple[str, ...]:
        """See `KinematicsFormat.loading`."""
        return (
            "Save the present kinematics. Change the Trans rows of the existing description by the differences between this file and "
            "that of a calibration without errors; keep its collision objects and the rows of the spindle head.",
            "Select the changed description in the assignment table, then measure a sphere at several positions of the rotary axes "
            "(KinematicsOpt, cycle 451, mode check).",
            "The description acts only with M128 or FUNCTION TCPM, and with PLANE.",
            "The last Trans rows contain shift and tilt of the workpiece preset: keep the preset.",
        )


def _coord(values: Values, name: str) -> float:
    """Return the value of a row; a name with a minus sign is the negative."""
    return -values[name[1:]] if name.startswith("-") else values[name] if name else 0.0


def _rows(machine: Machine) -> list[Row]:
    """Return the rows of a machine."""
    rows: list[Row] = [("ToolAxis", "Z", "")]
    rows += [
        ("MachAxis", machine.axes[i].name, "") for i in sorted(machine.linear, key=lambda i: -machine.axis_joints[i])
    ]
    for n, axis in enumerate(rotary_axes(machine), 1):
        letters = _ALIGNED[axis.name]
        rows += [("Trans", letter, f"{n}{letter}") for letter in "XYZ" + letters]
        rows.append(("MachAxis", axis.name, ""))
        rows += [("Trans", letter, f"-{n}{letter}") for letter in reversed(letters)]
    return rows + [("Trans", letter, f"3{letter}") for letter in "XYZABC"]


def _angles(name: str, line: np.ndarray) -> tuple[float, float]:
    """Return the angles in degrees of the two rotations that turn the axis of that name into a direction."""
    x, y, z = (float(value) for value in line)
    if name == "A":
        turns = np.arctan2(-z, x), np.arcsin(y)
    elif name == "B":
        turns = np.arctan2(z, y), -np.arcsin(x)
    else:
        turns = np.arctan2(-y, z), np.arcsin(x)
    return float(np.degrees(turns[0])), float(np.degrees(turns[1]))


def _followed(rows: Sequence[tuple[str, str, float]], machine: Machine, path: Path | None = None) -> TableGeometry:
    """Return the geometry by following KEY, AXIS and COORD of all rows, with both rotary axes of the table in their order."""
    turned, place = np.eye(3), np.zeros(3)
    names, points, directions = list[str](), list[np.ndarray](), list[np.ndarray]()
    for key, axis, value in rows:
        if key == "Trans" and axis in "XYZ":
            place = place + turned[:, "XYZ".index(axis)] * value
        elif key == "Trans":
            turned = turned @ rotation_about_axis("ABC".index(axis), np.radians(value))
        elif key == "MachAxis" and axis in "ABC":
            names.append(axis)
            points.append(place)
            directions.append(-turned[:, "ABC".index(axis)])
    expected = [axis.name for axis in rotary_axes(machine)]
    if names != expected:
        what = "other rotary axes than those of the table"
        raise InputError(what, expected=" ".join(expected), file=path, value=" ".join(names))
    shift = place - work_origin(machine)
    return TableGeometry(np.array(points), np.array(directions), shift, rotation_vector(turned))
