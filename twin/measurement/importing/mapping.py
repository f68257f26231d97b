"""The mapping from a table's columns to those of a measurement table: a commented YAML file (``schema: twin.columns/1``).

A file may give readings not as coordinates but as horizontal angle, vertical angle and distance, or as deviations: measured less
nominal, in the directions of the machine. The nominal point of a reflector is that of the nominal machine at the commanded position,
for the place of the reflector on its carrier: without that place, deviations say nothing of angular errors.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError, closest_name
from twin._common.units import MM
from twin._common.yaml_files import EntryPath, line_of, load_yaml, quoted, yaml_text
from twin.machine.machine import Machine
from twin.measurement.columns import ANGLE_COLUMNS, PLACE_COLUMNS, POINT_COLUMNS, axis_columns
from twin.measurement.importing.cells import DELIMITERS, yaml_list
from twin.measurement.importing.quantities import SIGNS, UNITS, is_table_column, table_names, unit_named, units_of
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

    ``clockwise``: whether the horizontal angle grows clockwise seen from above, as on geodetic instruments; ``vertical_from``:
    ``zenith`` if the vertical angle is 90° in the horizontal plane, ``horizon`` if it is 0° there.
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

    ``along``: column of the axis that an interferometer follows, such as ``X_mm``: ``x`` is then the deviation of its length;
    ``nominal``: columns of the nominal coordinates, mm; empty for those of the nominal machine at the commanded position.
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
        positions=_floats(cells, [*axis_columns(machine)]),
        point_mm=_floats(cells, POINT_COLUMNS),
        carrier=words("carrier", ""),
        station_carrier=words("station_carrier", "base"),
        station=words("station", "1"),
        target=words("target", ""),
    )


# --- The mapping file ----------------------------------------------------------------------------

SCHEMA: Final = "twin.columns/1"
_Number = Annotated[float, Field(ge=-1e9, le=1e9)]


@final
class OriginEntry(BaseModel):
    """Origin of one column of the measurement table: columns of the file, or one value for all rows."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    source: str | tuple[str, ...] | None = Field(None, alias="from")
    value: str | _Number | None = None
    unit: str | None = None
    sign: Literal[1, -1] = 1
    offset: _Number = 0.0
    words: dict[str, str | int | float] | None = None
    format: str | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """Columns of the file."""
        return () if self.source is None else (self.source,) if isinstance(self.source, str) else self.source


def entry_of(
    source: str | tuple[str, ...] | None = None,
    *,
    value: str | float | None = None,
    unit: str | None = None,
    form: str | None = None,
) -> OriginEntry:
    """Return an entry from its parts."""
    return OriginEntry.model_validate({"from": source, "value": value, "unit": unit, "format": form})


@final
class PlanEntry(BaseModel):
    """Rule that matches the rows of a file with those of a plan."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    match: Literal["order", "point", "positions"]
    point: str | None = None


@final
class ColumnsFile(BaseModel):
    """A mapping file."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal["twin.columns/1"] = Field(SCHEMA, alias="schema")
    file: str = ""
    encoding: str = ""
    delimiter: Literal["", "tab", "semicolon", "bar", "comma", "space"] = ""
    decimal: Literal["point", "comma"] = "point"
    sheet: str = ""
    names: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    length: str = ""
    angle: str = ""
    columns: dict[str, OriginEntry] = Field(default_factory=dict)
    spherical: SphericalEntry | None = None
    deviations: DeviationEntry | None = None
    plan: PlanEntry | None = None

    @property
    def sign(self) -> str:
        """The decimal sign."""
        return next(sign for sign, name in SIGNS.items() if name == self.decimal)

    @property
    def gives_readings(self) -> bool:
        """Whether the mapping gives a measured quantity."""
        return any(name in self.columns for name in (*POINT_COLUMNS, *ANGLE_COLUMNS)) or bool(
            self.spherical or self.deviations
        )

    def is_complete(self, machine: Machine) -> bool:
        """Return whether the mapping gives all that a measurement table needs, and is applied exactly; others are completed."""
        needed = {"target", "carrier", *axis_columns(machine)}
        return self.gives_readings and (self.plan is not None or needed <= {*self.columns})


