"""LinuxCNC: `compute_screw_comp` by hand."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

URAD_A_DEG = np.pi / 180.0 * 1e6
AGREES_UM = 1e-6
GOOD = {
    "joints.ini": "[TRAJ]\nCOORDINATES = X Y Z B C\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\n[JOINT_0]\nCOMP_FILE = X.comp\n"
    "COMP_FILE_TYPE = 0\n",
    "X.comp": "0 0.001 0.001\n100 100.002 100.002\n200 200.001 200.001\n",
}
BAD = [
    ("X.comp", "100 100.002", "# the middle\n100 100.002", 2, "LinuxCNC stops there"),
    ("X.comp", "100 100.002", "\n100 100.002", 2, "LinuxCNC stops there"),
    ("X.comp", "200 200.001", "90 200.001", 3, "do not increase"),
    ("X.comp", "100.002 100", "1e999 100", 2, "not a number"),
    ("joints.ini", "COMP_FILE_TYPE = 0", "COMP_FILE_TYPE = 2", 7, "COMP_FILE_TYPE"),
    ("joints.ini", "LINEAR_UNITS = mm", "LINEAR_UNITS = inch", 3, "LINEAR_UNITS"),
    ("joints.ini", "COMP_FILE = X.comp", "COMP_FILE = Y.comp", 6, "missing file"),
    ("joints.ini", "X Y Z B C", "V Y Z B C", 6, "no such axis"),
]
"""File, text replaced in it, replacement, line number and text of the error."""


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return motor position − commanded position, computed as in `compute_screw_comp`."""
    ini = (folder / "joints.ini").read_text()
    letters = re.search(r"^COORDINATES = (.*)$", ini, re.M)[1].split()
    section = ini.split(f"[JOINT_{letters.index(axis)}]")[1].split("[")[0]
    file, kind = re.search(r"COMP_FILE = (\S+)", section)[1], re.search(r"COMP_FILE_TYPE = (\d)", section)[1]
    entries = []
    for line in (folder / file).read_text().splitlines():
        try:
            nominal, forward, reverse = map(float, line.split()[:3])
        except ValueError:
            break
        entries.append((nominal, nominal - forward, nominal - reverse) if kind == "0" else (nominal, forward, reverse))
    found = []
    for q, side in zip(state[axis], state[f"approach_{axis}"], strict=True):
        trims = []
        for column in (1, 2):
            before = [i for i, entry in enumerate(entries) if entry[0] <= q]
            if not before:
                trims.append(entries[0][column])
            elif before[-1] == len(entries) - 1:
                trims.append(entries[-1][column])
            else:
                a, b = entries[before[-1]], entries[before[-1] + 1]
                trims.append(a[column] + (b[column] - a[column]) / (b[0] - a[0]) * (q - a[0]))
        found.append({1.0: trims[0], -1.0: trims[1], 0.0: sum(trims) / 2}[side])
    return np.array(found) * (1e3 if axis in "XYZ" else URAD_A_DEG)
