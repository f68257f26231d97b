"""The set-up: poses of the stations, places of the targets, and dead paths of an interferometer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal, NamedTuple, final

import numpy as np

from twin._common.units import DEG, MM
from twin.measurement.instruments import InstrumentSpecification, StationInstruments
from twin.measurement.state import of_angles
from twin.measurement.table import Measurements
from twin.numerics.spatial import rotation_exp

PLACE_PLAUSIBLE: Final = 0.2
"""Prior standard deviation of a target's place on its carrier if it is not given, m."""
STATION_PLAUSIBLE: Final = 10.0
"""Prior standard deviation of a station's position, m."""
VERTICAL_M: Final = (0.0, 0.0, 1.0)
"""The line that turns with a level, metres."""
TURN_PLAUSIBLE: Final = 1.0
"""Prior standard deviation of a station's rotation about its initial value, rad."""


class Slot(NamedTuple):
    """Unknown parameters of one kind of one station or target.

    Attributes:
        kind: ``turn``, ``origin`` and ``dead path`` of a station, ``place`` of a target.
        number: index of the station or target.
        at: their slice of the set-up's unknowns.
    """

    kind: Literal["turn", "origin", "dead path", "place"]
    number: int
    at: slice


@final
@dataclass(frozen=True)
class SetUp:
    """Poses of stations and places of targets; metres and radians, in the frame on which each station rides (usually the base frame).

    Attributes:
        stations: names.
        rotation: (stations, 3, 3) station frame in that frame.
        origin: (stations, 3).
        dead: (stations,) dead path of an interferometer, at which its counter was zeroed; zero where lengths are absolute.
        targets: names.
        place: (targets, 3) on their carriers.
        station_known, target_known: whether the table gives the pose or place.
        reads: what the instrument of each station reads.
        lines: (targets,) whether a target is a line of 1 m that turns with a level; its unknowns are x and y of its end.
        shift: (unknowns,) change of each parameter by `moved` since its initial value, metres and radians; None for zero.
    """

    stations: tuple[str, ...]
    rotation: np.ndarray
    origin: np.ndarray
    dead: np.ndarray
    targets: tuple[str, ...]
    place: np.ndarray
    station_known: np.ndarray
    target_known: np.ndarray
    reads: tuple[InstrumentSpecification, ...]
    lines: np.ndarray
    shift: np.ndarray | None = None

    @classmethod
    def from_table(cls, data: Measurements, instruments: StationInstruments) -> SetUp:
        """Return the poses and places given in a table; identity and zero for the others."""
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
        reads = tuple(instruments.by_station[name].specification for name in stations)
        lines = np.isin(targets, data.target[of_angles(data)].astype(str))
        place[lines & ~target_known] = VERTICAL_M
        return cls(stations, rotation, origin, dead, targets, place, station_known, target_known, reads, lines)

    def of(self, data: Measurements) -> SetUp:
        """Return the stations and targets of other data, with the values of this set-up.

        Raises:
            KeyError: a station or target that is not in this set-up.
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
            reads=tuple(self.reads[i] for i in stations),
            lines=self.lines[targets],
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
        """Unknown parameters of each station, then of each target."""
        found: list[Slot] = []

        def add(kind: Literal["turn", "origin", "dead path", "place"], number: int, count: int = 3) -> None:
            start = found[-1].at.stop if found else 0
            found.append(Slot(kind, number, slice(start, start + count)))

        for i, (known, reads) in enumerate(zip(self.station_known.tolist(), self.reads, strict=True)):
            if reads.turns and not known:
                add("turn", i)
            if not known:
                add("origin", i)
            if reads.free_start:
                add("dead path", i, 1)
        for i in np.flatnonzero(~self.target_known).tolist():
            add("place", i, 2 if self.lines[i] else 3)
        return tuple(found)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown parameters, in the order of `moved`."""
        found: list[str] = []
        for kind, i, at in self.slots:
            if kind == "dead path":
                found.append(f"station {self.stations[i]} dead path")
                continue
            what = f"target {self.targets[i]}" if kind == "place" else f"station {self.stations[i]}"
            axes = "xyz"[: at.stop - at.start]
            found += [f"{what} turn {axis}" if kind == "turn" else f"{what} {axis}" for axis in axes]
        return tuple(found)

    @property
    def plausible(self) -> np.ndarray:
        """Prior standard deviation of each unknown parameter, (unknowns,), metres and radians."""
        # The factor allows for a common shift of all targets of that size.
        place = PLACE_PLAUSIBLE * float(np.sqrt(max(int(np.count_nonzero(~self.target_known)), 1)))
        kinds = {"place": place, "turn": TURN_PLAUSIBLE}
        return np.array(
            [kinds.get(kind, STATION_PLAUSIBLE) for kind, _, at in self.slots for _ in range(at.stop - at.start)]
        )

    def moved(self, step: np.ndarray) -> SetUp:
        """Return the set-up after a step; rotations are rotation vectors in the station's own frame."""
        rotation = np.array(self.rotation)
        shifted = {"origin": np.array(self.origin), "dead path": np.array(self.dead), "place": np.array(self.place)}
        for kind, i, at in self.slots:
            if kind == "turn":
                rotation[i] = rotation[i] @ rotation_exp(step[at])
            else:
                shifted[kind].reshape(len(shifted[kind]), -1)[i, : at.stop - at.start] += step[at]
        shift = step if self.shift is None else self.shift + step
        origin, dead, place = shifted.values()
        return replace(self, rotation=rotation, origin=origin, dead=dead, place=place, shift=shift)


def _first_rows(names: np.ndarray) -> tuple[tuple[str, ...], list[int]]:
    """Return the names in order of appearance, and the first row of each."""
    first: dict[str, int] = {}
    for row, name in enumerate(names):
        first.setdefault(name, row)
    return tuple(first), list(first.values())
