"""SINUMERIK: independent evaluation of the CEC tables."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

URAD_A_DEG = np.pi / 180.0 * 1e6
AGREES_UM = 1e-6
GOOD = {
    "cec.mpf": "$AN_CEC[0,0]=0.01\n$AN_CEC[0,1]=0.02\n$AN_CEC_INPUT_AXIS[0]=(AX1)\n$AN_CEC_OUTPUT_AXIS[0]=(AX2)\n"
    "$AN_CEC_STEP[0]=100\n$AN_CEC_MIN[0]=0\n$AN_CEC_MAX[0]=100\n$AN_CEC_MULT_BY_TABLE[0]=0\nM17\n"
}
BAD = [
    ("cec.mpf", "$AN_CEC[0,1]=0.02\n", "", 1, "points"),
    ("cec.mpf", "STEP[0]=100", "STEP[0]=30", 5, "does not divide"),
    ("cec.mpf", "STEP[0]=100", "STEP[0]=1e-308", 5, "does not divide"),
    ("cec.mpf", "STEP[0]=100", "STEP[0]=1e-300", 1, "points"),
    ("cec.mpf", "$AN_CEC_MAX[0]=100\n", "", 1, "lacks"),
    ("cec.mpf", "(AX2)", "(AX9)", 4, "no such axis"),
    ("cec.mpf", "BY_TABLE[0]=0", "BY_TABLE[0]=7", 8, "no such table"),
    ("cec.mpf", "M17", "G0 X100", 9, "not a line of a compensation table"),
    ("cec.mpf", "[0,1]=0.02", "[0,1]=$R1", 2, "not a number"),
    ("cec.mpf", "[0,1]=0.02", "[0,0]=0.02", 2, "assigned twice"),
]
"""File, text replaced in it, replacement, line number and text of the error."""


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the sum of the axis's tables and products; a table that multiplies another does not count by itself."""
    names = [name for name in state if not name.startswith("approach_")]  # AX1, AX2, …
    text = (folder / "cec.mpf").read_text()
    single = dict(re.findall(r"^\$AN_CEC_(\w+\[\d+\])=\(?([^)\n]+)\)?$", text, re.M))
    points: dict[int, list[float]] = {}
    for table, _, value in re.findall(r"^\$AN_CEC\[(\d+),(\d+)\]=(\S+)$", text, re.M):
        points.setdefault(int(table), []).append(float(value))

    def looked_up(t: int) -> np.ndarray:
        low, high = float(single[f"MIN[{t}]"]), float(single[f"MAX[{t}]"])
        of = names[int(single[f"INPUT_AXIS[{t}]"][2:]) - 1]
        q = state[of]
        if single[f"IS_MODULO[{t}]"] == "1":
            q = low + np.mod(q - low, high - low)
        value = np.interp(q, np.linspace(low, high, len(points[t])), points[t])
        direction, side = int(single[f"DIRECTION[{t}]"]), state[f"approach_{of}"]
        return value if direction == 0 else value * np.where(side == direction, 1.0, np.where(side == 0, 0.5, 0.0))

    multiplied = {int(single[f"MULT_BY_TABLE[{t}]"]) - 1 for t in points} - {-1}
    total = np.zeros(len(state[axis]))
    for t in points:
        if t in multiplied or names[int(single[f"OUTPUT_AXIS[{t}]"][2:]) - 1] != axis:
            continue
        by = int(single[f"MULT_BY_TABLE[{t}]"])
        total += looked_up(t) * (looked_up(by - 1) if by else 1.0)
    return total * (1e3 if axis in "XYZ" else URAD_A_DEG)
