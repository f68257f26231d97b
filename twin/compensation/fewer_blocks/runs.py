"""Find runs, sequences of blocks that approximate one smooth path, and their corners.

A run consists of consecutive straight feed blocks that contain nothing but positions, in one mode and at one feed; comments between
them are allowed. Curves are fitted from corner to corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.compensation.fewer_blocks.fit import POINTS_PER_BLOCK, Polyline
from twin.compensation.programs.motions import PathMotion, ToolPath
from twin.compensation.programs.words import WordSpace
from twin.nc.blocks import Kind, Program
from twin.nc.dialect import Dialect, FeedUnit

FEWEST_BLOCKS: Final = 3
"""Least number of blocks of a run: two cannot be reduced."""
ISOLATED_BEND_RAD: Final = np.radians(15.0)
"""Least isolated bend that is a corner …"""
ISOLATED_FACTOR: Final = 3.0
"""… a bend is isolated if its neighbours are smaller by this factor; along a curve they are similar."""
LONG_FACTOR: Final = 10.0
"""A block longer than this many median blocks of the run is a line of its own, not part of a curve."""
SAME_MM: Final = 1e-9
"""Distance below which positions are equal."""


@final
@dataclass(frozen=True)
class Run:
    """Consecutive blocks of a run."""

    motions: range  # their indices in ``ToolPath.motions``, in order
    lines: tuple[int, ...]  # index of each block's line in the program
    words: np.ndarray  # (n+1, axes) start of the first block, and end points of all


def find_runs(program: Program, dialect: Dialect, path: ToolPath, space: WordSpace) -> list[Run]:
    """Return the runs of a program, in order."""
    plain = _plain_lines(program, dialect, path, space.axes.names)
    passed = {passage.before for passage in path.passages}
    per_line: dict[int, int] = {}
    for motion in path.motions:
        per_line[motion.move.line] = per_line.get(motion.move.line, 0) + 1
    runs: list[Run] = []
    members: list[int] = []

    def close() -> None:
        if len(members) >= FEWEST_BLOCKS:
            motions = [path.motions[i] for i in members]
            words = np.array([motions[0].start, *(motion.end for motion in motions)])
            runs.append(Run(range(members[0], members[-1] + 1), tuple(m.move.line for m in motions), words))
        members.clear()

    for i, motion in enumerate(path.motions):
        feed = plain.get(motion.move.line)
        fits = feed is not None and per_line[motion.move.line] == 1 and _straight(motion)
        if members and not (fits and _follows(path.motions[members[-1]], motion) and i not in passed):
            close()
        if members:
            before = path.motions[members[-1]].move.line
            if feed != plain[before] or not all(map(dialect.is_comment, program.texts[before + 1 : motion.move.line])):
                close()
        if fits:
            members.append(i)
    close()
    return runs


def corners(line: Polyline, allowed_mm: float) -> list[int]:
    """Return the vertices of a run at which one curve ends and the next begins, including both end points.

    A vertex is a corner in three cases. First, the smooth path from the middle of one block to the middle of the next would miss it by
    more than the fit allows (twice that much, because a curve may lie on both sides of its polyline). Second, its bend is isolated.
    Third, a neighbouring block is so long that it is a line of its own. The smooth path, tangent to both blocks, misses the vertex by ¼
    of the shorter block times the sine of half the bend.

    ``line``: the run; bends of blocks that are not straight at the tool are measured between their end directions; ``allowed_mm``:
    largest distance allowed between curve and run.
    """
    size = line.size
    way = np.diff(line.dense_tool, axis=0)
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    half_sine = (
        np.linalg.norm(
            unit[POINTS_PER_BLOCK::POINTS_PER_BLOCK] - unit[POINTS_PER_BLOCK - 1 : -1 : POINTS_PER_BLOCK], axis=1
        )
        / 2.0
    )
    bend = 2.0 * np.arcsin(np.clip(half_sine, 0.0, 1.0))
    rounded = np.minimum(size[:-1], size[1:]) * half_sine / 4.0
    neighbour = np.maximum(np.append(0.0, bend[:-1]), np.append(bend[1:], 0.0))
    isolated = (bend >= ISOLATED_BEND_RAD) & (bend >= ISOLATED_FACTOR * neighbour)
    long = size > LONG_FACTOR * np.median(size)
    is_corner = (rounded > 2.0 * allowed_mm) | isolated | long[:-1] | long[1:]
    return [0, *(np.flatnonzero(is_corner) + 1).tolist(), len(size)]


def _straight(motion: PathMotion) -> bool:
    """Return whether a block is one straight move from a known position and nothing else."""
    move = motion.move
    free = not (move.machine or move.whole) and move.normal is None
    return move.kind is Kind.LINEAR and free and motion.interpolated


def _follows(before: PathMotion, motion: PathMotion) -> bool:
    """Return whether a block begins where the one before ended, in the same kind of words."""
    same = before.move.tcp == motion.move.tcp and (before.move.vector is None) == (motion.move.vector is None)
    return same and bool(np.array_equal(before.end, motion.start))


def _plain_lines(program: Program, dialect: Dialect, path: ToolPath, names: tuple[str, ...]) -> dict[int, str]:
    """Return the lines that contain only positions, with the feed in force; none in inverse-time feed mode."""
    moving = {motion.move.line for motion in path.motions}
    plain_lines: dict[int, str] = {}
    feed: float | None = None
    timed = False
    for index, text in enumerate(program.texts):
        words = dialect.line_words(text)
        feed = feed if words.feed is None else words.feed
        timed = timed if words.unit is None else words.unit is FeedUnit.INVERSE
        if index in moving and not timed and dialect.is_motion_only(text, names):
            plain_lines[index] = str(feed)
    return plain_lines
