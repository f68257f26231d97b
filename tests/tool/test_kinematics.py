"""Three formulations of the machine with errors agree; without errors they equal Sørby's closed form."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

from tests.truth.reference import dmu50_pose, sorby_forward, sorby_inverse
from twin._common.errors import InputError
from twin.compute.along import BatchFunction
from twin.machine.chain import chain_function, tip_function
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import Reversal
from twin.model.motion_curve import Curve
from twin.tool.forward import Kinematics

POSES = 10_000
MM_TOLERANCE = 1e-9  # contract: agreement promised to users
RAD_TOLERANCE = 1e-12


def random_commands(machine: Machine, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return random commands over the whole range, C over three turns."""
    lower = [axis.lower if axis.lower is not None else -540.0 for axis in machine.axes]
    upper = [axis.upper if axis.upper is not None else 540.0 for axis in machine.axes]
    return rng.uniform(lower, upper, (n, len(machine.axes)))


def reference_pose(machine: Machine, q: np.ndarray, errors: np.ndarray, length: float) -> np.ndarray:
    """Return the reference pose for commands in mm and degrees, error frames (frames, 6) and tool length in metres and radians."""
    frames = {
        ("L_" if frame.role == "location" else "") + frame.axis: errors[k] * [1e3, 1e3, 1e3, 1, 1, 1]
        for k, frame in enumerate(machine.frames)
    }
    return dmu50_pose(q * [1, 1, 1, np.pi / 180, np.pi / 180], frames, length * 1e3)


@pytest.fixture(scope="module")
def cases(dmu50: Machine) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return random_commands(dmu50, POSES, rng), rng.uniform(-1e-3, 1e-3, (POSES, len(dmu50.frames), 6))


@pytest.mark.slow
def test_three_formulations_agree(dmu50: Machine, cases: tuple[np.ndarray, np.ndarray]) -> None:
    """Errors to 1 mm and 1 mrad in every component of every frame, locations included."""
    q, errors = cases
    length = 0.123
    rotation, point = BatchFunction(chain_function(dmu50))(
        q * dmu50.scale, errors.reshape(POSES, -1), np.array([length])
    )
    casadi_rotation = rotation.reshape(-1, 3, 3).transpose(0, 2, 1)
    data = dmu50.model.createData()
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))
    worst_mm = worst_rad = 0.0
    for i in range(POSES):
        pin.framesForwardKinematics(dmu50.model, data, dmu50.configuration(q[i] * dmu50.scale, errors[i]))
        pinocchio = (data.oMf[dmu50.work_frame].actInv(data.oMf[dmu50.tool_frame]) * tip).homogeneous
        reference = reference_pose(dmu50, q[i], errors[i], length)
        for other_rotation, other_mm in (
            (casadi_rotation[i], point[i] * 1e3),
            (pinocchio[:3, :3], pinocchio[:3, 3] * 1e3),
        ):
            worst_mm = max(worst_mm, float(np.abs(other_mm - reference[:3, 3]).max()))
            worst_rad = max(worst_rad, float(np.abs(other_rotation - reference[:3, :3]).max()))
    assert worst_mm <= MM_TOLERANCE
    assert worst_rad <= RAD_TOLERANCE


def test_without_errors_it_is_the_closed_form_both_ways(dmu50: Machine) -> None:
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=0.0)
    q = random_commands(dmu50, POSES, np.random.default_rng(2))
    poses = nominal.forward(q)
    from_centre = (q - [250, 225, -400, 0, 0]) * [1, 1, 1, np.pi / 180, np.pi / 180]
    closed = [sorby_forward(row) for row in from_centre]
    assert np.abs(poses.point_mm - [point for point, _ in closed]).max() <= MM_TOLERANCE
    assert np.abs(poses.axis - [axis for _, axis in closed]).max() <= RAD_TOLERANCE
    for i in range(0, POSES, 7):
        back = sorby_inverse(poses.point_mm[i], poses.axis[i])
        again, _ = sorby_forward(back)
        # arccos near k = 1 and k = 1/2 loses half the digits of B: compare where the closed form is well conditioned.
        if 1.0 < q[i, 3] < 179.0:
            assert np.abs(again - poses.point_mm[i]).max() <= MM_TOLERANCE
            turns = (back[4] - from_centre[i, 4]) / (2 * np.pi)
            assert np.abs(back[:3] - from_centre[i, :3]).max() <= 1e-9
            assert abs(back[3] - from_centre[i, 3]) <= 1e-12 / np.sin(np.radians(1.0))
            assert abs(turns - round(turns)) <= 1e-11


