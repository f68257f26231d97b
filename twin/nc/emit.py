"""What the writers share: what the output program last said of every axis, and how the next value is printed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from twin.nc.blocks import AxisWords, Move, Reading, Rewrite
from twin.nc.text import Grid, Style, format_number, grid

Vector = tuple[float, float, float]


class Said:
    """What the output program last said of every axis, mm and degrees, in its own coordinates.

    A value is NaN when unknown (after a reference return, say) and stale when it may not have been said (a block
    the operator can skip): both make the next rewritten block say it again. ``last`` is the number printed last.
    """

    def __init__(self, axes: AxisWords) -> None:
        self.names = axes.names
        self.linear = len(axes.linear)
        self.value: list[float] = [math.nan] * len(self.names)
        self.stale: list[bool] = [False] * len(self.names)
        self.last = 0.0
        plain = [grid(axes.increment[name], False) for name in self.names]
        inches = [grid(axes.increment[name], i < self.linear) for i, name in enumerate(self.names)]
        self._grids: tuple[list[Grid], list[Grid]] = (plain, inches)

    def differs(self, axis: int, target: float, inch: bool) -> bool:
        """Whether a word is needed for the axis to be at a target: it prints differently from what was last said."""
        said = self.value[axis]
        if said != said or self.stale[axis]:
            return True
        if said == target:
            return False
        step, _, unit = self._grids[inch][axis]
        scale = step * unit
        return round(target / scale) != round(said / scale)

    def say(self, axis: int, target: float, inch: bool, incremental: bool, style: Style) -> str:
        """The number that takes the axis to a target, as printed; what it leaves said is remembered."""
        step, decimals, unit = self._grids[inch][axis]
        if incremental:
            start = self.value[axis]
            value = round((target - start) / unit / step) * step
            self.value[axis] = start + value * unit
        else:
            value = round(target / unit / step) * step
            self.value[axis] = value * unit
        self.stale[axis] = False
        self.last = value
        return format_number(value, decimals, style)

    def heard(self, axis: int, value: float, incremental: bool) -> None:
        """A word of a block that passes through said this (mm, degrees; NaN: something unknown)."""
        self.value[axis] = self.value[axis] + value if incremental else value
        self.stale[axis] = False

    def forget(self, which: Iterable[int]) -> None:
        """Make axes unknown."""
        for axis in which:
            self.value[axis] = math.nan

    def doubt(self, which: Iterable[int]) -> None:
        """Make axes stale."""
        for axis in which:
            self.stale[axis] = True


def pieces_of(
    reading: Reading, rewrites: Iterable[Rewrite], axes: AxisWords
) -> dict[int, dict[int, tuple[Rewrite, list[list[float]]]]]:
    """Rewrites by line, and within a line by the place of their move in it, with positions as lists.

    Raises:
        ValueError: a rewrite of a move that is not in the reading, two of one move, or a wrong shape: errors of the
            caller, not of the user.
    """
    place: dict[int, tuple[int, int]] = {}
    count: dict[int, int] = {}
    for move in reading.moves:
        place[id(move)] = (move.line, count.get(move.line, 0))
        count[move.line] = count.get(move.line, 0) + 1
    width = len(axes.names)
    result: dict[int, dict[int, tuple[Rewrite, list[list[float]]]]] = {}
    for rewrite in rewrites:
        found = place.get(id(rewrite.move)) or _twin_of(rewrite.move, count)
        shape = rewrite.positions.shape
        if len(shape) != 2 or shape[1] != width or shape[0] < 1:
            raise ValueError(f"positions of shape {shape}; expected (pieces, {width})")
        if rewrite.vectors is not None and rewrite.vectors.shape != (shape[0], 3):
            raise ValueError(f"vectors of shape {rewrite.vectors.shape}; expected ({shape[0]}, 3)")
        line, ordinal = found
        rows: list[list[float]] = rewrite.positions.tolist()
        at = result.setdefault(line, {})
        if ordinal in at:
            raise ValueError(f"two rewrites of the move of line index {line}")
        if rewrite.move.machine:
            raise ValueError(f"a rewrite of the machine-coordinate block of line index {line}")
        at[ordinal] = (rewrite, rows)
    return result


def _twin_of(move: Move, count: dict[int, int]) -> tuple[int, int]:
    """The place of an equal move when the very object is not in the reading (it was pickled, say)."""
    if count.get(move.line) == 1:
        return (move.line, 0)
    raise ValueError(f"a rewrite of a move of line index {move.line} that is not in the reading")


def vector_texts(vector: Sequence[float], decimals: int, plus: bool) -> tuple[str, str, str]:
    """The components of a tool vector as printed."""
    style = Style(plus=plus)
    x, y, z = (format_number(component, decimals, style) for component in vector)
    return x, y, z
