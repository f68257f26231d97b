"""Linear axes with rotated joint frames in the URDF: names of their errors, and the effect of a squareness error."""

from __future__ import annotations

import math
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin
import pytest

from tests.real import write_both
from twin import cli
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics

MM_TOLERANCE = 1e-9  # contract: largest difference of two formulations of the chain
FRAMES = {"x": ("0 0 0", "1 0 0"), "y": ("0 0 0", "0 1 0"), "z": ("0 0 0", "0 0 1")}


def write_mill(
    folder: Path,
    turned: dict[str, tuple[str, str]] | None = None,
    *,
    base_rpy: str = "0 0 0",
    entries: dict[str, str] | None = None,
    further: str = "",
    axes: str = "",
) -> Path:
    """Write a mill of three stacked axes; some joints with another frame (rpy) and axis vector, or another entry in the file."""
    frames = FRAMES | (turned or {})
    joints, below = "", "floor"
    for name, (rpy, axis) in frames.items():
        joints += (
            f'  <joint name="{name}_joint" type="prismatic"><parent link="{below}"/><child link="{name}"/>\n'
            f'    <origin rpy="{rpy}"/><axis xyz="{axis}"/><limit lower="0" upper="1" effort="0" velocity="1"/></joint>\n'
            f'  <link name="{name}"/>\n'
        )
        # The next joint's frame is parallel to the base again.
        back = pin.rpy.rpyToMatrix(*map(float, rpy.split())).T
        undo = " ".join(f"{angle:.17g}" for angle in pin.rpy.matrixToRpy(back))
        joints += (
            f'  <joint name="{name}_end" type="fixed"><parent link="{name}"/><child link="{name}_slide"/>'
            f'<origin rpy="{undo}"/></joint><link name="{name}_slide"/>\n'
        )
        below = f"{name}_slide"
    urdf = (
        f'<robot name="mill"><link name="base"/>\n<joint name="floor_joint" type="fixed"><parent link="base"/>'
        f'<child link="floor"/><origin rpy="{base_rpy}"/></joint><link name="floor"/>\n{joints}{further}</robot>\n'
    )
    lines = "".join(
        f"  - {{name: {name.upper()}, joint: {name}_joint, kind: linear, range: [0, 400], increment: 0.001"
        f"{(entries or {}).get(name, '')}}}\n"
        for name in frames
    )
    file = f"schema: twin.machine/1\nname: mill\nurdf: mill.urdf\naxes:\n{lines}{axes}frames: {{tool: {below}, work: floor}}\n"
    return write_both(folder, "mill", urdf, file)


def with_squareness(machine: Machine, **angles_urad: float) -> Kinematics:
    empty: MappingProxyType[str, float] = MappingProxyType({})
    calibration = Calibration(machine, "a test", MappingProxyType({}), MappingProxyType(angles_urad), empty)
    return Kinematics(machine, calibration)


def check_against_the_contract(machine: Machine) -> None:
    """Check contract §1: E_XY −= y·E_C0Y, E_XZ += z·E_B0Z, E_YZ −= z·E_A0Z; by formula and by Pinocchio's recursion."""
    x, y, z = 120.0, 250.0, 310.0
    assert set(machine.squareness_names) == {"E_C0Y", "E_A0Z", "E_B0Z"}
    real = with_squareness(machine, E_C0Y=20.0, E_B0Z=30.0, E_A0Z=-50.0)
    expected = np.array([x - y * 20e-6 + z * 30e-6, y + z * 50e-6, z])
    point = real.forward([[x, y, z]]).point_mm[0]
    assert np.abs(point - expected).max() < MM_TOLERANCE
    data = machine.model.createData()
    q = np.array([x, y, z]) * machine.scale
    errors = real.error_frames(np.array([[x, y, z]]))[0]
    pin.framesForwardKinematics(machine.model, data, machine.configuration(q, errors))
    seen = data.oMf[machine.work_frame].actInv(data.oMf[machine.tool_frame]).translation * 1e3
    assert np.abs(seen - expected).max() < MM_TOLERANCE


def leaning(about: int, angle: float, along: int) -> tuple[str, str]:
    """Return a frame inclined about x, y or z of the base, and the vector in it that points along the base's x, y or z."""
    rpy = np.zeros(3)
    rpy[about] = angle
    vector = pin.rpy.rpyToMatrix(rpy).T[:, along]
    return " ".join(f"{v:.17g}" for v in rpy), " ".join(f"{v:.17g}" for v in vector)


def test_upright(tmp_path: Path) -> None:
    check_against_the_contract(Machine.load(write_mill(tmp_path)))


@pytest.mark.parametrize("angle", [0.5, -0.7])
@pytest.mark.parametrize(("axis", "about", "along"), [("y", 0, 1), ("y", 2, 1), ("z", 0, 2), ("z", 1, 2)])
def test_squareness_refers_to_the_machine_directions_with_an_inclined_frame(
    tmp_path: Path, axis: str, about: int, along: int, angle: float
) -> None:
    check_against_the_contract(Machine.load(write_mill(tmp_path, {axis: leaning(about, angle, along)})))


