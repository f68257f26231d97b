"""Names of a machine's errors from the bare files are those of the checked machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin._common.bundled import bundled_folder
from twin._common.errors import InputError
from twin.machine.error_names import NamedAxis, axes_of, component_names, location_names, squareness_names
from twin.machine.machine import Machine

MACHINES = sorted(path for path in bundled_folder().glob("*.yaml") if path.name.count(".") == 1)
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
TURNED = """
schema: twin.machine/1
name: inclined
urdf: inclined.urdf
axes:
  - {name: V, joint: v, kind: linear, range: [0, 100], increment: 0.001, error_frame_rpy_deg: [0, 0, 20]}
  - {name: W, joint: w, kind: linear, range: [0, 100], increment: 0.001}
  - {name: A, joint: a, kind: rotary, range: [-30, 30], increment: 0.001, error_frame_rpy_deg: [10, -20, 30]}
frames: {tool: head, work: base}
"""
URDF = """<robot name="inclined"><link name="base"/><link name="slide"/><link name="plate"/><link name="arm"/><link name="head"/>
<joint name="v" type="prismatic"><parent link="base"/><child link="slide"/><origin xyz="0 0 1" rpy="0.1 -0.2 0.3"/>
<axis xyz="0.2 1 0"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
<joint name="f" type="fixed"><parent link="slide"/><child link="plate"/><origin rpy="-0.3 0.1 0.2"/></joint>
<joint name="w" type="prismatic"><parent link="plate"/><child link="arm"/>
<limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
<joint name="a" type="revolute"><parent link="arm"/><child link="head"/><origin rpy="0.4 0.5 -0.6"/><axis xyz="1 2 9"/>
<limit lower="-0.6" upper="0.6" effort="1" velocity="1"/></joint></robot>"""


def _agree(path: Path) -> None:
    machine, axes = Machine.load(path), axes_of(path)
    assert [axis.name for axis in axes] == list(machine.names)
    assert tuple(name for axis in axes for name in component_names(axis.name)) == machine.motion_names
    assert location_names(axes) == machine.location_names
    assert squareness_names(axes) == machine.squareness_names
    for found, axis in zip(axes, machine.axes, strict=True):
        assert found.linear == axis.linear
        np.testing.assert_allclose(found.direction, axis.direction, atol=1e-12)
        np.testing.assert_allclose(found.machine_direction, axis.machine_direction, atol=1e-12)


@pytest.mark.parametrize("path", MACHINES, ids=lambda path: path.stem)
def test_bundled_machines(path: Path) -> None:
    _agree(path)


def test_inclined_axes_and_turned_error_frames(tmp_path: Path) -> None:
    (tmp_path / "inclined.urdf").write_text(URDF)
    (tmp_path / "inclined.yaml").write_text(TURNED)
    _agree(tmp_path / "inclined.yaml")


def test_names_of_squareness_and_locations() -> None:
    """The first axis that is not parallel to the datum axis has one squareness, every other one two."""
    linear = [NamedAxis(name, True, one, one) for name, one in (("X", X), ("U", X), ("Y", Y), ("Z", Z))]
    assert squareness_names(linear) == ("E_B0U", "E_C0U", "E_C0Y", "E_A0Z", "E_B0Z")
    assert squareness_names(linear[:1]) == () and location_names(linear) == ()
    assert location_names([NamedAxis("B", False, Y, Y)]) == ("E_X0B", "E_Z0B", "E_A0B", "E_C0B")
    assert component_names("X")[3] == "E_AX" and component_names("C", average=True)[5] == "E_C0C"


@pytest.mark.parametrize("text", ["", "axes: 3", "urdf: none.urdf\naxes: []", "{", "urdf: a.urdf\naxes: [{joint: x}]"])
def test_what_is_not_a_machine_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text)
    (tmp_path / "a.urdf").write_text("<robot/>")
    with pytest.raises(InputError):
        axes_of(tmp_path / "a.yaml")
