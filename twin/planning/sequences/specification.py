"""Specification of a measuring sequence, what it is made from, and the points that it consists of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.families import SEQUENCE_INSTRUMENTS
from twin._common.messages import Message, joined, say
from twin._common.records import json_form
from twin._common.units import MM
from twin.display import readable
from twin.identification.unidentified import ConstantErrors, constant_errors
from twin.machine.machine import Machine
from twin.measurement.contacts import approach_of
from twin.measurement.instruments import Instrument, StationInstruments
from twin.measurement.observation import Observation
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.simulate import Station
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import unit_of
from twin.planning.kit import Kit


@final
@dataclass(frozen=True)
class PartNames:
    """Names of the parts of an instrument."""

    station: str  # station, target: names of the station and the target in the table, without number
    target: str
    places: Message  # the parts on the table, in words (plural)
    tip: Message  # the part in the spindle, in words
    set_up_s: float  # seconds for setting up one part on the table (assumed): fastening it and finding it with the axes


_PARTS: Final = (
    PartNames("probe", "sphere", Message("spheres"), Message("tip"), 180.0),
    PartNames("nest", "ball", Message("nests"), Message("ball"), 900.0),
    PartNames("pivot", "ball", Message("pivots"), Message("ball"), 300.0),
)
SET_UPS: Final = dict(zip(SEQUENCE_INSTRUMENTS, _PARTS, strict=True))
"""Parts of each instrument that measures the tool relative to the table, by the name of the instrument."""


@final
@dataclass(frozen=True)
class InstrumentSizes:
    """Sizes of the instrument: they keep the probe clear of the sphere, and motions within the ranges.

    Attributes:
        tool_length_mm: from the spindle nose to the tip or the ball; None: that of the machine file, or 100 mm.
        sphere_mm: diameter of the calibration sphere.
        ball_mm: diameter of the stylus ball.
        clearance_mm: distance that is kept from the sphere outside of contacts, and from everything else.
        bar_mm: length of a ball bar.
        feed_mm_min: feed of a ball bar.

    Examples:
        >>> sizes = twin.InstrumentSizes(tool_length_mm=120.0, sphere_mm=25.0, ball_mm=6.0)
        >>> sizes.contact_mm
        15.5
    """

    tool_length_mm: float | None = None
    sphere_mm: float = 25.0
    ball_mm: float = 6.0
    clearance_mm: float = 10.0
    bar_mm: float = 100.0
    feed_mm_min: float = 1000.0

    @property
    def contact_mm(self) -> float:
        """Distance between the centres of stylus ball and sphere at contact."""
        return (self.sphere_mm + self.ball_mm) / 2.0

    @property
    def around_mm(self) -> float:
        """Distance between the centres before a contact."""
        return self.contact_mm + self.clearance_mm

    def check(self) -> None:
        """Raise `InputError` unless all sizes are positive."""
        if self.tool_length_mm is not None and not 0.0 < self.tool_length_mm < 1e4:
            raise InputError("impossible length of the probe", expected="0 to 10000 mm", value=self.tool_length_mm)
        named = {
            "sphere": self.sphere_mm,
            "stylus ball": self.ball_mm,
            "clearance": self.clearance_mm,
            "bar": self.bar_mm,
        }
        for name, value in named.items():
            if not 0.0 < value < 1e3:
                raise InputError(f"size of the {name} is impossible", expected="0 to 1000 mm", value=value)
        if not 0.0 < self.feed_mm_min < 1e6:
            raise InputError("impossible feed", expected="a positive number of mm/min", value=self.feed_mm_min)


@final
@dataclass(frozen=True)
class SequenceTask:
    """Input of a sequence: machine, instrument, parts on the table and sizes."""

    machine: Machine
    instrument: Instrument  # the instrument, one of `SET_UPS`
    kit: Kit  # speeds and usable ranges; its stations, targets and times are not used
    tip_mm: tuple[float, float, float]  # (3,) the tool-side part in the frame of the spindle nose
    places_mm: Mapping[str, tuple[float, float, float]]  # the parts on the table by name, in the work frame
    minutes: float  # time budget, set-up included
    sizes: InstrumentSizes
    seed: int = 0  # random seed

    @property
    def words(self) -> PartNames:
        """Names of the instrument's parts."""
        return SET_UPS[self.instrument.name]

    @property
    def margin_mm(self) -> float:
        """Distance that linear axes keep from the ends of their ranges."""
        return self.sizes.around_mm if self.instrument.specification.reads == "null" else 1.0

    @property
    def rotary(self) -> tuple[int, ...]:
        """Indices of the rotary axes, in command order."""
        return self.machine.rotary

    def rest(self) -> np.ndarray:
        """Return (axes,) the position of the rotary axes that do not turn: zero, or the end of the range nearest to it."""
        low, high = self.kit.ranges.T
        return np.where([axis.linear for axis in self.machine.axes], 0.0, np.clip(0.0, low, high))


