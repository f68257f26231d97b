"""Specification of a measuring sequence, what it is made from, and the points that it consists of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import SEQUENCE_INSTRUMENTS
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.planning.kit import Kit


@final
@dataclass(frozen=True)
class PartNames:
    """Names of the parts of an instrument.

    Attributes:
        station, target: names of the station and the target in the table, without number.
        places: the parts on the table, in words (plural).
        tip: the part in the spindle, in words.
        set_up_s: seconds for setting up one part on the table (assumed): fastening it and finding it with the axes.
    """

    station: str
    target: str
    places: str
    tip: str
    set_up_s: float


_PARTS: Final = (
    PartNames("probe", "sphere", "spheres", "tip", 180.0),
    PartNames("nest", "ball", "nests", "ball", 900.0),
    PartNames("pivot", "ball", "pivots", "ball", 300.0),
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
    """Input of a sequence: machine, instrument, parts on the table and sizes.

    Attributes:
        machine: the machine.
        instrument: the instrument, one of `SET_UPS`.
        kit: speeds and usable ranges; its stations, targets and times are not used.
        tip_mm: (3,) the tool-side part in the frame of the spindle nose.
        places_mm: the parts on the table by name, in the work frame.
        minutes: time budget, set-up included.
        sizes: sizes of the instrument.
        seed: random seed.
    """

    machine: Machine
    instrument: Instrument
    kit: Kit
    tip_mm: tuple[float, float, float]
    places_mm: Mapping[str, tuple[float, float, float]]
    minutes: float
    sizes: InstrumentSizes
    seed: int = 0

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
    """Points of a sequence in order; the positions of the linear axes follow from them.

    Attributes:
        positions: (n, axes) mm and degrees; those of the linear axes are not used.
        place: (n,) names of the parts on the table.
        offset_mm: (n, 3) wanted position of the tool-side part from the part on the table, base frame.
        run: (n,) number of the run, from 1.
    """

    positions: np.ndarray
    place: np.ndarray
    offset_mm: np.ndarray
    run: np.ndarray

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
    """A sequence of poses for instruments that measure the tool relative to the table.

    Attributes:
        name: the name that selects it.
        title: what it is.
        source: standard and clause, or another source.
        instruments: names of the instruments that it is for.
        unverified: what was not checked against the text of the standard; empty if it follows none.
        limits: what it does not do or show, in words.
        make: function that returns its points; it raises `InputError` where the machine cannot perform it.
    """

    name: str
    title: str
    source: str
    instruments: tuple[str, ...]
    unverified: str
    limits: str
    make: Callable[[SequenceTask], SequencePoints]
