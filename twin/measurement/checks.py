"""Checks of a measurement table that need no model: copied rows, commands outside an axis's range, names without a reading.

They work on columns, so that the table itself (`twin.measurement.table`) can use them while it is read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin.machine.machine import Axis

FIRST_LINES: Final = 5
"""Line numbers of a group of notes that a text lists; the JSON has all."""
ASSUMED: Final = "assumed: "
"""What a notice begins with that a text shows before any result: what was assumed of the data, and how to say otherwise."""
LARGEST_MM: Final = 1e6
"""Coordinate beyond which a row is set aside: no instrument reads a machine from a kilometre away."""
RANGE_SLACK: Final = 0.5
"""mm or degrees a command may lie outside an axis's range (overtravel) before its row is set aside."""
FALSE_ALARM: Final = 0.01
"""Expected number of equal readings below which equal readings are copies: one table in a hundred would lose a row by mistake."""
LEAST_SCATTER_MM: Final = 1e-4
"""Noise of a reading where no repeat shows it: no machine repeats its positions better."""
MOST_DECIMALS: Final = 12
FEW: Final = 0.05
"""Share of an axis's positions outside its range up to which they are single wrong rows, not an offset of all."""
SEVERAL: Final = 3
"""Rows outside the range below which they are typing errors."""
MICROMETRES: Final = 1e3


@final
@dataclass(frozen=True)
class RowNote:
    """Something about one line of the file.

    Attributes:
        line: 1-based line.
        text: what it is, with this row's own figures.
        kind: the reason without the row's figures, the same for all rows set aside for it; the text where empty.
        size: how bad it is, in any one unit; None where rows of this kind are equally bad.
    """

    line: int
    text: str
    kind: str = ""
    size: float | None = None


def assumptions(notices: Iterable[str]) -> list[str]:
    """Return the notices that say what was assumed of the data; a text shows them before any result."""
    return [notice for notice in notices if notice.startswith(ASSUMED)]


def grouped_notes(notes: Iterable[RowNote]) -> list[str]:
    """Return one line of text a reason: a count, the first lines and the worst row; a single row stands as it is.

    Args:
        notes: notes of any kinds; the groups keep the order in which their reasons first appear.
    """
    groups: dict[str, list[RowNote]] = {}
    for note in notes:
        groups.setdefault(note.kind or note.text, []).append(note)
    return [_group_text(kind, group) for kind, group in groups.items()]


def _group_text(kind: str, group: Sequence[RowNote]) -> str:
    if len(group) == 1:
        return f"line {group[0].line}: {group[0].text}"
    lines = ", ".join(str(note.line) for note in group[:FIRST_LINES])
    more = f" and {len(group) - FIRST_LINES:,} more" if len(group) > FIRST_LINES else ""
    text = f"{len(group):,} rows (lines {lines}{more}): {kind}"
    sized = [note for note in group if note.size is not None]
    if not sized:
        return text
    worst = max(sized, key=lambda note: note.size or 0.0)
    return f"{text}; worst, line {worst.line}: {worst.text}"


def copied_rows(
    point_mm: np.ndarray, state: Sequence[bytes], series: Sequence[bytes], point_of: Sequence[bytes], time_s: np.ndarray
) -> dict[int, int]:
    """Return the rows that are copies of an earlier row, each with that row.

    A copy agrees with the earlier row in every column. Equal readings alone are no copies: a sensor with coarse steps repeats itself.
    Where the times say when each reading was taken, no second reading of the same instant is a new one. Elsewhere rows are
    copies only where chance would not have made them: where the expected number of equal readings, from the sensor's smallest step
    and its noise in repeats, is below `FALSE_ALARM`.

    Args:
        point_mm: (n, 3) readings; NaN where not read.
        state: (n) every other column of a row.
        series: (n) station and target of a row.
        point_of: (n) what a row repeats: its series, command and direction of approach.
        time_s: (n,) NaN where not given.
    """
    readings = [(row + 0.0).tobytes() for row in point_mm]
    first: dict[bytes, int] = {}
    alike: dict[int, int] = {}
    for row, key in enumerate(zip(state, readings, strict=True)):
        before = first.setdefault(b"".join(key), row)
        if before != row:
            alike[row] = before
    found: dict[int, int] = {}
    for name in dict.fromkeys(series[row] for row in alike):
        rows = np.array([row for row, other in enumerate(series) if other == name])
        timed = rows[np.isfinite(time_s[rows])]
        undecided = rows[~np.isfinite(time_s[rows])] if _times_tell(time_s, state, readings, timed) else rows
        keep = set(undecided.tolist()) if _chance_repeats(point_mm, state, point_of, undecided) else set()
        found |= {row: before for row, before in alike.items() if series[row] == name and row not in keep}
    return dict(sorted(found.items()))