def test_the_calibration_drives_the_frames(dmu50: Machine, calibration: Calibration) -> None:
    """Curves, squareness and location as the conventions define them, evaluated independently."""
    located = Calibration(
        dmu50,
        "test",
        calibration.curves,
        MappingProxyType({"E_C0Y": 40.0, "E_A0Z": -25.0, "E_B0Z": 15.0}),
        MappingProxyType({"E_X0C": 12.0, "E_Y0C": -7.0, "E_A0C": 30.0, "E_B0B": -20.0}),
    )
    kinematics = Kinematics(dmu50, located, tool_length_mm=80.0)
    q = random_commands(dmu50, 200, np.random.default_rng(3))
    poses = kinematics.forward(q)

    def curve(name: str, position: float) -> float:
        c = calibration.curves[name]
        if c.basis == "fourier":
            angle = np.radians(position)
            terms = [1.0] + [f(k * angle) for k in range(1, len(c.coefficients)) for f in (np.cos, np.sin)]
            return sum(a * t for a, t in zip(c.coefficients, terms, strict=False))
        u = (2 * position - sum(c.domain)) / (c.domain[1] - c.domain[0])
        return float(np.polyval(c.coefficients[::-1], u))

    for i, row in enumerate(q):
        errors = {}
        for k, axis in enumerate("XYZBC"):
            six = np.array([curve(f"E_{letter}{axis}", row[k]) for letter in "XYZABC"])
            errors[axis] = six * [1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6]
        errors["Y"][0] -= row[1] * 40.0e-6
        errors["Z"][0] += row[2] * 15.0e-6
        errors["Z"][1] -= row[2] * -25.0e-6
        errors["L_C"] = np.array([12e-3, -7e-3, 0, 30e-6, 0, 0])
        errors["L_B"] = np.array([0, 0, 0, 0, -20e-6, 0])
        reference = dmu50_pose(row * [1, 1, 1, np.pi / 180, np.pi / 180], errors, 80.0)
        assert np.abs(poses.point_mm[i] - reference[:3, 3]).max() <= MM_TOLERANCE
        assert np.abs(poses.rotation[i] - reference[:3, :3]).max() <= RAD_TOLERANCE


