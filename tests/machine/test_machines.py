"""The machines that come with `twin`, and refusal of invalid machine files."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import coal
import numpy as np
import pinocchio as pin
import pytest

from twin._common.bundled import bundled_folder
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.tool.forward import Kinematics

BUNDLED = ("dmu50", "trunnion_ac", "xyzbc_trunnion")
MM_TOLERANCE = 1e-9  # contract: largest difference of two formulations of the chain


@pytest.fixture(scope="module", params=BUNDLED)
def machine(request: pytest.FixtureRequest) -> Machine:
    return Machine.load(str(request.param))


def zeroed(machine: Machine, length: float = 0.0) -> Kinematics:
    return Kinematics(machine, Calibration.zero(machine), tool_length_mm=length)


def origin(machine: Machine) -> np.ndarray:
    """Return the axis positions of `frames.origin`, read without `twin`'s reader; rotary axes at zero."""
    entries = re.search(r"^\s*origin: \{(.*)\}", machine.path.read_text(), re.MULTILINE)
    found = dict(re.findall(r"(\w+): (-?\d+)", entries[1])) if entries else {}
    return np.array([float(found.get(axis.name, 0)) for axis in machine.axes])


def random_commands(machine: Machine, count: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    lower = [-540.0 if axis.lower is None else axis.lower for axis in machine.axes]
    upper = [540.0 if axis.upper is None else axis.upper for axis in machine.axes]
    return rng.uniform(lower, upper, (count, len(machine.axes)))


def test_every_machine_file_is_tested() -> None:
    files = {file.stem for file in bundled_folder().glob("*.yaml") if file.name.count(".") == 1}
    assert files == set(BUNDLED)


def test_at_its_origin_the_tool_frame_is_the_work_frame(machine: Machine) -> None:
    pose = zeroed(machine).forward(origin(machine))
    assert np.abs(pose.point_mm).max() < MM_TOLERANCE
    assert np.abs(pose.rotation[0] - np.eye(3)).max() < 1e-12


@pytest.mark.parametrize("axis", "XYZ")
@pytest.mark.parametrize("step", [-30.0, 12.5, 80.0])
def test_a_linear_command_moves_the_tool_in_its_direction(machine: Machine, axis: str, step: float) -> None:
    """The motion is relative to the workpiece, whether the axis carries the tool or the workpiece."""
    command = origin(machine)
    command[machine.names.index(axis)] += step
    expected = step * np.eye(3)["XYZ".index(axis)]
    assert np.abs(zeroed(machine).forward(command).point_mm[0] - expected).max() < MM_TOLERANCE


@pytest.mark.parametrize("name", BUNDLED)
def test_c_turns_the_tool_in_the_positive_direction_about_the_workpiece(name: str) -> None:
    machine = Machine.load(name)
    command = origin(machine)
    command[machine.names.index("X")] += 100.0
    command[machine.names.index("C")] = 90.0
    assert zeroed(machine).forward(command).point_mm[0] == pytest.approx([0.0, 100.0, 0.0], abs=MM_TOLERANCE)


def test_ranges() -> None:
    ranges = {name: [(a.name, a.lower, a.upper, a.side) for a in Machine.load(name).axes] for name in BUNDLED}
    assert ranges == {
        "dmu50": [
            ("X", 0, 500, "tool"),
            ("Y", 0, 450, "tool"),
            ("Z", -400, 0, "tool"),
            ("B", 0, 180, "work"),
            ("C", None, None, "work"),
        ],
        "trunnion_ac": [
            ("X", 0, 600, "tool"),
            ("Y", 0, 500, "work"),
            ("Z", -450, 0, "tool"),
            ("A", -120, 30, "work"),
            ("C", None, None, "work"),
        ],
        "xyzbc_trunnion": [
            ("X", -300, 300, "tool"),
            ("Y", -300, 300, "tool"),
            ("Z", -100, 500, "tool"),
            ("B", -110, 110, "work"),
            ("C", None, None, "work"),
        ],
    }


def test_names_of_the_errors(machine: Machine) -> None:
    """Six error motions per axis, three squareness errors, four locations per rotary axis, perpendicular to it (ISO 230-1)."""
    assert len(machine.motion_names) == len(set(machine.motion_names)) == 30
    assert set(machine.squareness_names) == {"E_C0Y", "E_A0Z", "E_B0Z"}
    tilting = next(axis.name for axis in machine.axes if not axis.linear and axis.name != "C")
    # B of the DMU is inclined: names refer to its own frame, whose z is the axis.
    across = {"dmu50": "XYAB", "trunnion_ac": "YZBC", "xyzbc_trunnion": "XZAC"}[machine.path.stem]
    assert set(machine.location_names) == {f"E_{d}0{tilting}" for d in across} | {f"E_{d}0C" for d in "XYAB"}


def trunnion_ac(q: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return point (mm) and tool axis in the workpiece, which turns about -x, 60 mm above the table, then about -z; by formula."""
    x, y, z, a, c = q.T * np.array([1, 1, 1, np.pi / 180, np.pi / 180])[:, None]
    u, v, w = x - 300, y - 250, z + 450 - length - 60
    across, up = v * np.cos(a) - w * np.sin(a), v * np.sin(a) + w * np.cos(a) + 60
    point = np.column_stack([u * np.cos(c) - across * np.sin(c), u * np.sin(c) + across * np.cos(c), up])
    return point, np.column_stack([np.sin(a) * np.sin(c), -np.sin(a) * np.cos(c), np.cos(a)])


def xyzbc_trunnion(q: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the same for a rotation about -y, 40 mm above the table."""
    x, y, z, b, c = q.T * np.array([1, 1, 1, np.pi / 180, np.pi / 180])[:, None]
    w = z - length - 40
    across, up = x * np.cos(b) + w * np.sin(b), -x * np.sin(b) + w * np.cos(b) + 40
    point = np.column_stack([across * np.cos(c) - y * np.sin(c), across * np.sin(c) + y * np.cos(c), up])
    return point, np.column_stack([np.sin(b) * np.cos(c), np.sin(b) * np.sin(c), np.cos(b)])


@pytest.mark.parametrize("by_hand", [trunnion_ac, xyzbc_trunnion])
def test_closed_form(by_hand: Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]) -> None:
    machine = Machine.load(by_hand.__name__)
    q = random_commands(machine, 5000)
    poses = zeroed(machine, 87.5).forward(q)
    point, axis = by_hand(q, 87.5)
    assert np.abs(poses.point_mm - point).max() < MM_TOLERANCE
    assert np.abs(poses.axis - axis).max() < 1e-12


@pytest.mark.parametrize(("name", "axis", "along"), [("trunnion_ac", "A", "X"), ("xyzbc_trunnion", "B", "Y")])
def test_errors_of_a_tilting_axis_carry_the_directions_of_the_machine(name: str, axis: str, along: str) -> None:
    """The error frame has the machine's directions, unlike the joint frame: E_X., E_Y., E_Z. shift the workpiece along x, y, z."""
    machine = Machine.load(name)
    tilting = machine.by_name[axis]
    assert tilting.lower is not None and tilting.upper is not None
    for index, direction in enumerate("XYZ"):
        curve = Curve(f"E_{direction}{axis}", "um", (tilting.lower, tilting.upper), "power", (10.0,))
        calibration = Calibration(machine, "a shift", *(MappingProxyType(d) for d in ({curve.name: curve}, {}, {})))
        shift = Kinematics(machine, calibration).forward(origin(machine)).point_mm[0]
        assert shift == pytest.approx(-0.01 * np.eye(3)[index], abs=MM_TOLERANCE)
    assert tilting.direction == tuple(-np.eye(3)["XYZ".index(along)])


def gap_mm(machine: Machine, command: np.ndarray, moving: set[str], others: set[str]) -> tuple[float, str, str]:
    """Return the smallest distance between the shapes of two sets of links."""
    shapes = pin.buildGeomFromUrdf(machine.model, str(machine.urdf), pin.GeometryType.VISUAL).geometryObjects
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, machine.configuration(command * machine.scale))

    def placed(links: set[str]) -> list[tuple[str, object, coal.Transform3s]]:
        found = []
        for shape in shapes:
            if machine.model.frames[shape.parentFrame].name in links:
                pose = data.oMi[shape.parentJoint] * shape.placement
                found.append((shape.name, shape.geometry, coal.Transform3s(pose.rotation, pose.translation)))
        assert found
        return found

    fixed = placed(others)
    gaps = [
        (coal.distance(a, pa, b, pb, coal.DistanceRequest(), coal.DistanceResult()) * 1e3, one, two)
        for one, a, pa in placed(moving)
        for two, b, pb in fixed
    ]
    return min(gaps)


