"""Candidate readings: poses with clearance, and the reflectors visible there from each possible station."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.clearance import Clearance
from twin.planning.kit import Kit
from twin.planning.sight import Sight
from twin.uncertainty.budget import latin_hypercube

POSES: Final = 240
BATCHES: Final = 8
"""Batches of poses drawn before planning gives up for lack of clearance."""
FEWEST: Final = 20
ROUNDED_TO: Final = 1.0
"""Commands are rounded to this, mm or degrees, for readability."""
SHARE_AT_LIMIT: Final = 0.4
"""Share of poses with one axis at a limit of its range, where curves are least certain."""


@final
@dataclass(frozen=True)
class Session:
    """A state of the machine in which readings are taken.

    Attributes:
        instruction: instruction for bringing the machine into this state.
        start_s: earliest start on the clock of ``time_s``.
        temperatures: °C of axes and sensors, by name.
    """

    instruction: str
    start_s: float = 0.0
    temperatures: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


ANY_STATE: Final = (Session("as it is"),)
"""Single session for plans in which the machine's state does not matter."""


@final
@dataclass(frozen=True)
class CandidateReadings:
    """Candidate readings in all sessions.

    Attributes:
        plan: the readings, one row each.
        session: (n,) index of each reading's session.
        sessions: states of the machine, in order.
    """

    plan: Measurements
    session: np.ndarray
    sessions: tuple[Session, ...] = ANY_STATE

    def select(self, rows: np.ndarray) -> CandidateReadings:
        """Return the candidates with these indices; an index may repeat."""
        return replace(self, plan=self.plan.select(rows), session=self.session[rows])


def candidates(machine: Machine, kit: Kit, rng: np.random.Generator, levels: int | None = None) -> CandidateReadings:
    """Return every possible reading, one row each; the direction of approach of each axis is drawn per pose.

    Args:
        machine: the machine.
        kit: instruments, stations and targets.
        rng: random generator for poses and directions of approach.
        levels: number of positions of each axis, equally spaced over its range (`Task.levels`); None: any multiple of `ROUNDED_TO`.

    Raises:
        InputError: too few poses have clearance, or a reflector is visible from no station.
    """
    positions = _safe_poses(machine, kit, rng, levels)
    seen = Sight(machine, kit).visible(positions)
    sides = rng.choice([-1.0, 1.0], positions.shape)
    rows: list[tuple[int, str, str]] = []
    for name in kit.targets:
        mine = [(int(i), station, name) for station in kit.stations for i in np.flatnonzero(seen[station, name])]
        if not mine:
            raise InputError(
                f"target {name} is hidden from every station at every pose",
                expected="another place for the target, another station, or `stops_the_beam: nothing` in the kit",
                value=f"{kit.targets[name].place_mm} mm on the {kit.targets[name].carrier} side",
            )
        rows += mine
    pose = np.array([row[0] for row in rows])
    table = plan_table(machine, kit, positions[pose], [r[2] for r in rows], [r[1] for r in rows], sides[pose])
    return CandidateReadings(table, np.zeros(len(table), dtype=int))


def _safe_poses(machine: Machine, kit: Kit, rng: np.random.Generator, levels: int | None) -> np.ndarray:
    """Return commands (n, axes) in mm and degrees over the kit's ranges at which the machine has clearance.

    Raises:
        InputError: too few poses have clearance.
    """
    clearance = Clearance(machine, kit)
    found: list[np.ndarray] = []
    low, high = kit.ranges.T
    unlimited = np.array([axis.lower is None for axis in machine.axes])
    for _ in range(BATCHES):
        drawn = latin_hypercube(kit.ranges, POSES, rng)
        ended = np.flatnonzero(rng.random(POSES) < SHARE_AT_LIMIT)
        axis = rng.choice(np.flatnonzero(~unlimited), len(ended)) if not unlimited.all() else ended[:0]
        for row, i in zip(ended, axis, strict=False):
            drawn[row, i] = low[i] if rng.random() < 0.5 else high[i]
        if levels is not None:
            # On an unlimited axis the last level coincides with the first.
            step = (high - low) / np.where(unlimited, levels, levels - 1)
            drawn = low + np.round((drawn - low) / step) * step
            drawn = np.where(unlimited, low + np.mod(drawn - low, high - low), drawn)
        whole = np.clip(np.round(drawn / ROUNDED_TO) * ROUNDED_TO, low, high)
        found += [pose for pose in whole if clearance.is_clear(pose)]
        if len(found) >= POSES:
            break
    if len(found) < FEWEST:
        raise InputError(
            "too few poses keep the tool side clear of the work side",
            expected=f"at least {FEWEST} of {BATCHES * POSES} poses: shorter holders, or narrower `ranges` in the kit",
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
    """Return a plan as a measurement table without coordinates, with the kit's stations and target positions.

    Args:
        machine: the machine.
        kit: instruments, stations and targets.
        positions: (n, axes) mm and degrees.
        target: n names.
        station: n names.
        approach: (n, axes) direction of approach: +1, −1, 0 any.
        source: name of the table in messages.
    """
    n = len(target)

    def nothing(*more: int) -> np.ndarray:
        return read_only(np.full((n, *more), np.nan))

    return Measurements(
        source=source,
        lines=read_only(np.arange(1, n + 1)),
        positions=read_only(np.array(positions, dtype=float).reshape(n, len(machine.axes))),
        readback=nothing(len(machine.axes)),
        target=read_only(np.array(target, dtype=object)),
        carrier=read_only(np.array([kit.targets[name].carrier for name in target], dtype=object)),
        station=read_only(np.array(station, dtype=object)),
        round=read_only(np.full(n, "1", dtype=object)),
        point_mm=nothing(3),
        u_mm=nothing(3),
        time_s=nothing(),
        approach=read_only(np.array(approach, dtype=float).reshape(n, len(machine.axes))),
        place_mm=read_only(np.array([kit.targets[name].place_mm for name in target]).reshape(n, 3)),
        station_pose=read_only(np.array([kit.stations[name].pose for name in station]).reshape(n, 6)),
        temperature_degC=MappingProxyType({}),
    )
