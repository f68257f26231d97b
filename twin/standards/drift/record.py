"""A drift record: displacements of the tool relative to the work over time, with temperatures, spindle speed and axis positions.

Which displacement sensor measures in which direction: given by the user or by a comment of the table, never guessed.

# sensors: d1=X1 d2=X2 d3=Y1 d4=Y2 d5=Z X1-X2=76 Y1-Y2=76 t5=ambient
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError, closest_name
from twin._common.records import SPEED, TIME, check_course, is_temperature, read_record, sensor_of
from twin.machine.machine import Machine
from twin.measurement.columns import RowNote, simulated_comments
from twin.standards.drift.iso230_3 import AxisDesign, tilt_urad

PLACES: Final = ("X", "X1", "X2", "Y", "Y1", "Y2", "Z")
"""Directions of sensors; 1 near the end of the mandrel, 2 near the spindle nose."""
PAIRS: Final = ("X1-X2", "Y1-Y2")
AMBIENT: Final = "ambient"
COMMENT: Final = re.compile(r"sensors:(.*)", re.IGNORECASE)
EXPECTED: Final = (
    f"sensor={'|'.join(PLACES)}, sensor=-X1 where it counts the other way, X1-X2=mm, Y1-Y2=mm, sensor=ambient"
)


@final
@dataclass(frozen=True)
class SensorMap:
    """Directions of displacement sensors, distances between parallel ones, and the sensor of the ambient temperature.

    Attributes:
        sensor: name of the sensor by direction (``X1``).
        sign: +1.0 or −1.0 by direction.
        distance_mm: by pair: ``X1-X2``, ``Y1-Y2``.
        ambient: sensor of the ambient temperature; empty if not given.
    """

    sensor: Mapping[str, str]
    sign: Mapping[str, float]
    distance_mm: Mapping[str, float]
    ambient: str = ""

    @classmethod
    def parse(cls, entries: Sequence[str]) -> SensorMap:
        """Return the map from entries like ``d1=X1``, ``X1-X2=76`` and ``t5=ambient``.

        Raises:
            InputError: an entry that cannot be read, a direction or sensor given twice, a distance that is not positive.
        """
        sensor: dict[str, str] = {}
        sign: dict[str, float] = {}
        distance: dict[str, float] = {}
        ambient = ""
        for entry in entries:
            name, _, value = entry.partition("=")
            place = value.removeprefix("-")
            if name in PAIRS:
                distance[name] = _distance(entry, value)
            elif name and value == AMBIENT and not ambient:
                ambient = name
            elif name and place in PLACES and place not in sensor and name not in sensor.values():
                sensor[place], sign[place] = name, -1.0 if value.startswith("-") else 1.0
            else:
                raise InputError("the sensors' directions cannot be read", expected=EXPECTED, value=entry)
        for axis in "XY":
            if axis in sensor and {f"{axis}1", f"{axis}2"} & set(sensor):
                raise InputError(
                    f"{axis} and {axis}1 or {axis}2 are both given", expected=f"{axis}, or {axis}1 and {axis}2"
                )
        return cls(MappingProxyType(sensor), MappingProxyType(sign), MappingProxyType(distance), ambient)

    @classmethod
    def of_comments(cls, comments: Sequence[str]) -> SensorMap:
        """Return the map that the comments of a table give; an empty one if they give none."""
        texts = [match[1] for match in map(COMMENT.match, comments) if match]
        return cls.parse([entry for text in texts for entry in re.split(r"[\s,;]+", text) if entry])

    def __bool__(self) -> bool:
        return bool(self.sensor or self.distance_mm or self.ambient)

    def check(self, displacements: Sequence[str], temperatures: Sequence[str]) -> None:
        """Raise `InputError` for a sensor that the record does not have."""
        asked = [(name, displacements) for name in self.sensor.values()]
        for name, known in [*asked, *([(self.ambient, temperatures)] if self.ambient else [])]:
            if name not in known:
                raise InputError(
                    "the record has no such sensor",
                    expected=f"one of {', '.join(known)}" if known else "a column of this sensor",
                    value=name,
                    nearest=closest_name(name, known),
                )

    def ambient_of(self, temperatures: Mapping[str, np.ndarray]) -> str:
        """Return the sensor of the ambient temperature, given or named ``ambient``; empty if there is none that read anything."""
        name = self.ambient or AMBIENT
        return name if name in temperatures and np.isfinite(temperatures[name]).any() else ""

    def applied(self, readings: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], dict[str, str], list[str]]:
        """Return displacements by direction, with tilts, their units, and remarks.

        B is the tilt about +Y from X1 and X2, A that about +X from Y1 and Y2, right-handed, where sensor 2 is above sensor 1 on a
        spindle along Z. Sensors without a direction keep their names.

        Args:
            readings: (n,) µm by sensor, of those that read anything.
        """
        read = [place for place in PLACES if self.sensor.get(place) in readings]
        values = {place: self.sign[place] * readings[self.sensor[place]] for place in read}
        units = dict.fromkeys(values, "um")
        silent = sorted(set(self.sensor.values()) - set(readings))
        remarks = [f"sensors without any reading: {', '.join(silent)}"] if silent else []
        for pair, tilt, way in (("X1-X2", "B", 1.0), ("Y1-Y2", "A", -1.0)):
            lower, upper = pair.split("-")
            if lower in values and upper in values:
                if pair in self.distance_mm:
                    values[tilt] = way * tilt_urad(values[lower], values[upper], self.distance_mm[pair])
                    units[tilt] = "urad"
                else:
                    remarks.append(f"no tilt {tilt}: the distance {pair} of the sensors is not given")
        left = [name for name in readings if name not in self.sensor.values()]
        own = {name: f"sensor {name}" if name in values else name for name in left}
        values |= {own[name]: readings[name] for name in left}
        units |= dict.fromkeys(own.values(), "um")
        if left:
            remarks.append(f"the direction of {', '.join(left)} is not given: values of single sensors, without tilt")
        if {"A", "B"} & set(units):
            remarks.append(
                "tilts are right-handed if sensor 2 is nearer to the spindle nose than sensor 1, on a spindle along Z"
            )
        return values, units, remarks


def _distance(entry: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and 0.0 < value < 1e4):
        raise InputError("the distance of two sensors cannot be read", expected="mm, above 0: X1-X2=76", value=entry)
    return value


# --- A drift record: displacements of the tool relative to the work over time, with temperatures, spindle speed and axis posi

ROUND: Final = "round"
SUFFIX: Final = "_um"
ANGLE: Final = "_urad"
Readings = Mapping[str, np.ndarray]


@final
@dataclass(frozen=True)
class DriftRecord:
    """Displacements over time; n rows in the order of time.

    Attributes:
        source: the file.
        time_s: (n,) strictly increasing.
        part: (n,) name of the part of the record (round): tests of different axes are different parts.
        spot: (n,) what was read: target and station, in words; empty for displacement sensors.
        positions: (n, axes) mm and degrees, command order.
        displacement: (n,) by direction or sensor, µm or µrad; NaN where it was not read.
        units: ``um`` or ``urad`` by name.
        temperature_degC: (n,) by sensor.
        ambient: the sensor of the ambient temperature; empty if unknown.
        speed_rpm: (n,); None if the record has no speeds.
        u_um: standard uncertainty of a displacement; NaN if unknown.
        remarks: assumptions on directions.
        notices: what was read but not used.
        set_aside: rows that are not used.
        simulated: whether the readings were simulated.
        design: how the errors of the rotary axis that moves act on the displacements; None if there is none.
    """

    source: str
    time_s: np.ndarray
    part: np.ndarray
    spot: np.ndarray
    positions: np.ndarray
    displacement: Readings
    units: Mapping[str, str]
    temperature_degC: Readings
    ambient: str
    speed_rpm: np.ndarray | None
    u_um: float = float("nan")
    remarks: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    set_aside: tuple[RowNote, ...] = ()
    simulated: bool = False
    design: AxisDesign | None = None

    def __len__(self) -> int:
        return len(self.time_s)


def is_displacement_record(path: str | Path) -> bool:
    """Return whether a file has columns ``<name>_um`` or ``<name>_urad`` and none of targets: it is not a measurement table."""
    header, _, _ = read_table(Path(path))
    return any(_is_reading(name, suffix) for name in header for suffix in (SUFFIX, ANGLE)) and "target" not in header


def load_displacements(path: str | Path, machine: Machine, sensors: SensorMap) -> DriftRecord:
    """Read a record of displacement sensors.

    Columns: ``time_s``, ``<name>_um``, ``<name>_urad`` of levels and autocollimators, which keep their names; optionally
    ``spindle_rpm``, ``T_<sensor>_degC``, ``round`` and the axes' positions. A comment ``# sensors: d1=X1 …`` gives the directions.

    Args:
        machine: the machine, for the names of its axes.
        sensors: the sensors' directions; empty for those of the comment.

    Raises:
        InputError: no times, fewer than two rows, a cell that is not a number, times that do not increase, a sensor that is not there.
    """
    cells, comments = read_record(path)
    header, rows, file = list(cells.columns), cells.rows, cells.path
    axes = [f"{axis.name}_{axis.unit}" for axis in machine.axes]
    names = [name for name in header if _is_reading(name, SUFFIX)]
    angular = [name for name in header if _is_reading(name, ANGLE)]
    temperatures = [name for name in header if is_temperature(name)]
    numbers = {
        name: _numbers(cells, name) for name in [TIME, SPEED, *axes, *names, *angular, *temperatures] if name in header
    }
    for name in [name for name in (TIME, SPEED, *axes) if name in numbers]:
        cells.refuse(np.isnan(numbers[name]), numbers[name], name, "a number in every row")
    check_course(cells, numbers)
    displacements = {name[: -len(SUFFIX)]: numbers[name] for name in names if np.isfinite(numbers[name]).any()}
    angles = {f"angle_{name[: -len(ANGLE)]}": numbers[name] for name in angular if np.isfinite(numbers[name]).any()}
    if not (displacements or angles):
        raise InputError("no displacement was read", expected="numbers in a column <name>_um or <name>_urad", file=file)
    measured = {sensor_of(name): numbers[name] for name in temperatures}
    directions = sensors or SensorMap.of_comments(comments)
    directions.check([name[: -len(SUFFIX)] for name in names], list(measured))
    displacement, units, remarks = directions.applied(displacements)
    known = {TIME, SPEED, ROUND, *axes, *names, *angular, *temperatures}
    none = np.zeros(len(rows))
    return DriftRecord(
        source=str(path),
        time_s=numbers[TIME],
        part=cells.words(ROUND, "1"),
        spot=read_only(np.full(len(rows), "", dtype=object)),
        positions=read_only(np.stack([numbers.get(name, none) for name in axes], axis=1)),
        displacement=MappingProxyType(displacement | angles),
        units=MappingProxyType(units | dict.fromkeys(angles, "urad")),
        temperature_degC=MappingProxyType(measured),
        ambient=directions.ambient_of(measured),
        speed_rpm=numbers.get(SPEED),
        remarks=tuple(remarks),
        notices=tuple(unused_column_note(name, sorted(known)) for name in header if name not in known),
        simulated=bool(simulated_comments(comments)),
    )


def _is_reading(name: str, suffix: str) -> bool:
    return name.endswith(suffix) and len(name) > len(suffix)


def _numbers(cells: Cells, name: str) -> np.ndarray:
    """Return a column; NaN for an empty cell."""
    values = cells.numbers(name)
    cells.refuse(np.isinf(values), values, name, "a number or an empty cell")
    return values