def test_the_table_does_not_collide_with_its_surroundings(machine: Machine) -> None:
    tilting = next(axis for axis in machine.axes if not axis.linear and axis.lower is not None)
    around = {"base", "x_slide"} | ({"y_table"} if machine.path.stem == "trunnion_ac" else set())
    for angle in np.linspace(tilting.lower, tilting.upper, 13):
        for command in (random_commands(machine, 1)[0], origin(machine)):
            command[machine.names.index(tilting.name)] = angle
            gap = gap_mm(machine, command, {"cradle", "table"}, around)
            assert gap[0] > 0.5, (angle, gap)


def test_slides_do_not_collide_with_the_bed(machine: Machine) -> None:
    moving = {"x_slide", "spindle"} | {
        str(machine.model.frames[i].name)
        for i in range(machine.model.nframes)
        if machine.model.frames[i].name in ("y_slide", "y_beam", "y_table")
    }
    lower, upper = np.array([(axis.lower, axis.upper) for axis in machine.axes[:3]]).T
    for corner in range(8):
        command = origin(machine)
        command[:3] = np.where([corner & 1, corner & 2, corner & 4], upper, lower)
        gap = gap_mm(machine, command, moving, {"base"})
        assert gap[0] > 0.5, (command, gap)


def test_masses_of_the_dmu50_are_plausible() -> None:
    """The masses determine gravity loads: slides of hundreds of kilograms, and no body with an impossible inertia."""
    model = Machine.load("dmu50").model
    masses = [inertia.mass for inertia in model.inertias if inertia.mass > 0]
    assert len(masses) == 5 and min(masses) > 50 and 1000 < sum(masses) < 3000
    for inertia in model.inertias:
        if inertia.mass > 0:
            moments = np.linalg.eigvalsh(inertia.inertia)
            assert moments[0] > 0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-12)


