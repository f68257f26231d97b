"""Units of columns: as the file states them, else from the size of the numbers compared with the machine's ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.measurement.checks import RANGE_SLACK
from twin.measurement.importing.cells import Layout
from twin.measurement.importing.headers import Unit, table_unit, unit_named, units_of

LEAST_SHARE: Final = 0.02
"""Share of an axis's range that positions must span in a unit for that unit to be likely."""
LARGEST_U_MM: Final = 0.2
"""Uncertainty beyond which a number without a unit is taken as micrometres."""
LENGTHS: Final = ("mm", "m", "inch", "um")
ANGLES: Final = ("deg", "rad", "mrad")


class Columns(Protocol):
    """A proposal whose units are determined."""

    layout: Layout
    machine: Machine

    def values(self, name: str) -> np.ndarray:
        """Return the numbers of a column of the file."""

    def assume(self, text: str, column: str, remark: str = "check") -> None:
        """Add an assumption."""


def unit_by_size(found: Columns, sources: Mapping[str, tuple[str, str]]) -> dict[str, str]:
    """Return the unit of every column, and add an assumption for each one that the file does not state.

    Args:
        found: the proposal.
        sources: column of the file and unit in its header (empty if none), by column of the measurement table.
    """
    units: dict[str, str] = {}
    missing: dict[str, str] = {}
    for column, (name, stated) in sources.items():
        below = found.layout.units[found.layout.names.index(name)]
        fitting = [unit for text in (stated, below) if (unit := _fitting(text, column)) is not None]
        if fitting:
            units[column] = fitting[0].name
            if len({unit.name for unit in fitting}) > 1:
                found.assume(
                    f"'{name}' is in {fitting[0].name}: its header and the row of units differ", column, "unit"
                )
        elif table_unit(column) and name != column:
            missing[column] = name
            if stated or below:
                found.assume(f"the unit '{stated or below}' of '{name}' does not fit {column}", column, "unit")
    for columns in _families(missing, found.machine):
        name, why = _likely(found, columns, missing, units)
        units |= dict.fromkeys(columns, name)
        if not any(np.nan_to_num(found.values(missing[column])).any() for column in columns):
            continue  # zero in any unit
        names = ", ".join(f"'{missing[column]}'" for column in columns)
        found.assume(f"no unit is given for {names}: {name}{why}", columns[0], "unit")
    return units


def _fitting(text: str, column: str) -> Unit | None:
    """Return a unit by its spelling if a column can have it."""
    unit = unit_named(text) if text else None
    return unit if unit is not None and unit in units_of(column) else None


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
