"""Kit file: instruments, possible station positions, reflectors, and times of the operations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, final

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError

from twin._common.bundled import find_bundled
from twin._common.errors import InputError, closest_name
from twin._common.units import DEG
from twin._common.yaml_files import EntryPath, load_yaml
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.measurement.simulate import Placement, Station
from twin.uncertainty.budget import volume

SCHEMA: Final = "twin.kit/1"
ACCEPTANCE_DEG: Final = 30.0
"""Acceptance angle of a spherically mounted reflector, either side of its axis (Leica red ring reflector, data sheet)."""
DISTANCE_MM: Final = 2000.0
"""Distance of a default station from the middle of the working volume, mm."""
TRAVEL_MM_S: Final = 100.0
TRAVEL_DEG_S: Final = 15.0


class _KitEntries(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@final
class Seconds(_KitEntries):
    """Times of the operations in seconds.

    Attributes:
        point: settling and reading.
        aim: turning a reflector towards the instrument by hand when it is outside the acceptance angle.
        target: changing from one reflector to another.
        station: setting the instrument up in another place.
    """

    point: Annotated[float, Field(gt=0)] = 15.0
    aim: Annotated[float, Field(ge=0)] = 20.0
    target: Annotated[float, Field(ge=0)] = 30.0
    station: Annotated[float, Field(ge=0)] = 900.0


class _StationEntry(_KitEntries):
    origin_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float] | None = None
    known: bool = False

    def station(self, middle: np.ndarray) -> Station:
        """Return the station; without ``turn_deg`` it faces the middle of the working volume."""
        if self.turn_deg is None:
            return station_facing(self.origin_mm, middle)
        return Station(self.origin_mm, _triple(np.array(self.turn_deg) * DEG))


class _TargetEntry(_KitEntries):
    carrier: Literal["tool", "work"]
    place_mm: tuple[float, float, float]
    known: bool = False
    facing: tuple[float, float, float] | Literal["aimed"] = "aimed"
    acceptance_deg: Annotated[float, Field(gt=0, le=180)] = ACCEPTANCE_DEG

    @field_validator("facing", mode="before")
    @classmethod
    def _direction(cls, value: Any) -> Any:
        if value != "aimed" and not (isinstance(value, list) and len(value) == 3):
            expected = "aimed, or x, y, z on its carrier"
            raise PydanticCustomError("facing", "Input should be {expected}", {"expected": expected})
        return value

    def target(self) -> Target:
        """Return the target, with its facing as a unit vector."""
        facing = None
        if self.facing != "aimed":
            way = np.array(self.facing, dtype=float)
            facing = _triple(way / np.linalg.norm(way))
        return Target(self.carrier, self.place_mm, self.known, facing, self.acceptance_deg * DEG)


class _KitFile(_KitEntries):
    schema_: Literal["twin.kit/1"] = Field(alias="schema")
    source: str = ""
    instruments: Annotated[tuple[str, ...], Field(min_length=1)] = ("tracker",)
    stations: Annotated[dict[str, _StationEntry], Field(min_length=1)]
    targets: Annotated[dict[str, _TargetEntry], Field(min_length=1)]
    seconds: Seconds = Seconds()
    speeds: dict[str, Annotated[float, Field(gt=0)]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    stops_the_beam: Literal["machine", "nothing"] = "machine"


@final
@dataclass(frozen=True)
class Target:
    """A reflector.

    Attributes:
        carrier: ``tool`` or ``work``.
        place_mm: nominal position on its carrier; it need not be met to the millimetre.
        known: whether an evaluation may treat the position as exactly known.
        facing: (3,) unit vector of its axis on its carrier; None: it is turned towards the instrument by hand.
        acceptance_rad: largest angle between its axis and the beam.
    """

    carrier: Literal["tool", "work"]
    place_mm: tuple[float, float, float]
    known: bool
    facing: tuple[float, float, float] | None
    acceptance_rad: float


@final
@dataclass(frozen=True)
class Kit:
    """Equipment for a measurement.

    Attributes:
        source: origin of the kit, in words.
        instruments: instruments to choose from.
        stations: possible stations by name.
        stations_known: names of the stations whose pose an evaluation may treat as exactly known.
        targets: reflectors by name.
        seconds: times of the operations.
        speeds: (axes,) travel speed, mm/s and degrees/s.
        ranges: (axes, 2) usable ranges, mm and degrees; one turn for an unlimited axis.
        opaque: whether the machine's shapes block the beam.
    """

    source: str
    instruments: tuple[Instrument, ...]
    stations: Mapping[str, Station]
    stations_known: frozenset[str]
    targets: Mapping[str, Target]
    seconds: Seconds
    speeds: np.ndarray
    ranges: np.ndarray
    opaque: bool

    @property
    def known(self) -> frozenset[str]:
        """Names of the stations and targets that an evaluation treats as exactly known."""
        return self.stations_known | {name for name, target in self.targets.items() if target.known}

    @property
    def coordinates_per_reading(self) -> int:
        """Number of coordinates per reading, for the instrument that reads fewest."""
        return min(int(np.isfinite(one.read(np.ones((1, 3)))).sum()) for one in self.instruments)

    @property
    def setting(self) -> Placement:
        """Stations and target positions for a simulation."""
        return Placement(self.stations, {name: target.place_mm for name, target in self.targets.items()})

    def without_targets(self) -> Kit:
        """Return the kit without reflectors."""
        return replace(self, targets=MappingProxyType({}))

    @classmethod
    def load(cls, path: str | Path, machine: Machine) -> Kit:
        """Read a kit file (``schema: twin.kit/1``).

        Raises:
            InputError: the file does not fit the schema or the machine; with file, line and value.
        """
        file = Path(path)
        entries, lines = load_yaml(file, _KitFile, SCHEMA)

        def fail(place: EntryPath, what: str, expected: str, value: object, known: Iterable[str] = ()) -> InputError:
            meant = closest_name(str(value), known)
            return InputError(what, expected=expected, file=file, line=lines.get(place), value=value, nearest=meant)

        # Checks beyond the schema.
        by_name = {one.name: one for one in INSTRUMENTS}
        for i, name in enumerate(entries.instruments):
            if name not in by_name:
                raise fail(("instruments", i), "no such instrument", f"one of {', '.join(by_name)}", name, by_name)
        for key, named in (("speeds", entries.speeds), ("ranges", entries.ranges)):
            for name in named:
                if name not in machine.by_name:
                    known = machine.names
                    raise fail((key, name), "no such axis", f"one of {', '.join(known)}", name, known)
        ranges = full_ranges(machine)
        for name, (lower, upper) in entries.ranges.items():
            i = machine.names.index(name)
            if not ranges[i, 0] <= lower < upper <= ranges[i, 1]:
                expected = f"lower, upper within {ranges[i, 0]:g} … {ranges[i, 1]:g}"
                raise fail(("ranges", name), "the range is not within that of the machine", expected, [lower, upper])
            ranges[i] = lower, upper
        for name, entry in entries.targets.items():
            if entry.facing != "aimed" and np.linalg.norm(entry.facing) == 0.0:
                place = ("targets", name, "facing")
                raise fail(place, "facing is a zero vector", "aimed, or x, y, z on its carrier", entry.facing)
        middle = _middle(machine)
        return cls(
            source=entries.source or str(file),
            instruments=tuple(by_name[name] for name in entries.instruments),
            stations=MappingProxyType({name: one.station(middle) for name, one in entries.stations.items()}),
            stations_known=frozenset(name for name, one in entries.stations.items() if one.known),
            targets=MappingProxyType({name: one.target() for name, one in entries.targets.items()}),
            seconds=entries.seconds,
            speeds=np.array([entries.speeds.get(axis.name, _speed(axis.linear)) for axis in machine.axes]),
            ranges=ranges,
            opaque=entries.stops_the_beam == "machine",
        )

    @classmethod
    def default(cls, machine: Machine) -> Kit:
        """Return the default kit, used if no kit file is given.

        A laser tracker that may stand in front, on either side or high up; three reflectors below the spindle nose and three above
        the table.
        """
        middle = _middle(machine)
        corners = {
            "front": (0.0, -1.0, 0.1),
            "left": (-1.0, -0.35, 0.25),
            "right": (1.0, -0.35, 0.25),
            "high": (0.3, -0.8, 0.9),
        }
        stations = {}
        for name, way in corners.items():
            direction = np.array(way) / np.linalg.norm(way)
            stations[name] = station_facing(_triple(np.round(middle + DISTANCE_MM * direction, -1)), middle)
        reflectors = {}
        for k in range(3):
            angle = np.radians(30.0 + 120.0 * k)
            across = np.array([np.cos(angle), np.sin(angle)])
            for letter, radius, height in (("T", 110.0, -40.0 - 35.0 * k), ("W", 170.0, 30.0 + 30.0 * k)):
                place = _triple(np.round([*(radius * across), height]) + 0.0)
                carrier: Literal["tool", "work"] = "tool" if letter == "T" else "work"
                reflectors[f"{letter}{k + 1}"] = Target(carrier, place, False, None, ACCEPTANCE_DEG * DEG)
        return cls(
            source="assumed by twin: describe your equipment in a kit file",
            instruments=(INSTRUMENTS[0],),
            stations=MappingProxyType(stations),
            stations_known=frozenset(),
            targets=MappingProxyType(dict(sorted(reflectors.items()))),
            seconds=Seconds(),
            speeds=np.array([_speed(axis.linear) for axis in machine.axes]),
            ranges=full_ranges(machine),
            opaque=True,
        )


def bundled_kit(name: str | Path) -> Path:
    """Return the path of a kit file, given by its path or by the bare name of one that comes with `twin`.

    Raises:
        InputError: there is no such file; the message lists those that come with `twin`.
    """
    return find_bundled(name, ".kit.yaml", "a kit file (schema twin.kit/1)")


def full_ranges(machine: Machine) -> np.ndarray:
    """Return the full ranges (axes, 2) in mm and degrees; one turn for an unlimited axis."""
    return np.array([axis.domain for axis in machine.axes])


def station_facing(origin_mm: tuple[float, float, float], point_mm: np.ndarray) -> Station:
    """Return an upright station at a position, its x axis towards a point."""
    away = point_mm - np.array(origin_mm)
    return Station(origin_mm, (0.0, 0.0, float(np.radians(np.round(np.degrees(np.arctan2(away[1], away[0])))))))


def _middle(machine: Machine) -> np.ndarray:
    """Return the mean position (3,) of tool and work over the volume, base frame, mm."""
    poses = volume(machine, 50)
    data = machine.model.createData()
    found: list[Any] = []
    for q in poses * machine.scale:
        pin.framesForwardKinematics(machine.model, data, machine.configuration(q))
        found += [data.oMf[machine.tool_frame].translation * 1e3, data.oMf[machine.work_frame].translation * 1e3]
    return np.asarray(np.mean(found, axis=0))


def _speed(linear: bool) -> float:
    return TRAVEL_MM_S if linear else TRAVEL_DEG_S


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
