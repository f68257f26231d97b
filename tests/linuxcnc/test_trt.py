"""`control --kinematics linuxcnc-trt` and `--to matrixkins` in the running control: its joints are the model's, signs included."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.controls.test_skew import CORNERS, matrix_move, skewed, tool
from tests.linuxcnc.control import control, needs_linuxcnc, needs_root, skip_without_control
from tests.machine.test_description import DMU50
from tests.machine.test_description import made as described
from tests.truth.rotary_table import pins_of, trt_joints
from twin.compensation.tables import Request, make
from twin.controls.kinematics.linuxcnc_trt import LinuxCncTrt

pytestmark = [needs_linuxcnc]
URDF = Path(__file__).parents[2] / "urdf"
POSES = ((300, 250, -100, 0, 0), (310, 240, -150, 30, 40), (280, 260, -120, -20, 170), (290, 245, -130, 80, -95))
_ROTARY = re.compile(r'(<joint name="[^"]*" type="(?:revolute|continuous)">.*?<axis xyz=")([^"]*)(")', re.DOTALL)


def right_handed(folder: Path) -> twin.Machine:
    """Return the trunnion with rotary axes that turn the other way: version 2.9 knows no other."""

    def turned(match: re.Match[str]) -> str:
        return match[1] + " ".join(str(-float(value)) for value in match[2].split()) + match[3]

    (folder / "trunnion_ac.urdf").write_text(_ROTARY.sub(turned, (URDF / "trunnion_ac.urdf").read_text()))
    shutil.copy(URDF / "trunnion_ac.yaml", folder)
    return twin.Machine.load(folder / "trunnion_ac.yaml")


def test_the_joints_are_those_of_the_model(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    machine, form = right_handed(tmp_path), LinuxCncTrt()
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    values = {**form.nominal(machine), "x-rot-point": 299.5, "y-rot-point": 250.75, "y-offset": 12.5}
    text = form.write(values, machine)
    assert "conventional-directions" not in text
    actions: list[list[Any]] = [["home"]]
    for pose in POSES:
        words = " ".join(f"{name}{value}" for name, value in zip(machine.names, pose, strict=True))
        actions += [["mdi", f"G53 G0 {words}"], ["position"]]
    home = dict(zip(machine.names, POSES[0], strict=True))
    folder = tmp_path_factory.mktemp("control")
    ran = control(folder, machine, actions, home=home, kinematics="xyzac-trt-kins", hal=text)
    pins = pins_of(text)
    for pose, place in zip(POSES, ran.results("position"), strict=True):
        joints = trt_joints(pins, "A", np.array(pose[:3], dtype=float), *pose[3:], 0.0)
        assert place["joints"][:3] == pytest.approx(joints, abs=1e-8)
        assert place["joints"][3:] == pytest.approx(pose[3:], abs=1e-8)


def test_a_machine_that_needs_a_newer_version_is_told_so() -> None:
    machine, form = twin.Machine.load("trunnion_ac"), LinuxCncTrt()
    assert "setp xyzac-trt-kins.conventional-directions 1" in form.write(form.nominal(machine), machine)
    assert "2.10" in form.loading(machine)[0]


@needs_root
def test_matrixkins_moves_the_joints_as_its_formula_says(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> None:
    """The settings of a skewed, scaled machine in the running control: joints = C · commands, and the tool is where it was meant."""
    source = Path(os.environ.get("MATRIXKINS", ""))
    if source.name != "matrixkins.comp" or not source.is_file():
        pytest.skip("the environment variable MATRIXKINS does not name LinuxCNC's matrixkins.comp")
    machine = described(
        tmp_path_factory.mktemp("mill"), {**DMU50, "work": [], "axes": {name: DMU50["axes"][name] for name in "XYZ"}}
    )
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    folder = tmp_path_factory.mktemp("control")
    shutil.copy(source, folder)
    subprocess.run(["halcompile", "--install", "matrixkins.comp"], cwd=folder, check=True, capture_output=True)
    request.addfinalizer(lambda: Path("/usr/lib/linuxcnc/modules/matrixkins.so").unlink())
    made = make(machine, skewed(machine, scaled=True), Request("matrixkins", tool_length_mm=0.0))
    (text,) = made.files.values()
    actions: list[list[Any]] = [["home"]]
    for x, y, z in CORNERS:
        actions += [["mdi", f"G53 G0 X{x} Y{y} Z{z}"], ["position"]]
    home = dict(zip(machine.names, CORNERS[0], strict=True))
    ran = control(folder, machine, actions, home=home, kinematics="matrixkins", hal=text)
    joints = np.array([place["joints"][:3] for place in ran.results("position")])
    np.testing.assert_allclose(joints, matrix_move(text)(CORNERS), atol=1e-8)
    assert np.abs(joints - CORNERS).max() > 0.5
    assert np.abs(tool(joints, scaled=True) - CORNERS).max() < 2e-6
