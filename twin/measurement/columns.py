"""Columns of a measurement table: the field each belongs to, how its cells are read and written, and checks of columns alone."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import MM, UM
from twin.machine.machine import Axis, Machine
from twin.measurement.instruments.base import SIDES

CARRIERS: Final = ("tool", "work")
POINT_COLUMNS: Final = ("x_mm", "y_mm", "z_mm")
PLACE_COLUMNS: Final = tuple(f"place_{name}" for name in POINT_COLUMNS)
STATION_COLUMNS: Final = (*(f"station_{name}" for name in POINT_COLUMNS), *(f"station_{a}_deg" for a in "abc"))
ANGLE_COLUMNS: Final = ("a_urad", "b_urad")
ALONG_COLUMNS: Final = ("along_x", "along_y", "along_z")
BY_TOOL_COLUMNS: Final = ("by_radius", "by_length", "by_force")
CONTACT_COLUMNS: Final = tuple(f"contact_{name}" for name in POINT_COLUMNS)
ANGULAR: Final = "level"
"""Instrument of the rows that give angles and name none."""
DECIMALS: Final = 6
"""Decimals of a simulated reading in mm. Rounding in double precision, which differs from one processor to another, is a millionth of
this nanometre: from one seed, the readings in a file are the same to the last digit."""
PLANNED: Final = "planned_"
"""Prefix of a place column that gives where a target or station is meant to be. Only plans have it; no evaluation uses it."""
SIMULATED: Final = "simulated"
"""First word of the comment in a table of simulated readings."""
ONE_DIMENSIONAL: Final = ("time_s", "feed_mm_min")
"""Numeric fields that are one-dimensional arrays."""


class TableColumns(NamedTuple):
    """Columns of the file that make up one field of `Measurements`.

    ``columns``: names of the columns; one for a one-dimensional field; ``default``: word that stands for an empty cell; ``needed``:
    whether the columns are always written.
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


def axis_columns(machine: Machine) -> dict[str, Axis]:
    """Return the columns of commanded positions, each with its axis."""
    return {f"{axis.name}_{axis.unit}": axis for axis in machine.axes}


def table_columns(machine: Machine) -> tuple[TableColumns, ...]:
    """Return the columns of a table except temperatures, channels and places, in the order in which they are written."""
    axes = tuple(axis_columns(machine))
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
        TableColumns("along", ALONG_COLUMNS),
        TableColumns("tool", ("tool",), "words"),
        TableColumns("by_tool", BY_TOOL_COLUMNS),
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


# --- Checks of columns: copied rows, commands out of range, names without a usable row -----------

FIRST_LINES: Final = 5
"""Number of line numbers that a text lists for a group of notes; the JSON lists all."""
ASSUMED: Final = "assumed: "
"""Prefix of a notice that states an assumption about the data; reports print these notices before any result."""
LARGEST_MM: Final = 1e6
"""Coordinate beyond which a row is set aside: no instrument measures a machine tool from a kilometre away."""
RANGE_SLACK: Final = 0.5
"""Overtravel, mm or degrees: a row whose command is farther outside an axis's range is set aside."""
FALSE_ALARM: Final = 0.01
"""Expected number of equal readings below which equal readings count as copies: one table in a hundred loses a row by mistake."""
LEAST_NOISE_MM: Final = 1e-4
"""Noise assumed for a reading where no repeats show it, mm: no machine repeats its positions better."""
MOST_DECIMALS: Final = 12
FEWEST_DOF: Final = 20
OVERSTATED: Final = 0.1
"""Reduced chi² below which the stated noise is reported as too large: by chance in one of nine million data sets with 20 dof."""
ISOLATED_SHARE: Final = 0.05
"""Share of an axis's positions outside its range up to which they count as single wrong rows, not as an offset of the column."""
SYSTEMATIC_ROWS: Final = 3
"""Number of rows outside the range below which they count as typing errors."""
UM_PER_MM: Final = 1e3


@final
@dataclass(frozen=True)
class RowNote:
    """A note about one line of the file, such as the reason why its row is set aside.

    Attributes:
        line: 1-based line.
        text: the note, with this row's own values.
        kind: the reason without the row's values, by which notes are grouped; None for the text.
        size: severity, to find the worst row of a group; None where all rows of the group are equally bad.
    """

    line: int
    text: Message
    kind: Message | None = None
    size: float | None = None


