"""The head-head gantry of `../shared/data/real/probe-sphere` that probed one sphere at 32 orientations, as a measurement table.

The file gives coordinates of the tip under tool centre point control (their spread, 437 µm, is that of the tip): the axis positions
follow with the nominal kinematics of the control, C to B (0.011, 0, -270) mm and B to tip (-0.67, 0, -309) mm.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Final

import numpy as np

HERE: Final = Path(__file__).parent
MACHINE: Final = HERE / "head_head.yaml"
C_TO_B: Final = np.array([0.011, 0.0, -270.0])
B_TO_TIP: Final = np.array([-0.67, 0.0, -309.0])


def lever(c_deg: float, b_deg: float) -> np.ndarray:
    """Return (3,) the nominal tip relative to the position of X, Y and Z, mm."""
    c, b = np.radians([c_deg, b_deg])
    about_z = np.array([[np.cos(c), -np.sin(c), 0.0], [np.sin(c), np.cos(c), 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[np.cos(b), 0.0, np.sin(b)], [0.0, 1.0, 0.0], [-np.sin(b), 0.0, np.cos(b)]])
    return np.asarray(about_z @ (C_TO_B + about_y @ B_TO_TIP))


def write_table(source: Path, path: Path) -> Path:
    """Write the axis positions at which the probe's tip was at the centre of the sphere as a measurement table."""
    with source.open(encoding="utf-8") as lines, path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow("X_mm Y_mm Z_mm C_deg B_deg target carrier x_mm y_mm z_mm station station_carrier".split())
        for row in csv.DictReader(lines):
            c, b = float(row["C_deg"]), float(row["B_deg"])
            linear = np.array([float(row[name]) for name in ("X_mm", "Y_mm", "Z_mm")]) - lever(c, b)
            writer.writerow([*(f"{v:.6f}" for v in linear), c, b, "sphere", "work", 0, 0, 0, "probe", "tool"])
    return path
