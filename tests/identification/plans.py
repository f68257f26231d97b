"""Measurement tables for tests of identification: plans, stations, and the readings of a machine in plain numpy."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from tests.truth.machine import TruthMachine, carried, seen
from twin._common.arrays import read_only
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

LOW, HIGH = np.array([0.0, 0.0, -400.0, 0.0, 0.0]), np.array([500.0, 450.0, 0.0, 180.0, 360.0])
PLACES = {
    "K": ("tool", (-100.0, 70.0, 180.0)),
    "P": ("tool", (30.0, -70.0, 10.0)),
    "Q": ("tool", (110.0, 60.0, 150.0)),
    "KT": ("work", (-60.0, 130.0, 170.0)),
    "PT": ("work", (-100.0, -200.0, 30.0)),
    "QT": ("work", (60.0, 90.0, 140.0)),
}
"""Three targets on each side, not on a line; mm."""
STATIONS = {
    "1": (0.0, -2000.0, 200.0, 0.0, 0.0, 1.6),
    "2": (1900.0, -300.0, 700.0, 0.1, -0.2, 3.0),
    "3": (-1700.0, -900.0, 1100.0, 0.0, 0.3, 0.2),
    "4": (-300.0, 600.0, 2100.0, 0.2, 1.4, 0.0),
}
"""Positions around the machine: origin in mm, rotation vector; the fourth from above."""


def table(
    machine: Machine, positions: np.ndarray, target: np.ndarray, station: np.ndarray, number: np.ndarray | None = None
) -> Measurements:
    """Return a plan: (n, axes) positions, (n,) names of targets of `PLACES`, of stations and of rounds; no places or stations given."""
    n = len(positions)

    def unknown(*more: int) -> np.ndarray:
        return read_only(np.full((n, *more), np.nan))

    return Measurements(
        source="a test",
        lines=read_only(np.arange(2, n + 2)),
        positions=read_only(np.asarray(positions, dtype=float)),
        readback=unknown(len(machine.axes)),
        target=read_only(np.array(target, dtype=object)),
        carrier=read_only(np.array([PLACES[name][0] for name in target], dtype=object)),
        station=read_only(np.array(station, dtype=object)),
        round=read_only(np.full(n, "1", dtype=object) if number is None else np.array(number, dtype=object)),
        point_mm=unknown(3),
        u_mm=unknown(3),
        time_s=unknown(),
        approach=read_only(np.zeros((n, len(machine.axes)))),
        place_mm=unknown(3),
        station_pose=unknown(6),
        temperature_degC=MappingProxyType({}),
    )


def volumetric(machine: Machine, rng: np.random.Generator, points: int, stations: int = 2) -> Measurements:
    """Return random poses over the whole range, each with one target measured from one station."""
    positions = np.round(rng.uniform(LOW, HIGH, (points, 5)), 3)
    target = rng.choice(list(PLACES), points)
    return table(
        machine,
        positions,
        target,
        rng.choice(list(STATIONS)[:stations], points),
        rng.integers(1, 4, points).astype(str),
    )


def four_stations(machine: Machine, rng: np.random.Generator, poses: int) -> Measurements:
    """Return multilateration: every pose with one target on each side, measured from all four stations."""
    positions = np.round(rng.uniform(LOW, HIGH, (poses, 5)), 3)
    sides = [[name for name, (side, _) in PLACES.items() if side == carrier] for carrier in ("tool", "work")]
    targets = np.array([rng.choice(side, poses) for side in sides])
    each = len(STATIONS)
    return table(
        machine,
        np.tile(positions, (2 * each, 1)),
        np.repeat(targets, each, axis=0).reshape(-1),
        np.tile(np.repeat(list(STATIONS), poses), 2),
    )


def read_by_truth(plan: Measurements, truth: TruthMachine, *, dead_mm: float | None = None) -> Measurements:
    """Return the table of noise-free readings of the truth machine.

    Args:
        plan: what to measure.
        truth: the machine.
        dead_mm: None for a tracker; for an interferometer the dead path of the first station, each further one 10 mm more.
    """
    points = np.full((len(plan), 3), np.nan)
    names = list(dict.fromkeys(plan.station))
    for i in range(len(plan)):
        side, place = PLACES[plan.target[i]]
        pose = np.array(STATIONS[plan.station[i]])
        found = seen(pose[:3], pose[3:], carried(truth, plan.positions[i], side, np.array(place)))
        if dead_mm is None:
            points[i] = found
        else:
            points[i, 0] = np.linalg.norm(found) - dead_mm - 10.0 * names.index(plan.station[i])
    return replace(plan, point_mm=read_only(points), place_mm=plan.place_mm)


def with_places(data: Measurements) -> Measurements:
    """Return the data with the targets' places given."""
    return replace(data, place_mm=read_only(np.array([PLACES[name][1] for name in data.target])))
