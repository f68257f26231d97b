"""The kinematics module with errors for machines of other kinds, executed by the control and judged by a machine in plain numpy."""

from __future__ import annotations

import itertools
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import LETTERS, control, needs_linuxcnc, needs_root, skip_without_control
from tests.linuxcnc.machines import KINDS, Kind
from tests.linuxcnc.test_live import LAG, MODULES, smoothed, synchronous
from tests.model.errors import random_calibration
from tests.truth.machine import TruthMachine
from twin.compensation.live import make_module, write_module
from twin.controls.linuxcnc import Ran

pytestmark = [needs_linuxcnc, needs_root]
ERRORS_UM = 100.0
TOOLS = ((0.0, 0.0, 120.0), (3.0, -2.0, 80.0))
ON = [["hal", ["setp", "twinkins.fade-rate", "10"]], ["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 0.5]]
TO_WORKPIECE = [["mdi", "M68 E3 Q1"], ["mdi", "M66 E0 L0"]]
TO_AXES = [["mdi", "M68 E3 Q0"], ["mdi", "M66 E0 L0"]]
WITH_ROTARY = [kind for kind in KINDS if kind != "three axes"]


@dataclass(frozen=True)
class Built:
    """A machine with errors, its module compiled into the control, and the same machine in plain numpy."""

    kind: Kind
    machine: twin.Machine
    truth: TruthMachine
    folder: Path

    @property
    def names(self) -> tuple[str, ...]:
        return self.machine.names

    @property
    def bounds(self) -> np.ndarray:
        """(2, axes) the ranges."""
        return np.array([axis.domain for axis in self.machine.axes]).T

    def block(self, q: np.ndarray) -> str:
        return " ".join(f"{name}{value:.6f}" for name, value in zip(self.names, q, strict=True))

    def run(self, folder: Path, actions: Sequence[Sequence[Any]], home: np.ndarray) -> Ran:
        """Run the control; recorded are the motors and the axes."""
        count = len(self.names)
        try:
            return control(
                folder,
                self.machine,
                [["home"], *actions],
                home=dict(zip(self.names, home, strict=True)),
                kinematics="twinkins",
                hal=(self.folder / "twinkins.hal").read_text(),
                pins=[
                    *(f"twinkins-command-{i}" for i in range(count)),
                    *(f"axis.{name.lower()}.pos-cmd" for name in self.names),
                ],
                tools="".join(f"T{i} P{i} X{x} Y{y} Z{z}\n" for i, (x, y, z) in enumerate(TOOLS, 1)),
            )
        finally:
            (MODULES / "twinkins.so").unlink()

    def off_um(self, joints: np.ndarray, axes: np.ndarray, tool: tuple[float, float, float]) -> np.ndarray:
        """Return (n,) how far the true tip at positions of the joints is from the nominal one at those of the axes."""
        goal = self.kind.tip(self.names, axes, tool)
        return 1e3 * np.linalg.norm(self.kind.tip(self.names, joints, tool, self.truth) - goal, axis=1)


def built(name: str, folder: Path, plain: Path) -> Built:
    """Return a machine with curves of up to `ERRORS_UM`, constants of a tenth, and its module loaded."""
    kind = KINDS[name]()
    machine = kind.machine(folder)
    skip_without_control(plain, machine)
    errors = random_calibration(machine, np.random.default_rng(7), ERRORS_UM)
    errors.save(folder / "errors.yaml")
    live = folder / "live"
    write_module(make_module(errors, tool_length_mm=TOOLS[0][2]), live)
    subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=live, check=True, capture_output=True)
    return Built(kind, machine, TruthMachine(folder / "errors.yaml"), live)


def moving(axes: np.ndarray) -> np.ndarray:
    return np.any(np.abs(np.diff(axes, axis=0, append=axes[-1:])) > 1e-9, axis=1)


@pytest.mark.sample(1)  # of 6
@pytest.mark.parametrize("kind", KINDS)
def test_the_tip_of_every_kind_is_where_the_program_means(
    kind: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Five lines across the volume, all axes at once; then the control computes the axes from the joints, and the joints again."""
    made = built(kind, tmp_path, tmp_path_factory.mktemp("plain"))
    low, high = made.bounds
    share = np.random.default_rng(7).uniform(0.1, 0.9, (6, len(low)))
    poses = np.round(low + share * (high - low), 2)
    folder = tmp_path_factory.mktemp("control")
    lines = [f"G53 G1 {made.block(q)}\n" for q in poses[1:]]
    (folder / "part.ngc").write_text(f"G21 G90 G94\nF25000\n{''.join(lines)}M2\n")
    actions: list[list[Any]] = [["mdi", "M61 Q1 G43 H1"], *ON]
    actions += [["record", "part.txt"], ["program", "part.ngc"], ["stop"]]
    for q in poses[:3]:
        actions += [["mdi", f"G53 G0 {made.block(q)}"], ["position"], ["free"], ["position"]]
    ran = made.run(folder, actions, poses[0])
    joints, axes = synchronous(ran.samples("part.txt"))
    joints, axes = joints[moving(axes)], axes[moving(axes)]
    plain, distance = (made.off_um(q, axes, TOOLS[0]) for q in (axes, joints))
    print(f"{kind}, µm: {np.median(plain):.1f} median, {plain.max():.1f} largest without the module,", end=" ")
    print(f"{np.median(distance):.4f} median, {distance.max():.4f} largest with it")
    assert len(distance) > 1500 and np.median(plain) > 15.0
    assert np.median(distance) < 0.01 and distance.max() < 0.2
    places = ran.results("position")
    columns = [LETTERS.index(name) for name in made.names]
    for before, after in zip(places[::2], places[1::2], strict=True):
        assert np.abs(np.array(before["joints"]) - np.array(before["axes"])[columns]).max() > 0.005
        assert np.array(before["actual"])[columns] == pytest.approx(np.array(before["axes"])[columns], abs=1e-9)
        assert after["joints"] == pytest.approx(before["joints"], abs=1e-9)
        assert after["axes"] == pytest.approx(before["axes"], abs=1e-9)


TURNS = ((25.0, 40.0), (8.0, 60.0), (0.0, 75.0), (0.0, 130.0), (-8.0, 150.0), (20.0, 100.0))
"""First and second rotary axis at the ends of the lines, degrees; where the first is zero, the tool is parallel to the second."""


def workpiece_path(made: Built, tool: tuple[float, float, float]) -> np.ndarray:
    """Return words (6, axes) of lines in coordinates of the workpiece, along which the axes stay within their ranges."""
    rng, (low, high) = np.random.default_rng(3), made.bounds
    rotary, linear = list(made.machine.rotary), list(made.machine.linear)
    share = np.linspace(0.0, 1.0, 41)[:, None]
    margin = 0.02 * (high - low)
    for _ in range(20000):
        q = low + rng.uniform(0.1, 0.9, len(low)) * (high - low)
        q[rotary] = 0.0
        words = np.tile(q, (len(TURNS), 1))
        words[:, rotary] = np.array(TURNS)[:, : len(rotary)]
        words[:, linear] += rng.uniform(-40.0, 40.0, (len(TURNS), 3))
        path = np.vstack([a + share * (b - a) for a, b in itertools.pairwise(words)])
        axes = made.kind.axes(made.names, path, tool)
        if np.all((axes > low + margin) & (axes < high - margin)):
            return np.round(words, 3)
    raise AssertionError("no path")


@pytest.mark.sample(1)  # of 5
@pytest.mark.parametrize("kind", WITH_ROTARY)
def test_tool_centre_point_mode_of_every_kind(
    kind: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Lines on the turned workpiece, through and at the singular position; the mode is changed at rest without any motion."""
    made = built(kind, tmp_path, tmp_path_factory.mktemp("plain"))
    names, tool = made.names, TOOLS[1]
    rotary = list(made.machine.rotary)
    words = workpiece_path(made, tool)
    first, last = made.kind.axes(names, words[[0, -1]], tool)
    folder = tmp_path_factory.mktemp("control")
    lines = "".join(f"G1 {made.block(row - _xyz(names, tool))}\n" for row in words[1:])
    (folder / "part.ngc").write_text(f"G21 G90 G94\nF6000\n{lines}M2\n")
    # Outside the range of a curve, and outside those of the axes.
    beyond, far = last.copy(), words[-1].copy()
    beyond[names.index("X")] = made.bounds[1, names.index("X")] + 30.0
    far[names.index("X")] += 3000.0
    actions: list[list[Any]] = [
        ["mdi", "M61 Q2 G43 H2"],
        *ON,
        ["mdi", f"G53 G0 {made.block(first)}"],
        ["position"],
        *([["record", "on.txt"], *TO_WORKPIECE, ["stop"]]),
        *(["position"], ["free"], ["position"]),
        *([["record", "part.txt"], ["program", "part.ngc"], ["stop"]]),
        *(["position"], ["free"], ["position"]),
        *([["record", "off.txt"], *TO_AXES, ["stop"]]),
        *(["position"], ["hal", ["getp", "twinkins.out-of-range"]]),
        *(["mdi", f"G53 G0 {made.block(beyond)}"], ["position"], ["hal", ["getp", "twinkins.out-of-range"]]),
        *([*TO_WORKPIECE, ["position"], ["free"], ["position"]]),
        *(["mdi", f"G0 {made.block(far - _xyz(names, tool))}"], ["position"]),
    ]
    ran = made.run(folder, actions, first)
    count = len(names)
    for name in ("on.txt", "off.txt"):
        assert np.ptp(ran.samples(name)[:, :count], axis=0).max() < 1e-9
    columns = [LETTERS.index(name) for name in names]
    places = [(np.array(one["joints"]), np.array(one["axes"])[columns]) for one in ran.results("position")]
    in_axes, on, freed, end, end_freed, off, *outside = places
    assert in_axes[1] == pytest.approx(first, abs=1e-6) and off[1] == pytest.approx(last, abs=1e-6)
    assert on[1] == pytest.approx(words[0], abs=1e-6) and end[1] == pytest.approx(words[-1], abs=1e-6)
    for before, after in ((in_axes, on), (on, freed), (end, end_freed), (end_freed, off)):
        assert after[0] == pytest.approx(before[0], abs=1e-9)
    assert freed[1] == pytest.approx(on[1], abs=1e-9) and end_freed[1] == pytest.approx(end[1], abs=1e-9)
    assert [one for one in ran.results("hal") if one in ("TRUE", "FALSE")] == ["FALSE", "TRUE"]
    assert outside[0][1] == pytest.approx(beyond, abs=1e-6)
    assert outside[1][1] == pytest.approx(made.kind.words(names, beyond[None], tool)[0], abs=1e-6)
    for before, after in itertools.pairwise(outside):
        assert after[0] == pytest.approx(before[0], abs=1e-9)
    assert any("exceed X's positive limit" in text for text in ran.said)
    joints, coordinates = np.hsplit(ran.samples("part.txt"), 2)
    # The control interpolates the joints, not the coordinates.
    joints, axes = joints[LAG:][1:-1], smoothed(made.kind.axes(names, coordinates[:-LAG], tool))
    joints, axes = joints[moving(axes)], axes[moving(axes)]
    plain, distance = (made.off_um(q, axes, tool) for q in (axes, joints))
    tilt = np.zeros(len(axes))
    if len(rotary) == 2:
        directions = (
            made.kind.tip(names, q, (0.0, 0.0, 0.0), truth) - made.kind.tip(names, q, (0.0, 0.0, 1e3), truth)
            for q, truth in ((axes, None), (joints, made.truth))
        )
        nominal, true = directions
        tilt = 1e3 * np.linalg.norm(true - nominal, axis=1)[np.abs(axes[:, rotary[0]]) > 15.0]
    print(f"{kind}, µm: {np.median(plain):.1f} median, {plain.max():.1f} largest without the module,", end=" ")
    print(f"{np.median(distance):.4f} median, {distance.max():.4f} largest with it; tilt {tilt.max():.3f} µrad")
    assert len(distance) > 1500 and np.median(plain) > 15.0
    assert np.median(distance) < 0.01 and distance.max() < 0.2 and tilt.max() < 1.0
    # No axis turns by leaps at the singular position.
    turned, meant = (np.abs(np.diff(q[:, rotary], axis=0)).max(axis=0) for q in (joints, axes))
    assert np.all(turned < 1.5 * meant)


def _xyz(names: tuple[str, ...], tool: tuple[float, float, float]) -> np.ndarray:
    """Return (axes,) the tool's offsets, in the columns of the linear axes: the control adds them to the words of a program."""
    return np.array([tool["XYZ".index(name)] if name in "XYZ" else 0.0 for name in names])
