"""The kinematics module with errors, executed by the control itself.

The control's joints follow the positions by two servo periods, and are smoothed, (x₋₁ + 4x₀ + x₁)/6, by its cubic interpolation
(``cubic.h``): the commands of the axes are smoothed in the same way before the comparison.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import LETTERS, control, needs_linuxcnc, needs_root, skip_without_control
from twin.compensation.live import make_module, outputs_of, write_module
from twin.controls.linuxcnc import Ran

pytestmark = [needs_linuxcnc, needs_root]
MODULES = Path("/usr/lib/linuxcnc/modules")
LAG = 2
TOOL = 120.0
HOME = {"X": 250.0, "Y": 225.0, "Z": -100.0, "B": 20.0, "C": 0.0}
FADE = ["hal", ["setp", "twinkins.fade-rate", "10"]]
ON = [["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 0.3]]


@pytest.fixture(scope="module")
def machine() -> twin.Machine:
    return twin.Machine.load("dmu50")


@pytest.fixture(scope="module")
def errors(machine: twin.Machine) -> twin.Calibration:
    """The bundled errors, and such as depend on the direction, on temperatures and on the spindle."""
    named = {
        "reversal Y": {"size": 9.0},
        "thermal_growth Z by bed": {"coefficient": 12.0},
        "thermal_lag Z by oil": {"coefficient": 5.0, "time_constant": 600.0},
        "thermal_expansion X": {"coefficient": 9.0},
        "spindle_growth Z": {"amplitude": 20.0, "exponent": 1.5, "time_constant": 2.0, "highest_rpm": 12000.0},
    }
    extra = tuple(twin.effect_named(*name.split(" ", 1), numbers, machine) for name, numbers in named.items())
    return replace(twin.Calibration.default(machine), extra=extra)


@pytest.fixture(scope="module")
def loaded(errors: twin.Calibration, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return the folder of the module, compiled into the control."""
    skip_without_control(tmp_path_factory.mktemp("plain"), errors.machine)
    folder = tmp_path_factory.mktemp("live")
    write_module(make_module(errors, tool_length_mm=TOOL), folder)
    assert set(folder.iterdir()) == set(outputs_of(folder))
    subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=folder, check=True, capture_output=True)
    yield folder
    (MODULES / "twinkins.so").unlink()


def run(folder: Path, tmp_path: Path, machine: twin.Machine, actions: Sequence[Sequence[Any]]) -> Ran:
    signals = [f"twinkins-command-{i}" for i in range(len(machine.names))]
    return control(
        tmp_path,
        machine,
        actions,
        home={name: HOME.get(name, 0.0) for name in machine.names},
        kinematics="twinkins",
        hal=(folder / "twinkins.hal").read_text(),
        pins=[*signals, *(f"axis.{name.lower()}.pos-cmd" for name in machine.names)],
        tools=f"T1 P1 Z{TOOL}\nT2 P2 X3 Y-2 Z80\n",
    )


