"""The set-up: where the stations stand, where the targets sit, from where an interferometer counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

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


@final
@dataclass(frozen=True)
class SetUp:
    """Stations and targets; metres and radians, base frame.

    Attributes:
        stations: names.
        rotation: (stations, 3, 3) station frame in the base frame.
        origin: (stations, 3).
        dead: (stations,) path an interferometer's counter was zeroed at; zero where lengths are absolute.
        targets: names.
        place: (targets, 3) on their carriers.
        station_known, target_known: what the data say themselves.
        lengths_only: whether the stations read lengths from an unknown zero and nothing else.
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

    @classmethod
    def told(cls, data: Measurements, *, lengths_only: bool) -> SetUp:
        """What the data say; identity and zero for the rest."""
        stations = tuple(dict.fromkeys(data.station))
        targets = tuple(dict.fromkeys(data.target))
        rotation = np.tile(np.eye(3), (len(stations), 1, 1))
        origin, place = np.zeros((len(stations), 3)), np.zeros((len(targets), 3))
        station_known, target_known = np.zeros(len(stations), dtype=bool), np.zeros(len(targets), dtype=bool)
        for i, name in enumerate(stations):
            pose = data.station_pose[np.flatnonzero(data.station == name)[0]]
            if np.all(np.isfinite(pose)):
                station_known[i] = True
                origin[i], rotation[i] = pose[:3] * MM, rotation_exp(pose[3:] * DEG)
        for i, name in enumerate(targets):
            where = data.place_mm[np.flatnonzero(data.target == name)[0]]
            if np.all(np.isfinite(where)):
                target_known[i] = True
                place[i] = where * MM
        dead = np.zeros(len(stations))
        return cls(stations, rotation, origin, dead, targets, place, station_known, target_known, lengths_only)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown numbers, in the order of `moved`."""
        found: list[str] = []
        for name, known in zip(self.stations, self.station_known, strict=True):
            if not self.lengths_only and not known:
                found += [f"station {name} turn {axis}" for axis in "xyz"]
            if not known:
                found += [f"station {name} {axis}" for axis in "xyz"]
            if self.lengths_only:
                found.append(f"station {name} dead path")
        for name, known in zip(self.targets, self.target_known, strict=True):
            if not known:
                found += [f"target {name} {axis}" for axis in "xyz"]
        return tuple(found)

    @property
    def plausible(self) -> np.ndarray:
        """(unknowns,) how far each may be from anything, metres and radians."""
        # Their common shift, too, may be that large.
        place = PLACE_PLAUSIBLE * float(np.sqrt(max(int(np.count_nonzero(~self.target_known)), 1)))
        kinds = {"target": place, "turn": TURN_PLAUSIBLE, "station": STATION_PLAUSIBLE}
        return np.array([kinds[_kind(name)] for name in self.names])

    def slots(self) -> tuple[list[tuple[slice, slice, slice]], list[slice]]:
        """Where each station's turn, origin and dead path stand among the unknowns, and each target's place; empty where known."""
        at = 0

        def take(count: int, there: bool) -> slice:
            nonlocal at
            taken = slice(at, at + (count if there else 0))
            at = taken.stop
            return taken

        stations = []
        for known in self.station_known:
            turn = take(3, not self.lengths_only and not known)
            stations.append((turn, take(3, not known), take(1, self.lengths_only)))
        return stations, [take(3, not known) for known in self.target_known]

    def moved(self, step: np.ndarray) -> SetUp:
        """The set-up after a step: turns as rotation vectors in the station's own frame."""
        stations, targets = self.slots()
        rotation, origin, dead, place = (np.array(a) for a in (self.rotation, self.origin, self.dead, self.place))
        for i, (turn, shift, path) in enumerate(stations):
            if turn.stop > turn.start:
                rotation[i] = rotation[i] @ rotation_exp(step[turn])
            if shift.stop > shift.start:
                origin[i] += step[shift]
            if path.stop > path.start:
                dead[i] += step[path][0]
        for i, where in enumerate(targets):
            if where.stop > where.start:
                place[i] += step[where]
        return SetUp(
            self.stations,
            rotation,
            origin,
            dead,
            self.targets,
            place,
            self.station_known,
            self.target_known,
            self.lengths_only,
        )


def _kind(name: str) -> str:
    return "target" if name.startswith("target") else "turn" if " turn " in name else "station"
