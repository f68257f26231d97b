"""Orientation errors in reports: tilt of the tool axis, rotation of the table; checked with SciPy and an independent DMU 50 model."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from tests.model.errors import random_calibration
from tests.truth.reference import dmu50_pose
from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin.compensation import Compensator, Options
from twin.compensation.programs.execute import execute
from twin.compensation.programs.follow import follow
from twin.compensation.programs.words import Setup, WordSpace
from twin.identification.result import TableTilt
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program
from twin.numerics.covariance import Covariance
from twin.numerics.spatial import fused_angles
from twin.tool.forward import Kinematics, Poses, angle_between_rad
from twin.tool.uncertainty import error_budget

COMMANDS = np.array(
    [[250, 225, -200, 0, 0], [100, 300, -50, 37, 211], [400, 10, -390, 90, -30], [20, 440, -7, 180, 90]], dtype=float
)
"""The last with the tool level: it lies in the work frame's xy-plane."""


def located(machine: Machine, **location: float) -> Calibration:
    return replace(Calibration.zero(machine), location=MappingProxyType(location))


def test_the_tool_axis_against_the_second_machine(dmu50: Machine) -> None:
    calibration = random_calibration(dmu50, np.random.default_rng(1))
    real, drawn = Kinematics(dmu50, calibration), Kinematics(dmu50, Calibration.zero(dmu50))
    tilt = real.forward(COMMANDS).tilt_urad(drawn.forward(COMMANDS))
    frames = real.error_frames(COMMANDS)
    names = [("L_" if frame.role == "location" else "") + frame.axis for frame in dmu50.frames]
    for command, errors, found in zip(COMMANDS, frames, tilt, strict=True):
        q = command * [1, 1, 1, np.pi / 180, np.pi / 180]
        scaled = {name: six * [1e3, 1e3, 1e3, 1, 1, 1] for name, six in zip(names, errors, strict=True)}
        reached, meant = dmu50_pose(q, scaled)[:3, 2], dmu50_pose(q, {})
        # Eq. 5 and 6 of the paper, in the nominal tool frame.
        z = meant[:3, :3].T @ reached
        expected = np.array([np.arctan(-z[1] / z[2]), np.arctan(z[0] / z[2])]) * 1e6
        assert np.abs(expected).max() > 10.0
        assert np.abs(found - expected).max() <= 1e-6  # roundings of a chain, 1e-15, in µrad: 1e-9
    assert tilt.shape == (4, 2)
    assert not tilt.flags.writeable


def test_a_tilt_is_the_angle_in_two_parts(dmu50: Machine) -> None:
    """√(x² + y²) equals the angle between the axes, to third order."""
    calibration = random_calibration(dmu50, np.random.default_rng(2), 300.0)
    meant = Kinematics(dmu50, Calibration.zero(dmu50)).forward(COMMANDS)
    reached = Kinematics(dmu50, calibration).forward(COMMANDS)
    angle = angle_between_rad(reached.axis, meant.axis) * 1e6
    assert np.hypot(*reached.tilt_urad(meant).T) == pytest.approx(angle, rel=1e-6)


def test_a_turn_about_the_tool_itself_is_no_tilt(dmu50: Machine) -> None:
    poses = Kinematics(dmu50).forward(COMMANDS)
    spun = Poses(poses.point_mm, poses.rotation @ Rotation.from_rotvec([0.0, 0.0, 0.3]).as_matrix())
    assert np.abs(spun.tilt_urad(poses)).max() <= 1e-9
    with pytest.raises(InputError, match="number of nominal poses differs"):
        poses.tilt_urad(Poses(poses.point_mm[:2], poses.rotation[:2]))


def work_turn_urad(real: Kinematics, positions: np.ndarray) -> np.ndarray:
    """Return (n, 3) µrad: rotation of the table from its nominal orientation, by Pinocchio."""
    machine, found = real.machine, []
    for q, errors in zip(positions, real.error_frames(positions), strict=True):
        turns = []
        for e in (errors, 0.0 * errors):
            data = machine.model.createData()
            pin.framesForwardKinematics(machine.model, data, machine.configuration(q * machine.scale, e))
            turns.append(data.oMf[machine.work_frame].rotation.copy())
        found.append(fused_angles(turns[0] @ turns[1].T) * 1e6)
    return np.array(found)


def test_the_sign_is_that_of_a_right_handed_turn(dmu50: Machine) -> None:
    """The table tilted by +10 µrad about x gives a tool tilt of −10 about x, at B = C = 0."""
    drawn = Kinematics(dmu50, Calibration.zero(dmu50)).forward(COMMANDS[:1])
    for name, expected in (("E_A0C", [-10.0, 0.0]), ("E_B0C", [0.0, -10.0])):
        real = Kinematics(dmu50, located(dmu50, **{name: 10.0}))
        assert real.forward(COMMANDS[:1]).tilt_urad(drawn)[0] == pytest.approx(expected, abs=1e-6)
        assert work_turn_urad(real, COMMANDS[:1])[0, :2] == pytest.approx([-one for one in expected], abs=1e-6)


