"""Measurement plan of a truth machine, in the order of measurement, and its measurement table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class TruthAxis:
    """One axis of a truth machine.

    Attributes:
        name: name in tables.
        linear: whether it translates (mm) or turns (degrees).
        low, high: measured range, mm or degrees.
        side: ``tool`` or ``work``.
        endless: whether its range is unlimited; ``high`` is then ``low`` plus one turn.
    """

    name: str
    linear: bool
    low: float
    high: float
    side: str
    endless: bool = False

    @property
    def column(self) -> str:
        """Name of its column in the table."""
        return f"{self.name}_{'mm' if self.linear else 'deg'}"


@dataclass(frozen=True, eq=False)
class Plan:
    """Measurement plan with n rows, each a reading of one target.

    Attributes:
        axes: axes of the machine, in command order.
        q: (n, axes) commands, mm or degrees.
        approach: (n, axes) direction of approach, +1 or −1.
        target, carrier, station, round: (n,) names.
        time_s: (n,) seconds.
        warm: (n,) temperatures by sensor, °C.
        channels: further columns by name.
    """

    axes: tuple[TruthAxis, ...]
    q: np.ndarray
    approach: np.ndarray
    target: np.ndarray
    carrier: np.ndarray
    station: np.ndarray
    round: np.ndarray
    time_s: np.ndarray
    warm: dict[str, np.ndarray]
    channels: dict[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.q)

    def at(self, axis: str) -> np.ndarray:
        """Return (n,) commands of one axis."""
        return self.q[:, [one.name for one in self.axes].index(axis)]

    def approach_of(self, axis: str) -> np.ndarray:
        """Return (n,) directions of approach of one axis, +1 or −1."""
        return self.approach[:, [one.name for one in self.axes].index(axis)]

    def columns(self) -> dict[str, np.ndarray]:
        """Return positions, time and temperatures by their column names."""
        found = {axis.column: self.q[:, i] for i, axis in enumerate(self.axes)}
        return found | {"time_s": self.time_s} | {f"T_{name}_degC": values for name, values in self.warm.items()}


def write_table(path: Path, plan: Plan, read: np.ndarray, u_mm: float, comments: Sequence[str] = ()) -> Path:
    """Write a measurement table.

    Args:
        path: path of the table.
        plan: the measurement plan.
        read: (n, 3) readings, mm.
        u_mm: standard uncertainty of the readings, mm.
        comments: lines before the header.
    """
    columns: dict[str, np.ndarray] = {axis.column: plan.q[:, i] for i, axis in enumerate(plan.axes)}
    columns |= {"target": plan.target, "carrier": plan.carrier, "station": plan.station, "round": plan.round}
    columns |= {"time_s": plan.time_s}
    columns |= {f"approach_{axis.name}": plan.approach[:, i].astype(int) for i, axis in enumerate(plan.axes)}
    columns |= {f"T_{name}_degC": values for name, values in plan.warm.items()} | plan.channels
    columns |= {f"{c}_mm": read[:, i] for i, c in enumerate("xyz")}
    columns |= {f"u_{c}_mm": np.full(len(plan), u_mm) for c in "xyz"}
    with path.open("w", newline="") as file:
        file.writelines(f"# {line}\n" for line in comments)
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
    return path
