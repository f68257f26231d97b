"""Drift tests after ISO 230-3 as sequences of readings over time: environment, spindle, moving axes. To add one, add it here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common import families
from twin._common.arrays import read_only
from twin._common.errors import InputError, require_name
from twin._common.files import write_atomic
from twin._common.units import count_with_noun
from twin.display import readable
from twin.display.results import Result
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import comment_lines, csv_text, number_cells
from twin.measurement.instruments import instrument_named
from twin.measurement.table import Measurements
from twin.planning.kit import CONTACT_S, Kit
from twin.planning.sequences.contacts import default_place, reach
from twin.planning.sequences.specification import (
    CONTACTS,
    POINT_S,
    RETRACT_MM,
    SET_UPS,
    InstrumentSizes,
    SequencePoints,
    SequenceTask,
    sequence_table,
)
from twin.standards.iso230_3 import design_of

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
    """Return cycles of readings, one at each pose, with motion of the axis between the cycles; `InputError` if it has too little time.

    ``steps``: (poses - 1,) travel of the axis from pose to pose, mm or degrees; ``stroke``: to one side between the cycles.
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


# --- Plan a drift test: poses, times, spindle speeds, and the file to fill in ---------------------

SCHEMA: Final = "twin.plan/1"
MOST_MINUTES: Final = 7.0 * 24.0 * 60.0
FEED_MM_MIN: Final = 5000.0
CANDIDATES: Final = 13
"""Angles of a rotary axis with ends that are tried for readings."""
MOST_ANGLES: Final = 5
FEWEST_ANGLES: Final = 3
RISERS_MM: Final = tuple(range(300, 40, -10))
"""Heights of the riser of the upper part that are tried for an axis along the spindle."""
ASIDE: Final = (0.5, 0.65, 0.8)
"""Distances of the upper part from the lower one that are tried, as shares of the height of the riser."""
FASTEST_RPM: Final = 1e6
SENSORS: Final = ("X1", "X2", "Y1", "Y2", "Z")


