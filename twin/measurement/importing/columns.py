"""Proposal of the columns of a mapping by the headers of a file, with every assumption in words."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import POINT_COLUMNS, RANGE_SLACK, axis_columns
from twin.measurement.importing.apply import WORD_COLUMNS, PlanPoints, moment_in, slack_of
from twin.measurement.importing.arrangement import NAME, RUN
from twin.measurement.importing.cells import Layout, yaml_list
from twin.measurement.importing.mapping import (
    ColumnMapping,
    ColumnsFile,
    DeviationEntry,
    OriginEntry,
    PlanEntry,
    SphericalEntry,
    column_line,
    entry_of,
)
from twin.measurement.importing.quantities import (
    CARRIER_WORDS,
    COMMA,
    POINT,
    SIGNS,
    Meaning,
    decimal_sign,
    direction_of,
    is_no_value,
    looks_like_number,
    meaning_of,
    plain_words,
    quantity_in,
    table_unit,
    unit_named,
    units_of,
)


@final
@dataclass
class Proposal:
    """A mapping in the making.

    Attributes:
        plan: the plan that gives positions, or None.
        entries: origin of each column of the measurement table.
        remarks: comment for an entry of the mapping file, by its column.
        notes: facts that need no confirmation.
        given: lines of a mapping file that hold already; None for none.
    """

    layout: Layout
    machine: Machine
    plan: PlanPoints | None = None
    given: ColumnsFile | None = None
    entries: dict[str, OriginEntry] = field(default_factory=dict)
    assumptions: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    sign: str = POINT
    matched: PlanEntry | None = None
    used: set[str] = field(default_factory=set)
    spherical: SphericalEntry | None = None
    deviations: DeviationEntry | None = None

    def __post_init__(self) -> None:
        """Take over what holds already."""
        if self.given is not None:
            self.entries |= self.given.columns
            self.spherical, self.deviations = self.given.spherical, self.given.deviations
            computed = [one for one in (self.spherical, self.deviations) if one is not None]
            self.used |= {source for one in (*self.given.columns.values(), *computed) for source in one.sources}

    @property
    def missing(self) -> tuple[str, ...]:
        """Words for no value, in lower case."""
        return () if self.given is None else tuple(plain_words(word) for word in self.given.missing)

    @property
    def has_readings(self) -> bool:
        """Whether the readings of the file are known."""
        return self.mapping().entries.gives_readings

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
            "spherical": self.spherical,
            "deviations": self.deviations,
            "plan": self.matched,
        }
        if self.given is not None:
            content |= {name: getattr(self.given, name) for name in ("names", "missing", "length", "angle")}
        return ColumnMapping(ColumnsFile(**content))

    def assume(self, text: str, column: str, remark: str = "check") -> None:
        """Add an assumption, and a remark at the entry that it concerns."""
        self.assumptions.append(text)
        said = self.remarks.get(column, "")
        if remark not in said.split("; "):
            self.remarks[column] = f"{said}; {remark}" if said else remark

    def add(self, column: str, entry: OriginEntry) -> bool:
        """Add an entry; return False, with a note, if the column has one already."""
        if self.given is not None and column in self.given.columns:
            return False
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
        sign = POINT if name in self.layout.derived else self.sign
        numbers = [
            None if is_no_value(cell, self.missing) else quantity_in(cell, sign) for cell in self.layout.column(name)
        ]
        return np.array([np.nan if number is None else float(number.value) for number in numbers])


def quoted(names: Sequence[str]) -> str:
    """Return names in quotes, separated by commas."""
    return ", ".join(f"'{name}'" for name in names)


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
        if name in found.used or (name in found.layout.derived and meaning.kind in found.entries):
            continue
        if meaning.kind == "exact" and name in WORD_COLUMNS:
            found.add(name, entry_of(name))
        elif meaning.kind in ("target", "station", "round"):
            found.add(meaning.kind, entry_of(name))
        elif meaning.kind in ("carrier", "") and "carrier" not in found.entries:
            if not meaning.kind and not {plain_words(cell) for cell in found.layout.column(name)} <= {*CARRIER_WORDS}:
                continue
            wrong = [cell for cell in found.layout.column(name) if plain_words(cell) not in CARRIER_WORDS]
            if wrong:
                found.notes.append(f"'{name}' is not used: '{wrong[0]}' is not a side of the machine")
            else:
                found.add("carrier", entry_of(name))
    if found.plan is not None:
        return
    points = sorted(
        (name for name, one in meanings.items() if one.kind == "point"),
        key=lambda name: name not in found.layout.derived,
    )
    if "target" not in found.entries:
        _add_target(found, points)


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
        if name in found.used or (meaning.kind != "approach" and not exact):
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


# --- Proposal of the columns of numbers ---------------------------------------------------------------


def meanings_of(layout: Layout, machine: Machine) -> dict[str, Meaning]:
    """Return the meaning of every column of a file, those that were made from others included."""
    meanings = {name: meaning_of(name, machine) for name in layout.names if name not in layout.derived}
    for name in layout.derived:
        part = name.rpartition(": ")[2]
        axis = machine.by_name.get(part)
        given = any(other.startswith(name.removesuffix(NAME)) and other[-3:-1] == ": " for other in layout.derived)
        kinds = {
            RUN: Meaning("round", "round"),
            NAME: Meaning("target", "target") if given else Meaning("point", "point"),
        }
        meanings[name] = Meaning("command", axis.name, axis.unit) if axis is not None else kinds.get(part, Meaning())
    return meanings


def choose_sign(found: Proposal, *, exact: bool) -> None:
    """Choose the decimal sign: the one given, else that of the cells. Raises `InputError`: the cells have both."""
    layout = found.layout
    is_sheet, own = bool(layout.raw.sheet), len(layout.names) - len(layout.derived)
    cells = [cell for _, row in layout.rows for cell in row[:own] if not is_sheet or COMMA in cell]
    sign = decimal_sign(cells)
    if found.given is not None and "decimal" in found.given.model_fields_set:
        found.sign = found.given.sign
        return
    if sign.contrary and not is_sheet:
        line = next(line for line, row in layout.rows if sign.contrary in row)
        most = (
            COMMA
            if 2 * sum(COMMA in cell for cell in cells) > sum(COMMA in cell or POINT in cell for cell in cells)
            else POINT
        )
        raise InputError(
            "decimal commas and decimal points in one file",
            expected="one decimal sign",
            file=layout.raw.path,
            line=line,
            value=sign.contrary,
            cure=f"decimal: {SIGNS[most]}",
        )
    found.sign = sign.sign
    ordinary = sign.sign == POINT and COMMA not in sign.ambiguous and (exact or layout.raw.delimiter == "comma")
    if sign.ambiguous and not ordinary:
        number = quantity_in(sign.ambiguous, sign.sign)
        value, name = "no number" if number is None else number.value, SIGNS[sign.sign]
        found.assume(f"the decimal sign is the {name}: '{sign.ambiguous}' is read as {value}", "decimal", "check")


def without_header(found: Proposal) -> dict[str, Meaning]:
    """Return meanings of the columns of a file without header: a name and three coordinates.

    Raises `InputError`: other columns, or no plan.
    """
    layout = found.layout
    own = [name for name in layout.names if name not in layout.derived]
    numbers = [
        name for name in own if all(looks_like_number(cell) for cell in layout.column(name) if not is_no_value(cell))
    ]
    words = [name for name in own if name not in numbers and any(layout.column(name))]
    if len(numbers) > 3 and words:  # an offset, which is the same for all points
        numbers = [name for name in numbers if len({*layout.column(name)}) > 1]
    if len(numbers) == 4 and not words:  # numbered points
        words, numbers = numbers[:1], numbers[1:]
    known = found.plan is not None or layout.derived
    if len(numbers) != 3 or not words or not known:
        names = iter("xyz" if len(numbers) == 3 else "XYZxyz" if len(numbers) == 6 else ())
        titles = [next(names, name) if name in numbers else "Name" if [name] == words[:1] else name for name in own]
        raise InputError(
            "no header row" + ("" if known else " and no plan"),
            expected="a row with the names of the columns; or lines of a name and x, y, z, with a plan for the positions",
            file=layout.raw.path,
            line=layout.rows[0][0],
            value=" | ".join(layout.rows[0][1]),
            setting=None if known else "plan",
            cure=f"names: {yaml_list(titles)}",
        )
    found.assume(f"the file has no header; {quoted(numbers)} are x, y, z", "x_mm", "no header")
    return {
        **dict.fromkeys(own, Meaning()),
        **{name: meaning for name, meaning in meanings_of(layout, found.machine).items() if name in layout.derived},
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
    bare = {own.lstrip()[:1] for own in found.layout.names if meaning_of(own, machine).kind == "bare"}
    if {"x", "X"} <= bare:  # both cases: capital letters are commands
        return "measured" if name.lstrip()[:1].islower() else "command"
    if ("measured", letter) in roles:
        return "command"
    if ("command", letter) in roles or found.plan is not None:
        return "measured"
    return "bare"


def add_numbers(found: Proposal, meanings: dict[str, Meaning]) -> None:
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
        column = None if name in found.used else _column_of(name, meaning, found, roles)
        if column is None or (found.given is not None and column in found.given.columns):
            continue
        if column in chosen:
            if name in found.layout.derived and _are_equal(found, chosen[column][0], name):
                found.used.add(name)
                continue
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


def _are_equal(found: Proposal, one: str, other: str) -> bool:
    """Return whether two columns hold the same numbers, the second rounded to its digits."""
    slack = np.array([slack_of(cell) for cell in found.layout.column(other)])
    return bool(np.all(~(np.abs(found.values(one) - found.values(other)) > slack)))


def _column_of(name: str, meaning: Meaning, found: Proposal, roles: set[tuple[str, str]]) -> str | None:
    """Return the column of the measurement table that a column of numbers gives; None if it gives none."""
    if meaning.kind == "exact":
        return None if name in WORD_COLUMNS or name.startswith("approach_") else name
    if meaning.kind in ("spindle_rpm", "feed_mm_min", "load_kg"):
        return meaning.kind
    if meaning.kind == "temperature":
        return f"T_{meaning.name}_degC"
    if meaning.kind == "time" and is_number_column(found, name):
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


def is_number_column(found: Proposal, name: str) -> bool:
    """Return whether all cells of a column that have a value are numbers."""
    cells = [cell for cell in found.layout.column(name) if not is_no_value(cell, found.missing)]
    sign = POINT if name in found.layout.derived else found.sign
    return bool(cells) and all(quantity_in(cell, sign) is not None for cell in cells)


# --- Units of columns: as the file states them, else from the size of the numbers compared with the machine's ranges ---

LEAST_SHARE: Final = 0.02
"""Share of an axis's range that positions must span in a unit for that unit to be likely."""
LARGEST_U_MM: Final = 0.2
"""Uncertainty beyond which a number without a unit is taken as micrometres."""
LENGTHS: Final = ("mm", "m", "inch", "um")
ANGLES: Final = ("deg", "rad", "mrad")
_STATEMENT: Final = re.compile(
    r"\b(?:length|angle|angular|linear|längen?|winkel|unité de)?\s*-?(?:units?|einheit(?:en)?|unités?)\b[^:=]{0,24}?[\s:=]+(.+)"
    r"|\b(?:dimensions|coordinates|values|lengths|maße|angaben|koordinaten|werte|cotes|valeurs|coordonnées)\b.{0,24}?\b(?:in|en)\s+(.+)",
    re.IGNORECASE,
)
"""Title or comment that states units: ``Units: Millimeters``, ``Einheit: mm; Grad``, ``All dimensions in inches``."""


