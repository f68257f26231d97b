"""`control --to linuxcnc` loaded into the control: the motors move by the model's correction, signs and directions included."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import control, needs_linuxcnc, skip_without_control
from tests.truth.machine import AXES, RANGES, TruthMachine
from twin.compensation.tables import Request, make

pytestmark = [needs_linuxcnc]
TOOL = 120.0
HOME = {"X": 240.0, "Y": 215.0, "Z": -190.0, "B": 80.0, "C": 100.0}
REVERSALS = {"X": 9.0, "Y": -6.0, "Z": 4.0, "B": 25.0, "C": -40.0}
"""µm, µrad: the position approached upwards less that approached downwards."""
STOPS = 4
TOLERANCE_UM = 0.3
ACCELERATION = 200.0
"""mm/s²: the control leaves out changes of the correction of up to 0.1 µm, see `twin.controls.formats.linuxcnc`."""
UM_PER_DEG = 1e6 * np.pi / 180.0 / 2.0
"""Tables of rotary axes are 2 µrad from the model where those of linear axes are 1 µm."""


def expected(truth: TruthMachine, axis: str, position: float, side: float) -> float:
    """Return the correction, µm or µrad, by the machine in plain numpy: the part along the axis of the errors of this axis alone."""
    column = AXES.index(axis)
    if axis in "BC":
        # B turns about the z of its error frame, C against it.
        along = float(truth.curve(f"E_C{axis}", position)) * (1.0 if axis == "B" else -1.0)
        return -along - 0.5 * side * REVERSALS[axis]
    q = np.array([np.mean(RANGES[name]) if name in "XYZ" else 0.0 for name in AXES])
    q[column] = position
    off = 1e3 * (truth.pose(q) - truth.pose(q, real=False))[column, 3]
    return -float(off) - 0.5 * side * REVERSALS[axis]


@pytest.mark.slow  # 20 s; `test_trt.py` loads kinematics in the default run
def test_the_motors_move_by_the_correction(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """All axes stop at nodes and between, upwards and then downwards; the motors stand off the commands by the correction."""
    machine = twin.Machine.load("dmu50")
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    bundled = twin.Calibration.default(machine)
    extra = tuple(twin.effect_named("reversal", axis, {"size": size}, machine) for axis, size in REVERSALS.items())
    made = make(
        machine, replace(bundled, extra=extra), Request("linuxcnc", tool_length_mm=TOOL, tolerance_um=TOLERANCE_UM)
    )
    folder = tmp_path_factory.mktemp("control")
    for name, text in made.files.items():
        (folder / name).write_text(text)
    joints = {int(number): lines for number, lines in re.findall(r"\[JOINT_(\d)\]\n([^\[]*)", made.files["joints.ini"])}
    assert len(joints) == len(AXES)
    truths = {}
    for axis in AXES:
        own = bundled.where(lambda name, axis=axis: name.endswith(axis) and "0" not in name)
        own.save(tmp_path / f"{axis}.yaml")
        truths[axis] = TruthMachine(tmp_path / f"{axis}.yaml", TOOL)
    stops, nodes = [], []
    for axis in AXES:
        every = np.loadtxt(folder / f"{axis}.comp")[:, 0]
        every = every[(every >= RANGES[axis][0]) & (every <= RANGES[axis][1])]
        first = len(every) // 5 + np.arange(STOPS // 2)
        nodes.append(np.tile([True, False], STOPS // 2))
        stops.append(np.stack([every[first], 0.37 * every[first] + 0.63 * every[first + 1]], axis=1).ravel())
    up, is_node = np.array(stops).T, np.array(nodes).T
    rows = [up[0] - 5.0, *up, up[-1] + 5.0, *up[::-1]]
    program = "".join(
        "G53 G1 " + " ".join(f"{axis}{value:.6f}" for axis, value in zip(AXES, row, strict=True)) + "\nG4 P0.15\n"
        for row in rows
    )
    (folder / "nodes.ngc").write_text(f"G21 G90 G94\nF30000\n{program}M2\n")
    pins = [*(f"motor-{i}" for i in range(5)), *(f"joint.{i}.pos-cmd" for i in range(5))]
    ran = control(
        folder,
        machine,
        [["home"], ["record", "nodes.txt"], ["program", "nodes.ngc"], ["stop"]],
        home=HOME,
        joints=joints,
        acceleration=ACCELERATION,
        pins=pins,
    )
    motors, commands = np.hsplit(ran.samples("nodes.txt"), 2)
    motors = motors + np.array(list(HOME.values()))
    turning = int(np.abs(commands - rows[STOPS + 1]).max(axis=1).argmin())
    worst = {"nodes": 0.0, "between": 0.0}
    for which, side in ((slice(1, STOPS + 1), 1.0), (slice(STOPS + 2, None), -1.0)):
        at_node = is_node if side > 0 else is_node[::-1]
        for row, node in zip(rows[which], at_node, strict=True):
            there = np.flatnonzero(np.abs(commands - row).max(axis=1) < 1e-9)
            there = there[there < turning] if side > 0 else there[there > turning]
            assert len(there) > 100
            found = (motors - commands)[there[-1]]
            for i, axis in enumerate(AXES):
                um = found[i] * (1e3 if axis in "XYZ" else UM_PER_DEG)
                wanted = expected(truths[axis], axis, row[i], side) * (1.0 if axis in "XYZ" else 0.5)
                kind = "nodes" if node[i] else "between"
                worst[kind] = max(worst[kind], abs(um - wanted))
                assert abs(um - wanted) < (0.1 if node[i] else TOLERANCE_UM + 0.1), (axis, row[i], side, um, wanted)
    print(f"largest difference, µm (or 2 µrad): {worst['nodes']:.4f} at nodes, {worst['between']:.4f} between")
