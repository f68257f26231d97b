"""Specification of a drift sequence, what it is made from, and its schedule."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis
from twin.planning.sequences import SequenceTask

READ_S: Final = 300.0
"""Time between readings of sensors, s."""
PROBE_EVERY_S: Final = 600.0
"""Time between readings with a touch probe while something heats up, s."""
STANDARD: Final = "after public descriptions of ISO 230-3:2020"
UNVERIFIED: Final = (
    "Times, speeds and numbers of readings are choices of twin, not checked against the text of the standard."
)


@final
@dataclass(frozen=True)
class DriftTask:
    """Input of a drift sequence.

    Attributes:
        base: machine, instrument geometry, parts on the table, sizes, minutes and seed.
        instrument: one of `twin._common.families.DRIFT_INSTRUMENTS`.
        highest_rpm: highest spindle speed; None if not given.
        spectrum: whether the speeds change at random instead of in steps.
        axis: index of the axis that moves.
        feed: feed of that axis, mm/min or degrees/min.
        angles_deg: positions of a rotary axis at which readings are taken; empty for a linear axis.
    """

    base: SequenceTask
    instrument: str
    highest_rpm: float | None
    spectrum: bool
    axis: int
    feed: float
    angles_deg: tuple[float, ...] = ()

    @property
    def seconds(self) -> float:
        """Duration of the test, without setting up."""
        return 60.0 * self.base.minutes

    @property
    def moved(self) -> Axis:
        """The axis that moves."""
        return self.base.machine.axes[self.axis]

    def reading_times(self, every_s: float) -> np.ndarray:
        """Return (n,) times of readings from 0 to the end.

        Raises:
            InputError: the time does not allow four readings.
        """
        if self.seconds < 3.0 * every_s:
            raise InputError(
                "too little time", expected=f"at least {3.0 * every_s / 60.0:g} minutes", value=self.base.minutes
            )
        return np.arange(0.0, self.seconds + 1.0, every_s)


@final
@dataclass(frozen=True)
class DriftSchedule:
    """Readings of a drift sequence in their order.

    Attributes:
        time_s: (n,) increasing.
        speed_rpm: (n,) spindle speed between the reading before and this one.
        pose: (n,) number of the pose, from 0: a part on the table, or a position of the rotary axis.
        exercised: (n,) whether the axis moves to and fro after this reading.
        notices: what to do between the readings, and what the test cannot show, in words.
    """

    time_s: np.ndarray
    speed_rpm: np.ndarray
    pose: np.ndarray
    exercised: np.ndarray
    notices: tuple[str, ...]


@final
@dataclass(frozen=True)
class DriftSequence:
    """A drift sequence.

    Attributes:
        name: the name that selects it.
        title: what it is.
        minutes: default duration.
        targets: number of parts on the table; one if a rotary axis moves.
        limits: what it does not show, in words.
        make: function that returns its schedule; it raises `InputError` where that is not possible.
    """

    name: str
    title: str
    minutes: float
    targets: int
    limits: str
    make: Callable[[DriftTask], DriftSchedule]
