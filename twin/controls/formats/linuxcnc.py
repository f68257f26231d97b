"""LinuxCNC: joint compensation files (``COMP_FILE``), one per joint, with the lines of the INI file that name them.

The behaviour of the control is taken from its source, github.com/LinuxCNC/linuxcnc at 5c41560:

- ``src/emc/motion/usrmotintf.cc`` (`usrmotLoadComp`): three numbers per line, nominal, forward, reverse; **reading stops
  silently at the first line that is not three numbers**, including a comment or an empty line. ``COMP_FILE_TYPE = 0``: forward and
  reverse are the actual positions approached in the + and the − direction, and the trim is nominal − actual. ``COMP_FILE_TYPE = 1``:
  they are the trims.
- ``src/emc/motion/control.c`` (`compute_screw_comp`, and the calculation of ``motor_pos_cmd``): the trim is added to the
  commanded position, with linear interpolation between the points and constant continuation beyond them. The forward trim applies
  while the joint moves up, the reverse trim while it moves down; at standstill the last one remains. The change of the trim is
  ramped at half of the joint's acceleration a, but from standstill the ramp does not begin for a change between aT²/4 and aT²/2 (T
  the servo period): 1.25 to 2.5 µm with 5000 mm/s² and 1 ms, as executed by version 2.9.
- ``src/emc/motion/motion.h``: 256 points per joint. ``src/emc/motion/command.c``: nominal positions must increase.
- linuxcnc.org/docs/html/config/ini-config.html, ``[JOINT_n]``: values in machine units; ``BACKLASH`` is not used together
  with a ``COMP_FILE``.

Positions are not wrapped: the table of an unlimited rotary axis must cover as many turns as the axis makes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.correction import BOTH, DOWN, UP, ControlCurve, ControlTerm, TableSum
from twin.controls.format import (
    TableFormat,
    TableLine,
    check_increasing,
    check_letters,
    fixed_decimals,
    single_file,
    table_lines,
    unit_of,
)
from twin.machine.machine import Axis, Machine

INI: Final = "joints.ini"
_DIGITS: Final = 6
"""Number of decimals, mm and degrees: one nanometre."""


@final
class LinuxCnc(TableFormat[TableSum]):
    """LinuxCNC: joint compensation files."""

    name = "linuxcnc"
    title = "LinuxCNC"
    what = "`.comp`, one per joint"
    carries = "positioning, backlash; of angular errors the part along the axis"
    leaves = "straightness, squareness"
    written = ("{}.comp", INI)
    correction = TableSum
    classes = ("L-POS", "L-ANG", "R-POS")
    points = 256
    rounding = (0.0005, 0.0088)
    directions = True

    def write(self, correction: TableSum, notes: Sequence[str] = ()) -> dict[str, str]:
        """Return one ``.comp`` of type 0 (actual positions) per joint, and the INI lines that name them; see `TableFormat.write`.

        Tables are those of an axis over itself, of at most 256 points, the same for both directions; the axes are joints 0, 1, … in
        command order. Notes are comments after the last point, where the control no longer reads, and at the beginning of the INI
        lines.
        """
        machine = correction.machine
        check_letters(machine.names, self.title)
        comments = [f"# {note}" for note in notes]
        files: dict[str, str] = {}
        ini = [
            "# Lines for the INI file of LinuxCNC; COORDINATES and the units exist there already and must agree.",
            *comments,
            "[TRAJ]",
            f"COORDINATES = {' '.join(machine.names)}",
            "LINEAR_UNITS = mm",
            "ANGULAR_UNITS = degree",
        ]
        for joint, axis in enumerate(machine.axes):
            own = [term for term in correction.terms if term.axis == axis.name]
            if not own:
                continue
            up, down = self._both(own, axis)
            scale, name = unit_of(axis), f"{axis.name}.comp"
            rows = [
                " ".join(fixed_decimals(value, _DIGITS) for value in (q, q - a * scale, q - b * scale))
                for q, a, b in zip(up.at, up.values, down.values, strict=True)
            ]
            files[name] = "\n".join([*rows, *comments]) + "\n"
            ini += [
                f"[JOINT_{joint}]",
                "# do not use BACKLASH together with it",
                f"COMP_FILE = {name}",
                "COMP_FILE_TYPE = 0",
            ]
        return {**files, INI: "\n".join(ini) + "\n"}

    def _both(self, own: Sequence[ControlTerm], axis: Axis) -> tuple[ControlCurve, ControlCurve]:
        """Return the curves of the + and the − direction."""
        curves = [term.factors[0] for term in own]
        by = {curve.direction: curve for curve in curves}
        up, down = by.get(UP, by.get(BOTH)), by.get(DOWN, by.get(BOTH))
        whole = len(own) == (1 if BOTH in by else 2) and all(len(term.factors) == 1 for term in own)
        alike = up is not None and down is not None and whole and up.at == down.at and not up.period
        if up is None or down is None or not alike or {up.argument, down.argument} != {axis.name}:
            what = f"not possible as a joint compensation of LinuxCNC: {axis.name}"
            expected = (
                "one table of the axis over itself, or one per direction with the same nodes; positions not wrapped"
            )
            shown = [f"over {curve.argument}, direction {curve.direction}" for curve in curves]
            raise InputError(what, expected=expected, value=shown)
        if len(up.at) > self.points:
            what = f"too many points for joint {axis.name}"
            raise InputError(what, expected=f"at most {self.points} (LinuxCNC)", value=len(up.at))
        return up, down

    def read(self, files: Sequence[Path], machine: Machine) -> TableSum:
        """Return the tables from an INI file (or its lines) and the ``.comp`` files named in it.

        It raises `InputError` if the units are not mm and degrees, or LinuxCNC would refuse a file or not read all of it.
        """
        what = "LinuxCNC tables are read with the INI file that names them"
        expected = f"one .ini with [JOINT_n] COMP_FILE and COMP_FILE_TYPE (twin writes {INI}) and the .comp files"
        ini = _Ini(single_file(files, ".ini", what, expected))
        given = {file.name: file for file in files if file is not ini.path}
        terms: list[ControlTerm] = []
        for joint, name in enumerate(ini.coordinates(machine)):
            entry, kind = (ini.get(f"JOINT_{joint}", key) for key in ("COMP_FILE", "COMP_FILE_TYPE"))
            if entry.number is None:
                continue
            if not entry.text:
                raise entry.error("COMP_FILE is empty", "the name of a .comp file")
            axis = entry.axis(name, machine)
            file = given.pop(Path(entry.text).name, None)
            if file is None:
                raise entry.error("missing file", entry.text, sorted(given))
            if kind.text not in ("0", "1"):
                there = entry if kind.number is None else kind
                raise there.error(f"COMP_FILE_TYPE of JOINT_{joint}", "0 or 1", kind.text or None)
            terms += self._terms(file, axis, actual=kind.text == "0")
        if given:
            what = "files that no [JOINT_n] COMP_FILE names"
            raise InputError(what, expected="all files named in the INI file", file=ini.path, value=sorted(given))
        return TableSum(tuple(terms), machine)

    def _terms(self, path: Path, axis: Axis, *, actual: bool) -> list[ControlTerm]:
        """Return the tables of one joint, one for both directions or one for each."""
        rows: list[tuple[float, float, float]] = []
        lines: list[TableLine] = []
        stopped: TableLine | None = None
        for line in table_lines(path):
            words = line.text.split()
            if not (len(words) >= 3 and all(re.match(r"[-+]?(\d|\.\d)", word) for word in words[:3])):
                stopped = stopped or line
                continue
            if stopped is not None:
                what = "points after a line that is not three numbers: LinuxCNC stops there and does not read them"
                raise stopped.error(what, "no other lines between the points, comments only after the last", line.text)
            nominal, up, down = (line.decimal("a position", word) for word in words[:3])
            rows.append((nominal, nominal - up, nominal - down) if actual else (nominal, up, down))
            lines.append(line)
        if not rows:
            raise InputError("no points", expected="lines with nominal, forward and reverse position", file=path)
        if len(rows) > self.points:
            raise lines[self.points].error("too many points", f"at most {self.points}", len(rows))
        at = tuple(row[0] for row in rows)
        check_increasing(at, lines)
        ups, downs = (tuple(row[i] / unit_of(axis) for row in rows) for i in (1, 2))
        sides = [(ups, BOTH)] if ups == downs else [(ups, UP), (downs, DOWN)]
        return [
            ControlTerm(axis.name, (ControlCurve(axis.name, at, values, direction=side),)) for values, side in sides
        ]

    def loading(self, correction: TableSum, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        machine = correction.machine
        joints = ", ".join(f"joint {i} is {name}" for i, name in enumerate(machine.names))
        pins = [f"joint.{machine.names.index(name)}.backlash-corr" for name in largest]
        shown = f"halcmd show pin {pins[0]} shows" if len(pins) == 1 else f"halcmd show pin {' or '.join(pins)} show"
        loading = [
            f"Copy the .comp files next to the INI file, and the lines of {INI} into its existing sections ({joints}: "
            "check this).",
            "Remove BACKLASH from these sections: it is not used together with a COMP_FILE.",
            "Set STEPGEN_MAXACCEL (steppers) to 1.5 to 2 times MAX_ACCELERATION: the correction adds to the motion of the program.",
            f"Restart LinuxCNC. The tables are then active; {shown} the correction (mm, degrees).",
            "Move every axis once after homing: a joint that has not moved since then has no correction.",
            "With a = MAX_ACCELERATION and T = SERVO_PERIOD, LinuxCNC 2.9 leaves out a change of the correction between aT²/4 and "
            "aT²/2 until the correction changes further (5000 mm/s² and 1 ms: up to 2.5 µm).",
            "To deactivate them, remove the COMP_FILE lines and restart.",
        ]
        if any(axis.lower is None for axis in machine.axes):
            loading.append(
                "Unlimited rotary axis: the table covers -360 ... 720 degrees; beyond that its end value applies."
            )
        return tuple(loading)


@final
class _Ini:
    """The entries of an INI file by section and key."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._found: dict[tuple[str, str], TableLine] = {}
        section = ""
        for line in table_lines(path):
            if line.text.startswith("["):
                section = line.text.strip("[] ").upper()
            elif "=" in line.text and line.text[0] not in "#;":
                key, _, value = line.text.partition("=")
                entry = TableLine(path, line.number, value.partition("#")[0].strip())
                self._found.setdefault((section, key.strip().upper()), entry)

    def get(self, section: str, key: str) -> TableLine:
        """Return the value of an entry; without line number and text if there is none."""
        return self._found.get((section, key), TableLine(self.path, None, ""))

    def coordinates(self, machine: Machine) -> list[str]:
        """Return the axis that each joint moves; raise `InputError` for one given twice, and units other than mm and degrees."""
        for key, wanted in (("LINEAR_UNITS", ("mm", "metric")), ("ANGULAR_UNITS", ("degree", "deg"))):
            unit = self.get("TRAJ", key)
            if unit.text.lower() not in wanted:
                raise unit.error(f"[TRAJ] {key}", wanted[0], unit.text or None)
        entry = self.get("TRAJ", "COORDINATES")
        names = list(entry.text.replace(" ", "").upper())
        if entry.number is None or len(set(names)) != len(names):
            raise entry.error("[TRAJ] COORDINATES, one joint per axis", " ".join(machine.names), entry.text or None)
        return names
