"""The drilling machine of `../shared/data/real/plates`: URDF, machine file, and the holes of one plate as a measurement table.

The holes were drilled at their nominal places and measured on a coordinate measuring machine. A hole is where the drill's axis actually
was at the nominal position of the control. So the drill is the target, on the tool side, at the tool frame's origin; the plate is
the workpiece, at rest in the base frame; the coordinate measuring machine is a station of unknown pose. It measured x and y of each
hole: z stays empty.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from tests.real import write_both

PLATE: Final = "D1597A_redrilled_meas_2011"
U_MM: Final = 0.0037
"""Standard uncertainty of a coordinate. Not stated for the machine; this is the residual of the source's fit, 5.2 µm in the plane,
per coordinate.
"""
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
    """Write URDF and machine file into ``folder``."""
    return write_both(folder, "plate_drill", _URDF, _MACHINE)


def holes_mm(shared: Path) -> np.ndarray:
    """Return (n, 4) x and y as measured, X and Y as nominal, mm."""
    return np.loadtxt(shared / PLATE, skiprows=4)[:, :4]


def write_table(holes: np.ndarray, path: Path) -> Path:
    """Write the holes as a measurement table: nominal positions as commands, measured ones as points."""
    lines = ["X_mm,Y_mm,target,carrier,x_mm,y_mm,z_mm,u_x_mm,u_y_mm,place_x_mm,place_y_mm,place_z_mm"]
    lines += [f"{X},{Y},drill,tool,{x},{y},,{U_MM},{U_MM},0,0,0" for x, y, X, Y in holes]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path
