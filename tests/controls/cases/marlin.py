"""Marlin: M852 means the machine that its factors describe; the targets are solved for, as in `tests.controls.cases.klipper`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.controls.cases.klipper import motors

AGREES_UM = 1e-6
GOOD = {"skew.gcode": "; note\nG21\nM852 I-0.001 J0.002 K0.0005\nM500\n"}
BAD = [
    ("skew.gcode", "I-0.001", "I-x", 3, "not a number"),
    ("skew.gcode", "J0.002", "J20", 3, "implausibly large"),
    ("skew.gcode", "J0.002", "I0.002", 3, "M852"),
    ("skew.gcode", "M852", "M851", 3, "not a M852 line"),
    ("skew.gcode", "M500", "M852 I0", None, "not one M852 line"),
]


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    text = re.search(r"^M852 (.*)$", (folder / "skew.gcode").read_text(), re.M)
    assert text is not None
    found = {word[0]: float(word[1:]) for word in text[1].split()}
    return (motors(found["I"], found["J"], found["K"], state)["XYZ".index(axis)] - state[axis]) * 1e3
