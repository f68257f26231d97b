"""The interpreter of LinuxCNC (`rs274 -g`), as the judge of programs: its canonical motions."""

from __future__ import annotations

import re
import shutil
import subprocess
from math import atan2, ceil, copysign, pi
from pathlib import Path

import pytest

from tests.nc.modal_programs import Event

PROGRAM = shutil.which("rs274")
needed = pytest.mark.skipif(PROGRAM is None, reason="needs rs274 of LinuxCNC (Debian: linuxcnc-uspace)")
_CALL = re.compile(r"\d+ +N\S* +(\w+)\((.*)\)")
_PLANES = {"CANON_PLANE_XY": (0, 1, 2), "CANON_PLANE_XZ": (2, 0, 1), "CANON_PLANE_YZ": (1, 2, 0)}
PECK_MM = 0.254
"""Height above the bottom at which LinuxCNC begins to feed again after a retract for chips: 0.010 inch."""


def events(text: str, folder: Path, tools: Path | None = None) -> list[Event]:
    """Return the motions of a program by LinuxCNC's interpreter, X, Y, Z, B, C in mm and degrees, 4 decimals of a program unit."""
    assert PROGRAM is not None
    path = folder / "program.ngc"
    path.write_bytes(text.encode("latin-1"))
    table = [] if tools is None else ["-t", str(tools)]
    done = subprocess.run([PROGRAM, "-g", *table, str(path)], capture_output=True, text=True, check=False, cwd=folder)
    found: list[Event] = []
    unit, plane, at = 1.0, (0, 1, 2), (0.0,) * 5
    said = [line for line in (done.stdout + done.stderr).splitlines() if not _CALL.search(line)]
    ended = False
    for call in _CALL.finditer(done.stdout):
        name, arguments = call.group(1), call.group(2)
        ended |= name == "PROGRAM_END"
        if name == "USE_LENGTH_UNITS":
            unit = 25.4 if "INCHES" in arguments else 1.0
        elif name == "SELECT_PLANE":
            plane = _PLANES[arguments]
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            x, y, z, _, b, c = map(float, arguments.split(","))
            at = (x * unit, y * unit, z * unit, b, c)
            found.append(Event(int(name == "STRAIGHT_FEED"), at))
        elif name == "ARC_FEED":
            first, second, centre_1, centre_2, turns, third, _, b, c = map(float, arguments.split(","))
            end = list(at)
            end[plane[0]], end[plane[1]], end[plane[2]] = first * unit, second * unit, third * unit
            end[3:] = b, c
            middle = (centre_1 * unit, centre_2 * unit)
            found.append(_arc(plane, at, tuple(end), middle, int(turns)))
            at = tuple(end)
    assert ended, f"rs274: {said[-3:]}\n{text}"
    return found


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
    if share < 1e-3 or share > 2.0 * pi - 1e-3:
        share = 2.0 * pi
    sweep = copysign(share + 2.0 * pi * (abs(turns) - 1), turns)
    assert ceil(abs(sweep) / (2.0 * pi) - 1e-3) == abs(turns)
    return Event(3 if turns > 0 else 2, end, (a, b), middle, sweep)
