"""CSV tables with a header row and comments; errors name file, line and value."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, closest_name, control_character
from twin._common.files import other_kind, read_lines
from twin._common.messages import Message
from twin._common.units import count_with_noun

MAX_COLUMNS: Final = 1000
MAX_CELLS: Final = 10_000_000
"""Largest table: 100,000 points with 30 columns are 3 million cells; ten million take about 2 GB."""
MAX_VALUE: Final = 1e12
"""Largest absolute value of a number in a table. Times in seconds since 1970 are smaller; squares and their sums stay finite."""


def read_table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]], list[str]]:
    """Return header, rows with their line numbers, and the text of every ``#`` comment of a CSV file in which each row is one line.

    Raises `InputError` with line and value: no header, too many columns, a duplicate one, a row of another length, a cell that does
    not end on its line or is too long, a control character.
    """
    whole = [(number, text) for number, text in enumerate(read_lines(path), start=1) if text.strip()]
    for number, text in whole:
        if control_character(text) is not None:
            raise InputError("control character", expected="printable text", file=path, line=number, value=text)
    lines = [(number, text) for number, text in whole if not text.lstrip().startswith("#")]
    comments = [text.strip().lstrip("# ") for _, text in whole if text.lstrip().startswith("#")]
    kind = other_kind("\n".join(text for _, text in whole[:100]), "a measurement table", "a plan")
    if kind is not None:
        raise InputError(f"{kind}, not a table", expected="a CSV table with a header (twin doc files)", file=path)
    if not lines:
        raise InputError("no header row", expected="a CSV table with a header", file=path)
    _check_separator(lines[0][1], path, lines[0][0])
    columns = lines[0][1].count(",") + 1
    if columns * len(lines) > MAX_CELLS:
        size = f"{count_with_noun(len(lines), 'row')} of {count_with_noun(columns, 'cell')}"
        raise InputError(
            f"too large: {size}", expected=f"at most {MAX_CELLS:,} cells: fewer rows or columns", file=path
        )
    cells = _cells(lines, path)
    header = [name.strip() for name in cells[0]]
    if len(header) > MAX_COLUMNS:
        raise InputError(
            count_with_noun(len(header), "column"), expected=f"at most {MAX_COLUMNS}", file=path, line=lines[0][0]
        )
    twice = next((name for name, count in Counter(header).items() if count > 1), None)
    if twice is not None:
        raise InputError("duplicate column", expected="each column once", file=path, line=lines[0][0], value=twice)
    rows = []
    for (number, text), row in zip(lines[1:], cells[1:], strict=True):
        if len(row) != len(header):
            raise InputError(
                count_with_noun(len(row), "cell"),
                expected=f"{count_with_noun(len(header), 'cell')}, as in the header",
                file=path,
                line=number,
                value=",".join(row),
            )
        rows.append((number, [cell.strip() for cell in row] if " " in text or "\t" in text else row))
    return header, rows, comments


def _check_separator(header: str, path: Path, line: int) -> None:
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if header.count(separator) > header.count(","):
            raise InputError(
                f"the columns are separated by {name}",
                expected="commas between columns and decimal points (`twin import` reads other tables)",
                file=path,
                line=line,
                value=header,
            )


def split_cells(text: str, path: Path, line: int) -> list[str]:
    """Return the cells of one line of CSV; raise `InputError` if one does not end on this line, or is too long."""
    return _cells([(line, text)], path)[0]


def _cells(lines: Sequence[tuple[int, str]], path: Path) -> list[list[str]]:
    """Return the cells of every line, one row per line."""
    reader = csv.reader((text for _, text in lines), strict=True)
    cells: list[list[str]] = []
    expected = "cells separated by commas, each ending on its line"
    try:
        for row in reader:
            cells.append(row)
            if reader.line_num != len(cells):
                line, text = lines[len(cells) - 1]
                raise InputError("line break in a cell", expected=expected, file=path, line=line, value=text)
    except csv.Error as error:
        line, text = lines[len(cells)]
        raise InputError(f"not a table row ({error})", expected=expected, file=path, line=line, value=text) from None
    return cells


@final
@dataclass(frozen=True)
class Cells:
    """The cells below a header. Reading a column checks it and raises `InputError` with file, line and value."""

    path: Path
    columns: Mapping[str, int]
    rows: Sequence[tuple[int, list[str]]]

    def numbers(self, name: str) -> np.ndarray:
        """Return a column of numbers, NaN where the cell is empty or the column is absent."""
        column = self.columns.get(name)
        if column is None:
            return read_only(np.full(len(self.rows), np.nan))
        cells = [row[column] for _, row in self.rows]
        try:
            values = np.array([float(cell) if cell else np.nan for cell in cells], dtype=float)
        except ValueError:
            line, cell = next(
                (line, row[column]) for line, row in self.rows if row[column] and not _is_number(row[column])
            )
            raise InputError(
                f"{name} is not a number",
                expected="a number with a decimal point, or an empty cell",
                file=self.path,
                line=line,
                value=cell,
            ) from None
        for i in np.flatnonzero(np.isfinite(values) & (np.abs(values) > MAX_VALUE)):
            raise InputError(
                f"{name} is too large",
                expected=f"a number of at most {MAX_VALUE:g}",
                file=self.path,
                line=self.rows[int(i)][0],
                value=cells[i],
            )
        for i in np.flatnonzero(np.isnan(values)):
            if cells[i]:
                values[i] = np.inf  # "NaN" was written: unlike an empty cell, that does not mean "not measured"
        return read_only(values)

    def refuse(self, wrong: np.ndarray, values: np.ndarray, name: str, expected: str) -> None:
        """Raise `InputError` for the first row (n,) in which a value of a column is wrong; NaN is an empty cell."""
        for i in np.flatnonzero(wrong)[:1]:
            value = float(values[i])
            raise InputError(
                f"{name} is empty" if np.isnan(value) else f"{name} cannot be used",
                expected=expected,
                file=self.path,
                line=self.rows[int(i)][0],
                value=value if np.isfinite(value) else None,
            )

    def words(self, name: str, default: str) -> np.ndarray:
        """Return a column of words, the default where the cell is empty or the column is absent."""
        column = self.columns.get(name)
        cells = [default] * len(self.rows) if column is None else [row[column] or default for _, row in self.rows]
        return read_only(np.array(cells, dtype=object))

    def signs(self, name: str) -> np.ndarray:
        """Return a column of directions, +1 or −1, and 0 where the cell is empty or the column is absent."""
        values = np.nan_to_num(self.numbers(name), nan=0.0)
        wrong = ~np.isin(values, (-1.0, 0.0, 1.0))
        if np.any(wrong):
            i = int(np.flatnonzero(wrong)[0])
            raise InputError(
                f"{name} is not a direction",
                expected="+1, -1 or 0",
                file=self.path,
                line=self.rows[i][0],
                value=values[i],
            )
        return read_only(values)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def unused_column_note(name: str, known: Sequence[str]) -> Message:
    """Return the notice that a column is unknown and not used."""
    close = closest_name(name, known)
    hint = "" if close is None else Message(" (did you mean {name}?)", name=close)
    return Message("column {name} is unknown and not used{hint}", name=name, hint=hint)
