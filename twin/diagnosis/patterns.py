"""Patterns that have no name: functions of each column of the table and of each pair of columns, on each side of the machine.

A pattern shifts the targets of one side along the axes of the base frame, or of the frame that carries them. Its functions are
cosines of increasing order over the range of a column (half waves), whole turns of a rotary axis that turned round, and the
direction an axis was approached from; of a pair, their products. They see what low polynomials do not: short waves, steps, and
a reversal that depends on the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Final, final

import numpy as np

from twin.diagnosis.functions import Functions, Rows
from twin.diagnosis.signatures import Column, Part
from twin.machine import Machine
from twin.measurement import CARRIERS, Measurements, state_of
from twin.units import UM

ALONE: Final = 16
"""Highest order of a column by itself."""
PAIRED: Final = 8
"""Highest order of an axis in a pair."""
SLOW: Final = 4
"""Highest order in a pair of what changes slowly: time, temperatures, rounds, other channels."""
LEVELS: Final = (2, 4, 8, 16)
"""Orders up to which a pattern's functions are taken together."""
TURNED: Final = 300.0
"""Degrees from which on a rotary axis has turned round, and its functions are periodic."""
APPROACH: Final = "approach_"


@final
@dataclass(frozen=True, eq=False)
class Channel:
    """One column that patterns may depend on.

    Attributes:
        name: in the table (``X_mm``, ``T_bed_degC``, ``approach_X``).
        values: (n, k) its functions, without the constant.
        order: (k,) of each.
        paired: highest order in a pair.
    """

    name: str
    values: np.ndarray
    order: np.ndarray
    paired: int

    @property
    def direction(self) -> bool:
        """Whether it is the direction of approach: a sign, no position."""
        return self.name.startswith(APPROACH)


@final
@dataclass(frozen=True, eq=False)
class Pattern:
    """Functions of one column or two, on one side.

    Attributes:
        side: ``tool`` or ``work``.
        field: ``base`` or ``place``: along the axes of the base frame, or of the frame the targets are fixed to.
        channels: one or two.
        own: (n,) which readings are of that side.
        highest: order up to which functions are taken.
    """

    side: str
    field: str
    channels: tuple[Channel, ...]
    own: np.ndarray
    highest: int

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of the table."""
        return tuple(channel.name for channel in self.channels)

    @cached_property
    def levels(self) -> tuple[int, ...]:
        """Orders it can be taken up to: each adds functions to the one before."""
        orders = self.order
        found: list[int] = []
        for level in LEVELS:
            if level <= self.highest and (not found or np.any((orders > found[-1]) & (orders <= level))):
                found.append(level)
        return tuple(found) or (int(orders.max()),)

    @cached_property
    def order(self) -> np.ndarray:
        """(m,) the higher of the two orders of each function."""
        return np.concatenate([np.maximum.outer(a, b).ravel() for a, b in self._orders])

    @cached_property
    def _orders(self) -> list[tuple[np.ndarray, np.ndarray]]:
        if len(self.channels) == 1:
            (one,) = self.channels
            return [(one.order[one.order <= self.highest], np.zeros(1, dtype=int))]
        first, second = (c.order[c.order <= min(c.paired, self.highest)] for c in self.channels)
        none = np.zeros(1, dtype=int)
        if self.channels[0].direction:
            return [(first, np.concatenate([none, second]))]
        return [(first, none), (none, second), (first, second)]

    def at(self, rows: Rows) -> np.ndarray:
        """(rows, m) its functions, zero on the other side."""
        own = self.own[rows, None]
        if len(self.channels) == 1:
            (one,) = self.channels
            return np.asarray(one.values[rows][:, one.order <= self.highest] * own)
        first, second = (c.values[rows][:, c.order <= min(c.paired, self.highest)] for c in self.channels)
        products = first[:, :, None] * second[:, None, :]
        if self.channels[0].direction:
            found = np.concatenate([first[:, :, None], products], axis=2).reshape(len(first), -1)
        else:
            found = np.concatenate([first, second, products.reshape(len(first), -1)], axis=1)
        return np.asarray(found * own)

    def columns(self, level: int, directions: Sequence[int]) -> list[Column]:
        """Signatures, µm a unit, of the functions up to an order along some directions; those of a direction together."""
        functions = Functions(len(self.own), len(self.order), self.at, self.own)
        chosen = np.flatnonzero(self.order <= level).tolist()
        return [Column((Part((self.field, i), functions, k, UM),), 1.0) for i in directions for k in chosen]


def patterns(machine: Machine, data: Measurements) -> list[Pattern]:
    """Every column and every pair, on every side that has targets, in every frame that turns differently.

    Args:
        machine: the machine.
        data: the measurements.
    """
    found = []
    channels = _channels(machine, data)
    for side in CARRIERS:
        own = data.carrier == side
        if not own.any():
            continue
        turning = any(not axis.linear and axis.side == side for axis in machine.axes)
        for field in ("base", "place") if turning else ("base",):
            found += [Pattern(side, field, (one,), own, ALONE) for one in channels]
            for a, b in combinations(channels, 2):
                if not b.direction:
                    found.append(Pattern(side, field, (a, b), own, PAIRED))
                elif not a.direction:
                    found.append(Pattern(side, field, (b, a), own, PAIRED))
    return found


def _channels(machine: Machine, data: Measurements) -> list[Channel]:
    state = dict(state_of(data, machine))
    if len(set(data.round)) > 2:
        rounds = list(dict.fromkeys(data.round))
        state["round"] = np.array([float(rounds.index(name)) for name in data.round])
    found = []
    for name, values in state.items():
        axis = machine.by_name.get(name)
        distinct = len(np.unique(np.round(values, 6)))
        if distinct < 2:
            continue
        if name.startswith(APPROACH):
            found.append(Channel(name, values[:, None], np.ones(1, dtype=int), 1))
            continue
        turned = axis is not None and not axis.linear and np.ptp(values) >= TURNED
        made, order = _turning(values, distinct) if turned else _waves(values, distinct)
        label = name if axis is None else f"{axis.name}_{axis.unit}"
        found.append(Channel(label, made, order, PAIRED if axis is not None else SLOW))
    return found


def _turning(values: np.ndarray, distinct: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosines and sines of whole turns; an order is half a period, as it is of `_waves`."""
    most = min(ALONE // 2, max((distinct - 1) // 2, 1))
    angle = np.radians(values)
    made = np.stack([f(k * angle) for k in range(1, most + 1) for f in (np.cos, np.sin)], axis=1)
    return made, np.repeat(2 * np.arange(1, most + 1), 2)


def _waves(values: np.ndarray, distinct: int) -> tuple[np.ndarray, np.ndarray]:
    """Half waves over the range."""
    low, high = float(values.min()), float(values.max())
    order = np.arange(1, min(ALONE, distinct - 1) + 1)
    return np.cos(np.pi * order * ((values - low) / (high - low))[:, None]), order
