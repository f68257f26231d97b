"""Output state shared by the writers: the last value written for every axis, and the format of the next one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from twin.nc.blocks import AxisWords
from twin.nc.text import Grid, Style, format_number, grid

Vector = tuple[float, float, float]
SAME_NUMBER = 1e-10
"""Numbers closer than this print alike: words have at most 9 decimals."""
_BARE = Style()
_SIGNED = Style(plus=True)


class OutputState:
    """The last value of every axis in the output program, mm and degrees, in program coordinates.

    A value is NaN when unknown (after a reference return, for example) and stale when it may not have been executed (after a block that
    the operator can skip). In both cases the next rewritten block writes the axis again.
    """

    def __init__(self, axes: AxisWords) -> None:
        self.names = axes.names
        self.linear = len(axes.linear)
        self.value: list[float] = [math.nan] * len(self.names)
        self.stale: list[bool] = [False] * len(self.names)
        plain = [grid(axes.increment[name], False) for name in self.names]
        inches = [grid(axes.increment[name], i < self.linear) for i, name in enumerate(self.names)]
        self._grids: tuple[list[Grid], list[Grid]] = (plain, inches)

    def _step(self, axis: int, target: float, inch: bool, incremental: bool) -> tuple[float, int]:
        """Set an axis to a target and return the number to write, with its decimals."""
        step, decimals, unit = self._grids[inch][axis]
        if incremental:
            start = self.value[axis]
            value = round((target - start) / unit / step) * step
            self.value[axis] = start + value * unit
        else:
            value = round(target / unit / step) * step
            self.value[axis] = value * unit
        self.stale[axis] = False
        return value, decimals

    def number_for(self, axis: int, target: float, inch: bool, incremental: bool, style: Style) -> str:
        """Set an axis to a target and return the number to write, formatted."""
        value, decimals = self._step(axis, target, inch, incremental)
        return format_number(value, decimals, style)

    def replace(
        self, axis: int, old: str, number: float, target: float, inch: bool, incremental: bool, style: Style
    ) -> str:
        """As `number_for`, but return the number as written if it already has the target value."""
        value, decimals = self._step(axis, target, inch, incremental)
        if -SAME_NUMBER < number - value < SAME_NUMBER:
            first = old[0]
            if (first != "-" or number != 0.0) and (first in "+-" or not style.plus):
                return old
        return format_number(value, decimals, style)

    def record(self, axis: int, value: float, incremental: bool) -> None:
        """Record a word of a block that passes through (mm, degrees; NaN: unknown)."""
        self.value[axis] = self.value[axis] + value if incremental else value
        self.stale[axis] = False

    def axes_to_write(self, row: Sequence[float], written: int, inch: bool) -> list[int]:
        """Return the axes that need a word to reach their targets.

        Args:
            row: targets; NaN: no target.
            written: axes that have a word already, as bits.
            inch: whether the program is in inches.
        """
        grids = self._grids[inch]
        found = []
        for axis, target in enumerate(row):
            said = self.value[axis]
            if target != target or written >> axis & 1 or (target == said and not self.stale[axis]):
                continue
            if said == said and not self.stale[axis]:
                scale = grids[axis].step * grids[axis].unit
                if round(target / scale) == round(said / scale):
                    continue
            found.append(axis)
        return found

    def mark_unknown(self, which: Iterable[int]) -> None:
        """Mark axes as unknown."""
        for axis in which:
            self.value[axis] = math.nan

    def mark_stale(self, which: Iterable[int]) -> None:
        """Mark axes as stale."""
        for axis in which:
            self.stale[axis] = True


def vector_texts(vector: Sequence[float], decimals: int, plus: bool) -> tuple[str, str, str]:
    """Return the formatted components of a tool vector."""
    style = _SIGNED if plus else _BARE
    x, y, z = vector
    return format_number(x, decimals, style), format_number(y, decimals, style), format_number(z, decimals, style)
