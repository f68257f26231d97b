"""The interpreter of LinuxCNC, as the judge of programs: its canonical motions, unrounded, with their lines and offsets."""

from __future__ import annotations

import json
import os
import subprocess
from functools import cache
from math import atan2, ceil, copysign, cos, pi, radians, sin
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.nc.modal_programs import Event

PYTHON = Path("/usr/bin/python3")
CANON = Path(__file__).with_name("linuxcnc_canon.py")
_PLANES = {1: (0, 1, 2), 2: (1, 2, 0), 3: (2, 0, 1)}
_OFFSETS = {"set_g5x_offset": 1, "set_g92_offset": 0, "tool_offset": 0}
"""Calls that shift the axes, and the place of their first length."""
_OTHER = 9
"""Motion code of a probing move or a thread."""
_AXES = (0, 1, 2, 4, 5)
PECK_MM = 0.254
"""Height above the bottom at which LinuxCNC begins to feed again after a retract for chips: 0.010 inch."""


class Motion(NamedTuple):
    """A canonical motion.

    Attributes:
        line: its line, 1-based, in the file that holds it.
        event: the motion in the program's coordinates there, X, Y, Z, B, C in mm and degrees.
        machine: its end point in the machine's coordinates; the tool's length counts as an offset.
    """

    line: int
    event: Event
    machine: tuple[float, ...]


class Reading(NamedTuple):
    """Motions that the interpreter reads in a program.

    Attributes:
        motions: up to its end, or to the line that is refused.
        line: the last line.
        refusal: the interpreter's message, empty if it reads the whole program.
    """

    motions: list[Motion]
    line: int
    refusal: str


@cache
def installed() -> bool:
    """Return whether this computer has the interpreter."""
    code = "import ctypes, gcode; ctypes.CDLL('libtooldata.so.0')"
    done = PYTHON.exists() and subprocess.run([PYTHON, "-E", "-s", "-c", code], capture_output=True, check=False)
    return bool(done) and done.returncode == 0


needed = pytest.mark.skipif(not installed(), reason="needs the interpreter of LinuxCNC (Debian: linuxcnc-uspace)")


def read(path: Path, folder: Path, *, tools: str = "", parameters: str = "") -> Reading:
    """Return what the interpreter reads in a program.

    Args:
        path: the program; subprograms may lie beside it.
        folder: for its own files.
        tools, parameters: texts of the tool table and the parameter file.
    """
    (folder / "judge.tbl").write_text(tools)
    (folder / "judge.var").write_text(parameters)
    # The interpreter looks for the tools in a file of the home folder.
    environment = {**os.environ, "HOME": str(folder)}
    words = [str(PYTHON), "-E", "-s", str(CANON), str(path.resolve()), "judge.var", "judge.tbl"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder, env=environment)
    assert done.returncode == 0, f"{done.returncode}: {done.stderr}\n{path.read_text('latin-1')}"
    answer = json.loads(done.stdout.splitlines()[-1])
    return Reading(_motions(answer["calls"]), answer["line"], answer["error"])


def events(text: str, folder: Path, tools: str = "") -> list[Event]:
    """Return the motions of a program that the interpreter reads to its end, in the program's coordinates."""
    path = folder / "program.ngc"
    path.write_bytes(text.encode("latin-1"))
    reading = read(path, folder, tools=tools)
    assert not reading.refusal, f"line {reading.line}: {reading.refusal}\n{text}"
    return [motion.event for motion in reading.motions]


def _motions(calls: list[tuple[int, str, list[float]]]) -> list[Motion]:
    found: list[Motion] = []
    shifts, turn = dict.fromkeys(_OFFSETS, (0.0,) * 5), 0.0
    plane, at = _PLANES[1], (0.0,) * 5
    for line, name, numbers in calls:
        machine = _machine(at, shifts, turn)
        if name == "set_plane":
            plane = _PLANES[int(numbers[0])]
        elif name in _OFFSETS:
            shifts[name] = _position(numbers[_OFFSETS[name] :])
            at = _of_program(machine, shifts, turn)
        elif name == "set_xy_rotation":
            turn = radians(numbers[0])
            at = _of_program(machine, shifts, turn)
        elif name in ("straight_traverse", "straight_feed"):
            at = _position(numbers)
            found.append(Motion(line, Event(int(name == "straight_feed"), at), _machine(at, shifts, turn)))
        elif name == "arc_feed":
            first, second, centre_1, centre_2, turns, third, *others = numbers
            end = [0.0] * 3
            for axis, value in zip(plane, (first, second, third), strict=True):
                end[axis] = value
            middle = (25.4 * centre_1, 25.4 * centre_2)
            event = _arc(plane, at, _position([*end, *others]), middle, int(turns))
            at = event.end
            found.append(Motion(line, event, _machine(at, shifts, turn)))
        elif name in ("straight_probe", "rigid_tap"):
            end = [*numbers[:3], *([0.0] * 6 if name == "rigid_tap" else numbers[3:])]
            at = (*_position(end)[:3], *at[3:])
            found.append(Motion(line, Event(_OTHER, at), _machine(at, shifts, turn)))
    return found


def _position(numbers: list[float]) -> tuple[float, ...]:
    return tuple(numbers[i] * (25.4 if i < 3 else 1.0) for i in _AXES)


def _machine(at: tuple[float, ...], shifts: dict[str, tuple[float, ...]], turn: float) -> tuple[float, ...]:
    """Return the position in the machine: shifted by G92, turned about the zero of the work offset, then shifted by offset and tool."""
    x, y, *others = map(sum, zip(at, shifts["set_g92_offset"], strict=True))
    turned = (x * cos(turn) - y * sin(turn), x * sin(turn) + y * cos(turn), *others)
    return tuple(map(sum, zip(turned, shifts["set_g5x_offset"], shifts["tool_offset"], strict=True)))


def _of_program(machine: tuple[float, ...], shifts: dict[str, tuple[float, ...]], turn: float) -> tuple[float, ...]:
    """Return the position in the program's coordinates of a position in the machine's."""
    x, y, *others = (
        a - b - c for a, b, c in zip(machine, shifts["set_g5x_offset"], shifts["tool_offset"], strict=True)
    )
    turned = (x * cos(turn) + y * sin(turn), -x * sin(turn) + y * cos(turn), *others)
    return tuple(a - b for a, b in zip(turned, shifts["set_g92_offset"], strict=True))


def _arc(
    plane: tuple[int, int, int],
    start: tuple[float, ...],
    end: tuple[float, ...],
    middle: tuple[float, float],
    turns: int,
) -> Event:
    """Return an arc from its sense and turns: ``turns`` full or begun ones, counter-clockwise positive."""
    a, b, _ = plane
    before = atan2(start[b] - middle[1], start[a] - middle[0])
    behind = atan2(end[b] - middle[1], end[a] - middle[0])
    share = (behind - before if turns > 0 else before - behind) % (2.0 * pi)
    if share < 1e-6 or share > 2.0 * pi - 1e-6:
        share = 2.0 * pi
    sweep = copysign(share + 2.0 * pi * (abs(turns) - 1), turns)
    assert ceil(abs(sweep) / (2.0 * pi) - 1e-6) == abs(turns)
    return Event(3 if turns > 0 else 2, end, (a, b), middle, sweep)
