"""The measurement table: one row for each measured point, checked while it is read.

No row is dropped silently: a row that cannot be used is listed in `Measurements.set_aside` with its line and reason. Unknown columns,
rounds that lack points and the like are listed in `Measurements.notices`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError, closest_name, require_type
from twin._common.files import write_atomic
from twin._common.messages import Message, Number
from twin._common.units import count_with_noun
from twin.display import Cell, note, spans
from twin.display.results import Display, DisplayedResult
from twin.machine.machine import Machine
from twin.measurement.certificate import Artefact
from twin.measurement.columns import (
    ANGLE_COLUMNS,
    ANGULAR,
    CARRIERS,
    LARGEST_MM,
    PLACE_COLUMNS,
    PLANNED,
    POINT_COLUMNS,
    STATION_COLUMNS,
    RowNote,
    TableColumns,
    angle_columns,
    check_ranges,
    comment_lines,
    copied_rows,
    csv_text,
    grouped_notes,
    missing_rounds,
    number_cells,
    outside_axis_range,
    place_by_name,
    printed,
    refuse_contacts,
    simulated_comments,
    table_columns,
    unused_names,
    with_angles,
)
from twin.measurement.instruments import INSTRUMENTS, SIDES
from twin.model.effects.base import LOAD

COMMENT: Final = "ball bar length"
"""First words of the comment of a table that states the length: ``# ball bar length: 150 mm``."""
BARS: Final = tuple(one.name for one in INSTRUMENTS if one.specification.nominal_length)
"""Names of the instruments with a nominal length."""


def stated_length_mm(comments: Sequence[str], path: Path) -> float | None:
    """Return the length that the comments of a table state, mm; None if they state none.

    Raises `InputError`: a length that cannot be read, or two different lengths.
    """
    found: dict[float, str] = {}
    for text in comments:
        if not text.lower().startswith(COMMENT):
            continue
        match = re.fullmatch(r"\s*:\s*(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*mm\s*", text[len(COMMENT) :])
        value = float(match[1]) if match else 0.0
        if not 0.0 < value < 1e6:
            raise InputError(
                "the length of the ball bar cannot be read", expected=f"{COMMENT}: 150 mm", file=path, value=text
            )
        found[value] = text
    if len(found) > 1:
        raise InputError(
            f"the table states different lengths of the ball bar: {_listed(found)}",
            expected="one length; readings of another bar belong in another table",
            file=path,
        )
    return next(iter(found), None)


def length_comment(bar_mm: np.ndarray) -> list[str]:
    """Return the comment that states the length of a table's ball bar, as a list; empty if it has none.

    ``bar_mm``: (n,) nominal lengths, mm; NaN where there is none.

    Raises `InputError`: rows with different lengths.
    """
    lengths = np.unique(bar_mm[np.isfinite(bar_mm)]).tolist()
    if len(lengths) > 1:
        raise InputError(
            f"ball bars of different lengths: {_listed(lengths)}", expected="one table for each length of the ball bar"
        )
    return [f"{COMMENT}: {length:.12g} mm" for length in lengths]


def with_length(values: Mapping[str, Any], length_mm: float) -> tuple[dict[str, Any], tuple[Message, ...]]:
    """Return the fields of a table that the length of its ball bar changes, and what to note.

    The rows of the ball bar are those that name it, and those without an instrument that read a length alone from a station on the
    tool or work side. Readings below half of the length are deviations from it, to which it is added.

    ``values``: the fields ``point_mm``, ``instrument``, ``station_carrier`` and ``bar_mm`` (NaN or absent where no length is known).

    Raises `InputError`: a row that already has another length.
    """
    point, names = np.array(values["point_mm"]), np.asarray(values["instrument"]).astype(str)
    alone = np.isnan(point[:, 1:]).all(axis=1) & (values["station_carrier"] != SIDES[0])
    rows = np.isin(names, BARS) | ((names == "") & alone)
    bar = np.array(values.get("bar_mm", np.full(len(point), np.nan)))
    other = bar[rows & np.isfinite(bar) & (bar != length_mm)]
    if len(other):
        raise InputError(
            f"two lengths of the ball bar: {other[0]:.12g} mm in the table, {length_mm:.12g} mm given",
            expected="the length of the table, or no length in the table",
        )
    bar[rows] = length_mm
    deviations = rows & (point[:, 0] < length_mm / 2.0)
    point[deviations, 0] += length_mm
    note = Message(
        "lengths near zero count as deviations from the ball bar's length of {length_mm:.12g} mm", length_mm=length_mm
    )
    return {"point_mm": read_only(point), "bar_mm": read_only(bar)}, (note,) if deviations.any() else ()


