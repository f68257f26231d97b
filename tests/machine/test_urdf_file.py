"""Invalid or hostile URDF files: refused with file and line before Pinocchio reads them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.truth import few_axes
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.machine.machine_file import MAX_BYTES, MAX_LINKS, MAX_MOVING_JOINTS
from twin.planning.clearance import machine_shapes
from twin.tool.forward import Kinematics

QUILL = '<link name="quill"/>'
INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'


def chain(links: int, kind: str = "fixed") -> str:
    """Return a chain with the given number of links."""
    motion = '<axis xyz="1 0 0"/><limit lower="0" upper="1" effort="0" velocity="1"/>'
    joints = (
        f'<joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/><child link="l{i}"/>{motion}</joint><link name="l{i}"/>'
        for i in range(1, links)
    )
    return f'<robot name="chain"><link name="l0"/>{"".join(joints)}</robot>'


def changed(folder: Path, old: str, new: str) -> tuple[Path, int]:
    """Write the drill's machine file with a change in its URDF; return its path and the line of the change."""
    path = few_axes.write_drill(folder)
    urdf = path.with_suffix(".urdf")
    text = urdf.read_text()
    assert text.count(old) == 1
    urdf.write_text(text.replace(old, new))
    return path, text[: text.index(old)].count("\n") + 1


@pytest.mark.parametrize(
    ("old", "new", "what", "expected"),
    [
        ('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>', "<axis", "a unit vector"),
        ('<axis xyz="1 0 0"/>', '<axis xyz="1e-300 0 0"/>', "<axis", "a unit vector"),
        ('<axis xyz="1 0 0"/>', '<axis xyz="1e300 1e300 0"/>', "<axis", "a unit vector"),
        ('<axis xyz="1 0 0"/>', '<axis xyz="nan 0 0"/>', "<axis", "3 numbers"),
        ('<axis xyz="1 0 0"/>', '<axis xyz="1 0"/>', "<axis", "3 numbers"),
        ('xyz="0.15 0 0.2"', 'xyz="0.15 inf 0.2"', "<origin", "3 numbers"),
        ('xyz="0.15 0 0.2"', 'xyz="0.15 1e400 0.2"', "<origin", "finite"),
        ('xyz="0.15 0 0.2"', 'xyz="0.15 1e300 0.2"', "<origin", "at most 1000"),
        (
            QUILL,
            f'<link name="quill"><inertial><mass value="-1"/>{INERTIA}</inertial></link>',
            "<mass",
            "zero or more",
        ),
        (QUILL, f'<link name="quill"><inertial><mass value="nan"/>{INERTIA}</inertial></link>', "<mass", "a number"),
        (
            QUILL,
            f'<link name="quill"><inertial><mass value="9"/><origin xyz="0 52 0"/>{INERTIA}</inertial></link>',
            "the centre of mass of quill is 52 m away",
            "metres, within",
        ),
        (
            QUILL,
            '<link name="quill"><inertial><mass value="9"/></inertial></link>',
            "<inertial> is not complete",
            "<inertia>",
        ),
        (
            QUILL,
            '<link name="quill"><visual><geometry/></visual></link>',
            "<geometry> is not complete",
            "a shape",
        ),
        (
            QUILL,
            '<link name="quill"><collision><geometry><sphere radius="-1"/></geometry></collision></link>',
            "<sphere",
            "zero or more",
        ),
        (QUILL, QUILL + QUILL, "duplicate link", "every name once"),
        (QUILL, '<link name=""/>', "a link without a name", "every name once"),
        ('name="z_joint"', 'name="x_joint"', "duplicate joint", "every name once"),
        ('<child link="quill"/>', '<child link="quil"/>', "no such link", "names a link"),
        ('<child link="quill"/>', "", "joint z_joint has no child link", "names a link"),
        (
            QUILL,
            f'{QUILL}<joint name="c" type="fixed"><parent link="quill"/><child link="bed"/></joint>',
            "joints that form a loop",
            "a tree",
        ),
        (
            QUILL,
            f'{QUILL}<joint name="c" type="fixed"><parent link="table"/><child link="quill"/></joint>',
            "a link carried by two joints",
            "one joint per link",
        ),
        (
            QUILL,
            f'{QUILL}<link name="p"/><joint name="f" type="floating"><parent link="quill"/><child link="p"/></joint>',
            "an unsupported type",
            "prismatic, revolute, continuous, fixed",
        ),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="x_joint"/>', "follows another", "independently"),
        ('<limit lower="-0.2" upper="0" effort="0" velocity="1"/>', "", "without <limit>", "<limit lower"),
        (' upper="0" effort="0" velocity="1"/>', ' upper="0"/>', "<limit> is not complete", 'effort="…"'),
        ("<robot", "<!DOCTYPE robot [<!ENTITY a 'b'>]><robot", "document type declaration", "XML without"),
        (QUILL, "<a>" * 100_000 + "</a>" * 100_000, "nested too deeply", "levels"),
    ],
)
def test_an_invalid_urdf_is_refused_with_its_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, what: str, expected: str
) -> None:
    path, line = changed(tmp_path, old, new)
    with pytest.raises(InputError) as caught:
        Machine.load(path)
    assert what in caught.value.what and expected in caught.value.expected
    assert caught.value.file == str(path.with_suffix(".urdf"))
    # An error of a joint may be reported at the joint, two lines above its axis.
    assert caught.value.line is not None and line - 2 <= caught.value.line <= line
    assert capfd.readouterr().err == ""  # Pinocchio's reader, which would write there, was not called


