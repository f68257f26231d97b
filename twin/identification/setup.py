"""The set-up: where the stations stand, where the targets sit, from where an interferometer counts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal, NamedTuple, final

import numpy as np

from twin._common.units import DEG, MM
from twin.measurement.table import Measurements
from twin.numerics.spatial import rotation_exp

PLACE_PLAUSIBLE: Final = 0.2
"""m: how far from the origin of its carrier a target may sit when nobody says where."""
STATION_PLAUSIBLE: Final = 10.0
"""m: where a station may stand."""
TURN_PLAUSIBLE: Final = 1.0
"""rad: how it may be turned beside what the data say."""


class Slot(NamedTuple):
    """Unknown numbers of one kind of one station or target.

    Attributes:
        kind: ``turn``, ``origin`` and ``dead path`` of a station, ``place`` of a target.
        number: index of the station or target.
        at: where they stand among the set-up's unknowns.
    """

    kind: Literal["turn", "origin", "dead path", "place"]
    number: int
    at: slice


@final
@dataclass(frozen=True)
class SetUp:
    """Stations and targets; metres and radians, in the frame that each station rides on (the base frame, as a rule).

    Attributes:
        stations: names.
        rotation: (stations, 3, 3) station frame in that frame.
        origin: (stations, 3).
        dead: (stations,) path an interferometer's counter was zeroed at; zero where lengths are absolute.
        targets: names.
        place: (targets, 3) on their carriers.
        station_known, target_known: what the data say themselves.
        lengths_only: whether the stations read lengths and nothing else, so that how they are turned does not show.
        free_start: whether these lengths count from an unknown zero.
        shift: (unknowns,) how far `moved` has taken each number from where it was placed first, metres and radians; None for nowhere.
    """

    stations: tuple[str, ...]
    rotation: np.ndarray
    origin: np.ndarray
    dead: np.ndarray
    targets: tuple[str, ...]
    place: np.ndarray
    station_known: np.ndarray
    target_known: np.ndarray
    lengths_only: bool
    free_start: bool = True
    shift: np.ndarray | None = None

    @classmethod
    def told(cls, data: Measurements, *, lengths_only: bool) -> SetUp:
        """What the data say; identity and zero for the rest."""
        stations, first = _first_rows(data.station)
        targets, first_target = _first_rows(data.target)
        pose, place = data.station_pose[first], data.place_mm[first_target] * MM
        station_known, target_known = (np.asarray(np.isfinite(given).all(axis=1)) for given in (pose, place))
        rotation = np.tile(np.eye(3), (len(stations), 1, 1))
        for i in np.flatnonzero(station_known):
            rotation[i] = rotation_exp(pose[i, 3:] * DEG)
        origin = np.where(station_known[:, None], pose[:, :3] * MM, 0.0)
        place = np.where(target_known[:, None], place, 0.0)
        dead = np.zeros(len(stations))
        return cls(stations, rotation, origin, dead, targets, place, station_known, target_known, lengths_only)

    def of(self, data: Measurements) -> SetUp:
        """The stations and targets of other data, as they are here.

        Raises:
            KeyError: one that is not known here.
        """
        named = dict.fromkeys(data.station.tolist()), dict.fromkeys(data.target.tolist())
        for name in (*(set(named[0]) - set(self.stations)), *(set(named[1]) - set(self.targets))):
            raise KeyError(name)
        stations = [self.stations.index(name) for name in named[0]]
        targets = [self.targets.index(name) for name in named[1]]
        return replace(
            self,
            stations=tuple(named[0]),
            rotation=self.rotation[stations],
            origin=self.origin[stations],
            dead=self.dead[stations],
            targets=tuple(named[1]),
            place=self.place[targets],
            station_known=self.station_known[stations],
            target_known=self.target_known[targets],
            shift=None,
        )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """The unknown numbers: of each station, then of each target."""
        found: list[Slot] = []

        def add(kind: Literal["turn", "origin", "dead path", "place"], number: int, count: int = 3) -> None:
            start = found[-1].at.stop if found else 0
            found.append(Slot(kind, number, slice(start, start + count)))

        for i, known in enumerate(self.station_known.tolist()):
            if not self.lengths_only and not known:
                add("turn", i)
            if not known:
                add("origin", i)
            if self.lengths_only and self.free_start:
                add("dead path", i, 1)
        for i in np.flatnonzero(~self.target_known).tolist():
            add("place", i)
        return tuple(found)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown numbers, in the order of `moved`."""
        found: list[str] = []
        for kind, i, _ in self.slots:
            if kind == "dead path":
                found.append(f"station {self.stations[i]} dead path")
                continue
            what = f"target {self.targets[i]}" if kind == "place" else f"station {self.stations[i]}"
            found += [f"{what} turn {axis}" if kind == "turn" else f"{what} {axis}" for axis in "xyz"]
        return tuple(found)

    @property
    def plausible(self) -> np.ndarray:
        """(unknowns,) how far each may be from anything, metres and radians."""
        # Their common shift, too, may be that large.
        place = PLACE_PLAUSIBLE * float(np.sqrt(max(int(np.count_nonzero(~self.target_known)), 1)))
        kinds = {"place": place, "turn": TURN_PLAUSIBLE}
        return np.array(
            [kinds.get(kind, STATION_PLAUSIBLE) for kind, _, at in self.slots for _ in range(at.stop - at.start)]
        )

    def moved(self, step: np.ndarray) -> SetUp:
        """The set-up after a step: turns as rotation vectors in the station's own frame."""
        rotation = np.array(self.rotation)
        shifted = {"origin": np.array(self.origin), "dead path": np.array(self.dead), "place": np.array(self.place)}
        for kind, i, at in self.slots:
            if kind == "turn":
                rotation[i] = rotation[i] @ rotation_exp(step[at])
            else:
                shifted[kind][i : i + 1] += step[at]
        shift = step if self.shift is None else self.shift + step
        origin, dead, place = shifted.values()
        return replace(self, rotation=rotation, origin=origin, dead=dead, place=place, shift=shift)


def _first_rows(names: np.ndarray) -> tuple[tuple[str, ...], list[int]]:
    """Names in order of appearance, and the first row of each."""
    first: dict[str, int] = {}
    for row, name in enumerate(names):
        first.setdefault(name, row)
    return tuple(first), list(first.values())