def _listed(lengths: Sequence[float] | Mapping[float, str]) -> str:
    return " and ".join(f"{length:.12g} mm" for length in lengths)


# --- The measurement table: one row for each measured point, checked while it is read -------------

FEWEST_POINTS: Final = 3
"""Least number of points of a station from which its pose can be determined."""
UNIT_LENGTH: Final = 1e-4
SMALLEST_U_MM: Final = 1e-9
"""Stated standard uncertainty below which a row is set aside, so that weights stay finite; no instrument is that good."""
NOT_GIVEN: Final = read_only(np.zeros(0))
"""Placeholder for a column that a table does not have."""


def _absent() -> np.ndarray:
    return NOT_GIVEN


BY_COLUMN_NAME: Final = ("temperature_degC", "channels")
"""Fields that map a column's name to its values."""
CHANNEL: Final = re.compile(r"[A-Za-z]\w*_(rpm|kg|N|Nm|A|V|W|bar|percent|Hz|l_min)")
"""Names of further columns that are read as numbers: a quantity and its unit."""


@final
@dataclass(frozen=True, repr=False)
class Measurements(DisplayedResult):
    """Measured points and the state of the machine at each of them; arrays are read-only and have n rows.

    Attributes:
        source: the file, or another description of the source.
        lines: (n,) line of each row in the file.
        positions: (n, axes) commanded, mm and degrees, command order.
        readback: (n, axes) reported by the control; NaN where not given.
        target, carrier, station, round: (n,) names; carrier is ``tool`` or ``work``.
        point_mm: (n, 3) measured coordinates in the station's own frame; NaN for a coordinate that was not measured.
        u_mm: (n, 3) standard uncertainties; NaN where not given.
        time_s: (n,) NaN where not given.
        approach: (n, axes) direction of approach +1 or −1; 0 if unknown.
        place_mm: (n, 3) the target's place on its carrier (tool: frame of the spindle nose; work: work frame); NaN where unknown.
        station_carrier: (n,) side on which the station rides: ``base``, ``tool`` or ``work``.
        instrument: (n,) name of the station's instrument (`twin.measurement.instruments`); empty where not given.
        station_pose: (n, 6) the station's origin in the frame on which it rides, mm, and rotation vector, degrees; NaN where unknown.
        temperature_degC: (n,) temperatures by axis or sensor; NaN where not given.
        channels: (n,) other columns that an effect may use, by column name (``spindle_rpm``); NaN where not given.
        set_aside: rows of the file that are not used, and why.
        notices: facts to know before using a result.
        simulated: whether any of the readings were simulated, not measured on a machine.
        feed_mm_min: (n,) feed along the path when the point was taken, mm/min; NaN where not given.
        bar_mm: (n,) nominal length of the ball bar, from a comment of the file; NaN where not given.
        along: (n, 3) unit vector in the station's frame along which x_mm was read: the normal of a surface that was cut; NaN where the
            coordinates are those along the station's own axes.
        tool: (n,) name of the tool that cut the point; empty where none did.
        by_tool: (n, 3) change of the reading by that tool's radius and length, in mm/mm, and by its deflection under one unit of its
            engagement; NaN where no tool cut.
        artefacts: known distances between targets, or their coordinates, from calibration certificates; `twin.identify` uses them.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.thesis_plan.plan(machine)
        >>> along_x = plan.select(plan.approach[:, 0] != 0)
        >>> along_x.save("along_x.csv", machine)
        >>> len(plan), len(twin.Measurements.load("along_x.csv", machine, plan=True))
        (840, 132)
    """

    source: str
    lines: np.ndarray
    positions: np.ndarray
    target: np.ndarray
    carrier: np.ndarray
    readback: np.ndarray = field(default_factory=_absent)
    station: np.ndarray = field(default_factory=_absent)
    station_carrier: np.ndarray = field(default_factory=_absent)
    instrument: np.ndarray = field(default_factory=_absent)
    round: np.ndarray = field(default_factory=_absent)
    point_mm: np.ndarray = field(default_factory=_absent)
    u_mm: np.ndarray = field(default_factory=_absent)
    time_s: np.ndarray = field(default_factory=_absent)
    approach: np.ndarray = field(default_factory=_absent)
    place_mm: np.ndarray = field(default_factory=_absent)
    station_pose: np.ndarray = field(default_factory=_absent)
    temperature_degC: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    channels: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    set_aside: tuple[RowNote, ...] = ()
    notices: tuple[Message, ...] = ()
    simulated: bool = False
    feed_mm_min: np.ndarray = field(default_factory=_absent)
    bar_mm: np.ndarray = field(default_factory=_absent)
    artefacts: tuple[Artefact, ...] = ()
    along: np.ndarray = field(default_factory=_absent)
    tool: np.ndarray = field(default_factory=_absent)
    by_tool: np.ndarray = field(default_factory=_absent)

    def __post_init__(self) -> None:
        """Fill in the fields that were not given."""
        n, axes = np.shape(self.positions)
        blank: dict[str, tuple[tuple[int, ...], object]] = {
            "readback": ((n, axes), np.nan),
            "station": ((n,), "1"),
            "station_carrier": ((n,), SIDES[0]),
            "instrument": ((n,), ""),
            "round": ((n,), "1"),
            "point_mm": ((n, 3), np.nan),
            "u_mm": ((n, 3), np.nan),
            "time_s": ((n,), np.nan),
            "approach": ((n, axes), 0.0),
            "place_mm": ((n, 3), np.nan),
            "station_pose": ((n, 6), np.nan),
            "feed_mm_min": ((n,), np.nan),
            "bar_mm": ((n,), np.nan),
            "along": ((n, 3), np.nan),
            "tool": ((n,), ""),
            "by_tool": ((n, 3), np.nan),
        }
        for name, (shape, value) in blank.items():
            if getattr(self, name) is NOT_GIVEN:
                kind = object if isinstance(value, str) else float
                object.__setattr__(self, name, read_only(np.full(shape, value, dtype=kind)))

    @classmethod
    def load(cls, path: str | Path, machine: Machine, *, plan: bool = False) -> Measurements:
        """Read and check a measurement table.

        Args:
            machine: the machine that was measured.
            plan: whether the table is a plan: its coordinates are not read and their columns may be missing.

        Raises:
            InputError: with file, line and value, if the file is not a measurement table: no header, a missing column, a cell that is
                not a number, an unknown carrier, a target that changes sides or has two places, a station with two poses, an incomplete
                place or pose, positions with a constant offset or in another unit.
        """
        require_type("machine", machine, Machine)
        table, unknown_cells = cls._read(Path(path), machine, plan=plan)
        return without_unusable_rows(_with_known_places(table), machine, unknown_cells)

    @classmethod
    def _read(cls, path: Path, machine: Machine, *, plan: bool) -> tuple[Measurements, Sequence[str]]:
        """Return a table with all rows, usable or not, and the cells of unknown columns in each row; errors as `load`."""
        header, rows, comments = read_table(path)
        simulated_notes, parts = simulated_comments(comments), table_columns(machine)
        columns = {name: i for i, name in enumerate(header)}
        angular = any(name in columns for name in ANGLE_COLUMNS)
        needed = [*parts[0].columns, "target", "carrier", *(() if plan or angular else POINT_COLUMNS)]
        _check_header(header, needed, path, rows[0][0] - 1 if rows else 1)
        reader = Cells(path, columns, rows)
        temperatures = {name[2:-5]: reader.numbers(name) for name in header if re.fullmatch("T_.*_degC", name)}
        places = (*PLACE_COLUMNS, *STATION_COLUMNS)
        known = {name for part in parts for name in part.columns} | {f"T_{name}_degC" for name in temperatures}
        known |= {
            *places,
            *ANGLE_COLUMNS,
            *(f"u_{name}" for name in ANGLE_COLUMNS),
            *(f"{PLANNED}{name}" for name in places),
        }
        channels = {name: reader.numbers(name) for name in header if name not in known and CHANNEL.fullmatch(name)}
        if LOAD in channels:
            reader.refuse(channels[LOAD] < 0.0, channels[LOAD], LOAD, "the mass that is carried, 0 kg or above")
        unknown_columns = [name for name in header if name not in known and name not in channels]
        values, notices = _fields(reader, parts, comments)
        if plan:
            values["point_mm"] = read_only(np.zeros((len(rows), 3)))
        table = cls(
            source=str(path),
            lines=read_only(np.array([line for line, _ in rows], dtype=int)),
            **values,
            place_mm=_places(reader, PLACE_COLUMNS, planned=plan),
            station_pose=_places(reader, STATION_COLUMNS, planned=plan),
            temperature_degC=MappingProxyType(temperatures),
            channels=MappingProxyType(channels),
            notices=(
                *(Message("the file says: {text}", text=text) for text in simulated_notes),
                *notices,
                *(unused_column_note(name, sorted(known)) for name in unknown_columns),
            ),
            simulated=bool(simulated_notes),
        )
        if not rows:
            raise InputError("no measured point", expected="one row for each point below the header", file=path)
        _check_names(table)
        _check_directions(table)
        unknown_cells = (
            ["\0".join(row[columns[name]] for name in unknown_columns) for _, row in rows] if unknown_columns else ()
        )
        return table, unknown_cells

    @classmethod
    def join(cls, tables: Sequence[Measurements]) -> Measurements:
        """Join tables of one machine: the rounds of an export, or the readings of several instruments.

        Line numbers remain those of each file. A station that another table has on another side or with another instrument is another
        station: it and its rounds get the name of their file.

        Raises:
            InputError: no table, or a target or station whose place differs between tables.
        """
        if not tables:
            raise InputError("no measurements", expected="at least one table")
        tables = _with_own_stations(tables)
        first = tables[0]
        merged: dict[str, Any] = {
            name: read_only(np.concatenate([table.arrays()[name] for table in tables])) for name in first.arrays()
        }
        for field_name in BY_COLUMN_NAME:
            every = [getattr(table, field_name) for table in tables]
            merged[field_name] = MappingProxyType(
                {
                    name: read_only(
                        np.concatenate(
                            [o.get(name, np.full(len(t), np.nan)) for o, t in zip(every, tables, strict=True)]
                        )
                    )
                    for name in dict.fromkeys(name for own in every for name in own)
                }
            )
        table = replace(
            first,
            **merged,
            source=", ".join(dict.fromkeys(table.source for table in tables)),
            set_aside=tuple(note for table in tables for note in table.set_aside),
            notices=tuple(dict.fromkeys(notice for table in tables for notice in table.notices)),
            simulated=any(table.simulated for table in tables),
            artefacts=tuple(dict.fromkeys(one for table in tables for one in table.artefacts)),
        )
        return _with_known_places(table)

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def brief(self) -> str:
        """Numbers of readings, targets and stations, and the file."""
        of = f"{count_with_noun(len(set(self.target)), 'target')} from {count_with_noun(len(set(self.station)), 'station')}"
        return f"{count_with_noun(len(self), 'reading')} of {of}, {self.source}"

    def display(self) -> Display:
        """Return counts, names, ranges and notices."""
        ends = [(float(q.min()), float(q.max())) for q in self.positions.T] if len(self) else []
        reach = spans((f"axis {i + 1}:", low, high, "") for i, (low, high) in enumerate(ends))
        by_side = {
            side: dict.fromkeys(t for t, c in zip(self.target, self.carrier, strict=True) if c == side)
            for side in CARRIERS
        }
        stated = np.isfinite(self.u_mm)
        read = np.isfinite(self.point_mm)
        u = "not stated in the table"
        if stated.any():
            u = f"{1e3 * np.nanmin(self.u_mm):.2g} … {1e3 * np.nanmax(self.u_mm):.2g} µm (k = 1)"
            u += "" if stated[read].all() else ", unknown for some"
        rows: list[tuple[str, Cell]] = [
            ("coordinates read", f"{int(read.sum()):,}, mm" if read.any() else "none: a plan"),
            ("stated uncertainty", u if read.any() else ""),
            ("stations", ", ".join(map(str, dict.fromkeys(self.station)))),
            ("rounds", f"{len(set(self.round))}"),
            *((f"targets on the {side}", ", ".join(map(str, names))) for side, names in by_side.items()),
            ("commanded, in command order (mm, °)", reach),
            ("temperatures (°C)", ", ".join(self.temperature_degC)),
        ]
        aside = [note(f"set aside, {text}", loud=True) for text in grouped_notes(self.set_aside)]
        notices = [note(notice) for notice in self.notices]
        return Display(count_with_noun(len(self), "reading"), rows, below=(*aside, *notices), small=self.source)

    def moved(self, machine: Machine) -> list[str]:
        """Return the names of the axes that have more than one commanded position."""
        return [axis.name for axis, q in zip(machine.axes, self.positions.T, strict=True) if np.ptp(q) > 0.0]

    def error(
        self,
        what: str,
        *,
        expected: str,
        row: int | np.integer[Any] | None = None,
        value: object = None,
        nearest: str | None = None,
    ) -> InputError:
        """Return an `InputError` about this table, with its file and the line of a row."""
        line = None if row is None else int(self.lines[row])
        return InputError(what, expected=expected, file=self.source, line=line, value=value, nearest=nearest)

    def select(self, rows: np.ndarray) -> Measurements:
        """Return the table with some of its rows (indices or a mask)."""
        picked: dict[str, Any] = {name: read_only(values[rows]) for name, values in self.arrays().items()}
        for name in BY_COLUMN_NAME:
            some = {key: read_only(values[rows]) for key, values in getattr(self, name).items()}
            picked[name] = MappingProxyType(some)
        return replace(self, **picked)

    def arrays(self) -> dict[str, Any]:
        """Return every field that is an array of rows, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)}

    def save(self, path: str | Path, machine: Machine, *, comment: str = "", planned: Collection[str] = ()) -> None:
        """Write the table atomically, after it was read back; columns without any value are left out. Arguments as `to_csv`.

        Raises:
            InputError: it cannot be written, or is not a table that `load` reads. Too few rows, and rows that `load` would leave out,
                are written: they are what was measured.
        """
        plan = not np.isfinite(self.point_mm).any()
        write_atomic(
            Path(path),
            self.to_csv(machine, comment=comment, planned=planned),
            check=lambda written: Measurements._read(written, machine, plan=plan),
        )

    def to_csv(self, machine: Machine, *, comment: str = "", planned: Collection[str] = ()) -> str:
        """Return the table as text, which reads back as the same measurements. Without any coordinate it is a plan.

        Simulated readings are rounded, and with them the positions of the linear axes, which are the readings of a probe (`printed`).

        Args:
            comment: comment lines that precede the table.
            planned: names of targets and stations whose places are planned, not known (`PLANNED`).
        """
        angles = self.instrument == ANGULAR
        columns: dict[str, Sequence[str]] = {}
        read = {"point_mm": printed(self.point_mm, simulated=self.simulated), "positions": np.array(self.positions)}
        linear = list(machine.linear)
        read["positions"][:, linear] = printed(self.positions[:, linear], simulated=self.simulated)
        for part in table_columns(machine):
            if part.field == "temperature_degC":
                columns |= {f"T_{name}_degC": number_cells(values) for name, values in self.temperature_degC.items()}
                columns |= {name: number_cells(values) for name, values in self.channels.items()}
            elif part.field in ("point_mm", "u_mm"):
                # A plan has none of the three columns; a table of lengths has all three, with y and z empty.
                if np.isfinite(self.point_mm).any():
                    columns |= part.written(np.where(angles[:, None], np.nan, read.get(part.field, self.u_mm)))
            else:
                columns |= part.written(read[part.field] if part.field in read else getattr(self, part.field))
        columns |= angle_columns(read["point_mm"], self.u_mm, angles)
        for names, whose, values in (
            (PLACE_COLUMNS, self.target, self.place_mm),
            (STATION_COLUMNS, self.station, self.station_pose),
        ):
            is_planned = np.array([name in planned for name in whose])[:, None]
            for prefix, known in (
                ("", np.where(is_planned, np.nan, values)),
                (PLANNED, np.where(is_planned, values, np.nan)),
            ):
                if np.isfinite(known).any():
                    columns |= {f"{prefix}{n}": number_cells(column) for n, column in zip(names, known.T, strict=True)}
        comment = "\n".join(filter(None, [comment, *length_comment(self.bar_mm)]))
        return csv_text(columns, comment_lines(comment, simulated=self.simulated))


def _fields(
    reader: Cells, parts: Sequence[TableColumns], comments: Sequence[str]
) -> tuple[dict[str, Any], tuple[Message, ...]]:
    """Return the fields of a table by name, with angles and a ball bar's lengths as points, and what to note."""
    values: dict[str, Any] = {part.field: part.read(reader) for part in parts if part.columns}
    if any(name in reader.columns for name in ANGLE_COLUMNS):
        values |= with_angles(reader, values)
    length_mm = stated_length_mm(comments, reader.path)
    changed, notices = ({}, ()) if length_mm is None else with_length(values, length_mm)
    return values | changed, notices


