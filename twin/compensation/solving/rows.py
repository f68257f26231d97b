"""Ends of pieces of blocks as arrays: what is solved for them, and where pieces go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Final, NamedTuple, final

import numpy as np

from twin.kinematics.forward import Poses

SAMPLE_SPACING: Final = (10.0, 3.0)
"""No two samples further apart than this: mm of linear and degrees of rotary motion."""
SAME: Final = 1e-9
"""Words closer than this are printed alike."""


@final
@dataclass(frozen=True)
class Rows:
    """Ends of pieces, n of them, in the order of the program.

    Attributes:
        leg, motion: (n,) which leg and which motion each belongs to.
        taken: (n,) whether it only takes up a reversal, standing at its fraction.
        approach: (n, axes) sides that axes come from, which it is solved for.
        turned: (n, axes) whether they turn round in front of it.
        beyond: (n, axes) by how much it goes too far on purpose, mm and degrees.
        fraction: (n,) of its motion.
        words, nominal: (n, axes) as meant, in words and in commands.
        target_mm, target_rotation: (n, 3) and (n, 3, 3) the pose meant there.
        exact: (n, axes) compensated commands before linear words were rounded.
        commands, printed: (n, axes) compensated commands as printed, and the words printed.
        vectors: (n, 3) tool vectors printed; NaN where there is none.
        orientation_left: (n,) radians that the rotary axes do not repair.
        singular: (n,) whether that is more than the solver's own noise.
        clamped: (n,) whether an axis stops at its limit.
        untouched: (n,) whether it is left as written, being out of range.
    """

    leg: np.ndarray
    motion: np.ndarray
    taken: np.ndarray
    approach: np.ndarray
    turned: np.ndarray
    beyond: np.ndarray
    fraction: np.ndarray
    words: np.ndarray
    nominal: np.ndarray
    target_mm: np.ndarray
    target_rotation: np.ndarray
    exact: np.ndarray
    commands: np.ndarray
    printed: np.ndarray
    vectors: np.ndarray
    orientation_left: np.ndarray
    singular: np.ndarray
    clamped: np.ndarray
    untouched: np.ndarray

    @property
    def target(self) -> Poses:
        """The poses meant."""
        return Poses(self.target_mm, self.target_rotation)

    def where(self, keep: np.ndarray | slice) -> Rows:
        """Some of the rows, (n,) booleans or a stretch of them."""
        return _of_each(lambda column: column[keep], self)

    def replaced(self, legs: np.ndarray, new: Rows) -> Rows:
        """The rows with those of some legs exchanged, still in order."""
        keep = ~np.isin(self.leg, legs)
        order = np.argsort(np.concatenate([self.leg[keep], new.leg]), kind="stable")
        return _of_each(lambda mine, others: np.concatenate([mine[keep], others])[order], self, new)

    def distinct(self) -> Rows:
        """The rows without moves that take up what words cannot tell from the place before, or from the one behind."""
        rows = self
        for behind in (False, True):
            vectors = np.nan_to_num(rows.vectors)
            alike = (np.abs(np.diff(rows.printed, axis=0)) < SAME).all(axis=1) & ~np.diff(vectors, axis=0).any(axis=1)
            rows = rows.where(~(rows.taken & (np.append(alike, False) if behind else np.append(False, alike))))
        return rows


def _of_each(make: Callable[..., np.ndarray], *rows: Rows) -> Rows:
    return Rows(**{field.name: make(*(getattr(one, field.name) for one in rows)) for field in fields(Rows)})


class Ways(NamedTuple):
    """Where pieces go.

    Attributes:
        begin: (rows, axes) words that each piece starts from.
        way: (rows, axes) how far it goes.
        rows: (pieces,) the rows that are ends of pieces.
        first: (legs,) which of these each leg begins with.
    """

    begin: np.ndarray
    way: np.ndarray
    rows: np.ndarray
    first: np.ndarray


def counted(things: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each of (n,) things as often as it counts, and 0, 1, 2 … within each."""
    return np.repeat(things, count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)


def spacings(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(n,) how many times `SAMPLE_SPACING` it is from (n, axes) words to others."""
    limits = np.repeat(SAMPLE_SPACING, [3, start.shape[1] - 3])
    return np.maximum.reduce([np.abs(b - a) / limit for a, b, limit in zip(start.T, end.T, limits, strict=True)])


def even_cuts(sizes: np.ndarray, most: float) -> list[int]:
    """Where to cut things of (n,) sizes in as few portions as can be that make no more than about ``most`` each, and alike."""
    total = np.cumsum(sizes)
    count = int(np.ceil(total[-1] / most)) if len(total) else 0
    return np.unique(np.searchsorted(total, total[-1] * np.arange(1, count) / count)).tolist() if count > 1 else []
