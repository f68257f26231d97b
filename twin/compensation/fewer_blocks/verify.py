"""The output executed on the machine with errors, beside the input's path: from the text alone, densely."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.compensation.backlash import LostMotion
from twin.compensation.fewer_blocks.distance import apart, lengths
from twin.compensation.toolpath import WordSpace, along, follow
from twin.kinematics.forward import Kinematics
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect

PLACES: Final = 7
"""Places a block at which it is looked at: no multiple of those that fit and chords looked at."""
NEAR: Final = 0.25
"""Share of the tolerance below which a nearer place on the other path does not matter."""
TURN_STEP_DEG: Final = 0.25
LINEAR_STEP_MM: Final = 5.0


@final
@dataclass(frozen=True)
class Executed:
    """A program run on a machine, block by block.

    Attributes:
        block: (n,) index of each place's move among those of the program.
        words: (n, axes) what is commanded there, in words.
        point_mm: (n, 3) where the tool is, in the work frame.
    """

    block: np.ndarray
    words: np.ndarray
    point_mm: np.ndarray

    def without(self, blocks: np.ndarray) -> Executed:
        """But for some moves."""
        keep = ~np.isin(self.block, blocks)
        return Executed(self.block[keep], self.words[keep], self.point_mm[keep])

    def between(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Words and points of the moves from one to another, both included."""
        part = slice(*np.searchsorted(self.block, [first, last + 1]))
        return self.words[part], self.point_mm[part]


def execute_words(
    program: Program,
    dialect: Dialect,
    space: WordSpace,
    real: Kinematics,
    *,
    tcp: bool,
    dense: np.ndarray | None = None,
) -> Executed:
    """Run a program as its control would, straight in words.

    Args:
        program: as read.
        dialect: its language.
        space: the machine's words.
        real: the machine, with the errors it has.
        tcp: as of `Dialect.moves`.
        dense: (moves,) which are looked at from where they begin, not only at their ends; all if None.
    """
    reading = dialect.moves(program, space.axes, tcp=tcp)
    path = follow(program, reading, space)
    index = {id(move): i for i, move in enumerate(reading.moves)}
    words, block, of, modes = [], [], [], []
    for i, motion in enumerate(path.motions):
        move = index[id(motion.move)]
        share = np.array([1.0])
        if motion.interpolated and (dense is None or dense[move]):
            size = np.abs(motion.end - motion.start)
            steps = max(size[:3].max() / LINEAR_STEP_MM, size[3:].max(initial=0.0) / TURN_STEP_DEG, PLACES)
            share = np.arange(int(np.ceil(steps)) + 1) / np.ceil(steps)
        words.append(along(motion, share) if np.isfinite(motion.start).all() else motion.end[None])
        block += [move] * len(words[-1])
        of += [i] * len(words[-1])
        modes += [motion.move.tcp] * len(words[-1])
    every = np.concatenate(words)
    commands = space.commands(every, np.array(modes))
    sides = LostMotion(real.calibration).sides(path, np.array(of), commands)
    point = real.reached(commands * space.machine.scale, sides)[1] * 1e3
    return Executed(np.array(block), every, point)


def apart_mm(
    one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray], lever_mm: float, tolerance_mm: float
) -> float:
    """The largest distance between two executed paths, both ways, mm; each is its words and its points.

    A place is first looked for about as far along, where the rotary words count too: a tool that stands and turns goes on.
    """
    at = [_shares(words, points, lever_mm) for words, points in (one, other)]
    return apart(one[1], at[0], other[1], at[1], NEAR * tolerance_mm, tolerance_mm, anywhere=True)


def _shares(words: np.ndarray, points: np.ndarray, lever_mm: float) -> np.ndarray:
    way = lengths(np.concatenate([points, np.radians(words[:, 3:]) * lever_mm], axis=1))
    return np.asarray(way / way[-1]) if way[-1] > 0.0 else way
