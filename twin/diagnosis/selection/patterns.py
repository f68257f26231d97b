"""Unnamed patterns: functions of each column of the table and of each pair of columns, on each side of the machine.

A pattern shifts the targets and stations of one side along the axes of the base frame, or of the frame of that side. Its functions are
those of `twin.machine.effects.waves`: half waves over the range of a column, harmonics of a rotary axis that made a whole turn, the
approach direction of an axis; for a pair, their products. They can represent what low polynomials cannot: short waves, steps, and a
reversal that depends on the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations
from typing import Final, final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.signatures import Column, SignatureTerm
from twin.machine.effects.waves import APPROACH, Waves
from twin.machine.effects.waves import terms as products_of
from twin.machine.machine import Axis, Machine
from twin.measurement.instruments import SIDES
from twin.measurement.state import machine_state
from twin.measurement.table import CARRIERS, Measurements
from twin.numerics.functions import Functions, Rows

ALONE: Final = 16
"""Highest order of a single column."""
PAIRED: Final = 8
"""Highest order of an axis in a pair."""
SLOW: Final = 4
"""Highest order of a slowly changing column in a pair: time, temperatures, rounds, other channels."""
LEVELS: Final = (2, 4, 8, 16)
"""Orders up to which the functions of a pattern are tested together."""
TURNED: Final = 300.0
"""Range of a rotary axis, degrees, from which on its functions are periodic."""


@final
@dataclass(frozen=True, eq=False)
class Channel:
    """One column that patterns may depend on.

    Attributes:
        waves: functions of the column.
        column: (n,) its values; those of the functions are computed where they are needed, as they would take much memory.
        paired: highest order in a pair.
    """

    waves: Waves
    column: np.ndarray
    paired: int

    @property
    def name(self) -> str:
        """Return the name in the table (``X_mm``, ``T_bed_degC``, ``approach_X``)."""
        return self.waves.column

    @property
    def direction(self) -> bool:
        """Return whether it is an approach direction, a sign and no position."""
        return self.waves.kind == "direction"


@final
@dataclass(frozen=True, eq=False)
class Pattern:
    """Functions of one or two columns, on one side of the machine.

    Attributes:
        side: ``tool`` or ``work``.
        field: ``base`` or ``place``: shifts along the axes of the base frame, or of the frame of that side.
        channels: one or two.
        own: (n,) which readings a shift of that side changes.
        highest: highest order of the functions.
    """

    side: str
    field: str
    channels: tuple[Channel, ...]
    own: np.ndarray
    highest: int

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of its columns of the table."""
        return tuple(channel.name for channel in self.channels)

    @property
    def derivative(self) -> str:
        """Return which derivative of the readings it multiplies (`twin.diagnosis.candidates.signatures.ReadingDerivatives`)."""
        return f"{self.side} {self.field}"

    @cached_property
    def levels(self) -> tuple[int, ...]:
        """Return the orders up to which it is tested; each adds functions to the previous one."""
        orders = self.order
        found: list[int] = []
        for level in LEVELS:
            if level <= self.highest and (not found or np.any((orders > found[-1]) & (orders <= level))):
                found.append(level)
        return tuple(found) or (int(orders.max()),)

    @cached_property
    def order(self) -> np.ndarray:
        """Return (m,) the higher of the two orders of each function."""
        own = [np.array([0, *waves.half_waves]) for waves in self.waves(self.highest)]
        return np.max([orders[i] for orders, i in zip(own, self.terms.T, strict=True)], axis=0)

    def waves(self, level: int) -> tuple[Waves, ...]:
        """Return the functions of its columns up to an order."""
        most = min(level, self.highest)
        if len(self.channels) == 1:
            return (self.channels[0].waves.up_to(most),)
        return tuple(channel.waves.up_to(min(channel.paired, most)) for channel in self.channels)

    @cached_property
    def terms(self) -> np.ndarray:
        """Return (m, columns) for each function the number of each column's function, from 1; 0 for the constant."""
        return np.array(products_of(self.waves(self.highest)))

    def at(self, rows: Rows) -> np.ndarray:
        """Return (rows, m) values of its functions, zero on the other side."""
        own = self.own[rows, None]
        first, *others = (
            np.stack(waves.values(channel.column[rows]), axis=1)
            for channel, waves in zip(self.channels, self.waves(self.highest), strict=True)
        )
        if not others:
            return np.asarray(first * own)
        one = np.ones((len(first), 1))
        pair = [np.concatenate([one, values], axis=1) for values in (first, others[0])]
        return np.asarray(pair[0][:, self.terms[:, 0]] * pair[1][:, self.terms[:, 1]] * own)

    def columns(self, level: int, directions: Sequence[int]) -> list[Column]:
        """Return the signatures, µm per unit, of the functions up to an order along some directions, sorted by direction."""
        chosen = np.flatnonzero(self.order <= level).tolist()
        return [self._columns[i][k] for i in directions for k in chosen]

    @cached_property
    def _columns(self) -> list[list[Column]]:
        """Columns by direction and function: always the same objects, so that their inner products are found again."""
        functions = Functions(len(self.own), len(self.order), self.at, self.own)
        return [
            [Column((SignatureTerm((self.derivative, i), functions, k, UM),), 1.0) for k in range(functions.count)]
            for i in range(3)
        ]


