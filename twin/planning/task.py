"""What a plan has to do: the machine, what there is to measure with, the time there is, and what is to be known in the end."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.errors import InputError, nearest
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.planning.kit import Kit
from twin.planning.model import MOST, PlanModel

Say = Callable[[str, float], None]
AIMS: Final = ("tool", "everything", "weakest")
MOST_READINGS: Final = 10_000
"""A plan's work grows with their square; a day has some 5,000."""
PAID: Final = 3.0
"""Numbers read for every function of a curve: two thirds of them for stations, reflectors, and to object."""
BEYOND: Final = 2
"""Positions more than functions, to object."""
LEVELS: Final = 3 + BEYOND
"""At least: three functions."""
FEWEST: Final = 12
"""Readings below which nothing is planned: a station and two reflectors alone take four."""


@final
@dataclass(frozen=True)
class Task:
    """What a plan is made for.

    Attributes:
        machine: the machine.
        kit: what there is to measure with.
        minutes: that it may take, setting up included.
        expected: how large errors are, for what is known beforehand.
        seed: of every draw.
        say: told what is being done and how far it is.
        wanted: what is to become small: one of `AIMS`, or names of errors (``E_*C``).
        first_round: number of the first round.
    """

    machine: Machine
    kit: Kit
    minutes: float
    expected: Calibration
    seed: int
    say: Say
    wanted: tuple[str, ...]
    first_round: int = 1

    @classmethod
    def of(
        cls,
        machine: Machine,
        kit: Kit | None,
        minutes: float,
        expected: Calibration | None,
        seed: int,
        say: Say | None,
        reduce: str | Sequence[str] = "tool",
    ) -> Task:
        """With `Kit.default` and the machine file's own calibration where none is given.

        Raises:
            InputError: time for more readings than can be planned; a name of no error of the machine.
        """
        wanted = _wanted(machine, reduce)
        own = Kit.default(machine) if kit is None else kit
        longest = MOST_READINGS * own.seconds.point / 60.0
        if not minutes <= longest:
            raise InputError(
                f"time for more than {MOST_READINGS} readings",
                expected=f"at most {longest:.4g} minutes, or a kit that takes longer over a reading",
                value=minutes,
            )
        sizes = Calibration.default(machine) if expected is None else expected
        return cls(machine, own, minutes, sizes, seed, say or (lambda stage, part: None), wanted)

    @cached_property
    def rng(self) -> np.random.Generator:
        """Of the poses, and of the spreads of readings that a choice begins with."""
        return np.random.default_rng(self.seed)

    def model(self, plan: Measurements, instrument: Instrument) -> PlanModel:
        """What readings of an instrument would tell."""
        return PlanModel.of(self.machine, plan, self.kit.setting, instrument, self.expected, self.kit.known)

    @property
    def levels(self) -> int | None:
        """Positions of each axis that the plan can afford; None where there is no need to keep to any."""
        return levels_for(self.machine, self.expected_points, self.kit.numbers, self.expected)

    @property
    def seconds(self) -> float:
        """That it may take."""
        return 60.0 * self.minutes

    @property
    def expected_points(self) -> int:
        """How many readings there will be, about: the way takes as long as the readings."""
        return max(FEWEST, int((self.seconds - self.kit.seconds.station) / (2.0 * self.kit.seconds.point)))


def levels_for(machine: Machine, readings: int, numbers: int, expected: Calibration) -> int | None:
    """Positions of each axis that a plan can afford: a curve gets as many functions as it has positions, and all have to be paid for.

    Not fewer than the curves that are expected need: with fewer an evaluation could not write the machine down, and what it then
    left out would be in no uncertainty.

    Args:
        machine: the machine.
        readings: how many there will be.
        numbers: read at each.
        expected: the machine's errors, about.

    Returns:
        Levels, or None where there is no need to keep to any.
    """
    functions = int(readings * numbers / (PAID * len(machine.motion_names)))
    needed = max((len(curve.coefficients) for curve in expected.curves.values()), default=0)
    levels = max(LEVELS, functions + BEYOND, needed + BEYOND)
    return None if levels >= MOST + BEYOND else levels


def _wanted(machine: Machine, reduce: str | Sequence[str]) -> tuple[str, ...]:
    """What is to become small: one of `AIMS`, or names of errors (``E_*C``).

    Raises:
        InputError: a name of no error of the machine.
    """
    patterns = (reduce,) if isinstance(reduce, str) else tuple(reduce)
    if len(patterns) == 1 and patterns[0] in AIMS:
        return patterns
    names = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    for pattern in patterns or ("",):
        if not fnmatch.filter(names, pattern):
            expected = f"{', '.join(AIMS)}, or errors among {', '.join(names)}"
            meant = nearest(pattern, (*AIMS, *names))
            raise InputError("nothing of that name to reduce", expected=expected, value=pattern, nearest=meant)
    return patterns
