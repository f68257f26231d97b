"""Choose readings by exchange: start from an even spread, replace the least informative ones by those that gain most per second.

With C the covariance of all unknowns so far and R the whitened derivatives of a reading, the reading reduces the criterion by
tr(S⁻¹ R C M C Rᵀ), S = 1 + R C Rᵀ, where M is the weight matrix of the unknowns (`twin.planning.task`).
(Fedorov 1972; Atkinson, Donev and Tobias 2007, chapters 10 to 12.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import EQUAL, first_largest, read_only
from twin._common.errors import InputError
from twin._common.resources import Progress, silent
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.planning.clearance import CandidateReadings, Clearance, Sight
from twin.planning.kit import Kit
from twin.planning.task import FEWEST, Aim, Task

RECOMPUTED_AFTER: Final = 50
"""Number of choices after which the covariance is recomputed, as updates accumulate rounding errors."""
SAMPLED: Final = 128
"""Number of random candidates from which each reading is chosen."""
EXCHANGED_SHARES: Final = (0.9, 0.3, 0.3)
"""Shares of a plan exchanged in successive rounds."""


def covariance_of(prior: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the covariance (f, f) of the coordinates from the prior precision (f, f) and readings with derivatives (n, 3, f)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return inverse(prior + flat.T @ flat)


def inverse(precision: np.ndarray) -> np.ndarray:
    """Return the inverse of a precision, scaled to a unit diagonal first: uncertainties range from metres to micrometres."""
    size = 1.0 / np.sqrt(np.diag(precision))
    inverted = np.linalg.inv(precision * size[:, None] * size)
    return np.asarray((inverted + inverted.T) / 2.0 * size[:, None] * size)


@final
@dataclass(frozen=True)
class DesignProblem:
    """Design problem of one instrument: candidate readings and criterion."""

    instrument: Instrument
    candidates: CandidateReadings
    prior: np.ndarray  # (f, f) prior precision of the unknowns' coordinates
    rows: np.ndarray  # (n, 3, f) derivatives of the whitened readings
    aim: Aim  # the criterion to minimise

    @property
    def plan(self) -> Measurements:
        """Table of the candidate readings, one row each."""
        return self.candidates.plan

    def from_stations(self, stations: Sequence[str]) -> DesignProblem:
        """Return the problem restricted to some stations."""
        inside = np.flatnonzero(np.isin(self.plan.station, stations))
        return replace(self, candidates=self.candidates.select(inside), rows=self.rows[inside])

    def value(self, rows: np.ndarray) -> float:
        """Return the criterion after the readings with these indices."""
        return self.aim.value(covariance_of(self.prior, self.rows[rows]))


@final
@dataclass(frozen=True)
class Exchange:
    """Exchange algorithm that chooses readings among candidates."""

    prior: np.ndarray  # (f, f) prior precision of the coordinates
    rows: np.ndarray  # (n, 3, f) derivatives of every candidate
    cost: np.ndarray  # (n,) seconds for each
    aim: Aim  # the criterion to minimise
    most: int = 4  # how often one candidate may be taken
    exchanged: tuple[float, ...] = EXCHANGED_SHARES  # shares of the plan exchanged in successive rounds
    among: int = SAMPLED  # number of random candidates from which each reading is chosen
    progress: Progress = silent  # progress callback

    def choose(self, count: int, first: np.ndarray, least: int) -> np.ndarray:
        """Return the indices of ``count`` chosen readings in order of choice; an index may repeat.

        ``first``: all candidates in random order, so that its first elements are an even spread: the initial plan; ``least``: of them
        at least.
        """
        spread = np.concatenate([first] * (1 + (count - 1) // max(len(first), 1)))[:count]
        best, value = list(spread), self._value(spread)
        for number, share in enumerate(self.exchanged):
            # A reading of a target whose position nothing determines carries no information, so the choice cannot begin with none.
            # It begins with part of an even spread; an exchange that does not reduce the criterion is dropped.
            fewer = max(1, round(share * count))
            chosen = (
                self._without_least_informative(best, fewer)
                if number
                else best[: max(count - fewer, min(least, count))]
            )
            self._add_readings(chosen, count, number / len(self.exchanged))
            reached = self._value(chosen)
            if reached < value * (1.0 - EQUAL):
                best, value = chosen, reached
        return np.array(best)

    def _value(self, chosen: np.ndarray | list[int]) -> float:
        """Return the criterion after some readings."""
        return self.aim.value(covariance_of(self.prior, self.rows[chosen]))

    def _add_readings(self, chosen: list[int], count: int, done: float) -> None:
        """Add readings: each time the one of a random sample with the largest gain per second (Mirzasoleiman et al. 2015)."""
        begun = len(chosen)
        taken = np.bincount(chosen, minlength=len(self.rows))
        rng = np.random.default_rng(begun)
        covariance, weight = np.zeros((0, 0)), np.zeros((0, 0))
        while len(chosen) < count:
            if (len(chosen) - begun) % RECOMPUTED_AFTER == 0:
                covariance = covariance_of(self.prior, self.rows[chosen])
                weight = self.aim.weight(covariance)
                part = (len(chosen) - begun) / max(count - begun, 1)
                self.progress("choosing", done + part / len(self.exchanged))
            available = np.flatnonzero(taken < self.most)
            if not len(available):
                return
            drawn = rng.choice(available, min(self.among, len(available)), replace=False)
            best = int(drawn[first_largest(gains(self.rows[drawn], covariance, weight) / self.cost[drawn])])
            chosen.append(best)
            taken[best] += 1
            covariance = _updated(covariance, self.rows[best])

    def _without_least_informative(self, chosen: list[int], fewer: int) -> list[int]:
        """Return the readings without the ``fewer`` least informative ones."""
        picked = self.rows[chosen]
        covariance = covariance_of(self.prior, picked)
        weight = self.aim.weight(covariance)
        spread = picked @ covariance
        own = np.eye(3) - np.einsum("nif,njf->nij", spread, picked)
        moved = np.einsum("nif,njf->nij", spread @ weight, spread)
        # Without an irreplaceable reading the loss would be infinite.
        safe = np.linalg.eigvalsh(own)[:, 0] > 1e-6
        loss = np.full(len(chosen), np.inf)
        loss[safe] = np.einsum("nii->n", np.linalg.solve(own[safe], moved[safe]))
        # In single precision, rounding does not decide between mirrored readings that are equally informative.
        gone = set(np.argsort(loss.astype(np.float32), kind="stable")[:fewer].tolist())
        return [index for k, index in enumerate(chosen) if k not in gone]


def gains(rows: np.ndarray, covariance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return by how much each of some readings (n, 3, f) reduces the criterion: (n,)."""
    # One long product instead of many small ones.
    long = rows.reshape(-1, rows.shape[-1]) @ covariance
    spread = long.reshape(rows.shape)
    own = spread @ rows.transpose(0, 2, 1) + np.eye(3)
    moved = (long @ weight).reshape(rows.shape) @ spread.transpose(0, 2, 1)
    return np.asarray(np.einsum("nii->n", np.linalg.solve(own, moved)))