@pytest.mark.parametrize(
    ("axis", "rpy", "vector", "remedy"),
    [
        ("y", "0 0 1.5708", "1 0 0", "error_frame_rpy_deg: [0, 0, -90.0002]"),
        ("y", f"0 0 {math.pi!r}", "0 -1 0", "180]"),  # its straightness would have the other sign
        ("x", "0 0 1.5707963267948966", "0 -1 0", "error_frame_rpy_deg: [0, 0, -90]"),
        ("z", "0 1.5707963267948966 0", "-1 0 0", "error_frame_rpy_deg: [0, -90, 0]"),
    ],
)
def test_a_rotated_frame_is_refused_and_the_remedy_works(
    tmp_path: Path, axis: str, rpy: str, vector: str, remedy: str
) -> None:
    """Otherwise E_XY would act along y, and the squareness of Y would have another name and no effect."""
    with pytest.raises(InputError, match="is turned") as caught:
        Machine.load(write_mill(tmp_path, {axis: (rpy, vector)}))
    assert remedy in caught.value.expected
    assert caught.value.line == 5 + "xyz".index(axis) and caught.value.value == f"{axis}_joint"
    entry = ", " + caught.value.expected.split(" for this axis")[0]
    machine = Machine.load(write_mill(tmp_path, {axis: (rpy, vector)}, entries={axis: entry}))
    if rpy != "0 0 1.5708":  # right angle with four digits: the axis itself is inclined by 4 µrad
        check_against_the_contract(machine)
    assert set(machine.squareness_names) == {"E_C0Y", "E_A0Z", "E_B0Z"}


@pytest.mark.parametrize("rpy", ["0 0 1.5707963267948966", "1.5707963267948966 0 0", "0.3 0.2 0.1"])
def test_a_machine_whose_frames_are_all_rotated_equally(tmp_path: Path, rpy: str) -> None:
    """The orientation of the base link then has no influence: the first linear axis's frame is the machine frame."""
    check_against_the_contract(Machine.load(write_mill(tmp_path, base_rpy=rpy)))


def test_an_axis_parallel_to_the_datum_axis_has_two_squareness_errors(tmp_path: Path) -> None:
    machine = Machine.load(write_mill(tmp_path, {"y": ("0 0 0", "1 0 0")}))
    assert machine.squareness_names == ("E_B0Y", "E_C0Y", "E_B0Z")
    real = with_squareness(machine, E_C0Y=20.0, E_B0Y=10.0)
    point = real.forward([[0.0, 200.0, 0.0]]).point_mm[0]
    assert point == pytest.approx([200.0, 200.0 * 20e-6, -200.0 * 10e-6], abs=MM_TOLERANCE)


def test_an_axis_that_carries_neither_tool_nor_work(tmp_path: Path) -> None:
    joint = (
        '<joint name="w_joint" type="prismatic"><parent link="floor"/><child link="w"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="1" effort="0" velocity="1"/></joint><link name="w"/>'
    )
    axis = "  - {name: W, joint: w_joint, kind: linear, range: [0, 100], increment: 0.001}\n"
    with pytest.raises(InputError, match="axis W carries neither the tool nor the work") as caught:
        Machine.load(write_mill(tmp_path, further=joint, axes=axis))
    assert caught.value.line == 8 and "z_slide or floor" in caught.value.expected


def test_a_joint_used_by_two_axes_is_refused(tmp_path: Path) -> None:
    path = write_mill(tmp_path)
    path.write_text(path.read_text().replace("z_joint", "y_joint"))
    with pytest.raises(InputError, match="duplicate joint") as caught:
        Machine.load(path)
    assert caught.value.line == 7


@pytest.mark.parametrize(
    ("old", "new"),
    [("[0, 400]", "[0, 1e300]"), ("0.001", "1e300"), ("tool: z_slide", "tool: z_slide, origin: {X: 1e200}")],
)
def test_implausibly_large_numbers_are_refused(tmp_path: Path, old: str, new: str) -> None:
    path = write_mill(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match="number too large"):
        Machine.load(path)


@pytest.mark.parametrize("length", [-0.001, -120.0, 5000.001, 1e300, math.inf, math.nan])
def test_an_implausible_tool_length_is_refused(tmp_path: Path, length: float) -> None:
    machine = Machine.load(write_mill(tmp_path))
    with pytest.raises(InputError, match="tool length out of range"):
        Kinematics(machine, Calibration.zero(machine), tool_length_mm=length)


@pytest.mark.parametrize("length", ["-5", "6000", ".inf"])
def test_an_implausible_tool_length_in_the_machine_file_is_refused(tmp_path: Path, length: str) -> None:
    path = write_mill(tmp_path)
    path.write_text(path.read_text() + f"programs: {{tool_length: {length}}}\n")
    with pytest.raises(InputError, match=r"programs\.tool_length") as caught:
        Machine.load(path)
    assert caught.value.line == 9


@pytest.mark.parametrize(
    "words",
    [
        ("compensate", "cone_frustum.nc", "-o", "out.nc"),
        ("path", "cone_frustum.nc", "-o", "out.nc"),
        ("scene", "cone_frustum.nc", "-o", "out.html"),
        ("report", "-o", "out.html"),
        ("control", "--to", "grid", "-o", "out"),
        ("plan", "-o", "out.csv"),
        ("volume", "--trials", "10"),
        ("info",),
    ],
    ids=lambda words: words[0],
)
def test_no_command_takes_a_negative_tool_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        cli.main([*words, "--tool-length", "-120"])
    assert ended.value.code == 2
    assert "tool length out of range: '-120.0'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
