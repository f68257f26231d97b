"""Choose stations and readings so that the plan fills the time budget."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.measurement.table import Measurements
from twin.planning.design import DesignProblem, Exchange
from twin.planning.route import Route, route
from twin.planning.task import FEWEST, Task

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
    """Stations of one instrument, with the criterion reached from there.

    Attributes:
        problem: design problem of the instrument.
        stations: names of the stations.
        points: number of readings the time allows.
        value: value of the criterion.
    """

    problem: DesignProblem
    stations: tuple[str, ...]
    points: int
    value: float

    @property
    def least(self) -> int:
        """Readings at the start of a choice: enough to determine every station and target."""
        return READINGS_TO_PLACE * len(self.stations) * len(set(self.problem.plan.target))


@final
@dataclass(frozen=True)
class FilledPlan:
    """Readings of a plan in order, and the station choices that were compared.

    Attributes:
        station_choices: the station choices, best first; the plan uses the first.
        route: its readings.
    """

    station_choices: tuple[StationChoice, ...]
    route: Route


def fill(task: Task, problems: Sequence[DesignProblem]) -> FilledPlan:
    """Choose stations and readings within the time budget.

    Args:
        task: machine, kit, time budget and criterion.
        problems: design problem of each instrument.

    Raises:
        InputError: the time budget is too short.
    """
    filler = _PlanFiller(task)
    station_choices = filler.best([one for problem in problems for one in filler.station_choices(problem)])
    return FilledPlan(tuple(station_choices), filler.fill_time(station_choices[0]))


@final
@dataclass(frozen=True)
class _PlanFiller:
    """Steps of choosing stations and readings for one plan."""

    task: Task

    def station_choices(self, problem: DesignProblem) -> list[StationChoice]:
        """Return every set of stations with the criterion reached by an even spread of readings in the time budget.

        Raises:
            InputError: the time budget is too short.
        """
        found, least = [], math.inf
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
                found.append(StationChoice(problem, stations, points, problem.value(np.resize(inside, points))))
        if not found:
            raise InputError(
                "the time budget is too short for a measurement",
                expected=f"{math.ceil(least / 60.0)} minutes or more",
                value=f"{self.task.minutes:g} minutes",
            )
        return found

    def best(self, station_choices: Sequence[StationChoice]) -> list[StationChoice]:
        """Return the best few station choices for every instrument and number of stations, readings chosen; best first."""
        kinds: dict[tuple[str, int], list[StationChoice]] = {}
        for one in sorted(station_choices, key=lambda choice: choice.value):
            kinds.setdefault((one.problem.instrument.name, len(one.stations)), []).append(one)
        tried = [one for kind in kinds.values() for one in kind[:TRIED_OF_A_KIND]]
        found = []
        for number, one in enumerate(tried):
            self.task.progress("choosing", 0.1 + 0.3 * number / len(tried))
            own = one.problem.from_stations(one.stations)
            cost = np.full(len(own.plan), self.task.kit.seconds.point)
            first = np.random.default_rng(self.task.seed).permutation(len(own.plan))
            choice = Exchange(own.prior, own.rows, cost, own.aim, exchanged=TRIAL_SHARES, among=TRIAL_SAMPLED)
            found.append(replace(one, value=own.value(choice.choose(one.points, first, one.least))))
        return sorted(found, key=lambda choice: choice.value)

    def fill_time(self, best: StationChoice) -> Route:
        """Return the plan that fills the time budget; the time per reading is taken from the route through a first plan.

        Raises:
            InputError: the time budget is too short.
        """
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
