"""The mapping from a table's columns to those of a measurement table: a commented YAML file (``schema: twin.columns/1``)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal, final

from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError, closest_name
from twin._common.yaml_files import EntryPath, line_of, load_yaml, quoted, yaml_text
from twin.machine.machine import Machine
from twin.measurement.importing.cells import DELIMITERS, SIGNS
from twin.measurement.importing.headers import UNITS, is_table_column, table_names, unit_named, units_of

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
    words: dict[str, str | int] | None = None
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
    match: Literal["order", "point"]
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
    columns: Annotated[dict[str, OriginEntry], Field(min_length=1)]
    plan: PlanEntry | None = None

    @property
    def sign(self) -> str:
        """The decimal sign."""
        return next(sign for sign, name in SIGNS.items() if name == self.decimal)


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
        found = cls(entries, path, MappingProxyType(dict(lines)))
        for name, entry in entries.columns.items():
            found.check_entry(name, entry, machine)
        return found

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
            "# Each entry: a column of the measurement table, and the column of the file that gives it (from), its unit, and",
            "# sign: -1 to mirror it; or one value for all rows. Further keys: offset (in the table's unit), words, format.",
            f"# Units: {', '.join(unit.name for unit in UNITS)}.",
            "columns:",
        ]
        lines += [
            f"  {_quoted_name(name)}: {{{_entry(entry)}}}{_remark(remarks, name, '    # ')}"
            for name, entry in own.columns.items()
        ]
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


def _entry(entry: OriginEntry) -> str:
    """Return an entry in YAML's flow style, without the keys that have their default value."""
    data = entry.model_dump(by_alias=True, exclude_defaults=True)
    if "unit" in data:  # the keys that a user is most likely to change are always written
        data.setdefault("sign", 1)
    parts = []
    for key, value in data.items():
        if isinstance(value, dict):
            text = "{" + ", ".join(f"{_quoted(word)}: {_quoted(one)}" for word, one in value.items()) + "}"
        elif isinstance(value, tuple):
            text = "[" + ", ".join(map(_quoted, value)) + "]"
        else:
            text = value if key == "unit" else _quoted(value)
        parts.append(f"{key}: {text}")
    return ", ".join(parts)
