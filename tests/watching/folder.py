"""Folders of short checks of the truth machine: spheres probed in several poses, over weeks; shares no code with `twin`."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from tests.truth.machine import TruthMachine, carried

TIP = np.array([0.0, 0.0, -150.0])
START = datetime(2026, 3, 2, 7, 30)
SPHERES = {
    "S1": np.array([120.0, 10.0, 60.0]),
    "S2": np.array([-70.0, 110.0, 90.0]),
    "S3": np.array([-60.0, -105.0, 75.0]),
}
POSES = [(b, c) for b in (0.0, 30.0, 60.0) for c in (0.0, 90.0, 180.0, 270.0)]
NOISE_MM = 0.0003
"""Noise of each coordinate of a sphere's centre."""


def probed(truth: TruthMachine, place: np.ndarray, tip: np.ndarray, b: float, c: float) -> np.ndarray:
    """Return the X, Y, Z at which the tip is at the centre of a sphere on the table, mm."""
    q = np.array([250.0, 225.0, -200.0, b, c])
    for _ in range(6):
        off = carried(truth, q, "work", place) - carried(truth, q, "tool", tip)
        q[:3] += off
        if np.abs(off).max() < 1e-7:
            break
    return q[:3]


def write_check(
    path: Path,
    truth: TruthMachine,
    rng: np.random.Generator,
    *,
    temperatures: dict[str, float] | None = None,
    comment: str = "",
) -> Path:
    """Write one check: three spheres, set up anew, in every pose that the travels reach."""
    tip = TIP + rng.normal(0.0, 0.05, 3)
    shift = rng.normal(0.0, 2.0, 3)
    sensors = temperatures or {}
    head = ["X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg", "target", "carrier", "x_mm", "y_mm", "z_mm"]
    head += ["station", "station_carrier", "instrument", *(f"T_{name}_degC" for name in sensors)]
    rows = []
    for name, place in SPHERES.items():
        for b, c in POSES:
            x, y, z = probed(truth, place + shift, tip, b, c) + rng.normal(0.0, NOISE_MM, 3)
            if 0.0 <= x <= 500.0 and 0.0 <= y <= 450.0 and -400.0 <= z <= 0.0:
                cells = [f"{x:.5f}", f"{y:.5f}", f"{z:.5f}", f"{b:g}", f"{c:g}", name, "work", "0", "0", "0", "1"]
                rows.append([*cells, "tool", "probe", *(f"{value:.3f}" for value in sensors.values())])
    lines = [*([f"# {comment}"] if comment else []), ",".join(head), *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_folder(
    folder: Path,
    truth: TruthMachine,
    checks: int,
    *,
    seed: int,
    deviation: Callable[[int, TruthMachine, dict[str, float]], None] = lambda i, machine, temperatures: None,
    temperatures: Callable[[int], dict[str, float]] = lambda i: {},
    repeatability: float = 0.0,
) -> Path:
    """Write a folder of checks, three to four days apart.

    Args:
        folder: to be made.
        truth: the machine; its squareness and locations are changed for each check.
        checks: number of checks.
        seed: of noise and set-up.
        deviation: changes a copy of the machine for check i, given its temperatures.
        temperatures: of check i, by sensor.
        repeatability: standard deviation of every squareness and location between the checks, µm and µrad.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    squareness, location = dict(truth.squareness), dict(truth.location)
    day = START
    for i in range(checks):
        truth.squareness, truth.location = (
            {name: value + rng.normal(0.0, repeatability) for name, value in own.items()}
            for own in (squareness, location)
        )
        degrees = temperatures(i)
        deviation(i, truth, degrees)
        write_check(folder / f"spheres_{day:%Y-%m-%dT%H-%M}.csv", truth, rng, temperatures=degrees)
        day += timedelta(days=3 + i % 2)
    truth.squareness, truth.location = squareness, location
    return folder
