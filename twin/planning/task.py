"""Task of a plan: machine, kit, time budget, and the uncertainty to minimise."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.progress import Progress
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.planning.kit import Kit
from twin.planning.model import MOST_FUNCTIONS, PlanModel

AIMS: Final = ("tool", "everything", "weakest")
MOST_READINGS: Final = 10_000
"""Limit of the number of readings: computing time grows with its square; a day allows some 5,000."""
NUMBERS_PER_FUNCTION: Final = 3.0
"""Coordinates read per function of a curve: two thirds of them for stations, reflectors and redundancy."""
REDUNDANT: Final = 2
"""Positions in excess of functions, for redundancy."""
LEAST_LEVELS: Final = 3 + REDUNDANT
"""Fewest positions of an axis: three functions and redundancy."""
FEWEST: Final = 12
"""Fewest readings of a plan: a station and two reflectors alone need four."""


@final
@dataclass(frozen=True)
class Task:
    """Task of a plan.

    Attributes:
        machine: the machine.
        kit: instruments, stations, reflectors and times.
        minutes: time budget, including set-up.
        expected: expected size of the errors, for the prior.
        seed: random seed.
        progress: progress callback: stage and share done.
        reduce: uncertainty to minimise: one of `AIMS`, or names of errors (``E_*C``).
        first_round: number of the first round.
    """

    machine: Machine
    kit: Kit
    minutes: float
    expected: Calibration
    seed: int
    progress: Progress
    reduce: tuple[str, ...]
    first_round: int = 1

    @classmethod
    def of(
        cls,
        machine: Machine,
        kit: Kit | None,
        minutes: float,
        expected: Calibration | None,
        seed: int,
        progress: Progress,
        reduce: str | Sequence[str] = "tool",
    ) -> Task:
        """Return the task; defaults are `Kit.default` and the machine file's calibration.

        Raises:
            InputError: the time budget allows too many readings, or the machine has no error of a given name.
        """
        names = _names_to_minimise(machine, reduce)
        own = Kit.default(machine) if kit is None else kit
        longest = MOST_READINGS * own.seconds.point / 60.0
        if not minutes <= longest:
            raise InputError(
                f"time budget for more than {MOST_READINGS} readings",
                expected=f"at most {longest:.4g} minutes, or a kit with more time per reading",
                value=minutes,
            )
        sizes = Calibration.default(machine) if expected is None else expected
        return cls(machine, own, minutes, sizes, seed, progress, names)

    @cached_property
    def rng(self) -> np.random.Generator:
        """Random generator for poses and initial readings."""
        return np.random.default_rng(self.seed)

    def model(self, plan: Measurements, instrument: Instrument) -> PlanModel:
        """Return the model of an instrument's readings."""
        return PlanModel.of(self.machine, plan, self.kit.setting, instrument, self.expected, self.kit.known)

    @property
    def levels(self) -> int | None:
        """Number of positions of each axis that the plan can afford; None: no limit needed."""
        return levels_for(self.machine, self.expected_points, self.kit.coordinates_per_reading, self.expected)

    @property
    def seconds(self) -> float:
        """Time budget in seconds."""
        return 60.0 * self.minutes

    @property
    def expected_points(self) -> int:
        """Approximate number of readings, if travel takes as long as the readings."""
        return max(FEWEST, int((self.seconds - self.kit.seconds.station) / (2.0 * self.kit.seconds.point)))


def levels_for(machine: Machine, readings: int, numbers: int, expected: Calibration) -> int | None:
    """Return how many positions of each axis a plan can afford: each position adds a function to every curve of the axis.

    It is at least the number that the expected curves need: with fewer an evaluation could not represent the machine, and no
    uncertainty would include the part left out.

    Args:
        machine: the machine.
        readings: number of readings.
        numbers: coordinates per reading.
        expected: expected errors of the machine.

    Returns:
        Number of positions, or None if no limit is needed.
    """
    functions = int(readings * numbers / (NUMBERS_PER_FUNCTION * len(machine.motion_names)))
    needed = max((len(curve.coefficients) for curve in expected.curves.values()), default=0)
    levels = max(LEAST_LEVELS, functions + REDUNDANT, needed + REDUNDANT)
    return None if levels >= MOST_FUNCTIONS + REDUNDANT else levels


def _names_to_minimise(machine: Machine, reduce: str | Sequence[str]) -> tuple[str, ...]:
    """Return the uncertainty to minimise: one of `AIMS`, or names of errors (``E_*C``).

    Raises:
        InputError: the machine has no error of a given name.
    """
    patterns = (reduce,) if isinstance(reduce, str) else tuple(reduce)
    if len(patterns) == 1 and patterns[0] in AIMS:
        return patterns
    names = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    for pattern in patterns or ("",):
        if not fnmatch.filter(names, pattern):
            expected = f"{', '.join(AIMS)}, or errors among {', '.join(names)}"
            meant = closest_name(pattern, (*AIMS, *names))
            raise InputError("no such uncertainty to minimise", expected=expected, value=pattern, nearest=meant)
    return patterns
