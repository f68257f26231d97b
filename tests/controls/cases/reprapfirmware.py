"""RepRapFirmware: M556, whose tangents are added: X by Y, Y by Z, X by Z."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

AGREES_UM = 1e-6
GOOD = {"skew.g": "; note\nM556 S100 X0.1 Y-0.2 Z0.05\n"}
BAD = [
    ("skew.g", "X0.1", "X0.1mm", 2, "not a number"),
    ("skew.g", "X0.1", "X40", 2, "implausibly large"),
    ("skew.g", "S100", "S1", 2, "ignores M556"),
    ("skew.g", "Z0.05", "P1", 2, "P1 corrects Y"),
    ("skew.g", "M556", "M557", 2, "not a M556 line"),
]


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    (text,) = re.findall(r"^M556 (.*)$", (folder / "skew.g").read_text(), re.M)
    word = {one[0]: float(one[1:]) for one in text.split()}
    tangent = {letter: word[letter] / word["S"] for letter in "XYZ"}
    added = {
        "X": tangent["X"] * state["Y"] + tangent["Z"] * state["Z"],
        "Y": tangent["Y"] * state["Z"],
        "Z": 0.0 * state["Z"],
    }
    return added[axis] * 1e3
