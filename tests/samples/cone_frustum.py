"""Generate the cone frustum programs in `twin.samples`: run ``python -m tests.samples.cone_frustum``.

The five-axis acceptance test of NAS 979 and ISO 10791-7: a conical frustum with an inclined axis, finished in one turn with the flank
of an end mill, so that all five axes move at once. Half apex angle 15°, inclination 10°, base diameter 80 mm; height, offset from the
table centre and tool are chosen here. The same path is written in three languages: cutter locations (APT), tool-tip coordinates with B
and C (Heidenhain plain language, ``M128``) and axis words of the DMU 50 (ISO).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.files import write_atomic
from twin._common.units import DEG
from twin.compensation.programs.words import Setup, WordSpace
from twin.machine.machine import Machine
from twin.samples import PLANS
from twin.tool.forward import Poses
from twin.tool.inverse import Inverse

FOLDER: Final = PLANS[0].parent
HALF_APEX_DEG: Final = 15.0
INCLINED_DEG: Final = 10.0
BASE_DIAMETER_MM: Final = 80.0
HEIGHT_MM: Final = 20.0
CENTRE_MM: Final = (60.0, 0.0, 60.0)
"""Centre of the base circle in the work frame (table centre)."""
TOOL_RADIUS_MM: Final = 10.0
TOOL_LENGTH_MM: Final = 120.0
BELOW_MM: Final = 2.0
"""The tool's end goes this far below the base."""
STEP_DEG: Final = 1.0
FEED: Final = 800


def cutter_locations() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the path: tool tips (n, 3) mm and tool axes (n, 3) in the work frame, and (n,) whether each block is a rapid."""
    angle = np.arange(0.0, 360.0 + 0.5 * STEP_DEG, STEP_DEG) * DEG
    apex = HALF_APEX_DEG * DEG
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    along = -np.sin(apex) * around + np.cos(apex) * up
    outward = np.cos(apex) * around + np.sin(apex) * up
    tip = 0.5 * BASE_DIAMETER_MM * around + TOOL_RADIUS_MM * outward - BELOW_MM * along
    clear = HEIGHT_MM + 40.0
    first, last = tip[0] + 15.0 * outward[0], tip[-1] + 15.0 * outward[-1]
    points = np.concatenate([[first + clear * along[0], first], tip, [last, last + clear * along[-1]]])
    axes = np.concatenate([along[[0, 0]], along, along[[-1, -1]]])
    rapid = np.zeros(len(points), dtype=bool)
    rapid[[0, 1, -1]] = True
    lean = INCLINED_DEG * DEG
    turn = np.array([[np.cos(lean), 0.0, np.sin(lean)], [0.0, 1.0, 0.0], [-np.sin(lean), 0.0, np.cos(lean)]])
    return points @ turn.T + CENTRE_MM, axes @ turn.T, rapid


def apt() -> str:
    """Return the program in cutter locations."""
    points, axes, rapid = cutter_locations()
    out = [
        "$$ CONE FRUSTUM, NAS 979 / ISO 10791-7: HALF APEX 15 DEG, INCLINED 10 DEG, BASE DIA 80",
        "PARTNO/CONE FRUSTUM",
        "UNITS/MM",
        "MULTAX/ON",
        "LOADTL/1",
        "SPINDL/RPM,6000,CLW",
    ]
    for point, axis, fast in zip(points, axes, rapid, strict=True):
        words = ",".join([*(f"{value:.5f}" for value in point), *(f"{value:.9f}" for value in axis)])
        if fast:
            out.append("RAPID")
        out.append(f"GOTO/{words}")
        if len(out) == 10:
            out.append(f"FEDRAT/{FEED},MMPM")
    return "\n".join([*out, "SPINDL/OFF", "FINI", ""])


def heidenhain() -> str:
    """Return the program as tool tips with B and C, in tool-centre-point mode."""
    points, axes, rapid = cutter_locations()
    space = _space()
    rotary = np.round(_rotary(space, axes), 3)
    out = [
        "BEGIN PGM CONE_FRUSTUM MM",
        "; CONE FRUSTUM, NAS 979 / ISO 10791-7: HALF APEX 15 DEG, INCLINED 10 DEG, BASE DIA 80",
        "TOOL CALL 1 Z S6000",
        "L Z+0 R0 FMAX M91",
        "M3",
        "FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS",
    ]
    for point, (b, c), fast in zip(points, rotary, rapid, strict=True):
        feed = "FMAX" if fast else f"F{FEED}"
        out.append(f"L X{point[0]:+.3f} Y{point[1]:+.3f} Z{point[2]:+.3f} B{b:+.3f} C{c:+.3f} R0 {feed}")
    out += ["FUNCTION RESET TCPM", "L Z+0 R0 FMAX M91", "M5", "M30", "END PGM CONE_FRUSTUM MM"]
    return "".join(f"{number} {line}\n" for number, line in enumerate(out))


def iso() -> str:
    """Return the program in axis words of the DMU 50 for a tool of 120 mm."""
    points, axes, rapid = cutter_locations()
    space = _space()
    start = np.zeros((len(points), len(space.order)))
    start[:, space.order[3:]] = np.round(_rotary(space, axes), 3)
    target = Poses(points, space.nominal.forward(start).rotation)
    solution = Inverse(space.nominal).solve(target, start, rotary=False)
    out = [
        "%",
        "O0979 (CONE FRUSTUM, NAS 979 / ISO 10791-7)",
        "(HALF APEX 15 DEG, INCLINED 10 DEG, BASE DIA 80)",
        "(AXIS WORDS OF THE DMU 50: TOOL LENGTH 120 MM)",
        "N10 G21 G17 G40 G90 G94",
        "N20 T1 M6",
        "N30 S6000 M3",
    ]
    last: list[str] = [""] * len(space.order)
    code = ""
    for i, (position, fast) in enumerate(zip(solution.positions[:, space.order], rapid, strict=True)):
        words = [f"{name}{value:.3f}" for name, value in zip(space.axes.names, position, strict=True)]
        changed = [word for word, before in zip(words, last, strict=True) if word != before]
        motion = "G0" if fast else "G1"
        line = [f"N{40 + 10 * i}", *([motion] if motion != code else []), *changed]
        if motion == "G1" and code == "G0":
            line.append(f"F{FEED}")
        out.append(" ".join(line))
        last, code = words, motion
    return "\n".join([*out, "M5", "M30", "%", ""])


def _space() -> WordSpace:
    return WordSpace(Machine.load("dmu50"), Setup(), TOOL_LENGTH_MM)


def _rotary(space: WordSpace, axes: np.ndarray) -> np.ndarray:
    """Return (n, 2) rotary positions, each on the branch of the one before."""
    return space.branches.along(space.branches.all(axes), np.zeros(2), np.zeros(2))


def main() -> None:
    """Write the three programs."""
    for suffix, text in (("cls", apt()), ("h", heidenhain()), ("nc", iso())):
        write_atomic(FOLDER / f"cone_frustum.{suffix}", text)


if __name__ == "__main__":
    main()