def _times_tell(time_s: np.ndarray, state: Sequence[bytes], readings: Sequence[bytes], rows: np.ndarray) -> bool:
    """Whether the times of some rows are fine enough to tell one reading from the next: none is shared by different readings."""
    if not len(rows) or np.ptp(time_s[rows]) == 0.0:
        return False
    return len({(state[row], readings[row]) for row in rows}) == len({state[row] for row in rows})


def _chance_repeats(point_mm: np.ndarray, state: Sequence[bytes], point_of: Sequence[bytes], rows: np.ndarray) -> bool:
    """Whether rows of one station and target are to be expected to agree in every column by chance."""
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
        # From successive readings, so that a drift does not count as noise.
        noise = float(np.sqrt(np.mean(own**2) / 2.0)) if len(own) else 0.0
        noise = noise if known else LEAST_SCATTER_MM
        if resolution > 0.0 and noise > 0.0:
            chance *= min(1.0, resolution / (2.0 * np.sqrt(np.pi) * noise))
    if pairs * chance < FALSE_ALARM:
        return False
    # No repeat differs: either the steps are coarser than the noise, or the only repeats are copies. A plan repeats more than a few.
    return known or sum(len(group) > 1 for group in groups.values()) > len(groups) / 2.0


def _resolution(values: np.ndarray) -> float:
    """Smallest step of a sensor, mm: of the digits written, or of its own coarser steps; 0 where it read one value only."""
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
    # A step is rounded to the digits written: many steps together say nothing of the smallest.
    telling = times * digits < smallest / 4.0
    regular = np.abs(steps - times * smallest) <= (times + 1.0) * digits
    return smallest if bool(np.all(regular[telling])) else digits


def check_ranges(axes: Sequence[Axis], positions: np.ndarray, lines: np.ndarray, source: str) -> None:
    """Refuse commands that a constant, or a unit, keeps from an axis's range.

    Args:
        axes: of the machine, in command order.
        positions: (n, axes) commands, mm and degrees.
        lines: (n,) their lines.
        source: the file.

    Raises:
        InputError: many positions of an axis are outside its range, and all would be inside if one constant were subtracted, or if they
            were micrometres.
    """
    for axis, column in zip(axes, positions.T, strict=True):
        beyond = outside(axis, column)
        if axis.lower is None or axis.upper is None or not np.any(beyond):
            continue
        q = column[np.isfinite(column)]
        distinct, beyond_distinct = np.unique(np.round(q, 3)), np.unique(np.round(column[beyond], 3))
        several = np.count_nonzero(beyond) >= SEVERAL and len(beyond_distinct) > FEW * len(distinct)
        if not several and np.mean(beyond) <= 0.5:
            continue
        low, high = float(q.min()), float(q.max())
        least, most = high - axis.upper - RANGE_SLACK, low - axis.lower + RANGE_SLACK
        runs = f"{axis.name}_{axis.unit} runs {low:g} … {high:g} and {axis.name} {axis.lower:g} … {axis.upper:g}"
        if least <= most:
            likely = f"{axis.name}_{axis.unit} less an offset of {_roundest(least, most):g} {axis.unit}?"
        elif axis.linear and len(beyond_distinct) > len(distinct) / 2 and not np.any(outside(axis, q / MICROMETRES)):
            likely = f"millimetres: {axis.name}_{axis.unit} looks like micrometres, divide by {MICROMETRES:g}?"
        else:
            continue
        row = int(np.flatnonzero(beyond)[0])
        raise InputError(
            f"positions outside the machine's range: {runs}",
            expected=f"machine coordinates of the axis, within its range; {likely}",
            file=source,
            line=int(lines[row]),
            value=f"{column[row]:g}",
        )