def unit_by_size(found: Proposal, sources: Mapping[str, tuple[str, str]]) -> dict[str, str]:
    """Return the unit of every column, and add an assumption for each one that the file does not state.

    ``sources``: column of the file and unit in its header (empty if none), by column of the measurement table.
    """
    units: dict[str, str] = {}
    missing: dict[str, str] = {}
    by_title = stated_units(found)
    for column, (name, stated) in sources.items():
        place = found.layout.names.index(name)
        in_cells = found.layout.cell_units(name)
        header = [
            unit.name for text in (stated, found.layout.units[place]) if text and (unit := unit_named(text, column))
        ]
        cells = list(dict.fromkeys(unit.name for text in in_cells if (unit := unit_named(text, column))))
        is_coordinate = column in POINT_COLUMNS or _kind(column, found.machine) == "command"
        title = by_title.get(table_unit(column)) if is_coordinate else None  # titles state the unit of coordinates
        header = header or ([table_unit(column)] if name == column and table_unit(column) and not cells else [])
        _check_contradiction(found, column, name, header, title, in_cells, cells)
        if len(cells) > 1:
            continue  # each cell states its own
        if [*header, *cells]:
            units[column] = [*header, *cells][0]
            if len(set(header)) > 1:
                found.assume(f"'{name}' is in {header[0]}: its header and the row of units differ", column, "unit")
        elif title is not None:
            units[column] = title
        elif table_unit(column) and name != column:
            missing[column] = name
            if stated or found.layout.units[place]:
                text = stated or found.layout.units[place]
                found.assume(f"the unit '{text}' of '{name}' does not fit {column}", column, "unit")
    for columns in _families(missing, found.machine):
        name, why = _likely(found, columns, missing, units)
        units |= dict.fromkeys(columns, name)
        if not any(np.nan_to_num(found.values(missing[column])).any() for column in columns):
            continue  # zero in any unit
        names = ", ".join(f"'{missing[column]}'" for column in columns)
        found.assume(f"no unit is given for {names}: {name}{why}", columns[0], "unit")
    return units