def _places(reader: Cells, names: Sequence[str], *, planned: bool) -> np.ndarray:
    """Return (n, k) known places; for a plan also the planned ones."""
    places = np.stack([reader.numbers(name) for name in names], axis=1)
    if planned:
        planned_places = np.stack([reader.numbers(f"{PLANNED}{name}") for name in names], axis=1)
        places = np.where(np.isfinite(places).any(axis=1, keepdims=True), places, planned_places)
    return read_only(places)


def _with_own_stations(tables: Sequence[Measurements]) -> list[Measurements]:
    """Return the tables with a name of its own for each station that has another side or instrument in an earlier table."""
    kinds: dict[str, tuple[str, str, bool]] = {}
    found = []
    for table in tables:
        station, rounds = np.array(table.station, dtype=object), np.array(table.round, dtype=object)
        for name in dict.fromkeys(table.station):
            rows = table.station == name
            zero = not np.any(np.nan_to_num(table.point_mm[rows]))
            kind = str(table.station_carrier[rows][0]), str(table.instrument[rows][0]), zero
            if kinds.setdefault(name, kind) != kind:
                own = f"{name} ({Path(table.source).name})"
                kinds[own], station[rows] = kind, own
                rounds[rows] = [f"{one} ({Path(table.source).name})" for one in rounds[rows]]
        found.append(replace(table, station=read_only(station), round=read_only(rounds)))
    return found