def outside(axis: Axis, column: np.ndarray) -> np.ndarray:
    """(n,) Whether a command is outside the axis's range by more than overtravel."""
    if axis.lower is None or axis.upper is None:
        return np.zeros(len(column), dtype=bool)
    return (column < axis.lower - RANGE_SLACK) | (column > axis.upper + RANGE_SLACK)


def _roundest(low: float, high: float) -> float:
    """The number between two others that a person would have chosen: the multiple of the largest power of ten, halved or fifthed."""
    middle = (low + high) / 2.0
    for power in range(6, -4, -1):
        for part in (1.0, 0.5, 0.2):
            step = part * 10.0**power
            number = step * round(middle / step)
            if low <= number <= high and number != 0.0:
                return number
    return middle


def lost_names(what: str, names: np.ndarray, reasons: Mapping[int, str]) -> list[str]:
    """Return a notice for each station or target of which no row is used.

    Args:
        what: ``station`` or ``target``.
        names: (n,) of every row.
        reasons: why a row is set aside, by row.
    """
    found = []
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        why = Counter(reasons[int(row)] for row in rows if int(row) in reasons)
        if sum(why.values()) == len(rows):
            main = why.most_common(1)[0][0]
            found.append(f"{what} {name} is not part of the result: none of its {len(rows)} rows can be used ({main})")
    return found


def missing_rounds(target: np.ndarray, names: np.ndarray, positions: np.ndarray) -> list[str]:
    """Return a notice for each round that lacks points the other rounds of the same target have.

    Args:
        target: (n,) names of targets.
        names: (n,) names of rounds.
        positions: (n, axes) commands.
    """
    points: dict[tuple[str, str], set[bytes]] = {}
    for one, name, position in zip(target, names, positions, strict=True):
        points.setdefault((one, name), set()).add(position.tobytes())
    notices = []
    for one in dict.fromkeys(target):
        of = {name: found for (other, name), found in points.items() if other == one}
        if len(of) < 2:
            continue
        everything = set.union(*of.values())
        for name, found in of.items():
            missing = len(everything) - len(found)
            if missing and all(len(found & other) > len(everything) // 2 for other in of.values()):
                notices.append(f"target {one}: round {name} lacks {missing} of {len(everything)} positions")
    for name in dict.fromkeys(names):
        absent = [one for one in dict.fromkeys(target) if (one, name) not in points]
        if absent and len(dict.fromkeys(names)) > 1:
            notices.append(f"round {name} has no target {', '.join(absent)}")
    return notices


def one_place(
    what: str, names: np.ndarray, columns: Sequence[str], values: np.ndarray, lines: np.ndarray, source: str
) -> np.ndarray:
    """Return (n, k) the place of each row's target or station, from whichever row gives it; NaN where none does.

    Args:
        what: ``target`` or ``station``.
        names: (n,) of every row.
        columns: (k) that give the place.
        values: (n, k) as written.
        lines: (n,) of the rows.
        source: the file.

    Raises:
        InputError: a place given in part, no finite number, or one thing at two places.
    """
    given = ~np.isnan(values)
    for row in np.flatnonzero(given.any(axis=1) & ~(np.abs(values) <= LARGEST_MM).all(axis=1)):
        raise InputError(
            f"{what} {names[row]}: its place is given in part",
            expected=f"numbers of at most {LARGEST_MM:g} in {', '.join(columns)}, or nothing",
            file=source,
            line=int(lines[row]),
        )
    found = np.array(values)
    for name in dict.fromkeys(names):
        of = names == name
        stated = np.flatnonzero(of & given.any(axis=1))
        if len(stated) == 0:
            continue
        other = stated[np.any(values[stated] != values[stated[0]], axis=1)]
        if len(other):
            raise InputError(
                f"{what} {name} at two places",
                expected=f"the same {', '.join(columns)} as in line {lines[stated[0]]}",
                file=source,
                line=int(lines[other[0]]),
                value=", ".join(f"{value:g}" for value in values[other[0]]),
            )
        found[of] = values[stated[0]]
    return locked(found)
