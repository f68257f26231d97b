"""Mirrored, exchanged and wrongly scaled coordinates: rigid fits of the readings to the tool points that the machine commands.

With positions ``t`` and orientations ``R`` of a target's carrier in the frame on which the station rides, a reading is
``m = s · O (R p + t) + o`` with unknown place ``p``, station ``o`` and orthogonal matrix ``O``. Differences within one target and one
orientation do not depend on ``p`` and ``o``. They give ``O``, proper (determinant +1) or improper (−1), from a singular value
decomposition (Kabsch, Acta Cryst. A32, 1976, 922; determinant and scale as Umeyama, IEEE Trans. PAMI 13, 1991, 376). A mirror is
reported only if the improper fit is far better. An exact symmetry cannot be resolved: a mirrored command and a mirrored reading differ
by a rotation of the station.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Final, NamedTuple, Protocol, final

import numpy as np

from twin._common.csv_tables import read_table
from twin._common.errors import InputError, closest_name
from twin._common.units import MM, count_with_noun
from twin.machine.machine import Axis, Machine
from twin.measurement.checks import RANGE_SLACK, SYSTEMATIC_ROWS
from twin.measurement.columns import table_columns
from twin.measurement.importing.cells import Layout
from twin.measurement.importing.headers import Unit, meaning_of, table_unit, unit_named, units_of
from twin.measurement.importing.mapping import PlanEntry
from twin.measurement.observation import observation_of
from twin.measurement.table import Measurements

RATIO: Final = 10.0
"""Ratio of RMS residuals from which the other fit is reported."""
LEAST_RMS_MM: Final = 0.5
"""RMS residual below which no mirror is reported: the errors of a machine are smaller."""
LEAST_SPREAD_MM: Final = 1.0
"""Least RMS extent of the commanded points in their thinnest direction."""
FEWEST_ROWS: Final = 8
SCALES: Final = {"m": 1e-3, "um": 1e3, "cm": 0.1, "inch": 1.0 / 25.4}
"""Ratio of readings to millimetres, by the unit that explains it."""
SCALE_TOLERANCE: Final = 0.02
ALIGNED: Final = 0.25
"""Largest deviation of a matrix from a signed permutation that counts as aligned with the machine's axes."""


@final
@dataclass(frozen=True)
class FrameRows:
    """Commands and readings of a table, before it is checked.

    Attributes:
        positions: (n, axes) commanded, mm and degrees; NaN where missing.
        point_mm: (n, 3) readings; NaN where missing.
        carrier, station_carrier, station, target: (n,) names.
    """

    positions: np.ndarray
    point_mm: np.ndarray
    carrier: np.ndarray
    station_carrier: np.ndarray
    station: np.ndarray
    target: np.ndarray

    def select(self, rows: np.ndarray) -> FrameRows:
        """Return some of the rows (a mask or indices)."""
        return FrameRows(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


class FrameFinding(NamedTuple):
    """A sign, order or unit of coordinates that seems to be wrong.

    Attributes:
        text: the finding with its numbers, one sentence.
        columns: columns of the measurement table that it concerns.
        advice: comment for the entries of these columns in a mapping file.
    """

    text: str
    columns: tuple[str, ...]
    advice: str


class RigidFit(NamedTuple):
    """Fit of the readings of one station to the commanded points.

    Attributes:
        matrix: (3, 3) improper or proper orthogonal matrix, from commanded to measured differences.
        scale: ratio of measured to commanded distances.
        residual_mm: (n,) length of each residual, in millimetres of the commanded points.
    """

    matrix: np.ndarray
    scale: float
    residual_mm: np.ndarray

    @property
    def rms_mm(self) -> float:
        """RMS residual."""
        return float(np.sqrt(np.mean(self.residual_mm**2)))


def carrier_poses(machine: Machine, rows: FrameRows) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3, 3) orientations and (n, 3) positions, mm, of the targets' carriers in the frames on which the stations ride."""
    n = len(rows.positions)
    no_errors, origin = np.zeros((n, 6 * len(machine.frames))), np.zeros((n, 3))
    found = observation_of(machine).carried(
        rows.positions * machine.scale, no_errors, rows.carrier, origin, rows.station_carrier
    )
    return found.rotation, found.points / MM


def usable(rows: FrameRows) -> np.ndarray:
    """Return (n,) whether a row has all commands, all three coordinates, and known sides."""
    sides = np.isin(rows.carrier, ("tool", "work")) & np.isin(rows.station_carrier, ("base", "tool", "work"))
    return np.isfinite(rows.positions).all(axis=1) & np.isfinite(rows.point_mm).all(axis=1) & sides


