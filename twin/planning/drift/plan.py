"""Plan a drift test: poses, times, spindle speeds, and the file to fill in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, require_name
from twin._common.families import DRIFT_INSTRUMENTS
from twin._common.files import write_atomic
from twin._common.units import count_with_noun
from twin.display import readable
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.measurement.columns import comment_lines, csv_text, number_cells
from twin.measurement.instruments import instrument_named
from twin.measurement.table import Measurements
from twin.planning.drift.tests import STANDARD, UNVERIFIED, DriftSchedule, DriftSequence, DriftTask
from twin.planning.kit import Kit
from twin.planning.sequences import (
    SET_UPS,
    InstrumentSizes,
    SequencePoints,
    SequenceTask,
    default_place,
    reach,
    sequence_table,
)
from twin.standards.drift.iso230_3 import design_of

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


def make_drift_plan(
    machine: Machine,
    sequence: DriftSequence,
    instrument: str,
    kit: Kit | None = None,
    *,
    places_mm: Mapping[str, tuple[float, float, float]] | None = None,
    minutes: float | None = None,
    sizes: InstrumentSizes | None = None,
    options: Mapping[str, Any] | None = None,
) -> DriftPlan:
    """Plan a drift test.

    ``instrument``: one of `twin._common.families.DRIFT_INSTRUMENTS`; ``kit``: usable ranges; `Kit.default` if None; ``places_mm``:
    parts on the table by name, in the work frame; None: near the rim of the table; ``minutes``: duration without setting up; None: that
    of the sequence; ``options``: further fields of `DriftTask` by name (``highest_rpm``, ``spectrum``, ``axis`` by name,
    ``feed_mm_min``), ``seed``. Raises `InputError`: an unknown instrument or axis, an impossible number, a pose out of reach.
    """
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
    """Return the task, with the defaults.

    Raises `InputError`: an unknown instrument or axis, an impossible number, a wrong number of parts on the table.
    """
    require_name("instrument for a drift test", instrument, DRIFT_INSTRUMENTS)
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
    """Return the angles of the rotary axis for the readings: a turn in quarters, or spread over those within reach.

    Raises `InputError`: fewer than three are within reach.
    """
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
    """Return two places in line with a linear axis; for one along the spindle at two levels, beside each other (rotary axes at rest).

    Raises `InputError`: the upper place is out of reach at every level.
    """
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
