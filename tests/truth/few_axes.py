"""Machines that are not five-axis mills: a drill of two axes, a saw with two parallel axes, a robot of six joints, a stage."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from tests.real import write_both

_DRILL: Final = """<?xml version="1.0"?>
<!-- The table moves along x under a quill that moves along z; metres. -->
<robot name="drill">
  <link name="bed"/>
  <joint name="x_joint" type="prismatic">
    <parent link="bed"/><child link="table"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3" effort="0" velocity="1"/>
  </joint>
  <link name="table"/>
  <joint name="z_joint" type="prismatic">
    <parent link="bed"/><child link="quill"/><origin xyz="0.15 0 0.2"/>
    <axis xyz="0 0 1"/><limit lower="-0.2" upper="0" effort="0" velocity="1"/>
  </joint>
  <link name="quill"/>
</robot>
"""
_DRILL_FILE: Final = """schema: twin.machine/1
name: drill
urdf: drill.urdf
axes:
  - {name: X, joint: x_joint, kind: linear, range: [0, 300], increment: 0.001}
  - {name: Z, joint: z_joint, kind: linear, range: [-200, 0], increment: 0.001}
frames: {tool: quill, work: table}
"""
_STAGE: Final = """<?xml version="1.0"?>
<!-- One slide on a bed; metres. -->
<robot name="stage">
  <link name="bed"/>
  <joint name="x_joint" type="prismatic">
    <parent link="bed"/><child link="slide"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.5" effort="0" velocity="1"/>
  </joint>
  <link name="slide"/>
</robot>
"""
_STAGE_FILE: Final = """schema: twin.machine/1
name: stage
urdf: stage.urdf
axes:
  - {name: X, joint: x_joint, kind: linear, range: [0, 500], increment: 0.001}
frames: {tool: slide, work: bed}
"""


def write_stage(folder: Path) -> Path:
    """Write URDF and machine file of a slide of 500 mm into ``folder``."""
    return write_both(folder, "stage", _STAGE, _STAGE_FILE)


def write_drill(folder: Path, *, second: str = "0 0 1") -> Path:
    """Write URDF and machine file into ``folder``; the quill's axis may be rotated."""
    return write_both(folder, "drill", _DRILL.replace("0 0 1", second), _DRILL_FILE)


def write_robot(folder: Path, joints: int = 6, reach_deg: float = 360.0) -> Path:
    """Write a chain of revolute joints, 0.3 m apart, about z and y in turn."""
    links, axes = ['<link name="l0"/>'], []
    for i in range(1, joints + 1):
        about = "0 0 1" if i % 2 else "0 1 0"
        links.append(
            f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="0.05 0 0.3"/>'
            f'<axis xyz="{about}"/><limit lower="-6.3" upper="6.3" effort="0" velocity="1"/></joint><link name="l{i}"/>'
        )
        rpy = "" if i % 2 else ", error_frame_rpy_deg: [-90, 0, 0]"
        axes.append(
            f"  - {{name: J{i}, joint: j{i}, kind: rotary, range: [{-reach_deg}, {reach_deg}], increment: 0.001{rpy}}}\n"
        )
    urdf = f'<?xml version="1.0"?>\n<robot name="arm">{"".join(links)}</robot>\n'
    file = f"schema: twin.machine/1\nname: arm\nurdf: arm.urdf\naxes:\n{''.join(axes)}frames: {{tool: l{joints}, work: l0}}\n"
    return write_both(folder, "arm", urdf, file)
