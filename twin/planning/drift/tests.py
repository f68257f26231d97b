"""The drift tests of ISO 230-3 that can be planned: environment, spindle, moving axes; to add one, add it here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis
from twin.planning.sequences import SequenceTask
from twin.planning.sequences.specification import CONTACT_S, CONTACTS, POINT_S, RETRACT_MM

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
    """Input of a drift sequence."""

    base: SequenceTask  # machine, instrument geometry, parts on the table, sizes, minutes and seed
    instrument: str  # one of `twin._common.families.DRIFT_INSTRUMENTS`
    highest_rpm: float | None  # highest spindle speed; None if not given
    spectrum: bool  # whether the speeds change at random instead of in steps
    axis: int  # index of the axis that moves
    feed: float  # feed of that axis, mm/min or degrees/min
    # positions of a rotary axis at which readings are taken; empty for a linear axis
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
        """Return (n,) times of readings from 0 to the end. Raises `InputError`: the time does not allow four readings."""
        if self.seconds < 3.0 * every_s:
            raise InputError(
                "too little time", expected=f"at least {3.0 * every_s / 60.0:g} minutes", value=self.base.minutes
            )
        return np.arange(0.0, self.seconds + 1.0, every_s)


@final
@dataclass(frozen=True)
class DriftSchedule:
    """Readings of a drift sequence in their order."""

    time_s: np.ndarray  # (n,) increasing
    speed_rpm: np.ndarray  # (n,) spindle speed between the reading before and this one
    pose: np.ndarray  # (n,) number of the pose, from 0: a part on the table, or a position of the rotary axis
    exercised: np.ndarray  # (n,) whether the axis moves to and fro after this reading
    notices: tuple[str, ...]  # what to do between the readings, and what the test cannot show, in words


@final
@dataclass(frozen=True)
class DriftSequence:
    """A drift sequence."""

    name: str  # the name that selects it
    title: str  # what it is
    minutes: float  # default duration
    targets: int  # number of parts on the table; one if a rotary axis moves
    limits: str  # what it does not show, in words
    # function that returns its schedule; it raises `InputError` where that is not possible
    make: Callable[[DriftTask], DriftSchedule]


# --- Moving linear or rotary axis: motion to and fro, readings at two target positions or at several angles, then rest

RUNNING_SHARE: Final = 0.8
"""Share of the time in which the axis moves or the spindle runs; it rests in the remaining time."""
ALONG: Final = 0.5
"""Direction cosine with the spindle above which an axis moves along it."""


def _linear(task: DriftTask) -> DriftSchedule:
    places = np.array(list(task.base.places_mm.values()))
    stroke = float(np.linalg.norm(places[1] - places[0]))
    name = task.moved.name
    notice = "readings at the two target positions; between them, strokes of {name} between the two target positions at {feed:g} mm/min"
    notices = [notice.format(name=name, feed=task.feed)]
    if abs(task.moved.machine_direction[2]) > ALONG:
        notices.append(
            f"{name} needs places at two levels: the upper part stands on a riser beside the lower one, because the tool comes from "
            "above; the change of the distance contains the riser's own expansion (iron: 12 µm per metre and kelvin); the width of "
            "the riser is not checked"
        )
    return _repeated(task, np.array([stroke]), stroke, notices)


def _rotary(task: DriftTask) -> DriftSchedule:
    angles = np.array(task.angles_deg)
    low, high = task.base.kit.ranges[task.axis]
    name, listed = task.moved.name, ", ".join(f"{angle:g}" for angle in angles)
    notices = [
        f"readings at {name} {listed} degrees in every cycle; between the cycles, turns of {name} between {low:g} and {high:g} degrees "
        f"at {task.feed:g} degrees/min; the default is the assumed fastest feed of the kit: state that of the machine",
        "the spindle and the linear axes drift too: run the test of the environment before, at one of these poses",
        "the test of rotary axes has a name in the public scope of the standard; its positions and times are choices of twin",
    ]
    return _repeated(task, np.diff(angles), float(high - low), notices)


def _repeated(task: DriftTask, steps: np.ndarray, stroke: float, notices: list[str]) -> DriftSchedule:
    """Return cycles of readings, one at each pose, with motion of the axis between the cycles.

    ``steps``: (poses - 1,) travel of the axis from pose to pose, mm or degrees. Raises `InputError`: the readings leave less than half
    of the time for the motion.
    """
    probing = task.instrument == "probe"
    every = PROBE_EVERY_S if probing else READ_S
    speed = float(task.base.kit.speeds[list(task.base.machine.linear)].min())
    slow = 2.0 * RETRACT_MM / speed + (CONTACTS * CONTACT_S if probing else POINT_S)
    offset = np.r_[0.0, np.cumsum(slow + 60.0 * steps / task.feed)]
    whole = offset[-1] + slow + 60.0 * float(np.sum(steps)) / task.feed
    if whole > every / 2.0:
        least = 120.0 * float(np.sum(steps)) / max(every / 2.0 - slow * (len(steps) + 1), 1.0)
        raise InputError(
            "the feed leaves no time to heat the axis between readings",
            expected=f"at least {least:.0f} per minute for {np.sum(steps):.0f} mm or degrees",
            value=task.feed,
        )
    start = task.reading_times(every)[:-1]
    time = (start[:, None] + offset).reshape(-1)
    running = RUNNING_SHARE * task.seconds
    last = np.arange(len(time)) % len(offset) == len(offset) - 1
    found = [
        *notices,
        f"the axis moves up to {running / 60.0:.0f} min, some {int((every - whole) // (120.0 * stroke / task.feed))} times to and fro "
        "after each cycle of readings; then it rests between the readings",
        f"readings take {whole / every:.0%} of the time, in which the axis does not heat up as between them",
    ]
    if probing:
        found.append("probing moves all linear axes: they warm a little at every reading")
    pose = np.tile(np.arange(len(offset)), len(start))
    return DriftSchedule(time, np.zeros(len(time)), pose, last & (time < running), tuple(found))


AXES: Final = DriftSequence(
    name="axes",
    title="thermal distortion caused by a moving axis: motion to and fro, cycles of readings, then rest",
    minutes=240.0,
    targets=2,
    limits="It shows one axis, at the positions of the readings only: let the machine cool before the next axis.",
    make=lambda task: _linear(task) if task.moved.linear else _rotary(task),
)

# --- Environmental temperature variation error: the machine at rest, readings over hours ----------

DAY_MINUTES: Final = 24.0 * 60.0


def _environment_schedule(task: DriftTask) -> DriftSchedule:
    time = task.reading_times(READ_S)
    notices = ["drives and cooling stay on, the spindle stands still; record the ambient temperature near the machine"]
    if task.instrument == "probe":
        notices.append("probing moves the axes: they warm a little at every reading, which sensors avoid")
    if task.base.minutes < DAY_MINUTES:
        notices.append("less than 24 h: the daily change of the environment is not complete")
    return DriftSchedule(
        time, np.zeros(len(time)), np.zeros(len(time), dtype=int), np.zeros(len(time), dtype=bool), tuple(notices)
    )


ENVIRONMENT: Final = DriftSequence(
    name="environment",
    title="environmental temperature variation error (ETVE): machine at rest",
    minutes=DAY_MINUTES,
    targets=1,
    limits="It shows one pose on one day; a change that the ambient sensor does not feel (sun, a door) looks like drift.",
    make=_environment_schedule,
)

# --- Rotating spindle: speed steps or a spectrum of speeds, then rest -----------------------------

STEPS: Final = (0.25, 0.5, 0.75, 1.0)
"""Speeds of the steps as shares of the highest one."""
SEGMENT_S: Final = 600.0
"""Time at one speed of a spectrum, s."""
STOP_S: Final = 60.0
"""Seconds assumed to stop the spindle, put the probe in, and put the test tool back."""


def _spindle_schedule(task: DriftTask) -> DriftSchedule:
    if task.highest_rpm is None:
        raise InputError("no highest spindle speed", expected="the highest speed to run, 1/min")
    probing = task.instrument == "probe"
    time = task.reading_times(PROBE_EVERY_S if probing else READ_S)
    running = RUNNING_SHARE * task.seconds
    middle = np.r_[0.0, (time[1:] + time[:-1]) / 2.0]  # a speed is that of the interval before its reading
    if task.spectrum:
        shares = np.random.default_rng(task.base.seed).choice((0.0, *STEPS), size=int(running // SEGMENT_S) + 1)
        shares[0] = STEPS[1]
        share = shares[np.minimum(middle // SEGMENT_S, len(shares) - 1).astype(int)]
    else:
        share = np.array(STEPS)[np.minimum(middle // (running / len(STEPS)), len(STEPS) - 1).astype(int)]
    speed = np.where((middle > 0.0) & (middle < running), np.round(share * task.highest_rpm), 0.0)
    notices = ["spindle_rpm is the speed from the reading before to this one; the first reading is of the cold machine"]
    if probing:
        stopped = STOP_S + CONTACTS * CONTACT_S
        notices += [
            f"a probe needs the spindle stopped: about {stopped:.0f} s at every reading (assumed), "
            f"{stopped / PROBE_EVERY_S:.0%} of the time; spindle nose and bearings cool meanwhile, so that less growth shows than in "
            "steady running",
            f"growth with a time constant of less than {stopped / 60.0:.1f} min and shifts with the speed at once do not show; "
            "the repeatability of the tool change is in every reading",
        ]
    elif task.instrument == "r-test":
        notices.append(
            "only a nest with non-contact sensors reads while the ball rotates; stop the spindle for a contacting one"
        )
    else:
        notices.append("run-out and expansion of the mandrel are in the readings: average over whole turns")
    return DriftSchedule(time, speed, np.zeros(len(time), dtype=int), np.zeros(len(time), dtype=bool), tuple(notices))


SPINDLE: Final = DriftSequence(
    name="spindle",
    title="thermal distortion caused by a rotating spindle: speeds, then rest",
    minutes=300.0,
    targets=1,
    limits="It shows one pose without cutting load. Steps separate speed from time only if each lasts longer than "
    "the spindle's time constant, or by a spectrum.",
    make=_spindle_schedule,
)
