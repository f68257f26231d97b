"""Proposal of a mapping: the columns of a file by their headers, with every assumption in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.importing.cells import (
    COMMA,
    POINT,
    SIGNS,
    Layout,
    decimal_sign,
    decimal_text,
    decimal_value,
    looks_like_number,
)
from twin.measurement.importing.headers import (
    CARRIER_WORDS,
    ROLES,
    Meaning,
    Unit,
    direction_of,
    meaning_of,
    plain_words,
    table_unit,
    unit_named,
    units_of,
)
from twin.measurement.importing.mapping import ColumnMapping, ColumnsFile, OriginEntry, PlanEntry, PlanPoints, entry_of
from twin.measurement.importing.units import unit_by_size


@final
@dataclass
class Proposal:
    """A mapping in the making.

    Attributes:
        layout: the file.
        plan: the plan that gives positions, or None.
        entries: origin of each column of the measurement table.
        assumptions: what was assumed, one sentence each.
        remarks: comment for an entry of the mapping file, by its column.
        notes: facts that need no confirmation.
    """

    layout: Layout
    machine: Machine
    plan: PlanPoints | None = None
    entries: dict[str, OriginEntry] = field(default_factory=dict)
    assumptions: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    sign: str = POINT
    matched: PlanEntry | None = None
    used: set[str] = field(default_factory=set)

    def mapping(self) -> ColumnMapping:
        """Return the mapping."""
        raw = self.layout.raw
        content: dict[str, Any] = {
            "file": raw.path.name,
            "encoding": raw.encoding,
            "delimiter": raw.delimiter,
            "decimal": SIGNS[self.sign],
            "sheet": raw.sheet,
            "columns": self.entries,
            "plan": self.matched,
        }
        return ColumnMapping(ColumnsFile(**content))

    def assume(self, text: str, column: str, remark: str = "check") -> None:
        """Add an assumption, and a remark at the entry that it concerns."""
        self.assumptions.append(text)
        self.remarks[column] = f"{self.remarks[column]}; {remark}" if column in self.remarks else remark

    def add(self, column: str, entry: OriginEntry) -> bool:
        """Add an entry; return False, with a note, if the column has one already."""
        if column in self.entries:
            taken, other = self.entries[column].sources, entry.sources
            text = f"{column} is taken from {quoted(taken)}, not from {quoted(other)}"
            self.assume(text, column, f"or {', '.join(other)}")
            return False
        self.entries[column] = entry
        self.used |= {*entry.sources}
        return True

    def values(self, name: str) -> np.ndarray:
        """Return the numbers of a column of the file, NaN where a cell holds none."""
        numbers = [decimal_value(cell, self.sign) if cell else None for cell in self.layout.column(name)]
        return np.array([np.nan if value is None else float(value) for value in numbers])


def quoted(names: Sequence[str]) -> str:
    """Return names in quotes, separated by commas."""
    return ", ".join(f"'{name}'" for name in names)


def axis_columns(machine: Machine) -> dict[str, Axis]:
    """Return the columns of commanded positions, each with its axis."""
    return {f"{axis.name}_{axis.unit}": axis for axis in machine.axes}


# --- Application of a mapping: the cells of a measurement table from those of the file, exactly as the mapping says

WORD_COLUMNS: Final = ("target", "carrier", "station", "station_carrier", "instrument", "round")
TIME: Final = "time_s"


@final
@dataclass(frozen=True)
class Applied:
    """Application of a mapping to a file.

    Attributes:
        layout: the file.
    """

    layout: Layout
    mapping: ColumnMapping

    def columns(self) -> dict[str, list[str]]:
        """Return the cells of every mapped column of the measurement table, by its name.

        Raises:
            InputError: a column of the mapping is not in the file; a cell that is not a number, direction, side or date.
        """
        return {name: self.column(name, entry) for name, entry in self.mapping.entries.columns.items()}

    def column(self, name: str, entry: OriginEntry) -> list[str]:
        """Return the cells of one column.

        Raises:
            InputError: as `columns`.
        """
        if entry.source is None:
            value = "" if entry.value is None else entry.value
            return [f"{value:g}" if isinstance(value, float) else str(value)] * len(self.layout.rows)
        self._check_sources(name, entry.sources)
        if name in WORD_COLUMNS:
            return self._words(name, entry)
        if name.startswith("approach_"):
            return self._directions(name, entry)
        if name == TIME and entry.format is not None:
            return self._seconds(entry)
        return self._numbers(name, entry)

    def _check_sources(self, name: str, sources: Sequence[str]) -> None:
        for source in sources:
            if source not in self.layout.names:
                names = self.layout.names
                raise self.mapping.error(
                    f"{self.layout.raw.path} has no such column",
                    ("columns", name, "from"),
                    expected=f"one of {', '.join(names)}",
                    value=source,
                    known=names,
                )

    def _error(self, what: str, row: int, value: str, expected: str) -> InputError:
        line = self.layout.rows[row][0]
        return InputError(what, expected=expected, file=self.layout.raw.path, line=line, value=value)

    def _words(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): str(meaning) for word, meaning in (entry.words or {}).items()}
        cells = self.layout.column(entry.sources[0])
        if name in ("carrier", "station_carrier"):
            words = {**CARRIER_WORDS, "base": "base", **words}
            for row, cell in enumerate(cells):
                if plain_words(cell) not in words:
                    expected = f"{' or '.join(CARRIERS)}, or an entry of `words` in the mapping"
                    raise self._error(f"{name} is not a side of the machine", row, cell, expected)
        return [words.get(plain_words(cell), cell) for cell in cells]

    def _directions(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): meaning for word, meaning in (entry.words or {}).items()}
        directions = []
        for row, cell in enumerate(self.layout.column(entry.sources[0])):
            value = words.get(plain_words(cell), direction_of(cell))
            if value is None or str(value) not in ("-1", "0", "1"):
                expected = "+, -, up, down, vorwärts, rückwärts, +1, -1 or 0, or an entry of `words` in the mapping"
                raise self._error(f"{name} is not a direction", row, cell, expected)
            directions.append(str(int(value) * entry.sign))
        return directions

    def _numbers(self, name: str, entry: OriginEntry) -> list[str]:
        unit, sign = self._unit(name, entry), self.mapping.entries.sign
        offset = Decimal(repr(entry.offset))
        numbers = []
        for row, cell in enumerate(self.layout.column(entry.sources[0])):
            if not cell:
                numbers.append("")
                continue
            value = decimal_value(cell, "." if self.layout.raw.sheet and "," not in cell else sign)
            if value is None:
                expected = f"a number with a decimal {SIGNS[sign]}, or an empty cell"
                raise self._error(f"{entry.sources[0]} ({name}) is not a number", row, cell, expected)
            value = value if unit is None else unit.to_table(value)
            numbers.append(decimal_text(value * entry.sign + offset if entry.sign < 0 or offset else value))
        return numbers

    def _unit(self, name: str, entry: OriginEntry) -> Unit | None:
        return unit_named(entry.unit) if entry.unit else next(iter(units_of(name)), None) if table_unit(name) else None

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


# --- Proposal of the columns that are not numbers: names, sides, directions of approach, dates and times

DATE_FORMS: Final = tuple(
    f"{day}{clock}"
    for day in ("%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d", "%d-%m-%Y", "%m-%d-%Y", "")
    for clock in (" %H:%M:%S", " %H:%M:%S.%f", " %H:%M:%S,%f", " %H:%M", " %I:%M:%S %p", " %I:%M %p")
)
"""Forms of dates and times that are tried after ISO 8601; those without a date only where the file has none."""
SERIAL: Final = ("datetime", "date", "time")


def add_names(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add target, carrier, station, round and instrument."""
    for name, meaning in meanings.items():
        if meaning.kind == "exact" and name in WORD_COLUMNS:
            found.add(name, entry_of(name))
        elif meaning.kind in ("target", "station", "round"):
            found.add(meaning.kind, entry_of(name))
        elif meaning.kind == "carrier":
            wrong = [cell for cell in found.layout.column(name) if plain_words(cell) not in CARRIER_WORDS]
            if wrong:
                found.notes.append(f"'{name}' is not used: '{wrong[0]}' is not a side of the machine")
            else:
                found.add("carrier", entry_of(name))
    if found.plan is not None:
        return
    points = [name for name, one in meanings.items() if one.kind == "point"]
    if "target" not in found.entries:
        _add_target(found, points)
    if "carrier" not in found.entries:
        moving = [axis for axis, q in zip(found.machine.axes, commands_of(found).T, strict=True) if np.ptp(q) > 1e-3]
        side = "work" if moving and all(axis.side == "work" for axis in moving) else "tool"
        found.entries["carrier"] = entry_of(value=side)
        found.assume(f"the targets sit on the {side} side of the machine (carrier: {side})", "carrier", "tool or work")


