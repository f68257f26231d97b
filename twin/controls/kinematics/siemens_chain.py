"""SINUMERIK 840D sl / ONE: kinematic chain ``$NK_…`` with the transformation TRAORI_STAT ``$NT_…``.

Checked against public descriptions: Commissioning Manual SINUMERIK Operate (IM9), 12/2017, 6FC5397-1DP40-6BA1, p. 339 and 604
(www.easymanua.ls/siemens/sinumerik-one-mcp-2400-4c/manual/1265511?p=618) and Function Manual Transformations, 06/2019,
A5E47435470B AA, p. 285 and 300: ``$NT_TRAFO_TYPE`` TRAORI_STAT, ``$NT_P_CHAIN_LAST_ELEM`` and ``$NT_T_CHAIN_LAST_ELEM`` end the chains
of workpiece and tool, which begin at the first element; ``$NT_GEO_AX_NAME`` and ``$NT_ROT_AX_NAME`` name the elements of the axes.

The linear axes are written with their nominal directions: squareness is left to the compensation tables, which also act without a
transformation.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin.controls.correction import check_linear
from twin.controls.format import TableLine, fixed_decimals
from twin.controls.kinematics.format import (
    SHORTEST,
    KinematicsFormat,
    TableGeometry,
    Values,
    code_lines,
    rotary_axes,
    table_geometry,
    work_origin,
)
from twin.machine.machine import Machine

_DIGITS: Final = 6
_DIRECTION_DIGITS: Final = 12
_ANGLE_DIGITS: Final = 10
_LINE: Final = re.compile(
    r"^(?:N\d+\s+)?\$N(?P<group>[KT])_(?P<name>\w+)\[(?P<element>\d{1,4})(?:,(?P<index>\d))?\]\s*=\s*(?P<value>.+)$",
    re.IGNORECASE,
)
_OFFSETS: Final = ("TO_FIRST", "TO_SECOND", "TO_TABLE")
_AXES: Final = ("FIRST", "SECOND")
_TURN: Final = "TURN"


@final
class SiemensChain(KinematicsFormat):
    """SINUMERIK: kinematic chain of the machine and TRAORI_STAT."""

    name = "siemens-chain"
    title = "SINUMERIK 840D sl, ONE"
    what = "kinematic chain `$NK_…`, `$NT_…`"
    carries = "positions and directions of both rotary axes; shift and tilt of the workpiece"
    leaves = "nothing of the rotary axes (squareness of linear axes: in the tables)"
    file = "kinchain.mpf"
    unchecked = (
        "the fields $NK_NAME, $NK_NEXT, $NK_PARALLEL, $NK_TYPE (OFFSET, AXIS_LIN, AXIS_ROT, ROT_CONST), $NK_OFF_DIR, $NK_AXIS and "
        "$NK_A_OFF of the elements",
        "all vectors of the chain are in machine coordinates with all axes at zero; an element moves what follows it, a rotary axis "
        "right-handed about $NK_OFF_DIR with a positive command",
        "whether TRAORI_STAT uses the directions of linear axes that are not square; they are written as square",
    )

    def nominal(self, machine: Machine) -> Values:
        """See `KinematicsFormat.nominal`."""
        nominal = table_geometry(machine)
        first, second = nominal.points
        vectors = (first, second - first, work_origin(machine) - second, *nominal.directions, nominal.turn)
        return {
            f"{name}[{i}]": float(value)
            for name, vector in zip((*_OFFSETS, *_AXES, _TURN), vectors, strict=True)
            for i, value in enumerate(vector)
        }

    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.geometry`."""
        to_first, to_second, to_table, one, two, turn = (
            np.array([values[f"{name}[{i}]"] for i in range(3)]) for name in (*_OFFSETS, *_AXES, _TURN)
        )
        directions = np.array([axis / np.linalg.norm(axis) for axis in (one, two)])
        shift = to_first + to_second + to_table - work_origin(machine)
        points = np.array([to_first, to_first + to_second])
        return TableGeometry(points, directions, shift, turn)

    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """See `KinematicsFormat.write`."""
        vectors = {name: np.array([values[f"{name}[{i}]"] for i in range(3)]) for name in (*_OFFSETS, *_AXES, _TURN)}
        first, second = rotary_axes(machine)
        motions = dict(
            zip((machine.axes[i].name for i in machine.linear), np.linalg.inv(check_linear(machine)).T, strict=True)
        )
        order = sorted(machine.linear, key=lambda i: machine.axis_joints[i])
        sides = {
            side: [machine.axes[i].name for i in order if machine.axes[i].side == side] for side in ("work", "tool")
        }
        linear = {name: ("AXIS_LIN", (-1.0 if name in sides["work"] else 1.0) * motions[name]) for name in motions}
        turn, angle = vectors[_TURN], float(np.linalg.norm(vectors[_TURN]))
        work = [(name, *linear[name]) for name in sides["work"]]
        work += [("TO_FIRST", "OFFSET", vectors["TO_FIRST"]), (first.name, "AXIS_ROT", vectors["FIRST"])]
        work += [("TO_SECOND", "OFFSET", vectors["TO_SECOND"]), (second.name, "AXIS_ROT", vectors["SECOND"])]
        work += [("TO_TABLE", "OFFSET", vectors["TO_TABLE"])]
        work += [("TABLE", "ROT_CONST", turn / angle if angle > 0.0 else np.array([0.0, 0.0, 1.0]))]
        tool = [(name, *linear[name]) for name in sides["tool"]]
        elements = [("ROOT", "OFFSET", np.zeros(3)), *work, *tool]
        following = dict(zip((one[0] for one in work), (one[0] for one in work[1:]), strict=False))
        following |= dict(zip((one[0] for one in tool), (one[0] for one in tool[1:]), strict=False))
        following["ROOT"] = work[0][0]
        lines = [f"; {note}" for note in notes]
        for n, (name, kind, vector) in enumerate(elements):
            digits = _DIGITS if kind == "OFFSET" else _DIRECTION_DIGITS
            lines += [f'$NK_NAME[{n}]="{name}"', f'$NK_NEXT[{n}]="{following.get(name, "")}"']
            lines.append(f'$NK_PARALLEL[{n}]="{tool[0][0] if tool and n == 1 else ""}"')
            lines += [f'$NK_TYPE[{n}]="{kind}"', f'$NK_AXIS[{n}]="{name if kind.startswith("AXIS") else ""}"']
            lines += [f"$NK_OFF_DIR[{n},{i}]={fixed_decimals(float(value), digits)}" for i, value in enumerate(vector)]
            lines.append(
                f"$NK_A_OFF[{n}]={fixed_decimals(np.degrees(angle) if kind == 'ROT_CONST' else 0.0, _ANGLE_DIGITS)}"
            )
        lines += ['$NT_NAME[1]="TWIN"', '$NT_TRAFO_TYPE[1]="TRAORI_STAT"', '$NT_P_CHAIN_LAST_ELEM[1]="TABLE"']
        lines.append(f'$NT_T_CHAIN_LAST_ELEM[1]="{tool[-1][0] if tool else ""}"')
        lines += [f'$NT_GEO_AX_NAME[1,{i}]="{machine.axes[k].name}"' for i, k in enumerate(machine.linear)]
        lines += [f'$NT_ROT_AX_NAME[1,{i}]="{axis.name}"' for i, axis in enumerate((first, second))]
        return "\n".join([*lines, "NEWCONF", "M17"]) + "\n"

    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.read`; the chain is followed from the element ROOT by ``$NK_NEXT``."""
        elements = _elements(path)
        name, place, followed = "ROOT", np.zeros(3), set[str]()
        points, directions, turn = list[np.ndarray](), list[np.ndarray](), np.zeros(3)
        expected = [axis.name for axis in rotary_axes(machine)]
        while name:
            element = elements.get(name)
            if element is None or name in followed:
                what = "the kinematic chain is broken or closed"
                raise TableLine(path, None, name).error(what, "elements linked by $NK_NEXT, from ROOT on", name)
            followed.add(name)
            kind = element["TYPE,"].text
            vector = np.array([element[f"OFF_DIR,{i}"].decimal("OFF_DIR") for i in range(3)])
            if kind != "OFFSET" and np.linalg.norm(vector) < SHORTEST:
                raise element["TYPE,"].error(f"{name} has no direction", "a vector other than zero", "0 0 0")
            if kind == "OFFSET":
                place = place + vector
            elif kind == "AXIS_ROT":
                if element["AXIS,"].text != expected[min(len(points), 1)] or len(points) == 2:
                    what = "not a rotary axis of the table"
                    raise element["AXIS,"].error(what, " ".join(expected), element["AXIS,"].text)
                points.append(place)
                directions.append(vector / np.linalg.norm(vector))
            elif kind == "ROT_CONST":
                turn = np.radians(element["A_OFF,"].decimal("A_OFF")) * vector / np.linalg.norm(vector)
            name = element["NEXT,"].text
        if len(points) != 2:
            what = "a rotary axis is missing in the chain"
            raise TableLine(path, None, "").error(what, " ".join(expected), len(points))
        return TableGeometry(np.array(points), np.array(directions), place - work_origin(machine), turn)

    def label(self, name: str, machine: Machine) -> str:
        """See `KinematicsFormat.label`: element and coordinate."""
        element, _, index = name.partition("[")
        axes = dict(zip(_AXES, (axis.name for axis in rotary_axes(machine)), strict=True))
        return f"{name} [rad]" if element == _TURN else f"$NK_OFF_DIR {axes.get(element, element)}[{index}"

    def loading(self, machine: Machine) -> tuple[str, ...]:
        """See `KinematicsFormat.loading`."""
        return (
            "Save the present kinematic chain. Change OFFSET, AXIS_ROT and ROT_CONST of the existing chain by the differences between "
            "this file and that of a calibration without errors; keep its names, its collision elements and the directions of its "
            "linear axes.",
            f"A control without a chain can run {self.file} as a part program with the rights of the manufacturer.",
            "The chain acts only while the transformation (TRAORI) is active.",
            "The element TABLE contains shift and tilt of the workpiece zero: keep the workpiece zero.",
        )


def _elements(path: Path) -> dict[str, dict[str, TableLine]]:
    """Return the elements of the chain by name: their fields by name and index (``OFF_DIR,0``)."""
    found: dict[int, dict[str, TableLine]] = {}
    for line in code_lines(path, ";"):
        match = _LINE.match(line.text)
        if match is None or match["group"].upper() != "K":
            continue
        fields = found.setdefault(int(match["element"]), {})
        key = f"{match['name'].upper()},{match['index'] or ''}"
        if key in fields:
            raise line.error("assigned twice", "one assignment", line.text)
        fields[key] = TableLine(path, line.number, match["value"].strip().strip('"'))
    elements = {}
    needed = ("NAME,", "NEXT,", "TYPE,", "AXIS,", "A_OFF,", "OFF_DIR,0", "OFF_DIR,1", "OFF_DIR,2")
    for n, fields in found.items():
        for key in needed:
            if key not in fields:
                raise TableLine(path, None, "").error(f"element {n} lacks $NK_{key.rstrip(',')}", "all its fields")
        elements[fields["NAME,"].text] = fields
    return elements
