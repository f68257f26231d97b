"""Tests of visibility, clearance and order of readings: by hand on a one-slide machine, independently on the DMU 50.

References: points sampled densely along a beam, distances from coal between shapes placed by Pinocchio, angles in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from tests.conftest import two_stations
from tests.planning import kits
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.planning import Kit, Plan, duration, plan
from twin.planning.clearance import MARGIN_MM, NEST, REFLECTOR_MM, Clearance, Sight, plan_table

BEAMS = 400
SAMPLES = 4001
GRAZING_MM = 0.4
"""Beams that pass a surface closer than the sample spacing: either answer is right."""
PLACED = '<origin xyz="0.02 -0.05 0.1" rpy="0.4 -0.3 0.7"/>'
TURN = pin.rpy.rpyToMatrix(0.4, -0.3, 0.7)
ORIGIN_MM = np.array([20.0, -50.0, 100.0])


def in_box(p: np.ndarray) -> np.ndarray:
    return np.max(np.abs(p) - [60.0, 100.0, 40.0], axis=-1)


def in_cylinder(p: np.ndarray) -> np.ndarray:
    return np.maximum(np.hypot(p[..., 0], p[..., 1]) - 70.0, np.abs(p[..., 2]) - 90.0)


def in_sphere(p: np.ndarray) -> np.ndarray:
    return np.linalg.norm(p, axis=-1) - 80.0


@pytest.mark.parametrize(
    ("shape", "depth"),
    [
        ('<box size="0.12 0.2 0.08"/>', in_box),
        ('<cylinder radius="0.07" length="0.18"/>', in_cylinder),
        ('<sphere radius="0.08"/>', in_sphere),
    ],
    ids=["box", "cylinder", "sphere"],
)
def test_a_shape_blocks_beams_that_pass_through_it(
    tmp_path: Path, shape: str, depth: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Stations and reflectors on either side, inside and beyond; a reflector on the slide moves with it."""
    machine = kits.bench(tmp_path, f"{PLACED}<geometry>{shape}</geometry>")
    rng = np.random.default_rng(3)
    stations = {f"S{i}": rng.uniform(-400.0, 400.0, 3) for i in range(10)}
    targets = {f"T{i}": (("tool", "work")[i % 2], rng.uniform(-300.0, 300.0, 3)) for i in range(BEAMS // 40)}
    positions = rng.uniform(-300.0, 300.0, (4, 1))
    seen = Sight(machine, kits.kit(machine, stations, targets)).visible(positions)
    decided, blocked = 0, 0
    for station, eye in stations.items():
        for name, (side, place) in targets.items():
            for row, (x,) in enumerate(positions):
                reflector = place + (np.array([x, 0.0, 0.0]) if side == "tool" else 0.0)
                # The last 30 mm belong to the reflector's nest.
                away = (eye - reflector) / np.linalg.norm(eye - reflector)
                beam = np.linspace(reflector + NEST * 1e3 * away, eye, SAMPLES)
                nearest = depth((beam - ORIGIN_MM) @ TURN).min()
                if abs(nearest) > GRAZING_MM:
                    assert bool(seen[station, name][row]) == (nearest > 0.0), (station, name, row, nearest)
                    decided, blocked = decided + 1, blocked + (nearest < 0.0)
    assert decided > 0.9 * BEAMS and 20 < blocked < 0.9 * BEAMS


def test_a_box_between_station_and_reflector(tmp_path: Path) -> None:
    """A wall 100 mm high at x = 500: from a station 150 mm up the beam to a reflector 50 mm up clears it where x < 0."""
    machine = kits.bench(tmp_path, '<origin xyz="0.5 0 0.05"/><geometry><box size="0.002 1 0.1"/></geometry>')
    own = kits.kit(machine, {"S": (1000.0, 0.0, 150.0)}, {"T": ("tool", (0.0, 0.0, 50.0)), "W": ("work", (0, 0, 100))})
    # At the wall the beam is 50 + 100·(500 − x)/(1000 − x) mm up; 2 mm of wall are 0.2 mm of beam.
    seen = Sight(machine, own).visible(np.array([[-50.0], [-5.0], [5.0], [50.0]]))
    assert seen["S", "T"].tolist() == [True, True, False, False]
    glass = kits.kit(machine, {"S": (1000.0, 0.0, 150.0)}, {"T": ("tool", (0.0, 0.0, 50.0))}, opaque=False)
    assert Sight(machine, glass).visible(np.array([[50.0]]))["S", "T"].all()


def test_a_shape_that_moves_with_the_slide(tmp_path: Path) -> None:
    """A plate on the slide 100 mm in front of the reflector hides it at every position; a plate on the bed does not follow."""
    plate = '<origin xyz="0.1 0 0"/><geometry><box size="0.01 0.2 0.2"/></geometry>'
    stations = {"S": (2000.0, 0.0, 0.0), "back": (-2000.0, 0.0, 0.0)}
    targets = {"T": ("tool", (0.0, 0.0, 0.0))}
    at = np.array([[-200.0], [0.0], [200.0]])
    (tmp_path / "bed").mkdir()
    riding = kits.bench(tmp_path, moving=plate)
    standing = kits.bench(tmp_path / "bed", plate)
    assert Sight(riding, kits.kit(riding, stations, targets)).visible(at)["S", "T"].tolist() == [False] * 3
    assert Sight(riding, kits.kit(riding, stations, targets)).visible(at)["back", "T"].all()
    assert Sight(standing, kits.kit(standing, stations, targets)).visible(at)["S", "T"].tolist() == [False, False, True]


def test_a_mesh_counts_as_the_box_around_it(tmp_path: Path) -> None:
    """A beam that passes the tetrahedron but not its bounding box counts as blocked."""
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    machine = kits.bench(
        tmp_path, f'<geometry><mesh filename="{tmp_path}/t.obj" scale="0.001 0.001 0.001"/></geometry>'
    )
    stations = {"through": (20.0, 20.0, 500.0), "past it": (90.0, 90.0, 500.0), "clear": (150.0, 90.0, 500.0)}
    targets = {"T": ("work", (20.0, 20.0, -200.0)), "U": ("work", (90.0, 90.0, -200.0))}
    seen = Sight(machine, kits.kit(machine, stations, targets)).visible(np.zeros((1, 1)))
    assert not seen["through", "T"][0] and not seen["past it", "U"][0] and seen["clear", "U"][0]


def test_a_reflector_accepts_a_beam_within_its_angle(tmp_path: Path) -> None:
    """Facing +x at x on the slide, station at (1000, 300): 300/(1000 − x) is compared with the tangent of the acceptance."""
    machine = kits.bench(tmp_path)
    x = np.linspace(-300.0, 300.0, 61)
    own = kits.kit(
        machine, {"S": (1000.0, 300.0, 0.0)}, {"T": ("tool", (0, 0, 0))}, facing=(1, 0, 0), acceptance_deg=20
    )
    expected = 300.0 / (1000.0 - x) <= np.tan(np.radians(20.0))
    assert 10 < expected.sum() < 50
    assert np.array_equal(Sight(machine, own).visible(x[:, None])["S", "T"], expected)


def test_a_reflector_on_the_table_turns_with_it(dmu50: Machine) -> None:
    """Facing +x on the table, station far out on +x of the base: the commanded C turns about −z, so cos C decides."""
    own = kits.kit(
        dmu50, {"S": (1e7, 0.0, 0.0)}, {"W": ("work", (0, 0, 0))}, facing=(1, 0, 0), acceptance_deg=50, opaque=False
    )
    c = np.arange(0.0, 360.0, 7.0)
    positions = np.zeros((len(c), 5))
    positions[:, 4] = c
    seen = Sight(dmu50, own).visible(positions)["S", "W"]
    assert np.array_equal(seen, np.cos(np.radians(c)) >= np.cos(np.radians(50.0)))


def test_a_target_that_is_never_visible_is_named(tmp_path: Path) -> None:
    machine = kits.bench(tmp_path, '<origin xyz="0.7 0 0"/><geometry><box size="0.1 5 5"/></geometry>')
    own = kits.kit(machine, {"S": (2000.0, 0.0, 0.0)}, {"T": ("tool", (0, 0, 0)), "W": ("work", (0, 500, 0))})
    with pytest.raises(InputError, match="target T is hidden from every station"):
        plan(machine, own, minutes=60)


# ---- clearance


def test_the_margin_between_two_reflectors(tmp_path: Path) -> None:
    """Sphere on the slide and sphere on the bed: the limit is a distance of two radii and the margin."""
    machine = kits.bench(tmp_path)
    own = kits.kit(machine, {"S": (0, 2000, 0)}, {"T": ("tool", (0, 0, 0)), "W": ("work", (0, 60, 0))})
    clearance = Clearance(machine, own)
    assert not clearance.has_shapes
    needed = np.sqrt((2.0 * REFLECTOR_MM + MARGIN_MM) ** 2 - 60.0**2)
    for x in (needed - 0.1, -needed + 0.1, 0.0):
        assert not clearance.is_clear(np.array([x]))
    for x in (needed + 0.1, -needed - 0.1):
        assert clearance.is_clear(np.array([x]))
    assert not clearance.is_move_clear(np.array([-200.0]), np.array([200.0]))
    assert clearance.is_move_clear(np.array([-300.0]), np.array([-needed - 1.0]))


# ---- a plan of the DMU 50


MINUTES = 60.0


@pytest.fixture(scope="module")
def made(dmu50: Machine) -> Plan:
    return plan(dmu50, two_stations(dmu50), minutes=MINUTES)


class Shapes:
    """Shapes of either side, found by the names of the URDF's links, and the reflectors as spheres."""

    def __init__(self, machine: Machine, kit: Kit) -> None:
        self.machine, self.kit = machine, kit
        drawn = pin.buildGeomFromUrdf(machine.model, str(machine.urdf), pin.GeometryType.VISUAL).geometryObjects
        self.sides: dict[str, list[tuple[int, coal.CollisionGeometry, pin.SE3]]] = {}
        for side, links in (("tool", {"x_slide", "y_slide", "spindle"}), ("work", {"cradle", "table"})):
            self.sides[side] = [
                (s.parentJoint, s.geometry, s.placement)
                for s in drawn
                if machine.model.frames[s.parentFrame].name in links
            ]
            assert len(self.sides[side]) > 5
        for name, link in (("tool", "spindle_nose"), ("work", "table")):
            frame = machine.model.frames[machine.model.getFrameId(link)]
            for target in kit.targets.values():
                if target.carrier == name:
                    place = frame.placement * pin.SE3(np.eye(3), np.array(target.place_mm) * 1e-3)
                    self.sides[name].append((frame.parentJoint, coal.Sphere(REFLECTOR_MM * 1e-3), place))

    def gap_mm(self, command: np.ndarray, enough: float = np.inf) -> float:
        """Return the smallest distance between the two sides; pairs with bounding spheres beyond ``enough`` are skipped."""
        data = self.machine.model.createData()
        pin.forwardKinematics(self.machine.model, data, self.machine.configuration(command * self.machine.scale))
        placed = {}
        for side, shapes in self.sides.items():
            placed[side] = []
            for joint, geometry, placement in shapes:
                pose = data.oMi[joint] * placement
                geometry.computeLocalAABB()
                middle = pose.act(np.array(geometry.aabb_center))
                placed[side].append(
                    (geometry, coal.Transform3s(pose.rotation, pose.translation), middle, geometry.aabb_radius)
                )
        best = np.inf
        for a, at_a, middle_a, radius_a in placed["tool"]:
            for b, at_b, middle_b, radius_b in placed["work"]:
                if (np.linalg.norm(middle_a - middle_b) - radius_a - radius_b) * 1e3 < min(best, enough):
                    found = coal.distance(a, at_a, b, at_b, coal.DistanceRequest(), coal.DistanceResult())
                    best = min(best, found * 1e3)
        return float(best)


def test_every_pose_of_a_plan_has_clearance(dmu50: Machine, made: Plan) -> None:
    shapes = Shapes(dmu50, made.kit)
    poses = np.unique(made.table.positions, axis=0)
    gaps = [shapes.gap_mm(pose, 2.0 * MARGIN_MM) for pose in poses]
    # 1e-3 mm: tolerance of coal's iteration.
    assert min(gaps) >= MARGIN_MM - 1e-3
    # The check can fail: some random poses have no clearance.
    low, high = made.kit.ranges.T
    drawn = np.random.default_rng(0).uniform(low, high, (40, 5))
    assert min(shapes.gap_mm(pose, 1.0) for pose in drawn) < 0.0


@pytest.mark.slow
def test_straight_moves_are_clear_or_listed(dmu50: Machine, half: Plan) -> None:
    """Check dense points of every twelfth move that is not listed, and that every listed move has too little clearance."""
    made = half
    shapes = Shapes(dmu50, made.kit)
    at = made.table.positions
    blocked = set(made.route.blocked)
    for row in range(1, len(at)):
        if row % 12 and row not in blocked:
            continue
        way = np.abs(at[row] - at[row - 1]) / [5.0, 5.0, 5.0, 1.0, 1.0]
        parts = np.linspace(0.0, 1.0, int(np.ceil(way.max())) + 2)
        if row in blocked:
            gap = min(shapes.gap_mm(at[row - 1] + part * (at[row] - at[row - 1]), MARGIN_MM) for part in parts)
            assert gap < MARGIN_MM, row
        else:
            gap = min(shapes.gap_mm(at[row - 1] + part * (at[row] - at[row - 1]), 5.0) for part in parts)
            assert gap > 0.0, row
    assert all(str(row + 1) in " ".join(made.notices()) for row in list(blocked)[:20])
    assert made.complete is (not blocked)


def test_reflectors_of_a_plan_are_visible(dmu50: Machine, made: Plan) -> None:
    """For every reading, checked with coal: no shape between the reflector's nest and the station."""
    drawn = pin.buildGeomFromUrdf(dmu50.model, str(dmu50.urdf), pin.GeometryType.VISUAL).geometryObjects
    table = made.table
    data = dmu50.model.createData()
    for row in np.random.default_rng(1).choice(len(table), 25, replace=False):
        q = dmu50.configuration(table.positions[row] * dmu50.scale)
        pin.framesForwardKinematics(dmu50.model, data, q)
        link = "spindle_nose" if table.carrier[row] == "tool" else "table"
        reflector = data.oMf[dmu50.model.getFrameId(link)].act(table.place_mm[row] * 1e-3)
        eye = table.station_pose[row, :3] * 1e-3
        length = float(np.linalg.norm(eye - reflector))
        along = (eye - reflector) / length
        # A thin rod from the end of the nest to the station.
        rod = coal.Capsule(1e-5, length - NEST)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
        middle = coal.Transform3s(turn, reflector + (NEST + (length - NEST) / 2.0) * along)
        for shape in drawn:
            pose = data.oMi[shape.parentJoint] * shape.placement
            there = coal.Transform3s(pose.rotation, pose.translation)
            assert not coal.collide(
                rod, middle, shape.geometry, there, coal.CollisionRequest(), coal.CollisionResult()
            ), (row, shape.name)


def test_a_plan_keeps_within_time_kit_and_ranges(dmu50: Machine, made: Plan) -> None:
    table = made.table
    low, high = made.kit.ranges.T
    assert np.all(table.positions >= low) and np.all(table.positions <= high)
    assert {*table.station} == {*made.stations} <= {*made.kit.stations}
    assert {*table.target} <= {*made.kit.targets}
    for axis in range(5):
        assert {*table.approach[:, axis]} == {-1.0, 1.0}, dmu50.names[axis]
    assert np.all(np.diff(table.time_s) > 0.0) and np.isfinite(table.time_s).all()
    assert 0.95 * MINUTES < made.minutes <= MINUTES and table.time_s[-1] == pytest.approx(60.0 * made.minutes, abs=0.1)
    # Every station is visited once, with two passes.
    changes = [name for i, name in enumerate(table.station) if i == 0 or name != table.station[i - 1]]
    assert len(changes) == len({*changes})
    assert len({*table.round}) == 2 * len(made.stations)


def test_the_clock(dmu50: Machine, made: Plan) -> None:
    """Sum by hand of set-up, change of target, travel of the slowest axis, aiming and reading."""
    table, own = made.table, made.kit
    assert duration(dmu50, own, table) == pytest.approx(made.route.seconds)
    total, stations = 0.0, 0.0
    for row in range(len(table)):
        if row == 0 or table.station[row] != table.station[row - 1]:
            stations += own.seconds.station
        if row:
            total += np.max(np.abs(table.positions[row] - table.positions[row - 1]) / own.speeds)
            total += own.seconds.target * (table.target[row] != table.target[row - 1])
        total += own.seconds.point
    route = made.route
    assert route.spent["station"] == stations
    assert total == pytest.approx(route.spent["travel"] + route.spent["target"] + route.spent["point"])
    # Aiming: the angle from the last aimed direction, in the frame of the reflector's carrier.
    sight = Sight(dmu50, own)
    poses = sight.poses(table.positions)
    turns, facing = 0, {}
    for row in range(len(table)):
        if row == 0 or table.station[row] != table.station[row - 1]:
            facing = {}
        pose = poses[table.carrier[row]][row]
        beam = pose[:3, :3].T @ (table.station_pose[row, :3] * 1e-3 - pose[:3, 3]) - table.place_mm[row] * 1e-3
        beam /= np.linalg.norm(beam)
        name = table.target[row]
        if name not in facing or np.degrees(np.arccos(np.clip(beam @ facing[name], -1, 1))) > 30.0:
            turns += 1
            facing[name] = beam
    assert route.spent["aim"] == own.seconds.aim * turns


def test_the_same_seed_gives_the_same_plan(tmp_path: Path) -> None:
    machine = kits.bench(tmp_path)
    own = kits.kit(
        machine, {"S": (0, -2000, 100), "T": (2000, 0, 300)}, {"T": ("tool", (0, 0, 0)), "W": ("work", (0, 300, 0))}
    )
    first, again, other = (plan(machine, own, minutes=60.0, seed=seed).table for seed in (1, 1, 2))
    assert np.array_equal(first.positions, again.positions) and list(first.target) == list(again.target)
    assert np.array_equal(first.time_s, again.time_s) and np.array_equal(first.approach, again.approach)
    assert not np.array_equal(first.positions, other.positions)


def test_a_plan_is_a_table(dmu50: Machine, made: Plan, tmp_path: Path) -> None:
    """The table has the positions of the kit, unchanged after writing and reading."""
    from twin.measurement.table import Measurements

    made.save(tmp_path / "p.csv")
    read = Measurements.load(tmp_path / "p.csv", dmu50, plan=True)
    assert not read.set_aside and len(read) == len(made.table)
    for name in ("positions", "approach", "time_s", "place_mm", "station_pose"):
        assert np.array_equal(getattr(read, name), getattr(made.table, name)), name
    again = plan_table(dmu50, made.kit, read.positions, list(read.target), list(read.station), read.approach)
    assert np.array_equal(again.place_mm, read.place_mm) and np.array_equal(again.carrier, read.carrier)