def test_rotation_of_the_table(dmu50: Machine) -> None:
    """With SciPy, from the kinematic chain: B's axis lies in the yz-plane at 45°, so E_B also rotates the table about z."""
    a_b, b_b, a_c, b_c = 130.0, -220.0, 90.0, 310.0
    calibration = located(dmu50, E_A0B=a_b, E_B0B=b_b, E_A0C=a_c, E_B0C=b_c, E_X0C=50.0)
    lean = Rotation.from_euler("x", 45.0, degrees=True)
    turn = lean * Rotation.from_rotvec([a_b * 1e-6, b_b * 1e-6, 0.0]) * lean.inv()
    turn = turn * Rotation.from_rotvec([a_c * 1e-6, b_c * 1e-6, 0.0])
    _, y, z = turn.as_matrix().T
    expected = np.array([np.arctan(-z[1] / z[2]), np.arctan(z[0] / z[2]), np.arctan2(-y[0], y[1])]) * 1e6
    assert work_turn_urad(Kinematics(dmu50, calibration), np.array([[250.0, 225, 0, 0, 0]]))[0] == pytest.approx(
        expected, abs=1e-6
    )
    found = TableTilt.of(calibration)
    assert found is not None
    assert found.fused_urad == pytest.approx(expected, abs=1e-6)
    assert found.at == (("B", 0.0), ("C", 0.0))
    assert found.missing == ()
    assert np.isnan(found.u_urad).all()
    assert "±" not in found.to_text(2.0)


def test_uncertainty_of_the_rotation_of_the_table(dmu50: Machine) -> None:
    """The covariance is propagated: small rotations add, E_B0B in equal parts about y and z."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    names = ("E_A0B", "E_B0B", "E_B0C")
    known = Covariance(names, root @ root.T)
    found = TableTilt.of(replace(located(dmu50, E_A0B=5.0, E_B0B=-7.0, E_B0C=11.0), joint=known))
    assert found is not None
    half = np.sqrt(0.5)
    rates = np.array([[1.0, 0.0, 0.0], [0.0, half, 1.0], [0.0, half, 0.0]])
    assert found.fused_urad == pytest.approx(rates @ [5.0, -7.0, 11.0], rel=1e-4)  # second order: 1e-5
    assert found.covariance == pytest.approx(rates @ known.matrix @ rates.T, rel=1e-4, abs=1e-4)
    assert found.u_urad == pytest.approx(np.sqrt(np.diag(found.covariance)))
    assert found.missing == ("E_A0C",)
    assert found.to_text(2.0).endswith("without E_A0C")
    assert TableTilt.of(Calibration.zero(dmu50)) is None


def test_tilt_of_the_tool_axis_in_the_error_budget(dmu50: Machine) -> None:
    """C's axis tilted by 10 µrad about x. B rotates that about (0, −1, 1)/√2: x keeps cos B of it, y gets sin B/√2, over 0 … 180°."""
    calibration = replace(located(dmu50, E_A0C=10.0), squareness=MappingProxyType({"E_C0Y": 30.0}))
    rows, classes = error_budget(dmu50, calibration)
    by_name = {row.name: row for row in (*rows, *classes)}
    # 2000 values of B, one in every 0.09°: a mean of sin² over them is right to 1e-3 and better.
    assert by_name["E_A0C"].tilt_rms_urad == pytest.approx((10.0 * 0.5**0.5, 5.0), rel=1e-3)
    assert by_name["E_A0C"].tilt_max_urad == pytest.approx((10.0, 10.0 * 0.5**0.5), rel=1e-3)
    assert max(by_name["E_C0Y"].tilt_max_urad) <= 1e-8  # squareness moves the point and turns nothing: roundings, µrad
    assert by_name["all"].tilt_rms_urad == by_name["R-POR"].tilt_rms_urad == by_name["E_A0C"].tilt_rms_urad


def test_tilt_of_the_tool_axis_in_report_and_execution(dmu50: Machine) -> None:
    """A table tilted by 20 µrad about x at B = 0: at B, √(1 − sin²B / 2) of it is tilt, the rest a rotation about the tool."""
    read, dialect = read_program(find_program("cone_frustum.nc"))
    calibration = located(dmu50, E_A0C=20.0)
    report = Compensator(dmu50, calibration, Options()).compensate(read, dialect).report
    for side in (report.before, report.after):
        assert np.hypot(*side.tilt_rms_urad) == pytest.approx(side.rms_urad, rel=1e-6)
        assert max(side.tilt_max_urad) <= side.max_urad * (1.0 + 1e-6)
    x, y = report.before.tilt_rms_urad
    assert f"about x / y of the tool frame, RMS: before {x:.1f} / {y:.1f}" in report.to_text()
    assert tuple(report.to_dict()["before"]["tilt_rms_urad"]) == report.before.tilt_rms_urad
    space = WordSpace(dmu50, Setup(), None)
    path = follow(read, dialect.moves(read, space.axes, tcp=False), space)
    run = execute(read, path, space, Kinematics(dmu50, calibration))
    assert run.tilt_urad.shape == (len(run.positions), 2)
    share = np.sqrt(1.0 - np.sin(np.radians(run.positions[:, 3])) ** 2 / 2.0)
    assert np.hypot(*run.tilt_urad.T) == pytest.approx(20.0 * share, rel=1e-4)  # second order: 20 µrad of it