def rigid_fits(machine: Machine, rows: FrameRows) -> tuple[RigidFit, RigidFit] | None:
    """Return the proper and the improper fit of one station's rows; None if the commanded points do not span space.

    Args:
        machine: the machine.
        rows: usable rows of one station.
    """
    rotation, translation = carrier_poses(machine, rows)
    keys = [f"{t}\0".encode() + np.round(r, 6).tobytes() for t, r in zip(rows.target, rotation + 0.0, strict=True)]
    commanded, measured = np.array(translation), np.array(rows.point_mm)
    group = np.unique(np.array(keys, dtype=object), return_inverse=True)[1]
    for one in range(group.max() + 1 if len(group) else 0):
        of = group == one
        commanded[of] -= commanded[of].mean(axis=0)
        measured[of] -= measured[of].mean(axis=0)
    of = np.bincount(group, minlength=1)[group] > 1 if len(group) else np.zeros(0, dtype=bool)
    commanded, measured = commanded[of], measured[of]
    if len(commanded) < FEWEST_ROWS:
        return None
    spread = np.linalg.svd(commanded, compute_uv=False) / np.sqrt(len(commanded))
    if spread[-1] < LEAST_SPREAD_MM or not np.any(measured):
        return None
    u, values, vt = np.linalg.svd(measured.T @ commanded)
    fits = []
    for determinant in (1.0, -1.0):
        last = np.sign(np.linalg.det(u @ vt)) * determinant
        matrix = u @ np.diag([1.0, 1.0, last]) @ vt
        scale = float(values @ [1.0, 1.0, last]) / float(np.sum(commanded**2))
        rest = measured / scale - commanded @ matrix.T if scale > 0.0 else commanded
        fits.append(RigidFit(matrix, scale, np.linalg.norm(rest, axis=1)))
    return fits[0], fits[1]


def is_far_better(other_mm: float, own_mm: float) -> bool:
    """Return whether another fit has residuals so much smaller that it is reported."""
    return own_mm > LEAST_RMS_MM and own_mm > RATIO * other_mm


def findings(machine: Machine, rows: FrameRows) -> list[FrameFinding]:
    """Return a finding for each sign, order or unit of coordinates that seems to be wrong; empty if the data show none."""
    by_range = {
        axis.name: text for axis, q in zip(machine.axes, rows.positions.T, strict=True) if (text := _mirrored(axis, q))
    }
    found = [FrameFinding(text, (_command(machine.by_name[name]),), "sign: -1?") for name, text in by_range.items()]
    signs = np.array([-1.0 if axis.name in by_range else 1.0 for axis in machine.axes])
    rows = replace(rows.select(usable(rows)), positions=rows.positions[usable(rows)] * signs)
    stations = list(dict.fromkeys(rows.station))
    for station in stations:
        own = _station_findings(machine, rows.select(rows.station == station))
        found += [one._replace(text=f"station {station}: {one.text}") if len(stations) > 1 else one for one in own]
    return found


def _command(axis: Axis) -> str:
    return f"{axis.name}_{axis.unit}"


def _station_findings(machine: Machine, rows: FrameRows) -> list[FrameFinding]:
    fits = rigid_fits(machine, rows)
    if fits is None:
        return []
    proper, improper = fits
    mirrored = is_far_better(improper.rms_mm, proper.rms_mm)
    best = improper if mirrored else proper
    found = [_mirror_finding(proper, improper)] if mirrored else []
    unit = next((name for name, ratio in SCALES.items() if abs(best.scale / ratio - 1.0) < SCALE_TOLERANCE), None)
    if unit is not None:
        text = f"x, y, z look like {unit}: their distances are {best.scale:.4g} times the commanded ones in mm"
        found.append(FrameFinding(text, ("x_mm", "y_mm", "z_mm"), f"unit: {unit}?"))
    return found + _rotary_findings(machine, rows, best)


def _mirrored(axis: Axis, q: np.ndarray) -> str:
    """Return a sentence if the positions of an axis are within its range with the opposite sign only; empty otherwise."""
    if axis.lower is None or axis.upper is None:
        return ""
    own = q[np.isfinite(q)]
    outside = [
        (sign * own < axis.lower - RANGE_SLACK) | (sign * own > axis.upper + RANGE_SLACK) for sign in (1.0, -1.0)
    ]
    count = np.count_nonzero(outside[0])
    if len(own) < SYSTEMATIC_ROWS or 2 * count < len(own) or np.any(outside[1]):
        return ""
    return (
        f"{axis.name} seems to be mirrored: {count} of {count_with_noun(len(own), 'row')} are outside the range of {axis.name}, "
        f"{axis.lower:g} … {axis.upper:g} {axis.unit}, and none with −{axis.name}"
    )


