"""State of the machine for effects, and rows that were read at the origin of their station, from a measurement table."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, SIDES
from twin.measurement.table import Measurements

FEWEST_REPEATS: Final = 10
"""Degrees of freedom of repeats below which they do not decide on the noise."""
ANGLES: Final = tuple(one.name for one in INSTRUMENTS if one.specification.reads == "angle")
"""Names of the instruments that read angles."""


def machine_state(data: Measurements, machine: Machine) -> dict[str, np.ndarray]:
    """Return the positions and every channel that has no gaps, by name: ``approach_X``, ``time_s``, ``T_X_degC``, ``spindle_rpm``."""
    found = {axis.name: np.asarray(data.positions[:, i]) for i, axis in enumerate(machine.axes)}
    for i, axis in enumerate(machine.axes):
        if np.any(data.approach[:, i]):
            found[f"approach_{axis.name}"] = np.asarray(data.approach[:, i], dtype=float)
    if has_times(data):
        found["time_s"] = np.asarray(data.time_s)
    for name, values in data.temperature_degC.items():
        if np.all(np.isfinite(values)):
            found[f"T_{name}_degC"] = np.asarray(values)
    return found | {name: np.asarray(values) for name, values in data.channels.items() if np.all(np.isfinite(values))}


def has_times(data: Measurements) -> bool:
    """Return whether every row has a time."""
    return bool(np.all(np.isfinite(data.time_s)))


def order_in_time(data: Measurements) -> np.ndarray:
    """Return (n,) the rows in the order of time if every row has one, else in that of the table."""
    return np.argsort(data.time_s, kind="stable") if has_times(data) else np.arange(len(data))


def of_angles(data: Measurements) -> np.ndarray:
    """Return (n,) whether a row is of an instrument that reads angles."""
    return np.isin(data.instrument.astype(str), ANGLES)


def at_origin(data: Measurements) -> np.ndarray:
    """Return (n,) whether a target was read at its station's origin: a probe's tip at the centre of a sphere."""
    probed = (data.station_carrier != SIDES[0]) & ~of_angles(data)
    return np.asarray(probed & (np.nan_to_num(data.point_mm, nan=1.0) == 0.0).all(axis=1))


def repeat_groups(data: Measurements) -> np.ndarray:
    """Return (n,) the index of the point that each row repeats: same command, target, station and directions of approach.

    A probe finds the same point again at slightly other positions of the axes.
    """
    positions = np.where(at_origin(data)[:, None], np.round(data.positions, 0), np.round(data.positions, 6))
    keys = np.concatenate([positions, data.approach], axis=1)
    _, pose = np.unique(keys, axis=0, return_inverse=True)
    _, target = np.unique(data.target.astype(str), return_inverse=True)
    _, station = np.unique(data.station.astype(str), return_inverse=True)
    _, group = np.unique(np.stack([pose.reshape(-1), target, station], axis=1), axis=0, return_inverse=True)
    return np.asarray(group.reshape(-1))


def repeats_dof(data: Measurements) -> int:
    """Return the degrees of freedom of repeats, per coordinate."""
    return int(np.sum(np.maximum(np.bincount(repeat_groups(data)) - 1, 0)))
