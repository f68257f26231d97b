"""Parts of a raw table: title rows, header, row of units, rows of measured points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

from twin._common.errors import InputError
from twin.measurement.importing.cells import RawTable
from twin.measurement.importing.decimals import looks_like_number
from twin.measurement.importing.units import unit_named

SHARE: Final = 0.6
"""Share of rows that have a number in a column of numbers."""

Row = tuple[int, tuple[str, ...]]


@final
@dataclass(frozen=True)
class Layout:
    """A raw table with its parts identified.

    Attributes:
        raw: the raw cells.
        header_line: line of the header; 0 if the file has none.
        names: names of the columns, each one once: as in the header, or ``column 1`` and so on.
        units: unit of each column from the row of units; empty where it gives none.
        rows: rows of measured points with their lines, each with as many cells as there are names.
        titles: rows above the header, as text.
        left_out: rows below the header that hold no number, with their text.
    """

    raw: RawTable
    header_line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[Row, ...]
    titles: tuple[str, ...]
    left_out: tuple[tuple[int, str], ...]

    def column(self, name: str) -> list[str]:
        """Return the cells of a column."""
        place = self.names.index(name)
        return [cells[place] for _, cells in self.rows]


def layout_of(raw: RawTable) -> Layout:
    """Return the parts of a raw table.

    Raises:
        InputError: no row with two numbers or more; a row with more cells than the header.
    """
    numeric = [[looks_like_number(cell) for cell in row] for _, row in raw.rows]
    candidates = [mask for mask in numeric if sum(mask) >= 2]
    if not candidates:
        line = raw.rows[0][0]
        raise InputError(
            "no row with numbers", expected="a table with one row for each measured point", file=raw.path, line=line
        )
    counts = Counter(i for mask in candidates for i, is_number in enumerate(mask) if is_number)
    columns = {i for i, count in counts.items() if count >= SHARE * len(candidates)} or set(counts)
    is_data = [_is_point(mask, columns) for mask in numeric]
    first = is_data.index(True) if any(is_data) else numeric.index(candidates[0])
    header, units, titles = _header(raw.rows[:first], len(columns))
    width = max(len(row) for (_, row), used in zip(raw.rows, is_data, strict=True) if used)
    rows, left_out = [], []
    for line, row in raw.rows[first:]:
        if any(looks_like_number(cell) for cell in row[:1000]) and not _is_repeated(row, header):
            rows.append((line, row))
        else:
            left_out.append((line, " ".join(filter(None, row))))
    if header and len(header) < width:
        line, row = next((line, row) for line, row in rows if len(row) > len(header))
        raise InputError(
            f"{len(row)} cells, more than the {len(header)} of the header",
            expected="one cell for each column",
            file=raw.path,
            line=line,
            value=" | ".join(row),
        )
    names = _unique([header[i] if i < len(header) and header[i] else f"column {i + 1}" for i in range(width)])
    return Layout(
        raw=raw,
        header_line=raw.rows[first - 1 - bool(any(units))][0] if header else 0,
        names=tuple(names),
        units=tuple(units[i] if i < len(units) else "" for i in range(width)),
        rows=tuple((line, (*row, *[""] * (width - len(row)))[:width]) for line, row in rows),
        titles=tuple(" ".join(filter(None, row)) for _, row in titles),
        left_out=tuple(left_out),
    )


def _is_point(mask: Sequence[bool], columns: set[int]) -> bool:
    """Return whether a row has numbers in at least half of the columns of numbers."""
    return 2 * sum(i < len(mask) and mask[i] for i in columns) >= len(columns)


def _is_repeated(row: Sequence[str], header: Sequence[str]) -> bool:
    return bool(header) and list(row) == list(header)[: len(row)]


def _header(above: Sequence[Row], numbers: int) -> tuple[list[str], list[str], Sequence[Row]]:
    """Return the names of columns, their units, and the rows above, from the rows before the first measured point."""
    units: list[str] = []
    rest = list(above)
    if rest and _is_units(rest[-1][1]):
        units = [cell.strip("[]() ") if cell else "" for cell in rest.pop()[1]]
    if not rest or sum(bool(cell) for cell in rest[-1][1]) < max(2, numbers / 2):
        return [], units, rest
    header = list(rest.pop()[1])
    if rest and len(set(filter(None, header))) < sum(map(bool, header)) and sum(map(bool, rest[-1][1])) >= 2:
        # Two rows of headers: "nominal" above X, Y, Z and "actual" above X, Y, Z.
        upper, last = list(rest.pop()[1]), ""
        for i, cell in enumerate(header):
            last = upper[i] if i < len(upper) and upper[i] else last
            header[i] = f"{last} {cell}".strip() if cell else last
    return header, units, rest


def _is_units(row: Sequence[str]) -> bool:
    """Return whether all cells of a row that are not empty are units, and two or more are."""
    cells = [cell.strip("[]() ") for cell in row if cell]
    known = [cell for cell in cells if unit_named(cell) is not None]
    return len(known) >= 2 and len(known) == len([cell for cell in cells if cell.strip("-–")])


def _unique(names: Sequence[str]) -> list[str]:
    """Return names with a number appended to those that repeat an earlier one."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found
