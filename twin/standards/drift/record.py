"""A drift record: displacements of the tool relative to the work over time, with temperatures, spindle speed and axis positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError
from twin._common.records import SPEED, TIME, check_course, is_temperature, read_record, sensor_of
from twin.machine.machine import Machine
from twin.measurement.checks import RowNote
from twin.measurement.columns import simulated_comments
from twin.standards.drift.axis_design import AxisDesign
from twin.standards.drift.sensors import SensorMap

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
        path: the file.
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
    found = {name[: -len(SUFFIX)]: numbers[name] for name in names if np.isfinite(numbers[name]).any()}
    angles = {f"angle_{name[: -len(ANGLE)]}": numbers[name] for name in angular if np.isfinite(numbers[name]).any()}
    if not (found or angles):
        raise InputError("no displacement was read", expected="numbers in a column <name>_um or <name>_urad", file=file)
    measured = {sensor_of(name): numbers[name] for name in temperatures}
    directions = sensors or SensorMap.of_comments(comments)
    directions.check([name[: -len(SUFFIX)] for name in names], list(measured))
    displacement, units, remarks = directions.applied(found)
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
