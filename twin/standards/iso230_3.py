"""Displacements over time in the tests of ISO 230-3, and the records of displacement sensors that hold them.

The figures are ranges (largest minus smallest) and changes from the first reading. They follow public descriptions of the standard (its
scope and its preview), not its clauses.

Action of the location, the orientation and the zero of a rotary axis on the displacements that were read around it: the nominal
kinematics at the commanded positions give the places of the sphere about the axis, as the linear axes follow it. The level of the
sphere along the axis does not show in the positions, so the location of the axis is that at the level of the sphere.

Which displacement sensor measures in which direction is given by the user or by a comment of the table, never guessed:

    # sensors: d1=X1 d2=X2 d3=Y1 d4=Y2 d5=Z X1-X2=76 Y1-Y2=76 t5=ambient
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal, final

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError, closest_name
from twin._common.messages import Message
from twin._common.records import SPEED, TIME, check_course, is_temperature, read_record, sensor_of
from twin._common.units import DEG, MM, UM
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import CARRIERS, RowNote, simulated_comments
from twin.measurement.instruments import Instrument
from twin.measurement.observation import Observation, nominal_carriers, of_angles
from twin.measurement.table import Measurements
from twin.standards.iso230_1 import check_same_length, finite_array
from twin.standards.readings import SAME_AS_MACHINE, reading_uncertainty_mm, rms_um

FIRST_S: Final = 3600.0
"""Length of the first part of a spindle test, s."""
DriftKind = Literal["environment", "spindle", "axes", "rotary axis"]


@final
@dataclass(frozen=True)
class DriftSeries:
    """Displacements of one test over time; n readings."""

    kind: DriftKind  # ``environment``, ``spindle``, ``axes`` or ``rotary axis``
    time_s: np.ndarray  # (n,) increasing
    # (n,) by name, µm or µrad, from the reference reading; NaN where it was not read
    displacement: Mapping[str, np.ndarray]
    units: Mapping[str, str]  # ``um`` or ``urad`` by name
    temperature_degC: Mapping[str, np.ndarray]  # (n,) by sensor; NaN where it was not read
    speed_rpm: np.ndarray | None  # (n,) spindle speed; None if unknown
    target: np.ndarray  # (n,) number of the target position, from 1
    running_s: tuple[float, float] | None  # start and end of the period in which the spindle ran; None for other tests

    @property
    def targets(self) -> tuple[int, ...]:
        """Numbers of the target positions."""
        return tuple(int(one) for one in np.unique(self.target))

    @property
    def duration_s(self) -> float:
        """Time from the first to the last reading."""
        return float(self.time_s[-1] - self.time_s[0])

    def range(self, name: str, *, target: int = 1, until_s: float = np.inf) -> float:
        """Return the largest minus the smallest displacement at a target; NaN for fewer than two readings.

        In a spindle test only readings of the period in which the spindle ran count, up to ``until_s`` from its start, and the
        reference reading before it.
        """
        return spread(self.displacement[name][self._counted(target, until_s)])

    def end(self, name: str, *, target: int = 1) -> float:
        """Return the displacement at the last counted reading of a target, from the reference; NaN if it was not read."""
        values = self.displacement[name][self._counted(target, np.inf)]
        read = values[np.isfinite(values)]
        return float(read[-1]) if len(read) else float("nan")

    def _counted(self, target: int, until_s: float) -> np.ndarray:
        start, end = self.running_s or (float(self.time_s[0]), float(self.time_s[-1]))
        after, before = self.time_s >= start, self.time_s <= min(end, start + until_s)
        return np.flatnonzero(after & before & (self.target == target))


def spread(values: np.ndarray) -> float:
    """Return the largest minus the smallest value, without those that are NaN; NaN for fewer than two."""
    read = values[np.isfinite(values)]
    return float(np.ptp(read)) if len(read) > 1 else float("nan")


def tilt_urad(first_um: np.ndarray, second_um: np.ndarray, distance_mm: float) -> np.ndarray:
    """Return the tilt (n,) from two parallel sensors at a distance: second minus first, divided by the distance."""
    return np.asarray((second_um - first_um) / distance_mm * 1e3)


def drift_series(
    kind: DriftKind,
    time_s: ArrayLike,
    displacement: Mapping[str, ArrayLike],
    *,
    units: Mapping[str, str],
    temperature_degC: Mapping[str, np.ndarray] | None = None,
    speed_rpm: ArrayLike | None = None,
    target: ArrayLike | None = None,
) -> DriftSeries:
    """Return the displacements of a test from the reference: the first reading at each target; for a spindle the last before it ran.

    Arguments are (n,) as the fields of `DriftSeries`; a speed is that at each reading, or between the reading before and this one if
    the spindle stands still for the reading.
    """
    time = finite_array("time_s", time_s, 1)
    for name, values in displacement.items():
        check_same_length(name, np.asarray(values), "time_s", time)
    if len(time) < 2:
        raise InputError("too few readings", expected="at least two", value=len(time))
    if np.any(np.diff(time) <= 0.0):
        raise InputError("the times do not increase", expected="a later time at every reading")
    number = np.ones(len(time), dtype=int) if target is None else np.asarray(target, dtype=int)
    speed = None if speed_rpm is None else np.asarray(speed_rpm, dtype=float)
    running = None
    first = {int(one): int(np.flatnonzero(number == one)[0]) for one in np.unique(number)}
    if kind == "spindle":
        ran = np.flatnonzero(np.nan_to_num(speed) > 0.0) if speed is not None else np.zeros(0, dtype=int)
        if not len(ran):
            raise InputError("the spindle never ran", expected="a spindle speed above zero")
        before = max(int(ran[0]) - 1, 0)
        running, first = (float(time[before]), float(time[ran[-1]])), {1: before}
    return DriftSeries(
        kind=kind,
        time_s=read_only(time),
        displacement=MappingProxyType(
            {
                name: read_only(_from_reference(np.asarray(v, dtype=float), number, first))
                for name, v in displacement.items()
            }
        ),
        units=MappingProxyType(dict(units)),
        temperature_degC=MappingProxyType(dict(temperature_degC or {})),
        speed_rpm=None if speed is None else read_only(speed),
        target=read_only(number),
        running_s=running,
    )


def _from_reference(values: np.ndarray, target: np.ndarray, first: Mapping[int, int]) -> np.ndarray:
    """Return values from that of the reference row of each target, or from the first one read after it."""
    change = np.full(values.shape, np.nan)
    for number, row in first.items():
        here = target == number
        read = np.flatnonzero(here & np.isfinite(values))
        later = read[read >= row]
        if len(later):
            change[here] = values[here] - values[later[0]]
    return change


# --- Action of the location, the orientation and the zero of a rotary axis on the displacements that were read around it

LETTERS: Final = "XYZABC"
TURNED_DEG: Final = 5.0
"""Travel above which a rotary axis counts as moved."""
STEP_DEG: Final = 1e-3


@final
@dataclass(frozen=True)
class AxisDesign:
    """Displacements of the tool relative to the work per unit of each quantity of a rotary axis."""

    axis: str
    # of the quantities: two locations, the shift along the axis, two orientations, the zero, the radial expansion
    names: tuple[str, ...]
    units: tuple[str, ...]  # ``um`` or ``urad`` by name, in that order
    matrix: np.ndarray  # (n, 3, 7) µm in X, Y, Z of the machine per unit, for every row of the record
    radius_mm: float  # mean distance of the spheres from the axis

    def select(self, rows: np.ndarray) -> AxisDesign:
        """Return the design of some rows."""
        return AxisDesign(self.axis, self.names, self.units, read_only(self.matrix[rows]), self.radius_mm)


def turning_axis(positions: np.ndarray, machine: Machine) -> Axis | None:
    """Return the only rotary axis that moves; None if none or several do."""
    turned = [i for i in machine.rotary if np.ptp(positions[:, i]) > TURNED_DEG]
    return machine.axes[turned[0]] if len(turned) == 1 else None


def axis_design(data: Measurements, machine: Machine) -> AxisDesign | None:
    """Return the design of the readings of a table; None if no rotary axis moves or several do, or if stations stand on the base."""
    axis = turning_axis(data.positions, machine)
    if axis is None or str(data.station_carrier[0]) == "base":
        return None
    return design_of(axis, np.asarray(data.positions), *_parts(data), machine)


def design_of(
    axis: Axis, positions: np.ndarray, on_tool: Sequence[str], on_work: Sequence[str], machine: Machine
) -> AxisDesign:
    """Return the design of poses (n, axes), mm and degrees, at which a part of the tool is at a part on the work, by their names."""
    observation, q, side = Observation(machine), positions * machine.scale, "tool" if axis.side == "tool" else "work"
    places = _places(observation, q, on_tool, on_work)[side]
    errors = np.zeros((len(q), 6 * len(machine.frames)))
    carried = observation.carried(q, errors, np.full(len(q), side, dtype=object), places)
    frame = next(k for k, one in enumerate(machine.frames) if one.axis == axis.name and one.role == "location")
    by_error = carried.by_error[:, :, 6 * frame : 6 * frame + 6]
    directions = by_error[:, :, :3]
    lever = -0.5 * np.sum(np.cross(directions, by_error[:, :, 3:], axis=1), axis=2)
    located = [LETTERS.index(name[2]) for name in machine.location_names if name[4] == axis.name]
    (along,) = {0, 1, 2} - set(located)
    own = directions[:, :, along]
    level = np.sum(own * lever, axis=1)
    radial = lever - own * level[:, None]
    lever = lever - own * level.mean()
    moved = positions.copy()
    index = machine.names.index(axis.name)
    moved[:, index] += STEP_DEG
    after = observation.points(moved * machine.scale, errors, np.full(len(q), side, dtype=object), places)
    about = np.cross(own, lever)
    way = np.sign(np.sum((after - carried.points) * about))
    radius = float(np.mean(np.linalg.norm(radial, axis=1)))
    sign = 1.0 if side == "tool" else -1.0
    columns = [directions[:, :, k] if k < 3 else np.cross(directions[:, :, k - 3], lever) / MM * 1e-3 for k in located]
    columns = [*columns[:2], own, *columns[2:], way * about / MM * 1e-3, radial / max(radius, 1e-12)]
    first, second, third, fourth = (f"E_{LETTERS[k]}0{axis.name}" for k in located)
    names = (first, second, f"axial_{axis.name}", third, fourth, f"zero_{axis.name}", f"radial_{axis.name}")
    units = ("um", "um", "um", "urad", "urad", "urad", "um")
    return AxisDesign(axis.name, names, units, read_only(sign * np.stack(columns, axis=2)), radius / MM)


def _parts(data: Measurements) -> tuple[list[str], list[str]]:
    """Return the names (n,) of the part on the tool side and of the part on the work side of each reading."""
    tool, work = [], []
    for target, station, carrier in zip(data.target, data.station, data.carrier, strict=True):
        first, second = (f"target {target}", f"station {station}")
        tool.append(first if carrier == "tool" else second)
        work.append(second if carrier == "tool" else first)
    return tool, work


def _places(
    observation: Observation, q: np.ndarray, on_tool: Sequence[str], on_work: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the places (n, 3) of the parts on both sides, metres: those that meet at the commanded positions.

    Their level along an axis parallel to the tool is not determined; the least-squares solution of smallest length is used.
    """
    errors, zero = np.zeros((len(q), 6 * len(observation.machine.frames))), np.zeros((len(q), 3))
    blocks, origins, numbers = [], [], []
    for side, names in zip(CARRIERS, (on_tool, on_work), strict=True):
        carried = observation.carried(q, errors, np.full(len(q), side, dtype=object), zero)
        every = list(dict.fromkeys(names))
        number = np.array([every.index(name) for name in names])
        block = np.zeros((len(q), 3, 3 * len(every)))
        for k in range(len(every)):
            block[number == k, :, 3 * k : 3 * k + 3] = carried.rotation[number == k]
        blocks.append(block)
        origins.append(carried.points)
        numbers.append(number)
    matrix = np.concatenate([blocks[0], -blocks[1]], axis=2).reshape(3 * len(q), -1)
    places = np.linalg.lstsq(matrix, (origins[1] - origins[0]).reshape(-1), rcond=1e-9)[0].reshape(-1, 3)
    split = blocks[0].shape[2] // 3
    own = places[:split], places[split:]
    return {side: own[k][numbers[k]] for k, side in enumerate(CARRIERS)}