def test_sensitivities_are_the_derivatives(dmu50: Machine, calibration: Calibration) -> None:
    """Central differences of the reference for commands; Pinocchio's own Jacobian columns for every error motion."""
    kinematics = Kinematics(dmu50, calibration, tool_length_mm=60.0)
    q = random_commands(dmu50, 20, np.random.default_rng(4))
    q[:, :3] = np.clip(q[:, :3], [10, 10, -390], [490, 440, -10])  # room for the differences
    q[:, 3] = np.clip(q[:, 3], 5, 175)
    found = kinematics.sensitivities(q)
    frames = kinematics.error_frames(q)
    data = dmu50.model.createData()
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.06]))
    for i in range(len(q)):
        for k in range(5):
            h = 1e-2 if k < 3 else 1e-3  # mm, degrees: truncation and rounding both below 1e-8
            step = np.zeros(5)
            step[k] = h
            plus, minus = kinematics.forward(q[i] + step), kinematics.forward(q[i] - step)
            scale = 2 * h * dmu50.scale[k]
            linear = (plus.point_mm[0] - minus.point_mm[0]) * 1e-3 / scale
            spin = pin.log3(plus.rotation[0] @ minus.rotation[0].T) / scale
            assert np.abs(found.command[i, :3, k] - linear).max() < 1e-6
            assert np.abs(found.command[i, 3:, k] - spin).max() < 1e-6
        configuration = dmu50.configuration(q[i] * dmu50.scale, frames[i])
        pin.computeJointJacobians(dmu50.model, data, configuration)
        pin.updateFramePlacements(dmu50.model, data)
        work, tool = data.oMf[dmu50.work_frame], data.oMf[dmu50.tool_frame] * tip
        for k, frame in enumerate(dmu50.frames):
            joint = dmu50.model.joints[frame.joint]
            six = frames[i, k]
            for component in range(6):
                rate = np.zeros(6)  # the joint's own velocity for a unit rate of this component
                if component < 3:
                    rate[:3] = pin.exp3(six[3:]).T[:, component]
                else:
                    rate[3:] = pin.Jexp3(six[3:])[:, component - 3]
                velocity = np.zeros(dmu50.model.nv)
                velocity[joint.idx_v : joint.idx_v + 6] = rate
                spatial = data.J @ velocity  # of the joint, as if everything behind it moved along
                point = tool.translation
                side = frame.joint in dmu50.model.supports[dmu50.model.frames[dmu50.tool_frame].parentJoint].tolist()
                sign = 1.0 if side else -1.0
                linear = sign * work.rotation.T @ (spatial[:3] + np.cross(spatial[3:], point))
                spin = sign * work.rotation.T @ spatial[3:]
                column = found.error[i, :, 6 * k + component]
                assert np.abs(column - np.concatenate([linear, spin])).max() < 1e-12


@pytest.mark.parametrize("name", ["dmu50", "xyzbc_trunnion"])
def test_travel_is_the_point_with_its_derivatives(name: str) -> None:
    """Both as by the functions for whole poses; a reversal and the tool's length count."""
    machine = Machine.load(name)
    rng = np.random.default_rng(12)
    own = Calibration.zero(machine)
    kinematics = Kinematics(machine, replace(own, extra=(Reversal(machine.by_name["Y"], 30.0),)), tool_length_mm=80.0)
    q = random_commands(machine, 40, rng)
    sides = rng.choice([-1.0, 0.0, 1.0], q.shape)
    point, by = kinematics.travel(q, sides)
    assert point == pytest.approx(kinematics.forward(q, sides).point_mm, abs=1e-9)
    assert by == pytest.approx(kinematics.sensitivities(q, sides).command[:, :3], abs=1e-12)


def test_positions_are_checked(dmu50: Machine, calibration: Calibration) -> None:
    kinematics = Kinematics(dmu50, calibration)
    good = [250.0, 225.0, -200.0, 30.0, 1000.0]
    assert len(kinematics.forward(good)) == 1
    for column, value, words in ((0, 500.1, "0 to 500 mm"), (3, -0.1, "0 to 180 deg"), (2, np.nan, "finite")):
        bad = list(good)
        bad[column] = value
        with pytest.raises(InputError, match=words):
            kinematics.forward(bad)
    with pytest.raises(InputError, match="X, Y, Z, B, C"):
        kinematics.forward([1.0, 2.0])


def test_an_unlimited_axis_is_wrapped(dmu50: Machine) -> None:
    """A power curve of C, which is not periodic itself."""
    curve = Curve("E_ZC", "um", (0.0, 360.0), "power", (0.0, 10.0))
    calibration = Calibration(
        dmu50, "test", MappingProxyType({"E_ZC": curve}), MappingProxyType({}), MappingProxyType({})
    )
    kinematics = Kinematics(dmu50, calibration)
    c = np.array([-350.0, 10.0, 370.0, 3610.0])
    q = np.column_stack([np.tile([250.0, 225.0, -200.0, 0.0], (4, 1)), c])
    raised = kinematics.error_frames(q)[:, -1, 2] * 1e6
    assert np.allclose(raised, curve(10.0), atol=1e-9)


