"""Tables with typical faults: a dead sensor, a single column, metres for millimetres. Each is named before anything is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from tests.cli.commands import refused
from tests.identification.plans import four_stations, volumetric
from tests.truth.few_axes import write_drill, write_robot
from twin import cli
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.diagnosis import diagnose
from twin.identification import identify
from twin.identification.inputs import prepare
from twin.identification.orders import HeldOutResiduals
from twin.identification.result import misfit_entry
from twin.machine.machine import Machine
from twin.measurement.columns import ASSUMED
from twin.measurement.instruments import Instrument, LaserTracker, TrackingInterferometer
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan

SEED = 21
BOTH: list[Callable[[Measurements, Machine], object]] = [
    lambda data, machine: identify(data, machine),
    lambda data, machine: diagnose(data, machine, Calibration.zero(machine)),
]
NAMES = ["identify", "diagnose"]


def rows_of(machine: Machine, positions: np.ndarray, carrier: str, target: str = "K") -> Measurements:
    """Return a plan of one target and one station."""
    n = len(positions)
    return Measurements(
        source="m.csv",
        lines=read_only(np.arange(2, n + 2)),
        positions=read_only(np.asarray(positions, dtype=float)),
        readback=read_only(np.full(positions.shape, np.nan)),
        target=read_only(np.full(n, target, dtype=object)),
        carrier=read_only(np.full(n, carrier, dtype=object)),
        station=read_only(np.full(n, "1", dtype=object)),
        round=read_only(np.full(n, "1", dtype=object)),
        point_mm=read_only(np.zeros((n, 3))),
        u_mm=read_only(np.full((n, 3), np.nan)),
        time_s=read_only(np.full(n, np.nan)),
        approach=read_only(np.zeros(positions.shape)),
        place_mm=read_only(np.full((n, 3), np.nan)),
        station_pose=read_only(np.full((n, 6), np.nan)),
        temperature_degC=MappingProxyType({}),
    )


def measured(plan: Measurements, machine: Machine, instrument: Instrument | None = None, **more: bool) -> Measurements:
    rng = np.random.default_rng(SEED)
    errors = Calibration.zero(machine)
    made = simulate(plan, machine, errors, instrument or LaserTracker(), rng, **more)[0]
    return replace(made, source="m.csv")


def with_points(data: Measurements, point_mm: np.ndarray) -> Measurements:
    return replace(data, point_mm=read_only(np.array(point_mm, dtype=float)))


def alone(data: Measurements, column: int) -> Measurements:
    points = np.full((len(data), 3), np.nan)
    points[:, column] = data.point_mm[:, column]
    return with_points(data, points)


@pytest.fixture(scope="module")
def drill(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return Machine.load(write_drill(tmp_path_factory.mktemp("drill")))


@pytest.fixture(scope="module")
def tracked(dmu50: Machine) -> Measurements:
    """Return the thesis's plan measured by a tracker: X, Y, Z, B and C in turn, targets on both sides."""
    return measured(thesis_plan.plan(dmu50), dmu50)


@pytest.fixture(scope="module")
def stage(drill: Machine) -> Measurements:
    """Return 20 mm of the drill's table with a parallel scale: x_mm only, 0.5 µm of noise."""
    x = np.tile(np.linspace(0.0, 20.0, 11), 6)
    plan = rows_of(drill, np.column_stack([x, np.zeros(len(x))]), "work")
    points = np.full((len(x), 3), np.nan)
    points[:, 0] = x + np.random.default_rng(SEED).normal(0.0, 5e-4, len(x))
    return with_points(plan, points)


@pytest.mark.parametrize("run", BOTH, ids=NAMES)
@pytest.mark.parametrize("value", [0.0, 5.0])
def test_a_dead_sensor_is_refused(
    drill: Machine, stage: Measurements, run: Callable[[Measurements, Machine], object], value: float
) -> None:
    dead = np.where(np.isfinite(stage.point_mm), value, np.nan)
    with pytest.raises(InputError, match=r"are equal in all 66 rows, but it was moved by 20 mm") as caught:
        run(with_points(stage, dead), drill)
    assert (caught.value.file, caught.value.line, caught.value.value) == ("m.csv", 12, f"x_mm {value:g}")
    assert "check the sensor" in caught.value.expected


def test_one_dead_target_among_others_is_refused(dmu50: Machine, tracked: Measurements) -> None:
    points = np.array(tracked.point_mm)
    points[tracked.target == "P"] = points[tracked.target == "P"][0]
    with pytest.raises(InputError, match="sensor without signal: readings of target P from station 1"):
        identify(with_points(tracked, points), dmu50)