def _check_names(table: Measurements) -> None:
    for columns, sides in ((("carrier", "target"), CARRIERS), (("station_carrier", "station"), SIDES)):
        side, name = (getattr(table, column) for column in columns)
        for row, one in enumerate(side):
            if one not in sides:
                raise table.error(
                    f"unknown {columns[0].replace('_', ' ')}",
                    expected=" or ".join(sides),
                    row=row,
                    value=one,
                    nearest=closest_name(one, sides),
                )
            if not name[row]:
                raise table.error(f"no {columns[1]} in this row", expected=f"the {columns[1]}'s name", row=row)
        first = {one: np.flatnonzero(name == one)[0] for one in dict.fromkeys(name)}
        for other in np.flatnonzero([side[first[one]] != own for one, own in zip(name, side, strict=True)]):
            raise table.error(
                f"{columns[1]} on both sides",
                expected=f"one {columns[0]} for each {columns[1]}",
                row=int(other),
                value=name[other],
            )


def _check_directions(table: Measurements) -> None:
    """Raise `InputError` for a direction of reading that is no unit vector, or a second coordinate beside it."""
    given = np.isfinite(table.along)
    some = given.any(axis=1)
    unit = np.abs(np.linalg.norm(np.nan_to_num(table.along), axis=1) - 1.0) < UNIT_LENGTH
    for row in np.flatnonzero(some & ~unit):
        raise table.error(
            "along_x, along_y, along_z are not a unit vector",
            expected="the direction of the reading, of length 1, or three empty cells",
            row=row,
            value=", ".join(f"{value:g}" for value in table.along[row]),
        )
    for row in np.flatnonzero(some & np.isfinite(table.point_mm[:, 1:]).any(axis=1)):
        raise table.error(
            "a coordinate beside the one along along_x, along_y, along_z",
            expected="x_mm alone: the coordinate along that direction",
            row=row,
        )


