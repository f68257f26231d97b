"""Machines made from answers: they are the bundled and the hand-written ones, and random chains follow homogeneous transforms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import twin
from tests.linuxcnc.machines import KINDS
from tests.truth.rotary_table import turned
from twin._common.errors import InputError
from twin._common.yaml_files import yaml_text
from twin.machine.description import SCHEMA, Description

SLIDES = {"X": {"range": [0, 600]}, "Y": {"range": [0, 500]}, "Z": {"range": [-450, 0]}}
TRUNNION: dict[str, Any] = {
    "name": "trunnion AC",
    "tool": ["X", "Z"],
    "work": ["Y", "A", "C"],
    "table": {"X": 300, "Y": 250, "Z": -450},
    "axes": {
        **SLIDES,
        "A": {"range": [-120, 30], "at": "machine 300 250 -390"},
        "C": {"range": "unlimited", "at": "A 0 0 -60"},
    },
}
DMU50: dict[str, Any] = {
    "name": "DMU 50 eVolution",
    "tool": ["X", "Y", "Z"],
    "work": ["B", "C"],
    "table": {"X": 250, "Y": 225, "Z": -400},
    "axes": {
        "X": {"range": [0, 500]},
        "Y": {"range": [0, 450]},
        "Z": {"range": [-400, 0]},
        "B": {"range": [0, 180], "about": "Y -Z 45", "at": "table 0 0 154.996"},
        "C": {"range": "unlimited", "at": "table 0 0 0"},
    },
}
GANTRY: dict[str, Any] = {
    "name": "XYZBC trunnion",
    "tool": ["Y", "X", "Z"],
    "work": ["B", "C"],
    "table": {"X": 0, "Y": 0, "Z": 0},
    "axes": {
        "X": {"range": [-300, 300]},
        "Y": {"range": [-300, 300]},
        "Z": {"range": [-100, 500]},
        "B": {"range": [-110, 110], "at": "table 0 0 40"},
        "C": {"range": "unlimited", "at": "table 0 0 0"},
    },
}


def made(folder: Path, data: dict[str, Any]) -> twin.Machine:
    """Return the machine of answers, loaded from its files."""
    description = Description.of(data)
    (folder / "made.urdf").write_text(description.urdf())
    (folder / "made.yaml").write_text(description.machine_file("made.urdf", "made.answers.yaml"))
    machine = twin.Machine.load(folder / "made.yaml")
    description.check(machine)
    return machine


def commands(machine: twin.Machine, number: int = 50) -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.array([[rng.uniform(*axis.domain) for axis in machine.axes] for _ in range(number)])


def poses(machine: twin.Machine, q: np.ndarray, length: float = 120.0) -> tuple[np.ndarray, np.ndarray]:
    found = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=length).forward(q)
    return found.point_mm, found.axis


@pytest.mark.parametrize(("data", "name"), [(TRUNNION, "trunnion_ac"), (DMU50, "dmu50"), (GANTRY, "xyzbc_trunnion")])
def test_made_machines_are_the_bundled_ones(data: dict[str, Any], name: str, tmp_path: Path) -> None:
    machine, bundled = made(tmp_path, data), twin.Machine.load(name)
    q = commands(bundled)
    for mine, theirs in zip(poses(machine, q), poses(bundled, q), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9)
    for mine, theirs in zip(machine.axes, bundled.axes, strict=True):
        assert (mine.name, mine.side, mine.domain, mine.increment) == (
            theirs.name,
            theirs.side,
            theirs.domain,
            theirs.increment,
        )
        np.testing.assert_allclose(mine.direction, theirs.direction, atol=1e-12)
    assert machine.squareness_names == bundled.squareness_names
    assert machine.location_names == bundled.location_names


HAND_WRITTEN: dict[str, dict[str, Any]] = {
    # The parts of `tests.linuxcnc.machines` by distances, as a control states them: from the spindle nose, in machine coordinates.
    "head-table": {
        "tool": ["Y", "Z", "B"],
        "work": ["X", "C"],
        "axes": {
            **SLIDES,
            "B": {"range": [-100, 100], "at": "nose 0 0 180"},
            "C": {"range": [-360, 360], "at": "machine -12 240 0"},
        },
    },
    "nutating head and table": {
        "tool": ["X", "Y", "Z", "B"],
        "work": ["C"],
        "axes": {
            **SLIDES,
            "B": {"range": [-90, 180], "about": "0 1 1", "at": "nose 0 30 140"},
            "C": {"range": [-360, 360], "at": "machine 300 250 0"},
        },
    },
    "head-head": {
        "tool": ["X", "Y", "Z", "C", "A"],
        "work": [],
        "axes": {
            **SLIDES,
            "C": {"range": [-200, 200], "at": "A 0 -4 120"},
            "A": {"range": [-110, 110], "at": "nose -0.5 0.3 160"},
        },
    },
}


@pytest.mark.parametrize("name", HAND_WRITTEN)
def test_made_heads_are_the_hand_written_ones(name: str, tmp_path: Path) -> None:
    """The same motion: their work frames differ by a constant shift (a table without rotary axes) or by the table's centre."""
    kind = KINDS[name]()
    hand = kind.machine(tmp_path)
    data = {"name": name, "table": {"X": 0, "Y": 0, "Z": 0}, **HAND_WRITTEN[name]}
    machine = made(tmp_path, data)
    q = commands(machine)
    q[0] = 0.0
    assert machine.names == hand.names
    mine, theirs = poses(machine, q), poses(hand, q)
    np.testing.assert_allclose(mine[1], theirs[1], rtol=0, atol=1e-12)
    # Both work frames ride on the same axes: a constant shift.
    np.testing.assert_allclose(mine[0] - mine[0][0], theirs[0] - theirs[0][0], rtol=0, atol=1e-9)