def test_a_constant_reading_may_be_right(dmu50: Machine, drill: Machine, stage: Measurements) -> None:
    """The axis stood still; or the table rotated under a target that may sit on its axis; or it moved by less than a gauge resolves."""
    still = replace(stage, positions=read_only(np.zeros_like(stage.positions)))
    constant = np.where(np.isfinite(stage.point_mm), 5.0, np.nan)
    assert not prepare(drill, with_points(still, constant), None)[1].notices
    c = np.zeros((36, 5))
    c[:, 4] = np.arange(0.0, 360.0, 10.0)
    turned = with_points(rows_of(dmu50, c, "work"), np.tile([100.0, 2.0, 3.0], (36, 1)))
    assert not prepare(dmu50, turned, None)[1].notices
    little = replace(stage, positions=read_only(np.array(stage.positions) * 0.0025))
    (notice,) = prepare(drill, with_points(little, constant), None)[1].notices
    assert notice.endswith("but it was moved by 0.05 mm: the sensor is dead or its resolution is coarse")


def test_a_coordinate_that_never_changes_is_noticed(drill: Machine) -> None:
    """The drill's quill and table measured perpendicularly and without noise: y is constant, which gives a notice."""
    q = np.array([[x, z] for x in np.linspace(0, 300, 7) for z in np.linspace(-200, 0, 5)])
    plan = rows_of(drill, q, "tool")
    plan = replace(plan, station_pose=read_only(np.tile([0.0, -2000.0, 0.0, 0.0, 0.0, 0.0], (len(q), 1))))
    plan = replace(plan, place_mm=read_only(np.tile([0.0, 0.0, 0.0], (len(q), 1))))
    data = measured(plan, drill, noise=False)
    found = prepare(drill, with_points(data, np.round(data.point_mm, 4)), None)[1].notices
    assert any(
        text.startswith("y_mm of station 1 is 2000 in every row while its targets move by 200 mm") for text in found
    )