def test_results_are_read_only(dmu50: Machine, calibration: Calibration) -> None:
    poses = Kinematics(dmu50, calibration).forward([250, 225, -200, 0, 0])
    with pytest.raises(ValueError, match="read-only"):
        poses.point_mm[0, 0] = 1.0


def test_poses_with_given_errors_are_those_of_the_chain(dmu50: Machine, cases: tuple[np.ndarray, np.ndarray]) -> None:
    q, errors = cases[0][:50], cases[1][:50]
    found = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=123.0).with_errors(q, errors.reshape(50, -1))
    for i in range(50):
        expected = reference_pose(dmu50, q[i], errors[i], 0.123)
        assert found.point_mm[i] == pytest.approx(expected[:3, 3], abs=MM_TOLERANCE)
        assert found.rotation[i] == pytest.approx(expected[:3, :3], abs=RAD_TOLERANCE)


def test_tip_and_axis_are_those_of_the_chain(dmu50: Machine, cases: tuple[np.ndarray, np.ndarray]) -> None:
    q, errors = cases
    inputs = q * dmu50.scale, errors.reshape(POSES, -1), np.array([0.123])
    rotation, point = BatchFunction(chain_function(dmu50))(*inputs)
    tip, axis = BatchFunction(tip_function(dmu50))(*inputs)
    assert np.abs(tip - point).max() * 1e3 <= MM_TOLERANCE
    assert np.abs(axis - rotation[:, 6:]).max() <= RAD_TOLERANCE


def test_some_of_the_errors(dmu50: Machine, calibration: Calibration) -> None:
    """As with the calibration of these errors alone, approach directions included."""
    extra = (Reversal(dmu50.by_name["X"], 6.0), Reversal(dmu50.by_name["C"], -9.0))
    whole = replace(calibration, extra=extra)
    machine = Kinematics(dmu50, whole, tool_length_mm=80.0)
    rng = np.random.default_rng(4)
    q, sides = random_commands(dmu50, 50, rng), rng.choice([-1.0, 1.0], (50, 5))
    q[:, 4] %= 360.0
    names = [effect.name for effect in whole.effects]
    for chosen in [set(), {"E_XX", "E_C0Y"}, set(names) - {"reversal:X", "reversal:C"}, {"reversal:C"}]:
        some = machine.where(chosen.__contains__)
        alone = Kinematics(dmu50, whole.where(chosen.__contains__), tool_length_mm=80.0)
        assert [effect.name for effect in some.calibration.effects] == [name for name in names if name in chosen]
        assert some.directed is alone.directed is any(name.startswith("reversal") for name in chosen)
        found, expected = some.forward(q, sides), alone.forward(q, sides)
        assert np.array_equal(found.point_mm, expected.point_mm) and np.array_equal(found.rotation, expected.rotation)
    assert machine.where(lambda name: True) is machine


def test_positions_by_axis() -> None:
    machine = Machine.load("dmu50")
    kinematics = Kinematics(machine, tool_length_mm=120)
    rows = kinematics.forward([[250, 225, -200, 30, 45], [260, 225, -200, 30, 45]]).point_mm
    by_axis = {"C": 45, "X": [250, 260], "Y": 225, "Z": -200, "B": 30}
    np.testing.assert_array_equal(kinematics.forward(by_axis).point_mm, rows)
    np.testing.assert_array_equal(kinematics.forward(pd.DataFrame(by_axis)).point_mm, rows)
    for positions, why in (
        ({"X": 250}, "an axis without position: 'Y, Z, B, C'; expected one number or column for each of X, Y, Z, B, C"),
        ({**by_axis, "A": 1}, "positions of no axis of this machine: 'A'"),
        ({**by_axis, "Y": [1, 2, 3]}, "positions by axis differ in number"),
        ("X250", "positions are not rows of numbers: 'X250'"),
    ):
        with pytest.raises(InputError, match=why):
            kinematics.forward(positions)
