"""In which order to measure, how long that takes, and whether the way from each point to the next keeps clear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.candidates import Candidates
from twin.planning.clearance import Clearance
from twin.planning.kit import Kit
from twin.planning.sight import Sight
from twin.planning.task import Task

PASSES: Final = 2
"""Times a station goes through its points: what comes back between the passes can be told from what does not."""
TRIED: Final = 12
"""Nearest points tried for one that a straight move reaches in the clear."""


@final
@dataclass(frozen=True)
class Route:
    """A plan in the order it is carried out.

    Attributes:
        plan: with rounds and ``time_s`` at which each reading is taken.
        spent: seconds of the work by what they go into: ``station``, ``target``, ``aim``, ``travel``, ``point``; without waiting for a
            session.
        blocked: rows whose straight move from the row before comes too near to something: retract first.
        sessions: the row each begins with, and how to bring it about.
    """

    plan: Measurements
    spent: Mapping[str, float]
    blocked: tuple[int, ...]
    sessions: tuple[tuple[int, str], ...] = ()

    @property
    def seconds(self) -> float:
        """Of the work, stations set up and moved included."""
        return sum(self.spent.values())


def duration(machine: Machine, kit: Kit, plan: Measurements) -> float:
    """Seconds that a plan takes in the order it stands in, by a kit's times: another's plan, to compare with.

    Its targets and stations are the kit's where they have its names; others cost no aiming.
    """
    clock = _Clock(machine, kit, plan, None)
    here: str | None = None
    for row in range(len(plan)):
        if plan.station[row] != here:
            here = str(plan.station[row])
            clock.set_up()
        clock.take(row, str(plan.round[row]), *(float(part[0]) for part in clock.way(np.array([row]))))
    return sum(clock.spent.values())


def route(task: Task, chosen: Candidates, stations: Sequence[str], *, clear: bool = True) -> Route:
    """Put a plan in order: session by session, station by station, in two passes, always on to the point that is reached soonest.

    Args:
        task: what the plan is made for.
        chosen: the readings, in any order.
        stations: in their order.
        clear: whether the way has to keep clear; to know about how long it takes, it need not.
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
            begun.append((len(clock.order), one.words))
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
                    clock.through(part, str(number))
    order = np.array(clock.order)
    ordered = replace(
        plan.select(order),
        lines=locked(np.arange(1, len(order) + 1)),
        round=locked(np.array(clock.rounds, dtype=object)),
        time_s=locked(np.round(clock.times, 1)),
    )
    return Route(ordered, MappingProxyType(clock.spent), tuple(clock.blocked), tuple(begun))


class _Clock:
    """A machine on its way through a plan."""

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
        """For the machine to be in the state of a session: no work."""
        self.now = max(self.now, until)

    def set_up(self) -> None:
        """The instrument goes to its next place; reflectors have to look there."""
        self._spend("station", self.kit.seconds.station)
        self.facing = {}

    def through(self, rows: np.ndarray, name: str) -> None:
        """All of some rows, the one reached soonest next."""
        left = list(rows)
        while left:
            candidates = np.array(left)
            travel, target, aim = self.way(candidates)
            nearest = np.argsort(travel + target + aim, kind="stable")
            taken = int(nearest[0])
            if self.order and self.clearance is not None:
                here, clearance = self.plan.positions[self.order[-1]], self.clearance
                clear = (
                    int(k) for k in nearest[:TRIED] if clearance.free_move(here, self.plan.positions[candidates[k]])
                )
                found = next(clear, None)
                if found is None:
                    self.blocked.append(len(self.order))
                else:
                    taken = found
            row = left.pop(taken)
            self.take(int(row), name, float(travel[taken]), float(target[taken]), float(aim[taken]))

    def take(self, row: int, name: str, travel: float, target: float, aim: float) -> None:
        """One reading, with the seconds it takes to come to it."""
        for what, seconds in (("travel", travel), ("target", target), ("aim", aim), ("point", self.kit.seconds.point)):
            self._spend(what, seconds)
        if aim or self.plan.target[row] not in self.facing:
            self.facing[self.plan.target[row]] = self.towards[row]
        self.order.append(row)
        self.rounds.append(name)
        self.times.append(self.now)

    def way(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Seconds to travel, to change the target and to turn a reflector, from where things are to each of some rows."""
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
