"""The stage of `../shared/data/real/stage-iso230-2`: URDF, machine file, and its ISO 230-2 run as a measurement table.

A slide driven by a screw and a motor with a resolver. Its position is measured by a laser triangulation sensor along the axis: one
coordinate, x. Nine targets, five cycles, both directions.

The reports print the tables of the two directions under each other's headings. The input of their program (the ``.dat``
file with the report of x) and the logs of the motion in the source's repository have the opposite assignment: the slide moves to
20.5 mm before the reading that the report calls forward at 20 mm. `readings` corrects it: arriving from below, the slide is lower.

The reports contain neither order nor time. In the log of x every cycle goes up through all targets and down again, one reading every
28.5 s, 17 s at the turning point; cycles follow each other in the same way. The tables' rows are in that order and have those times.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from tests.real import write_both

REPORTS: Final = {"x": "b02_x_x_iso230_2_report.md", "y": "b02_y_report_target_y.md"}
NUMBERS: Final = "b02_x_target_x.md_ISO230.dat"
STEP_S: Final = 28.5
TURN_S: Final = 17.0
_URDF: Final = """<?xml version="1.0"?>
<!-- One slide on a bed; metres. -->
<robot name="stage">
  <link name="bed"/>
  <joint name="slide_joint" type="prismatic">
    <parent link="bed"/><child link="slide"/>
    <axis xyz="1 0 0"/><limit lower="-0.021" upper="0.021" effort="0" velocity="0.001"/>
  </joint>
  <link name="slide"/>
</robot>
"""
_MACHINE: Final = """schema: twin.machine/1
name: stage
urdf: stage.urdf
axes:  # between the limit switches
  - {name: X, joint: slide_joint, kind: linear, range: [-21, 21], increment: 0.0001}
frames: {tool: slide, work: bed}
"""


def write_machine(folder: Path) -> Path:
    """Write URDF and machine file into ``folder``."""
    return write_both(folder, "stage", _URDF, _MACHINE)


def readings(shared: Path, axis: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return targets (9,), and readings arriving from below and from above, each (9, 5 cycles), mm."""
    text = (shared / REPORTS[axis]).read_text(encoding="utf-8")
    targets, above = _table(text, "Data forward direction")
    _, below = _table(text, "Data backward direction")
    return targets, below, above


def numbers(shared: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the same for x from the input of the reports' program: from below and from above, each (9, 5), mm."""
    text = (shared / NUMBERS).read_text(encoding="utf-8")
    found = []
    for way in ("FWD", "BWD"):
        cells = {(int(i), int(j)): float(v) for i, j, v in re.findall(rf"REF_DATA_{way}\[(\d+),(\d+)\]=(\S+)", text)}
        rows, columns = (max(key[k] for key in cells) for k in range(2))
        found.append(np.array([[cells[i + 1, j + 1] for j in range(columns)] for i in range(rows)]))
    return found[0], found[1]


def write_table(shared: Path, axis: str, path: Path) -> Path:
    """Write one axis's run as a measurement table, in the order in which it was measured; rounds are cycles."""
    targets, below, above = readings(shared, axis)
    lines = ["X_mm,approach_X,target,carrier,x_mm,y_mm,z_mm,round,time_s"]
    time = 0.0
    for cycle in range(below.shape[1]):
        for side, order in ((1, range(len(targets))), (-1, range(len(targets) - 1, -1, -1))):
            for k, i in enumerate(order):
                time += TURN_S if k == 0 else STEP_S
                read = (below if side == 1 else above)[i, cycle]
                lines.append(f"{targets[i]},{side},slide,tool,{read},,,{cycle + 1},{time - TURN_S:.1f}")
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path


def _table(text: str, heading: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the other columns of the table below a heading, without the row numbers."""
    body = text.split(f"### {heading}")[1].split("\n#")[0]
    rows = [[float(cell) for cell in line.split("|")[1:] if cell] for line in body.splitlines() if line[:1].isdigit()]
    table = np.array(rows)
    return table[:, 0], table[:, 1:]
