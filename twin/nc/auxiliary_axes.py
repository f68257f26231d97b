"""Axes that programs name and the model of the machine does not have: a quill, a pallet, a tailstock."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, final

NOT_IN_MODEL: Final = (
    "is not in the model of the machine: its words are left as written, and it stands still in all feeds; a shift of tool or "
    "workpiece by it must be in the work offset or the tool length"
)
"""End of the notice on an auxiliary axis."""


@final
class AuxiliaryAxes:
    """Positions of the auxiliary axes of a program, which must be the same in all feeds: they may move tool or workpiece.

    Attributes:
        names: their names in capitals.
        moved: whether one of them has moved since the last feed.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.names = frozenset(names)
        self.moved = False
        self._at: dict[str, object] = {}
        """Positions of the axes; another object for each one that is not known."""
        self._fed: dict[str, object] | None = None
        """Positions at the feeds so far."""

    def move(self, name: str, value: float | str, *, incremental: bool) -> bool:
        """Take a word and return whether it moves the axis; ``value``: NaN if unknown, a text for a fixed place of the machine."""
        before = self._at.get(name)
        if incremental and not isinstance(value, str):
            if value == 0.0:
                return False
            value = before + value if isinstance(before, float) else math.nan
        new = value if value == value else object()
        if new == before:
            return False
        self._at, self.moved = {**self._at, name: new}, True
        return True

    def feed(self) -> str:
        """Take note of a feed and return what is wrong with it: which axis stood elsewhere at feeds before; empty if nothing."""
        self.moved = False
        if self._fed is None or self._fed == self._at:
            self._fed = self._at
            return ""
        fed = self._fed
        name = next(name for name, position in self._at.items() if fed.get(name) != position)
        return f"feed with {name} at {_shown(self._at[name])}, after feeds with it at {_shown(fed.get(name))}"


def _shown(position: object) -> str:
    if isinstance(position, str):
        return position
    return f"{position:g}" if isinstance(position, float) else "an unknown position"