# ---- invalid machine files


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for suffix in (".yaml", ".urdf"):
        shutil.copy(bundled_folder() / f"trunnion_ac{suffix}", tmp_path)
    return tmp_path / "trunnion_ac.yaml"


@pytest.mark.parametrize(
    ("old", "new", "what", "expected"),
    [
        ("joint: a_joint", "joint: q_joint", "no such moving joint", "a_joint"),
        ("work: table ", "work: pallet ", "no such link", "table"),
        ("tool: spindle", "tool: nose", "no such link", "spindle"),
        (
            "joint: z_joint, kind: linear",
            "joint: z_joint, kind: rotary",
            "joint z_joint of the URDF slides",
            "kind: linear",
        ),
        ("joint: x_joint, kind: linear", "joint: x_joint, kind: hydraulic", "is invalid", "'linear' or 'rotary'"),
        (
            "joint: c_joint, kind: rotary",
            "joint: c_joint, kind: linear",
            "joint c_joint of the URDF turns",
            "kind: rotary",
        ),
        ("range: [0, 600]", "range: [600, 0]", "empty range", "lower < upper"),
        ("range: [0, 600]", "range: unlimited", "without limits", "[lower, upper] in mm"),
        ("range: [0, 600]", "range: [0, .nan]", "axes.0.range.1", "finite"),
        ("range: [0, 500], increment: 0.001", "range: [0, 500], increment: -1", "is invalid", "greater than 0"),
        ("name: Y,", "name: X,", "duplicate axis", "each axis once"),
        ("origin: {X: 300", "origin: {A: 300", "not a linear axis", "linear axes"),
        ("  tool: spindle ", "  tool: spindle\n  tool: spindle ", "duplicate key", "each key once"),
        ("schema: twin.machine/1", "schema: twin.machine/9", "wrong kind of file", "schema: twin.machine/1"),
        ("frames:", "colour: white\nframes:", "is invalid", ""),
        ("kind: linear, range: [0, 600]", "kind: linear range: [0, 600", "not YAML", "YAML"),
    ],
)
def test_an_invalid_machine_file_is_refused_with_its_line(
    copy: Path, old: str, new: str, what: str, expected: str
) -> None:
    text = copy.read_text()
    assert text.count(old) == 1
    copy.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        Machine.load(copy)
    assert caught.value.file == str(copy)
    changed = text[: text.index(old)].count("\n") + 1 + new.count("\n")
    assert caught.value.line in (changed, changed - new.count("\n"))
    assert what in caught.value.what and expected in caught.value.expected


def test_a_missing_urdf(copy: Path) -> None:
    copy.with_suffix(".urdf").unlink()
    with pytest.raises(InputError, match=r"trunnion_ac\.yaml:3: no such URDF"):
        Machine.load(copy)


def test_a_urdf_that_is_not_xml(copy: Path) -> None:
    urdf = copy.with_suffix(".urdf")
    lines = urdf.read_text().splitlines()
    broken = next(number for number, line in enumerate(lines) if "</visual>" in line)
    lines[broken] = lines[broken].replace("</visual>", "</visible>")
    urdf.write_text("\n".join(lines))
    with pytest.raises(InputError, match="not XML") as caught:
        Machine.load(copy)
    assert (caught.value.file, caught.value.line) == (str(urdf), broken + 1)


@pytest.mark.parametrize(("old", "new"), [('child link="table"', 'child link="tabel"'), ("<robot", "<robbot")])
def test_xml_that_is_not_a_robot(copy: Path, old: str, new: str, capfd: pytest.CaptureFixture[str]) -> None:
    urdf = copy.with_suffix(".urdf")
    urdf.write_text(
        urdf.read_text().replace(old, new).replace("</robot>", "</robbot>" if "robb" in new else "</robot>")
    )
    with pytest.raises(InputError) as caught:
        Machine.load(copy)
    assert caught.value.file in (str(urdf), str(copy))


def test_the_error_for_an_unknown_machine_lists_the_known_ones() -> None:
    with pytest.raises(InputError) as caught:
        Machine.load("dmu5000")
    assert all(f"{name}.yaml" in caught.value.expected for name in BUNDLED)
