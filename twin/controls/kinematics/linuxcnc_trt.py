"""LinuxCNC: pins of the kinematics ``xyzac-trt-kins`` and ``xyzbc-trt-kins`` (tilting rotary table), as ``setp`` lines of a HAL file.

The behaviour of the control is taken from its source, github.com/LinuxCNC/linuxcnc at 5c41560, ``src/emc/kinematics/trtfuncs.c``
and the configurations ``configs/sim/axis/vismach/5axis/table-rotary-tilting``:

- With A and C (or B and C) at zero the coordinates are those of the joints. ``x-rot-point`` and ``y-rot-point`` are the place of C
  there. A lies at y = ``y-rot-point`` + ``y-offset``, B at x = ``x-rot-point`` + ``x-offset``, both at the height ``z-rot-point`` +
  ``z-offset``; of these two only the sum matters. ``tool-offset`` is the tool length.
- The directions are exactly those of the linear axes. With ``conventional-directions`` 1 the table turns left-handed with a positive
  command (as on most machines), with 0 (the default) right-handed. Version 2.9 has no such pin and turns as with 0: a file that sets
  it keeps that version from starting. So the pin is only set where it must be 1, which needs version 2.10 (pull request 3482).
- `xyzbcKinematicsInverse` adds the terms of ``x-offset``, ``z-offset`` and ``tool-offset`` with the sign for
  ``conventional-directions`` 1 only; with 0 it disagrees with its own `xyzbcKinematicsForward` (until pull request 4546). twin
  therefore refuses 0 for xyzbc.

LinuxCNC has no parameter for the place of the workpiece: its shift is a comment, to be added to the workpiece zero.
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

EXACT: Final = 1e-9
_DIGITS: Final = 6
_SHIFT: Final = "work-zero-shift"
_LINE: Final = re.compile(
    r"^(?:#\s*)?(?:setp\s+(?P<kind>xyz[ab]c-trt)-kins\.(?P<pin>[a-z-]+)|(?P<shift>work-zero-shift-[xyz]))\s+(?P<value>\S+)$"
)


@final
class LinuxCncTrt(KinematicsFormat):
    """LinuxCNC: tilting rotary table with A and C or with B and C."""

    name = "linuxcnc-trt"
    title = "LinuxCNC"
    what = "`setp` lines of `xyzac-trt-kins`, `xyzbc-trt-kins`"
    carries = "position of C in X and Y, of A in Y and Z (B: X and Z); shift of the workpiece zero"
    leaves = "directions of the rotary axes"
    file = "kinematics.hal"

    def nominal(self, machine: Machine) -> Values:
        """See `KinematicsFormat.nominal`."""
        kind, _ = self._kind(machine)
        (first, second), moved = table_geometry(machine).points, "y" if kind == "xyzac-trt" else "x"
        offset = first[1] - second[1] if moved == "y" else first[0] - second[0]
        values = {"x-rot-point": second[0], "y-rot-point": second[1], "z-rot-point": first[2]}
        values[f"{moved}-offset"] = offset
        return {name: float(value) for name, value in values.items()} | {f"{_SHIFT}-{axis}": 0.0 for axis in "xyz"}

    def _kind(self, machine: Machine) -> tuple[str, int]:
        """Return the name of the kinematics, and 1 for conventional directions, else 0."""
        first, second = rotary_axes(machine)
        directions = table_geometry(machine).directions
        along = {"A": 0, "B": 1}.get(first.name)
        if along is None or second.name != "C" or abs(abs(directions[0][along]) - 1.0) > EXACT:
            raise InputError(
                f"{machine.name}: xyzac-trt needs A about X on the bed and C about Z on it, xyzbc-trt B about Y and C",
                expected="another format of kinematics for this machine",
                file=machine.path,
                value=" ".join(
                    f"{axis.name} about ({' '.join(f'{abs(v):.3f}' for v in line)})"
                    for axis, line in zip((first, second), directions, strict=True)
                ),
            )
        signs = {int(np.sign(directions[0][along])), int(np.sign(directions[1][2]))}
        allowed = ({-1}, {1}) if along == 0 else ({-1},)
        if signs not in allowed or abs(abs(directions[1][2]) - 1.0) > EXACT:
            what = f"{machine.name}: the rotary axes do not turn as the kinematics of LinuxCNC requires"
            expected = "both left-handed with a positive command (xyzac-trt: or both right-handed); reverse the scale of a joint"
            raise InputError(what, expected=expected, file=machine.path)
        return ("xyzac-trt", "xyzbc-trt")[along], int(signs == {-1})

    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.geometry`."""
        nominal = table_geometry(machine)
        (first, second), x, y = nominal.points.copy(), values["x-rot-point"], values["y-rot-point"]
        second[:2] = x, y
        first[2] = values["z-rot-point"] + values.get("z-offset", 0.0)
        if "y-offset" in values:
            first[1] = y + values["y-offset"]
        else:
            first[0] = x + values["x-offset"]
        shift = np.array([values[f"{_SHIFT}-{axis}"] for axis in "xyz"])
        return TableGeometry(np.array([first, second]), nominal.directions, shift, nominal.turn)

    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """See `KinematicsFormat.write`."""
        kind, conventional = self._kind(machine)
        unused = "x-offset" if kind == "xyzac-trt" else "y-offset"
        pins = {name: value for name, value in values.items() if not name.startswith(_SHIFT)}
        lines = [
            *(f"# {note}" for note in notes),
            *(
                f"setp {kind}-kins.{name} {fixed_decimals(value, _DIGITS)}"
                for name, value in (pins | {"z-offset": 0.0, unused: 0.0}).items()
            ),
            *([f"setp {kind}-kins.conventional-directions 1"] if conventional else []),
            f"net :tool-offset motion.tooloffset.z {kind}-kins.tool-offset",
            "# add to the workpiece zero (G54 ...) with the table at zero, unless the workpiece is probed after the change, mm:",
            *(f"# {_SHIFT}-{axis} {fixed_decimals(values[f'{_SHIFT}-{axis}'], _DIGITS)}" for axis in "xyz"),
        ]
        return "\n".join(lines) + "\n"

    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """See `KinematicsFormat.read`; other lines of a HAL file are ignored, and a missing shift is zero."""
        return self.geometry(self.values(path, machine), machine)

    def label(self, name: str, machine: Machine) -> str:
        """See `KinematicsFormat.label`."""
        return name if name.startswith(_SHIFT) else f"{self._kind(machine)[0]}-kins.{name}"

    def values(self, path: Path, machine: Machine) -> Values:
        """See `KinematicsFormat.values`."""
        kind, conventional = self._kind(machine)
        lines_by_name: dict[str, TableLine] = {}
        for line in table_lines(path):
            match = _LINE.match(line.text)
            if match is None or (match["pin"] and line.text.startswith("#")):
                continue
            if match["kind"] not in (None, kind):
                raise line.error(f"pins of other kinematics than those of {machine.name}", kind, match["kind"])
            assign(lines_by_name, match["pin"] or match["shift"], TableLine(path, line.number, match["value"]))
        names = self.nominal(machine)
        values = {name: 0.0 for name in names if name.startswith(_SHIFT)}
        values |= numbers_of(path, lines_by_name, [name for name in names if name not in values])
        for name in (*(f"{_SHIFT}-{axis}" for axis in "xyz"), "z-offset"):
            values |= numbers_of(path, lines_by_name, [name]) if name in lines_by_name else {}
        given = lines_by_name.get("conventional-directions", TableLine(path, None, "0"))
        if int(given.decimal("conventional-directions")) != conventional:
            raise given.error(f"conventional-directions of {machine.name}", str(conventional), given.text)
        return values

    def loading(self, machine: Machine) -> tuple[str, ...]:
        """See `KinematicsFormat.loading`."""
        kind, conventional = self._kind(machine)
        newer = (
            f"LinuxCNC 2.10 or newer is needed: version 2.9 has no pin conventional-directions, which {self.file} sets, and does not "
            "start with it."
        )
        return (
            *([newer] if conventional else []),
            f"Replace the setp lines of {kind}-kins in the HAL file of the machine by those of {self.file}; the line `net` is needed "
            "once only. All values are machine coordinates in mm.",
            f"Restart LinuxCNC; halcmd show pin {kind}-kins shows the values.",
            "Probe the workpiece zero again with the rotary axes at zero, or add the shift in the comments to it.",
            "The values act only while this kinematics is active (M428 of the sample configuration; not after M429).",
        )