def _updated(covariance: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return the covariance after one more reading."""
    spread = covariance @ row.T
    covariance_after = covariance - spread @ np.linalg.solve(row @ spread + np.eye(3), spread.T)
    return np.asarray((covariance_after + covariance_after.T) / 2.0)


# --- Order of the readings, their times, and moves with too little clearance ----------------------

PASSES: Final = 2
"""Number of passes over a station's readings, so that drift can be separated from repeatable errors."""
MOST_TRIED: Final = 12
"""Number of nearest readings tried for one that a straight move reaches with clearance."""


@final
@dataclass(frozen=True)
class Route:
    """Readings in the order they are taken."""

    plan: Measurements  # the readings, with rounds and the time ``time_s`` of each
    # seconds by operation: ``station``, ``target``, ``aim``, ``travel``, ``point``; without waiting for a session
    spent: Mapping[str, float]
    # rows to which the straight move from the row before has too little clearance: retract first
    blocked: tuple[int, ...]
    sessions: tuple[tuple[int, str], ...] = ()  # first row of each session and the instruction for it

    @property
    def seconds(self) -> float:
        """Total seconds, including set-up of the stations."""
        return sum(self.spent.values())


def duration(machine: Machine, kit: Kit, plan: Measurements) -> float:
    """Return the seconds that a plan takes in its given order with a kit's times, for comparison with other plans.

    Targets and stations are matched with the kit's by name; others need no time for aiming.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> seconds = twin.duration(machine, twin.Kit.default(machine), twin.thesis_plan.plan(machine))
        >>> round(seconds / 3600, 1)  # hours
        4.6
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
    """Order the readings by session and station, in two passes, each time continuing with the reading that is reached first."""
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


# --- Choose stations and readings so that the plan fills the time budget --------------------------

STATIONS: Final = 4
"""Most stations of one plan: each needs time to set up and readings to determine its pose."""
LEAST_FILLED: Final = 0.95
"""Smallest share of the time budget that a plan must fill; otherwise readings are chosen again."""
TRIMMED_UP_TO: Final = 1.1
"""Up to this multiple of the time budget readings are left out instead of choosing again."""
ROUNDS: Final = 3
READINGS_TO_PLACE: Final = 4
"""Readings of every target from every station at the start of a choice: enough to determine both positions."""
TRIAL_SAMPLED: Final = 48
TRIED_OF_A_KIND: Final = 3
TRIAL_SHARES: Final = (0.9,)
"""Shares exchanged in the trial choice that compares stations."""


@final
@dataclass(frozen=True)
class StationChoice:
    """Stations of one instrument, with the criterion reached from there."""

    problem: DesignProblem  # design problem of the instrument
    stations: tuple[str, ...]
    points: int  # number of readings the time allows
    value: float  # value of the criterion

    @property
    def least(self) -> int:
        """Readings at the start of a choice: enough to determine every station and target."""
        return READINGS_TO_PLACE * len(self.stations) * len(set(self.problem.plan.target))


@final
@dataclass(frozen=True)
class FilledPlan:
    """Readings of a plan in order, and the station choices that were compared."""

    station_choices: tuple[StationChoice, ...]  # the station choices, best first; the plan uses the first
    route: Route  # its readings


def fill(task: Task, problems: Sequence[DesignProblem]) -> FilledPlan:
    """Choose stations and readings within the time budget. Raises `InputError`: the time budget is too short."""
    filler = _PlanFiller(task)
    station_choices = filler.best(
        [station_choice for problem in problems for station_choice in filler.station_choices(problem)]
    )
    return FilledPlan(tuple(station_choices), filler.fill_time(station_choices[0]))


@final
@dataclass(frozen=True)
class _PlanFiller:
    """Steps of choosing stations and readings for one plan."""

    task: Task

    def station_choices(self, problem: DesignProblem) -> list[StationChoice]:
        """Return every set of stations with the criterion reached by an even spread of readings; `InputError` if time is too short."""
        station_choices, least = [], math.inf
        plan = problem.plan
        names = tuple(dict.fromkeys(plan.station))
        order = self.task.rng.permutation(len(plan))
        for count in range(1, min(STATIONS, len(names)) + 1):
            each: float | None = None
            for stations in combinations(names, count):
                inside = order[np.isin(plan.station[order], stations)]
                if set(plan.station[inside]) != set(stations):
                    continue
                if each is None:
                    each = self._seconds_per_reading(problem, stations, inside)
                points = self._affordable_readings(stations, problem, each)
                if points < FEWEST:
                    least = min(least, self._set_up(stations, problem) + FEWEST * each)
                    break
                station_choices.append(
                    StationChoice(problem, stations, points, problem.value(np.resize(inside, points)))
                )
        if not station_choices:
            raise InputError(
                "the time budget is too short for a measurement",
                expected=f"{math.ceil(least / 60.0)} minutes or more",
                value=f"{self.task.minutes:g} minutes",
            )
        return station_choices

    def best(self, station_choices: Sequence[StationChoice]) -> list[StationChoice]:
        """Return the best few station choices for every instrument and number of stations, readings chosen; best first."""
        kinds: dict[tuple[str, int], list[StationChoice]] = {}
        for one in sorted(station_choices, key=lambda choice: choice.value):
            kinds.setdefault((one.problem.instrument.name, len(one.stations)), []).append(one)
        tried = [one for kind in kinds.values() for one in kind[:TRIED_OF_A_KIND]]
        best = []
        for number, one in enumerate(tried):
            self.task.progress("choosing", 0.1 + 0.3 * number / len(tried))
            own = one.problem.from_stations(one.stations)
            cost = np.full(len(own.plan), self.task.kit.seconds.point)
            first = np.random.default_rng(self.task.seed).permutation(len(own.plan))
            choice = Exchange(own.prior, own.rows, cost, own.aim, exchanged=TRIAL_SHARES, among=TRIAL_SAMPLED)
            best.append(replace(one, value=own.value(choice.choose(one.points, first, one.least))))
        return sorted(best, key=lambda choice: choice.value)

    def fill_time(self, best: StationChoice) -> Route:
        """Return the plan that fills the time, per reading as on the route through a first plan; `InputError` if it is too short."""
        own = best.problem.from_stations(best.stations)
        first = self.task.rng.permutation(len(own.plan))
        taken = np.resize(first, best.points)
        spread = route(self.task, own.candidates.select(taken), best.stations, clear=False)
        for turn in range(ROUNDS):
            each = (spread.seconds - self._set_up(best.stations, own)) / len(spread.plan)
            points = self._affordable_readings(best.stations, own, each)
            if points < FEWEST:
                raise InputError(
                    "the time budget is too short for a measurement",
                    expected="more minutes, or a kit with less time per reading",
                    value=f"{each:.0f} s per reading",
                )
            part = 0.4 + 0.55 * turn / ROUNDS

            def progress(stage: str, done: float, part: float = part) -> None:
                self.task.progress(stage, part + 0.55 * done / ROUNDS)

            choice = Exchange(own.prior, own.rows, self._cost(spread.plan, own.plan, each), own.aim, progress=progress)
            taken = choice.choose(points, first, best.least)
            spread = route(self.task, own.candidates.select(taken), best.stations)
            if LEAST_FILLED * self.task.seconds <= spread.seconds <= self.task.seconds:
                return spread
            if spread.seconds <= self.task.seconds * TRIMMED_UP_TO:
                break
        while spread.seconds > self.task.seconds:
            # Readings are left out at random: every station and target loses about the same share.
            kept = int(len(taken) * min(0.99, self.task.seconds / spread.seconds))
            taken = taken[np.sort(np.random.default_rng(self.task.seed).permutation(len(taken))[:kept])]
            spread = route(self.task, own.candidates.select(taken), best.stations)
        return spread

    def _seconds_per_reading(self, problem: DesignProblem, stations: tuple[str, ...], inside: np.ndarray) -> float:
        """Return the seconds per reading including travel, for a route as dense as the plan's will be."""
        each = self.task.kit.seconds.point
        for _ in range(2):
            points = max(FEWEST, self._affordable_readings(stations, problem, each))
            way = route(self.task, problem.candidates.select(np.resize(inside, points)), stations, clear=False)
            each = (way.seconds - self._set_up(stations, problem)) / len(way.plan)
        return each

    def _set_up(self, stations: Sequence[str], problem: DesignProblem) -> float:
        """Return the seconds for set-up: a single station stays for all sessions, several are set up in each session."""
        times = 1 if len(stations) == 1 else len(stations) * len(problem.candidates.sessions)
        return times * self.task.kit.seconds.station

    def _affordable_readings(self, stations: Sequence[str], problem: DesignProblem, each: float) -> int:
        """Return how many readings the time budget allows at ``each`` seconds."""
        return int((self.task.seconds - self._set_up(stations, problem)) / each)

    def _cost(self, taken: Measurements, every: Measurements, each: float) -> np.ndarray:
        """Return the seconds (n,) per candidate: the mean time, travel included, of readings of its target from its station."""
        took = np.diff(taken.time_s, prepend=taken.time_s[0] - each)
        cost = np.full(len(every), each)
        for station in dict.fromkeys(taken.station):
            for target in dict.fromkeys(taken.target):
                of = (taken.station == station) & (taken.target == target)
                if np.count_nonzero(of) >= 5:
                    mine = (every.station == station) & (every.target == target)
                    # The set-up time before a station's first reading is not part of that reading: hence the cap.
                    cost[mine] = max(float(np.mean(np.minimum(took[of], 20.0 * each))), self.task.kit.seconds.point)
        return cost
