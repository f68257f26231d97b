"""A URDF with constant geometric errors: the same poses as the machine with these errors, by Pinocchio alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.model.errors import random_calibration
from twin import cli
from twin.machine.machine import Machine
from twin.model.calibrated_urdf import calibrated_urdf
from twin.model.calibration import Calibration
from twin.model.effects.location import ZeroOffset
from twin.tool.forward import Kinematics

ROOT = Path(__file__).resolve().parents[2]
MACHINES = ["dmu50", "trunnion_ac", "xyzbc_trunnion"]


def constants(machine: Machine, seed: int) -> Calibration:
    """Return random squareness, axis locations and zero offsets."""
    rng = np.random.default_rng(seed)
    names = (*machine.squareness_names, *machine.location_names)
    drawn = random_calibration(machine, rng).where(lambda name: name in names)
    offsets = tuple(ZeroOffset(axis, float(rng.normal(0.0, 200.0))) for axis in machine.axes)
    return replace(drawn, extra=offsets)


def poses(machine: Machine, count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(*axis.domain, size=count) for axis in machine.axes])


def with_urdf(machine: Machine, text: str, folder: Path) -> Machine:
    """Return the machine of the same machine file with another URDF, and no calibration."""
    lines = machine.path.read_text(encoding="utf-8").splitlines()
    changed = [line for line in lines if not line.startswith("calibration:")]
    path = folder / "machine.yaml"
    path.write_text("\n".join("urdf: out.urdf" if line.startswith("urdf:") else line for line in changed))
    (folder / "out.urdf").write_text(text)
    return Machine.load(path)


@pytest.mark.parametrize("name", MACHINES)
def test_the_same_poses_as_with_the_errors(name: str, tmp_path: Path) -> None:
    machine = Machine.load(name)
    known = constants(machine, 5)
    made = calibrated_urdf(known)
    assert made.left_out == () and len(made.included) == len(known.effects)
    again = with_urdf(machine, made.text, tmp_path)
    q = poses(machine, 200)
    real = Kinematics(machine, known, tool_length_mm=120.0).forward(q)
    found = Kinematics(again, Calibration.zero(again), tool_length_mm=120.0).forward(q)
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=120.0).forward(q)
    # Directions of linear axes are scaled to length one: 1e-8 of 500 mm at most, with squareness of some 100 µrad.
    assert np.abs(found.point_mm - real.point_mm).max() < 2e-5
    assert np.abs(found.axis - real.axis).max() < 1e-10
    assert np.abs(nominal.point_mm - real.point_mm).max() > 0.05


def test_other_programs_read_it(tmp_path: Path) -> None:
    """Pinocchio's own reader gives a model with the same joints in another place."""
    machine = Machine.load("dmu50")
    path = tmp_path / "out.urdf"
    calibrated_urdf(constants(machine, 6)).save(path)
    nominal, found = pin.buildModelFromUrdf(str(machine.urdf)), pin.buildModelFromUrdf(str(path))
    assert list(found.names) == list(nominal.names)
    moved = [b.translation - a.translation for a, b in zip(nominal.jointPlacements, found.jointPlacements, strict=True)]
    assert 1e-6 < np.abs(moved).max() < 5e-3


def test_without_errors_nothing_moves() -> None:
    machine = Machine.load("dmu50")
    made = calibrated_urdf(Calibration.zero(machine))
    assert made.included == () and made.left_out == ()
    nominal = pin.buildModelFromXML(machine.urdf.read_text())
    for a, b in zip(nominal.jointPlacements, pin.buildModelFromXML(made.text).jointPlacements, strict=True):
        assert a.isApprox(b, 1e-12)


def test_the_command_says_what_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out.urdf"
    with pytest.raises(SystemExit) as stopped:
        cli.main(["info", "--urdf", str(path)])
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    assert "E_C0Y" in said.split("the URDF contains")[1].split("without")[0]
    assert "E_XX" in said.split("without")[1]
    text = path.read_text()
    assert "ILLUSTRATIVE" in text and "cannot contain" in text
