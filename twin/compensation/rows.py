"""Ends of pieces of blocks as arrays: what is solved for them, where pieces go, and dense points inside them."""

from __future__ import annotations

from dataclasses import dataclass
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
    """Ends of pieces: which leg and motion each belongs to, at which fraction of it, and everything solved for it.

    ``approach`` are the sides it is solved for, ``turned`` the axes that turn round in front of it; ``taken`` says that the row only
    takes up what that costs, standing at its fraction, ``beyond`` by how much it goes too far on purpose (mm and degrees).
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
    target: Poses
    exact: np.ndarray
    commands: np.ndarray
    printed: np.ndarray
    vectors: np.ndarray
    orientation_left: np.ndarray
    singular: np.ndarray
    clamped: np.ndarray
    untouched: np.ndarray

    def where(self, keep: np.ndarray | slice) -> Rows:
        """Some of the rows, (n,) booleans or a stretch of them."""
        fields = {name: getattr(self, name)[keep] for name in Rows.__dataclass_fields__ if name != "target"}
        return Rows(target=Poses(self.target.point_mm[keep], self.target.rotation[keep]), **fields)


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


class Samples(NamedTuple):
    """Dense points inside the pieces of legs.

    Attributes:
        leg: (pieces,) which leg each piece is of.
        number: (pieces,) which piece of it.
        piece: (n,) which of the pieces each point is in.
        within: (n,) at which fraction of it.
    """

    leg: np.ndarray
    number: np.ndarray
    piece: np.ndarray
    within: np.ndarray


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


def not_back(way: np.ndarray, most: float) -> np.ndarray:
    """A way up with its steps back left out, if they are smaller than ``most``: larger ones are no rounding."""
    out = []
    top = way[0]
    for place in way.tolist():
        top = place if place >= top or top - place >= most else top
        out.append(top)
    return np.array(out)


def distinct(rows: Rows) -> Rows:
    """Rows without moves that take up what words cannot tell from the place before, or from the one behind."""
    for behind in (False, True):
        vectors = np.nan_to_num(rows.vectors)
        alike = (np.abs(np.diff(rows.printed, axis=0)) < SAME).all(axis=1) & ~np.diff(vectors, axis=0).any(axis=1)
        rows = rows.where(~(rows.taken & (np.append(alike, False) if behind else np.append(False, alike))))
    return rows


def replaced(rows: Rows, legs: np.ndarray, new: Rows) -> Rows:
    """Rows with those of some legs exchanged, still in order."""
    keep = ~np.isin(rows.leg, legs)
    order = np.argsort(np.concatenate([rows.leg[keep], new.leg]), kind="stable")

    def merged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(np.concatenate([a[keep], b])[order])

    target = Poses(merged(rows.target.point_mm, new.target.point_mm), merged(rows.target.rotation, new.target.rotation))
    fields = {
        name: merged(getattr(rows, name), getattr(new, name)) for name in Rows.__dataclass_fields__ if name != "target"
    }
    return Rows(target=target, **fields)