@final
@dataclass(frozen=True)
class ColumnMapping:
    """A mapping, with the file that it was read from.

    Attributes:
        entries: its content.
        path: its file; None for a proposed mapping.
        lines: line of every entry of the file by its path in it.
    """

    entries: ColumnsFile
    path: Path | None = None
    lines: Mapping[EntryPath, int] = field(default_factory=lambda: MappingProxyType({}))

    def error(
        self, what: str, place: Sequence[str | int], *, expected: str, value: object, known: Sequence[str] = ()
    ) -> InputError:
        """Return an `InputError` about one entry, with the line of the mapping file."""
        line = line_of(tuple(place), self.lines) if self.path is not None else None
        nearest = closest_name(str(value), known) if known else None
        return InputError(what, expected=expected, file=self.path, line=line, value=value, nearest=nearest)

    @classmethod
    def load(cls, path: Path, machine: Machine) -> ColumnMapping:
        """Read a mapping file.

        Raises:
            InputError: with the line: it does not match the schema, names a column that a table of this machine does not have, a unit
                that does not fit a column, or an entry without an origin.
        """
        entries, lines = load_yaml(path, ColumnsFile, SCHEMA)
        mapping = cls(entries, path, MappingProxyType(dict(lines)))
        for name, entry in entries.columns.items():
            mapping.check_entry(name, entry, machine)
        mapping._check_units(machine)
        return mapping

    def _check_units(self, machine: Machine) -> None:
        """Raise `InputError` for a unit or an axis outside the columns that does not exist."""
        own, spherical, deviations = self.entries, self.entries.spherical, self.entries.deviations
        stated: list[tuple[tuple[str, ...], str | None, str]] = [
            (("length",), own.length, LENGTH),
            (("angle",), own.angle, ANGLE),
        ]
        if spherical is not None:
            stated += [
                (("spherical", "angle"), spherical.angle, ANGLE),
                (("spherical", "length"), spherical.length, LENGTH),
            ]
        if deviations is not None:
            stated.append((("deviations", "unit"), deviations.unit, LENGTH))
            axes = [name for name, axis in axis_columns(machine).items() if axis.linear]
            if deviations.along is not None and deviations.along not in axes:
                expected = f"one of {', '.join(axes)}"
                raise self.error(
                    "no such axis", ("deviations", "along"), expected=expected, value=deviations.along, known=axes
                )
        for place, text, column in stated:
            known = [unit.name for unit in units_of(column)]
            if text and unit_named(text, column) is None:
                raise self.error("no such unit", place, expected=f"one of {', '.join(known)}", value=text, known=known)

    def check_copy(self, path: Path) -> None:
        """Raise `InputError` unless a file written from this mapping reads back as the same entries."""
        entries, _ = load_yaml(path, ColumnsFile, SCHEMA)
        if entries != self.entries:
            raise InputError("the file reads back as another mapping", expected="the same entries", file=path)

    def check_entry(self, name: str, entry: OriginEntry, machine: Machine) -> None:
        """Raise `InputError` unless an entry names a column of a measurement table and has one origin and a unit that fits."""
        place = ("columns", name)
        known = machine_columns(machine)
        if not is_table_column(name, machine):
            raise self.error(
                "no such column of a measurement table",
                place,
                expected=f"one of {', '.join(known)}, T_<sensor>_degC or <name>_<unit>",
                value=name,
                known=known,
            )
        if (entry.source is None) == (entry.value is None) or entry.source == ():
            raise self.error(
                "no single origin of this column",
                place,
                expected="either `from`, a column of the file, or `value`, the same for all rows",
                value=name,
            )
        units = [unit.name for unit in units_of(name)]
        unit = unit_named(entry.unit or "")
        if entry.unit is not None and (unit is None or unit.name not in units):
            raise self.error(
                "the unit does not fit this column",
                (*place, "unit"),
                expected=f"one of {', '.join(units)}" if units else "no unit",
                value=entry.unit,
                known=units,
            )

    def to_yaml(self, remarks: Mapping[str, str], head: Sequence[str]) -> str:
        """Return the mapping as a commented file.

        Args:
            remarks: comment behind an entry, by its column.
            head: comment lines at the beginning.
        """
        own = self.entries
        lines = [f"# {text}" for text in head]
        lines += [f"schema: {SCHEMA}", f"file: {_quoted(own.file)}"]
        if own.sheet:
            lines.append(f"sheet: {_quoted(own.sheet)}")
        if own.encoding:
            lines.append(f"encoding: {own.encoding}")
            lines.append(f"delimiter: {own.delimiter}    # {', '.join(DELIMITERS.values())}")
        lines.append(f"decimal: {own.decimal}    # {' or '.join(SIGNS.values())}{_remark(remarks, 'decimal', '; ')}")
        lines += [
            f"{name}: {yaml_list(words)}" for name, words in (("names", own.names), ("missing", own.missing)) if words
        ]
        lines += [f"{name}: {unit}" for name, unit in (("length", own.length), ("angle", own.angle)) if unit]
        lines += [
            "# Each entry: a column of the measurement table, and the column of the file that gives it (from), its unit, and",
            "# sign: -1 to mirror it; or one value for all rows. Further keys: offset (in the table's unit), words, format.",
            f"# Units: {', '.join(unit.name for unit in UNITS)}.",
            "columns:",
        ]
        lines += [
            f"  {_quoted_name(name)}: {{{_entry(entry)}}}{_remark(remarks, name, '    # ')}"
            for name, entry in own.columns.items()
        ]
        for name, computed in (("spherical", own.spherical), ("deviations", own.deviations)):
            if computed is not None:
                lines.append(f"{name}: {{{_entry(computed)}}}{_remark(remarks, name, '    # ')}")
        if own.plan is not None:
            point = f", point: {_quoted(own.plan.point)}" if own.plan.point else ""
            lines.append(f"plan: {{match: {own.plan.match}{point}}}{_remark(remarks, 'plan', '    # ')}")
        return "\n".join(lines) + "\n"