def _with_known_places(table: Measurements) -> Measurements:
    """Return the table with the place of its target and the pose of its station in every row, taken from any row that gives it.

    Raises `InputError`: an incomplete place, a number that is not finite, or two places for one target or station.
    """
    return replace(
        table,
        place_mm=place_by_name("target", table.target, PLACE_COLUMNS, table.place_mm, table.lines, table.source),
        station_pose=place_by_name(
            "station", table.station, STATION_COLUMNS, table.station_pose, table.lines, table.source
        ),
    )


def without_unusable_rows(table: Measurements, machine: Machine, unknown_cells: Sequence[str] = ()) -> Measurements:
    """Return the table without the rows that cannot be used, which are listed with their reasons in `Measurements.set_aside`.

    ``unknown_cells``: cells of the unknown columns, one string per row; empty if there are no such columns.

    Raises `InputError`: no usable row; commands with a constant offset or in another unit.
    """
    check_ranges(machine.axes, table.positions, table.lines, table.source)
    reasons: dict[int, RowNote] = {}

    def aside(rows: np.ndarray, reason: Message) -> None:
        for row in np.flatnonzero(rows):
            reasons.setdefault(int(row), RowNote(int(table.lines[row]), reason))

    finite = np.isfinite(table.positions)
    aside(~finite.all(axis=1), Message("a commanded position is missing or not finite"))
    aside(np.isinf(table.point_mm).any(axis=1), Message("a measured coordinate is not finite"))
    too_large = Message("a measured coordinate exceeds {most:g} mm", most=LARGEST_MM)
    aside((np.abs(table.point_mm) > LARGEST_MM).any(axis=1), too_large)
    aside(np.isnan(table.point_mm).all(axis=1), Message("no coordinate was measured"))
    too_small = Message("a standard uncertainty is below {least:g} mm", least=SMALLEST_U_MM)
    aside(np.any(table.u_mm < SMALLEST_U_MM, axis=1), too_small)
    for axis, q in zip(machine.axes, table.positions.T, strict=True):
        if axis.lower is not None and axis.upper is not None:
            reach = Number(f"{axis.lower:g} … {axis.upper:g} {axis.unit}")
            aside(
                outside_axis_range(axis, q),
                Message("the command of {axis} is outside its range {reach}", axis=axis.name, reach=reach),
            )
    usable_rows = np.array([row for row in range(len(table)) if row not in reasons], dtype=int)
    # A probe reads zero: equal rows are repeats.
    read = usable_rows[np.any(np.nan_to_num(table.point_mm[usable_rows]) != 0.0, axis=1)]
    for row, before in _copies(table, read, unknown_cells).items():
        text = Message("copy of line {line}: equal in every column", line=str(table.lines[before]))
        reasons[row] = RowNote(
            int(table.lines[row]), text, kind=Message("copy of an earlier line: equal in every column")
        )
    keep = np.array([row not in reasons for row in range(len(table))])
    for station in dict.fromkeys(table.station):
        of = keep & (table.station == station)
        if 0 < np.count_nonzero(of) < FEWEST_POINTS:
            few = Message("station {name} has fewer than {count} usable points", name=station, count=FEWEST_POINTS)
            aside(of, few)
    keep = np.array([row not in reasons for row in range(len(table))])
    notes = tuple(note for _, note in sorted(reasons.items()))
    if not np.any(keep):
        first = notes[0]
        what = f"no usable row of station {table.station[table.lines == first.line][0]}: {first.text}"
        raise InputError(what, expected="measured points", file=table.source, line=first.line)
    why = {row: note.kind or note.text for row, note in reasons.items()}
    unused = [
        *unused_names(Message("station"), table.station, why),
        *unused_names(Message("target"), table.target, why),
    ]
    used = replace(table.select(keep), set_aside=notes)
    return replace(used, notices=(*used.notices, *unused, *missing_rounds(used.target, used.round, used.positions)))


