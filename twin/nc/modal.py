"""What the interpreters of blocks share: positions, notices, and errors that carry their place."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Protocol

from twin.errors import InputError
from twin.nc.blocks import AxisWords, Notice
from twin.nc.iso_block import AxisWord
from twin.nc.text import unit_vector


class Forgetful(Protocol):
    """A block that says which axes nobody knows the position of afterwards."""

    forgets: tuple[int, ...]


class Modal:
    """The state any language of words keeps.

    Attributes:
        position: last position said, mm and degrees, NaN where unknown.
        vector: the tool vector in force, if orientation is given as one.
        notices: what a reader of the report must know.
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
        self._line = 0
        self._named: dict[tuple[int, ...], frozenset[str]] = {}
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

    def forget(self, block: Forgetful, which: Iterable[int]) -> None:
        """Make axes unknown after a block."""
        axes = list(which)
        block.forgets = tuple(sorted({*block.forgets, *axes}))
        for axis in axes:
            self.position[axis] = math.nan

    def named(self, words: list[AxisWord]) -> frozenset[str]:
        """The names of the axes a block wrote."""
        key = tuple([word[0] for word in words])
        names = self._named.get(key)
        if names is None:
            names = self._named[key] = frozenset(self.names[i] for i in key)
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
        self.forget(block, which)
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