def test_links_that_no_joint_connects(tmp_path: Path) -> None:
    path, _ = changed(tmp_path, QUILL, QUILL + '<link name="lost"/>')
    with pytest.raises(InputError, match="no joint connects") as caught:
        Machine.load(path)
    assert caught.value.value == "bed, lost"


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b" \n",
        b"<!-- nothing -->",
        bytes(range(256)),
        "<robot/>".encode("utf-16"),
        b"<robot/>",
        b"<robot>\0</robot>",
    ],
)
def test_a_file_that_is_not_a_urdf(tmp_path: Path, raw: bytes) -> None:
    path = few_axes.write_drill(tmp_path)
    path.with_suffix(".urdf").write_bytes(raw)
    with pytest.raises(InputError) as caught:
        Machine.load(path)
    assert caught.value.file == str(path.with_suffix(".urdf"))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (chain(MAX_LINKS + 1), "too many links"),
        (chain(MAX_MOVING_JOINTS + 2, "prismatic"), "too many moving joints"),
        ("<robot>" + " " * MAX_BYTES + "</robot>", "too large"),
    ],
)
def test_a_urdf_beyond_the_size_limits(tmp_path: Path, text: str, what: str) -> None:
    path = few_axes.write_drill(tmp_path)
    path.with_suffix(".urdf").write_text(text)
    with pytest.raises(InputError, match=what):
        Machine.load(path)


def test_20_000_links_do_not_end_the_process(tmp_path: Path) -> None:
    """Runs in a separate process: the reader of Pinocchio would overflow the stack of this one."""
    path = few_axes.write_drill(tmp_path)
    path.with_suffix(".urdf").write_text(chain(20_001))
    code = f"from twin.machine.machine import Machine; Machine.load({str(path)!r})"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)
    assert ended.returncode == 1 and "too many links" in ended.stderr.splitlines()[-1]


def test_a_chain_at_the_size_limits_is_read(tmp_path: Path) -> None:
    path = few_axes.write_drill(tmp_path)
    path.with_suffix(".urdf").write_text(chain(MAX_MOVING_JOINTS + 1, "prismatic"))
    text = path.read_text().replace("x_joint", "j1").replace("z_joint", f"j{MAX_MOVING_JOINTS}")
    path.write_text(text.replace("quill", f"l{MAX_MOVING_JOINTS}").replace("table", "l0"))
    machine = Machine.load(path)
    assert Kinematics(machine).forward([[100.0, -50.0]]).point_mm[0] == pytest.approx([50.0, 0.0, 0.0])


def test_a_missing_mesh(tmp_path: Path) -> None:
    """A missing mesh matters only if shapes are needed, not for a compensation."""
    mesh = '<link name="quill"><visual><geometry><mesh filename="none.stl"/></geometry></visual></link>'
    machine = Machine.load(changed(tmp_path, QUILL, mesh)[0])
    with pytest.raises(InputError, match=r"none\.stl"):
        machine_shapes(machine)


def test_a_fixed_joint_may_have_the_name_of_a_link(tmp_path: Path) -> None:
    more = f'{QUILL}<link name="p"/><joint name="quill" type="fixed"><parent link="quill"/><child link="p"/></joint>'
    assert Machine.load(changed(tmp_path, QUILL, more)[0]).names == ("X", "Z")


def test_joints_with_the_names_of_error_frames(tmp_path: Path) -> None:
    more = f'{QUILL}<link name="p"/><joint name="z_joint:error" type="continuous"><parent link="quill"/><child link="p"/></joint>'
    with pytest.raises(InputError, match="z_joint:error") as caught:
        Machine.load(changed(tmp_path, QUILL, more)[0])
    assert caught.value.line == 6


@pytest.mark.parametrize("name", ["a" * 5000, ".", "loop"])
def test_a_urdf_path_that_is_not_a_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    path = few_axes.write_drill(tmp_path)
    path.write_text(path.read_text().replace("drill.urdf", name))
    with pytest.raises(InputError, match="no such URDF") as caught:
        Machine.load(path)
    assert caught.value.line == 3


def test_a_machine_with_an_impossible_name() -> None:
    for name in ("a" * 5000, "a\0b"):
        with pytest.raises(InputError, match="not found"):
            Machine.load(name)