@final
@dataclass(frozen=True)
class SequencePoints:
    """Points of a sequence in order; the positions of the linear axes follow from them."""

    positions: np.ndarray  # (n, axes) mm and degrees; those of the linear axes are not used
    place: np.ndarray  # (n,) names of the parts on the table
    offset_mm: np.ndarray  # (n, 3) wanted position of the tool-side part from the part on the table, base frame
    run: np.ndarray  # (n,) number of the run, from 1

    @classmethod
    def at_places(cls, positions: np.ndarray, place: np.ndarray | list[str], run: np.ndarray) -> SequencePoints:
        """Return points at which the tool-side part is at the part on the table."""
        return cls(positions, np.array(place, dtype=object), np.zeros((len(positions), 3)), run)

    def __len__(self) -> int:
        return len(self.positions)

    def select(self, rows: np.ndarray) -> SequencePoints:
        """Return some of the points, by index or mask."""
        return SequencePoints(self.positions[rows], self.place[rows], self.offset_mm[rows], self.run[rows])


@final
@dataclass(frozen=True)
class MeasuringSequence:
    """A sequence of poses for instruments that measure the tool relative to the table."""

    name: str  # the name that selects it
    title: Message  # what it is
    source: Message  # standard and clause, or another source
    instruments: tuple[str, ...]  # names of the instruments that it is for
    unverified: Message  # what was not checked against the text of the standard; empty if it follows none
    limits: Message  # what it does not do or show, in words
    # function that returns its points; it raises `InputError` where the machine cannot perform it
    make: Callable[[SequenceTask], SequencePoints]


# --- The table of a sequence, its duration, and what it determines of the constant errors ---------

CONTACTS: Final = 5
"""Contacts per sphere: four at the equator and one at the pole."""
POINT_S: Final = 3.0
"""Seconds for a reading of an R-test at rest."""
RETRACT_MM: Final = 100.0
"""Length of the retraction before rotary axes turn and of the approach after it, assumed for the duration of probing."""


def sequence_table(task: SequenceTask, points: SequencePoints) -> Measurements:
    """Return the measurement table of points whose linear positions are known, with the readings of the nominal machine."""
    n, words = len(points), task.words
    reads = task.instrument.specification.reads
    on_tool = probing = reads == "null"
    place = np.array([task.places_mm[str(name)] for name in points.place]).reshape(n, 3)
    tip = np.tile(np.array(task.tip_mm), (n, 1))
    reader, target = (tip, place) if on_tool else (place, tip)
    tip_name = words.station if on_tool else words.target
    names = np.full(n, tip_name, dtype=object)
    table = Measurements(
        source=f"plan {task.instrument.name}",
        lines=read_only(np.arange(1, n + 1)),
        positions=read_only(points.positions.copy()),
        target=read_only(points.place if on_tool else names),
        carrier=read_only(np.full(n, "work" if on_tool else "tool", dtype=object)),
        station=read_only(names if on_tool else points.place),
        station_carrier=read_only(np.full(n, "tool" if on_tool else "work", dtype=object)),
        instrument=read_only(np.full(n, task.instrument.name, dtype=object)),
        round=read_only(points.run.astype(str).astype(object)),
        approach=read_only(approach_of(task.machine, points.positions, linear=not probing)),
        place_mm=read_only(target),
        station_pose=read_only(np.concatenate([reader, np.zeros((n, 3))], axis=1)),
        feed_mm_min=read_only(np.full(n, task.sizes.feed_mm_min if reads == "length" else np.nan)),
        bar_mm=read_only(np.full(n, task.sizes.bar_mm if task.instrument.specification.nominal_length else np.nan)),
    )
    return replace(table, time_s=read_only(np.round(np.cumsum(seconds_of(task.machine, task.kit, table)), 1)))


def seconds_of(machine: Machine, kit: Kit, table: Measurements) -> np.ndarray:
    """Return the seconds (n,) from each reading of a plan to the next, in its order, without setting up."""
    instrument = str(table.instrument[0])
    away = np.abs(np.diff(table.positions, axis=0, prepend=table.positions[:1]))
    if instrument == "ball-bar":
        linear = list(machine.linear)
        path = np.linalg.norm(away[:, linear], axis=1)
        feed = np.where(np.isfinite(table.feed_mm_min), table.feed_mm_min, 1000.0) / 60.0
        return np.asarray(path / feed)
    travel = (away / kit.speeds).max(axis=1)
    if instrument != "probe":
        return np.asarray(travel + POINT_S)
    linear_speed = float(kit.speeds[list(machine.linear)].min())
    return np.asarray(travel + 2.0 * RETRACT_MM / linear_speed + CONTACTS * kit.seconds.contact)