# --- Displacement sensors and their record --------------------------------------------------------

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
    """Directions of displacement sensors, distances between parallel ones, and the sensor of the ambient temperature."""

    sensor: Mapping[str, str]  # name of the sensor by direction (``X1``)
    sign: Mapping[str, float]  # +1.0 or −1.0 by direction
    distance_mm: Mapping[str, float]  # by pair: ``X1-X2``, ``Y1-Y2``
    ambient: str = ""  # sensor of the ambient temperature; empty if not given

    @classmethod
    def parse(cls, entries: Sequence[str]) -> SensorMap:
        """Return the map from entries like ``d1=X1``, ``X1-X2=76`` and ``t5=ambient``."""
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

    def applied(
        self, readings: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, str], list[Message]]:
        """Return displacements by direction, with tilts, their units, and remarks, from readings (n,) in µm by sensor.

        B is the tilt about +Y from X1 and X2, A that about +X from Y1 and Y2, right-handed, where sensor 2 is above sensor 1 on a
        spindle along Z. Sensors without a direction keep their names.
        """
        read = [place for place in PLACES if self.sensor.get(place) in readings]
        values = {place: self.sign[place] * readings[self.sensor[place]] for place in read}
        units = dict.fromkeys(values, "um")
        silent = sorted(set(self.sensor.values()) - set(readings))
        remarks = [Message("sensors without any reading: {names}", names=", ".join(silent))] if silent else []
        for pair, tilt, way in (("X1-X2", "B", 1.0), ("Y1-Y2", "A", -1.0)):
            lower, upper = pair.split("-")
            if lower in values and upper in values:
                if pair in self.distance_mm:
                    values[tilt] = way * tilt_urad(values[lower], values[upper], self.distance_mm[pair])
                    units[tilt] = "urad"
                else:
                    remarks.append(
                        Message("no tilt {tilt}: the distance {pair} of the sensors is not given", tilt=tilt, pair=pair)
                    )
        left = [name for name in readings if name not in self.sensor.values()]
        own = {name: f"sensor {name}" if name in values else name for name in left}
        values |= {own[name]: readings[name] for name in left}
        units |= dict.fromkeys(own.values(), "um")
        if left:
            remarks.append(
                Message(
                    "the direction of {names} is not given: values of single sensors, without tilt",
                    names=", ".join(left),
                )
            )
        if {"A", "B"} & set(units):
            remarks.append(
                Message(
                    "tilts are right-handed if sensor 2 is nearer to the spindle nose than sensor 1, on a spindle along Z"
                )
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
    """Displacements over time; n rows in the order of time."""

    source: str
    time_s: np.ndarray  # (n,) strictly increasing
    part: np.ndarray  # (n,) name of the part of the record (round): tests of different axes are different parts
    spot: np.ndarray  # (n,) what was read: target and station, in words; empty for displacement sensors
    positions: np.ndarray  # (n, axes) mm and degrees, command order
    displacement: Readings  # (n,) by direction or sensor, µm or µrad; NaN where it was not read
    units: Mapping[str, str]  # ``um`` or ``urad`` by name
    temperature_degC: Readings  # (n,) by sensor
    ambient: str  # the sensor of the ambient temperature; empty if unknown
    speed_rpm: np.ndarray | None  # (n,); None if the record has no speeds
    u_um: float = float("nan")  # standard uncertainty of a displacement; NaN if unknown
    remarks: tuple[Message, ...] = ()  # assumptions on directions
    notices: tuple[Message, ...] = ()  # what was read but not used
    set_aside: tuple[RowNote, ...] = ()
    simulated: bool = False
    # how the errors of the rotary axis that moves act on the displacements; None if there is none
    design: AxisDesign | None = None

    def __len__(self) -> int:
        return len(self.time_s)


def is_displacement_record(path: str | Path) -> bool:
    """Return whether a file has columns ``<name>_um`` or ``<name>_urad`` and none of targets: it is not a measurement table."""
    header, _, _ = read_table(Path(path))
    return any(_is_reading(name, suffix) for name in header for suffix in (SUFFIX, ANGLE)) and "target" not in header


def load_displacements(path: str | Path, machine: Machine, sensors: SensorMap) -> DriftRecord:
    """Read a record of displacement sensors; ``sensors`` is empty for the directions of the comment.

    Columns: ``time_s``, ``<name>_um``, ``<name>_urad`` of levels and autocollimators, which keep their names; optionally
    ``spindle_rpm``, ``T_<sensor>_degC``, ``round`` and the axes' positions. A comment ``# sensors: d1=X1 …`` gives the directions.
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


# --- Displacements of the tool relative to the work from a measurement table: probe, R-test or tracker, repeated over time

UNTURNED: Final = Message(
    "x, y and z are those of the station, whose orientation is unknown: give its pose for directions of the machine"
)
NOT_RELATIVE: Final = Message("motions of the station and of the table are contained: no target on the work was read")
NOT_RELATIVE_WORK: Final = Message(
    "motions of the station and of the tool are contained: no target on the tool was read"
)


def relative_displacements(
    data: Measurements, machine: Machine, instrument: Instrument | None, ambient: str
) -> DriftRecord:
    """Return the displacements of the tool relative to the work, from a table whose stations are on one side.

    The nominal motion between the commanded positions is subtracted: for a touch probe the displacements are those of the recorded
    positions. Only changes at one pose count, so unknown places of station and target have no influence.
    """
    _check(data)
    data = data.select(np.argsort(data.time_s, kind="stable"))
    base = str(data.station_carrier[0]) == "base"
    posed = bool(np.isfinite(data.station_pose).all())
    deviation = _deviation_um(data, machine)
    on_work = data.carrier == "work"
    signed = np.where(on_work[:, None], -1.0, 1.0) * deviation
    remarks = [] if posed else [UNTURNED if base else SAME_AS_MACHINE]
    rows = np.arange(len(data))
    if base:
        signed, rows, more = _without_work(data, deviation, on_work)
        remarks.append(more)
    data, names = data.select(rows), ("x", "y", "z") if base and not posed else ("X", "Y", "Z")
    used = {name: read_only(signed[rows, k]) for k, name in enumerate(names)}
    u = _uncertainty_mm(data, instrument)
    speed = data.channels.get(SPEED, np.full(len(data), np.nan))
    return DriftRecord(
        source=data.source,
        time_s=data.time_s,
        part=data.round,
        spot=read_only(
            np.array(
                [
                    Message("target {target}, station {station}", target=t, station=s)
                    for t, s in zip(data.target, data.station, strict=True)
                ],
                dtype=object,
            )
        ),
        positions=data.positions,
        displacement=MappingProxyType(used),
        units=MappingProxyType(dict.fromkeys(used, "um")),
        temperature_degC=data.temperature_degC,
        ambient=ambient,
        speed_rpm=read_only(np.abs(speed)) if np.isfinite(speed).any() else None,
        u_um=rms_um(u),
        remarks=tuple(remarks),
        notices=data.notices,
        set_aside=data.set_aside,
        simulated=data.simulated,
        design=axis_design(data, machine),
    )


def _uncertainty_mm(data: Measurements, instrument: Instrument | None) -> np.ndarray:
    """Return (n, 3) standard uncertainties of the readings, mm, those of a touch probe at its zero; NaN if unknown."""
    if instrument is None or instrument.specification.reads != "null":
        return reading_uncertainty_mm(data, instrument)
    model = np.diagonal(instrument.covariance(np.zeros((len(data), 3))), axis1=1, axis2=2)
    return np.where(np.isfinite(data.u_mm), data.u_mm, np.sqrt(model) / MM)


def _check(data: Measurements) -> None:
    missing = np.flatnonzero(~np.isfinite(data.time_s))
    if len(missing):
        raise data.error("no time in this row", expected="time_s in every row", row=missing[0])
    unread = np.flatnonzero(~np.isfinite(data.point_mm).all(axis=1) | of_angles(data))
    if len(unread):
        raise data.error(
            "no three coordinates in this row",
            expected="x_mm, y_mm and z_mm: touch probe, R-test or tracker",
            row=unread[0],
        )
    other = np.flatnonzero(data.station_carrier != data.station_carrier[0])
    if len(other):
        raise data.error(
            "stations on different sides",
            expected=f"station_carrier {data.station_carrier[0]} in every row",
            row=other[0],
            value=data.station_carrier[other[0]],
        )


def _deviation_um(data: Measurements, machine: Machine) -> np.ndarray:
    """Return (n, 3) the readings minus the nominal motion, along the axes of the machine frame, µm.

    Where the station stands on the base without a pose, along those of the station; the nominal motion is then left in.
    """
    posed = np.isfinite(data.station_pose).all(axis=1)
    if data.station_carrier[0] == "base" and not posed.all():
        return np.asarray(data.point_mm) * (MM / UM)
    turn = scipy.spatial.transform.Rotation.from_rotvec(np.where(posed[:, None], data.station_pose[:, 3:], 0.0) * DEG)
    carried = nominal_carriers(machine, data)
    places = np.einsum("nij,nj->ni", carried.rotation, np.nan_to_num(data.place_mm) * MM)
    deviation = turn.apply(np.array(data.point_mm)) * MM - carried.points - places
    return np.asarray(np.einsum("nij,nj->ni", carried.ride, deviation)) / UM


def _without_work(
    data: Measurements, deviation_um: np.ndarray, on_work: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Message]:
    """Return the displacements (n, 3) of tool targets relative to a target on the work, the rows of tool targets, and a remark."""
    tool = np.flatnonzero(~on_work)
    if not on_work.any():
        return deviation_um, tool, NOT_RELATIVE
    if not len(tool):
        return (
            -deviation_um,
            np.arange(len(data)),
            NOT_RELATIVE_WORK,
        )
    name = data.target[on_work][0]
    work = np.flatnonzero(on_work & (data.target == name))
    deviation = deviation_um.copy()
    for k in range(3):
        deviation[:, k] -= np.interp(data.time_s, data.time_s[work], deviation_um[work, k])
    return (
        deviation,
        tool,
        Message(
            "the displacement of target {target} on the work, interpolated over time, is subtracted", target=str(name)
        ),
    )