@final
@dataclass(frozen=True, repr=False)
class DriftPlan(Result):
    """A drift test on one machine.

    Attributes:
        task: machine, instrument, parts on the table, speeds.
        schedule: times, speeds and targets.
        table: the readings to take, as a measurement table without coordinates.
    """

    task: DriftTask
    sequence: DriftSequence
    schedule: DriftSchedule
    table: Measurements

    @property
    def minutes(self) -> float:
        """Duration in minutes, without setting up."""
        return float(self.schedule.time_s[-1]) / 60.0

    def notices(self) -> list[str]:
        """Return what to know before carrying it out."""
        words = self.task.base.words
        parts = ", ".join(f"{name} at {x:g}, {y:g}, {z:g}" for name, (x, y, z) in self.task.base.places_mm.items())
        notices = [
            f"parts on the table (work frame, mm): {parts}; the {words.tip} is {-self.task.base.tip_mm[2]:g} mm below the spindle nose",
            *self.schedule.notices,
            *self._uncertainties(),
            self.sequence.limits,
            UNVERIFIED,
        ]
        if self.task.instrument == "probe":
            notices.append(
                "X, Y and Z are nominal: write the positions at which the tip was at the centre, and 0 in x_mm, y_mm and z_mm"
            )
        if self.task.instrument == "displacement":
            notices.append(
                "sensor 1 is near the end of the mandrel, sensor 2 near the spindle nose; add their distances to the comment: X1-X2=… "
                "Y1-Y2=… in mm; the sensors count as the mandrel moves along + of the axis, else write X1=-X1"
            )
        return notices

    def _uncertainties(self) -> list[str]:
        """Return what the readings at a rotary axis determine, in words."""
        count = len(self.task.angles_deg)
        if not count:
            return []
        design = design_of(
            self.task.moved,
            np.asarray(self.table.positions[:count]),
            ["tool"] * count,
            ["work"] * count,
            self.task.base.machine,
        )
        factor = np.sqrt(2.0) * np.linalg.norm(np.linalg.pinv(design.matrix.reshape(3 * count, -1)), axis=1)
        listed = [
            f"{name} {value:.2g} {readable(unit)}"
            for name, value, unit in zip(design.names, factor, design.units, strict=True)
        ]
        return [f"1 µm standard uncertainty of each reading gives the changes of one cycle one of: {', '.join(listed)}"]

    def save(self, path: str | Path) -> None:
        """Write the plan atomically: a measurement table, or the record of displacement sensors to fill in."""
        name = self.task.base.machine.name
        head = f"plan by twin: {name}, {self.task.instrument}, drift test {self.sequence.name} ({self.sequence.title})"
        comment = "\n".join([head, f"source: {STANDARD}", *self.notices()])
        machine = self.task.base.machine
        if self.task.instrument != "displacement":
            self.table.save(path, machine, comment=comment, planned={*self.table.station, *self.table.target})
            return
        given = " ".join(f"{name}={name}" for name in (*SENSORS, "ambient"))
        empty = [""] * len(self.table)
        columns = {"time_s": number_cells(self.table.time_s), "spindle_rpm": number_cells(self.schedule.speed_rpm)}
        columns |= {
            f"{a.name}_{a.unit}": number_cells(q) for a, q in zip(machine.axes, self.table.positions.T, strict=True)
        }
        columns |= {**{f"{name}_um": empty for name in SENSORS}, "T_ambient_degC": empty}
        write_atomic(Path(path), csv_text(columns, comment_lines(f"{comment}\nsensors: {given}", simulated=False)))

    def to_text(self) -> str:
        """Return the text report."""
        lines = [
            self.brief,
            f"{self.sequence.title}; {STANDARD}",
            *self._speeds(),
            "",
            *(f"note: {text}" for text in self.notices()),
        ]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object (``schema: twin.plan/1``)."""
        return {
            "schema": SCHEMA,
            "machine": self.task.base.machine.name,
            "instrument": self.task.instrument,
            "drift": self.sequence.name,
            "source": STANDARD,
            "unverified": UNVERIFIED,
            "points": len(self.table),
            "minutes": self.minutes,
            "time_s": self.schedule.time_s.tolist(),
            "spindle_rpm": self.schedule.speed_rpm.tolist(),
            "notices": self.notices(),
            "seed": self.task.base.seed,
        }

    def _speeds(self) -> list[str]:
        speed, time = self.schedule.speed_rpm, self.schedule.time_s
        if not speed.any():
            return []
        starts = 1 + np.flatnonzero(np.r_[True, np.diff(speed[1:]) != 0.0])
        parts = [f"from {time[i - 1] / 60.0:.0f} min {speed[i]:g}" for i in starts]
        return [f"spindle speeds, 1/min: {', '.join(parts)}"]

    @property
    def brief(self) -> str:
        """Test, instrument, number of readings and duration."""
        test = f"{self.task.base.machine.name}: drift test {self.sequence.name} with {self.task.instrument}"
        readings = count_with_noun(len(self.table), "reading")
        return f"{test}, {readings}, {self.minutes:.0f} minutes without setting up"


DRIFTS: Final = (ENVIRONMENT, SPINDLE, AXES)
"""All drift sequences; their names are `twin._common.families.DRIFTS`."""


def drift_plan(
    machine: Machine,
    name: str,
    instrument: str = "probe",
    kit: Kit | None = None,
    *,
    places_mm: Mapping[str, tuple[float, float, float]] | None = None,
    minutes: float | None = None,
    sizes: InstrumentSizes | None = None,
    options: Mapping[str, Any] | None = None,
) -> DriftPlan:
    """Plan the drift test of a name.

    Args:
        machine: the machine.
        name: one of `twin._common.families.DRIFTS`.
        instrument: one of `twin._common.families.DRIFT_INSTRUMENTS`.
        kit: usable ranges; `Kit.default` if None.
        places_mm: parts on the table by name, in the work frame; None: near the rim of the table.
        minutes: duration without setting up; None: that of the test.
        sizes: length of the probe or mandrel, sizes of probe and sphere.
        options: further fields of `DriftTask` by name (``highest_rpm``, ``spectrum``, ``axis`` by name, ``feed_mm_min``), ``seed``.

    Raises:
        InputError: an unknown name, instrument or axis, an impossible number, a pose out of reach.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.drift_plan(machine, "spindle", "probe", options={"highest_rpm": 8000})
        >>> plan.minutes
        300.0
        >>> plan.save("spindle.csv")

    References:
        - ISO 230-3:2020, Determination of thermal effects.
    """
    require_name("drift test", name, families.DRIFTS)
    sequence = next(drift for drift in DRIFTS if drift.name == name)
    task = _task(
        machine, sequence, instrument, kit, places_mm, minutes, sizes or InstrumentSizes(), dict(options or {})
    )
    schedule = sequence.make(task)
    n = len(schedule.time_s)
    reached = reach(task.base, _poses(task))
    if reached.dropped:
        why = ", ".join(f"{name}: {count}" for name, count in reached.dropped.items())
        raise InputError(
            f"a pose of the drift test is out of reach ({why})",
            expected="other places on the table, or another tool length",
        )
    points = reached.points.select(schedule.pose)
    table = replace(
        sequence_table(task.base, points),
        time_s=read_only(np.round(schedule.time_s, 1)),
        approach=read_only(np.zeros((n, len(machine.axes)))),
        channels=MappingProxyType({"spindle_rpm": read_only(schedule.speed_rpm)}),
        temperature_degC=MappingProxyType({"ambient": read_only(np.full(n, np.nan))}),
    )
    return DriftPlan(task, sequence, schedule, table)


def _task(
    machine: Machine,
    sequence: DriftSequence,
    instrument: str,
    kit: Kit | None,
    places_mm: Mapping[str, tuple[float, float, float]] | None,
    minutes: float | None,
    sizes: InstrumentSizes,
    options: dict[str, Any],
) -> DriftTask:
    """Return the task, with the defaults; `InputError` for unknown names, impossible numbers, a wrong number of parts."""
    require_name("instrument for a drift test", instrument, families.DRIFT_INSTRUMENTS)
    sizes.check()
    axis = _axis(machine, options.get("axis"))
    moved, own = machine.axes[axis], Kit.default(machine) if kit is None else kit
    duration = sequence.minutes if minutes is None else minutes
    fastest = 60.0 * float(own.speeds[axis])
    feed = options.get("feed_mm_min") or (FEED_MM_MIN if moved.linear else fastest)
    highest = options.get("highest_rpm")
    _check_numbers(duration, feed, highest)
    reader = instrument_named("r-test" if instrument == "displacement" else instrument)
    tip = (0.0, 0.0, -(sizes.tool_length_mm or machine.tool_length_mm or 100.0))
    names = SET_UPS[reader.name]
    part = names.target if instrument == "probe" else names.station
    turning = sequence.targets > 1 and not moved.linear
    if turning and instrument == "displacement":
        raise InputError(
            "fixed sensors do not follow a rotary axis", expected="a touch probe or an R-test", value=instrument
        )
    parts = 1 if turning else sequence.targets
    x, y, z = default_place(machine, tip, central=False)
    default = {f"{part} 1": (x, y, z)}
    base = SequenceTask(
        machine,
        reader,
        own,
        tip,
        MappingProxyType(dict(places_mm or default)),
        duration,
        sizes,
        int(options.get("seed", 0)),
    )
    task = DriftTask(base, instrument, highest, bool(options.get("spectrum")), axis, feed)
    if parts == 2 and not places_mm:
        task = replace(task, base=replace(base, places_mm=MappingProxyType(_two_places(task, part))))
    found = task.base.places_mm
    if len(found) != parts or not np.isfinite(list(found.values())).all():
        raise InputError("wrong places on the table", expected=f"{parts} in the work frame, mm", value=dict(found))
    return replace(task, angles_deg=_angles(task)) if turning else task


def _check_numbers(duration: float, feed: float, highest: float | None) -> None:
    """Raise `InputError` for a duration, feed or speed that is impossible."""
    for what, value, most in (
        ("duration", duration, MOST_MINUTES),
        ("feed", feed, 1e6),
        ("spindle speed", 1.0 if highest is None else highest, FASTEST_RPM),
    ):
        if not 0.0 < value <= most:
            raise InputError(f"impossible {what}", expected=f"above 0, up to {most:g}", value=value)


def _poses(task: DriftTask) -> SequencePoints:
    """Return the poses of the readings: the places on the table, or the angles of the rotary axis; linear axes still open."""
    names = list(task.base.places_mm) * max(len(task.angles_deg), 1)
    rest = np.tile(task.base.rest(), (len(names), 1))
    if task.angles_deg:
        rest[:, task.axis] = task.angles_deg
    return SequencePoints.at_places(rest, names, np.ones(len(names), dtype=int))


def _angles(task: DriftTask) -> tuple[float, ...]:
    """Return the angles for the readings, in quarters or over those within reach; `InputError` if fewer than three."""
    if task.moved.lower is None:
        return (0.0, 90.0, 180.0, 270.0)
    low, high = task.base.kit.ranges[task.axis]
    tried = [float(angle) for angle in np.round(np.linspace(low, high, CANDIDATES), 1)]
    found = [one for one in tried if not reach(task.base, _poses(replace(task, angles_deg=(one,)))).dropped]
    if len(found) < FEWEST_ANGLES:
        raise InputError(
            f"{len(found)} angles of {task.moved.name} are within reach",
            expected=f"at least {FEWEST_ANGLES}: another place on the table, or another tool length",
        )
    spread = np.round(np.linspace(0, len(found) - 1, min(MOST_ANGLES, len(found)))).astype(int)
    return tuple(found[k] for k in spread)


def _axis(machine: Machine, name: str | None) -> int:
    """Return the index of an axis; the first linear one if not named."""
    if len(machine.linear) != 3 or (name is not None and name not in machine.names):
        three = len(machine.linear) == 3
        expected = f"one of {', '.join(machine.names)}" if three else "a machine with three linear axes"
        raise InputError("no such axis", expected=expected, value=name)
    return machine.linear[0] if name is None else machine.names.index(name)


def _two_places(task: DriftTask, part: str) -> dict[str, tuple[float, float, float]]:
    """Return two places in line with a linear axis, for one along the spindle at two levels; `InputError` if out of reach."""
    x, y, z = next(iter(task.base.places_mm.values()))
    along = np.abs(np.round(np.asarray(task.moved.machine_direction), 3))
    if along[2] <= 0.5:
        half = np.hypot(x, y) * along
        first, second = (tuple(float(v) for v in np.array([0.0, 0.0, z]) + way * half) for way in (-1.0, 1.0))
        return {f"{part} 1": first, f"{part} 2": second}  # type: ignore[dict-item]
    for riser, share in product(RISERS_MM, ASIDE):
        aside = round(share * riser)
        for dx, dy in ((-aside, 0.0), (0.0, aside), (0.0, -aside)):
            two_places = {f"{part} 1": (x, y, z), f"{part} 2": (x + dx, y + dy, z + riser)}
            above = two_places | {
                f"{part} 2": (x + dx, y + dy, z + riser + task.base.sizes.around_mm)
            }  # room to retract
            tried = [replace(task.base, places_mm=MappingProxyType(places)) for places in (two_places, above)]
            if not any(reach(base, _poses(replace(task, base=base))).dropped for base in tried):
                return two_places
    raise InputError(
        f"no default places for {task.moved.name}: its target positions are at two levels",
        expected="two places at different levels on the table, with room for the spindle beside the higher one",
    )
