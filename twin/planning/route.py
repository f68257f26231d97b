"""Order of the readings, their times, and moves with too little clearance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.candidates import CandidateReadings
from twin.planning.clearance import Clearance
from twin.planning.kit import Kit
from twin.planning.sight import Sight
from twin.planning.task import Task

PASSES: Final = 2
"""Number of passes over a station's readings, so that drift can be separated from repeatable errors."""
MOST_TRIED: Final = 12
"""Number of nearest readings tried for one that a straight move reaches with clearance."""


@final
@dataclass(frozen=True)
class Route:
    """Readings in the order they are taken.

    Attributes:
        plan: the readings, with rounds and the time ``time_s`` of each.
        spent: seconds by operation: ``station``, ``target``, ``aim``, ``travel``, ``point``; without waiting for a session.
        blocked: rows to which the straight move from the row before has too little clearance: retract first.
        sessions: first row of each session and the instruction for it.
    """

    plan: Measurements
    spent: Mapping[str, float]
    blocked: tuple[int, ...]
    sessions: tuple[tuple[int, str], ...] = ()

    @property
    def seconds(self) -> float:
        """Total seconds, including set-up of the stations."""
        return sum(self.spent.values())


def duration(machine: Machine, kit: Kit, plan: Measurements) -> float:
    """Return the seconds that a plan takes in its given order with a kit's times, for comparison with other plans.

    Targets and stations are matched with the kit's by name; others need no time for aiming.
    """
    clock = _Clock(machine, kit, plan, None)
    here: str | None = None
    for row in range(len(plan)):
        if plan.station[row] != here:
            here = str(plan.station[row])
            clock.set_up()
        clock.take(row, str(plan.round[row]), *(float(part[0]) for part in clock.seconds_to(np.array([row]))))
    return sum(clock.spent.values())


def route(task: Task, chosen: CandidateReadings, stations: Sequence[str], *, clear: bool = True) -> Route:
    """Order the readings by session and station, in two passes, each time continuing with the reading that is reached first.

    Args:
        task: machine, kit and time budget.
        chosen: the readings, in any order.
        stations: stations in order.
        clear: whether moves are checked for clearance; not needed for an estimate of the duration.
    """
    plan, session, sessions = chosen.plan, chosen.session, chosen.sessions
    clock = _Clock(task.machine, task.kit, plan, Clearance(task.machine, task.kit) if clear else None)
    rng = np.random.default_rng(task.seed)
    number = task.first_round - 1
    begun: list[tuple[int, str]] = []
    standing: str | None = None
    for k, one in enumerate(sessions):
        if not np.any(session == k):
            continue
        clock.wait(one.start_s)
        if len(sessions) > 1:
            begun.append((len(clock.order), one.instruction))
        for station in stations:
            rows = np.flatnonzero((plan.station == station) & (session == k))
            if not len(rows):
                continue
            if station != standing:
                clock.set_up()
                standing = station
            for part in np.array_split(rng.permutation(rows), PASSES):
                if len(part):
                    number += 1
                    clock.visit(part, str(number))
    order = np.array(clock.order)
    ordered = replace(
        plan.select(order),
        lines=read_only(np.arange(1, len(order) + 1)),
        round=read_only(np.array(clock.rounds, dtype=object)),
        time_s=read_only(np.round(clock.times, 1)),
    )
    return Route(ordered, MappingProxyType(clock.spent), tuple(clock.blocked), tuple(begun))


class _Clock:
    """State of machine, instrument and reflectors while a plan is carried out, with the time."""

    def __init__(self, machine: Machine, kit: Kit, plan: Measurements, clearance: Clearance | None) -> None:
        self.kit = kit
        self.plan = plan
        self.towards = Sight(machine, kit).directions(plan)
        self.clearance = clearance
        self.now = 0.0
        self.spent = dict.fromkeys(("station", "target", "aim", "travel", "point"), 0.0)
        self.order: list[int] = []
        self.rounds: list[str] = []
        self.times: list[float] = []
        self.blocked: list[int] = []
        self.facing: dict[str, np.ndarray] = {}

    def wait(self, until: float) -> None:
        """Wait for the start of a session; this does not count as work."""
        self.now = max(self.now, until)

    def set_up(self) -> None:
        """Set the instrument up at the next station; reflectors must be aimed again."""
        self._spend("station", self.kit.seconds.station)
        self.facing = {}

    def visit(self, rows: np.ndarray, name: str) -> None:
        """Take all of some rows, each time the one that is reached first."""
        remaining = list(rows)
        while remaining:
            candidates = np.array(remaining)
            travel, target, aim = self.seconds_to(candidates)
            nearest = np.argsort(travel + target + aim, kind="stable")
            taken = int(nearest[0])
            if self.order and self.clearance is not None:
                here, clearance = self.plan.positions[self.order[-1]], self.clearance
                clear = (
                    int(k)
                    for k in nearest[:MOST_TRIED]
                    if clearance.is_move_clear(here, self.plan.positions[candidates[k]])
                )
                found = next(clear, None)
                if found is None:
                    self.blocked.append(len(self.order))
                else:
                    taken = found
            row = remaining.pop(taken)
            self.take(int(row), name, float(travel[taken]), float(target[taken]), float(aim[taken]))

    def take(self, row: int, name: str, travel: float, target: float, aim: float) -> None:
        """Take one reading, with the seconds needed to reach it."""
        for what, seconds in (("travel", travel), ("target", target), ("aim", aim), ("point", self.kit.seconds.point)):
            self._spend(what, seconds)
        if aim or self.plan.target[row] not in self.facing:
            self.facing[self.plan.target[row]] = self.towards[row]
        self.order.append(row)
        self.rounds.append(name)
        self.times.append(self.now)

    def seconds_to(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the seconds for travel, for changing the target and for aiming, from the present state to each of some rows."""
        targets = self.plan.target[rows]
        if self.order:
            away = np.abs(self.plan.positions[rows] - self.plan.positions[self.order[-1]])
            travel = (away / self.kit.speeds).max(axis=1)
            changed = np.where(targets == self.plan.target[self.order[-1]], 0.0, self.kit.seconds.target)
        else:
            travel, changed = np.zeros(len(rows)), np.zeros(len(rows))
        aim = np.zeros(len(rows))
        for name in dict.fromkeys(targets):
            target = self.kit.targets.get(name)
            if target is None or target.facing is not None:
                continue
            mine = (targets == name) & self.towards[rows].any(axis=1)
            if name not in self.facing:
                aim[mine] = self.kit.seconds.aim
            else:
                along = self.towards[rows[mine]] @ self.facing[name]
                aim[mine] = np.where(along >= np.cos(target.acceptance_rad), 0.0, self.kit.seconds.aim)
        return travel, changed, aim

    def _spend(self, what: str, seconds: float) -> None:
        self.now += seconds
        self.spent[what] += seconds