def homogeneous(rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, shift
    return out


def about(direction: np.ndarray, point: np.ndarray, degrees: float) -> np.ndarray:
    rotation = turned(direction, np.radians(degrees))
    return homogeneous(rotation, point - rotation @ point)


def point_of(data: dict[str, Any], name: str) -> np.ndarray:
    """Return the point of a rotary axis in the base frame."""
    reference, *numbers = data["axes"][name]["at"].split()
    point = np.array([float(word) for word in numbers])
    if reference == "machine":
        return point - [data["table"].get(axis, 0.0) for axis in "XYZ"]
    return point + point_of(data, reference) if reference in "ABC" else point


def expected_pose(data: dict[str, Any], q: dict[str, float], length: float) -> np.ndarray:
    """Return the tool at its tip in the work frame (4, 4): every axis moves what it carries about its line at rest."""
    sides = {}
    for side, sign in (("tool", 1.0), ("work", -1.0)):
        whole = np.eye(4)
        for name in data[side]:
            one = data["axes"][name]
            sense = sign * (-1.0 if one.get("positive") == "reversed" else 1.0)
            line = (
                np.array([float(word) for word in one["about"].split()])
                if "about" in one
                else np.eye(3)["XYZABC".index(name) % 3]
            )
            if name in "XYZ":
                whole = whole @ homogeneous(np.eye(3), sense * line * (q[name] - data["table"][name]))
            else:
                point = point_of(data, name)
                whole = whole @ about(line, point, sense * q[name])
        sides[side] = whole
    z = np.array([float(word) for word in data.get("tool_axis", "0 0 1").split()])
    z /= np.linalg.norm(z)
    # A right-angle head: x of its frame in the plane of x and z, the shortest turn by pitch and roll.
    y = np.cross(z, np.cross([0.0, 1.0, 0.0], z)) if abs(z[1]) < 1.0 else np.array([0.0, 0.0, -z[1]])
    y /= np.linalg.norm(y)
    nose = np.column_stack([np.cross(y, z), y, z])
    return np.linalg.inv(sides["work"]) @ sides["tool"] @ homogeneous(nose, -length * z)


@st.composite
def machines(draw: st.DrawFn) -> dict[str, Any]:
    """Draw answers: any split of the axes over the two sides, any order, up to two rotary axes, any direction near their letter's."""
    mm = st.integers(-4000, 4000).map(lambda n: n / 8)
    linear = draw(st.lists(st.sampled_from("XYZ"), min_size=1, max_size=3, unique=True))
    rotary = draw(st.lists(st.sampled_from("ABC"), min_size=0, max_size=2, unique=True))
    cut, turn = draw(st.integers(0, len(linear))), draw(st.integers(0, len(rotary)))
    data: dict[str, Any] = {"name": "drawn", "tool": linear[:cut] + rotary[:turn], "work": linear[cut:] + rotary[turn:]}
    data["table"] = {name: draw(mm) for name in linear}
    data["spindle"] = draw(st.sampled_from(["vertical", "horizontal"]))
    if draw(st.booleans()):
        data["tool_axis"] = draw(st.sampled_from(["1 0 0", "-1 0 0", "0 1 0", "0 -1 0", "0 1 1", "3 -1 2", "0 0 -1"]))
    data["axes"] = {
        name: {"range": [-500, 500], "positive": draw(st.sampled_from(["iso", "reversed"]))} for name in linear
    }
    for name in rotary:
        side = "tool" if name in data["tool"] else "work"
        along = np.eye(3)["ABC".index(name)] + draw(st.sampled_from([0.0, 0.0, 1e-4, 0.3])) * np.array(
            [draw(st.integers(-3, 3)) for _ in range(3)]
        )
        place = "nose" if side == "tool" else draw(st.sampled_from(["table", "machine"]))
        both = [
            other
            for other in data[side]
            if other in data["axes"] and other in "ABC" and data["axes"][other]["at"][0] in "ntm"
        ]
        if both and draw(st.booleans()):
            place = both[0]
        data["axes"][name] = {
            "range": [-200, 200],
            "positive": draw(st.sampled_from(["iso", "reversed"])),
            "about": " ".join(repr(float(part)) for part in along),
            "at": f"{place} {draw(mm)} {draw(mm)} {draw(mm)}",
        }
    return data


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much],
)
@given(data=machines(), seed=st.integers(0, 2**32 - 1))
def test_any_chain_follows_homogeneous_transforms(data: dict[str, Any], seed: int, tmp_path: Path) -> None:
    try:
        machine = made(tmp_path, data)
    except InputError as error:
        assert "parallel" in error.what or "closer to" in error.expected  # the two refusals that such draws can meet
        return
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q = {name: float(rng.uniform(*machine.by_name[name].domain)) for name in machine.names}
        configuration = machine.configuration(np.array([q[name] for name in machine.names]) * machine.scale)
        frames = machine.model.createData()
        pin.framesForwardKinematics(machine.model, frames, configuration)
        tool, work = (frames.oMf[frame].homogeneous for frame in (machine.tool_frame, machine.work_frame))
        found = np.linalg.inv(work) @ tool @ homogeneous(np.eye(3), np.array([0.0, 0.0, -0.1]))
        expected = expected_pose(data, q, 100.0)
        np.testing.assert_allclose(found[:3, :3], expected[:3, :3], rtol=0, atol=1e-11)
        np.testing.assert_allclose(
            1e3 * found[:3, 3], expected[:3, 3], rtol=0, atol=1e-8
        )  # directions 0.01° off: rpy to 1e-11


