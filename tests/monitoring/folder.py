"""Folders of short checks of the truth machine: spheres probed in several poses, over weeks; shares no code with `twin`."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np

from tests.truth.machine import TruthMachine, carried

CALIBRATION = Path(__file__).resolve().parents[2] / "urdf" / "dmu50.calibration.yaml"
BAR_MM = 100.0
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
    noise_mm: float = NOISE_MM,
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
            x, y, z = probed(truth, place + shift, tip, b, c) + rng.normal(0.0, noise_mm, 3)
            if 0.0 <= x <= 500.0 and 0.0 <= y <= 450.0 and -400.0 <= z <= 0.0:
                cells = [f"{x:.5f}", f"{y:.5f}", f"{z:.5f}", f"{b:g}", f"{c:g}", name, "work", "0", "0", "0", "1"]
                rows.append([*cells, "tool", "probe", *(f"{value:.3f}" for value in sensors.values())])
    lines = [*([f"# {comment}"] if comment else []), ",".join(head), *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@cache
def nominal_xyz(sphere: str, b: float, c: float) -> np.ndarray:
    """Return the X, Y, Z at which the tip of a machine without errors is at a sphere, mm."""
    found = TruthMachine(CALIBRATION)
    found.curves, found.squareness, found.location = {}, {}, {}
    return probed(found, SPHERES[sphere], TIP, b, c)


def within_travels(q: np.ndarray) -> bool:
    return bool(np.all(q[:3] >= [0.0, 0.0, -400.0]) and np.all(q[:3] <= [500.0, 450.0, 0.0]))


def write_nest_check(
    path: Path,
    truth: TruthMachine,
    rng: np.random.Generator,
    *,
    temperatures: dict[str, float] | None = None,
    comment: str = "",
) -> Path:
    """Write one R-test check: a nest at two places on the table, set up anew, reads the ball in the spindle in every pose."""
    tip = TIP + rng.normal(0.0, 0.05, 3)
    rows = []
    for name in ("S1", "S2"):
        place = SPHERES[name] + rng.normal(0.0, 2.0, 3)
        for b, c in POSES:
            q = np.array([*nominal_xyz(name, b, c), b, c])
            if within_travels(q):
                origin = carried(truth, q, "work", np.zeros(3))
                turn = np.stack([carried(truth, q, "work", np.eye(3)[k]) - origin for k in range(3)])
                read = turn @ (carried(truth, q, "tool", tip) - carried(truth, q, "work", place))
                rows.append((q, name, read + rng.normal(0.0, NOISE_MM, 3)))
    return _write(path, rows, "r-test", temperatures or {}, comment)


def write_bar_check(
    path: Path,
    truth: TruthMachine,
    rng: np.random.Generator,
    *,
    temperatures: dict[str, float] | None = None,
    comment: str = "",
) -> Path:
    """Write one ball bar check: circles in three planes, then turns of C and tilts of B with the bar along X, Y and Z."""
    pivot, tip = SPHERES["S1"] + rng.normal(0.0, 0.05, 3), TIP + rng.normal(0.0, 0.05, 3)
    whole, upper = np.radians(np.arange(0.0, 360.0, 30.0)), np.radians(np.arange(0.0, 181.0, 22.5))
    poses = [(0.0, 0.0, np.array([np.cos(a), np.sin(a), 0.0])) for a in whole]
    poses += [(0.0, 0.0, np.array([np.cos(a), 0.0, np.sin(a)])) for a in upper]
    poses += [(0.0, 0.0, np.array([0.0, np.cos(a), np.sin(a)])) for a in upper]
    turns = [*((0.0, float(c)) for c in range(0, 360, 45)), *((float(b), 0.0) for b in range(0, 91, 15))]
    poses += [(b, c, np.eye(3)[k]) for b, c in turns for k in range(3)]
    rows = []
    for b, c, way in poses:
        q = np.array([*nominal_xyz("S1", b, c) + BAR_MM * way, b, c])
        if within_travels(q):
            length = np.linalg.norm(carried(truth, q, "tool", tip) - carried(truth, q, "work", pivot))
            rows.append((q, "pivot", np.array([length + rng.normal(0.0, NOISE_MM), np.nan, np.nan])))
    return _write(path, rows, "ball-bar", temperatures or {}, comment)


def _write(
    path: Path, rows: list[tuple[np.ndarray, str, np.ndarray]], instrument: str, sensors: dict[str, float], comment: str
) -> Path:
    """Write readings of a ball in the spindle from a station on the table."""
    head = ["X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg", "target", "carrier", "x_mm", "y_mm", "z_mm"]
    head += ["station", "station_carrier", "instrument", *(f"T_{name}_degC" for name in sensors)]
    lines = [*([f"# {comment}"] if comment else []), ",".join(head)]
    for q, station, read in rows:
        cells = [*(f"{v:.5f}" for v in q), "ball", "tool", *("" if np.isnan(v) else f"{v:.6f}" for v in read)]
        lines.append(",".join([*cells, station, "work", instrument, *(f"{v:.3f}" for v in sensors.values())]))
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
    write: Callable[..., Path] = write_check,
) -> Path:
    """Write a folder of checks, three to four days apart.

    Args:
        folder: to be made.
        truth: the machine; its squareness and locations are changed for each check.
        checks: number of checks.
        seed: of noise and set-up.
        deviation: changes a copy of the machine for check i, given its temperatures.
        temperatures: of check i, by sensor.
        write: writes one check.
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
        write(folder / f"check_{day:%Y-%m-%dT%H-%M}.csv", truth, rng, temperatures=degrees)
        day += timedelta(days=3 + i % 2)
    truth.squareness, truth.location = squareness, location
    return folder
