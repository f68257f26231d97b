"""Spheres on the table of the DMU 50, probed at positions of B and C."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.machine.machine import Machine
from twin.measurement.table import Measurements

TIP = (0.0, 0.0, -150.0)
SPHERES = ((100.0, 0.0, 30.0), (-60.0, 80.0, 20.0), (-40.0, -90.0, 40.0))


def probing(
    machine: Machine,
    spheres: Sequence[Sequence[float]],
    poses: int,
    seed: int,
    *,
    tips: Sequence[Sequence[float]] = (TIP,),
) -> Measurements:
    """Return a plan: every sphere with every probe at random positions of B and C, all places given, without X, Y and Z."""
    rng = np.random.default_rng(seed)
    turns = np.stack([rng.uniform(0.0, 90.0, poses), rng.uniform(-180.0, 180.0, poses)], axis=1).round(1)
    rows = [(turn, k, p) for p in range(len(tips)) for k in range(len(spheres)) for turn in turns]
    n = len(rows)
    return Measurements(
        source="plan",
        lines=np.arange(n) + 2,
        positions=np.array([[250.0, 225.0, -200.0, *turn] for turn, _, _ in rows]),
        target=np.array([f"sphere {k + 1}" for _, k, _ in rows], dtype=object),
        carrier=np.full(n, "work", dtype=object),
        station=np.array([f"probe {p + 1}" for _, _, p in rows], dtype=object),
        station_carrier=np.full(n, "tool", dtype=object),
        point_mm=np.zeros((n, 3)),
        place_mm=np.array([spheres[k] for _, k, _ in rows]),
        station_pose=np.array([[*tips[p], 0.0, 0.0, 0.0] for _, _, p in rows]),
    )