def minutes_of(machine: Machine, kit: Kit, table: Measurements) -> float:
    """Return the minutes that a plan takes, set-up of each part on the table included."""
    parts = len({*table.target, *table.station}) - 1
    return (float(seconds_of(machine, kit, table).sum()) + parts * SET_UPS[str(table.instrument[0])].set_up_s) / 60.0


@final
@dataclass(frozen=True)
class Expectation:
    """The constant errors that a sequence determines, for several states of knowledge of the set-up."""

    by_knowledge: Mapping[
        Message, ConstantErrors
    ]  # the constant errors by the known parts, in words; nothing known first

    @property
    def unknown(self) -> ConstantErrors:
        """The constant errors if nothing of the set-up is known."""
        return next(iter(self.by_knowledge.values()))

    def lines(self, others: Mapping[Message, Mapping[str, float]] | None = None) -> list[str]:
        """Return the text: one line per constant error, then the errors that are not determined."""
        headers, rows = self.rows(others)
        titles = [say(title) for title in headers[1:]]
        width = max(map(len, titles)) + 2
        lines = [
            Message(
                "constant errors, predicted standard uncertainty (k = 1); - where this sequence cannot determine it:"
            ),
            " " * 16 + "".join(f"{title:>{width}}" for title in titles),
            *(f"  {name:<14}" + "".join(f"{cell:>{width}}" for cell in cells) for name, *cells in rows),
        ]
        lines.append(Message("what this sequence cannot tell:"))
        for title, constants in self.by_knowledge.items():
            lost = joined("; ", constants.lost) or Message("nothing among the errors of the axes that it moves")
            lines.append(
                Message(
                    "  {title}: {lost} ({determined} of {count} determined)",
                    title=title,
                    lost=lost,
                    determined=constants.determined,
                    count=len(constants.u),
                )
            )
        return lines

    def rows(
        self, others: Mapping[Message, Mapping[str, float]] | None = None
    ) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return headers and rows of the table of uncertainties, one row per constant error; arguments as of `lines`."""
        columns = {**{name: found.u for name, found in self.by_knowledge.items()}, **(others or {})}
        rows = []
        for name in dict.fromkeys(name for found in columns.values() for name in found):
            unit = readable(unit_of(name)) if "0" in name else "µm/m"
            rows.append((f"{name:<6} {unit}", *(_short(own.get(name, np.nan)) for own in columns.values())))
        return ("error", *columns), rows

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the JSON list, one entry for each state of knowledge."""
        return [
            {
                "known": title,
                "determined": constants.determined,
                "errors": json_form(
                    [
                        {
                            "name": name,
                            "unit": unit_of(name) if "0" in name else "um_per_m",
                            "u": None if value != value else value,
                        }
                        for name, value in constants.u.items()
                    ]
                ),
                "cannot_tell": list(constants.lost),
            }
            for title, constants in self.by_knowledge.items()
        ]


def _short(value: float) -> str:
    """Return an uncertainty with two digits, or a dash."""
    return "-" if value != value else f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def expectation(machine: Machine, table: Measurements, instrument: Instrument) -> Expectation:
    """Return what a plan determines of the constant errors: with nothing of the set-up known, with its parts known."""
    read = with_nominal_readings(machine, table, instrument)
    instruments = StationInstruments.same(instrument, read.station)
    setup = StationsAndTargets.from_table(read, instruments)
    words, probing = SET_UPS[instrument.name], instrument.specification.reads == "null"
    stations, targets = np.zeros(len(setup.stations), dtype=bool), np.zeros(len(setup.targets), dtype=bool)
    places = Message("{places} known", places=words.places)
    states = {
        Message("nothing known"): (stations, targets),
        places: (stations, ~targets) if probing else (~stations, targets),
        Message("{places} and {tip} known", places=words.places, tip=words.tip): (~stations, ~targets),
    }
    by_name = {}
    for name, (station_known, target_known) in states.items():
        of = replace(setup, station_known=station_known, target_known=target_known)
        constants = constant_errors(machine, read, instruments, of)
        if constants is not None:
            by_name[name] = constants
    return Expectation(MappingProxyType(by_name))


def with_nominal_readings(machine: Machine, table: Measurements, instrument: Instrument) -> Measurements:
    """Return a plan with the readings of the nominal machine: they show which coordinates are read, and how well."""
    if instrument.specification.reads == "null":
        return replace(table, point_mm=read_only(np.zeros((len(table), 3))))
    points = Observation(machine).points_mm(Calibration.zero(machine), table, table.place_mm)
    seen = np.empty((len(table), 3))
    for name in dict.fromkeys(table.station):
        rows = table.station == name
        seen[rows] = Station.at(table.station_pose[rows][0]).to_station_mm(points[rows])
    return replace(table, point_mm=read_only(instrument.read(seen * MM) / MM))
