"""The time there is, filled: where to stand, what to read from there, in which order."""

from __future__ import annotations

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
"""Stations of one plan at most: each more is set up, placed by the data, and paid for."""
CLOSE: Final = 0.95
"""Share of the time allowed that a plan fills, or it is chosen again."""
ALMOST: Final = 1.1
"""Times the time allowed from which readings are simply left out."""
ROUNDS: Final = 3
PLACING: Final = 4
"""Readings of every target from every station that a choice begins with: enough to place both."""
GLIMPSED: Final = 48
OF_A_KIND: Final = 3
GLIMPSE: Final = (0.9,)
"""Share of a plan that is exchanged to see what a place is worth."""


@final
@dataclass(frozen=True)
class Stand:
    """One instrument and the places it stands, and what an even spread of readings from there would give.

    Attributes:
        readings: of the instrument.
        stations: names.
        points: readings there is time for.
        value: of the aim.
    """

    readings: DesignProblem
    stations: tuple[str, ...]
    points: int
    value: float

    @property
    def least(self) -> int:
        """Readings that a choice begins with: enough to place every station and target."""
        return PLACING * len(self.stations) * len(set(self.readings.plan.target))


@final
@dataclass(frozen=True)
class Filled:
    """The readings of a plan in their order, and the ways to stand that were tried for them.

    Attributes:
        stands: the best first, which is the plan's.
        route: its readings.
    """

    stands: tuple[Stand, ...]
    route: Route


def fill(task: Task, problems: Sequence[DesignProblem]) -> Filled:
    """Choose where to stand and what to read from there, in the time there is.

    Args:
        task: what the plan is made for.
        problems: of each instrument.

    Raises:
        InputError: no time to measure anything.
    """
    filler = _Filler(task)
    stands = filler.best([one for problem in problems for one in filler.stands(problem)])
    return Filled(tuple(stands), filler.filled(stands[0]))


@final
@dataclass(frozen=True)
class _Filler:
    """One plan being made."""

    task: Task

    def stands(self, readings: DesignProblem) -> list[Stand]:
        """What an even spread of readings from every set of places would give in the time there is.

        Raises:
            InputError: no time to measure anything.
        """
        found = []
        plan = readings.plan
        names = tuple(dict.fromkeys(plan.station))
        order = self.task.rng.permutation(len(plan))
        for count in range(1, min(STATIONS, len(names)) + 1):
            each: float | None = None
            for stations in combinations(names, count):
                inside = order[np.isin(plan.station[order], stations)]
                if set(plan.station[inside]) != set(stations):
                    continue
                if each is None:
                    each = self._each(readings, stations, inside)
                points = self._points(stations, readings, each)
                if points < FEWEST:
                    break
                found.append(Stand(readings, stations, points, readings.value(np.resize(inside, points))))
        if not found:
            least = (self._set_up(names[:1], readings) + FEWEST * self.task.kit.seconds.point) / 60.0
            raise InputError(
                "no time to measure anything",
                expected=f"{least:.0f} minutes or more",
                value=f"{self.task.minutes:g} minutes",
            )
        return found

    def best(self, stands: Sequence[Stand]) -> list[Stand]:
        """For every instrument and number of places the best few of the kind, with readings chosen; the best of all first."""
        kinds: dict[tuple[str, int], list[Stand]] = {}
        for one in sorted(stands, key=lambda stand: stand.value):
            kinds.setdefault((one.readings.instrument.name, len(one.stations)), []).append(one)
        tried = [one for kind in kinds.values() for one in kind[:OF_A_KIND]]
        found = []
        for number, one in enumerate(tried):
            self.task.say("choosing", 0.1 + 0.3 * number / len(tried))
            own = one.readings.at(one.stations)
            cost = np.full(len(own.plan), self.task.kit.seconds.point)
            first = np.random.default_rng(self.task.seed).permutation(len(own.plan))
            choice = Exchange(own.prior, own.rows, cost, own.aim, exchanged=GLIMPSE, among=GLIMPSED)
            found.append(replace(one, value=own.value(choice.of(one.points, first, one.least))))
        return sorted(found, key=lambda stand: stand.value)

    def filled(self, best: Stand) -> Route:
        """The plan that fills the time: what a reading of each target really takes shows on the way through an even spread.

        Raises:
            InputError: no time to measure anything.
        """
        own = best.readings.at(best.stations)
        first = self.task.rng.permutation(len(own.plan))
        taken = np.resize(first, best.points)
        spread = route(self.task, own.every.select(taken), best.stations, clear=False)
        for turn in range(ROUNDS):
            each = (spread.seconds - self._set_up(best.stations, own)) / len(spread.plan)
            points = self._points(best.stations, own, each)
            if points < FEWEST:
                raise InputError(
                    "no time to measure anything",
                    expected="more minutes, or a kit in which a reading takes less",
                    value=f"{each:.0f} s a reading",
                )
            part = 0.4 + 0.55 * turn / ROUNDS

            def say(stage: str, done: float, part: float = part) -> None:
                self.task.say(stage, part + 0.55 * done / ROUNDS)

            choice = Exchange(own.prior, own.rows, self._cost(spread.plan, own.plan, each), own.aim, say=say)
            taken = choice.of(points, first, best.least)
            spread = route(self.task, own.every.select(taken), best.stations)
            if CLOSE * self.task.seconds <= spread.seconds <= self.task.seconds:
                return spread
            if spread.seconds <= self.task.seconds * ALMOST:
                break
        while spread.seconds > self.task.seconds:
            # Every station and target loses the same share.
            kept = int(len(taken) * min(0.99, self.task.seconds / spread.seconds))
            taken = taken[np.sort(np.random.default_rng(self.task.seed).permutation(len(taken))[:kept])]
            spread = route(self.task, own.every.select(taken), best.stations)
        return spread

    def _each(self, readings: DesignProblem, stations: tuple[str, ...], inside: np.ndarray) -> float:
        """Seconds that a reading takes with the way to it, from so many stations: as dense as they will be, the way is as short."""
        each = self.task.kit.seconds.point
        for _ in range(2):
            points = self._points(stations, readings, each)
            if points < FEWEST:
                break
            way = route(self.task, readings.every.select(np.resize(inside, points)), stations, clear=False)
            each = (way.seconds - self._set_up(stations, readings)) / len(way.plan)
        return each

    def _set_up(self, stations: Sequence[str], readings: DesignProblem) -> float:
        """Seconds of setting up: one station stays from session to session, of several each is set up in each."""
        times = 1 if len(stations) == 1 else len(stations) * len(readings.every.sessions)
        return times * self.task.kit.seconds.station

    def _points(self, stations: Sequence[str], readings: DesignProblem, each: float) -> int:
        """How many readings there is time for, at so many seconds each."""
        return int((self.task.seconds - self._set_up(stations, readings)) / each)

    def _cost(self, taken: Measurements, every: Measurements, each: float) -> np.ndarray:
        """(n,) seconds that a reading of each candidate's target from its station took on the way, the way included."""
        took = np.diff(taken.time_s, prepend=taken.time_s[0] - each)
        cost = np.full(len(every), each)
        for station in dict.fromkeys(taken.station):
            for target in dict.fromkeys(taken.target):
                of = (taken.station == station) & (taken.target == target)
                if np.count_nonzero(of) >= 5:
                    mine = (every.station == station) & (every.target == target)
                    # A station's set-up stands before its first reading and is not that reading's.
                    cost[mine] = max(float(np.mean(np.minimum(took[of], 20.0 * each))), self.task.kit.seconds.point)
        return cost