def _copies(table: Measurements, rows: np.ndarray, unknown_cells: Sequence[str]) -> dict[int, int]:
    """Return the copies among some rows, each with the row that it repeats."""
    part = table.select(rows)
    names = zip(part.station, part.target, strict=True)
    series = [f"{station}\0{target}\0".encode() for station, target in names]
    command = (part.positions + 0.0, part.approach + 0.0)
    point_of = [name + b"".join(column[i].tobytes() for column in command) for i, name in enumerate(series)]
    by_name = [values for name in BY_COLUMN_NAME for values in getattr(part, name).values()]
    rest = np.column_stack([part.readback, part.u_mm, part.time_s, part.feed_mm_min, *by_name]) + 0.0
    words = [
        f"{name}\0{unknown_cells[row] if len(unknown_cells) else ''}".encode()
        for name, row in zip(part.round, rows, strict=True)
    ]
    state = [point_of[i] + words[i] + rest[i].tobytes() for i in range(len(part))]
    found = copied_rows(part.point_mm, state, series, point_of, part.time_s)
    return {int(rows[row]): int(rows[before]) for row, before in found.items()}


def _check_header(header: Sequence[str], needed: Sequence[str], path: Path, line: int) -> None:
    """Raise `InputError` if a column is missing; it names the column whose name is probably misspelt."""
    refuse_contacts(header, needed, path, line)
    if set(needed) - set(header) == set(POINT_COLUMNS):
        expected = "a measurement table: measure the plan first, or simulate its measurement (twin simulate)"
        raise InputError("a plan, without readings", expected=expected, file=path, line=line)
    for name in needed:
        if name not in header:
            nearest = closest_name(name, [one for one in header if one not in needed])
            remark = "" if nearest is None else f" (the table has {nearest})"
            raise InputError(
                f"column {name} is missing{remark}",
                expected=f"columns {', '.join(needed)} (`twin import` reads columns of other names)",
                file=path,
                line=line,
            )
