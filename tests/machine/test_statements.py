"""Statements on a machine: true by homogeneous transforms that share no code with twin, and balls within the ranges."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.machine.test_description import DMU50, GANTRY, HAND_WRITTEN, TRUNNION, changed, expected_pose, made
from twin.machine.statements import TIP_MM, direction_words, picture, statements

MACHINES: dict[str, dict[str, Any]] = {
    "trunnion": TRUNNION,
    "DMU 50": changed(DMU50, B__about=f"0 {0.5**0.5!r} {-(0.5**0.5)!r}"),
    "gantry": GANTRY,
    **{name: {"name": name, "table": {"X": 300, "Y": 250, "Z": -450}, **one} for name, one in HAND_WRITTEN.items()},
}
MACHINES["nutating head and table"] = changed(
    MACHINES["nutating head and table"], B__about=f"0 {0.5**0.5!r} {0.5**0.5!r}"
)

WORD = r"([XYZABC])(-?[\d.]+)"


def pose(data: dict[str, Any], words: str) -> np.ndarray:
    """Return the tool (4, 4) of words such as ``X345.000 A-90.000``; axes that are not named are where the nose is at the table."""
    rest = {name: data["table"].get(name, 0.0) for name in data["axes"]}
    given = {name: float(value) for name, value in re.findall(WORD, words)}
    return expected_pose(data, rest | given, TIP_MM)


@pytest.mark.parametrize("name", MACHINES)
def test_statements_are_true(name: str, tmp_path: Path) -> None:
    data = MACHINES[name]
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
            axis = pose(data, f"{turn[1]}{turn[2]}")[:3, 2]
            if axis[2] < 0.999:
                assert turn[3].endswith(f"points {direction_words(axis)}")
                other = pose(data, f"{turn[1]}{-float(turn[2])}")[:3, 2]
                assert direction_words(other) in one.contradicted
            else:
                x = pose(data, f"{turn[1]}{turn[2]}")[:3, 0]
                tool_turns = x[1] * (1 if turn[1] in data["tool"] else -1) > 0.0
                assert ("counter-clockwise" in turn[3]) == tool_turns


def test_directions_in_words() -> None:
    assert direction_words(np.array([1.0, 0.0, 0.0])) == "to the right (+X)"
    assert direction_words(np.array([0.0, 1e-17, -1.0])) == "down (−Z)"
    assert direction_words(np.array([-0.8, 0.0, 0.6])) == "left and up (−0.800, +0.000, +0.600)"


def test_the_picture_shows_table_and_tool_twice(tmp_path: Path) -> None:
    machine = made(tmp_path, TRUNNION)
    drawn = picture(machine, statements(machine)[3].command)
    assert drawn.count("<polygon") == 4 and drawn.count("<polyline") == 4 and "nan" not in drawn
