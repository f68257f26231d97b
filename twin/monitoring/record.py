"""Records that a control with live compensation writes beside the checks: temperatures, and whether the correction was on.

The records of `twin control --to linuxcnc-kinematics`: one file a day, a row every ten seconds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import Cells, read_table
from twin._common.errors import InputError
from twin._common.records import RECORD_OF_CONTROL, TIME, is_temperature, sensor_of

DATE: Final = re.compile(r"date: (\S+)")
ON: Final = 0.999
"""Share of the correction from which it counts as on."""
UNKNOWN_LENGTH: Final = timedelta(minutes=30)
"""Length of a check whose table has no times."""
COLUMNS: Final = ("fade", "out_of_range", "stale")


@final
@dataclass(frozen=True)
class ControlState:
    """The control during a time."""

    rows: int  # of the record
    on: float  # share of them in which the correction was on, and off; between, it is faded
    off: float
    stale: float  # share in which a temperature had no new value, and the last one was used
    out_of_range: float  # share in which a position or a channel was outside the range of its errors
    temperature_degC: Mapping[str, float]  # mean of each sensor that had values
    lowest_degC: Mapping[str, float]  # lowest and highest of them
    highest_degC: Mapping[str, float]

    @property
    def text(self) -> str:
        """The state in words."""
        words = [f"correction on in {100 * self.on:.0f} % of {self.rows} rows"]
        if self.stale:
            words.append(f"in {100 * self.stale:.0f} % without a new value of every sensor: the last one was used")
        if self.out_of_range:
            words.append(f"in {100 * self.out_of_range:.0f} % outside the range of its errors")
        words += [
            f"T_{name} {self.lowest_degC[name]:.1f} to {self.highest_degC[name]:.1f} °C"
            for name in self.temperature_degC
        ]
        return "; ".join(words)


@final
@dataclass(frozen=True)
class ControlRecord:
    """The record of a day."""

    path: Path
    begin: datetime  # beginning, with the time zone of the control
    time_s: np.ndarray  # (n,) seconds since then
    columns: Mapping[str, np.ndarray]  # (n,) columns ``fade``, ``out_of_range`` and ``stale``
    temperature_degC: Mapping[str, np.ndarray]  # (n,) by sensor; NaN where it had no new value

    @staticmethod
    def load(path: Path) -> ControlRecord:
        """Read a record; `InputError`: no beginning, a missing column, a value that cannot be used."""
        header, rows, comments = read_table(path)
        cells = Cells(path, {name: i for i, name in enumerate(header)}, rows)
        dates = [match[1] for match in map(DATE.match, comments) if match is not None]
        try:
            begin = datetime.fromisoformat(dates[0] if dates else "")
        except ValueError:
            begin = datetime.min
        if begin.tzinfo is None:
            expected = "a comment '# date: 2026-03-02T08:10:00+01:00'"
            raise InputError("no beginning of the record", expected=expected, file=path, value=dates[:1])
        for name in (TIME, *COLUMNS):
            if name not in header:
                raise InputError("a column is missing", expected=name, file=path, value=",".join(header))
        numbers = {name: cells.numbers(name) for name in (TIME, *COLUMNS)}
        for name, values in numbers.items():
            cells.refuse(~np.isfinite(values), values, name, "a number in every row")
        sensors = {sensor_of(name): cells.numbers(name) for name in cells.columns if is_temperature(name)}
        for name, values in sensors.items():
            cells.refuse(np.isinf(values), values, f"T_{name}_degC", "a number, or an empty cell")
        return ControlRecord(path, begin, numbers[TIME], {name: numbers[name] for name in COLUMNS}, sensors)

    def during(self, begin: datetime, end: datetime) -> ControlState | None:
        """Return the state of the control between two times without a zone (its own) or in UTC with it; None: no rows."""
        own = self.begin if begin.tzinfo is not None else self.begin.replace(tzinfo=None)
        seconds = [(one - own).total_seconds() for one in (begin, end)]
        return self._state((self.time_s >= seconds[0]) & (self.time_s <= seconds[1]))

    @cached_property
    def whole(self) -> ControlState | None:
        """The state over the whole record."""
        return self._state(np.ones(len(self.time_s), dtype=bool))

    def _state(self, rows: np.ndarray) -> ControlState | None:
        if not rows.any():
            return None
        fade, outside, stale = (self.columns[name][rows] for name in COLUMNS)
        known = {name: values[rows][np.isfinite(values[rows])] for name, values in self.temperature_degC.items()}
        known = {name: values for name, values in known.items() if len(values)}
        means, lowest, highest = (
            {name: float(of(values)) for name, values in known.items()} for of in (np.mean, np.min, np.max)
        )
        on, off = float(np.mean(fade >= ON)), float(np.mean(fade <= 1.0 - ON))
        shares = on, off, float(np.mean(stale > 0.0)), float(np.mean(outside > 0.0))
        return ControlState(int(rows.sum()), *shares, means, lowest, highest)


def is_record(content: bytes) -> bool:
    """Return whether a file is the record of a control."""
    return content.startswith(f"# {RECORD_OF_CONTROL}".encode())


def state_at(records: Sequence[Path], date: datetime, length: timedelta | None, *, utc: bool) -> ControlState | None:
    """Return the state of the control during a check (``date``: begin, without a zone); None if no record has a row of it."""
    begin = date.replace(tzinfo=UTC) if utc else date
    end = begin + (UNKNOWN_LENGTH if length is None else length)
    days = {f"{date + timedelta(days=i):%Y-%m-%d}" for i in (-1, 0, 1)}
    near = (path for path in records if any(day in path.name for day in days))
    found = [state for state in (ControlRecord.load(path).during(begin, end) for path in near) if state is not None]
    return max(found, key=lambda one: one.rows, default=None)
