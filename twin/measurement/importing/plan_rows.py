"""Rows of a plan for the rows of a file: matched by the names of points, or by their order."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.counts import count_with_noun
from twin._common.csv_tables import read_table
from twin._common.errors import InputError, closest_name
from twin.machine.machine import Machine
from twin.measurement.columns import table_columns
from twin.measurement.importing.headers import meaning_of
from twin.measurement.importing.layout import Layout
from twin.measurement.importing.mapping import PlanEntry
from twin.measurement.table import Measurements

FIELDS: Final = ("positions", "target", "carrier", "station", "station_carrier", "instrument", "round", "approach")
"""Fields of a measurement table that a plan gives."""


@final
@dataclass(frozen=True)
class PlanPoints:
    """A plan with the names of its points.

    Attributes:
        table: its rows.
        points: (n) name of each point; empty if the plan has no such column.
    """

    table: Measurements
    points: tuple[str, ...]

    @classmethod
    def load(cls, path: Path, machine: Machine) -> PlanPoints:
        """Read a plan.

        Raises:
            InputError: it is not a plan, or some of its rows cannot be used.
        """
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
        return bool(self.points) and len(set(self.points)) == len(self.points) and {*names} <= {*self.points}

    def rows_for(self, layout: Layout, entry: PlanEntry) -> np.ndarray:
        """Return (n,) the row of the plan for each row of a file.

        Raises:
            InputError: the number of rows differs, or a row has a name that the plan does not have at its place.
        """
        if entry.match == "order":
            return self._by_order(layout)
        names = layout.column(entry.point) if entry.point in layout.names else []
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

    def columns(self, rows: np.ndarray, machine: Machine) -> dict[str, list[str]]:
        """Return the cells of the columns that the plan gives, for some of its rows."""
        found: dict[str, list[str]] = {}
        for part in table_columns(machine):
            if part.field in FIELDS:
                cells = part.written(getattr(self.table, part.field))
                found |= {name: [values[row] for row in rows] for name, values in cells.items()}
        return found

    @staticmethod
    def check_commands(
        own: dict[str, list[str]], given: dict[str, list[str]], layout: Layout, machine: Machine
    ) -> None:
        """Raise `InputError` for the first row whose commanded position or target differs from the plan's."""
        compared = given.keys() & {"target", *(f"{axis.name}_{axis.unit}" for axis in machine.axes)}
        for row, (line, _) in enumerate(layout.rows):
            for name in (name for name in own if name in compared):
                mine, planned = own[name][row], given[name][row]
                if mine and mine != planned and (name == "target" or _differ(mine, planned)):
                    raise InputError(
                        f"{name} is not that of the plan",
                        expected=f"{planned}, as in the plan",
                        file=layout.raw.path,
                        line=line,
                        value=mine,
                    )


def _differ(own: str, planned: str) -> bool:
    """Return whether two cells are numbers that differ by more than a rounded digit."""
    try:
        return abs(float(own) - float(planned)) > 0.002
    except ValueError:
        return False
