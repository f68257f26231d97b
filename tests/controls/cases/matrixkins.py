"""LinuxCNC: joints = C · axes of matrixkins."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

AGREES_UM = 1e-6
GOOD = {
    "matrixkins.hal": "# note\nsetp matrixkins.C_xx 1.001\nsetp matrixkins.C_xy -0.002\nsetp matrixkins.C_zx 0.001\n"
}
BAD = [
    ("matrixkins.hal", "1.001", "1,001", 2, "not a number"),
    ("matrixkins.hal", "1.001", "0.001", 2, "implausibly large"),
    ("matrixkins.hal", "C_zx", "C_xy", 4, "twice"),
    ("matrixkins.hal", "C_zx", "C_zw", 4, "not one of these settings"),
]


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    entries = re.findall(r"^setp matrixkins\.C_(.)(.) (\S+)", (folder / "matrixkins.hal").read_text(), re.M)
    joint = sum(float(value) * state[by.upper()] for moved, by, value in entries if moved.upper() == axis)
    return (joint - state[axis]) * 1e3