@pytest.mark.slow
def test_a_single_column_is_taken_as_lengths_with_a_notice(
    dmu50: Machine, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The notice precedes the results, in text and JSON; a named instrument needs none."""
    lengths = measured(four_stations(dmu50, np.random.default_rng(SEED), 30), dmu50, TrackingInterferometer())
    reader, data, _ = prepare(dmu50, lengths, None)
    assert isinstance(reader.every[0], TrackingInterferometer)
    assert data.notices[0].startswith(f"{ASSUMED}x_mm is a length") and "name the instrument" in data.notices[0]
    assert not prepare(dmu50, lengths, TrackingInterferometer())[1].notices
    lengths.save(tmp_path / "m.csv", dmu50)
    with pytest.raises(SystemExit) as stopped:
        cli.main(["identify", str(tmp_path / "m.csv"), "-o", str(tmp_path / "c.yaml")])
    said = capsys.readouterr().out
    assert stopped.value.code == 0
    assert said.count(f"{ASSUMED}x_mm is a length") == 1
    assert said.index(f"{ASSUMED}x_mm is a length") < said.index("error motions")


@pytest.mark.slow
@pytest.mark.parametrize("run", BOTH, ids=NAMES)
def test_one_coordinate_of_a_tracker_is_no_length(
    dmu50: Machine, tracked: Measurements, run: Callable[[Measurements, Machine], object]
) -> None:
    for column, name in enumerate(("x_mm", "y_mm", "z_mm")):
        with pytest.raises(InputError, match=f"only {name} is given") as caught:
            run(alone(tracked, column), dmu50)
        assert "x_mm, y_mm and z_mm" in caught.value.expected and caught.value.file == "m.csv"


@pytest.mark.parametrize("run", BOTH, ids=NAMES)
def test_a_column_that_does_not_follow_the_command(
    drill: Machine, stage: Measurements, run: Callable[[Measurements, Machine], object]
) -> None:
    """Noise of 3 mm on a travel of 20 and of 2 mm: less than a wrong command would cause."""
    rng = np.random.default_rng(SEED)
    for travel in (1.0, 0.1):
        noise = np.where(np.isfinite(stage.point_mm), rng.normal(0.0, 3.0 * travel, stage.point_mm.shape), np.nan)
        with pytest.raises(InputError) as caught:
            run(replace(with_points(stage, noise), positions=read_only(stage.positions * travel)), drill)
        assert "the commands" in caught.value.what and caught.value.line is not None


def test_single_y_that_follows_the_commands_is_accepted(drill: Machine, stage: Measurements) -> None:
    reader, data, _ = prepare(drill, with_points(stage, stage.point_mm[:, [1, 0, 2]]), None)
    assert isinstance(reader.every[0], LaserTracker)
    assert data.notices == ("only y_mm is given: taken as the coordinate of all targets along a line",)


@pytest.mark.sample(5)  # of 18
@pytest.mark.parametrize("run", BOTH, ids=NAMES)
@pytest.mark.parametrize(
    ("what", "columns", "factor", "words"),
    [
        ("readings", [0, 1, 2], 1e-3, "columns x_mm, y_mm, z_mm look like metres, not millimetres (factor 1000)"),
        ("readings", [0, 1, 2], 1 / 25.4, "columns x_mm, y_mm, z_mm look like inches, not millimetres (factor 25.4)"),
        ("readings", [0, 1, 2], 1e3, "columns x_mm, y_mm, z_mm look like micrometres, not millimetres (factor 0.001)"),
        ("readings", [1], 1e-3, "column y_mm looks like metres, not millimetres (factor 1000)"),
        ("commands", [0, 1, 2], 1e-3, "columns X_mm, Y_mm, Z_mm look like metres, not millimetres (factor 1000)"),
        ("commands", [0, 1, 2], 1 / 25.4, "columns X_mm, Y_mm, Z_mm look like inches, not millimetres (factor 25.4)"),
        ("commands", [2], 1e-3, "column Z_mm looks like metres, not millimetres (factor 1000)"),
        ("commands", [3, 4], np.pi / 180, "columns B_deg, C_deg look like radians, not degrees (factor 57.3)"),
        ("commands", [4], np.pi / 180, "column C_deg looks like radians, not degrees (factor 57.3)"),
    ],
)
def test_another_unit_is_named(
    dmu50: Machine,
    tracked: Measurements,
    run: Callable[[Measurements, Machine], object],
    what: str,
    columns: list[int],
    factor: float,
    words: str,
) -> None:
    values = np.array(tracked.point_mm if what == "readings" else tracked.positions)
    values[:, columns] *= factor
    data = with_points(tracked, values) if what == "readings" else replace(tracked, positions=read_only(values))
    with pytest.raises(InputError) as caught:
        run(data, dmu50)
    assert words in caught.value.what
    assert caught.value.file == "m.csv" and caught.value.line in data.lines and caught.value.value is not None


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "metres"), (1 / 25.4, "inches"), (1e3, "micrometres")])
def test_another_unit_of_a_single_column_is_named(
    drill: Machine, stage: Measurements, factor: float, unit: str
) -> None:
    """20 mm of travel: in metres, all readings are within a few millimetres of any command."""
    for travel in (1.0, 0.1):
        part = replace(stage, positions=read_only(stage.positions * travel))
        with pytest.raises(InputError, match=f"x_mm looks like {unit}"):
            identify(with_points(part, stage.point_mm * travel * factor), drill)


@pytest.mark.slow
def test_radians_of_a_robot_are_named(tmp_path: Path) -> None:
    machine = Machine.load(write_robot(tmp_path))
    rng = np.random.default_rng(SEED)
    data = measured(rows_of(machine, rng.uniform(-90.0, 90.0, (80, 6)), "tool"), machine)
    with pytest.raises(InputError, match=r"columns J1_deg, J2_deg, .* look like radians, not degrees \(factor 57.3\)"):
        identify(replace(data, positions=read_only(np.radians(data.positions))), machine)


def test_an_axis_that_moves_no_target_is_noticed(dmu50: Machine, tracked: Measurements) -> None:
    """B and C rotated, and all targets are on the tool side."""
    part = tracked.select(tracked.carrier == "tool")
    positions = np.array(part.positions)
    positions[:, 4] = np.random.default_rng(SEED).uniform(0.0, 360.0, len(part))
    found = prepare(dmu50, replace(part, positions=read_only(positions)), None)[1].notices
    assert "C moved, but it carries the work side, which has no target: its errors are not identifiable" in found


@pytest.mark.parametrize("wrong", ["readings", "commands"])
def test_a_mirrored_plane_is_noticed(dmu50: Machine, wrong: str) -> None:
    """Two coordinates of points in one plane have no handedness: a wrong sign looks like a station on the other side."""
    q = np.array([[x, y, 0.0, 0.0, 0.0] for x in np.linspace(0, 500, 7) for y in np.linspace(0, 450, 5)])
    turned = np.array([0.6, 0.8, -0.8, 0.6]).reshape(2, 2)
    points = np.column_stack([q[:, :2] @ turned, np.full(len(q), np.nan)])
    data = with_points(rows_of(dmu50, q, "tool"), points)
    assert not prepare(dmu50, data, None)[1].notices
    if wrong == "readings":
        data = with_points(data, points * [1.0, -1.0, 1.0])
    else:
        data = replace(data, positions=read_only(np.abs(q - [500.0, 0.0, 0.0, 0.0, 0.0])))
    (notice,) = prepare(dmu50, data, None)[1].notices
    assert notice.startswith(
        "station 1 reads x_mm and y_mm only, and its readings fit a station on the machine's -z side"
    )
    assert "wrong sign (mirrored axis)" in notice


@pytest.mark.parametrize("command", NAMES)
def test_an_axis_on_neither_path_is_named(tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A joint of the URDF on which neither the tool nor the work rides."""
    file = write_drill(tmp_path)
    urdf = tmp_path / "drill.urdf"
    door = (
        '<joint name="w_joint" type="prismatic"><parent link="bed"/><child link="door"/><axis xyz="1 0 0"/>'
        '<limit lower="0" upper="0.3" effort="0" velocity="1"/></joint><link name="door"/></robot>'
    )
    urdf.write_text(urdf.read_text().replace("</robot>", door))
    axis = "  - {name: W, joint: w_joint, kind: linear, range: [0, 300], increment: 0.001}\nframes:"
    file.write_text(file.read_text().replace("frames:", axis))
    table = tmp_path / "m.csv"
    table.write_text("X_mm,Z_mm,W_mm,target,carrier,x_mm,y_mm,z_mm\n0,0,0,K,tool,1,2,3\n")
    more = ["-o", tmp_path / "c.yaml"] if command == "identify" else []
    said = refused(capsys, command, table, "-m", file, *more)
    assert (
        f"{file}:7: axis W carries neither the tool nor the work: 'w_joint'; expected a joint between the base and"
        in said
    )


@pytest.mark.parametrize("noise", [True, False], ids=["noise", "exact"])
@pytest.mark.parametrize("instrument", [LaserTracker(), TrackingInterferometer()], ids=lambda one: one.name)
def test_good_data_raise_no_complaint(dmu50: Machine, instrument: Instrument, noise: bool) -> None:
    """The thesis's plan with the bundled errors, with and without noise, and lengths from four stations."""
    rng = np.random.default_rng(SEED)
    plan = four_stations(dmu50, rng, 60) if instrument.specification.free_start else thesis_plan.plan(dmu50)
    data = simulate(plan, dmu50, Calibration.default(dmu50), instrument, rng, noise=noise)[0]
    _, left, _ = prepare(dmu50, data, instrument)
    assert len(left) == len(data) and not left.notices and not left.set_aside


def test_good_data_of_one_axis_raise_no_complaint(drill: Machine, stage: Measurements, tmp_path: Path) -> None:
    stage.save(tmp_path / "m.csv", drill)
    _, left, _ = prepare(drill, Measurements.load(tmp_path / "m.csv", drill), None)
    assert len(left) == len(stage) and not left.notices and not left.set_aside


def test_too_few_positions_do_not_test_the_model(dmu50: Machine) -> None:
    """14 points fit any model, which the verdict states, in JSON too; so do positions that a good fit does not predict."""
    rng = np.random.default_rng(SEED)
    plan = volumetric(dmu50, rng, 14, stations=1)
    few = np.array(plan.positions)
    few[:, 1:] = few[0, 1:]
    data = simulate(replace(plan, positions=read_only(few)), dmu50, Calibration.default(dmu50), LaserTracker(), rng)[0]
    found = identify(data, dmu50)
    assert found.misfit.p_value > 1e-3
    assert found.verdict.startswith("TOO FEW")
    assert found.verdict in found.to_text() and found.to_dict()["verdict"] == found.verdict
    assert "consistent" not in found.to_text()
    fit = replace(found.misfit, dof=100.0)
    held_out = [HeldOutResiduals(1.0, whitened, 5, 20, 60) for whitened in (1.0, 5.0)]
    assert [misfit_entry(fit, 1.0, at_poses).verdict for at_poses in held_out] == ["consistent", "untested"]


@pytest.mark.slow
def test_enough_data_are_consistent(dmu50: Machine) -> None:
    rng = np.random.default_rng(SEED)
    data = simulate(thesis_plan.plan(dmu50), dmu50, Calibration.default(dmu50), LaserTracker(), rng)[0]
    found = identify(data, dmu50)
    assert found.verdict == "consistent with the noise of the readings"
    assert found.choice.held_out == pytest.approx(1.0, abs=0.1)
