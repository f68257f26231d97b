"""A record of displacements, temperatures and spindle speed over time, read from a CSV file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells
from twin._common.errors import InputError
from twin._common.records import SPEED, TIME, is_temperature, read_log, sensor_of
from twin._common.units import count_with_noun
from twin.display.numbers import listed
from twin.display.results import Result

MAX_GAP: Final = 5.0
"""Longest interval between two rows, in median intervals: a lag cannot be followed over a longer one."""


@final
@dataclass(frozen=True, repr=False)
class ThermalRecord(Result):
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

    Examples:
        >>> time_s = np.arange(0.0, 7200.0, 120.0)
        >>> bed_degC = 20.0 + 2.0 * (1.0 - np.exp(-time_s / 1800.0))
        >>> rows = np.column_stack([time_s, bed_degC, 6.0 * (bed_degC - 20.0)])
        >>> np.savetxt("warm_up.csv", rows, delimiter=",", header="time_s,T_bed_degC,Z_um", comments="")
        >>> record = twin.ThermalRecord.load("warm_up.csv")
        >>> record.sensors, record.displacements, record.interval_s
        (('bed',), ('Z',), 120.0)
    """

    path: str
    time_s: np.ndarray
    temperature_degC: np.ndarray
    sensors: tuple[str, ...]
    displacement_um: np.ndarray
    displacements: tuple[str, ...]
    speed_rpm: np.ndarray | None
    notices: tuple[str, ...] = ()

    @property
    def brief(self) -> str:
        """File, number of rows, sensors and displacements."""
        rows = f"{self.path}: {count_with_noun(len(self), 'row')}"
        return f"{rows}, sensors {listed(self.sensors)}, displacements {listed(self.displacements) or 'none'}"

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
        cells, columns, notices = read_log(path, _is_displacement)
        sensors = [name for name in columns if is_temperature(name)]
        displacements = [name for name in columns if _is_displacement(name)]
        rows = len(columns[TIME])
        _check_gaps(columns[TIME], cells)
        return ThermalRecord(
            path=str(path),
            time_s=columns[TIME],
            temperature_degC=_stacked(columns, sensors, rows),
            sensors=tuple(map(sensor_of, sensors)),
            displacement_um=_stacked(columns, displacements, rows),
            displacements=tuple(name[: -len("_um")] for name in displacements),
            speed_rpm=columns.get(SPEED),
            notices=notices,
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


def _is_displacement(name: str) -> bool:
    return name.endswith("_um") and len(name) > len("_um")


def _check_gaps(time_s: np.ndarray, cells: Cells) -> None:
    step = np.diff(time_s)
    longest = MAX_GAP * float(np.median(step))
    for i in np.flatnonzero(step > longest)[:1]:
        raise InputError(
            f"gap of {step[i]:g} s in {TIME}",
            expected=f"at most {longest:g} s between rows ({MAX_GAP:g} median intervals): split the record at the gap",
            file=cells.path,
            line=cells.rows[int(i) + 1][0],
            value=float(time_s[i + 1]),
        )


def _stacked(columns: Mapping[str, np.ndarray], names: Sequence[str], count: int) -> np.ndarray:
    return read_only(np.stack([columns[name] for name in names], axis=1) if names else np.empty((count, 0)))
