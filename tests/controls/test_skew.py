"""Skew settings: a skewed machine in plain numpy executes moves by each firmware's own formula, and what it makes is square."""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, ModuleType, SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin._common.errors import InputError
from twin.compensation.tables import Request, account_of, make
from twin.controls import read_tables
from twin.controls.formats.skew import skew_lengths
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.tool.forward import Kinematics

SQUARENESS = {"E_C0Y": 2400.0, "E_B0Z": -1300.0, "E_A0Z": 900.0}
SCALE = {"X": 1.5e-3, "Y": -0.8e-3, "Z": 0.6e-3}
CORNERS = np.array([[x, y, z] for x in (20.0, 420.0) for y in (30.0, 330.0) for z in (-250.0, -50.0)])
Moves = Callable[[str], np.ndarray]


def skewed(machine: Machine, *, scaled: bool) -> Calibration:
    curves = {}
    for name in "XYZ" if scaled else "":
        low, high = machine.by_name[name].domain
        size = SCALE[name] * 1e3
        values = (size * 0.5 * (low + high), size * 0.5 * (high - low))
        curves[f"E_{name}{name}"] = Curve(f"E_{name}{name}", "um", (low, high), "power", values)
    zero = Calibration.zero(machine)
    return replace(zero, curves=MappingProxyType(curves), squareness=MappingProxyType(dict(SQUARENESS)))


def tool(motors: np.ndarray, *, scaled: bool) -> np.ndarray:
    """Return where the tool of a machine is whose motors are at (n, 3): Y leans by E_C0Y, Z by E_B0Z and E_A0Z (ISO 230-1 signs)."""
    c, b, a = (1e-6 * SQUARENESS[name] for name in ("E_C0Y", "E_B0Z", "E_A0Z"))
    x, y, z = motors.T
    own = [SCALE[name] if scaled else 0.0 for name in "XYZ"]
    return np.column_stack([x * (1.0 + own[0]) - c * y + b * z, y * (1.0 + own[1]) - a * z, z * (1.0 + own[2])])


def klipper_move(text: str) -> Callable[[np.ndarray], np.ndarray]:
    """Klipper, skew_correction: x less xy of y and (xz − xy yz) of z; y less yz of z. Marlin has the same expression."""
    xy, xz, yz = (float(re.findall(rf"^{one}_skew = (\S+)$", text, re.M)[0]) for one in ("xy", "xz", "yz"))
    return lambda q: np.column_stack(
        [q[:, 0] - xy * q[:, 1] - (xz - xy * yz) * q[:, 2], q[:, 1] - yz * q[:, 2], q[:, 2]]
    )


def marlin_move(text: str) -> Callable[[np.ndarray], np.ndarray]:
    xy, xz, yz = map(float, re.findall(r"^M852 I(\S+) J(\S+) K(\S+)$", text, re.M)[0])
    return klipper_move(f"xy_skew = {xy!r}\nxz_skew = {xz!r}\nyz_skew = {yz!r}\n")


def reprap_move(text: str) -> Callable[[np.ndarray], np.ndarray]:
    """RepRapFirmware, Move::AxisTransform: tangents are added, those of x from the y and z before."""
    s, x, y, z = map(float, re.findall(r"^M556 S(\S+) X(\S+) Y(\S+) Z(\S+)$", text, re.M)[0])
    return lambda q: np.column_stack([q[:, 0] + x / s * q[:, 1] + z / s * q[:, 2], q[:, 1] + y / s * q[:, 2], q[:, 2]])


def matrix_move(text: str) -> Callable[[np.ndarray], np.ndarray]:
    """matrixkins: joints = C · axes, row by row."""
    entries = [float(value) for value in re.findall(r"^setp matrixkins\.C_\w\w (\S+)$", text, re.M)]
    return lambda q: q @ np.reshape(entries, (3, 3)).T


FIRMWARE = {"klipper": klipper_move, "marlin": marlin_move, "reprapfirmware": reprap_move, "matrixkins": matrix_move}


def out_of_square(points: np.ndarray) -> float:
    """Return the largest deviation from a right angle between the edges of a block from its eight corners, rad."""
    x, y, z = points[4] - points[0], points[2] - points[0], points[1] - points[0]
    return max(abs(float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))) for a, b in ((x, y), (x, z), (y, z)))


@pytest.mark.parametrize("kind", FIRMWARE)
@pytest.mark.parametrize("scaled", [False, True])
def test_a_skewed_machine_makes_square_parts(kind: str, scaled: bool, dmu50: Machine) -> None:
    made = make(dmu50, skewed(dmu50, scaled=scaled), Request(kind, tool_length_mm=0.0))
    assert made.unmet == ()
    (text,) = made.files.values()
    motors = FIRMWARE[kind](text)(CORNERS)
    before, after = (out_of_square(tool(q, scaled=scaled)) for q in (CORNERS, motors))
    assert before > 2e-3
    # Settings of three numbers leave the scale: a sheared block with edges of other lengths stays square.
    assert after < 2e-8
    if kind == "matrixkins" or not scaled:
        off = tool(motors, scaled=scaled) - CORNERS
        assert np.abs(off).max() < 2e-6  # mm: nine digits of 400 mm