def machine_columns(machine: Machine) -> tuple[str, ...]:
    """Return the columns of a measurement table that messages list: without read-back values and places."""
    return tuple(name for name in table_names(machine) if not name.startswith(("readback_", "place_", "station_")))


def _remark(remarks: Mapping[str, str], name: str, before: str) -> str:
    return f"{before}{remarks[name]}" if name in remarks else ""


def _quoted(value: object) -> str:
    return quoted(value) if isinstance(value, str) else json.dumps(value)


def _quoted_name(name: str) -> str:
    return name if yaml_text({name: 0}) == f"{{{name}: 0}}\n" else quoted(name)


def column_line(entries: Mapping[str, OriginEntry]) -> str:
    """Return the line of a mapping file with some entries of columns."""
    columns = ", ".join(f"{_quoted_name(name)}: {{{_entry(entry)}}}" for name, entry in entries.items())
    return f"columns: {{{columns}}}"


def _entry(entry: OriginEntry | SphericalEntry | DeviationEntry) -> str:
    """Return an entry in YAML's flow style, without the keys that have their default value."""
    data = entry.model_dump(by_alias=True, exclude_defaults=True)
    if isinstance(entry, SphericalEntry):  # conventions are always written
        data |= {"clockwise": entry.clockwise, "vertical_from": entry.vertical_from}
    elif "unit" in data and isinstance(
        entry, OriginEntry
    ):  # the keys that a user is most likely to change are always written
        data.setdefault("sign", 1)
    parts = []
    for key, value in data.items():
        if isinstance(value, dict):
            text = "{" + ", ".join(f"{_quoted(word)}: {_quoted(one)}" for word, one in value.items()) + "}"
        elif isinstance(value, tuple):
            text = "[" + ", ".join(map(_quoted, value)) + "]"
        else:
            text = value if key in ("unit", "angle", "length", "along", "vertical_from") else _quoted(value)
        parts.append(f"{key}: {text}")
    return ", ".join(parts)
