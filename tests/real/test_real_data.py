"""Real measurements of other authors: a robot with a laser tracker, a drilled plate on a coordinate measuring machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.conftest import beside
from tests.real import plates, ur10
from twin._common.errors import InputError
from twin.display.numbers import COVERAGE_FACTOR
from twin.identification import Identification, identify
from twin.identification.discrepancy import covariance_of
from twin.identification.network import Network, Unknowns
from twin.identification.solve import FitSolution, Spread, solve
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker, StationInstruments, default_instrument
from twin.measurement.observation import nominal_carriers
from twin.measurement.set_up import initial_setup
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.numerics.curves import POWER, CurveSpace
from twin.tool.forward import Kinematics

SEED = 20200714
"""Seed of the halves: the day on which the series was begun."""
SPREADS: tuple[Spread, ...] = ("between rounds", "between poses")


def folder(name: str) -> Path:
    return beside("data", "real", name)


def rms_mm(left: np.ndarray) -> float:
    """Return the RMS of the distance; coordinates that were not read are ignored."""
    return float(np.sqrt(np.mean(np.nansum(left**2, axis=1))))


# --- UR10 -----------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Robot:
    machine: Machine
    as_given: Machine
    data: Measurements
    goals_mm: np.ndarray


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    shared = folder("ur10")
    here, given = tmp_path_factory.mktemp("ur10"), tmp_path_factory.mktemp("ur10e")
    machine = Machine.load(ur10.write_machine(shared, here, as_given=False))
    as_given = Machine.load(ur10.write_machine(shared, given, as_given=True))
    return Robot(
        machine,
        as_given,
        Measurements.load(ur10.write_table(shared, here / "poses.csv"), machine),
        ur10.goals_mm(shared),
    )


def halves(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of one random half of the poses and of the other."""
    order = np.random.default_rng(SEED).permutation(len(robot.data))
    return np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])


def geometric(machine: Machine, data: Measurements) -> Identification:
    locations = machine.location_names
    return identify(data, machine, wanted=lambda name: name in locations, spread="between rounds")


@pytest.fixture(scope="module")
def found(robot: Robot) -> Identification:
    return geometric(robot.machine, robot.data.select(halves(robot)[0]))


def fitted(machine: Machine, data: Measurements, unknowns: Unknowns) -> tuple[Network, FitSolution]:
    """Return stations, targets and some of the machine's unknowns, by least squares."""
    network = Network(machine, data, StationInstruments.same(LaserTracker(), data.station), unknowns)
    setup, _ = initial_setup(
        data, StationInstruments.same(default_instrument("point"), data.station), nominal_carriers(machine, data)
    )
    return network, solve(network, np.zeros(len(unknowns)), setup, np.ones(len(data)))


def unseen_mm(machine: Machine, data: Measurements, other: Measurements) -> float:
    """Return the error of the nominal machine at other poses, with station and target fitted."""
    _, solution = fitted(machine, data, Unknowns(machine, (), ()))
    network = Network(machine, other, StationInstruments.same(LaserTracker(), other.station), Unknowns(machine, (), ()))
    return rms_mm(1e3 * network.residuals_m(solution.theta, solution.setup, np.arange(len(other))))


def test_the_robot_is_two_files_and_its_joints_reach_their_goals(robot: Robot) -> None:
    """Zeros, signs and links are those of the data; the URDF next to them is of another robot, the UR10e."""
    assert robot.machine.names == ("J1", "J2", "J3", "J4", "J5", "J6")
    assert len(robot.data) == 11_911
    assert not robot.data.set_aside
    assert len(robot.machine.location_names) == 24
    off = {}
    for name, machine in (("own", robot.machine), ("given", robot.as_given)):
        poses = Kinematics(machine, Calibration.zero(machine), tool_length_mm=0.0).forward(robot.data.positions)
        # All goals together give the place of the probe on the flange.
        left = robot.goals_mm - poses.point_mm
        place = np.linalg.lstsq(poses.rotation.reshape(-1, 3), left.ravel(), rcond=None)[0]
        off[name] = np.linalg.norm(left - poses.rotation @ place, axis=1)
        if name == "own":
            # Series_A_Trafo_TM_F_init.txt: 109 mm in front of the flange.
            np.testing.assert_allclose(place, [0.0, 0.0, 109.0], atol=0.02)
    # Joints are printed to 1e-5 rad or less and were read while the robot settled: 0.1 mm at a metre.
    assert np.median(off["own"]) < 0.1
    assert off["own"].max() < 0.7
    assert np.median(off["given"]) > 5.0