@pytest.mark.parametrize("name", ["dmu50", "trunnion_ac"])
@pytest.mark.parametrize("kind", FIRMWARE)
def test_also_where_the_workpiece_moves(kind: str, name: str) -> None:
    """The machine of the bundled file with Y in the table: the model's own point reaches the commands."""
    machine = Machine.load(name)
    calibration = skewed(machine, scaled=False)
    made = make(machine, calibration, Request(kind, tool_length_mm=0.0))
    (text,) = made.files.values()
    q = np.zeros((len(CORNERS), 5))
    q[:, :3] = CORNERS
    commands = q.copy()
    commands[:, :3] = FIRMWARE[kind](text)(CORNERS)
    real, meant = (
        Kinematics(machine, one, tool_length_mm=0.0).forward for one in (calibration, Calibration.zero(machine))
    )
    assert np.abs(real(q).point_mm - meant(q).point_mm).max() > 0.5
    assert np.abs(real(commands).point_mm - meant(q).point_mm).max() < 1e-5


def test_scale_is_left_to_the_steps(dmu50: Machine) -> None:
    """Multiplied by the factor in the comment, the steps per mm make the scale right."""
    texts = {kind: "".join(make(dmu50, skewed(dmu50, scaled=True), Request(kind)).files.values()) for kind in FIRMWARE}
    for axis, scale in SCALE.items():
        steps = re.findall(rf"steps per mm of {axis} \(M92\) by (\S+)", texts["marlin"])
        turn = re.findall(rf"rotation_distance of {axis} by (\S+)", texts["klipper"])
        # More steps for a millimetre: less motion. A motor that moves farther a turn than configured: more distance a turn.
        assert (1.0 + scale) * float(steps[0]) == pytest.approx(1.0, abs=2e-7)
        assert float(turn[0]) == pytest.approx(1.0 + scale, abs=2e-7)
    assert "scale" not in texts["matrixkins"]


def test_an_error_within_its_uncertainty_is_not_written(dmu50: Machine) -> None:
    from twin._common.arrays import read_only
    from twin.numerics.covariance import Covariance

    square = MappingProxyType({"E_C0Y": 100.0, "E_B0Z": 400.0})
    joint = Covariance(tuple(square), read_only(np.diag([90.0**2, 90.0**2])))
    calibration = replace(Calibration.zero(dmu50), squareness=square, joint=joint)
    made = make(dmu50, calibration, Request("klipper"))
    assert [one.name for one in made.unproven] == ["X by Y"]
    assert [one.content.name for one in made.tables] == ["X by Z"]
    shares = {one.name: one.share for one in account_of(made, calibration, calibration, {}).carried}
    assert shares["E_B0Z"] != "no"
    with pytest.raises(InputError, match="none of the 1 tables is shown to be an improvement"):
        make(dmu50, calibration.where(lambda name: name == "E_C0Y"), Request("klipper"))


def test_files_of_another_sense_are_told_apart(dmu50: Machine, tmp_path: Path) -> None:
    """A file with one sign reversed is not the correction of the calibration: read back, it differs by twice its size."""
    made = make(dmu50, skewed(dmu50, scaled=False), Request("marlin"))
    path = tmp_path / "skew.gcode"
    path.write_text(re.sub(r"I-", "I", made.files["skew.gcode"]))
    back, at = read_tables("marlin", [path], dmu50), {"X": 0.0, "Y": 400.0, "Z": 0.0}
    assert back.shift("X", at) == pytest.approx(-made.correction.shift("X", at), rel=1e-6)


@given(st.floats(-0.05, 0.05))
def test_the_lengths_of_set_skew(factor: float) -> None:
    """A parallelogram with that skew has these diagonals: y leans by `factor` towards x."""
    ac, bd, ad = skew_lengths(factor)
    up = ad * np.array([factor, 1.0]) / np.hypot(1.0, factor)
    along = np.array([ad, 0.0])
    assert ac == pytest.approx(float(np.linalg.norm(along + up)), abs=1e-9)
    assert bd == pytest.approx(float(np.linalg.norm(up - along)), abs=1e-9)


@pytest.fixture
def klipper() -> ModuleType:
    """Klipper's own module, from the folder in the environment variable ``KLIPPER``."""
    folder = os.environ.get("KLIPPER")
    path = Path(folder or ".") / "klippy" / "extras" / "skew_correction.py"
    if folder is None or not path.is_file():
        pytest.skip("the environment variable KLIPPER does not name a folder with Klipper's source")
    found = importlib.util.spec_from_file_location("skew_correction", path)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_klipper_itself(klipper: ModuleType, dmu50: Machine) -> None:
    """Klipper's module with the profile, and with the lengths of SET_SKEW: parts are square."""
    made = make(dmu50, skewed(dmu50, scaled=False), Request("klipper"))
    text = made.files["skew.cfg"]
    profile = {f"{one}_skew": float(re.findall(rf"^{one}_skew = (\S+)$", text, re.M)[0]) for one in ("xy", "xz", "yz")}
    command = re.findall(r"SET_SKEW XY=(\S+) XZ=(\S+) YZ=(\S+)", text)[0]
    lengths = [klipper.calc_skew_factor(*map(float, one.split(","))) for one in command]
    for factors in (list(profile.values()), lengths):
        own = klipper.PrinterSkew.__new__(klipper.PrinterSkew)
        own.xy_factor, own.xz_factor, own.yz_factor = factors
        sent: list[list[float]] = []
        own.next_transform = SimpleNamespace(move=lambda pos, speed, to=sent: to.append(pos))
        for corner in CORNERS:
            own.move([*corner.tolist(), 0.0], 50.0)
        assert out_of_square(tool(np.array(sent)[:, :3], scaled=False)) < 5e-8
