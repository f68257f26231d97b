"""Readings that a file does not give as coordinates: horizontal angle, vertical angle and distance, or deviations from nominal points.

Deviations are measured less nominal, in the directions of the machine. The nominal point of a reflector is that of the nominal machine
at the commanded position, for the place of the reflector on its carrier: without that place, deviations say nothing of angular errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict

from twin._common.units import MM
from twin.machine.machine import Machine
from twin.measurement.columns import PLACE_COLUMNS, POINT_COLUMNS
from twin.measurement.observation import nominal_carriers
from twin.measurement.table import Measurements

DECIMALS: Final = 7
"""Decimals of a computed coordinate in mm: below the resolution of any instrument."""
ANGLE: Final = "angle_deg"
LENGTH: Final = "distance_mm"
"""Names that carry the units into which angles and distances are converted."""
Numbers = Callable[[str, str, str | None], list[str]]
"""Function that returns the numbers of a column of the file, from its name, a name that carries the unit, and the unit in the file."""


@final
class SphericalEntry(BaseModel):
    """Columns of angles and distances, and their conventions.

    Attributes:
        clockwise: whether the horizontal angle grows clockwise seen from above, as on geodetic instruments.
        vertical_from: ``zenith`` if the vertical angle is 90° in the horizontal plane, ``horizon`` if it is 0° there.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    horizontal: str
    vertical: str
    distance: str
    angle: str | None = None
    length: str | None = None
    clockwise: bool = False
    vertical_from: Literal["zenith", "horizon"] = "zenith"

    @property
    def sources(self) -> tuple[str, ...]:
        """Columns of the file."""
        return self.horizontal, self.vertical, self.distance

    def points(self, numbers: Numbers) -> dict[str, list[str]]:
        """Return the cells of x_mm, y_mm, z_mm in the instrument's frame: z up, x at horizontal angle zero."""
        cells = [numbers(name, ANGLE, self.angle) for name in self.sources[:2]]
        cells.append(numbers(self.distance, LENGTH, self.length))
        hz, v, distance = (np.array([float(cell or "nan") for cell in column]) for column in cells)
        hz, v = np.radians(-hz if self.clockwise else hz), np.radians(v)
        zenith = v if self.vertical_from == "zenith" else np.pi / 2.0 - v
        flat = distance * np.sin(zenith)
        return _point_cells(np.stack([flat * np.cos(hz), flat * np.sin(hz), distance * np.cos(zenith)], axis=1))


@final
class DeviationEntry(BaseModel):
    """Columns of deviations, measured less nominal.

    Attributes:
        along: column of the axis that an interferometer follows, such as ``X_mm``: ``x`` is then the deviation of its length.
        nominal: columns of the nominal coordinates, mm; empty for those of the nominal machine at the commanded position.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    x: str | None = None
    y: str | None = None
    z: str | None = None
    unit: str | None = None
    along: str | None = None
    nominal: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """Columns of the file."""
        return tuple(name for name in (self.x, self.y, self.z, *self.nominal) if name is not None)

    def points(self, numbers: Numbers, cells: Mapping[str, Sequence[str]], machine: Machine) -> dict[str, list[str]]:
        """Return the cells of x_mm, y_mm, z_mm: nominal point plus deviation, empty where a deviation is not given."""
        by = [
            [""] * len(next(iter(cells.values()))) if name is None else numbers(name, LENGTH, self.unit)
            for name in (self.x, self.y, self.z)
        ]
        deviation = np.array([[float(cell or "nan") for cell in column] for column in by]).T
        return _point_cells(self._nominal_mm(numbers, cells, machine) + deviation)

    def _nominal_mm(self, numbers: Numbers, cells: Mapping[str, Sequence[str]], machine: Machine) -> np.ndarray:
        if self.along is not None:
            return np.tile(_floats(cells, [self.along]), (1, 3))
        if self.nominal:
            given = [numbers(name, LENGTH, None) for name in self.nominal]
            return np.array([[float(cell or "nan") for cell in column] for column in given]).T
        data = unchecked(cells, machine)
        usable = np.isfinite(data.positions).all(axis=1)
        nominal = np.full((len(data), 3), np.nan)
        carried = nominal_carriers(machine, data.select(usable))
        place = _floats(cells, PLACE_COLUMNS)[usable] * MM
        nominal[usable] = carried.at(place) / MM
        return nominal


def _floats(cells: Mapping[str, Sequence[str]], names: Sequence[str]) -> np.ndarray:
    """Return (n, names) numbers of columns, NaN where a cell holds none."""
    empty = [""] * len(next(iter(cells.values())))
    return np.array([[_number(cell) for cell in cells.get(name, empty)] for name in names], dtype=float).T


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return np.nan
    return value if abs(value) < 1e9 else np.nan


def _point_cells(point_mm: np.ndarray) -> dict[str, list[str]]:
    texts = [["" if np.isnan(value) else f"{value + 0.0:.{DECIMALS}f}" for value in column] for column in point_mm.T]
    return dict(zip(POINT_COLUMNS, texts, strict=True))


def unchecked(cells: Mapping[str, Sequence[str]], machine: Machine) -> Measurements:
    """Return commands and readings of a table before it is checked, NaN where a cell holds no number."""
    count = len(next(iter(cells.values())))

    def words(name: str, default: str) -> np.ndarray:
        return np.array([cell or default for cell in cells.get(name, [""] * count)], dtype=object)

    return Measurements(
        source="",
        lines=np.arange(count),
        positions=_floats(cells, [f"{axis.name}_{axis.unit}" for axis in machine.axes]),
        point_mm=_floats(cells, POINT_COLUMNS),
        carrier=words("carrier", ""),
        station_carrier=words("station_carrier", "base"),
        station=words("station", "1"),
        target=words("target", ""),
    )
