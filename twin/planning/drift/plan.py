"""Plan a drift test: poses, times, spindle speeds, and the file to fill in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin.display import card, count_with_noun, note, pairs
from twin.machine.machine import Machine
from twin.measurement.columns import comment_lines, csv_text, number_cells
from twin.measurement.instruments import instrument_named
from twin.measurement.table import Measurements
from twin.planning.drift.specification import (
    INSTRUMENTS,
    STANDARD,
    UNVERIFIED,
    DriftSchedule,
    DriftSequence,
    DriftTask,
)
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

SCHEMA: Final = "twin.plan/1"
MOST_MINUTES: Final = 7.0 * 24.0 * 60.0
FEED_MM_MIN: Final = 5000.0
FASTEST_RPM: Final = 1e6
SENSORS: Final = ("X1", "X2", "Y1", "Y2", "Z")


@final
@dataclass(frozen=True)
class DriftPlan:
    """A drift test on one machine.

    Attributes:
        task: machine, instrument, parts on the table, speeds.
        sequence: the sequence.
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
        found = [
            f"parts on the table (work frame, mm): {parts}; the {words.tip} is {-self.task.base.tip_mm[2]:g} mm below the spindle nose",
            *self.schedule.notices,
            self.sequence.limits,
            UNVERIFIED,
        ]
        if self.task.instrument == "probe":
            found.append(
                "X, Y and Z are nominal: write the positions at which the tip was at the centre, and 0 in x_mm, y_mm and z_mm"
            )
        if self.task.instrument == "displacement":
            found.append(
                "sensor 1 is near the end of the mandrel, sensor 2 near the spindle nose; add their distances to the comment: X1-X2=… "
                "Y1-Y2=… in mm; the sensors count as the mandrel moves along + of the axis, else write X1=-X1"
            )
        return found

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
        machine = self.task.base.machine.name
        lines = [
            f"{machine}: drift test {self.sequence.name} with {self.task.instrument}, {count_with_noun(len(self.table), 'reading')}, "
            f"{self.minutes:.0f} minutes without setting up",
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

    def _repr_html_(self) -> str:
        facts = [
            ("instrument", self.task.instrument),
            ("duration", f"{self.minutes:.0f} minutes"),
            ("source", STANDARD),
        ]
        small = count_with_noun(len(self.table), "reading")
        return card(f"Drift test {self.sequence.name}", pairs(facts), *map(note, self.notices()), small=small).text


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

    Args:
        machine: the machine.
        sequence: the sequence.
        instrument: one of `INSTRUMENTS`.
        kit: usable ranges; `Kit.default` if None.
        places_mm: parts on the table by name, in the work frame; None: near the rim of the table.
        minutes: duration without setting up; None: that of the sequence.
        sizes: length of the probe or mandrel, sizes of probe and sphere.
        options: further fields of `DriftTask` by name (``highest_rpm``, ``spectrum``, ``axis`` by name, ``feed_mm_min``), ``seed``.

    Raises:
        InputError: an unknown instrument or axis, an impossible number, a pose out of reach.
    """
    task = _task(
        machine, sequence, instrument, kit, places_mm, minutes, sizes or InstrumentSizes(), dict(options or {})
    )
    schedule = sequence.make(task)
    n, names = len(schedule.time_s), list(task.base.places_mm)
    rest = np.tile(task.base.rest(), (len(names), 1))
    reached = reach(task.base, SequencePoints.at_places(rest, names, np.ones(len(names), dtype=int)))
    if len(reached.points) < len(names):
        why = ", ".join(f"{name}: {count}" for name, count in reached.dropped.items())
        raise InputError(
            f"a pose of the drift test is out of reach ({why})",
            expected="other places on the table, or another tool length",
        )
    points = reached.points.select(schedule.place)
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

    Raises:
        InputError: an unknown instrument or axis, an impossible number, a wrong number of parts on the table.
    """
    if instrument not in INSTRUMENTS:
        raise InputError(
            "no such instrument for a drift test", expected=f"one of {', '.join(INSTRUMENTS)}", value=instrument
        )
    sizes.check()
    duration = sequence.minutes if minutes is None else minutes
    feed = options.get("feed_mm_min") or FEED_MM_MIN
    highest = options.get("highest_rpm")
    for what, value, most in (
        ("duration", duration, MOST_MINUTES),
        ("feed", feed, 1e6),
        ("spindle speed", 1.0 if highest is None else highest, FASTEST_RPM),
    ):
        if not 0.0 < value <= most:
            raise InputError(f"impossible {what}", expected=f"above 0, up to {most:g}", value=value)
    axis = _axis(machine, options.get("axis"))
    reader = instrument_named("r-test" if instrument == "displacement" else instrument)
    tip = (0.0, 0.0, -(sizes.tool_length_mm or machine.tool_length_mm or 100.0))
    names = SET_UPS[reader.name]
    part = names.target if instrument == "probe" else names.station
    places = places_mm or _default_places(machine, sequence, part, tip, axis)
    if len(places) != sequence.targets or not np.isfinite(list(places.values())).all():
        raise InputError(
            "wrong places on the table", expected=f"{sequence.targets} in the work frame, mm", value=dict(places)
        )
    own = Kit.default(machine) if kit is None else kit
    base = SequenceTask(
        machine, reader, own, tip, MappingProxyType(dict(places)), duration, sizes, int(options.get("seed", 0))
    )
    return DriftTask(base, instrument, highest, bool(options.get("spectrum")), axis, feed)


def _axis(machine: Machine, name: str | None) -> int:
    """Return the index of a linear axis; the first if not named."""
    linear = {machine.axes[i].name: i for i in machine.linear}
    if len(linear) != 3 or (name is not None and name not in linear):
        expected = f"one of {', '.join(linear)}" if len(linear) == 3 else "a machine with three linear axes"
        raise InputError("no such linear axis", expected=expected, value=name)
    return linear[name] if name is not None else machine.linear[0]


def _default_places(
    machine: Machine, sequence: DriftSequence, part: str, tip: tuple[float, float, float], axis: int
) -> dict[str, tuple[float, float, float]]:
    """Return places on the table: one near its rim, or two in line with an axis (rotary axes at rest)."""
    x, y, z = default_place(machine, tip, central=False)
    if sequence.targets == 1:
        return {f"{part} 1": (x, y, z)}
    along = np.abs(np.round(np.asarray(machine.axes[axis].machine_direction), 3))
    if along[2] > 0.5:
        raise InputError(
            f"no default places for {machine.axes[axis].name}, which is perpendicular to the table",
            expected="two places at different heights on the table, with room for the spindle beside the higher one",
        )
    half = np.hypot(x, y) * along
    first, second = (tuple(float(v) for v in np.array([0.0, 0.0, z]) + way * half) for way in (-1.0, 1.0))
    return {f"{part} 1": first, f"{part} 2": second}  # type: ignore[dict-item]
