"""A record of displacements, temperatures and spindle speed over time, read from a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError

TIME: Final = "time_s"
SPEED: Final = "spindle_rpm"
MAX_GAP: Final = 5.0
"""Longest interval between two rows, in median intervals: a lag cannot be followed over a longer one."""
MAX_CELLS: Final = 5_000_000


@final
@dataclass(frozen=True)
class ThermalRecord:
    """Rows of one thermal test, in the order of time.

    Attributes:
        path: the file, as given.
        time_s: (n,), strictly increasing.
        temperature_degC: (n, sensors).
        sensors: names of the sensors.
        displacement_um: (n, displacements); no columns if the record has none.
        displacements: names of the displacements.
        speed_rpm: (n,); None if the record has no column of speeds.
        notices: what was read but not used.
    """

    path: str
    time_s: np.ndarray
    temperature_degC: np.ndarray
    sensors: tuple[str, ...]
    displacement_um: np.ndarray
    displacements: tuple[str, ...]
    speed_rpm: np.ndarray | None
    notices: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def interval_s(self) -> float:
        """Median interval between rows in seconds."""
        return float(np.median(np.diff(self.time_s)))

    @staticmethod
    def load(path: str | Path) -> ThermalRecord:
        """Read a record.

        The columns are ``time_s``, ``T_<sensor>_degC``, displacements ``<name>_um`` and, optionally, ``spindle_rpm``.

        Raises:
            InputError: with line and value: no such columns, a cell that is empty or no number, a time that does not increase, a gap in
                time, a negative speed, too few rows.
        """
        file = Path(path)
        header, rows, _ = read_table(file)
        sensors = [name for name in header if name.startswith("T_") and name.endswith("_degC")]
        displacements = [name for name in header if name.endswith("_um") and len(name) > len("_um")]
        known = {TIME, SPEED, *sensors, *displacements}
        _check_columns(header, sensors, file)
        if len(rows) < 2:
            raise InputError(f"{len(rows)} rows", expected="at least 2 rows below the header", file=file)
        if len(rows) * len(header) > MAX_CELLS:
            raise InputError(f"{len(rows)} rows", expected=f"at most {MAX_CELLS} cells", file=file)
        cells = Cells(file, {name: i for i, name in enumerate(header)}, rows)
        columns = {name: _complete(cells, name) for name in header if name in known}
        _check_time(columns[TIME], cells)
        speed = columns.get(SPEED)
        if speed is not None:
            cells.refuse(speed < 0.0, speed, SPEED, "0 or above")
        return ThermalRecord(
            path=str(path),
            time_s=columns[TIME],
            temperature_degC=_stacked(columns, sensors, len(rows)),
            sensors=tuple(name[len("T_") : -len("_degC")] for name in sensors),
            displacement_um=_stacked(columns, displacements, len(rows)),
            displacements=tuple(name[: -len("_um")] for name in displacements),
            speed_rpm=speed,
            notices=tuple(unused_column_note(name, sorted(known)) for name in header if name not in known),
        )

    def rows(self, start: int, stop: int) -> ThermalRecord:
        """Return the record of the rows from ``start`` to before ``stop``."""
        part = slice(start, stop)
        return ThermalRecord(
            self.path,
            read_only(self.time_s[part]),
            read_only(self.temperature_degC[part]),
            self.sensors,
            read_only(self.displacement_um[part]),
            self.displacements,
            None if self.speed_rpm is None else read_only(self.speed_rpm[part]),
            self.notices,
        )


def _check_columns(header: Sequence[str], sensors: Sequence[str], file: Path) -> None:
    if TIME not in header:
        raise InputError("no column of times", expected=f"a column {TIME}", file=file, line=1, value=",".join(header))
    if not sensors and SPEED not in header:
        expected = f"columns T_<sensor>_degC, {SPEED} or both"
        raise InputError("no temperature and no speed", expected=expected, file=file, line=1, value=",".join(header))


def _complete(cells: Cells, name: str) -> np.ndarray:
    """Return a column in which every cell is a finite number."""
    values = cells.numbers(name)
    cells.refuse(~np.isfinite(values), values, name, "a number in every row")
    return values


def _check_time(time_s: np.ndarray, cells: Cells) -> None:
    step = np.diff(time_s)
    cells.refuse(np.r_[False, step <= 0.0], time_s, TIME, "a later time in every row")
    longest = MAX_GAP * float(np.median(step))
    for i in np.flatnonzero(step > longest)[:1]:
        raise InputError(
            f"gap of {step[i]:g} s in {TIME}",
            expected=f"at most {longest:g} s between rows ({MAX_GAP:g} median intervals): split the record at the gap",
            file=cells.path,
            line=cells.rows[int(i) + 1][0],
            value=float(time_s[i + 1]),
        )


def _stacked(columns: dict[str, np.ndarray], names: Sequence[str], count: int) -> np.ndarray:
    return read_only(np.stack([columns[name] for name in names], axis=1) if names else np.empty((count, 0)))