def changed(data: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return answers with some changed: ``A__at`` is `axes.A.at`; None removes one."""
    out = {**data, "axes": {name: dict(one) for name, one in data["axes"].items()}}
    for key, value in changes.items():
        name, _, entry = key.partition("__")
        place = out["axes"].setdefault(name, {}) if entry else out
        place[entry or key] = value
        if value is None:
            del place[entry or key]
    return out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"work": ["Y", "A", "A"]}, ["axis A twice", "every axis once"]),
        ({"work": ["Y", "A"]}, ["axis C is neither in `tool` nor in `work`"]),
        ({"tool": ["X"], "work": ["Y", "A", "C", "Z"]}, ["the linear axis Z is carried by the rotary axis C"]),
        ({"tool": ["X", "X1", "Z"], "X1__range": [0, 1]}, ["two linear axes in the same direction"]),
        ({"tool": ["X", "Z", "B"], "B__range": [-90, 90], "B__at": "nose 0 0 100"}, ["more than two rotary axes"]),
        ({"table": {"X": 1, "Y": 2}}, ["`table` lacks Z"]),
        ({"table": {"X": 1, "Y": 2, "Z": 3, "A": 0}}, ["`table` has A"]),
        ({"A__range": [30, -120]}, ["axes.A.range", "reversed or empty", "[30.0, -120.0]"]),
        ({"A__range": [10, 120]}, ["axes.A.range", "zero is outside"]),
        ({"X__range": [0, 900000]}, ["axes.X.range", "more than 100 m"]),
        ({"X__range": "unlimited"}, ["axes.X.range", "without limits"]),
        ({"X__about": "X"}, ["axes.X", "a linear axis"]),
        ({"A__about": "Y"}, ["axes.A.about", "an axis about X or inclined", "'Y'"]),
        ({"A__about": "0 0 0"}, ["axes.A.about", "not a direction"]),
        ({"A__about": "0.1 0 1"}, ["axes.A.about"]),
        ({"A__about": "Z X 0.5"}, ["axes.A.about", "A is an axis about X"]),
        ({"A__about": "1 0 4", "C__about": "1 0 4"}, ["A and C are parallel"]),
        ({"A__at": None}, ["axes.A.at", "missing", "nose 0 0 180"]),
        ({"A__at": "0 0 60"}, ["axes.A.at", "not a place"]),
        ({"A__at": "nose 0 0 60"}, ["axes.A.at", "moves the workpiece", "table or machine"]),
        ({"A__at": "C 0 0 60"}, ["refer to each other"]),
        ({"A__increment": 0}, ["axes.A.increment"]),
        ({"A__turn": "left"}, ["axes.A.turn", "one of"]),
        ({"tool": [], "work": []}, ["neither in `tool` nor in `work`"]),
        ({"tool": ["Q"]}, ["tool.0"]),
        ({"name": ""}, ["name"]),
    ],
)
def test_contradictory_answers_are_named(changes: dict[str, Any], words: list[str], tmp_path: Path) -> None:
    data = changed(TRUNNION, **changes)
    with pytest.raises(InputError) as refused:
        Description.of(data)
    assert all(word in str(refused.value) for word in words), refused.value
    path = tmp_path / "answers.yaml"
    path.write_text(yaml_text({"schema": SCHEMA, **data}))
    with pytest.raises(InputError, match=r"answers.yaml(:\d+)?: "):
        Description.load(path)


def test_an_error_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "answers.yaml"
    path.write_text(yaml_text({"schema": SCHEMA, **changed(TRUNNION, A__range=[30, -120])}))
    line = next(n for n, text in enumerate(path.read_text().splitlines(), 1) if "-120" in text)
    with pytest.raises(InputError, match=rf"answers.yaml:{line}: "):
        Description.load(path)


def test_masses_are_positive_and_marked_as_estimates(tmp_path: Path) -> None:
    machine = made(tmp_path, DMU50)
    assert "MASSES ARE ESTIMATES" in machine.urdf.read_text()
    for joint in machine.axis_joints:
        carried = [i for i in range(machine.model.njoints) if joint in machine.model.supports[i].tolist()]
        assert sum(machine.model.inertias[i].mass for i in carried) > 1.0
    for inertia in machine.model.inertias:
        moments = np.linalg.eigvalsh(inertia.inertia)
        assert inertia.mass == 0.0 or (moments[0] > 0.0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-3))


def test_shapes_of_neighbours_touch_where_the_machine_stands(tmp_path: Path) -> None:
    """`frames.origin` shifts the links of a branch: the Z ram stays on its saddle, and the saddle on its beam, everywhere."""
    machine = made(tmp_path, TRUNNION)
    geometry = pin.buildGeomFromUrdf(machine.model, str(machine.urdf), pin.GeometryType.VISUAL)
    for q in commands(machine, 5):
        data, geometry_data = machine.model.createData(), geometry.createData()
        configuration = machine.configuration(q * machine.scale)
        pin.updateGeometryPlacements(machine.model, data, geometry, geometry_data, configuration)
        boxes: dict[str, list[np.ndarray]] = {}
        for one, place in zip(geometry.geometryObjects, geometry_data.oMg, strict=True):
            if hasattr(one.geometry, "halfSide"):
                size = np.abs(place.rotation) @ np.array(one.geometry.halfSide)
                boxes.setdefault(one.name.rsplit("_", 1)[0], []).append(
                    np.stack([place.translation - size, place.translation + size])
                )
        for inner, outer in (("z_link", "x_link"), ("x_link", "base")):
            gaps = [np.max(np.maximum(a[0] - b[1], b[0] - a[1])) for a in boxes[inner] for b in boxes[outer]]
            assert min(gaps) < 0.01, (inner, outer)


def test_continuous_joints_are_accepted(tmp_path: Path) -> None:
    """Pinocchio gives them two coordinates; here they are joints of one, with and without `<limit>`."""
    urdf = Path(twin.Machine.load("trunnion_ac").urdf).read_text()
    start = urdf.index('<joint name="c_joint"')
    changed_joint = urdf[start:].replace('type="revolute"', 'type="continuous"', 1)
    for text in (
        changed_joint,
        changed_joint.replace('<limit lower="-10000" upper="10000" effort="0" velocity="3"/>', "", 1),
    ):
        (tmp_path / "trunnion_ac.urdf").write_text(urdf[:start] + text)
        (tmp_path / "trunnion_ac.yaml").write_text(twin.Machine.load("trunnion_ac").path.read_text())
        machine, bundled = twin.Machine.load(tmp_path / "trunnion_ac.yaml"), twin.Machine.load("trunnion_ac")
        q = commands(bundled, 10)
        for mine, theirs in zip(poses(machine, q), poses(bundled, q), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert machine.by_name["C"].lower is None