def synchronous(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joints and axes (n, axes) at the same time."""
    half = samples.shape[1] // 2
    return samples[LAG:, :half][1:-1], smoothed(samples[:-LAG, half:])


def smoothed(positions: np.ndarray) -> np.ndarray:
    """Return what the control's cubic interpolation makes of (n, axes) positions, without the first and the last."""
    return (positions[:-2] + 4.0 * positions[1:-1] + positions[2:]) / 6.0


def sides(axes: np.ndarray, back: float = 0.001) -> tuple[np.ndarray, np.ndarray]:
    """Return the sides (n, axes) from which positions are approached, and where none has changed during the last 0.11 s."""
    found, held = np.zeros(axes.shape), np.zeros(axes.shape)
    for column in range(axes.shape[1]):
        side, mark, since = 0.0, axes[0, column], 0
        for row, value in enumerate(axes[:, column]):
            if (value - mark) * side > 0.0 or (side == 0.0 and abs(value - mark) > back):
                side, mark, since = (side or np.sign(value - mark)), value, (since if side else row)
            elif side and (mark - value) * side > back:
                side, mark, since = -side, value, row
            found[row, column], held[row, column] = side, row - since
    return found, held.min(axis=1) > 110


def off(
    machine: twin.Machine, errors: twin.Calibration, samples: np.ndarray, conditions: twin.Conditions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return error of the tip (µm) and tilt (µrad) over a motion, and the error without the module.

    Left out: the beginning, where no axis has moved yet, and 0.1 s after every reversal, during which the correction changes sides.
    """
    joints, axes = synchronous(samples)
    approach, settled = sides(axes)
    settled &= np.all(approach != 0.0, axis=1)
    joints, axes, approach = joints[settled], axes[settled], approach[settled]
    real = twin.Kinematics(machine, errors, tool_length_mm=TOOL, conditions=conditions)
    nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=TOOL)
    (turn, goal), (after, reached), (_, plain) = (
        # Not checked against the domains: near their ends the corrected positions are beyond.
        model.reached(positions * machine.scale, directions)
        for model, positions, directions in ((nominal, axes, None), (real, joints, approach), (real, axes, approach))
    )
    tilt = np.linalg.norm((after - turn)[:, 6:], axis=1)
    return 1e6 * np.linalg.norm(reached - goal, axis=1), 1e6 * tilt, 1e6 * np.linalg.norm(plain - goal, axis=1)


def test_a_program_in_axis_words_is_cut_right_without_being_compensated(
    loaded: Path, machine: twin.Machine, errors: twin.Calibration, tmp_path: Path
) -> None:
    text = Path(twin.__file__).with_name("samples").joinpath("cone_frustum.nc").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("%", "O")) and "T1" not in line]
    lines = [line.replace("F800", "F3000") for line in lines]
    (tmp_path / "part.ngc").write_text("\n".join(lines) + "\n")
    actions = [
        ["home"],
        ["hal", ["unlinkp", "twinkins.tool-z"]],
        ["hal", ["setp", "twinkins.tool-z", f"{TOOL}"]],
        ["hal", ["setp", "twinkins.temperature-bed", "26"]],
        ["hal", ["setp", "twinkins.temperature-X", "23"]],
        # The program's own speed would make the machine grow while it runs.
        ["hal", ["unlinkp", "twinkins.spindle-speed"]],
        FADE,
        *ON,
        ["record", "part.txt"],
        ["mdi", "G0 X250 Y225 Z-100 B10 C-170"],
        ["program", "part.ngc"],
        ["stop"],
        ["hal", ["getp", "twinkins.out-of-range"]],
        ["hal", ["getp", "twinkins.update.time"]],
        ["hal", ["getp", "servo-thread.time"]],
        ["hal", ["setp", "twinkins.spindle-speed", "0"]],
        ["mdi", "M5 G53 G0 B0 C0"],
        ["sleep", 0.5],
        ["position"],
        ["hal", ["linkps", "twinkins.spindle-speed", "twinkins-spindle-speed"]],
        ["mdi", "S6000 M4"],
        ["sleep", 4.0],
        ["position"],
    ]
    ran = run(loaded, tmp_path, machine, actions)
    cold, warm = (result["joints"][2] for result in ran.results("position"))
    # 20 µm at 12,000 1/min, exponent 1.5, time constant 2 s; the command of the action takes some tenths of a second.
    assert 1e3 * (cold - warm) == pytest.approx(20.0 * 0.5**1.5 * (1.0 - np.exp(-4.3 / 2.0)), abs=0.25)
    conditions = twin.Conditions(temperature_degC={"bed": 26.0, "X": 23.0, "oil": 20.0}, spindle_rpm=0.0, time_s=0.0)
    distance, tilt, plain = off(machine, errors, ran.samples("part.txt"), conditions)
    assert len(distance) > 8000 and plain.mean() > 25.0
    assert np.median(distance) < 0.002 and distance.max() < 0.02 and tilt.max() < 1.0


POSES = (
    (250, 225, -100, 20, 0),
    (30, 400, -350, 88, 301),
    (470, 20, -10, 0, -45),
    (250, 225, -200, 3, 700),
    (-30, 470, 20, 175, -400),
)
"""The last but one lies close to the singular position and turns later, the last is outside the ranges of the curves."""


def test_nothing_jumps_when_it_is_switched_on_and_off(loaded: Path, machine: twin.Machine, tmp_path: Path) -> None:
    """The axes stay where they are, to a nanometre, anywhere; the joints are moved at the stated rate; off, all is as without it."""
    actions: list[list[Any]] = [["home"], FADE, ["mdi", "M61 Q1 G43 H1"]]
    for i, pose in enumerate(POSES):
        words = " ".join(f"{name}{value}" for name, value in zip(machine.names, pose, strict=True))
        actions += [
            ["mdi", f"G53 G0 {words}"],
            ["position"],
            ["record", f"{i}.txt"],
            *ON,
            ["stop"],
            ["position"],
            ["hal", ["getp", "twinkins.out-of-range"]],
            ["hal", ["setp", "twinkins.orientation", "0"]],
            ["sleep", 0.3],
            ["position"],
            ["hal", ["setp", "twinkins.enable", "0"]],
            ["sleep", 0.3],
            ["position"],
            ["hal", ["setp", "twinkins.orientation", "1"]],
            ["sleep", 0.3],
        ]
    ran = run(loaded, tmp_path, machine, actions)
    places = ran.results("position")
    rotary = list(machine.rotary)
    for i, pose in enumerate(POSES):
        before, on, no_turn, after = places[4 * i : 4 * i + 4]
        samples = ran.samples(f"{i}.txt")
        joints, axes = np.hsplit(samples, 2)
        assert np.abs(axes - np.array(pose)).max() < 1e-9
        assert np.allclose(before["joints"], pose, atol=1e-12) and np.allclose(after["joints"], pose, atol=1e-12)
        correction = np.array(on["joints"]) - np.array(pose)
        assert np.abs(correction[:3]).max() > 0.005
        # One part in a hundred of the correction a cycle of 1 ms.
        assert np.all(np.abs(np.diff(joints, axis=0)).max(axis=0) < 1.3e-2 * np.abs(correction) + 1e-9)
        assert np.allclose(np.array(no_turn["joints"])[rotary], np.array(pose)[rotary], atol=1e-12)
        names = [LETTERS.index(name) for name in machine.names]
        assert np.allclose(np.array(on["axes"])[names], pose, atol=1e-9)
    states = [result for result in ran.results("hal") if result in ("TRUE", "FALSE")]
    assert states == ["FALSE", "FALSE", "FALSE", "FALSE", "TRUE"]


def test_what_comes_to_the_pins_is_bounded_and_limited_in_rate(
    loaded: Path, machine: twin.Machine, tmp_path: Path
) -> None:
    """A longer tool, a jump of a temperature, a value that no sensor has, a tool of 500 m: the axes stay, the joints do not jump."""

    def pin(name: str, value: float) -> list[Any]:
        return ["hal", ["setp", f"twinkins.{name}", f"{value:g}"]]

    def recorded(name: str, *steps: list[Any]) -> list[list[Any]]:
        return [["record", name], *steps, ["stop"]]

    outside, place, off = ["hal", ["getp", "twinkins.out-of-range"]], ["position"], [pin("enable", 0), ["sleep", 0.3]]
    start = [["home"], FADE, ["mdi", "G53 G0 X250 Y225 Z-200 B60 C30"], ["hal", ["unlinkp", "twinkins.tool-z"]]]
    # With the orientation, the rotary axes take out a tilt, and the length of the tool does not matter.
    start += [pin("tool-z", TOOL), pin("orientation", 0), ["sleep", 0.3], *ON, place]
    longer = [*recorded("tool.txt", pin("tool-z", TOOL + 300.0), ["sleep", 1.2]), place, outside]
    bed = recorded("warm.txt", pin("temperature-bed", 26.0), ["sleep", 1.0])
    bed += [pin("temperature-bed", 75.0), ["sleep", 0.2], place, ["sleep", 0.5], place, outside]
    bed += [pin("temperature-bed", 20.0), ["sleep", 0.2], outside]
    longest = [pin("tool-rate", 1e9), pin("tool-z", 500e3), ["sleep", 0.3], place, outside, *off, pin("tool-z", TOOL)]
    oil = [
        pin("temperature-oil", 30.0),
        ["sleep", 0.2],
        *ON,
        place,
        pin("temperature-oil", 20.0),
        ["sleep", 1.0],
        place,
    ]
    back = [["mdi", "G53 G0 Y226"], ["mdi", "G53 G0 Y225"], ["sleep", 0.3]]
    turning = [*recorded("turned.txt", pin("orientation", 1), ["sleep", 0.3]), *recorded("back.txt", *back)]
    actions = [*start, *longer, *bed, *longest, *oil, *turning]
    ran = run(loaded, tmp_path, machine, actions)
    short, long, held, later, cut, warm, followed = (np.array(one["joints"]) for one in ran.results("position"))
    joints, axes = np.hsplit(ran.samples("tool.txt"), 2)
    assert np.ptp(axes, axis=0).max() < 1e-9
    change = np.abs(long - short)[:3].max()
    # 300 mm at 500 mm/s: 600 cycles.
    assert change > 0.005 and np.abs(np.diff(joints, axis=0))[:, :3].max() < 2.0 * change / 600.0
    # 12 µm/K at 0.2 K/s; the value beyond 60 °C is not followed, nor is what remained of the way to the last one.
    joints, _ = np.hsplit(ran.samples("warm.txt"), 2)
    assert 1.5e-3 < joints[0, 2] - joints[-1, 2] < 6e-3 and np.abs(np.diff(joints[:, 2])).max() < 5e-6
    assert later == pytest.approx(held, abs=1e-9)
    assert [one for one in ran.results("hal") if one in ("TRUE", "FALSE")] == ["FALSE", "TRUE", "FALSE", "TRUE"]
    assert np.isfinite(cut).all() and np.abs(cut - short)[:3].max() < 10.0
    # A lag is in balance with a sensor that comes while the correction is off; then it follows: 5 µm/K in 600 s.
    assert warm[2] - short[2] == pytest.approx(-0.05, abs=1e-4)
    assert 0.0 < followed[2] - warm[2] < 1e-5
    # A tenth of a second for the orientation at the rate of `FADE`, and for the 9 µm of the reversal.
    joints, _ = np.hsplit(ran.samples("turned.txt"), 2)
    change = np.abs(joints[-1] - joints[0]).max()
    assert change > 0.005 and np.abs(np.diff(joints, axis=0)).max() < 0.02 * change
    joints, axes = synchronous(ran.samples("back.txt"))
    correction = (joints - axes)[:, 1]
    assert 0.006 < np.ptp(correction) < 0.012 and np.abs(np.diff(correction)).max() < 5e-4


def test_the_singular_position_is_passed_smoothly(
    loaded: Path, machine: twin.Machine, errors: twin.Calibration, tmp_path: Path
) -> None:
    """B from 8° through zero and back, the table turning: the position is right throughout, and no axis turns by leaps."""
    (tmp_path / "zero.ngc").write_text(
        "G21 G90 G94\nM61 Q1\nG43 H1\nG4 P0.5\nG53 G0 X249 Y224 Z-199 B7 C29\nG53 G0 X250 Y225 Z-200 B8 C30\nG4 P0.3\n"
        "F3000\nG53 G1 B0 C40\nG53 G1 B0 C100\nG53 G1 B0.3 C150\n"
        "G53 G1 B0\nG53 G1 B8 C200\nM2\n"
    )
    actions = [["home"], FADE, *ON, ["record", "zero.txt"], ["program", "zero.ngc"], ["stop"]]
    ran = run(loaded, tmp_path, machine, actions)
    conditions = twin.Conditions(temperature_degC={"bed": 20.0, "X": 20.0, "oil": 20.0}, spindle_rpm=0.0, time_s=0.0)
    samples = ran.samples("zero.txt")
    distance, _, _ = off(machine, errors, samples, conditions)
    assert distance.max() < 0.05
    joints, axes = synchronous(samples)
    extra = np.abs(np.diff(joints - axes, axis=0)).max(axis=0)
    step = np.abs(np.diff(axes, axis=0)).max(axis=0)
    assert np.all(extra[list(machine.rotary)] < 0.5 * step[list(machine.rotary)])


def test_coordinates_of_the_workpiece_follow_the_tip(
    loaded: Path, machine: twin.Machine, errors: twin.Calibration, tmp_path: Path
) -> None:
    """Tool centre point mode: the tip of the machine with errors is where the program says, on the turned table."""
    (tmp_path / "tcp.ngc").write_text(
        "G21 G90 G94\nM61 Q1\nG43 H1\nG4 P0.5\nG53 G0 X249 Y224 Z-149 B1 C1\nG53 G0 X250 Y225 Z-150 B0.5 C0.5\n"
        "M68 E3 Q1\nM66 E0 L0\nF4000\n"
        "G1 X260 Y230 Z-330 B20 C30\nG1 X270 Y220 B50 C80\nG1 X250 Y240 Z-320 B10 C10\nG1 B0 C0\nM68 E3 Q0\nM66 E0 L0\nM2\n"
    )
    actions = [["home"], FADE, *ON, ["record", "tcp.txt"], ["program", "tcp.ngc"], ["stop"], ["position"]]
    ran = run(loaded, tmp_path, machine, actions)
    joints, words = np.hsplit(ran.samples("tcp.txt"), 2)
    joints, words = joints[LAG:], words[:-LAG]
    turned = np.flatnonzero(words[:, 3] > 0.6)
    # Before and after, the words are those of the axes.
    joints, words = (values[turned[0] : turned[-1]] for values in (joints, words))
    nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=TOOL)
    start, by = nominal.travel(np.zeros((1, len(machine.names))))
    tips = start[0] + words[:, :3] @ by[0][:, list(machine.linear)].T
    # Where the axes of the machine without errors stand: the tip is linear in the linear axes. The control smooths the joints.
    axes = words.copy()
    axes[:, :3] = 0.0
    there, by = nominal.travel(axes)
    axes[:, :3] = np.linalg.solve(by[:, :, list(machine.linear)], (tips - there)[:, :, None])[:, :, 0]
    joints, axes = joints[1:-1], smoothed(axes)
    _, meant = nominal.reached(axes * machine.scale)
    approach, settled = sides(axes)
    settled &= np.all(approach != 0.0, axis=1)
    conditions = twin.Conditions(temperature_degC={"bed": 20.0, "X": 20.0, "oil": 20.0}, spindle_rpm=0.0, time_s=0.0)
    real = twin.Kinematics(machine, errors, tool_length_mm=TOOL, conditions=conditions)
    _, reached = real.reached(joints * machine.scale, approach)
    distance = (1e6 * np.linalg.norm(reached - meant, axis=1))[settled]
    assert len(distance) > 1000
    assert distance.max() < 0.02