def stated_units(found: Proposal) -> dict[str, str]:
    """Return the units of lengths and angles that titles and comments state, by the unit of a measurement table (mm, deg).

    Raises `InputError`: they state two units of lengths, or of angles.
    """
    stated: dict[str, tuple[str, str]] = {}
    for text in (*found.layout.titles, *found.layout.raw.comments):
        match = _STATEMENT.search(text)
        words = (
            [word.strip("()[].:") for word in re.split(r"[\s,;/|&]+", next(filter(None, match.groups())))[:8]]
            if match
            else []
        )
        for k, word in enumerate(words):
            unit = unit_named(word)
            is_preposition = word.casefold() == "in" and unit_named("".join(words[k + 1 : k + 2])) is not None
            if unit is None or is_preposition or unit.table_unit not in ("mm", "deg") or unit.name in ("um", "nm"):
                continue  # positions are not in micrometres
            other, where = stated.setdefault(unit.table_unit, (unit.name, text))
            given = found.given is not None and (found.given.length if unit.table_unit == "mm" else found.given.angle)
            if other != unit.name and not given:
                raise InputError(
                    f"two units in the titles: '{where}' and '{text}'",
                    expected="one unit",
                    file=found.layout.raw.path,
                    cure=f"{'length' if unit.table_unit == 'mm' else 'angle'}: {other}",
                )
    units = {kind: unit for kind, (unit, _) in stated.items()}
    if found.given is not None:
        units |= {kind: unit for kind, unit in (("mm", found.given.length), ("deg", found.given.angle)) if unit}
    return units


