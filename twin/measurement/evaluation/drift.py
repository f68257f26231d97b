"""Displacements over time in the tests of ISO 230-3: environment, rotating spindle, moving linear axes.

The figures are ranges (largest minus smallest) and changes from the first reading. They follow public descriptions of the standard (its
scope and its preview), not its clauses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.measurement.evaluation.inputs import check_same_length, finite_array

FIRST_S: Final = 3600.0
"""Length of the first part of a spindle test, s."""
DriftKind = Literal["environment", "spindle", "axes", "rotary axis"]


@final
@dataclass(frozen=True)
class DriftSeries:
    """Displacements of one test over time; n readings.

    Attributes:
        kind: ``environment``, ``spindle``, ``axes`` or ``rotary axis``.
        time_s: (n,) increasing.
        displacement: (n,) by name, µm or µrad, from the reference reading; NaN where it was not read.
        units: ``um`` or ``urad`` by name.
        temperature_degC: (n,) by sensor; NaN where it was not read.
        speed_rpm: (n,) spindle speed; None if unknown.
        target: (n,) number of the target position, from 1.
        running_s: start and end of the period in which the spindle ran; None for other tests.
    """

    kind: DriftKind
    time_s: np.ndarray
    displacement: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    temperature_degC: Mapping[str, np.ndarray]
    speed_rpm: np.ndarray | None
    target: np.ndarray
    running_s: tuple[float, float] | None

    @property
    def targets(self) -> tuple[int, ...]:
        """Numbers of the target positions."""
        return tuple(int(one) for one in np.unique(self.target))

    @property
    def duration_s(self) -> float:
        """Time from the first to the last reading."""
        return float(self.time_s[-1] - self.time_s[0])

    def range(self, name: str, *, target: int = 1, until_s: float = np.inf) -> float:
        """Return the largest minus the smallest displacement at a target; NaN for fewer than two readings.

        In a spindle test only readings of the period in which the spindle ran count, and the reference reading before it.

        Args:
            name: the displacement.
            target: number of the target position.
            until_s: end of the part that counts, from the start of that period.
        """
        return spread(self.displacement[name][self._counted(target, until_s)])

    def end(self, name: str, *, target: int = 1) -> float:
        """Return the displacement at the last counted reading of a target, from the reference; NaN if it was not read."""
        values = self.displacement[name][self._counted(target, np.inf)]
        read = values[np.isfinite(values)]
        return float(read[-1]) if len(read) else float("nan")

    def _counted(self, target: int, until_s: float) -> np.ndarray:
        start, end = self.running_s or (float(self.time_s[0]), float(self.time_s[-1]))
        after, before = self.time_s >= start, self.time_s <= min(end, start + until_s)
        return np.flatnonzero(after & before & (self.target == target))


def spread(values: np.ndarray) -> float:
    """Return the largest minus the smallest value, without those that are NaN; NaN for fewer than two."""
    read = values[np.isfinite(values)]
    return float(np.ptp(read)) if len(read) > 1 else float("nan")


def tilt_urad(first_um: np.ndarray, second_um: np.ndarray, distance_mm: float) -> np.ndarray:
    """Return the tilt from two parallel sensors at a distance: second minus first, divided by the distance.

    Args:
        first_um: (n,) displacement at the first sensor.
        second_um: (n,) displacement at the second.
        distance_mm: distance of the sensors.
    """
    return np.asarray((second_um - first_um) / distance_mm * 1e3)


def drift_series(
    kind: DriftKind,
    time_s: ArrayLike,
    displacement: Mapping[str, ArrayLike],
    *,
    units: Mapping[str, str],
    temperature_degC: Mapping[str, np.ndarray] | None = None,
    speed_rpm: ArrayLike | None = None,
    target: ArrayLike | None = None,
) -> DriftSeries:
    """Return the displacements of a test from the reference reading: the first at each target; for a spindle the last before it ran.

    Args:
        kind: the test.
        time_s: (n,) increasing.
        displacement: (n,) by name; NaN where it was not read.
        units: ``um`` or ``urad`` by name.
        temperature_degC: (n,) by sensor.
        speed_rpm: (n,) the speed at each reading, or between the reading before and this one if it stands still for the reading.
        target: (n,) number of the target position, from 1; None for one position.

    Raises:
        InputError: fewer than two readings, times that do not increase, or a spindle that never ran.
    """
    time = finite_array("time_s", time_s, 1)
    for name, values in displacement.items():
        check_same_length(name, np.asarray(values), "time_s", time)
    if len(time) < 2:
        raise InputError("too few readings", expected="at least two", value=len(time))
    if np.any(np.diff(time) <= 0.0):
        raise InputError("the times do not increase", expected="a later time at every reading")
    number = np.ones(len(time), dtype=int) if target is None else np.asarray(target, dtype=int)
    speed = None if speed_rpm is None else np.asarray(speed_rpm, dtype=float)
    running = None
    first = {int(one): int(np.flatnonzero(number == one)[0]) for one in np.unique(number)}
    if kind == "spindle":
        ran = np.flatnonzero(np.nan_to_num(speed) > 0.0) if speed is not None else np.zeros(0, dtype=int)
        if not len(ran):
            raise InputError("the spindle never ran", expected="a spindle speed above zero")
        before = max(int(ran[0]) - 1, 0)
        running, first = (float(time[before]), float(time[ran[-1]])), {1: before}
    return DriftSeries(
        kind=kind,
        time_s=read_only(time),
        displacement=MappingProxyType(
            {
                name: read_only(_from_reference(np.asarray(v, dtype=float), number, first))
                for name, v in displacement.items()
            }
        ),
        units=MappingProxyType(dict(units)),
        temperature_degC=MappingProxyType(dict(temperature_degC or {})),
        speed_rpm=None if speed is None else read_only(speed),
        target=read_only(number),
        running_s=running,
    )


def _from_reference(values: np.ndarray, target: np.ndarray, first: Mapping[int, int]) -> np.ndarray:
    """Return values from that of the reference row of each target, or from the first one read after it."""
    found = np.full(values.shape, np.nan)
    for number, row in first.items():
        here = target == number
        read = np.flatnonzero(here & np.isfinite(values))
        later = read[read >= row]
        if len(later):
            found[here] = values[here] - values[later[0]]
    return found