@final
class ChannelFunctions:
    """The functions of several patterns of one side, made from those of their columns.

    Args:
        patterns: patterns with the same readings.

    Attributes:
        own: functions of each pattern among all.
        count: number m of all functions.
    """

    def __init__(self, patterns: Sequence[Pattern]) -> None:
        self._channels = list(dict.fromkeys(channel for pattern in patterns for channel in pattern.channels))
        starts = np.cumsum([0, *(len(channel.waves.half_waves) for channel in self._channels)]).tolist()
        start = dict(zip(self._channels, starts[:-1], strict=True))
        factors: list[np.ndarray] = []
        self.own: dict[Pattern, slice] = {}
        self.count = 0
        for pattern in patterns:
            # Function 0 is the constant.
            numbers = np.zeros((len(pattern.order), 2), dtype=int)
            for k, channel in enumerate(pattern.channels):
                numbers[:, k] = np.where(pattern.terms[:, k] > 0, start[channel] + pattern.terms[:, k], 0)
            factors.append(numbers)
            self.own[pattern] = slice(self.count, self.count + len(numbers))
            self.count += len(numbers)
        self._first, self._second = np.concatenate(factors).T

    def at(self, rows: np.ndarray) -> np.ndarray:
        """Return (rows, m) values of all functions at readings of the side."""
        factors = self._factors(rows)
        return np.asarray((factors[self._first] * factors[self._second]).T)

    def with_vectors(self, rows: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return inner products (r, m) of all functions with (r, rows) vectors at readings of the side."""
        factors = self._factors(rows)
        every = (vectors[:, None] * factors) @ factors.T
        return np.asarray(every[:, self._first, self._second])

    def _factors(self, rows: np.ndarray) -> np.ndarray:
        """Return (factors, rows) values of the functions that the others are products of."""
        of_channels = (channel.waves.values(channel.column[rows]) for channel in self._channels)
        return np.stack([np.ones(len(rows)), *chain.from_iterable(of_channels)])


def patterns(machine: Machine, data: Measurements) -> list[Pattern]:
    """Return the patterns of every column and pair, for every side with targets, in every frame that turns differently.

    Args:
        machine: the machine.
        data: the measurements.
    """
    found = []
    channels = _channels(machine, data)
    for side in _sides(machine, data):
        own = (data.carrier == side) != (data.station_carrier == side)
        turning = any(not axis.linear and axis.side == side for axis in machine.axes)
        for field in ("base", "place") if turning else ("base",):
            found += [Pattern(side, field, (one,), own, ALONE) for one in channels]
            for a, b in combinations(channels, 2):
                if not b.direction:
                    found.append(Pattern(side, field, (a, b), own, PAIRED))
                elif not a.direction:
                    found.append(Pattern(side, field, (b, a), own, PAIRED))
    return found


def _sides(machine: Machine, data: Measurements) -> list[str]:
    """Return the sides whose shifts the readings show; of two that only move relative to each other, those that axes move."""
    found = [side for side in CARRIERS if np.any((data.carrier == side) != (data.station_carrier == side))]
    if np.any(data.station_carrier == SIDES[0]):
        return found
    return [side for side in found if any(axis.side == side for axis in machine.axes)] or found


def _channels(machine: Machine, data: Measurements) -> list[Channel]:
    state = dict(machine_state(data, machine))
    if len(set(data.round)) > 2:
        rounds = list(dict.fromkeys(data.round))
        state["round"] = np.array([float(rounds.index(name)) for name in data.round])
    found = []
    for name, values in state.items():
        axis = machine.by_name.get(name)
        distinct = len(np.unique(np.round(values, 6)))
        if distinct < 2:
            continue
        waves = _waves(name, axis, values, distinct)
        paired = 1 if waves.kind == "direction" else PAIRED if axis is not None else SLOW
        found.append(Channel(waves, values, paired))
    return found


def _waves(name: str, axis: Axis | None, values: np.ndarray, distinct: int) -> Waves:
    """Return the functions of a column, as many as its distinct values allow, at most `ALONE` half waves."""
    if name.startswith(APPROACH):
        return Waves(name, "direction", 1)
    column = name if axis is None else f"{axis.name}_{axis.unit}"
    if axis is not None and not axis.linear and np.ptp(values) >= TURNED:
        return Waves(column, "whole_turns", min(ALONE // 2, max((distinct - 1) // 2, 1)))
    span = float(values.min()), float(values.max())
    wrapped = axis is not None and axis.lower is None
    return Waves(column, "half_waves", min(ALONE, distinct - 1), span, wrapped)
