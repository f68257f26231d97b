"""SINUMERIK 840D sl: machine data ``$MC_TRAFO5_…`` of the generic five-axis transformation (type 40: both rotary axes in the table).

Checked against public descriptions: Commissioning Manual SINUMERIK Operate (IM9), 12/2017, 6FC5397-1DP40-6BA1, p. 572
(www.easymanua.ls/siemens/sinumerik-804d-sl/manual/1265459?p=586): type 40 is the swivel table; the vectors of a tool carrier are I2 =
``BASE_TOOL``, I3 = ``JOINT_OFFSET``, I4 = ``PART_OFFSET`` with I4 = −(I2 + I3), V1 = ``AXIS1``, V2 = ``AXIS2``; for axes that move
the workpiece the direction is reversed, so that the vectors are those of the tool's motion relative to the workpiece.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin.controls.format import TableLine, fixed_decimals, table_lines
from twin.controls.kinematics.format import (
    SHORTEST,
    KinematicsFormat,
    TableGeometry,
    Values,
    assign,
    numbers_of,
    table_geometry,
)
from twin.machine.machine import Machine

_DIGITS: Final = 6
_DIRECTION_DIGITS: Final = 12
_ANGLE_DIGITS: Final = 10
_TYPE: Final = "40"
_LINE: Final = re.compile(
    r"^(?:N\d+\s+)?(?:\$MC_TRAFO5_(?P<name>\w+?)_1\[(?P<index>[0-2])\]|(?P<type>\$MC_TRAFO_TYPE_1)|"
    r";\s*(?P<tilt>WORK_ZERO_ROTATION)\[(?P<part>[0-2])\])\s*=\s*(?P<value>[^\s;]+)",
    re.IGNORECASE,
)
TILT: Final = "WORK_ZERO_ROTATION"
"""Rotation vector of the workpiece about the centre of the table, degrees; a comment in the file."""
_NUMBERS: Final = dict(BASE_TOOL=24550, JOINT_OFFSET=24560, PART_OFFSET=24500, AXIS1=24570, AXIS2=24572)
"""Machine data of the first transformation."""
VECTORS: Final = ("BASE_TOOL", "JOINT_OFFSET", "PART_OFFSET", "AXIS1", "AXIS2")


@final
class SiemensTrafo5(KinematicsFormat):
    """SINUMERIK 840D sl: machine data of TRAORI for a swivel table."""

    name = "siemens-trafo5"
    title = "SINUMERIK 840D sl"
    what = "machine data `$MC_TRAFO5_…`, type 40"
    carries = (
        "positions and directions of both rotary axes; shift of the workpiece zero (its tilt as a comment, for a frame)"
    )
    leaves = "nothing of the rotary axes (squareness of linear axes: in the tables)"
    file = "trafo5.mpf"
    unchecked = (
        "BASE_TOOL leads from the machine zero (spindle nose with all axes at zero) to the first axis, JOINT_OFFSET from there to the "
        "second: the public table gives the names and the closed sum, not the points",
        "a PART_OFFSET that does not close the sum shifts the workpiece zero by the sum",
        "$MC_TRAFO5_AXISn_1 is given as a machine datum with 12 decimals and is normalised by the control",
    )

    def nominal(self, machine: Machine) -> Values:
        """See `KinematicsFormat.nominal`."""
        nominal = table_geometry(machine)
        first, second = nominal.points
        vectors = (first, second - first, -second, *(-nominal.directions))
        return {
            f"{name}[{i}]": float(value)
            for name, vector in zip((*VECTORS, TILT), (*vectors, np.zeros(3)), strict=True)
            for i, value in enumerate(vector)
        }

    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.geometry`."""
        base, joint, part, one, two, tilt = (
            np.array([values[f"{name}[{i}]"] for i in range(3)]) for name in (*VECTORS, TILT)
        )
        directions = np.array([-axis / np.linalg.norm(axis) for axis in (one, two)])
        points = np.array([base, base + joint])
        return TableGeometry(points, directions, base + joint + part, np.radians(tilt))

    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """See `KinematicsFormat.write`."""
        lines = [*(f"; {note}" for note in notes), f"$MC_TRAFO_TYPE_1={_TYPE}"]
        for name, value in values.items():
            if name.startswith(TILT):
                lines.append(f"; {name}={fixed_decimals(value, _ANGLE_DIGITS)}")
                continue
            digits = _DIRECTION_DIGITS if name.startswith("AXIS") else _DIGITS
            vector, _, index = name.partition("[")
            lines.append(f"$MC_TRAFO5_{vector}_1[{index}={fixed_decimals(value, digits)}")
        return "\n".join([*lines, "NEWCONF", "M17"]) + "\n"

    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.read`; other machine data are ignored."""
        return self.geometry(self.values(path, machine), machine)

    def label(self, name: str, machine: Machine) -> str:
        """See `KinematicsFormat.label`."""
        vector, _, index = name.partition("[")
        return name if vector == TILT else f"MD{_NUMBERS[vector]}[{index}"

    def values(self, path: Path, machine: Machine) -> Values:
        """See `KinematicsFormat.values`."""
        lines_by_name: dict[str, TableLine] = {}
        for line in table_lines(path):
            match = _LINE.match(line.text)
            if match is None:
                continue
            value = TableLine(path, line.number, match["value"])
            if match["type"] and value.text != _TYPE:
                what = "transformation of another type"
                raise value.error(what, f"{_TYPE} (both rotary axes in the table)", value.text)
            name = match["name"] or match["tilt"]
            if name:
                assign(lines_by_name, f"{name.upper()}[{match['index'] or match['part']}]", value)
        names = list(self.nominal(machine))
        values = numbers_of(
            path, lines_by_name, [name for name in names if not name.startswith(TILT) or name in lines_by_name]
        )
        values |= {name: 0.0 for name in names if name not in values}
        for name in ("AXIS1", "AXIS2"):
            if np.linalg.norm([values[f"{name}[{i}]"] for i in range(3)]) < SHORTEST:
                raise lines_by_name[f"{name}[0]"].error(f"{name} has no direction", "a vector other than zero", "0 0 0")
        return values

    def loading(self, machine: Machine) -> tuple[str, ...]:
        """See `KinematicsFormat.loading`."""
        return (
            "Save the present machine data. Compare every value of the file with the present one: they may differ by the errors of the "
            "calibration only. A larger difference means that the vectors of this machine are defined from other points: then add the "
            "differences between this file and that of a calibration without errors.",
            f"Run {self.file} as a part program with the rights of the manufacturer; NEWCONF activates the values.",
            "The values act only while TRAORI is active.",
            "Keep the workpiece zero: PART_OFFSET contains its shift. Enter the rotation in the comments (about X, Y, Z in degrees, "
            "about the centre of the table) in a basic frame, or align the workpiece after the change.",
        )
