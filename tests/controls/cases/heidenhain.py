"""HEIDENHAIN: independent evaluation of the columns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

URAD_A_DEG = np.pi / 180.0 * 1e6
AGREES_UM = 1e-6
GOOD = {
    "CONFIG.CMA": "BEGIN CONFIG.CMA MM\nNR ACTIVE X\n0 * X_CORR\n[END]\n",
    "X_CORR.COM": "BEGIN X_CORR.COM MM\nNR AXISPOS X Y\n0 0 +0.001 +0.002\n1 100 +0.002 +0.001\n[END]\n",
}
BAD = [
    ("X_CORR.COM", "+0.002 +0.001", "+0.002", 4, "cells"),
    ("X_CORR.COM", "1 100", "1 0", 4, "do not increase"),
    ("X_CORR.COM", "X Y", "X W", 2, "no such axis"),
    ("X_CORR.COM", "+0.001 +0.002", "+0.001 ja", 3, "not a number"),
    ("X_CORR.COM", "COM MM", "COM INCH", 1, "not in mm"),
    ("CONFIG.CMA", "* X_CORR", "- X_CORR", None, r"lines with \*"),
    ("CONFIG.CMA", "* X_CORR", "* Q_CORR", 3, "missing table"),
]
"""File, text replaced in it, replacement, line number and text of the error."""


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the negative errors from the columns of the axis, over the axes given in the .CMA file."""
    rows = [line.split() for line in (folder / "CONFIG.CMA").read_text().splitlines()]
    total = np.zeros(len(state[axis]))
    for of, name in list(zip(rows[1], rows[2], strict=True))[2:]:
        lines = [line.split() for line in (folder / f"{name}.COM").read_text().split("[END]")[0].splitlines()[1:]]
        table = {key: np.array([float(line[i]) for line in lines[1:]]) for i, key in enumerate(lines[0])}
        q = np.mod(state[of], 360.0) if of == "C" else state[of]
        if axis not in table:
            continue
        forward = np.interp(q, table["AXISPOS"], table[axis])
        backward = np.interp(q, table["AXISPOS"], table["BACKLASH"]) if axis == of and "BACKLASH" in table else forward
        side = state[f"approach_{of}"]
        total -= np.where(side > 0, forward, np.where(side < 0, backward, 0.5 * (forward + backward)))
    return total * (1e3 if axis in "XYZ" else URAD_A_DEG)
