"""Legs: what a motion is cut into before it is cut into pieces, so that no axis with a reversal turns round inside a piece.

A straight motion of axis words is one leg. On an arc, and where the control makes axis positions of tool-tip coordinates while the tool
turns, an axis can come to a standstill and go back inside the block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np

from twin.compensation.bench import Bench
from twin.compensation.solving.rows import counted
from twin.compensation.toolpath import PathMotion

STEP_DEG: Final = 2.0
"""How finely an arc or a turn of the tool is searched for turning points, degrees."""
BEHIND: Final = 1e-4
"""Half the way over which a velocity is taken, as a share of the motion."""
STANDING: Final = 1e-8
"""mm or degrees over that way: less is the solver's own noise, and an axis that stands still."""
HALVINGS: Final = 24
"""2 degrees halved so often are 1e-7 of a degree."""


@final
@dataclass
class Legs:
    """Parts of motions, in order.

    Attributes:
        motion: (legs,) which motion each is of.
        begin, end: (legs,) fractions of it.
        count: (legs,) how many pieces each is in; 0 for one that another stands for.
    """

    motion: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, motions: int, turning: tuple[np.ndarray, np.ndarray]) -> Legs:
        """Of so many motions, cut at fractions of some of them (two arrays, motion and fraction)."""
        motion = np.concatenate([np.arange(motions), turning[0]])
        begin = np.concatenate([np.zeros(motions), turning[1]])
        order = np.lexsort((begin, motion))
        motion, begin = motion[order], begin[order]
        last = np.append(motion[1:] != motion[:-1], True)
        end = np.where(last, 1.0, np.append(begin[1:], 1.0))
        return cls(motion, begin, end, np.ones(len(motion), dtype=int))

    def whole(self, motions: np.ndarray) -> None:
        """Make some motions one leg in one piece again."""
        mine = np.isin(self.motion, motions)
        last = mine & (self.end == 1.0)
        self.begin[last], self.count[mine], self.count[last] = 0.0, 0, 1

    def ends(self, legs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of all pieces of some legs: leg, and the fraction of the motion at which the piece ends."""
        of, number = counted(legs, self.count[legs])
        share = (number + 1) / self.count[of]
        return of, np.where(share == 1.0, self.end[of], self.at(of, share))

    def at(self, legs: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Fractions of the motions at shares of legs."""
        return np.asarray(self.begin[legs] + share * (self.end[legs] - self.begin[legs]))


def turning_points(
    bench: Bench, motions: Sequence[PathMotion], which: np.ndarray, axes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Where axes turn round inside motions.

    Args:
        bench: the machine as drawn and the set-up.
        motions: all of them.
        which: indices of those the control interpolates.
        axes: indices of the axes that matter.

    Returns:
        (k,) motion and (k,) fraction, in order; none nearer to another or to an end of its motion than two least increments of every
        word, which is nearer than words can say.
    """
    curved = np.array([i for i in which if _can_turn(motions[i])] if axes else [], dtype=int)
    if not curved.size:
        return np.zeros(0, dtype=int), np.zeros(0)
    counts = np.array([_steps(motions[i]) for i in curved])
    of, index = counted(curved, counts + 1)
    grid = index / np.repeat(counts, counts + 1)
    found_of, found_at = [], []
    velocity = np.where(np.abs(v := _velocity(bench, motions, of, grid)) > STANDING, np.sign(v), 0.0)
    for axis in axes:
        moving = np.flatnonzero(velocity[:, axis])
        first, last = moving[:-1], moving[1:]
        turns = (of[first] == of[last]) & (velocity[first, axis] != velocity[last, axis])
        first, last = first[turns], last[turns]
        low, high, sign = grid[first], grid[last], velocity[first, axis]
        for _ in range(HALVINGS if first.size else 0):
            middle = (low + high) / 2.0
            before = _velocity(bench, motions, of[first], middle)[:, axis] * sign > 0.0
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        found_of.append(of[first])
        found_at.append((low + high) / 2.0)
    return _apart(bench, motions, np.concatenate(found_of), np.concatenate(found_at))


def _can_turn(motion: PathMotion) -> bool:
    return motion.move.arc is not None or (motion.move.tcp and bool(np.any(motion.start[3:] != motion.end[3:])))


def _steps(motion: PathMotion) -> int:
    turned = float(np.abs(motion.end[3:] - motion.start[3:]).max(initial=0.0)) if motion.move.tcp else 0.0
    arc = 0.0 if motion.move.arc is None else abs(np.degrees(motion.move.arc.angle_rad))
    return max(4, int(np.ceil(max(turned, arc) / STEP_DEG)))


def _velocity(bench: Bench, motions: Sequence[PathMotion], of: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """(n, axes) difference of commands just behind and just before fractions of motions, these in order."""
    bounds = np.append(np.flatnonzero(np.diff(of, prepend=-1)), len(of))
    tcp = np.array([motions[i].move.tcp for i in of])

    def commands(at: np.ndarray) -> np.ndarray:
        words = np.concatenate([motions[of[i]].along(at[i:j]) for i, j in pairwise(bounds)])
        return bench.space.commands(words, tcp)

    before, behind = np.clip(fraction - BEHIND, 0.0, 1.0), np.clip(fraction + BEHIND, 0.0, 1.0)
    return commands(behind) - commands(before)


def _apart(
    bench: Bench, motions: Sequence[PathMotion], of: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Those in order, without any that words cannot tell from the one before or from an end of its motion."""
    kept: list[tuple[int, float]] = []
    for motion in np.unique(of).tolist():
        places = np.sort(at[of == motion])
        words = motions[motion].along(np.array([0.0, *places, 1.0]))
        last = words[0]
        for place, here in zip(places.tolist(), words[1:-1], strict=True):
            if all(np.any(np.abs(here - there) >= 2.0 * bench.increment) for there in (last, words[-1])):
                kept.append((motion, place))
                last = here
    return np.array([one[0] for one in kept], dtype=int), np.array([one[1] for one in kept], dtype=float)
