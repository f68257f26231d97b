"""The mapping from a table's columns to those of a measurement table: a commented YAML file (``schema: twin.columns/1``)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin._common.csv_tables import read_table
from twin._common.errors import InputError, closest_name
from twin._common.units import count_with_noun
from twin._common.yaml_files import EntryPath, line_of, load_yaml, quoted, yaml_text
from twin.machine.machine import Machine
from twin.measurement.columns import ANGLE_COLUMNS, POINT_COLUMNS, table_columns
from twin.measurement.importing.cells import DELIMITERS, Layout, listed
from twin.measurement.importing.headers import is_table_column, meaning_of, table_names
from twin.measurement.importing.quantities import SIGNS, UNITS, unit_named, units_of
from twin.measurement.importing.readings import ANGLE, LENGTH, DeviationEntry, SphericalEntry
from twin.measurement.table import Measurements

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
        needed = {"target", "carrier", *(f"{axis.name}_{axis.unit}" for axis in machine.axes)}
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
            axes = [f"{axis.name}_{axis.unit}" for axis in machine.axes if axis.linear]
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
            f"{name}: {listed(words)}" for name, words in (("names", own.names), ("missing", own.missing)) if words
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


# --- Rows of a plan for the rows of a file: matched by the names of points, or by their order -----

SLACK: Final = 0.002
"""Difference of a position from that of the plan up to which they are the same; mm or degrees."""
FIELDS: Final = ("positions", "target", "carrier", "station", "station_carrier", "instrument", "round", "approach")
"""Fields of a measurement table that a plan gives."""


@final
@dataclass(frozen=True)
class PlanPoints:
    """A plan with the names of its points.

    Attributes:
        table: its rows.
        points: (n) name of each point; empty if the plan has no such column.
    """

    table: Measurements
    points: tuple[str, ...]

    @classmethod
    def load(cls, path: Path, machine: Machine) -> PlanPoints:
        """Read a plan.

        Raises:
            InputError: it is not a plan, or some of its rows cannot be used.
        """
        table = Measurements.load(path, machine, plan=True)
        if table.set_aside:
            first = table.set_aside[0]
            raise InputError(
                f"a row of the plan cannot be used: {first.text}", expected="a usable row", file=path, line=first.line
            )
        header, rows, _ = read_table(path)
        place = next((i for i, name in enumerate(header) if meaning_of(name, machine).kind == "point"), None)
        return cls(table, () if place is None else tuple(cells[place] for _, cells in rows))

    def matches(self, names: list[str]) -> bool:
        """Return whether every name is a point of the plan, and these are unique."""
        return bool(self.points) and len(set(self.points)) == len(self.points) and {*names} <= {*self.points}

    def rows_for(
        self, layout: Layout, entry: PlanEntry, cells: Mapping[str, Sequence[str]], machine: Machine
    ) -> np.ndarray:
        """Return (n,) the row of the plan for each row of a file.

        ``cells``: the columns of the measurement table that the file gives.

        Raises:
            InputError: the number of rows differs, or a row has a name that the plan does not have at its place.
        """
        if entry.match == "order":
            return self._by_order(layout)
        if entry.match == "positions":
            return self._by_positions(layout, cells, machine)
        names = layout.column(entry.point) if entry.point in layout.names else []
        if not names or not self.points:
            whose = layout.raw.path if not names else self.table.source
            raise InputError("no names of points", expected="a column with the name of each point", file=whose)
        twice = next((name for name, count in Counter(self.points).items() if count > 1), None)
        if twice is not None:
            raise InputError(
                "two points of one name", expected="a name for each point", file=self.table.source, value=twice
            )
        known = {name: row for row, name in enumerate(self.points)}
        for (line, _), name in zip(layout.rows, names, strict=True):
            if name not in known:
                raise InputError(
                    "a point that the plan does not have",
                    expected=f"a point of {self.table.source}",
                    file=layout.raw.path,
                    line=line,
                    value=name,
                    nearest=closest_name(name, known),
                )
        return np.array([known[name] for name in names], dtype=int)

    def _by_order(self, layout: Layout) -> np.ndarray:
        count, wanted = len(layout.rows), len(self.table)
        if count != wanted:
            line = layout.rows[min(count, wanted + 1) - 1][0]
            last = "the file ends with this row" if count < wanted else "this row has no row in the plan"
            raise InputError(
                f"{count_with_noun(count, 'measured point')}, and {self.table.source} has {wanted:,}: {last}",
                expected="one row for each row of the plan, in its order, or names of points in both",
                file=layout.raw.path,
                line=line,
            )
        return np.arange(wanted)

    def _by_positions(self, layout: Layout, cells: Mapping[str, Sequence[str]], machine: Machine) -> np.ndarray:
        """Return the rows with the positions and targets of the file: in the order of the plan, some of which may be missing.

        A file in another order is matched where no position occurs twice.
        """
        count, wanted = len(layout.rows), len(self.table)
        given = [
            (i, cells[f"{axis.name}_{axis.unit}"])
            for i, axis in enumerate(machine.axes)
            if f"{axis.name}_{axis.unit}" in cells
        ]

        def fits(row: int, start: int) -> np.ndarray:
            fitting = np.ones(wanted - start, dtype=bool)
            if "target" in cells:
                fitting &= self.table.target[start:] == cells["target"][row]
            for i, own in given:
                if own[row]:  # a row without a number fits, and is set aside
                    fitting &= np.abs(self.table.positions[start:, i] - float(own[row])) <= slack_of(own[row])
            return np.flatnonzero(fitting) + start

        rows: list[int] = []
        for row in range(count):
            later = fits(row, rows[-1] + 1 if rows else 0)
            if not len(later):
                break
            rows.append(int(later[0]))
        if len(rows) == count:
            return np.array(rows)
        every = [fits(row, 0) for row in range(count)]
        if all(len(found) == 1 for found in every) and len({int(found[0]) for found in every}) == count:
            return np.concatenate(every)
        if count == wanted:
            return np.arange(wanted)  # the first row that differs is named
        line, own_cells = layout.rows[len(rows)]
        raise InputError(
            "a position or target that is not one of the next rows of the plan",
            expected=f"the positions and targets of {self.table.source}, in its order",
            file=layout.raw.path,
            line=line,
            value=" | ".join(own_cells),
        )

    def columns(self, rows: np.ndarray, machine: Machine) -> dict[str, list[str]]:
        """Return the cells of the columns that the plan gives, for some of its rows."""
        columns: dict[str, list[str]] = {}
        for part in table_columns(machine):
            if part.field in FIELDS:
                cells = part.written(getattr(self.table, part.field))
                columns |= {name: [values[row] for row in rows] for name, values in cells.items()}
        return columns

    @staticmethod
    def check_commands(
        own: Mapping[str, Sequence[str]],
        given: Mapping[str, Sequence[str]],
        layout: Layout,
        machine: Machine,
        rounded: Collection[str] = (),
    ) -> None:
        """Raise `InputError` for the first row whose commanded position or target differs from the plan's.

        ``rounded``: columns whose positions are rounded to the digits written, as in names.
        """
        compared = given.keys() & {"target", *(f"{axis.name}_{axis.unit}" for axis in machine.axes)}
        for row, (line, _) in enumerate(layout.rows):
            for name in (name for name in own if name in compared):
                mine, planned = own[name][row], given[name][row]
                if mine and mine != planned and (name == "target" or _differ(mine, planned, name in rounded)):
                    raise InputError(
                        f"{name} is not that of the plan",
                        expected=f"{planned}, as in the plan",
                        file=layout.raw.path,
                        line=line,
                        value=mine,
                    )


def slack_of(cell: str) -> float:
    """Return the largest difference of a position from that of the plan if it is rounded to its last digit; mm or degrees."""
    return SLACK + 0.5 * 10.0 ** -len(cell.partition(".")[2])


def _differ(own: str, planned: str, rounded: bool) -> bool:
    """Return whether two cells are numbers that differ by more than a rounded digit."""
    try:
        return abs(float(own) - float(planned)) > (slack_of(own) if rounded else SLACK)
    except ValueError:
        return False
