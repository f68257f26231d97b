"""The grid, interpolated by SciPy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

AGREES_UM = 1e-9
GOOD = {
    "grid.csv": "X_mm,Y_mm,Z_mm,dX_um,dY_um,dZ_um\n"
    + "".join(f"{x},{y},{z},1,2,3\n" for x in (0, 9) for y in (0, 9) for z in (-9, 0))
}
BAD = [
    ("grid.csv", "9,9,0,1", "9,9,0,x", 9, "not a number"),
    ("grid.csv", "9,9,0,1", "9,0,0,1", 9, "duplicate point"),
    ("grid.csv", "9,9,0,1,2,3\n", "", None, "a point is missing"),
    ("grid.csv", "dX_um", "eX_um", None, "columns"),
]
"""File, text replaced in it, replacement, line number and text of the error."""


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the trilinear interpolation at the nearest point of the box."""
    rows = np.loadtxt(folder / "grid.csv", delimiter=",", comments=("#", "X"))
    nodes = [np.unique(rows[:, i]) for i in range(3)]
    values = rows[:, 3:].reshape(*map(len, nodes), 3)
    inside = np.stack([np.clip(state[name], at[0], at[-1]) for name, at in zip("XYZ", nodes, strict=True)], axis=1)
    return RegularGridInterpolator(nodes, values, bounds_error=False)(inside)[:, "XYZ".index(axis)]
