"""Fanuc 30i/31i: parameters 19680 to 19705 of five-axis machining, for a table with two rotary axes (mechanical unit type 12).

Checked against public descriptions: Series 30i-MODEL A, tool center point control, additional manual A-79348E
(www.cncmanuals.com/fanuc/609, pages 74 to 84): 19680 = 12 is a table with two rotary axes, the first the master; 19681 and 19686 are
the numbers of the axes; 19684 and 19689 the direction of rotation, 1 left-handed; 19703 to 19705 the vector, in machine coordinates
with both axes at zero, from a point A of the first axis to a point B of the second.

The place of the workpiece has no parameter: its shift is a comment, to be added to the workpiece zero.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.controls.format import TableLine, fixed_decimals, table_lines
from twin.controls.kinematics.format import (
    KinematicsFormat,
    TableGeometry,
    Values,
    assign,
    numbers_of,
    rotary_axes,
    table_geometry,
)
from twin.machine.machine import Machine

_DIGITS: Final = 5
_EXACT: Final = 1e-9
_SHIFT: Final = "WORK-ZERO-SHIFT"
_LINE: Final = re.compile(
    rf"^(?:N(?P<number>\d{{1,5}})\s*Q1\s*(?:L1)?\s*P(?P<value>\S+)|\({_SHIFT}\s+(?P<axis>[XYZ])(?P<shift>\S+)\))$"
)
_LENGTHS: Final = tuple(str(number) for number in range(19700, 19706))


@final
class FanucTable(KinematicsFormat):
    """Fanuc 30i: table with two rotary axes."""

    name = "fanuc-five-axis"
    title = "Fanuc Series 30i"
    what = "parameters 19680 to 19705, type 12"
    carries = "positions of both rotary axes; shift of the workpiece zero"
    leaves = "directions of the rotary axes"
    file = "fanuc5x.prm"
    unchecked = (
        "19700 to 19702 lead from the machine zero (spindle nose with all axes at zero) to the point A of the first axis",
        "19682 and 19687: 1 2 3 for X Y Z; 4, 5, 6 for an axis tilted in the plane XY, YZ, ZX by the angle in 19683 and 19688",
        "format of the parameter file: N, Q1, L1 (path), P",
        "the values have 5 decimals; a control of the increment system IS-B keeps 0.001 mm, IS-C 0.0001 mm, and rounds them",
        "volumetric and three-dimensional rotary error compensation are not written: no public description fixes their files",
    )

    def nominal(self, machine: Machine) -> Values:
        """See `KinematicsFormat.nominal`."""
        self._codes(machine)
        first, second = table_geometry(machine).points
        lengths = dict(zip(_LENGTHS, np.concatenate([first, second - first]).tolist(), strict=True))
        return lengths | {f"{_SHIFT} {axis}": 0.0 for axis in "XYZ"}

    def _codes(self, machine: Machine) -> dict[str, str]:
        """Return the parameters that describe the structure, as text."""
        codes = {"19680": "12"}
        for start, axis, turned in zip(
            (19681, 19686), rotary_axes(machine), table_geometry(machine).directions, strict=True
        ):
            line = -turned
            flat = [i for i in range(3) if abs(line[i]) < _EXACT]
            along = next((i for i in range(3) if abs(abs(line[i]) - 1.0) < _EXACT), None)
            if not flat:
                what = f"{machine.name}: the direction of {axis.name} lies in none of the planes XY, YZ, ZX"
                raise InputError(what, expected="another format of kinematics for this machine", file=machine.path)
            if along is not None:
                code, angle, hand = along + 1, 0.0, int(line[along] > 0.0)
            else:
                one = (flat[0] + 1) % 3
                code, hand = 4 + one, 1
                angle = float(np.degrees(np.arctan2(line[(one + 1) % 3], line[one])))
            texts = (str(machine.names.index(axis.name) + 1), str(code), fixed_decimals(angle, 3), str(hand))
            codes |= {str(start + i): text for i, text in enumerate(texts)}
        return codes

    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.geometry`."""
        first, between = np.array([values[name] for name in _LENGTHS]).reshape(2, 3)
        shift = np.array([values[f"{_SHIFT} {axis}"] for axis in "XYZ"])
        nominal = table_geometry(machine)
        return TableGeometry(np.array([first, first + between]), nominal.directions, shift, nominal.turn)

    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """See `KinematicsFormat.write`."""
        comments = [note.replace("(", "[").replace(")", "]") for note in notes]
        lengths = {name: fixed_decimals(values[name], _DIGITS) for name in _LENGTHS}
        lines = ["%", *(f"({note})" for note in comments)]
        lines += [f"N{name}Q1L1P{text}" for name, text in sorted((self._codes(machine) | lengths).items())]
        lines.append("(ADD TO THE WORKPIECE ZERO WITH THE TABLE AT ZERO, MM)")
        lines += [f"({_SHIFT} {axis}{fixed_decimals(values[f'{_SHIFT} {axis}'], _DIGITS)})" for axis in "XYZ"]
        return "\n".join([*lines, "%"]) + "\n"

    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.read`; other parameters and comments are ignored, and a missing shift is zero."""
        return self.geometry(self.values(path, machine), machine)

    def label(self, name: str, machine: Machine) -> str:
        """See `KinematicsFormat.label`."""
        return f"No. {name}" if name in _LENGTHS else name

    def values(self, path: Path, machine: Machine) -> Values:
        """See `KinematicsFormat.values`."""
        lines_by_parameter: dict[str, TableLine] = {}
        for line in table_lines(path):
            match = _LINE.match(line.text)
            if match is not None:
                name = match["number"] or f"{_SHIFT} {match['axis']}"
                assign(lines_by_parameter, name, TableLine(path, line.number, match["value"] or match["shift"]))
        for name, text in self._codes(machine).items():
            if name in lines_by_parameter and lines_by_parameter[name].decimal(name) != float(text):
                what = f"parameter {name} of another machine"
                raise lines_by_parameter[name].error(what, text, lines_by_parameter[name].text)
        values = numbers_of(path, lines_by_parameter, _LENGTHS)
        for axis in "XYZ":
            name = f"{_SHIFT} {axis}"
            values[name] = lines_by_parameter[name].decimal(name) if name in lines_by_parameter else 0.0
        return values

    def loading(self, machine: Machine) -> tuple[str, ...]:
        """See `KinematicsFormat.loading`."""
        return (
            "Save the present parameters. Compare every value with the present one: they may differ by the errors of the "
            "calibration only.",
            f"Enter the values of {self.file} (parameter write enabled), then switch the control off and on.",
            "The values act only in tool centre point control (G43.4, G43.5) and in functions that use the same parameters.",
            "Probe the workpiece zero again with the rotary axes at zero, or add the shift in the comments to it.",
        )
