"""Runs: which blocks of a program are one smooth path cut short, and where it has corners.

A run is made of straight feed blocks one after the other that say nothing but where to go, in one mode and at one feed. Between them
there may be comments. A curve is fitted from corner to corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.compensation.fewer_blocks.fit import PARTS, Polyline
from twin.compensation.toolpath import Path, PathMotion, WordSpace
from twin.nc.blocks import Kind, Program
from twin.nc.dialect import Dialect

FEWEST: Final = 3
"""Blocks of a run: in two there is nothing to save."""
LONE_BEND_RAD: Final = np.radians(15.0)
"""A bend that stands alone is a corner from here on …"""
LONE: Final = 3.0
"""… where the bends beside it are smaller by this factor: those of a curve are alike."""
LONG: Final = 10.0
"""A block longer than this many of the run's middle ones is a line of its own, not part of a curve."""
SAME_MM: Final = 1e-9
"""Places nearer to each other are one."""


@final
@dataclass(frozen=True)
class Run:
    """Blocks one after the other.

    Attributes:
        motions: their indices in ``Path.motions``, in order.
        lines: index of each one's line in the program.
        words: (n+1, axes) where the first starts, and all ends.
    """

    motions: range
    lines: tuple[int, ...]
    words: np.ndarray


def find_runs(program: Program, dialect: Dialect, path: Path, space: WordSpace) -> list[Run]:
    """The runs of a program, in order."""
    plain = _plain_lines(program, dialect, path, space.axes.names)
    passed = {passage.before for passage in path.passages}
    per_line: dict[int, int] = {}
    for motion in path.motions:
        per_line[motion.move.line] = per_line.get(motion.move.line, 0) + 1
    runs: list[Run] = []
    members: list[int] = []

    def close() -> None:
        if len(members) >= FEWEST:
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
    """Vertices of a run at which a curve ends and another begins, its two ends among them.

    A vertex is a corner if the smooth path from the middle of one block to the middle of the next would pass it by more than the
    fit may (twice that much for a curve on both sides of its polyline), if its bend stands alone, or if a block beside it is so long
    that it is a line of its own. That path, tangent to both blocks, passes at ¼ of the shorter times the sine of half the bend.

    Args:
        line: the run; blocks that are not straight at the tool bend by the directions in which they end.
        allowed_mm: how far a curve may leave the run.
    """
    size = line.size
    way = np.diff(line.dense_tool, axis=0)
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    half_sine = np.linalg.norm(unit[PARTS::PARTS] - unit[PARTS - 1 : -1 : PARTS], axis=1) / 2.0
    bend = 2.0 * np.arcsin(np.clip(half_sine, 0.0, 1.0))
    rounded = np.minimum(size[:-1], size[1:]) * half_sine / 4.0
    beside = np.maximum(np.append(0.0, bend[:-1]), np.append(bend[1:], 0.0))
    lone = (bend >= LONE_BEND_RAD) & (bend >= LONE * beside)
    long = size > LONG * np.median(size)
    found = (rounded > 2.0 * allowed_mm) | lone | long[:-1] | long[1:]
    return [0, *(np.flatnonzero(found) + 1).tolist(), len(size)]


def _straight(motion: PathMotion) -> bool:
    """Whether a block goes straight from a known place, and only there."""
    move = motion.move
    return move.kind is Kind.LINEAR and not move.machine and move.normal is None and motion.interpolated


def _follows(before: PathMotion, motion: PathMotion) -> bool:
    """Whether a block goes on where the one before ended, in the same words."""
    same = before.move.tcp == motion.move.tcp and (before.move.vector is None) == (motion.move.vector is None)
    return same and bool(np.array_equal(before.end, motion.start))


def _plain_lines(program: Program, dialect: Dialect, path: Path, names: tuple[str, ...]) -> dict[int, str]:
    """Lines that say nothing but where to go, and the feed in force there; none while the feed is a time."""
    moving = {motion.move.line for motion in path.motions}
    found: dict[int, str] = {}
    feed, timed = "", False
    for index, text in enumerate(program.texts):
        said, times = dialect.feed_word(text)
        feed, timed = said or feed, timed if times is None else times
        if index in moving and not timed and dialect.is_motion_only(text, names):
            found[index] = feed
    return found
