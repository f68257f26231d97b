"""Read points of a curve as a program with one straight block per point, to be refitted like any other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from twin._common.counts import count_with_noun
from twin._common.csv_tables import split_cells
from twin._common.errors import InputError
from twin._common.files import read_lines
from twin.nc.blocks import AxisWords, Program
from twin.nc.dialect import Dialect

POINT: Final = ("x_mm", "y_mm", "z_mm")
VECTOR: Final = ("i", "j", "k")
SUFFIX: Final = ".csv"


def is_points(path: Path) -> bool:
    """Return whether a file is a table of points, by its name."""
    return path.suffix.lower() == SUFFIX


def points_program(
    path: Path, axes: AxisWords, dialects: Sequence[Dialect], written: Dialect, feed: float | None
) -> tuple[Program, Dialect]:
    """Return a program with one straight block per point of a table, and its language.

    Args:
        path: the table: ``x_mm,y_mm,z_mm``, then nothing, dialect column ``<axis>_deg`` per rotary axis, or the tool vector ``i,j,k``;
            ``#`` begins a comment.
        axes: the machine's words.
        dialects: all languages.
        written: the language of the output.
        feed: mm/min; None for no feed word.

    Returns:
        The program and its language: that of the output, but cutter locations for points with a tool vector.

    Raises:
        InputError: with line and value, if it is no such table; rotary axes for an output language without words for them.
    """
    header, lines, values = _table(path, axes)
    vectors = header[3:] == VECTOR
    if written.cutter_locations and len(header) > 3 and not vectors:
        raise InputError(
            "rotary axis columns cannot be written as cutter locations",
            expected="columns i,j,k, or an output file ending in .nc or .h",
            file=path,
            line=lines[0] - 1,
            value=",".join(header),
            setting="output",
        )
    dialect = next(dialect for dialect in dialects if dialect.cutter_locations) if vectors else written
    if vectors:
        size = np.linalg.norm(values[:, 3:], axis=1)
        wrong = np.flatnonzero(np.abs(size - 1.0) > 1e-3)
        if wrong.size:
            at = int(wrong[0])
            raise InputError(
                "not a tool vector",
                expected="i,j,k of unit length",
                file=path,
                line=lines[at],
                value=",".join(f"{v:g}" for v in values[at, 3:]),
            )
    text = dialect.from_points(_names(header, axes), values, feed, _shown(path), path.stem)
    return dialect.read(text.encode("latin-1", "replace"), str(path)), dialect


def _table(path: Path, axes: AxisWords) -> tuple[tuple[str, ...], list[int], np.ndarray]:
    """Return header, line number of every row, and (n, columns) values."""
    rotary = tuple(f"{name}_deg" for name in axes.rotary)
    known = [POINT, *([POINT + rotary] if rotary else []), *([POINT + VECTOR] if rotary else [])]
    expected = "header " + " or ".join(",".join(columns) for columns in known)
    header: tuple[str, ...] | None = None
    lines: list[int] = []
    rows: list[list[float]] = []
    for number, text in enumerate(read_lines(path), start=1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in split_cells(text, path, number)]
        if header is None:
            header = tuple(cells)
            if header not in known:
                raise InputError("not a table of points", expected=expected, file=path, line=number, value=text)
            continue
        if len(cells) != len(header):
            raise InputError(
                f"row with {count_with_noun(len(cells), 'value')}",
                expected=f"{len(header)} values: {','.join(header)}",
                file=path,
                line=number,
                value=text,
            )
        rows.append([_number(cell, name, path, number) for cell, name in zip(cells, header, strict=True)])
        lines.append(number)
    if header is None:
        raise InputError("no header row", expected=expected, file=path)
    if len(rows) < 2:
        raise InputError(f"only {count_with_noun(len(rows), 'point')}", expected="two or more", file=path)
    return header, lines, np.array(rows)


def _number(cell: str, column: str, path: Path, line: int) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e6:
        raise InputError(
            f"{column} is not a coordinate", expected="a number below 1e6", file=path, line=line, value=cell
        )
    return value


def _names(header: tuple[str, ...], axes: AxisWords) -> tuple[str, ...]:
    return axes.linear if len(header) == 3 or header[3:] == VECTOR else axes.names


def _shown(path: Path) -> str:
    return "points of " + "".join(c if c.isascii() and c.isprintable() and c not in "()~;$" else "_" for c in path.name)
