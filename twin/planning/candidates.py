"""Everything that could be measured: poses that are safe, reflectors that are seen there, from every place a station may stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.clearance import Clearance
from twin.planning.kit import Kit
from twin.planning.sight import Sight
from twin.uncertainty.budget import latin_hypercube

POSES: Final = 240
TRIES: Final = 8
"""Times as many are drawn at most before it is said that there is no room."""
FEWEST: Final = 20
ROUND: Final = 1.0
"""mm and degrees: commands a person can read."""
AT_AN_END: Final = 0.4
"""Share of the poses that have an axis at an end of its range: curves are worst known there."""


@final
@dataclass(frozen=True)
class Session:
    """A state of the machine in which readings are taken.

    Attributes:
        words: how to bring it about.
        start_s: on the clock of ``time_s``, at the earliest.
        temperatures: °C of axes and sensors.
    """

    words: str
    start_s: float = 0.0
    temperatures: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


ALWAYS: Final = (Session("as it is"),)
"""Where the state does not matter."""


@final
@dataclass(frozen=True)
class Candidates:
    """Readings that could be taken, in any state of the machine.

    Attributes:
        plan: a row each.
        session: (n,) index of the session each belongs to.
        sessions: the states of the machine that readings are taken in, in order.
    """

    plan: Measurements
    session: np.ndarray
    sessions: tuple[Session, ...] = ALWAYS

    def select(self, rows: np.ndarray) -> Candidates:
        """Some of them, by index; again and again if it repeats."""
        return replace(self, plan=self.plan.select(rows), session=self.session[rows])


def candidates(machine: Machine, kit: Kit, rng: np.random.Generator, levels: int | None = None) -> Candidates:
    """Every reading that could be taken: a row each; each axis comes from a side drawn for the pose.

    Args:
        machine: the machine.
        kit: what there is to measure with.
        rng: of poses and sides.
        levels: positions of each axis at most, evenly over its range (`Task.levels`); any whole number if None.

    Raises:
        InputError: hardly any pose is clear; a reflector that no station ever sees.
    """
    positions = _safe_poses(machine, kit, rng, levels)
    seen = Sight(machine, kit).sees(positions)
    sides = rng.choice([-1.0, 1.0], positions.shape)
    rows: list[tuple[int, str, str]] = []
    for name in kit.targets:
        mine = [(int(i), station, name) for station in kit.stations for i in np.flatnonzero(seen[station, name])]
        if not mine:
            raise InputError(
                f"target {name} is hidden from every station at every pose",
                expected="another place for it, another station, or `stops_the_beam: nothing`",
                value=f"{kit.targets[name].place_mm} mm on the {kit.targets[name].carrier} side",
            )
        rows += mine
    pose = np.array([row[0] for row in rows])
    table = plan_table(machine, kit, positions[pose], [r[2] for r in rows], [r[1] for r in rows], sides[pose])
    return Candidates(table, np.zeros(len(table), dtype=int))


def _safe_poses(machine: Machine, kit: Kit, rng: np.random.Generator, levels: int | None) -> np.ndarray:
    """(n, axes) commands all over the ranges of a kit, mm and degrees, that keep clear.

    Raises:
        InputError: hardly any does.
    """
    clearance = Clearance(machine, kit)
    found: list[np.ndarray] = []
    low, high = kit.ranges.T
    unlimited = np.array([axis.lower is None for axis in machine.axes])
    for _ in range(TRIES):
        drawn = latin_hypercube(kit.ranges, POSES, rng)
        ended = np.flatnonzero(rng.random(POSES) < AT_AN_END)
        axis = rng.choice(np.flatnonzero(~unlimited), len(ended)) if not unlimited.all() else ended[:0]
        for row, i in zip(ended, axis, strict=False):
            drawn[row, i] = low[i] if rng.random() < 0.5 else high[i]
        if levels is not None:
            # A turn has no end: its last level is the first again.
            step = (high - low) / np.where(unlimited, levels, levels - 1)
            drawn = low + np.round((drawn - low) / step) * step
            drawn = np.where(unlimited, low + np.mod(drawn - low, high - low), drawn)
        whole = np.clip(np.round(drawn / ROUND) * ROUND, low, high)
        found += [pose for pose in whole if clearance.free(pose)]
        if len(found) >= POSES:
            break
    if len(found) < FEWEST:
        raise InputError(
            "hardly any pose keeps the tool side clear of the work side",
            expected=f"at least {FEWEST} of {TRIES * POSES} poses: shorter holders, or narrower `ranges` in the kit",
            value=len(found),
        )
    return np.unique(np.array(found[:POSES]), axis=0)


def plan_table(
    machine: Machine,
    kit: Kit,
    positions: np.ndarray,
    target: list[str],
    station: list[str],
    approach: np.ndarray,
    *,
    source: str = "plan",
) -> Measurements:
    """A plan: what to measure, in this order, the kit's places and stations with it.

    Args:
        machine: the machine.
        kit: what is measured with.
        positions: (n, axes) mm and degrees.
        target: n names.
        station: n names.
        approach: (n, axes) +1, −1, 0 any.
        source: what it is called in messages.
    """
    n = len(target)

    def nothing(*more: int) -> np.ndarray:
        return locked(np.full((n, *more), np.nan))

    return Measurements(
        source=source,
        lines=locked(np.arange(1, n + 1)),
        positions=locked(np.array(positions, dtype=float).reshape(n, len(machine.axes))),
        readback=nothing(len(machine.axes)),
        target=locked(np.array(target, dtype=object)),
        carrier=locked(np.array([kit.targets[name].carrier for name in target], dtype=object)),
        station=locked(np.array(station, dtype=object)),
        round=locked(np.full(n, "1", dtype=object)),
        point_mm=nothing(3),
        u_mm=nothing(3),
        time_s=nothing(),
        approach=locked(np.array(approach, dtype=float).reshape(n, len(machine.axes))),
        place_mm=locked(np.array([kit.targets[name].place_mm for name in target]).reshape(n, 3)),
        station_pose=locked(np.array([kit.stations[name].pose for name in station]).reshape(n, 6)),
        temperature_degC=MappingProxyType({}),
    )
