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
from twin.planning.model import PlanModel

Say = Callable[[str, float], None]
AIMS: Final = ("tool", "everything", "weakest")
MOST_READINGS: Final = 10_000
"""A plan's work grows with their square; a day has some 5,000."""
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
        first_round: number of the first round.
    """

    machine: Machine
    kit: Kit
    minutes: float
    expected: Calibration
    seed: int
    say: Say
    first_round: int = 1

    @classmethod
    def of(
        cls, machine: Machine, kit: Kit | None, minutes: float, expected: Calibration | None, seed: int, say: Say | None
    ) -> Task:
        """With `Kit.default` and the machine file's own calibration where none is given.

        Raises:
            InputError: time for more readings than can be planned.
        """
        own = Kit.default(machine) if kit is None else kit
        longest = MOST_READINGS * own.seconds.point / 60.0
        if not minutes <= longest:
            raise InputError(
                f"time for more than {MOST_READINGS} readings",
                expected=f"at most {longest:.4g} minutes, or a kit that takes longer over a reading",
                value=minutes,
            )
        sizes = Calibration.default(machine) if expected is None else expected
        return cls(machine, own, minutes, sizes, seed, say or (lambda stage, part: None))

    @cached_property
    def rng(self) -> np.random.Generator:
        """Of the poses, and of the spreads of readings that a choice begins with."""
        return np.random.default_rng(self.seed)

    def model(self, plan: Measurements, instrument: Instrument) -> PlanModel:
        """What readings of an instrument would tell."""
        return PlanModel.of(self.machine, plan, self.kit.setting, instrument, self.expected, self.kit.known)

    @property
    def seconds(self) -> float:
        """That it may take."""
        return 60.0 * self.minutes

    @property
    def expected_points(self) -> int:
        """How many readings there will be, about: the way takes as long as the readings."""
        return max(FEWEST, int((self.seconds - self.kit.seconds.station) / (2.0 * self.kit.seconds.point)))


def wanted(machine: Machine, reduce: str | Sequence[str]) -> list[str]:
    """What is to become small: one of `AIMS`, or names of errors (``E_*C``).

    Raises:
        InputError: a name of no error of the machine.
    """
    patterns = [reduce] if isinstance(reduce, str) else list(reduce)
    if len(patterns) == 1 and patterns[0] in AIMS:
        return patterns
    names = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    for pattern in patterns or [""]:
        if not fnmatch.filter(names, pattern):
            expected = f"{', '.join(AIMS)}, or errors among {', '.join(names)}"
            meant = nearest(pattern, (*AIMS, *names))
            raise InputError("nothing of that name to reduce", expected=expected, value=pattern, nearest=meant)
    return patterns


def length_of(machine: Machine, tool_length_mm: float | None) -> float:
    """As given, else the machine file's, else 100 mm: at the nose itself a turn about it would look harmless."""
    return tool_length_mm if tool_length_mm is not None else machine.tool_length_mm or 100.0
