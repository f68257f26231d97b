"""Statements on a machine: true by homogeneous transforms that share no code with twin, and balls within the ranges."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.machine.test_description import DMU50, GANTRY, HAND_WRITTEN, TRUNNION, changed, expected_pose, made
from twin._common.errors import InputError
from twin.compensation.live.module import Damping, LiveCorrection
from twin.controls.kinematics.format import rotary_axes
from twin.machine.chain import gravity_load
from twin.machine.statements import TIP_MM, direction_words, picture, statements
from twin.model.calibration import Calibration

MACHINES: dict[str, dict[str, Any]] = {
    "trunnion": TRUNNION,
    "DMU 50": changed(DMU50, B__about=f"0 {0.5**0.5!r} {-(0.5**0.5)!r}"),
    "gantry": GANTRY,
    **{name: {"name": name, "table": {"X": 300, "Y": 250, "Z": -450}, **one} for name, one in HAND_WRITTEN.items()},
}
MACHINES["nutating head and table"] = changed(
    MACHINES["nutating head and table"], B__about=f"0 {0.5**0.5!r} {0.5**0.5!r}"
)

HORIZONTAL: dict[str, Any] = {
    "name": "horizontal machining centre",
    "spindle": "horizontal",
    "tool": ["X", "Y"],
    "work": ["Z", "B"],
    "table": {"X": 0, "Y": -100, "Z": 0},
    "axes": {
        "X": {"range": [-400, 400]},
        "Y": {"range": [-50, 700]},
        "Z": {"range": [100, 900]},
        "B": {"range": "unlimited", "at": "table 0 0 0"},
    },
}
MACHINES |= {
    "horizontal": HORIZONTAL,
    "tilting table of a horizontal spindle": changed(
        {**HORIZONTAL, "work": ["Z", "A", "B"]}, A__range=[-30, 120], A__at="table 0 -80 0"
    ),
    "right-angle head": {**GANTRY, "tool_axis": "1 0 0"},
}
SEEN = {"vertical": np.eye(3), "horizontal": np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])}
"""Right, back and up in the directions of the machine."""

WORD = r"([XYZABC])(-?[\d.]+)"


def pose(data: dict[str, Any], words: str) -> np.ndarray:
    """Return the tool (4, 4) of words such as ``X345.000 A-90.000``; axes that are not named are where the nose is at the table."""
    rest = {name: data["table"].get(name, 0.0) for name in data["axes"]}
    given = {name: float(value) for name, value in re.findall(WORD, words)}
    return expected_pose(data, rest | given, TIP_MM)


@pytest.mark.parametrize("name", MACHINES)
def test_statements_are_true(name: str, tmp_path: Path) -> None:
    data = MACHINES[name]
    seen = SEEN[data.get("spindle", "vertical")]
    found = statements(made(tmp_path, data))
    assert len(found) == 3 + 2 * sum(axis in "ABC" for axis in data["axes"])
    for one in found:
        ball = re.search(r"centrally at (.*) is found at (.*)$", one.text)
        turn = re.match(r"([ABC]) to (-?\d+), the other rotary axes at 0: (.*)", one.text)
        if ball is not None:
            first, second = (pose(data, words)[:3, 3] for words in ball.groups())
            for axis, value in re.findall(WORD, " ".join(ball.groups())):
                reach = data["axes"][axis]["range"]
                assert reach == "unlimited" or reach[0] <= float(value) <= reach[1]
            np.testing.assert_allclose(first, second, atol=2e-3)  # words of three decimals
            assert ball[1] != ball[2]
        elif turn is not None:
            rest, after = (pose(data, words)[:3, :3] for words in ("", f"{turn[1]}{turn[2]}"))
            if after[:, 2] @ rest[:, 2] < 0.999:
                assert turn[3].endswith(f"points {direction_words(after[:, 2], seen)}")
                other = pose(data, f"{turn[1]}{-float(turn[2])}")[:3, 2]
                assert direction_words(other, seen) in one.contradicted
            else:
                assert "turns" in turn[3]
            if "turns" in turn[3]:
                spin = seen @ (after @ rest.T) @ seen.T
                tool_turns = (spin[1, 0] - spin[0, 1]) * (1 if turn[1] in data["tool"] else -1) > 0.0
                assert ("counter-clockwise" in turn[3]) == tool_turns


def test_directions_in_words() -> None:
    assert direction_words(np.array([1.0, 0.0, 0.0])) == "to the right (+X)"
    assert direction_words(np.array([0.0, 1e-17, -1.0])) == "down (−Z)"
    assert direction_words(np.array([0.0, 1.0, 0.0]), SEEN["horizontal"]) == "up (+Y)"
    assert direction_words(np.array([-1.0, 0.0, 0.0]), SEEN["horizontal"]) == "to the right (−X)"
    assert direction_words(np.array([-0.8, 0.0, 0.6])) == "left and up (−0.800, +0.000, +0.600)"


def test_the_picture_shows_table_and_tool_twice(tmp_path: Path) -> None:
    machine = made(tmp_path, TRUNNION)
    drawn = picture(machine, statements(machine)[3].command)
    assert drawn.count("<polygon") == 4 and drawn.count("<polyline") == 4 and "nan" not in drawn


def test_gravity_pulls_along_minus_y_of_a_horizontal_spindle(tmp_path: Path) -> None:
    """The load of the vertical axis is the weight that it carries; the table about the vertical carries no moment of gravity."""
    machine = made(tmp_path, MACHINES["tilting table of a horizontal spindle"])
    q = np.zeros(len(machine.axes))
    q[machine.names.index("A")] = math.pi / 2.0
    at_rest, tilted = (np.array(gravity_load(machine)(one)) for one in (0.0 * q, q))
    spindle = [machine.names.index(name) for name in "XYZ"]
    # 1 kg at the spindle nose.
    np.testing.assert_allclose(at_rest[spindle, 1], [0.0, -9.81, 0.0], atol=1e-9)
    a, b = machine.names.index("A"), machine.names.index("B")
    assert at_rest[b, 0] == pytest.approx(0.0, abs=1e-9)
    # 1 kg·m along z of the table: about A at rest, about B once A has turned B's axis level.
    assert abs(at_rest[a, 8]) == pytest.approx(9.81) and at_rest[b, 6:].tolist() == pytest.approx([0.0, 0.0, 0.0])
    assert np.abs(tilted[b, 6:]).max() == pytest.approx(9.81)


def test_no_kinematics_for_a_tool_that_is_not_along_z(tmp_path: Path) -> None:
    for data in (GANTRY, TRUNNION, HORIZONTAL):
        made(tmp_path, data).check_tool_along_z()
    right_angle = made(tmp_path, MACHINES["right-angle head"])
    for refused in (
        lambda: rotary_axes(right_angle),
        lambda: LiveCorrection(Calibration.zero(right_angle), (), Damping.for_tilt(1e-4)),
    ):
        with pytest.raises(InputError, match="the tool is not along Z"):
            refused()
