"""Plan a measuring sequence, or predict the result of an existing one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.messages import Message, joined, say
from twin._common.resources import one_blas_thread
from twin._common.units import count_with_noun
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, instrument_named
from twin.measurement.table import Measurements
from twin.planning.kit import Kit
from twin.planning.sequences.contacts import default_place, reach
from twin.planning.sequences.moves import sequence_named
from twin.planning.sequences.specification import (
    SET_UPS,
    Expectation,
    InstrumentSizes,
    MeasuringSequence,
    SequenceTask,
    expectation,
    minutes_of,
    sequence_table,
)

SCHEMA: Final = "twin.plan/1"
MINUTES: Final = 60.0
"""Time budget of a sequence that is chosen by the time."""
BEST_COLUMN: Final = Message("best, nothing known")
MOST_MINUTES: Final = 24.0 * 60.0


@final
@dataclass(frozen=True, repr=False)
class SequencePlan(Result):
    """A measuring sequence on one machine.

    Attributes:
        task: machine, instrument, parts and sizes.
        table: the plan, with the nominal places of the parts.
        dropped: number of points that are out of reach, by reason.
        expected: what it determines of the constant errors.
        best: what the best design of the same duration determines; None for the best design itself.
    """

    task: SequenceTask
    sequence: MeasuringSequence
    table: Measurements
    dropped: Mapping[Message, int]
    expected: Expectation
    best: Expectation | None

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.task.machine

    @property
    def minutes(self) -> float:
        """Duration in minutes, set-up included."""
        return minutes_of(self.machine, self.task.kit, self.table)

    def notices(self) -> list[Message]:
        """Return what to know before carrying it out."""
        parts = "; ".join(f"{name} ({x:g}, {y:g}, {z:g})" for name, (x, y, z) in self.task.places_mm.items())
        notices = [
            Message(
                "parts on the table (work frame, mm): {parts}; the {tip} is {depth:g} mm below the spindle nose",
                parts=parts,
                tip=self.task.words.tip,
                depth=-self.task.tip_mm[2],
            ),
            Message("planned_… are approximate places, which no evaluation treats as known"),
            Message(
                "poses are checked against the shapes of the URDF, with an assumed probe, stylus and stem; the moves "
                "between them are not"
            ),
        ]
        unused = [name for name in self.task.places_mm if name not in {*self.table.station, *self.table.target}]
        if unused:
            notices.append(
                Message(
                    "NOT MEASURED: {names}: no time for setting up, or no point of theirs is within reach",
                    names=", ".join(unused),
                )
            )
        if self.task.instrument.specification.reads == "null":
            notices.append(
                Message(
                    "X, Y and Z are nominal: the measured table has the positions at which the tip was at the centre of the "
                    "sphere, and 0 in x_mm, y_mm and z_mm"
                )
            )
        if self.dropped:
            notices.append(
                Message(
                    "points out of reach: {reasons}",
                    reasons=joined(
                        ", ", [Message("{count} ({why})", count=count, why=why) for why, count in self.dropped.items()]
                    ),
                )
            )
        notices.append(
            Message("the uncertainties hold where linear errors are the only ones that depend on the position")
        )
        notices += [text for text in (self.sequence.unverified, self.sequence.limits) if text]
        return notices

    def comment(self) -> str:
        """Return the comment lines of the file."""
        head = (
            f"plan by twin: {self.machine.name}, {self.task.instrument.name}, sequence {self.sequence.name} ({self.sequence.title}), "
            f"{count_with_noun(len(self.table), 'pose')}, {self.minutes:.0f} minutes, seed {self.task.seed}"
        )
        return "\n".join([head, f"source: {self.sequence.source}", *self.notices()])

    def save(self, path: str | Path) -> None:
        """Write the plan atomically as a measurement table without coordinates."""
        planned = {*self.table.station, *self.table.target}
        self.table.save(path, self.machine, comment=self.comment(), planned=planned)

    def to_text(self) -> str:
        """Return the text report."""
        others = {} if self.best is None else {BEST_COLUMN: self.best.unknown.u}
        lines = [
            self.brief,
            Message("{title}; {source}", title=self.sequence.title, source=self.sequence.source),
            "",
            *self.expected.lines(others),
            "",
            *(Message("note: {text}", text=text) for text in self.notices()),
        ]
        return "\n".join(map(say, lines)) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object (``schema: twin.plan/1``)."""
        return {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "instrument": self.task.instrument.name,
            "sequence": self.sequence.name,
            "source": self.sequence.source,
            "unverified": self.sequence.unverified,
            "points": len(self.table),
            "minutes": self.minutes,
            "dropped": dict(self.dropped),
            "constant_errors": self.expected.to_dict(),
            "best_in_the_same_time": None if self.best is None else self.best.to_dict(),
            "notices": self.notices(),
            "seed": self.task.seed,
        }

    @property
    def brief(self) -> Message:
        """Sequence, instrument, number of poses and duration."""
        return Message(
            "{machine}: sequence {name} with {instrument}, {count:,} poses, {minutes:.0f} minutes",
            machine=self.machine.name,
            name=self.sequence.name,
            instrument=self.task.instrument.specification.title,
            count=len(self.table),
            minutes=self.minutes,
        )


