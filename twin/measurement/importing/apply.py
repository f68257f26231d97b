"""Application of a mapping: the cells of a measurement table from those of the file, exactly as the mapping says, and of a plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import read_table
from twin._common.errors import InputError, closest_name
from twin._common.records import TIME
from twin._common.units import count_with_noun
from twin._common.yaml_files import quoted
from twin.machine.machine import Machine
from twin.measurement.columns import CARRIERS, POINT_COLUMNS, axis_columns, table_columns
from twin.measurement.importing.cells import Layout, yaml_list
from twin.measurement.importing.mapping import ColumnMapping, OriginEntry, PlanEntry, column_line
from twin.measurement.importing.quantities import (
    CARRIER_WORDS,
    COMMA,
    POINT,
    SIGNS,
    decimal_text,
    direction_of,
    is_no_value,
    meaning_of,
    plain_words,
    quantity_in,
)
from twin.measurement.table import Measurements

# --- Rows of a plan for the rows of a file: matched by the names of points, or by their order -----

SLACK: Final = 0.002
"""Difference of a position from that of the plan up to which they are the same; mm or degrees."""
FIELDS: Final = ("positions", "target", "carrier", "station", "station_carrier", "instrument", "round", "approach")
"""Fields of a measurement table that a plan gives."""


@final
@dataclass(frozen=True)
class PlanPoints:
    """A plan with the names of its points. ``points``: (n) name of each point; empty if the plan has no such column."""

    table: Measurements
    points: tuple[str, ...]

    @classmethod
    def load(cls, path: Path, machine: Machine) -> PlanPoints:
        """Read a plan. Raises `InputError`: it is not a plan, or some of its rows cannot be used."""
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
        own = {*self._points_of(names)}
        return bool(self.points) and len(set(self.points)) == len(self.points) and own <= {*self.points}

    def _points_of(self, names: list[str]) -> list[str]:
        """Return names without collection and group (``A::Round 1::P1``), unless the plan has them so."""
        return names if {*names} <= {*self.points} else [name.rpartition("::")[2] for name in names]

    def rows_for(
        self, layout: Layout, entry: PlanEntry, cells: Mapping[str, Sequence[str]], machine: Machine
    ) -> np.ndarray:
        """Return (n,) the row of the plan for each row of a file.

        ``cells``: the columns of the measurement table that the file gives.

        Raises `InputError`: the number of rows differs, or a row has a name that the plan does not have at its place.
        """
        if entry.match == "order":
            return self._by_order(layout)
        if entry.match == "positions":
            return self._by_positions(layout, cells, machine)
        names = self._points_of(layout.column(entry.point) if entry.point in layout.names else [])
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
        given = [(i, cells[name]) for i, name in enumerate(axis_columns(machine)) if name in cells]

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
        compared = given.keys() & {"target", *axis_columns(machine)}
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


# --- Cells of a measurement table ------------------------------------------------------------

WORD_COLUMNS: Final = ("target", "carrier", "station", "station_carrier", "instrument", "round")
MOST_EMPTY: Final = 0.2
"""Share of empty cells of a coordinate up to which they are failures, not coordinates that were not to be measured."""


@final
@dataclass(frozen=True)
class Applied:
    """Application of a mapping to a file. ``machine``: the machine that was measured."""

    layout: Layout
    mapping: ColumnMapping
    machine: Machine

    def table(self, plan: PlanPoints | None) -> dict[str, list[str]]:
        """Return the cells of the measurement table by its columns, with those of the plan and the readings that are computed.

        Raises `InputError`: as `columns`; the rows are not those of the plan.
        """
        entries, cells = self.mapping.entries, self.columns()
        if plan is not None and entries.plan is not None:
            given = plan.columns(plan.rows_for(self.layout, entries.plan, cells, self.machine), self.machine)
            rounded = {name for name, one in entries.columns.items() if {*one.sources} & {*self.layout.derived}}
            PlanPoints.check_commands(cells, given, self.layout, self.machine, rounded)
            cells = given | {name: column for name, column in cells.items() if name not in rounded or name not in given}
        for name, computed in (("spherical", entries.spherical), ("deviations", entries.deviations)):
            if computed is not None:
                self._check_sources((name,), computed.sources)
        if entries.spherical is not None:
            cells |= entries.spherical.points(self._quantities)
        if entries.deviations is not None:
            cells |= entries.deviations.points(self._quantities, cells, self.machine)
        return cells

    def columns(self) -> dict[str, list[str]]:
        """Return the cells of the columns that the mapping names, by their names in the measurement table.

        Raises `InputError`: a column of the mapping is not in the file; a cell that is not a number, direction, side or date.
        """
        return {name: self.column(name, entry) for name, entry in self.mapping.entries.columns.items()}

    def set_aside(self) -> dict[int, str]:
        """Return the rows without a commanded position or a reading that the others have, each with the reason.

        A column of a measurement table may have empty coordinates: they were not measured.
        """
        reasons: dict[int, str] = {}
        for source, name in self._needed():
            cells = self.layout.column(source)
            empty = [is_no_value(cell, self.mapping.entries.missing) for cell in cells]
            partial = name in POINT_COLUMNS and (source == name or sum(empty) > MOST_EMPTY * len(cells))
            for row, cell in enumerate(cells):
                if empty[row] and (cell or not partial):
                    reasons.setdefault(row, f"'{source}' is {quoted(cell)}" if cell else f"'{source}' is empty")
        return reasons

    def _needed(self) -> list[tuple[str, str]]:
        """Return the columns of the file that give commanded positions and readings, each with what it gives."""
        entries = self.mapping.entries
        names = [*axis_columns(self.machine), *POINT_COLUMNS]
        needed = [
            (source, name) for name in names if name in entries.columns for source in entries.columns[name].sources
        ]
        computed = [one.sources for one in (entries.spherical, entries.deviations) if one is not None]
        return needed + [(source, POINT_COLUMNS[0]) for sources in computed for source in sources]

    def column(self, name: str, entry: OriginEntry) -> list[str]:
        """Return the cells of one column. Raises `InputError`: as `columns`."""
        if entry.source is None:
            value = "" if entry.value is None else entry.value
            if isinstance(value, str) and value and name not in WORD_COLUMNS:
                if self.mapping.path is not None:
                    raise self._not_entered(name, value, ("columns", name, "value"))
                value = ""
            return [f"{value:g}" if isinstance(value, float) else str(value)] * len(self.layout.rows)
        self._check_sources(("columns", name, "from"), entry.sources)
        if name in WORD_COLUMNS:
            return self._words(name, entry)
        if name.startswith("approach_"):
            return self._directions(name, entry)
        if name == TIME and entry.format is not None:
            return self._seconds(entry)
        return self._numbers(name, entry)

    def _check_sources(self, place: Sequence[str], sources: Sequence[str]) -> None:
        for source in sources:
            if source not in self.layout.names:
                names = self.layout.names
                raise self.mapping.error(
                    f"{self.layout.raw.path} has no such column",
                    place,
                    expected=f"one of {', '.join(names)}",
                    value=source,
                    known=names,
                )

    def _error(self, what: str, row: int, value: str, expected: str, cure: str | None = None) -> InputError:
        line = self.layout.rows[row][0]
        return InputError(what, expected=expected, file=self.layout.raw.path, line=line, value=value, cure=cure)

    def _words(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): str(meaning) for word, meaning in (entry.words or {}).items()}
        cells = self.layout.column(entry.sources[0])
        if name in ("carrier", "station_carrier"):
            words = {**CARRIER_WORDS, "base": "base", **words}
            for row, cell in enumerate(cells):
                if plain_words(cell) not in words:
                    expected = f"{' or '.join(CARRIERS)}, or an entry of `words` in the mapping"
                    unknown = {one: "tool" for one in dict.fromkeys(cells) if plain_words(one) not in words}
                    line = column_line({name: entry.model_copy(update={"words": {**(entry.words or {}), **unknown}})})
                    raise self._error(f"{name} is not a side of the machine", row, cell, expected, line)
        return [words.get(plain_words(cell), cell) for cell in cells]

    def _directions(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): meaning for word, meaning in (entry.words or {}).items()}
        directions = []
        for row, cell in enumerate(self.layout.column(entry.sources[0])):
            value = words.get(plain_words(cell), direction_of(cell))
            if value is None or str(value) not in ("-1", "0", "1"):
                expected = "+, -, up, down, vorwärts, rückwärts, +1, -1 or 0, or an entry of `words` in the mapping"
                line = column_line({name: entry.model_copy(update={"words": {**(entry.words or {}), cell: 0}})})
                raise self._error(f"{name} is not a direction", row, cell, expected, line)
            directions.append(str(int(value) * entry.sign))
        return directions

    def _numbers(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): str(meaning) for word, meaning in (entry.words or {}).items()}
        if words:
            return self._numbers_of_words(name, entry, words)
        offset = Decimal(repr(entry.offset))
        numbers = self._quantities(entry.sources[0], name, entry.unit, entry)
        if entry.sign > 0 and not offset:
            return numbers
        return [decimal_text(Decimal(cell) * entry.sign + offset) if cell else "" for cell in numbers]

    def _numbers_of_words(self, name: str, entry: OriginEntry, words: dict[str, str]) -> list[str]:
        """Return numbers that the mapping gives for the words of a column: the places of reflectors by their names."""
        numbers = []
        for cell in self.layout.column(entry.sources[0]):
            word = words.get(plain_words(cell), "")
            number = quantity_in(word, POINT)
            if number is None and self.mapping.path is not None:
                raise self._not_entered(f"{name} of '{cell}'", word, ("columns", name, "words"))
            numbers.append("" if number is None else decimal_text(number.value))
        return numbers

    def _not_entered(self, what: str, value: str, place: Sequence[str]) -> InputError:
        """Return the error of a number that a person must enter; no line cures it, because no file knows the number."""
        return self.mapping.error(f"{what} is not known", place, expected="a number in its place", value=value)

    def _quantities(self, source: str, name: str, unit: str | None, entry: OriginEntry | None = None) -> list[str]:
        """Return the numbers of a column of the file, in the unit that the end of a name states; empty where a cell has no value."""
        sign, numbers = self.mapping.entries.sign, []
        missing = tuple(plain_words(word) for word in self.mapping.entries.missing)
        derived, is_sheet = source in self.layout.derived, bool(self.layout.raw.sheet)
        for row, cell in enumerate(self.layout.column(source)):
            if is_no_value(cell, missing):
                numbers.append("")
                continue
            quantity = quantity_in(cell, POINT if derived or (is_sheet and COMMA not in cell) else sign)
            if quantity is None:
                expected = f"a number with a decimal {SIGNS[sign]}, or an empty cell"
                line = f"missing: {yaml_list([*self.mapping.entries.missing, cell])}"
                raise self._error(f"{source} ({name}) is not a number", row, cell, expected, line)
            value = quantity.to_table(name, unit)
            if value is None:
                expected = f"a number in {unit}" if unit else "a number in a unit that fits the column"
                own = None if entry is None else column_line({name: entry.model_copy(update={"unit": None})})
                raise self._error(f"{source} ({name}) is in another unit", row, cell, expected, own)
            numbers.append(decimal_text(value))
        return numbers

    def _seconds(self, entry: OriginEntry) -> list[str]:
        """Return times in seconds since the first row that has one."""
        columns = [self.layout.column(source) for source in entry.sources]
        texts = [" ".join(parts) for parts in zip(*columns, strict=True)]
        first: datetime | None = None
        seconds = []
        for row, text in enumerate(texts):
            if not text.strip():
                seconds.append("")
                continue
            moment = moment_in(text, entry.format or "")
            if moment is None:
                raise self._error("not a date and time", row, text, f"the form {entry.format}")
            first = moment if first is None else first
            seconds.append(decimal_text(Decimal((moment - first) // timedelta(microseconds=1)) / 1_000_000))
        return seconds


def moment_in(text: str, form: str) -> datetime | None:
    """Return a date and time, without its time zone; None if the text does not have this form (``iso``, or as `datetime.strptime`)."""
    try:
        moment = datetime.fromisoformat(text) if form == "iso" else datetime.strptime(text, form)
    except ValueError:
        return None
    return moment.replace(tzinfo=None) if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)
