"""What the interpreters of blocks share: positions, notices, and errors that carry their place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Protocol

from twin._common.errors import InputError
from twin.nc.blocks import AxisWords, Left, Notice
from twin.nc.iso_block import AxisWord
from twin.nc.text import number, unit_vector


class Forgetful(Protocol):
    """A block that says which axes nobody knows the position of afterwards."""

    forgets: tuple[int, ...]


class Modal:
    """The state any language of words keeps.

    Attributes:
        position: last position said, mm and degrees, NaN where unknown.
        vector: the tool vector in force, if orientation is given as one.
        notices: what a reader of the report must know.
        left: axes left in places unknown.
        tcp: whether the control's kinematics are on.
    """

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        self.source = source
        self.names = axes.names
        self.index = {name.upper(): i for i, name in enumerate(self.names)}
        self.linear = len(axes.linear)
        self.position: list[float] = [math.nan] * len(self.names)
        self.vector: tuple[float, float, float] | None = None
        self.notices: list[Notice] = []
        self.tcp = tcp
        self.left: list[Left] = []
        self._line = 0
        self._named: dict[int, frozenset[str]] = {}
        self._noted: set[str] = set()

    def refuse(self, what: str, value: object, expected: str, line: int | None = None) -> InputError:
        """An error at the present line."""
        return InputError(what, expected=expected, file=self.source, line=line or self._line + 1, value=value)

    def note(self, text: str, *, once: bool = False) -> None:
        """A notice at the present line; ``once``: only the first time."""
        if once:
            if text in self._noted:
                return
            self._noted.add(text)
        self.notices.append(Notice(self._line, text))

    def forget(self, block: Forgetful, which: Iterable[int], *, moved: bool | None = False) -> None:
        """Make axes unknown after a block.

        Args:
            block: the block.
            which: the axes.
            moved: whether it moves them; False: perhaps; None: not at all, or to a place that is said.
        """
        axes = tuple(which)
        if moved is not None:
            self.left.append(Left(self._line, axes, moved))
        block.forgets = tuple(sorted({*block.forgets, *axes})) if block.forgets else axes
        for axis in axes:
            self.position[axis] = math.nan

    def plain_words(self, values: Sequence[str | None], axes: Sequence[int], incremental: bool, unit: float) -> int:
        """Take the words of a plain block to the position; the set of their axes as bits.

        Args:
            values: plain numbers, None for an axis that has no word.
            axes: their axes.
            incremental: whether they count from the last position.
            unit: mm per program unit.

        Returns:
            The set; empty (and nothing is taken) if a word counts from a position that is not known.
        """
        position = self.position.copy()
        seen = 0
        for axis, text in zip(axes, values, strict=False):
            if text is None:
                continue
            try:
                value = float(text)
            except ValueError:  # a decimal comma
                value = number(text)
            if axis < self.linear:
                value *= unit
            if incremental:
                value = position[axis] + value
                if value != value:
                    return 0
            position[axis] = value
            seen |= 1 << axis
        self.position = position
        return seen

    def named(self, bits: int) -> frozenset[str]:
        """The names of a set of axes given as bits."""
        names = self._named.get(bits)
        if names is None:
            names = self._named[bits] = frozenset(name for i, name in enumerate(self.names) if bits >> i & 1)
        return names

    def direction(self, what: str, components: list[float], shown: str) -> tuple[float, float, float]:
        """A vector at unit length."""
        vector, length = unit_vector((components[0], components[1], components[2]))
        if length == 0.0:
            raise self.refuse(f"{what} of zero length", shown, "a direction")
        if abs(length - 1.0) > 1e-3:
            self.note(f"{what} of length {length:.6g} is taken as a direction")
        return vector

    def machine_position(self, words: list[AxisWord], block: Forgetful) -> tuple[float, ...]:
        """What a machine-coordinate block names; where that is in program coordinates is unknown."""
        position = [math.nan] * len(self.names)
        for word in words:
            position[word.axis] = word.value
        which = {word.axis for word in words}
        if self.tcp:
            which.update(range(self.linear))
        if any(axis >= self.linear for axis in which):
            self.vector = None
        self.forget(block, which, moved=None)
        return tuple(position)

    def no_position(self, axis: int) -> InputError:
        """An incremental word of an axis whose position is unknown."""
        name = self.names[axis]
        return self.refuse(f"{name} is incremental where its position is unknown", name, "absolute position first")

    def no_number(self, name: str, written: str) -> InputError:
        """A word without a number."""
        return self.refuse(f"{name} has no number", f"{name}{written}", "a number like 12.5")

    def no_axis(self, shown: str) -> InputError:
        """A word of an axis this machine does not have."""
        return self.refuse("unknown axis", shown, f"one of this machine's axes ({', '.join(self.names)})")
