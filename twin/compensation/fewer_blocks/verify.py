"""Independent check: the output text executed densely on the machine with errors and compared with the input path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.compensation.backlash import Backlash
from twin.compensation.fewer_blocks.distance import largest_distance, lengths
from twin.compensation.toolpath import PathMotion, WordSpace, follow
from twin.kinematics.forward import Kinematics
from twin.nc.blocks import Interpretation, Program

PLACES: Final = 7
"""Points per block at which the path is evaluated; deliberately no multiple of the numbers used by fit and chords."""
NEAR: Final = 0.25
"""Share of the tolerance below which a closer point on the other path is not searched for."""
TURN_STEP_DEG: Final = 0.25
LINEAR_STEP_MM: Final = 5.0


@final
@dataclass(frozen=True)
class Executed:
    """A program executed on a machine, block by block.

    Attributes:
        block: (n,) index of each point's move among those of the program.
        words: (n, axes) commanded words.
        point_mm: (n, 3) tool points in the work frame.
    """

    block: np.ndarray
    words: np.ndarray
    point_mm: np.ndarray

    def without(self, blocks: np.ndarray) -> Executed:
        """Return the points without those of some moves."""
        keep = ~np.isin(self.block, blocks)
        return Executed(self.block[keep], self.words[keep], self.point_mm[keep])

    def between(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return words and points of the moves from ``first`` to ``last``, both included."""
        part = slice(*np.searchsorted(self.block, [first, last + 1]))
        return self.words[part], self.point_mm[part]


def execute_words(
    program: Program, reading: Interpretation, space: WordSpace, real: Kinematics, dense: np.ndarray
) -> Executed:
    """Execute a program as its control would, on straight lines in words.

    Args:
        program: as read.
        reading: its moves.
        space: conversion between words and commands.
        real: the machine with its errors.
        dense: (moves,) which moves are evaluated along their whole length, not only at their end points.
    """
    path = follow(program, reading, space)
    moves = path.columns.move
    motions = zip(path.motions, dense[moves].tolist(), strict=True)
    words, of = path.dense([_fractions(motion) if looked_at else np.array([1.0]) for motion, looked_at in motions])
    commands = space.commands(words, path.columns.tcp[of])
    sides = Backlash(real.calibration).sides(path, of, commands)
    point = real.reached(commands * space.machine.scale, sides)[1] * 1e3
    return Executed(moves[of], words, point)


def _fractions(motion: PathMotion) -> np.ndarray:
    if not motion.interpolated:
        return np.array([1.0])
    size = np.abs(motion.end - motion.start)
    steps = max(size[:3].max() / LINEAR_STEP_MM, size[3:].max(initial=0.0) / TURN_STEP_DEG, PLACES)
    return np.arange(int(np.ceil(steps)) + 1) / np.ceil(steps)


def path_distance_mm(
    one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray], lever_mm: float, tolerance_mm: float
) -> float:
    """Return the largest distance between two executed paths in both directions, mm; each is given by words and points.

    The nearest point is first searched at about the same distance along the path. Rotary words count towards this distance, so that it
    also increases while a tool only turns.
    """
    at = [_shares(words, points, lever_mm) for words, points in (one, other)]
    return largest_distance(one[1], at[0], other[1], at[1], NEAR * tolerance_mm, tolerance_mm, anywhere=True)


def _shares(words: np.ndarray, points: np.ndarray, lever_mm: float) -> np.ndarray:
    way = lengths(np.concatenate([points, np.radians(words[:, 3:]) * lever_mm], axis=1))
    return np.asarray(way / way[-1]) if way[-1] > 0.0 else way