def test_geometric_identification_halves_the_error_at_poses_it_never_saw(robot: Robot, found: Identification) -> None:
    """From 0.84 mm to 0.45 mm and less, as published with the data."""
    first, second = (robot.data.select(rows) for rows in halves(robot))
    before = unseen_mm(robot.machine, first, second)
    after = rms_mm(found.residuals_mm(second))
    assert found.converged
    assert 0.80 <= before <= 0.87
    assert after <= 0.45
    # Not by chance of the half to which it was fitted.
    assert after == pytest.approx(rms_mm(found.residual_mm[found.used]), rel=0.03)
    # Errors that one target on the last axis and a free station do not determine are named (J1 and two of J2 are the station's).
    assert {one.name for one in found.unidentified} == {
        *(f"E_{letter}0J1" for letter in "XYAB"),
        *("E_Y0J2", "E_B0J2"),
        # The one target sits on the last axis, where tilt and shift are confounded: only their sum is determined.
        *(f"E_{letter}0J6" for letter in "XYAB"),
    }


@pytest.mark.slow
def test_from_the_drawing_of_another_robot_the_same_prediction_and_the_true_links(
    robot: Robot, found: Identification
) -> None:
    """The URDF next to the data is wrong by 8 mm; links 10 mm off are identified, and nothing depends on the initial values."""
    first, second = (robot.data.select(rows) for rows in halves(robot))
    assert unseen_mm(robot.as_given, first, second) > 7.0
    given = geometric(robot.as_given, first)
    # Both are nearly the least-squares estimate: with residuals of 0.25 mm per coordinate, priors of errors and set-up change values of
    # centimetres by micrometres.
    np.testing.assert_allclose(given.residuals_mm(second), found.residuals_mm(second), atol=5e-3)
    difference = {name: value - found.calibration.location[name] for name, value in given.calibration.location.items()}
    # UR10 less UR10e, from Universal Robots' tables: upper arm 0.7 mm, forearm 0.75 mm, wrist 10.209 mm (and 4.15 mm at the last axis).
    # A tilt of one milliradian between nominal and actual axis moves 10 mm by 10 µm.
    links = {"E_X0J3": 700.0, "E_X0J4": -750.0, "E_Y0J5": -10_209.0}
    for name, expected in links.items():
        assert difference[name] == pytest.approx(expected, abs=10.0)
    for name in set(difference) - set(links) - set(found.held_by_prior):
        assert abs(difference[name]) < 20.0


