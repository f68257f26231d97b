"""Tracker export: two targets in blocks of three positions."""

from __future__ import annotations

import numpy as np

from twin.measurement.formats import Given
from twin.measurement.table import Measurements

FILE = "Round 1.csv"
MACHINE = "dmu50"
AT = np.array([[x, 225.0, -200.0, 0.0, 0.0] for x in (0.0, 100.0, 200.0)] * 2)
POINTS = np.array([[1000.0 + x, 10.0 * k, 3.5] for k in range(2) for x in (0.0, 100.0, 200.0)])
PLAN = Measurements(
    source="plan.csv",
    lines=np.arange(2, 8),
    positions=AT,
    target=np.array(["K"] * 3 + ["P"] * 3, dtype=object),
    carrier=np.array(["tool"] * 6, dtype=object),
    station=np.array(["T"] * 6, dtype=object),
    approach=np.array([[1.0, 0.0, 0.0, 0.0, 0.0]] * 6),
)
GIVEN = Given(plan=PLAN)
GOOD = "".join(f"p{i}, {x}, {y}, {z}\n" for i, (x, y, z) in enumerate(POINTS))
ROWS = {"positions": AT, "point_mm": POINTS, "approach": np.asarray(PLAN.approach)}
SIDES = ("T", "base", "tool")
AGREES_MM = 0.0
BAD = [
    ("p0, 1000.0, 0.0, 3.5\n", "", None, "5 points"),
    ("p2, 1200.0", "p2, x", 3, "not a measured point"),
]
