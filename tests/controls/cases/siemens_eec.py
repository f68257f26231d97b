"""SINUMERIK: independent evaluation of the LEC tables."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

URAD_A_DEG = np.pi / 180.0 * 1e6
AGREES_UM = 1e-6
GOOD = {
    "eec.mpf": "%_N_AX_EEC_INI\nCHANDATA(1)\n$AA_ENC_COMP[0,0,AX1]=0.003\n$AA_ENC_COMP[0,1,AX1]=0.01\n$AA_ENC_COMP[0,2,AX1]=0.0\n"
    "$AA_ENC_COMP_STEP[0,AX1]=50\n$AA_ENC_COMP_MIN[0,AX1]=-20\n$AA_ENC_COMP_MAX[0,AX1]=80\nM17\n"
}
BAD = [
    ("eec.mpf", "$AA_ENC_COMP[0,1,AX1]=0.01\n", "", 3, "points"),
    ("eec.mpf", "STEP[0,AX1]=50", "STEP[0,AX1]=30", 6, "does not divide"),
    ("eec.mpf", "STEP[0,AX1]=50", "STEP[0,AX1]=1e-308", 6, "does not divide"),
    ("eec.mpf", "STEP[0,AX1]=50", "STEP[0,AX1]=1e-300", 3, "points"),
    ("eec.mpf", "$AA_ENC_COMP_MAX[0,AX1]=80\n", "", 3, "lacks"),
    ("eec.mpf", "[0,1,AX1]=0.01", "[0,0,AX1]=0.01", 4, "assigned twice"),
    ("eec.mpf", "[0,1,AX1]=0.01", "[0,1,AX1]=$R1", 4, "not a number"),
    ("eec.mpf", "[0,1,AX1]=0.01", "[0,1,AX9]=0.01", 4, "no such axis"),
    ("eec.mpf", "[0,1,AX1]=0.01", "[1,1,AX1]=0.01", 4, "not a line of a compensation table"),
    ("eec.mpf", "STEP[0,AX1]=50", "STEP[0,1,AX1]=50", 6, "wrong indices"),
]
"""File, text replaced in it, replacement, line number and text of the error."""


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the correction: a positive value moves the axis back; beyond the range the end values hold, or modulo."""
    names = [name for name in state if not name.startswith("approach_")]  # AX1, AX2, …
    text, number = (folder / "eec.mpf").read_text(), names.index(axis) + 1
    points = [float(value) for value in re.findall(rf"^\$AA_ENC_COMP\[0,\d+,AX{number}\]=(\S+)$", text, re.M)]
    low, high, modulo = (
        float(re.search(rf"^\$AA_ENC_COMP_{name}\[0,AX{number}\]=(\S+)$", text, re.M)[1])
        for name in ("MIN", "MAX", "IS_MODULO")
    )
    q = low + np.mod(state[axis] - low, high - low) if modulo else state[axis]
    value = -np.interp(q, np.linspace(low, high, len(points)), points)
    return value * (1e3 if axis in "XYZ" else URAD_A_DEG)
