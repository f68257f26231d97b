"""The columns of a measurement table: which field each belongs to, how its cells are read and written."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Final, Literal, NamedTuple

import numpy as np

from twin._common.arrays import locked
from twin._common.csv_tables import Cells
from twin.machine.machine import Machine
from twin.measurement.instruments.base import SIDES

CARRIERS: Final = ("tool", "work")
POINT_COLUMNS: Final = ("x_mm", "y_mm", "z_mm")
PLACE_COLUMNS: Final = tuple(f"place_{name}" for name in POINT_COLUMNS)
STATION_COLUMNS: Final = (*(f"station_{name}" for name in POINT_COLUMNS), *(f"station_{a}_deg" for a in "abc"))
PLANNED: Final = "planned_"
"""Before the name of such a column: where a target or station is meant to go. A plan's; no evaluation takes it for known."""
SIMULATED: Final = "simulated"
"""What the comment of a simulated table begins with."""
FLAT: Final = ("time_s", "feed_mm_min")
"""Fields of numbers of one dimension."""


class TableColumns(NamedTuple):
    """Columns of the file that make one field of `Measurements`.

    Attributes:
        field: its name.
        columns: of the file; one for a field of one dimension.
        kind: what the cells are.
        default: a word where a cell is empty.
        needed: whether the columns are always written.
    """

    field: str
    columns: tuple[str, ...]
    kind: Literal["numbers", "signs", "words"] = "numbers"
    default: str = ""
    needed: bool = False

    def read(self, cells: Cells) -> np.ndarray:
        """The field from the cells of a file."""
        if self.kind == "words":
            return cells.words(self.columns[0], self.default)
        columns = [getattr(cells, self.kind)(name) for name in self.columns]
        return columns[0] if self.field in FLAT else locked(np.stack(columns, axis=1))

    def written(self, values: np.ndarray) -> dict[str, Sequence[str]]:
        """The columns of a file from the field; without those that have no value."""
        if self.kind == "words":
            return {self.columns[0]: list(values)} if self.needed or np.any(values != self.default) else {}
        by_name = dict(zip(self.columns, values.reshape(len(values), -1).T, strict=True))
        if self.kind == "signs":
            return {name: [str(int(value)) for value in column] for name, column in by_name.items() if np.any(column)}
        return {name: printed(c) for name, c in by_name.items() if self.needed or np.isfinite(c).any()}


def parts_of(machine: Machine) -> tuple[TableColumns, ...]:
    """All columns but temperatures and places, in the order in which they are written."""
    axes = tuple(f"{axis.name}_{axis.unit}" for axis in machine.axes)
    return (
        TableColumns("positions", axes, needed=True),
        TableColumns("readback", tuple(f"readback_{name}" for name in axes)),
        TableColumns("target", ("target",), "words", needed=True),
        TableColumns("carrier", ("carrier",), "words", needed=True),
        TableColumns("point_mm", POINT_COLUMNS, needed=True),
        TableColumns("station", ("station",), "words", "1", needed=True),
        TableColumns("station_carrier", ("station_carrier",), "words", SIDES[0]),
        TableColumns("round", ("round",), "words", "1", needed=True),
        TableColumns("time_s", ("time_s",)),
        TableColumns("approach", tuple(f"approach_{axis.name}" for axis in machine.axes), "signs"),
        TableColumns("temperature_degC", ()),
        TableColumns("feed_mm_min", ("feed_mm_min",)),
        TableColumns("u_mm", tuple(f"u_{name}" for name in POINT_COLUMNS)),
    )


def csv_text(columns: Mapping[str, Sequence[str]], comments: str) -> str:
    """Return a table as text: comment lines, the header, the rows."""
    text = io.StringIO()
    text.write(comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def printed(values: np.ndarray) -> list[str]:
    """Return the cells of numbers, shortest form that reads back the same; empty for NaN."""
    return ["" if np.isnan(value) else repr(float(value)) for value in values]


def says_simulated(comments: Sequence[str]) -> list[str]:
    """Return those comments of a table that say its readings were simulated."""
    return [text for text in comments if text.lower().startswith(SIMULATED)]


def comments_of(text: str, *, simulated: bool) -> str:
    """Return the comment lines that stand before a table.

    Args:
        text: the lines.
        simulated: whether the readings were simulated: then one of the lines says so.
    """
    lines = text.splitlines()
    if simulated and not says_simulated([line.lstrip("# ") for line in lines]):
        lines.insert(0, f"{SIMULATED} readings")
    return "".join(f"# {line}\n" for line in lines)
