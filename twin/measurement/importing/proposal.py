"""A mapping in the making, with its assumptions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.measurement.importing.decimals import POINT, SIGNS, decimal_value
from twin.measurement.importing.layout import Layout
from twin.measurement.importing.mapping import ColumnMapping, ColumnsFile, OriginEntry, PlanEntry
from twin.measurement.importing.plan_rows import PlanPoints


@final
@dataclass
class Proposal:
    """A mapping in the making.

    Attributes:
        layout: the file.
        machine: the machine.
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
        found = [decimal_value(cell, self.sign) if cell else None for cell in self.layout.column(name)]
        return np.array([np.nan if value is None else float(value) for value in found])


def quoted(names: Sequence[str]) -> str:
    """Return names in quotes, separated by commas."""
    return ", ".join(f"'{name}'" for name in names)


def axis_columns(machine: Machine) -> dict[str, Axis]:
    """Return the columns of commanded positions, each with its axis."""
    return {f"{axis.name}_{axis.unit}": axis for axis in machine.axes}
