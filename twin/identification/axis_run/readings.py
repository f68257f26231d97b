"""A table of a multi-axis interferometer's readings: one row for each position of the axis, one column for each beam.

Columns ``<axis>_mm`` (commanded) and ``beam_<name>_mm`` for every beam of the layout, optionally ``round``, ``approach`` and
``time_s``; an empty cell is a beam that was not read. Rows that cannot be used are listed in `BeamReadings.set_aside` with line and
reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.units import MM
from twin.identification.axis_run.layout import AxisLayout
from twin.measurement.checks import LARGEST_MM, RowNote, outside_axis_range
from twin.measurement.columns import comment_lines, csv_text, number_cells, printed, refuse_contacts, simulated_comments

FEWEST_BEAMS: Final = 6
"""Least number of beams that determine six motions."""


@final
@dataclass(frozen=True)
class BeamReadings:
    """Readings of n rows; arrays are read-only.

    Attributes:
        source: the file, or another description of the source.
        lines: (n,) line of each row in the file.
        position_mm: (n,) commanded.
        change_mm: (n, m) as displayed by the instrument; NaN for a beam that was not read.
        round: (n,) names.
        approach: (n,) +1, −1, 0 unknown.
        time_s: (n,) NaN where not given.
        set_aside: rows of the file that are not used, and why.
        notices: facts to know before using a result.
        simulated: whether they were simulated, not measured on a machine.
    """

    source: str
    lines: np.ndarray
    position_mm: np.ndarray
    change_mm: np.ndarray
    round: np.ndarray
    approach: np.ndarray
    time_s: np.ndarray
    set_aside: tuple[RowNote, ...] = ()
    notices: tuple[str, ...] = ()
    simulated: bool = False

    def __len__(self) -> int:
        return len(self.lines)

    def paths(self, layout: AxisLayout) -> np.ndarray:
        """Return (n, m) the change of path, there and back, metres."""
        return np.asarray(self.change_mm * MM * (2.0 if layout.halved else 1.0))

    def to_csv(self, layout: AxisLayout, *, comment: str = "") -> str:
        """Return the table as text, which reads back as the same readings; simulated ones are rounded (`printed`)."""
        columns: dict[str, Sequence[str]] = {f"{layout.axis.name}_mm": number_cells(self.position_mm)}
        change_mm = printed(self.change_mm, simulated=self.simulated)
        columns |= {name: number_cells(values) for name, values in zip(layout.columns, change_mm.T, strict=True)}
        columns["round"] = list(self.round)
        if np.any(self.approach):
            columns["approach"] = [str(int(value)) for value in self.approach]
        if np.isfinite(self.time_s).any():
            columns["time_s"] = number_cells(self.time_s)
        return csv_text(columns, comment_lines(comment, simulated=self.simulated))

    def save(self, path: str | Path, layout: AxisLayout, *, comment: str = "") -> None:
        """Write the table atomically, after it was read back."""
        text = self.to_csv(layout, comment=comment)
        write_atomic(Path(path), text, check=lambda written: load_readings(written, layout))


def load_readings(path: str | Path, layout: AxisLayout) -> BeamReadings:
    """Read and check a table of readings.

    Args:
        path: the file.
        layout: layout of the interferometer.

    Raises:
        InputError: with file, line and value: no header, a missing column, a cell that is not a number, no usable row.
    """
    path = Path(path)
    header, rows, comments = read_table(path)
    position = f"{layout.axis.name}_mm"
    needed = (position, *layout.columns)
    line = rows[0][0] - 1 if rows else 1
    refuse_contacts(header, needed, path, line)
    for name in needed:
        if name not in header:
            raise InputError(
                f"column {name} is missing",
                expected=f"columns {', '.join(needed)}",
                file=path,
                line=line,
            )
    if not rows:
        raise InputError("no reading", expected="one row for each position below the header", file=path)
    known = {*needed, "round", "approach", "time_s"}
    cells = Cells(path, {name: i for i, name in enumerate(header)}, rows)
    table = BeamReadings(
        source=str(path),
        lines=read_only(np.array([line for line, _ in rows], dtype=int)),
        position_mm=cells.numbers(position),
        change_mm=read_only(np.stack([cells.numbers(name) for name in layout.columns], axis=1)),
        round=cells.words("round", "1"),
        approach=cells.signs("approach"),
        time_s=cells.numbers("time_s"),
        notices=(
            *(f"the file says: {text}" for text in simulated_comments(comments)),
            *(unused_column_note(name, sorted(known)) for name in header if name not in known),
        ),
        simulated=bool(simulated_comments(comments)),
    )
    return _usable(table, layout)


def _usable(table: BeamReadings, layout: AxisLayout) -> BeamReadings:
    reasons: dict[int, str] = {}

    def aside(rows: np.ndarray, reason: str) -> None:
        for row in np.flatnonzero(rows):
            reasons.setdefault(int(row), reason)

    aside(~np.isfinite(table.position_mm), "a commanded position is missing or not finite")
    aside(np.isinf(table.change_mm).any(axis=1), "a reading is not finite")
    aside((np.abs(table.change_mm) > LARGEST_MM).any(axis=1), f"a reading exceeds {LARGEST_MM:g} mm")
    aside(np.isfinite(table.change_mm).sum(axis=1) < FEWEST_BEAMS, f"fewer than {FEWEST_BEAMS} beams were read")
    lower, upper = layout.axis.lower, layout.axis.upper
    if lower is not None and upper is not None:
        beyond = outside_axis_range(layout.axis, table.position_mm)
        aside(beyond, f"the command of {layout.axis.name} is outside its range {lower:g} … {upper:g} mm")
    keep = np.array([row not in reasons for row in range(len(table))])
    notes = tuple(RowNote(int(table.lines[row]), reason) for row, reason in sorted(reasons.items()))
    if not np.any(keep):
        raise InputError(f"no usable row: {notes[0].text}", expected="readings", file=table.source, line=notes[0].line)
    rows: dict[str, Any] = {
        field.name: read_only(getattr(table, field.name)[keep])
        for field in fields(table)
        if isinstance(getattr(table, field.name), np.ndarray)
    }
    return replace(table, **rows, set_aside=notes)
