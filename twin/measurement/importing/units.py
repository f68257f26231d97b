"""Units of columns: as the file states them, else from the size of the numbers compared with the machine's ranges."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.measurement.checks import RANGE_SLACK
from twin.measurement.columns import POINT_COLUMNS
from twin.measurement.importing.cells import Layout
from twin.measurement.importing.mapping import ColumnsFile, column_line, entry_of
from twin.measurement.importing.quantities import table_unit, unit_named, units_of

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


class Columns(Protocol):
    """A proposal whose units are determined."""

    layout: Layout
    machine: Machine
    given: ColumnsFile | None

    def values(self, name: str) -> np.ndarray:
        """Return the numbers of a column of the file."""

    def assume(self, text: str, column: str, remark: str = "check") -> None:
        """Add an assumption."""


def unit_by_size(found: Columns, sources: Mapping[str, tuple[str, str]]) -> dict[str, str]:
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
        title = by_title.get(table_unit(column)) if _is_coordinate(column, found.machine) else None
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


def stated_units(found: Columns) -> dict[str, str]:
    """Return the units of lengths and angles that titles and comments state, by the unit of a measurement table (mm, deg).

    Raises:
        InputError: they state two units of lengths, or of angles.
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


def _is_coordinate(column: str, machine: Machine) -> bool:
    """Return whether a column is a position or a coordinate, for which the unit of the titles holds."""
    return column in POINT_COLUMNS or _kind(column, machine) == "command"


def _check_contradiction(
    found: Columns,
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
        family = f"{_kind(column, machine)} {table_unit(column)}"
        families.setdefault(family, []).append(column)
    return list(families.values())


def _kind(column: str, machine: Machine) -> str:
    axes = {f"{axis.name}_{axis.unit}" for axis in machine.axes}
    return (
        "command"
        if column.removeprefix("readback_") in axes
        else column[:2]
        if column.startswith(("u_", "T_"))
        else "measured"
    )


def _likely(
    found: Columns, columns: Sequence[str], names: Mapping[str, str], known: Mapping[str, str]
) -> tuple[str, str]:
    """Return the likely unit of columns of one kind, and the reason."""
    axes = {f"{axis.name}_{axis.unit}": axis for axis in found.machine.axes}
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


def _by_extent(found: Columns, names: Sequence[str]) -> tuple[str, str]:
    """Return the unit in which measured coordinates extend over the size of the machine."""
    size = max((axis.domain[1] - axis.domain[0] for axis in found.machine.axes if axis.linear), default=1000.0)
    extent = max(
        (float(np.ptp(q[np.isfinite(q)])) for name in names if np.isfinite(q := found.values(name)).any()), default=0.0
    )
    for name in ("mm", "m", "inch"):
        if LEAST_SHARE * size <= extent * _factor(name) <= 4.0 * size:
            return name, f", because the readings extend over {extent:g}"
    return "mm", " assumed"