def measuring_sequence(
    machine: Machine,
    instrument: Instrument | str = "probe",
    sequence: str | None = None,
    kit: Kit | None = None,
    *,
    places_mm: Mapping[str, tuple[float, float, float]] | None = None,
    minutes: float = MINUTES,
    sizes: InstrumentSizes | None = None,
    seed: int = 0,
) -> SequencePlan:
    """Plan a measuring sequence for an instrument that measures the tool relative to the table.

    Args:
        machine: the machine.
        instrument: touch probe, R-test or ball bar.
        sequence: name of the sequence (`twin.planning.sequences.SEQUENCES`); None: the best design, or circles for a ball bar.
        kit: speeds and usable ranges; `Kit.default` if None.
        places_mm: spheres, nests or pivots by name, in the work frame; None: one near the rim of the table (a pivot above its middle).
        minutes: time budget of the best design, set-up included; other sequences take the time that they need.
        sizes: length of the probe, sizes of probe and sphere, length and feed of a ball bar.
        seed: random seed of the design.

    Raises:
        InputError: an unknown name, a sequence that is not for this instrument or machine, too little time, or no point within reach.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.measuring_sequence(machine, "probe", places_mm={"a": (150.0, 0.0, 60.0)}, minutes=15)
        >>> plan.minutes <= 15
        True
        >>> plan.save("plan.csv")

    References:
        - ISO 10791-6:2014 (interpolated motions).
        - V. V. Fedorov: Theory of Optimal Experiments, Academic Press, 1972 (best design).
        - A. C. Atkinson, A. N. Donev, R. D. Tobias: Optimum Experimental Designs, with SAS, Oxford University Press, 2007, chapters 10
          to 12.
    """
    reader = instrument_named(instrument) if isinstance(instrument, str) else instrument
    chosen = sequence_named(sequence, reader.name)
    task = sequence_task(machine, reader, kit, places_mm, minutes, sizes or InstrumentSizes())
    task = replace(task, seed=seed)
    with one_blas_thread():
        reached = reach(task, chosen.make(task))
        if not len(reached.points):
            why = ", ".join(f"{name}: {count}" for name, count in reached.dropped.items())
            raise InputError(
                f"no point of sequence {chosen.name} is within reach ({why})",
                expected="other places on the table, or another tool length",
            )
        table = sequence_table(task, reached.points)
        measuring_sequence = SequencePlan(
            task, chosen, table, reached.dropped, expectation(machine, table, reader), best=None
        )
        own = sequence_named(None, reader.name)
        if chosen is own:
            return measuring_sequence
        return replace(measuring_sequence, best=_rival(replace(task, minutes=measuring_sequence.minutes), own))


def _rival(task: SequenceTask, sequence: MeasuringSequence) -> Expectation | None:
    """Return what the default sequence determines in the time of another; None if the time is too short for it."""
    try:
        reached = reach(task, sequence.make(task))
    except InputError:
        return None
    return expectation(task.machine, sequence_table(task, reached.points), task.instrument)


def judge_sequence(table: Measurements, machine: Machine) -> Expectation:
    """Return what a plan determines of the constant errors; `InputError` if it has several instruments or no places."""
    names = dict.fromkeys(table.instrument.astype(str))
    if len(names) > 1 or not set(names) <= set(SET_UPS):
        raise table.error(
            "stations with different instruments",
            expected=f"one of {', '.join(SET_UPS)} in every row",
            row=0,
            value=", ".join(names),
        )
    placed = np.isfinite(table.place_mm).all(axis=1) & np.isfinite(table.station_pose).all(axis=1)
    if not placed.all():
        row = int(np.flatnonzero(~placed)[0])
        raise table.error("no planned place", expected="planned_place_… and planned_station_… in every row", row=row)
    return expectation(machine, table, instrument_named(next(iter(names))))


def sequence_task(
    machine: Machine,
    instrument: Instrument,
    kit: Kit | None,
    places_mm: Mapping[str, tuple[float, float, float]] | None,
    minutes: float,
    sizes: InstrumentSizes,
) -> SequenceTask:
    """Return the task, with the defaults. Raises `InputError`: an impossible number."""
    sizes.check()
    if len(machine.linear) != 3:
        raise InputError(
            "not three linear axes", expected="a machine with three linear axes", value=", ".join(machine.names)
        )
    length = sizes.tool_length_mm or machine.tool_length_mm or 100.0
    if not 0.0 < minutes <= MOST_MINUTES:
        raise InputError("impossible time budget", expected=f"up to {MOST_MINUTES:g} minutes", value=minutes)
    words = SET_UPS[instrument.name]
    name = words.target if instrument.specification.reads == "null" else words.station
    central = instrument.specification.reads == "length"
    tip = (0.0, 0.0, -length)
    places = places_mm or {name: default_place(machine, tip, central=central)}
    if not np.isfinite(list(places.values())).all():
        raise InputError("a place on the table is not finite", expected="x, y, z in mm", value=dict(places))
    return SequenceTask(
        machine,
        instrument,
        Kit.default(machine) if kit is None else kit,
        tip,
        MappingProxyType(dict(places)),
        minutes,
        sizes,
    )