def _check_contradiction(
    found: Proposal,
    column: str,
    name: str,
    header: Sequence[str],
    title: str | None,
    in_cells: Mapping[str, int],
    cells: Sequence[str],
) -> None:
    """Raise `InputError` if header, titles and cells of a column state different units.

    ``header``: units that the header and the row of units state; ``in_cells``: units in the cells, as spelt, with their first lines.
    """
    given = found.given is not None and bool(found.given.length if table_unit(column) == "mm" else found.given.angle)
    if header and title is not None and header[0] != title and not given:
        raise InputError(
            f"'{name}' is in {header[0]}, and the titles of the file state {title}",
            expected="one unit",
            file=found.layout.raw.path,
            line=found.layout.header_line,
            cure=f"{'length' if table_unit(column) == 'mm' else 'angle'}: {header[0]}",
        )
    stated = header[0] if header else title
    odd = next((unit for unit in cells if stated is not None and unit != stated), None)
    if odd is not None:
        spelt = next(text for text in in_cells if (unit := unit_named(text, column)) and unit.name == odd)
        raise InputError(
            f"'{name}' is in {stated} by its header, and a cell in {odd}",
            expected="one unit",
            file=found.layout.raw.path,
            line=in_cells[spelt],
            value=spelt,
            cure=column_line({column: entry_of(name)}),
        )


