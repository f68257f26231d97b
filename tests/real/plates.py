"""The drilling machine of `../shared/data/real/plates`: URDF, machine file, and the holes of one plate as a measurement table.

The holes were drilled at their nominal places and read on a coordinate measuring machine. A hole lies where the drill's axis really was
when the control thought it at the nominal place: so the drill is the target, on the tool side, at the tool frame's origin; the plate is
the work and at rest in the base frame; the coordinate measuring machine is a station whose place and turn nobody knows. It read x and y
of each hole: z stays empty.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from tests.real import write_both

PLATE: Final = "D1597A_redrilled_meas_2011"
U_MM: Final = 0.0037
"""Standard uncertainty of a coordinate. Nobody states the machine's; this is what the source's own fit leaves, 5.2 µm in the plane, a
coordinate."""
_URDF: Final = """<?xml version="1.0"?>
<!-- A drilling machine of two axes in a plane; metres. The lengths of a chain that only translates are immaterial. -->
<robot name="plate_drill">
  <link name="table"/>
  <joint name="x_joint" type="prismatic">
    <parent link="table"/><child link="x_slide"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="0" velocity="0.1"/>
  </joint>
  <link name="x_slide"/>
  <joint name="y_joint" type="prismatic">
    <parent link="x_slide"/><child link="drill"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="0" velocity="0.1"/>
  </joint>
  <link name="drill"/>
</robot>
"""
_MACHINE: Final = """schema: twin.machine/1
name: plate drill
urdf: plate_drill.urdf
axes:  # the ranges hold all holes
  - {name: X, joint: x_joint, kind: linear, range: [-320, 320], increment: 0.001}
  - {name: Y, joint: y_joint, kind: linear, range: [-260, 260], increment: 0.001}
frames: {tool: drill, work: table}
"""


def write_machine(folder: Path) -> Path:
    """URDF and machine file in ``folder``."""
    return write_both(folder, "plate_drill", _URDF, _MACHINE)


def holes_mm(shared: Path) -> np.ndarray:
    """(n, 4) x and y as read, X and Y as meant, mm."""
    return np.loadtxt(shared / PLATE, skiprows=4)[:, :4]


def write_table(holes: np.ndarray, path: Path) -> Path:
    """Holes as a measurement table: what was meant as commands, what was read as points."""
    lines = ["X_mm,Y_mm,target,carrier,x_mm,y_mm,z_mm,u_x_mm,u_y_mm,place_x_mm,place_y_mm,place_z_mm"]
    lines += [f"{X},{Y},drill,tool,{x},{y},,{U_MM},{U_MM},0,0,0" for x, y, X, Y in holes]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path
