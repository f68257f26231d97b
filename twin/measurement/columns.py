"""Columns of a measurement table: the field each belongs to, and how its cells are read and written."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells
from twin._common.errors import InputError
from twin._common.units import MM, UM
from twin.machine.machine import Machine
from twin.measurement.instruments.base import SIDES

CARRIERS: Final = ("tool", "work")
POINT_COLUMNS: Final = ("x_mm", "y_mm", "z_mm")
PLACE_COLUMNS: Final = tuple(f"place_{name}" for name in POINT_COLUMNS)
STATION_COLUMNS: Final = (*(f"station_{name}" for name in POINT_COLUMNS), *(f"station_{a}_deg" for a in "abc"))
ANGLE_COLUMNS: Final = ("a_urad", "b_urad")
CONTACT_COLUMNS: Final = tuple(f"contact_{name}" for name in POINT_COLUMNS)
ANGULAR: Final = "level"
DECIMALS: Final = 6
"""Decimals of a simulated reading in mm. Rounding in double precision, which differs from one processor to another, is a millionth of
this nanometre: from one seed, the readings in a file are the same to the last digit."""
"""Instrument of the rows that give angles and name none."""
PLANNED: Final = "planned_"
"""Prefix of a place column that gives where a target or station is meant to be. Only plans have it; no evaluation uses it."""
SIMULATED: Final = "simulated"
"""First word of the comment in a table of simulated readings."""
ONE_DIMENSIONAL: Final = ("time_s", "feed_mm_min")
"""Numeric fields that are one-dimensional arrays."""


class TableColumns(NamedTuple):
    """Columns of the file that make up one field of `Measurements`.

    Attributes:
        field: name of the field.
        columns: names of the columns; one for a one-dimensional field.
        kind: kind of the cells.
        default: word that stands for an empty cell.
        needed: whether the columns are always written.
    """

    field: str
    columns: tuple[str, ...]
    kind: Literal["numbers", "signs", "words"] = "numbers"
    default: str = ""
    needed: bool = False

    def read(self, cells: Cells) -> np.ndarray:
        """Return the field from the cells of a file."""
        if self.kind == "words":
            return cells.words(self.columns[0], self.default)
        columns = [getattr(cells, self.kind)(name) for name in self.columns]
        return columns[0] if self.field in ONE_DIMENSIONAL else read_only(np.stack(columns, axis=1))

    def written(self, values: np.ndarray) -> dict[str, Sequence[str]]:
        """Return the columns of a file from the field, without those that have no value."""
        if self.kind == "words":
            return {self.columns[0]: list(values)} if self.needed or np.any(values != self.default) else {}
        by_name = dict(zip(self.columns, values.reshape(len(values), -1).T, strict=True))
        if self.kind == "signs":
            return {name: [str(int(value)) for value in column] for name, column in by_name.items() if np.any(column)}
        return {name: number_cells(c) for name, c in by_name.items() if self.needed or np.isfinite(c).any()}


def table_columns(machine: Machine) -> tuple[TableColumns, ...]:
    """Return the columns of a table except temperatures, channels and places, in the order in which they are written."""
    axes = tuple(f"{axis.name}_{axis.unit}" for axis in machine.axes)
    return (
        TableColumns("positions", axes, needed=True),
        TableColumns("readback", tuple(f"readback_{name}" for name in axes)),
        TableColumns("target", ("target",), "words", needed=True),
        TableColumns("carrier", ("carrier",), "words", needed=True),
        TableColumns("point_mm", POINT_COLUMNS, needed=True),
        TableColumns("station", ("station",), "words", "1", needed=True),
        TableColumns("station_carrier", ("station_carrier",), "words", SIDES[0]),
        TableColumns("instrument", ("instrument",), "words"),
        TableColumns("round", ("round",), "words", "1", needed=True),
        TableColumns("time_s", ("time_s",)),
        TableColumns("approach", tuple(f"approach_{axis.name}" for axis in machine.axes), "signs"),
        TableColumns("temperature_degC", ()),
        TableColumns("feed_mm_min", ("feed_mm_min",)),
        TableColumns("u_mm", tuple(f"u_{name}" for name in POINT_COLUMNS)),
    )


def refuse_contacts(header: Sequence[str], needed: Sequence[str], path: Path, line: int) -> None:
    """Raise `InputError` if a table lacks columns because its rows are single contacts of a probe."""
    if not set(needed) <= set(header) and not {*CONTACT_COLUMNS}.isdisjoint(header):
        raise InputError(
            "these are single contacts of a probe, not measured points",
            expected="sphere centres: `twin convert` reduces the contacts to a table of centres",
            file=path,
            line=line,
            value=next(name for name in header if name in CONTACT_COLUMNS),
        )


def csv_text(columns: Mapping[str, Sequence[str]], comments: str) -> str:
    """Return a table as text: comment lines, header, rows."""
    text = io.StringIO()
    text.write(comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def number_cells(values: np.ndarray) -> list[str]:
    """Return numbers as cells, in the shortest form that reads back the same; empty for NaN."""
    return ["" if np.isnan(value) else repr(float(value)) for value in values]


def printed(values_mm: np.ndarray, *, simulated: bool) -> np.ndarray:
    """Return readings, mm, as a table prints them: those of instruments as they are, simulated ones with `DECIMALS`."""
    return np.round(values_mm, DECIMALS) + 0.0 if simulated else values_mm


def simulated_comments(comments: Sequence[str]) -> list[str]:
    """Return the comments of a table which state that its readings were simulated."""
    return [text for text in comments if text.lower().startswith(SIMULATED)]


def comment_lines(text: str, *, simulated: bool) -> str:
    """Return the comment lines that precede a table.

    ``simulated``: whether the readings were simulated; a comment that states it is then added if missing.
    """
    lines = text.splitlines()
    if simulated and not simulated_comments([line.lstrip("# ") for line in lines]):
        lines.insert(0, f"{SIMULATED} readings")
    return "".join(f"# {line}\n" for line in lines)


def with_angles(cells: Cells, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a table with angles: tilts (a, b) of a target as the shift (b, −a) of the end of a line of 1 m.

    ``values``: the fields read so far: ``point_mm``, ``u_mm`` and ``instrument``, whose name is ``level`` where angles are given.
    """
    angle, u = (np.stack([cells.numbers(f"{p}{name}") for name in ANGLE_COLUMNS], axis=1) for p in ("", "u_"))
    rows = np.isfinite(angle).any(axis=1)
    point, u_mm, names = (np.array(values[name]) for name in ("point_mm", "u_mm", "instrument"))
    point[rows, 2] = u_mm[rows, 2] = np.nan
    point[rows, :2] = angle[rows, ::-1] * np.array([1.0, -1.0]) * UM / MM
    u_mm[rows, :2] = u[rows, ::-1] * UM / MM
    names[rows & (names == "")] = ANGULAR
    return {"point_mm": read_only(point), "u_mm": read_only(u_mm), "instrument": read_only(names)}


def angle_columns(point_mm: np.ndarray, u_mm: np.ndarray, rows: np.ndarray) -> dict[str, Sequence[str]]:
    """Return the columns of angles of some rows (n,), the inverse of `with_angles`; none if there are no such rows."""
    angle_columns: dict[str, Sequence[str]] = {}
    angle = np.where(rows[:, None], point_mm[:, 1::-1] * np.array([-1.0, 1.0]), np.nan) * (MM / UM)
    u = np.where(rows[:, None], u_mm[:, 1::-1], np.nan) * (MM / UM)
    for prefix, values in (("", angle), ("u_", u)):
        if np.isfinite(values).any():
            angle_columns |= {
                f"{prefix}{n}": number_cells(column) for n, column in zip(ANGLE_COLUMNS, values.T, strict=True)
            }
    return angle_columns
