"""The kinematics module with errors for machines of other kinds, executed by the control and judged by a machine in plain numpy."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.linuxcnc.control import LETTERS, control, needs_linuxcnc, needs_root, skip_without_control
from tests.linuxcnc.machines import KINDS
from tests.linuxcnc.test_live import MODULES, TOOL, synchronous
from tests.model.errors import random_calibration
from tests.truth.machine import TruthMachine
from twin.compensation.live import make_module, write_module

pytestmark = [needs_linuxcnc, needs_root, pytest.mark.xdist_group("linuxcnc")]
ERRORS_UM = 100.0
ON = [
    ["hal", ["setp", "twinkins.fade-rate", "10"]],
    ["mdi", "M61 Q1 G43 H1"],
    ["hal", ["setp", "twinkins.enable", "1"]],
]


@pytest.mark.sample(1)  # of 6
@pytest.mark.parametrize("kind", KINDS)
def test_the_tip_of_every_kind_is_where_the_program_means(
    kind: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Five lines across the volume, all axes at once; then the control computes the axes from the joints, and the joints again."""
    truth_machine = KINDS[kind]()
    machine = truth_machine.machine(tmp_path)
    names = machine.names
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    rng = np.random.default_rng(7)
    errors = random_calibration(machine, rng, ERRORS_UM)
    errors.save(tmp_path / "errors.yaml")
    write_module(make_module(errors, tool_length_mm=TOOL), tmp_path / "live")
    subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=tmp_path / "live", check=True, capture_output=True)
    low, high = np.array([axis.domain for axis in machine.axes]).T
    poses = np.round(low + rng.uniform(0.1, 0.9, (6, len(names))) * (high - low), 2)
    lines = [" ".join(f"{name}{value}" for name, value in zip(names, pose, strict=True)) for pose in poses]
    folder = tmp_path_factory.mktemp("control")
    (folder / "part.ngc").write_text(
        "G21 G90 G94\nF25000\n" + "".join(f"G53 G1 {words}\n" for words in lines[1:]) + "M2\n"
    )
    actions: list[list[Any]] = [
        ["home"],
        *ON,
        ["sleep", 0.5],
        ["record", "part.txt"],
        ["program", "part.ngc"],
        ["stop"],
    ]
    for words in lines[:3]:
        actions += [["mdi", f"G53 G0 {words}"], ["position"], ["free"], ["position"]]
    try:
        ran = control(
            folder,
            machine,
            actions,
            home=dict(zip(names, poses[0], strict=True)),
            kinematics="twinkins",
            hal=(tmp_path / "live" / "twinkins.hal").read_text(),
            pins=[
                *(f"twinkins-command-{i}" for i in range(len(names))),
                *(f"axis.{name.lower()}.pos-cmd" for name in names),
            ],
            tools=f"T1 P1 Z{TOOL}\n",
        )
    finally:
        (MODULES / "twinkins.so").unlink()
    joints, axes = synchronous(ran.samples("part.txt"))
    moving = np.any(np.abs(np.diff(axes, axis=0, append=axes[-1:])) > 1e-9, axis=1)
    joints, axes = joints[moving], axes[moving]
    truth = TruthMachine(tmp_path / "errors.yaml")
    goal = truth_machine.tip(names, axes, TOOL)
    plain, distance = (
        1e3 * np.linalg.norm(truth_machine.tip(names, q, TOOL, truth) - goal, axis=1) for q in (axes, joints)
    )
    print(f"{kind}, µm: {np.median(plain):.1f} median, {plain.max():.1f} largest without the module,", end=" ")
    print(f"{np.median(distance):.4f} median, {distance.max():.4f} largest with it")
    assert len(distance) > 1500 and np.median(plain) > 20.0
    assert np.median(distance) < 0.01 and distance.max() < 0.2
    places = ran.results("position")
    columns = [LETTERS.index(name) for name in names]
    for before, after in zip(places[::2], places[1::2], strict=True):
        assert np.abs(np.array(before["joints"]) - np.array(before["axes"])[columns]).max() > 0.005
        assert np.array(before["actual"])[columns] == pytest.approx(np.array(before["axes"])[columns], abs=1e-9)
        assert after["joints"] == pytest.approx(before["joints"], abs=1e-9)
        assert after["axes"] == pytest.approx(before["axes"], abs=1e-9)
