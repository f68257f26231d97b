"""Legs: parts of motions within which no axis with backlash reverses; legs are then cut into pieces.

A straight motion of axis words is one leg. On an arc, and in tool-tip coordinates while the tool turns, an axis can reverse inside the
block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np

from twin.compensation.prepared import PreparedMachine
from twin.compensation.solving.rows import repeat_with_index, taken
from twin.compensation.toolpath import PathMotion, ToolPath

STEP_DEG: Final = 2.0
"""Step of the search for reversals on an arc or a turn of the tool, degrees."""
HALF_INTERVAL: Final = 1e-4
"""Half the interval for numerical velocities, as a fraction of the motion."""
AT_REST: Final = 1e-8
"""Displacement (mm, degrees) over that interval below which an axis stands still; the solver's numerical noise is smaller."""
HALVINGS: Final = 24
"""Bisection steps: 2 degrees become 1e-7 of a degree."""


@final
@dataclass
class Legs:
    """Parts of motions, in order.

    Attributes:
        motion: (legs,) motion of each leg.
        begin, end: (legs,) fractions of that motion.
        count: (legs,) number of pieces; 0 for a leg merged into another.
    """

    motion: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, motions: int, turning: tuple[np.ndarray, np.ndarray]) -> Legs:
        """Create the legs of ``motions`` motions, cut at the points ``turning``: (k,) motions and (k,) fractions."""
        motion = np.concatenate([np.arange(motions), turning[0]])
        begin = np.concatenate([np.zeros(motions), turning[1]])
        order = np.lexsort((begin, motion))
        motion, begin = motion[order], begin[order]
        last = np.append(motion[1:] != motion[:-1], True)
        end = np.where(last, 1.0, np.append(begin[1:], 1.0))
        return cls(motion, begin, end, np.ones(len(motion), dtype=int))

    def merge(self, motions: np.ndarray) -> None:
        """Merge the legs of some motions into one leg in one piece."""
        mine = np.isin(self.motion, motions)
        last = mine & (self.end == 1.0)
        self.begin[last], self.count[mine], self.count[last] = 0.0, 0, 1

    def whole(self, legs: np.ndarray) -> bool:
        """Return whether each of some legs is a motion in one piece."""
        columns = ((self.count, 1), (self.begin, 0.0), (self.end, 1.0))
        return all(bool(np.all(taken(column, legs) == value)) for column, value in columns)

    def ends(self, legs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the leg of every piece of some legs, and the fraction of the motion at the piece's end point."""
        if self.whole(legs):
            return legs, np.ones(len(legs))
        of, number = repeat_with_index(legs, self.count[legs])
        share = (number + 1) / self.count[of]
        return of, np.where(share == 1.0, self.end[of], self.at(of, share))

    def at(self, legs: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the fractions of the motions at fractions of legs."""
        return np.asarray(self.begin[legs] + share * (self.end[legs] - self.begin[legs]))


def turning_points(
    prepared: PreparedMachine, path: ToolPath, which: np.ndarray, axes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points at which axes reverse inside motions.

    Args:
        prepared: the machine without errors, and the set-up.
        path: all motions.
        which: indices of the interpolated ones.
        axes: indices of the axes to consider.

    Returns:
        (k,) motion and (k,) fraction, in order. Points closer than two least increments to another one or to an end point of the
        motion are omitted, because rounded words cannot represent them.
    """
    columns, motions = path.columns, path.motions
    can_turn = np.array(columns.tcp)
    if can_turn.any():
        can_turn &= (columns.start[:, 3:] != columns.end[:, 3:]).any(axis=1)
    can_turn[list(columns.special)] = True
    curved = which[can_turn[which]]
    if not axes or not curved.size:
        return np.zeros(0, dtype=int), np.zeros(0)
    counts = np.array([_steps(motions[i]) for i in curved])
    of, index = repeat_with_index(curved, counts + 1)
    grid = index / np.repeat(counts, counts + 1)
    found_of, found_at = [], []
    velocity = np.where(np.abs(v := _velocity(prepared, motions, of, grid)) > AT_REST, np.sign(v), 0.0)
    for axis in axes:
        moving = np.flatnonzero(velocity[:, axis])
        first, last = moving[:-1], moving[1:]
        turns = (of[first] == of[last]) & (velocity[first, axis] != velocity[last, axis])
        first, last = first[turns], last[turns]
        low, high, sign = grid[first], grid[last], velocity[first, axis]
        for _ in range(HALVINGS if first.size else 0):
            middle = (low + high) / 2.0
            before = _velocity(prepared, motions, of[first], middle)[:, axis] * sign > 0.0
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        found_of.append(of[first])
        found_at.append((low + high) / 2.0)
    return _resolvable(prepared, motions, np.concatenate(found_of), np.concatenate(found_at))


def _steps(motion: PathMotion) -> int:
    turned = float(np.abs(motion.end[3:] - motion.start[3:]).max(initial=0.0)) if motion.move.tcp else 0.0
    arc = 0.0 if motion.move.arc is None else abs(np.degrees(motion.move.arc.angle_rad))
    return max(4, int(np.ceil(max(turned, arc) / STEP_DEG)))


def _velocity(
    prepared: PreparedMachine, motions: Sequence[PathMotion], of: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    """Return (n, axes) differences of commands just after and just before fractions of motions, in ascending order."""
    bounds = np.append(np.flatnonzero(np.diff(of, prepend=-1)), len(of))
    tcp = np.array([motions[i].move.tcp for i in of])

    def commands(at: np.ndarray) -> np.ndarray:
        words = np.concatenate([motions[of[i]].along(at[i:j]) for i, j in pairwise(bounds)])
        return prepared.space.commands(words, tcp)

    before, behind = np.clip(fraction - HALF_INTERVAL, 0.0, 1.0), np.clip(fraction + HALF_INTERVAL, 0.0, 1.0)
    return commands(behind) - commands(before)


def _resolvable(
    prepared: PreparedMachine, motions: Sequence[PathMotion], of: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points in order, without those that rounded words cannot distinguish from the one before or from an end point."""
    kept: list[tuple[int, float]] = []
    for motion in np.unique(of).tolist():
        places = np.sort(at[of == motion])
        words = motions[motion].along(np.array([0.0, *places, 1.0]))
        last = words[0]
        for place, here in zip(places.tolist(), words[1:-1], strict=True):
            if all(np.any(np.abs(here - there) >= 2.0 * prepared.increment) for there in (last, words[-1])):
                kept.append((motion, place))
                last = here
    return np.array([point[0] for point in kept], dtype=int), np.array([point[1] for point in kept], dtype=float)