def commands_of(found: Proposal) -> np.ndarray:
    """Return (n, axes) the commanded positions in the file's units; zero for an axis that the file does not give."""
    columns = [found.entries.get(name) for name in axis_columns(found.machine)]
    zero = np.zeros(len(found.layout.rows))
    return np.stack(
        [np.nan_to_num(found.values(column.sources[0])) if column and column.sources else zero for column in columns],
        axis=1,
    )


def _add_target(found: Proposal, points: Sequence[str]) -> None:
    for name in points:
        names = dict.fromkeys(found.layout.column(name))
        if 2 * len(names) <= len(found.layout.rows):
            found.add("target", entry_of(name))
            shown = ", ".join(list(names)[:5]) + (", …" if len(names) > 5 else "")
            found.assume(f"each name of '{name}' is a target: {shown}", "target", f"{len(names)} targets")
            return
    found.entries["target"] = entry_of(value="1")
    found.assume("all rows are of one target, named 1", "target", "name of the target")


def add_directions(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add directions of approach."""
    machine = found.machine
    for name, meaning in meanings.items():
        exact = meaning.kind == "exact" and name.startswith("approach_")
        if meaning.kind != "approach" and not exact:
            continue
        if any(direction_of(cell) is None for cell in found.layout.column(name)):
            wrong = next(cell for cell in found.layout.column(name) if direction_of(cell) is None)
            found.notes.append(f"'{name}' is not used: '{wrong}' is not a direction")
            continue
        axis = machine.by_name.get(meaning.name)
        if exact:
            found.add(name, entry_of(name))
        elif axis is not None:
            found.add(f"approach_{axis.name}", entry_of(name))
        else:
            spans = np.ptp(commands_of(found), axis=0)
            if np.count_nonzero(spans > 1e-3) == 1:
                column = f"approach_{machine.names[int(np.argmax(spans))]}"
                if found.add(column, entry_of(name)):
                    found.assume(f"'{name}' is the direction of {column[9:]}, the only axis that moves", column)


def add_times(found: Proposal, meanings: Mapping[str, Meaning]) -> None:
    """Add the time of each row from columns of dates and times."""
    kinds = {kind: [name for name, one in meanings.items() if one.kind == kind] for kind in SERIAL}
    if "time_s" in found.entries or not any(kinds.values()):
        return
    candidates = [*([one] for one in kinds["datetime"]), *([d, t] for d in kinds["date"] for t in kinds["time"])]
    candidates += [*([one] for one in kinds["time"]), *([one] for one in kinds["date"])]
    for sources in candidates:
        texts = [" ".join(parts).strip() for parts in zip(*map(found.layout.column, sources), strict=True)]
        texts = [text for text in texts if text]
        forms = [form.strip() for form in ("iso", *DATE_FORMS)]
        fitting = [form for form in forms if texts and all(moment_in(text, form) is not None for text in texts)]
        if not fitting or (fitting[0] == "iso" and len(texts[0]) <= 10):
            continue
        if any(form.endswith("%p") for form in fitting):  # clocks of twelve hours come with the month first
            fitting.sort(key=lambda form: not form.startswith("%m"))
        source = sources[0] if len(sources) == 1 else tuple(sources)
        if found.add("time_s", entry_of(source, form=fitting[0])):
            found.notes.append(f"time_s counts from the first row, {texts[0]}")
            if {form[:2] for form in fitting} >= {"%d", "%m"}:
                order = "month" if fitting[0].startswith("%m") else "day"
                found.assume(f"dates have the {order} first: {texts[0]}", "time_s", "order of day and month")
        return
    found.notes.append(
        f"no time: {quoted([name for names in kinds.values() for name in names])} cannot be read as dates"
    )


# --- Proposal of a mapping: the columns of a file by their headers, with every assumption in words


def proposed(layout: Layout, machine: Machine, plan: PlanPoints | None) -> Proposal:
    """Return the proposed mapping of a file.

    Raises:
        InputError: decimal commas and points in one file; no commanded positions; no header.
    """
    proposed = Proposal(layout, machine, plan)
    meanings = {name: meaning_of(name, machine) for name in layout.names}
    _choose_sign(proposed, exact=any(meaning.kind == "exact" for meaning in meanings.values()))
    if not layout.header_line:
        meanings = _without_header(proposed)
    _add_numbers(proposed, meanings)
    if plan is None:
        _check_commands(proposed, meanings)
    else:
        _match_plan(proposed, meanings)
    add_names(proposed, meanings)
    add_directions(proposed, meanings)
    add_times(proposed, meanings)
    if plan is None:
        _add_missing(proposed)
    unused = [name for name in layout.names if name not in proposed.used and any(layout.column(name))]
    if unused:
        proposed.notes.append(f"not used: {quoted(unused)}")
    if layout.left_out:
        lines = ", ".join(f"{line} ({text[:40]})" for line, text in layout.left_out[:3])
        more = f" and {len(layout.left_out) - 3} more" if len(layout.left_out) > 3 else ""
        proposed.notes.append(f"rows without a number are left out: line {lines}{more}")
    return proposed


def _choose_sign(found: Proposal, *, exact: bool) -> None:
    layout = found.layout
    is_sheet = bool(layout.raw.sheet)
    cells = [cell for _, row in layout.rows for cell in row if not is_sheet or COMMA in cell]
    sign = decimal_sign(cells)
    if sign.contrary and not is_sheet:
        line = next(line for line, row in layout.rows if sign.contrary in row)
        raise InputError(
            "decimal commas and decimal points in one file",
            expected="one decimal sign",
            file=layout.raw.path,
            line=line,
            value=sign.contrary,
        )
    found.sign = sign.sign
    ordinary = sign.sign == POINT and COMMA not in sign.ambiguous and (exact or layout.raw.delimiter == "comma")
    if sign.ambiguous and not ordinary:
        value = decimal_value(sign.ambiguous, sign.sign)
        name = SIGNS[sign.sign]
        found.assume(f"the decimal sign is the {name}: '{sign.ambiguous}' is read as {value}", "decimal", "check")


def _without_header(found: Proposal) -> dict[str, Meaning]:
    """Return meanings of the columns of a file without header: a name and three coordinates.

    Raises:
        InputError: other columns, or no plan.
    """
    layout = found.layout
    numbers = [name for name in layout.names if all(looks_like_number(cell) for cell in layout.column(name) if cell)]
    words = [name for name in layout.names if name not in numbers and any(layout.column(name))]
    if len(numbers) == 4 and not words:  # numbered points
        words, numbers = numbers[:1], numbers[1:]
    if len(numbers) != 3 or not words or found.plan is None:
        raise InputError(
            "no header row" + (" and no plan" if found.plan is None else ""),
            expected="a row with the names of the columns; or lines of a name and x, y, z, with a plan for the positions",
            file=layout.raw.path,
            line=layout.rows[0][0],
            value=" | ".join(layout.rows[0][1]),
            setting="plan" if found.plan is None else None,
        )
    found.assume(f"the file has no header; {quoted(numbers)} are x, y, z", "x_mm", "no header")
    return {
        **dict.fromkeys(layout.names, Meaning()),
        words[-1]: Meaning("point", "point"),
        **{name: Meaning("measured", axis) for name, axis in zip(numbers, "xyz", strict=True)},
    }


def _role(meaning: Meaning, name: str, found: Proposal, roles: set[tuple[str, str]]) -> str:
    """Return the role of a column that names an axis: that of its words, else from the other columns."""
    machine = found.machine
    linear = meaning.name.casefold() in ("x", "y", "z")
    if meaning.kind == "measured":
        return "measured" if linear else "readback"
    if meaning.kind != "bare":
        return meaning.kind
    if not linear or meaning.name not in machine.by_name:
        return "command" if meaning.name in machine.by_name else "measured" if linear else ""
    letter = meaning.name.casefold()
    if any(kind == "bare" and other == "x" for kind, other in roles) and _has_both_cases(found.layout.names, machine):
        return "measured" if name.lstrip()[:1].islower() else "command"
    if ("measured", letter) in roles:
        return "command"
    if ("command", letter) in roles or found.plan is not None:
        return "measured"
    return "bare"


def _has_both_cases(names: Sequence[str], machine: Machine) -> bool:
    first = [name.lstrip()[:1] for name in names if meaning_of(name, machine).kind == "bare"]
    return "x" in first and "X" in first


def _add_numbers(found: Proposal, meanings: dict[str, Meaning]) -> None:
    """Add commanded positions, read-back values, coordinates, uncertainties, temperatures and channels."""
    machine = found.machine
    roles = {(one.kind, one.name.casefold()) for one in meanings.values()}
    roles |= {
        ("measured", one.name[0])
        for name, one in meanings.items()
        if one.kind == "exact" and name in ("x_mm", "y_mm", "z_mm")
    }
    roles |= {
        ("command", one.name[0].casefold())
        for one in meanings.values()
        if one.kind == "exact" and one.name in axis_columns(machine)
    }
    chosen: dict[str, tuple[str, Meaning]] = {}
    for name, meaning in meanings.items():
        column = _column_of(name, meaning, found, roles)
        if column is None:
            continue
        if column in chosen:
            found.assume(f"{column} is taken from '{chosen[column][0]}', not from '{name}'", column, f"or {name}")
            continue
        chosen[column] = (name, meaning)
        if not meaning.certain:
            found.assume(f"'{name}' is {column}", column, "meaning of the name")
    units = unit_by_size(found, {column: (name, meaning.unit) for column, (name, meaning) in chosen.items()})
    for column, (name, meaning) in chosen.items():
        if meaning.kind == "exact":
            unit = next((one.name for one in units_of(column)), None)
            found.add(column, entry_of(name, unit=unit))
        else:
            found.add(column, entry_of(name, unit=units.get(column)))


def _column_of(name: str, meaning: Meaning, found: Proposal, roles: set[tuple[str, str]]) -> str | None:
    """Return the column of the measurement table that a column of numbers gives; None if it gives none."""
    if meaning.kind == "exact":
        return None if name in WORD_COLUMNS or name.startswith("approach_") else name
    if meaning.kind in ("spindle_rpm", "feed_mm_min", "load_kg"):
        return meaning.kind
    if meaning.kind == "temperature":
        return f"T_{meaning.name}_degC"
    if meaning.kind == "time" and _is_number_column(found, name):
        return "time_s"
    if not meaning.name:
        return None
    role, axis = _role(meaning, name, found, roles), found.machine.by_name.get(meaning.name)
    letter = meaning.name.casefold()
    if role in ("command", "readback") and axis is not None:
        return f"{'readback_' if role == 'readback' else ''}{axis.name}_{axis.unit}"
    if role == "measured" and letter in ("x", "y", "z"):
        return f"{letter}_mm"
    return f"u_{letter}_mm" if role == "uncertainty" and letter in ("x", "y", "z") else None


def _is_number_column(found: Proposal, name: str) -> bool:
    cells = [cell for cell in found.layout.column(name) if cell]
    return bool(cells) and all(decimal_value(cell, found.sign) is not None for cell in cells)


def _check_commands(found: Proposal, meanings: dict[str, Meaning]) -> None:
    """Raise `InputError` if the file gives no commanded position at all, or no measured coordinate."""
    commands = [name for name in axis_columns(found.machine) if name in found.entries]
    measured = [name for name in ("x_mm", "y_mm", "z_mm", "a_urad", "b_urad") if name in found.entries]
    unclear = [name for name, one in meanings.items() if one.kind == "bare" and name not in found.used]
    if commands and measured:
        return
    words = [{*plain_words(name).split()} for name in found.layout.names]
    if all(any(own <= ROLES[role] for own in words) for role in ("command", "measured")):
        raise InputError(
            "one row for each axis or feature, not for each measured point",
            expected="one row for each point, with the commands of all axes and x, y, z measured",
            file=found.layout.raw.path,
            line=found.layout.header_line,
            value=" | ".join(found.layout.names),
        )
    what = "no commanded positions" if not commands else "no measured coordinates"
    what += f": {quoted(unclear)} can be either" if unclear else ""
    raise InputError(
        what,
        expected="columns for both (X nominal, X actual, or X-Soll, X-Ist), or a plan that gives the commanded positions",
        file=found.layout.raw.path,
        line=found.layout.header_line,
        value=" | ".join(found.layout.names),
        setting="plan" if not commands else None,
    )


def _match_plan(found: Proposal, meanings: dict[str, Meaning]) -> None:
    plan = found.plan
    if plan is None:
        return
    names = [name for name, one in meanings.items() if one.kind in ("point", "target", "index")]
    for name in names:
        if plan.matches(found.layout.column(name)):
            found.matched = PlanEntry(match="point", point=name)
            found.used.add(name)
            return
    found.matched = PlanEntry(match="order")
    found.assume("the rows are in the order of the plan", "plan", "check the order of the rows")


def _add_missing(found: Proposal) -> None:
    """Add a constant for each axis whose commanded position the file does not give."""
    for column, axis in axis_columns(found.machine).items():
        if column in found.entries:
            continue
        low, high = (axis.lower, axis.upper) if axis.lower is not None and axis.upper is not None else (0.0, 0.0)
        value = min(max(0.0, low), high)
        found.entries[column] = entry_of(value=value)
        found.assume(
            f"{axis.name} stood at {value:g} {axis.unit} in all rows: the file does not give it", column, "position"
        )