def _families(missing: Mapping[str, str], machine: Machine) -> list[list[str]]:
    """Return the columns without a unit in groups that have the same one."""
    families: dict[str, list[str]] = {}
    for column in missing:
        families.setdefault(f"{_kind(column, machine)} {table_unit(column)}", []).append(column)
    return list(families.values())


def _kind(column: str, machine: Machine) -> str:
    axes = axis_columns(machine)
    return (
        "command"
        if column.removeprefix("readback_") in axes
        else column[:2]
        if column.startswith(("u_", "T_"))
        else "measured"
    )


def _likely(
    found: Proposal, columns: Sequence[str], names: Mapping[str, str], known: Mapping[str, str]
) -> tuple[str, str]:
    """Return the likely unit of columns of one kind, and the reason."""
    axes = axis_columns(found.machine)
    own = table_unit(columns[0])
    if columns[0] in axes:
        return _by_range([(axes[column], found.values(names[column])) for column in columns if column in axes])
    if columns[0].startswith("u_"):
        largest = max(float(np.nanmax(found.values(names[column]), initial=0.0)) for column in columns)
        return ("um", f", because the numbers reach {largest:g}") if largest > LARGEST_U_MM else ("mm", " assumed")
    if own == "mm":
        commands = [known[name] for name, axis in axes.items() if axis.linear and name in known]
        return (
            (commands[0], ", as the commanded positions")
            if commands
            else _by_extent(found, [names[c] for c in columns])
        )
    return units_of(columns[0])[0].name, " assumed"


def _by_range(columns: Sequence[tuple[Axis, np.ndarray]]) -> tuple[str, str]:
    """Return the unit in which commanded positions fit the ranges of their axes best."""
    axis, _ = columns[0]
    fitting: dict[str, float] = {}
    for name in LENGTHS if axis.linear else ANGLES:
        fitting[name] = _share_of_range(columns, _factor(name))
    first = next(iter(fitting))
    best = next((name for name, share in fitting.items() if LEAST_SHARE <= share <= 1.0), first)
    low = min(float(np.nanmin(q, initial=0.0)) for _, q in columns)
    high = max(float(np.nanmax(q, initial=0.0)) for _, q in columns)
    if best == first:
        return best, f", because {low:g} … {high:g} fits the machine's ranges" if fitting[best] <= 1.0 else " assumed"
    return best, f", because {low:g} … {high:g} looks like {best} on this machine (factor {_factor(best):.6g})"


def _factor(name: str) -> float:
    unit = unit_named(name)
    return 1.0 if unit is None else float(unit.factor)


def _share_of_range(columns: Sequence[tuple[Axis, np.ndarray]], factor: float) -> float:
    """Return the largest share of its range that an axis moves; infinity if a position is outside."""
    share = 0.0
    for axis, q in columns:
        own = q[np.isfinite(q)] * factor
        low, high = axis.domain
        limited = axis.lower is not None
        if not len(own):
            continue
        if limited and (own.min() < low - RANGE_SLACK or own.max() > high + RANGE_SLACK):
            return np.inf
        # A turn of an unlimited axis, and a step of half a turn, are no limits: several turns are possible.
        share = max(share, min(float(np.ptp(own)) / (high - low), 1.0 if not limited else np.inf))
    return share


def _by_extent(found: Proposal, names: Sequence[str]) -> tuple[str, str]:
    """Return the unit in which measured coordinates extend over the size of the machine."""
    size = max((axis.domain[1] - axis.domain[0] for axis in found.machine.axes if axis.linear), default=1000.0)
    extent = max(
        (float(np.ptp(q[np.isfinite(q)])) for name in names if np.isfinite(q := found.values(name)).any()), default=0.0
    )
    for name in ("mm", "m", "inch"):
        if LEAST_SHARE * size <= extent * _factor(name) <= 4.0 * size:
            return name, f", because the readings extend over {extent:g}"
    return "mm", " assumed"
