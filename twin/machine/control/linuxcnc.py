"""LinuxCNC: joint compensation files (``COMP_FILE``), one joint each, with the lines of the INI file that name them.

What the control does with them is read from its source, github.com/LinuxCNC/linuxcnc at 5c41560:

- ``src/emc/motion/usrmotintf.cc`` (`usrmotLoadComp`): three numbers a line, nominal, forward, reverse; **reading stops without a
  word at the first line that is not three numbers**, a comment or an empty line included. ``COMP_FILE_TYPE = 0``: forward and
  reverse are the actual positions coming from below and from above, and the trim is nominal − actual. ``COMP_FILE_TYPE = 1``:
  they are the trims.
- ``src/emc/motion/control.c`` (`compute_screw_comp`, and where ``motor_pos_cmd`` is made): the trim is added to the commanded
  position. Straight lines between the points; below the first its trim, above the last its trim. The forward one while the joint
  moves up, the reverse one while it moves down, standing still what there was.
- ``src/emc/motion/motion.h``: 256 points a joint. ``src/emc/motion/command.c``: nominals must rise.
- linuxcnc.org/docs/html/config/ini-config.html, ``[JOINT_n]``: values in machine units; ``BACKLASH`` is not used beside a
  ``COMP_FILE``.

Positions are not wrapped: an axis that turns without end needs as many turns as it makes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.machine.control.curve import Curve, Term, Terms
from twin.machine.control.lines import axis_named, check_letters, number, numbered, plain, rising, unit_of
from twin.machine.machine import Axis, Machine

POINTS: Final = 256
"""Points a joint may have."""
DIGITS: Final = 6
"""Behind the point, mm and degrees: a nanometre."""
INI: Final = "joints.ini"


def write(terms: Sequence[Term], machine: Machine, notes: Sequence[str] = ()) -> dict[str, str]:
    """Files by name: one ``.comp`` a joint of type 0 (actual positions), and the INI lines that name them.

    Args:
        terms: tables of an axis over itself; two of one axis, of the directions +1 and −1, have the same nodes.
        machine: its axes are taken as joints 0, 1, … in command order.
        notes: said in comments: behind the last point, where the control no longer reads, and at the head of the INI lines.

    Raises:
        InputError: an axis that is none of X Y Z A B C U V W, more than 256 points, or what a joint compensation cannot hold.
    """
    check_letters(machine.names, "LinuxCNC")
    files: dict[str, str] = {}
    ini = [
        "# Lines for the INI file of LinuxCNC; COORDINATES and the units are there already and must say the same.",
        *(f"# {note}" for note in notes),
        "[TRAJ]",
        f"COORDINATES = {' '.join(machine.names)}",
        "LINEAR_UNITS = mm",
        "ANGULAR_UNITS = degree",
    ]
    for joint, axis in enumerate(machine.axes):
        own = [term for term in terms if term.axis == axis.name]
        if not own:
            continue
        up, down = _both(own, axis)
        scale = unit_of(axis)
        rows = [
            " ".join(plain(value, DIGITS) for value in (q, q - up.values[i] * scale, q - down.values[i] * scale))
            for i, q in enumerate(up.at)
        ]
        name = f"{axis.name}.comp"
        files[name] = "\n".join([*rows, *(f"# {note}" for note in notes)]) + "\n"
        ini += [f"[JOINT_{joint}]", "# no BACKLASH beside it", f"COMP_FILE = {name}", "COMP_FILE_TYPE = 0"]
    files[INI] = "\n".join(ini) + "\n"
    return files


def _both(own: Sequence[Term], axis: Axis) -> tuple[Curve, Curve]:
    """The curves coming from below and from above."""
    curves = [term.factors[0] for term in own]
    by = {curve.direction: curve for curve in curves}
    up, down = by.get(1, by.get(0)), by.get(-1, by.get(0))
    whole = len(own) == (1 if 0 in by else 2) and all(len(term.factors) == 1 for term in own)
    if up is None or down is None or not whole or up.at != down.at or {up.of, down.of} != {axis.name} or up.period:
        raise InputError(
            f"no joint compensation of LinuxCNC: {axis.name}",
            expected="one table of an axis over itself, or one for each direction with the same nodes; positions not wrapped",
            value=[f"over {curve.of}, direction {curve.direction}" for curve in curves],
        )
    if len(up.at) > POINTS:
        raise InputError(
            f"too many points for joint {axis.name}", expected=f"at most {POINTS} (LinuxCNC)", value=len(up.at)
        )
    return up, down


def read(files: Sequence[Path], machine: Machine) -> Terms:
    """Tables from an INI file (or its lines) and the ``.comp`` files it names.

    Raises:
        InputError: no INI file among them, a file it names is missing or one it does not name is there; units other than mm and
        degrees;
            whatever LinuxCNC would refuse, or would read less of than is there.
    """
    inis = [file for file in files if file.suffix.lower() == ".ini"]
    if len(inis) != 1:
        raise InputError(
            "LinuxCNC's tables are read with the INI file that names them",
            expected=f"one .ini with [JOINT_n] COMP_FILE and COMP_FILE_TYPE (twin writes {INI}) and the .comp files",
            value=" ".join(file.name for file in files),
        )
    ini = _Ini(inis[0])
    given = {file.name: file for file in files if file is not inis[0]}
    terms: list[Term] = []
    for joint, name in ini.coordinates(machine):
        entry = ini.entry(f"JOINT_{joint}", "COMP_FILE")
        if entry is None:
            continue
        line, text = entry
        if not text:
            raise InputError("COMP_FILE names no file", expected="the name of a .comp file", file=inis[0], line=line)
        axis = axis_named(name, machine, inis[0], line)
        file = given.pop(Path(text).name, None)
        if file is None:
            raise InputError("the file is not given", expected=text, file=inis[0], line=line, value=sorted(given))
        kind = ini.entry(f"JOINT_{joint}", "COMP_FILE_TYPE")
        if kind is None or kind[1] not in ("0", "1"):
            raise InputError(
                f"COMP_FILE_TYPE of JOINT_{joint}",
                expected="0 or 1",
                file=inis[0],
                line=line if kind is None else kind[0],
                value=None if kind is None else kind[1],
            )
        terms += _terms(file, axis, actual=kind[1] == "0")
    if given:
        raise InputError(
            "files that no [JOINT_n] COMP_FILE names", expected="them in the INI", file=inis[0], value=sorted(given)
        )
    return Terms(terms, machine)


def _terms(path: Path, axis: Axis, *, actual: bool) -> list[Term]:
    rows: list[tuple[float, float, float]] = []
    lines: list[int] = []
    stopped: int | None = None
    for line, text in numbered(path):
        words = text.split()
        three = len(words) >= 3 and all(re.match(r"[-+]?(\d|\.\d)", word) for word in words[:3])
        if not three:
            stopped = stopped or line
            continue
        if stopped is not None:
            raise InputError(
                "points behind a line that is not three numbers: LinuxCNC stops there and never reads them",
                expected="nothing between the points, comments only behind the last",
                file=path,
                line=stopped,
                value=text,
            )
        nominal, up, down = (number(word, path, line, "a position") for word in words[:3])
        rows.append((nominal, nominal - up, nominal - down) if actual else (nominal, up, down))
        lines.append(line)
    if not rows:
        raise InputError("no points", expected="nominal, forward and reverse, line by line", file=path)
    if len(rows) > POINTS:
        raise InputError(
            "too many points", expected=f"at most {POINTS}", file=path, line=lines[POINTS], value=len(rows)
        )
    at = tuple(row[0] for row in rows)
    rising(at, tuple(lines), path)
    ups, downs = (tuple(row[i] / unit_of(axis) for row in rows) for i in (1, 2))
    if ups == downs:
        return [Term(axis.name, (Curve(axis.name, at, ups),))]
    return [
        Term(axis.name, (Curve(axis.name, at, ups, direction=1),)),
        Term(axis.name, (Curve(axis.name, at, downs, direction=-1),)),
    ]


@final
class _Ini:
    """The sections of an INI file, as far as they are needed here."""

    def __init__(self, path: Path) -> None:
        self.path = path
        found: dict[tuple[str, str], tuple[int, str]] = {}
        section = ""
        for line, text in numbered(path):
            if text.startswith("["):
                section = text.strip("[] ").upper()
            elif "=" in text and text[0] not in "#;":
                key, _, value = text.partition("=")
                found.setdefault((section, key.strip().upper()), (line, value.partition("#")[0].strip()))
        self.found: Mapping[tuple[str, str], tuple[int, str]] = found

    def entry(self, section: str, key: str) -> tuple[int, str] | None:
        """Line and value."""
        return self.found.get((section, key))

    def coordinates(self, machine: Machine) -> list[tuple[int, str]]:
        """Joint numbers with the axis each moves.

        Raises:
            InputError: they are not said, or not each axis once; units other than mm and degrees.
        """
        for key, wanted in (("LINEAR_UNITS", ("mm", "metric")), ("ANGULAR_UNITS", ("degree", "deg"))):
            unit = self.entry("TRAJ", key)
            if unit is None or unit[1].lower() not in wanted:
                raise InputError(
                    f"[TRAJ] {key}",
                    expected=wanted[0],
                    file=self.path,
                    line=None if unit is None else unit[0],
                    value=None if unit is None else unit[1],
                )
        entry = self.entry("TRAJ", "COORDINATES")
        names = [] if entry is None else list(entry[1].replace(" ", "").upper())
        if entry is None or len(set(names)) != len(names):
            raise InputError(
                "[TRAJ] COORDINATES, one joint an axis",
                expected=" ".join(machine.names),
                file=self.path,
                line=None if entry is None else entry[0],
                value=None if entry is None else entry[1],
            )
        return list(enumerate(names))
