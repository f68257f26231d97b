"""End points of pieces as arrays: targets, solved commands and printed words, and the ways of pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import distinct
from twin.kinematics.forward import Poses

SAME: Final = 1e-9
"""Words closer than this are printed alike."""


@final
@dataclass(frozen=True)
class Rows:
    """n end points of pieces, in the order of the program.

    Attributes:
        leg, motion: (n,) leg and motion of each end point.
        backlash_move: (n,) whether the row is an inserted move that only takes up backlash, at its fraction of the motion.
        approach: (n, axes) approach directions for which it is solved.
        reverses: (n, axes) whether each axis reverses before it.
        overshoot: (n, axes) intentional overshoot, mm and degrees.
        fraction: (n,) fraction of its motion.
        words, nominal: (n, axes) nominal words and commands.
        target_mm, target_rotation: (n, 3) and (n, 3, 3) nominal pose.
        exact: (n, axes) compensated commands before linear words were rounded.
        commands, printed: (n, axes) compensated commands as printed, and the printed words.
        vectors: (n, 3) printed tool vectors; NaN where there is none.
        orientation_residual_rad: (n,) orientation residual in radians that the rotary axes do not correct.
        singular: (n,) whether that residual exceeds the solver's numerical noise.
        clamped: (n,) whether an axis stops at its limit.
        relaxed: (n,) whether the rotary axes stay as programmed, because with the corrected tool axis the point would be farther off.
        as_programmed: (n,) whether all axes stay as programmed, because no other position is nearer; such a row is also clamped.
        untouched: (n,) whether it is left as written because it is out of range.
    """

    leg: np.ndarray
    motion: np.ndarray
    backlash_move: np.ndarray
    approach: np.ndarray
    reverses: np.ndarray
    overshoot: np.ndarray
    fraction: np.ndarray
    words: np.ndarray
    nominal: np.ndarray
    target_mm: np.ndarray
    target_rotation: np.ndarray
    exact: np.ndarray
    commands: np.ndarray
    printed: np.ndarray
    vectors: np.ndarray
    orientation_residual_rad: np.ndarray
    singular: np.ndarray
    clamped: np.ndarray
    relaxed: np.ndarray
    as_programmed: np.ndarray
    untouched: np.ndarray

    @property
    def target(self) -> Poses:
        """Nominal poses."""
        return Poses(self.target_mm, self.target_rotation)

    def where(self, keep: np.ndarray | slice) -> Rows:
        """Return a selection of the rows: (n,) booleans or a slice."""
        return _of_each(lambda column: column[keep], self)

    def put(self, which: np.ndarray, new: Rows) -> Rows:
        """Return the rows with some of them, (n,) booleans, replaced."""

        def put(mine: np.ndarray, others: np.ndarray) -> np.ndarray:
            found = np.array(mine)
            found[which] = others
            return found

        return _of_each(put, self, new)

    def replaced(self, legs: np.ndarray, new: Rows) -> Rows:
        """Return the rows with those of some legs replaced, still in order."""
        kept = np.flatnonzero(~np.isin(self.leg, legs))
        if not kept.size:
            return new
        order = np.argsort(np.concatenate([self.leg[kept], new.leg]), kind="stable")
        place = np.flatnonzero(order >= len(kept))
        source = kept.take(order, mode="clip")

        def merged(mine: np.ndarray, others: np.ndarray) -> np.ndarray:
            found = mine.take(source, axis=0)
            found[place] = others[order[place] - len(kept)]
            return found

        return _of_each(merged, self, new)

    def distinct(self) -> Rows:
        """Return the rows without inserted moves that, as printed, equal the position before or after."""
        rows = self
        for behind in (False, True):
            vectors = np.nan_to_num(rows.vectors)
            alike = (np.abs(np.diff(rows.printed, axis=0)) < SAME).all(axis=1) & ~np.diff(vectors, axis=0).any(axis=1)
            omitted = rows.backlash_move & (np.append(alike, False) if behind else np.append(False, alike))
            rows = rows.where(~omitted) if np.any(omitted) else rows
        return rows


def _of_each(make: Callable[..., np.ndarray], *rows: Rows) -> Rows:
    return Rows(**{field.name: make(*(getattr(one, field.name) for one in rows)) for field in fields(Rows)})


class Ways(NamedTuple):
    """Start and displacement of pieces.

    Attributes:
        begin: (rows, axes) words at the start of each piece.
        way: (rows, axes) displacement.
        rows: (pieces,) rows that are end points of pieces.
        first: (legs,) index in ``rows`` of each leg's first piece.
    """

    begin: np.ndarray
    way: np.ndarray
    rows: np.ndarray
    first: np.ndarray


def taken(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return some rows of an array; the array itself if these are all of them, in order."""
    n = len(values)
    if len(rows) == n and (n == 0 or (rows[0] == 0 and rows[-1] == n - 1 and bool(np.all(rows[1:] > rows[:-1])))):
        return values
    return values.take(rows, axis=0)


def repeat_with_index(things: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Repeat each of (n,) items by its count, and number the repetitions 0, 1, 2 … within each."""
    return np.repeat(things, count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)


def even_cuts(sizes: np.ndarray, most: float) -> list[int]:
    """Return where to cut items of (n,) sizes into the fewest portions of about equal size, none much larger than ``most``."""
    total = np.cumsum(sizes)
    count = int(np.ceil(total[-1] / most)) if len(total) else 0
    if count <= 1:
        return []
    return distinct(np.searchsorted(total, total[-1] * np.arange(1, count) / count))