@pytest.mark.slow
def test_intervals_hold_on_a_second_half_of_the_data(robot: Robot, found: Identification) -> None:
    """Estimates of two halves differ as their 95 % intervals allow: halves drawn by place, and one in time after the other.

    The model lacks effects that change little within a place, so places are the sample (`ur10.write_table`). If the poses are taken as
    independent, intervals are three times too narrow; with the uncertainty of a reading alone, eight times narrower still.
    """
    # The last axis's shift with them, its tilt taken as zero: the two are confounded.
    names = tuple(name for name in found.calibration.location if name not in ("E_A0J6", "E_B0J6"))
    unknowns, count = Unknowns(robot.machine, (), names), len(names)
    _, settled = fitted(robot.machine, robot.data.select(halves(robot)[0]), unknowns)
    start = settled.theta
    place = robot.data.round.astype(int)

    def estimate(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        part, weight = robot.data.select(rows), np.ones(len(rows))
        network = Network(robot.machine, part, StationInstruments.same(LaserTracker(), part.station), unknowns)
        # One step: all of these estimates lie within 0.1 mm and 1 mrad, and the second order of that is below a micrometre.
        solution = solve(network, start, settled.setup, weight, steps=1)
        by_round, by_pose = (covariance_of(network, solution, weight, spread)[:count, :count] for spread in SPREADS)
        return solution.theta, by_round, by_pose

    splits = [np.arange(len(place)) < len(place) // 2]
    for seed in range(2):
        order = np.random.default_rng(seed).permutation(place.max()) + 1
        splits.append(np.isin(place, order[: len(order) // 2]))
    naive = 0
    for k, split in enumerate(splits):
        (one, one_round, one_pose), (two, two_round, two_pose) = (
            estimate(np.flatnonzero(half)) for half in (split, ~split)
        )
        difference, covariance = one - two, one_round + two_round
        held = np.abs(difference) < COVERAGE_FACTOR * np.sqrt(np.diag(covariance))
        # Of 16 intervals 12 or fewer hold in less than one case of a hundred (binomial; they are not independent).
        assert held.sum() >= stats.binom.ppf(0.01, count, 0.95)
        naive += int(np.sum(np.abs(difference) < COVERAGE_FACTOR * np.sqrt(np.diag(one_pose + two_pose))))
        if k > 0:
            # All together, correlations included; in time not, where the halves are other regions and the model has misfits in both.
            distance = float(difference @ np.linalg.solve(covariance, difference))
            assert stats.chi2.ppf(0.001, count) < distance < stats.chi2.isf(0.001, count)
    assert naive < 0.5 * count * len(splits)


# --- plates ---------------------------------------------------------------------------------------------------------------------

SCALES = ("E_XX", "E_YY")
SQUARENESS = "E_C0Y"


@pytest.fixture(scope="module")
def drill(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return Machine.load(plates.write_machine(tmp_path_factory.mktemp("drill")))


@pytest.fixture(scope="module")
def plate(drill: Machine, tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    holes = plates.holes_mm(folder("plates"))
    return Measurements.load(plates.write_table(holes, tmp_path_factory.mktemp("plate") / "plate.csv"), drill)


def straight(machine: Machine, *wanted: str) -> Unknowns:
    """Return scales as straight lines, and the squareness: the model of the publication, but with a scale for each axis."""
    ranges = {f"E_{axis.name * 2}": (axis.lower or 0.0, axis.upper or 0.0) for axis in machine.axes}
    curves = [CurveSpace(name, POWER, ranges[name], first=1, count=2) for name in SCALES if name in wanted]
    return Unknowns(machine, curves, [name for name in wanted if name == SQUARENESS])


def scale_ppm(calibration: Calibration) -> tuple[float, float]:
    """Return one scale from the mean lines of E_XX and E_YY, weighted by their covariance, and its standard uncertainty."""
    names, rows = [], []
    for name in SCALES:
        curve = calibration.curves[name]
        u, w = np.polynomial.legendre.leggauss(40)
        half = (curve.domain[1] - curve.domain[0]) / 2.0
        # µm per mm is 1e3 ppm; the mean line of u^k has the slope 3/2 ∫ u^k u du.
        rows.append([1e3 / half * 1.5 * float(np.sum(w * u**k * u)) for k in range(len(curve.coefficients))])
        names.append([f"{name}[{k}]" for k in range(len(curve.coefficients))])
    values = [np.dot(row, calibration.curves[name].coefficients) for row, name in zip(rows, SCALES, strict=True)]
    matrix = np.zeros((2, len(rows[0]) + len(rows[1])))
    matrix[0, : len(rows[0])], matrix[1, len(rows[0]) :] = rows
    covariance = matrix @ calibration.covariance.of([*names[0], *names[1]]).matrix @ matrix.T
    weight = np.linalg.solve(covariance, np.ones(2))
    return float(weight @ values / weight.sum()), float(weight.sum() ** -0.5)


def test_a_plate_shows_scale_and_squareness_as_published(drill: Machine, plate: Measurements) -> None:
    """−34.6 ± 0.7 ppm and 64.3 ± 1.4 µrad, 10.8 → 5.2 µm RMS in the plane; either alone gives 8.3 or 8.8 µm.

    The published uncertainties are of ordinary least squares with the residuals' own variance; ours are from the variation between
    holes, each with its own.
    """
    left = {}
    for wanted in ((), SCALES, (SQUARENESS,), (*SCALES, SQUARENESS)):
        network, solution = fitted(drill, plate, straight(drill, *wanted))
        left[wanted] = 1e3 * rms_mm(1e3 * network.residuals_m(solution.theta, solution.setup, np.arange(len(plate))))
    # Printed to 0.1 µm.
    assert left[()] == pytest.approx(10.8, abs=0.05)
    assert left[SCALES] == pytest.approx(8.3, abs=0.05)
    assert left[SQUARENESS,] == pytest.approx(8.8, abs=0.05)
    assert left[*SCALES, SQUARENESS] == pytest.approx(5.2, abs=0.05)
    unknowns = network.unknowns
    covariance = covariance_of(network, solution, np.ones(len(plate)), "between poses")[
        : len(unknowns), : len(unknowns)
    ]
    calibration, _ = unknowns.calibration(solution.theta, range(len(unknowns)), "test", covariance)
    scale, u_scale = scale_ppm(calibration)
    u_square = float(np.sqrt(calibration.covariance.of([SQUARENESS]).matrix[0, 0]))
    assert scale == pytest.approx(-34.6, abs=0.7)
    assert calibration.squareness[SQUARENESS] == pytest.approx(64.3, abs=1.4)
    # The same data and nearly the same noise: robust and ordinary uncertainties differ by the unevenness of the holes.
    assert u_scale == pytest.approx(0.7, rel=0.25)
    assert u_square == pytest.approx(1.4, rel=0.25)


def test_the_squareness_of_the_plate_has_the_sign_of_the_contract(drill: Machine, plate: Measurements) -> None:
    """E_C0Y rotates Y right-handed, E_XY −= y·E_C0Y: the published number is the shear x += s·y, so its sign is opposite."""
    holes = plates.holes_mm(folder("plates"))
    error, meant = holes[:, :2] - holes[:, 2:], np.column_stack([holes[:, 2:], np.ones(len(holes))])
    (_, by_x), (by_y, _) = np.linalg.lstsq(meant, error, rcond=None)[0][:2]
    turned_x, turned_y = by_x * 1e6, -by_y * 1e6
    _, solution = fitted(drill, plate, straight(drill, *SCALES, SQUARENESS))
    # Rotations of 70 µrad and scales of 35 ppm interact at second order only: 1e-3 of a µrad.
    assert solution.theta[-1] == pytest.approx(turned_y - turned_x, abs=0.01)


def test_the_plate_is_identified_with_curves_of_any_degree(drill: Machine, plate: Measurements) -> None:
    """`identify` as a user calls it, without a given model: the mean lines agree with the published scale and squareness."""
    wanted = (*SCALES, SQUARENESS)
    found = identify(plate, drill, wanted=lambda name: name in wanted, spread="between poses")
    scale, u_scale = scale_ppm(found.calibration)
    u_square = float(np.sqrt(found.calibration.covariance.of([SQUARENESS]).matrix[0, 0]))
    assert found.converged
    assert not found.set_aside
    assert abs(scale + 34.6) < COVERAGE_FACTOR * u_scale
    assert abs(found.calibration.squareness[SQUARENESS] - 64.3) < COVERAGE_FACTOR * u_square
    assert u_scale < 1.5
    assert u_square < 2.0
    # Degrees above one are chosen because they predict held-out holes.
    assert rms_mm(found.residual_mm[found.used]) < 5.1e-3


def test_too_few_rounds_have_no_scatter(drill: Machine, plate: Measurements) -> None:
    """All holes are one round: the variation between rounds cannot be estimated, which the message states."""
    with pytest.raises(InputError, match="too few rounds"):
        identify(plate, drill, wanted=lambda name: name == SQUARENESS, spread="between rounds")


def test_a_station_that_read_a_plane_is_placed_by_it(drill: Machine, tmp_path: Path) -> None:
    """Holes of a known machine, measured from a known place, without noise: z empty, and everything else is identified."""
    grid = np.array([[x, y] for x in np.linspace(-300, 300, 9) for y in np.linspace(-240, 240, 8)])
    scale, squareness, turn, shift = np.array([40e-6, -25e-6]), 60e-6, 0.7, np.array([120.0, -45.0])
    actual = grid * (1.0 + scale)
    actual[:, 0] -= squareness * grid[:, 1]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    read = (actual - shift) @ rotation
    data = Measurements.load(plates.write_table(np.hstack([read, grid]), tmp_path / "plane.csv"), drill)
    network, solution = fitted(drill, data, straight(drill, *SCALES, SQUARENESS))
    calibration, _ = network.unknowns.calibration(solution.theta, range(3), "test", None)
    # Chain: T_x E_x T_y E_y: a shear of 6e-5 times a scale of 4e-5 is 2e-3 µrad.
    assert calibration.squareness[SQUARENESS] == pytest.approx(60.0, abs=0.01)
    for name, expected, half in (("E_XX", 40.0, 320.0), ("E_YY", -25.0, 260.0)):
        assert calibration.curves[name].coefficients[1] * 1e3 / half == pytest.approx(expected, abs=0.01)
    np.testing.assert_allclose(solution.setup.rotation[0][:2, :2], rotation, atol=1e-7)
    np.testing.assert_allclose(solution.setup.origin[0][:2] * 1e3, shift, atol=1e-4)


@pytest.mark.slow
def test_a_plate_imported_with_its_program_foretells_the_other_half(tmp_path: Path) -> None:
    """Every third hole of the plate, as a part with a program (its order is that of the file; the real one is not known).

    Scales and squareness from half of the holes predict the other half: 7.9 to 3.6 µm a coordinate of all holes; plain least squares
    5.2 µm in the plane (3.7 a coordinate); squareness as published.
    """
    from twin.compensation.programs.prepared import Options
    from twin.nc import read_program
    from twin.part.features import PartDrawing
    from twin.part.measured import import_part

    holes = plates.holes_mm(folder("plates"))[::3]
    urdf = Path(__file__).parents[2] / "urdf"
    (tmp_path / "xyzbc_trunnion.urdf").write_text((urdf / "xyzbc_trunnion.urdf").read_text())
    wide = (urdf / "xyzbc_trunnion.yaml").read_text().replace("[-300, 300]", "[-330, 330]")
    (tmp_path / "mill.yaml").write_text(wide)
    machine = Machine.load(tmp_path / "mill.yaml")
    cut = "".join(f"G0 X{x:.3f} Y{y:.3f}\nG0 Z12.\nG1 Z2. F100\nG0 Z12.\n" for x, y in holes[:, 2:])
    (tmp_path / "plate.nc").write_text(f"G21 G90 G94\nG0 B0 C0\n{cut}M30\n")
    features = "".join(
        f"  H{i}: {{kind: hole, point: [{x}, {y}, 10], depth: 8, diameter: 2.167}}\n"
        for i, (x, y) in enumerate(holes[:, 2:])
    )
    (tmp_path / "plate.yaml").write_text(
        f"schema: twin.part/1\nunits: mm\ntools: [{{number: 1, diameter: 2.167}}]\nfeatures:\n{features}"
        "tolerances:\n  - {kind: position, of: H0, zone: 0.1, datums: [H1]}\n"
    )
    rows = [f"H{i},{X},{Y},{x},{y},{plates.U_MM}" for i, (x, y, X, Y) in enumerate(holes)]
    (tmp_path / "cmm.csv").write_text("\n".join(["name,nom x,nom y,meas x,meas y,u", *rows, ""]))
    part, read = PartDrawing(tmp_path / "plate.yaml"), read_program(tmp_path / "plate.nc")
    data = import_part(tmp_path / "cmm.csv", part, read, machine, Options(tool_length_mm=0.0)).measurements
    first = np.repeat(np.random.default_rng(1).random(len(holes)) < 0.5, 2)
    wanted = (*SCALES, SQUARENESS)
    calibration = identify(data.select(np.flatnonzero(first)), machine, wanted=lambda name: name in wanted).calibration
    u = float(np.sqrt(calibration.covariance.of([SQUARENESS]).matrix[0, 0]))
    assert abs(calibration.squareness[SQUARENESS] - 64.3) < COVERAGE_FACTOR * np.hypot(u, 1.4)

    def left_um(errors: Calibration) -> float:
        """Return the RMS of the other half, with its own place."""
        other = data.select(np.flatnonzero(~first))
        point = Kinematics(machine, errors, tool_length_mm=0.0).forward(other.positions).point_mm
        off = other.point_mm[:, 0] - (other.along * point).sum(axis=1)
        turn = (other.along * np.cross([0.0, 0.0, 1.0], other.positions[:, :3])).sum(axis=1)
        placed = np.column_stack([other.along[:, :2], turn])
        return 1e3 * float(np.sqrt(np.mean((off - placed @ np.linalg.lstsq(placed, off, rcond=None)[0]) ** 2)))

    assert left_um(Calibration.zero(machine)) > 7.0
    assert left_um(calibration) < 4.0
