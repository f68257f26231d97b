"""A log of a machine: temperatures and spindle speed over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import final

import numpy as np

from twin._common.counts import count_with_noun
from twin._common.records import SPEED, TIME, is_temperature, read_log, sensor_of
from twin.display import card, pairs


@final
@dataclass(frozen=True)
class MachineLog:
    """A record of a machine.

    Attributes:
        path: the file.
        time_s: (n,), strictly increasing.
        temperature_degC: (n,) by sensor or axis.
        speed_rpm: (n,) spindle speed of the time up to each row; None if it was not recorded.
        notices: what was read but not used.
    """

    path: Path
    time_s: np.ndarray
    temperature_degC: Mapping[str, np.ndarray]
    speed_rpm: np.ndarray | None
    notices: tuple[str, ...] = ()

    @staticmethod
    def load(path: str | Path) -> MachineLog:
        """Read a record with the columns ``time_s``, ``T_<sensor>_degC`` and ``spindle_rpm``.

        Raises:
            InputError: as for `read_log`.
        """
        cells, numbers, notices = read_log(path)
        found = {sensor_of(name): values for name, values in numbers.items() if is_temperature(name)}
        return MachineLog(cells.path, numbers[TIME], MappingProxyType(found), numbers.get(SPEED), notices)

    def _repr_html_(self) -> str:
        rows = [
            ("time", f"{self.time_s[0]:g} to {self.time_s[-1]:g} s"),
            *((name, f"{values.min():.1f} to {values.max():.1f} °C") for name, values in self.temperature_degC.items()),
            (
                "spindle",
                "" if self.speed_rpm is None else f"{self.speed_rpm.min():g} to {self.speed_rpm.max():g} 1/min",
            ),
        ]
        return card(f"Log {self.path.name}", pairs(rows), small=count_with_noun(len(self.time_s), "row")).text