def _mirror_finding(proper: RigidFit, improper: RigidFit) -> FrameFinding:
    better = np.count_nonzero(improper.residual_mm < proper.residual_mm)
    size = f"RMS residual {improper.rms_mm:.3g} mm instead of {proper.rms_mm:.3g} mm"
    of = f"{better} of {count_with_noun(len(proper.residual_mm), 'row')} fit better"
    nearest = np.round(improper.matrix)
    # The letters are those of the readings: the same data with a mirrored command differ by a rotation of the station.
    if np.max(np.abs(improper.matrix - nearest)) < ALIGNED and abs(np.linalg.det(nearest)) > 0.5:
        negative = ["xyz"[i] for i in range(3) if nearest[i].sum() < 0]
        swapped = [
            f"{'xyz'[i]} and {'xyz'[j]}" for i, j in combinations(range(3), 2) if nearest[i, j] and nearest[j, i]
        ]
        if not swapped and len(negative) == 1:
            (name,) = negative
            return FrameFinding(f"{name} seems to be mirrored: {of} with −{name}; {size}", (f"{name}_mm",), "sign: -1?")
        if len(swapped) == 1 and not negative:
            pair = (f"{swapped[0][0]}_mm", f"{swapped[0][-1]}_mm")
            return FrameFinding(
                f"{swapped[0]} seem to be exchanged: {of} with exchanged columns; {size}", pair, "exchanged?"
            )
    text = (
        f"the coordinates seem to be mirrored: {of} in a frame of the other hand; {size}. "
        "The data do not show which one: one of x, y, z (or of the commanded linear axes) has the opposite sign, or two are exchanged"
    )
    return FrameFinding(text, ("x_mm", "y_mm", "z_mm"), "sign: -1 on one of them?")


def _rotary_findings(machine: Machine, rows: FrameRows, fit: RigidFit) -> list[FrameFinding]:
    """Return a finding if the readings fit only with the opposite sign of one or two rotary axes."""
    moving = [i for i in machine.rotary if np.ptp(rows.positions[:, i]) > 1.0]
    own = _placed_rms_mm(machine, rows, fit)
    if not moving or own < LEAST_RMS_MM:
        return []
    tried: dict[tuple[int, ...], float] = {}
    for axes in (*((i,) for i in moving), *combinations(moving, 2)):
        positions = np.array(rows.positions)
        positions[:, list(axes)] *= -1.0
        tried[axes] = _placed_rms_mm(machine, replace(rows, positions=positions), fit)
    best = min(tried, key=lambda axes: tried[axes])
    if not is_far_better(tried[best], own):
        return []
    names = " and ".join(machine.names[i] for i in best)
    verb = "seems" if len(best) == 1 else "seem"
    signs = " and ".join(f"−{machine.names[i]}" for i in best)
    text = (
        f"{names} {verb} to be mirrored: {count_with_noun(len(rows.positions), 'row')} fit with {signs}; "
        f"RMS residual {tried[best]:.3g} mm instead of {own:.3g} mm"
    )
    return [FrameFinding(text, tuple(_command(machine.axes[i]) for i in best), "sign: -1?")]


def _placed_rms_mm(machine: Machine, rows: FrameRows, fit: RigidFit) -> float:
    """Return the RMS residual of readings with the station's orientation known, places of targets and of the station fitted."""
    rotation, translation = carrier_poses(machine, rows)
    wanted = rows.point_mm @ fit.matrix / fit.scale - translation
    names: Sequence[str] = list(dict.fromkeys(rows.target))
    place: Mapping[str, int] = {name: k for k, name in enumerate(names)}
    design = np.zeros((len(wanted), 3, 3 * len(names) + 3))
    for i, name in enumerate(rows.target):
        design[i, :, 3 * place[name] : 3 * place[name] + 3] = rotation[i]
        design[i, :, -3:] = np.eye(3)
    matrix, right = design.reshape(-1, design.shape[2]), wanted.ravel()
    rest = right - matrix @ np.linalg.lstsq(matrix, right, rcond=None)[0]
    return float(np.sqrt(np.sum(rest**2) / len(wanted)))


# --- Units of columns: as the file states them, else from the size of the numbers compared with the machine's ranges

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


# --- Rows of a plan for the rows of a file: matched by the names of points, or by their order -----

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