def assumptions(notices: Iterable[Message]) -> list[Message]:
    """Return the notices that state an assumption about the data; reports print them before any result."""
    return [notice for notice in notices if notice.startswith(ASSUMED)]


def overstated_noise(rms_um: float, chi2: float, dof: float) -> tuple[Message, ...]:
    """Return a notice if the residuals are far smaller than the stated noise: its unit may be wrong, and it would hide errors."""
    if dof < FEWEST_DOF or chi2 > OVERSTATED * dof:
        return ()
    times = float(np.sqrt(dof / chi2)) if chi2 > 0.0 else np.inf
    return (
        Message(
            "assumed: the stated measurement noise is right, although it is {times:.3g} times the residuals "
            "({rms_um:.3g} µm): check the unit of u_x_mm, u_y_mm, u_z_mm, because noise that is stated too large hides"
            " errors",
            times=times,
            rms_um=rms_um,
        ),
    )


def grouped_notes(notes: Iterable[RowNote]) -> list[Message]:
    """Return one line of text for each reason: the number of rows, the first line numbers and the worst row.

    ``notes``: notes of any kind; A single note keeps its own text; groups keep the order in which their reasons first appear.
    """
    groups: dict[Message, list[RowNote]] = {}
    for note in notes:
        groups.setdefault(note.kind or note.text, []).append(note)
    return [_group_text(kind, group) for kind, group in groups.items()]


def _group_text(kind: Message, group: Sequence[RowNote]) -> Message:
    if len(group) == 1:
        return Message("line {line}: {text}", line=group[0].line, text=group[0].text)
    lines = ", ".join(str(note.line) for note in group[:FIRST_LINES])
    more = Message(" and {count:,} more", count=len(group) - FIRST_LINES) if len(group) > FIRST_LINES else ""
    text = Message("{count:,} rows (lines {lines}{more}): {kind}", count=len(group), lines=lines, more=more, kind=kind)
    sized = [note for note in group if note.size is not None]
    if not sized:
        return text
    worst = max(sized, key=lambda note: note.size or 0.0)
    return Message("{text}; worst, line {line}: {worst}", text=text, line=worst.line, worst=worst.text)


def copied_rows(
    point_mm: np.ndarray, state: Sequence[bytes], series: Sequence[bytes], point_of: Sequence[bytes], time_s: np.ndarray
) -> dict[int, int]:
    """Return the rows that are copies of an earlier row: copy → earlier row.

    A copy agrees with the earlier row in every column. Equal readings alone are not enough: a sensor with coarse resolution repeats
    its values. Where ``time_s`` distinguishes the readings, two equal rows with the same time are copies. Without such times, rows are
    copies only if the expected number of equal readings, estimated from the sensor's resolution and the noise of repeats, is below
    `FALSE_ALARM`.

    ``point_mm``: (n, 3) readings; NaN where not read; ``state``: (n) key of all other columns of a row; ``series``: (n) key of station
    and target; ``point_of``: (n) key of the measured point: series, command and direction of approach; ``time_s``: (n,) NaN where not
    given.
    """
    readings = [(row + 0.0).tobytes() for row in point_mm]
    first: dict[bytes, int] = {}
    equal_to: dict[int, int] = {}
    for row, key in enumerate(zip(state, readings, strict=True)):
        before = first.setdefault(b"".join(key), row)
        if before != row:
            equal_to[row] = before
    copies: dict[int, int] = {}
    for name in dict.fromkeys(series[row] for row in equal_to):
        rows = np.array([row for row, other in enumerate(series) if other == name])
        timed = rows[np.isfinite(time_s[rows])]
        undecided = (
            rows[~np.isfinite(time_s[rows])] if _times_distinguish_readings(time_s, state, readings, timed) else rows
        )
        keep = set(undecided.tolist()) if _equal_by_chance(point_mm, state, point_of, undecided) else set()
        copies |= {row: before for row, before in equal_to.items() if series[row] == name and row not in keep}
    return dict(sorted(copies.items()))


def _times_distinguish_readings(
    time_s: np.ndarray, state: Sequence[bytes], readings: Sequence[bytes], rows: np.ndarray
) -> bool:
    """Return whether no two different readings among some rows share a time, so that times distinguish readings."""
    if not len(rows) or np.ptp(time_s[rows]) == 0.0:
        return False
    return len({(state[row], readings[row]) for row in rows}) == len({state[row] for row in rows})


def _equal_by_chance(point_mm: np.ndarray, state: Sequence[bytes], point_of: Sequence[bytes], rows: np.ndarray) -> bool:
    """Return whether rows of one station and target may agree in every column by chance."""
    sizes = Counter(state[row] for row in rows)
    pairs = sum(size * (size - 1) // 2 for size in sizes.values())
    groups: dict[bytes, list[int]] = {}
    for row in rows:
        groups.setdefault(point_of[row], []).append(int(row))
    steps = np.concatenate([np.diff(point_mm[group], axis=0) for group in groups.values()] or [np.empty((0, 3))])
    known = bool(np.any(np.abs(steps) > 0.0))
    chance = 1.0
    for i in range(3):
        resolution = _resolution(point_mm[rows, i])
        own = steps[np.isfinite(steps[:, i]), i]
        # From differences of successive readings, so that drift does not count as noise.
        noise = float(np.sqrt(np.mean(own**2) / 2.0)) if len(own) else 0.0
        noise = noise if known else LEAST_NOISE_MM
        if resolution > 0.0 and noise > 0.0:
            chance *= min(1.0, resolution / (2.0 * np.sqrt(np.pi) * noise))
    if pairs * chance < FALSE_ALARM:
        return False
    # No repeat differs: either the resolution is coarser than the noise, or the only repeats are copies. Where most points are
    # repeated, the repeats were planned and are no copies.
    return known or sum(len(group) > 1 for group in groups.values()) > len(groups) / 2.0


def _resolution(values: np.ndarray) -> float:
    """Return the resolution of a sensor, mm: its own step if that is coarser than the digits written; 0 if all values are equal."""
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < 2:
        return 0.0
    digits = next(
        (
            10.0**-k
            for k in range(MOST_DECIMALS + 1)
            if np.all(
                np.abs(distinct * 10.0**k - np.round(distinct * 10.0**k)) < 1e-6 * np.maximum(1.0, np.abs(distinct))
            )
        ),
        10.0**-MOST_DECIMALS,
    )
    steps = np.diff(distinct)
    smallest = float(steps.min())
    times = np.round(steps / smallest)
    # A step is rounded to the digits written, so the sum of many steps does not show whether it is a multiple of the smallest.
    informative = times * digits < smallest / 4.0
    regular = np.abs(steps - times * smallest) <= (times + 1.0) * digits
    return smallest if bool(np.all(regular[informative])) else digits


def check_ranges(axes: Sequence[Axis], positions: np.ndarray, lines: np.ndarray, source: str) -> None:
    """Raise `InputError` if a column of commands has a constant offset or is in micrometres.

    ``positions``: (n, axes) commands, mm and degrees; ``lines``: (n,) lines of the rows.

    Raises `InputError`: many positions of an axis are outside its range, and all would be inside after subtracting one constant, or if
    they were micrometres.
    """
    for axis, column in zip(axes, positions.T, strict=True):
        beyond = outside_axis_range(axis, column)
        if axis.lower is None or axis.upper is None or not np.any(beyond):
            continue
        q = column[np.isfinite(column)]
        distinct, beyond_distinct = np.unique(np.round(q, 3)), np.unique(np.round(column[beyond], 3))
        several = np.count_nonzero(beyond) >= SYSTEMATIC_ROWS and len(beyond_distinct) > ISOLATED_SHARE * len(distinct)
        if not several and np.mean(beyond) <= 0.5:
            continue
        low, high = float(q.min()), float(q.max())
        least, most = high - axis.upper - RANGE_SLACK, low - axis.lower + RANGE_SLACK
        runs = (
            f"{axis.name}_{axis.unit} is {low:g} … {high:g}, the range of {axis.name} {axis.lower:g} … {axis.upper:g}"
        )
        if least <= most:
            suggestion = f"subtract {_roundest_between(least, most):g} {axis.unit} from {axis.name}_{axis.unit}?"
        elif (
            axis.linear
            and len(beyond_distinct) > len(distinct) / 2
            and not np.any(outside_axis_range(axis, q / UM_PER_MM))
        ):
            suggestion = f"{axis.name}_{axis.unit} looks like micrometres: divide by {UM_PER_MM:g}?"
        else:
            continue
        row = int(np.flatnonzero(beyond)[0])
        raise InputError(
            f"positions outside the machine's range: {runs}",
            expected=f"machine coordinates within the axis's range; {suggestion}",
            file=source,
            line=int(lines[row]),
            value=f"{column[row]:g}",
        )


def outside_axis_range(axis: Axis, column: np.ndarray) -> np.ndarray:
    """Return (n,) whether a command is outside the axis's range by more than `RANGE_SLACK`."""
    if axis.lower is None or axis.upper is None:
        return np.zeros(len(column), dtype=bool)
    return (column < axis.lower - RANGE_SLACK) | (column > axis.upper + RANGE_SLACK)


def _roundest_between(low: float, high: float) -> float:
    """Return the roundest number between two numbers: a multiple of 1, 0.5 or 0.2 times the largest possible power of ten."""
    middle = (low + high) / 2.0
    for power in range(6, -4, -1):
        for part in (1.0, 0.5, 0.2):
            step = part * 10.0**power
            number = step * round(middle / step)
            if low <= number <= high and number != 0.0:
                return number
    return middle


def unused_names(what: Message, names: np.ndarray, reasons: Mapping[int, Message]) -> list[Message]:
    """Return a notice for each station or target that has no usable row.

    ``what``: ``station`` or ``target``; ``names``: (n,) name of the station or target of every row; ``reasons``: reason why a row is
    set aside, by row.
    """
    unused_names = []
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        why = Counter(reasons[int(row)] for row in rows if int(row) in reasons)
        if sum(why.values()) == len(rows):
            main = why.most_common(1)[0][0]
            unused_names.append(
                Message(
                    "{what} {name} is not used: none of its {count} rows is usable ({reason})",
                    what=what,
                    name=name,
                    count=len(rows),
                    reason=main,
                )
            )
    return unused_names


def missing_rounds(target: np.ndarray, names: np.ndarray, positions: np.ndarray) -> list[Message]:
    """Return a notice for each round that lacks points which the other rounds of the same target contain.

    ``target``: (n,) names of targets; ``names``: (n,) names of rounds; ``positions``: (n, axes) commands.
    """
    points: dict[tuple[str, str], set[bytes]] = {}
    for reflector, name, position in zip(target, names, positions, strict=True):
        points.setdefault((reflector, name), set()).add(position.tobytes())
    notices: list[Message] = []
    for reflector in dict.fromkeys(target):
        of = {name: found for (other, name), found in points.items() if other == reflector}
        if len(of) < 2:
            continue
        everything = set.union(*of.values())
        for name, found in of.items():
            missing = len(everything) - len(found)
            if missing and all(len(found & other) > len(everything) // 2 for other in of.values()):
                notices.append(
                    Message(
                        "target {target}: round {name} lacks {missing} of {count:,} positions",
                        target=reflector,
                        name=str(name),
                        missing=missing,
                        count=len(everything),
                    )
                )
    for name in dict.fromkeys(names):
        absent = [reflector for reflector in dict.fromkeys(target) if (reflector, name) not in points]
        if absent and len(dict.fromkeys(names)) > 1:
            notices.append(Message("round {name} has no target {targets}", name=str(name), targets=", ".join(absent)))
    return notices


def place_by_name(
    what: str, names: np.ndarray, columns: Sequence[str], values: np.ndarray, lines: np.ndarray, source: str
) -> np.ndarray:
    """Return (n, k) the place of each row's target or station, taken from any row that gives it; NaN where no row does.

    ``what``: ``target`` or ``station``; ``names``: (n,) name of the target or station of every row; ``columns``: (k) names of the
    columns of the place; ``values``: (n, k) cells of these columns; ``lines``: (n,) lines of the rows.

    Raises `InputError`: an incomplete place, a number that is not finite or too large, or two places for one target or station.
    """
    given = ~np.isnan(values)
    for row in np.flatnonzero(given.any(axis=1) & ~(np.abs(values) <= LARGEST_MM).all(axis=1)):
        raise InputError(
            f"incomplete place of {what} {names[row]}",
            expected=f"numbers of at most {LARGEST_MM:g} in all of {', '.join(columns)}, or all of them empty",
            file=source,
            line=int(lines[row]),
        )
    place_by_name = np.array(values)
    for name in dict.fromkeys(names):
        of = names == name
        stated = np.flatnonzero(of & given.any(axis=1))
        if len(stated) == 0:
            continue
        other = stated[np.any(values[stated] != values[stated[0]], axis=1)]
        if len(other):
            raise InputError(
                f"two places for {what} {name}",
                expected=f"the same {', '.join(columns)} as in line {lines[stated[0]]}",
                file=source,
                line=int(lines[other[0]]),
                value=", ".join(f"{value:g}" for value in values[other[0]]),
            )
        place_by_name[of] = values[stated[0]]
    return read_only(place_by_name)
