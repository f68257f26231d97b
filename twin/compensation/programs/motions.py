"""Motions of a program: moves with known end points, one by one or in columns."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import MadeOnAccess
from twin._common.errors import InputError
from twin.machine.machine import Machine, bundled_machines
from twin.nc.blocks import Kind, Move, Notice
from twin.nc.dialect import Dialect
from twin.nc.modal import UNKNOWN_AXIS

SAMPLE_SPACING: Final = (10.0, 3.0)
"""Largest distance between two samples: mm of linear and degrees of rotary motion."""
SAMPLES_A_PIECE: Final = 5
"""Least number of interior points at which a piece is simulated; long pieces have more."""

CHORD_MM: Final = 0.01
"""Chord tolerance on arcs in a simulated execution."""
MOST_SAMPLES: Final = 100_000
"""Samples of one motion beyond which it is refused: 1 km, 833 turns of a rotary axis, an arc of as many chords."""


def counted(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (n,) the motion and the number within it, from 0, of the samples of motions that have (motions,) ``counts``."""
    of = np.repeat(np.arange(len(counts)), counts)
    return of, np.arange(len(of)) - (np.cumsum(counts) - counts)[of]


# --- Numbers without a decimal point that may count least increments, as on Fanuc controls: ``X100500`` is X 100.5 there

INCREMENTS: Final = "increments? (no decimal point, outside the axis's range)"
"""Hint for the user."""
FEWEST_INCREMENTS: Final = 1000.0
"""Least number without a decimal point that is taken for increments: 1 mm in micrometres."""
_WORD: Final = re.compile(r"([XYZABCUVW])[ \t]*=?[ \t]*[+-]?[ \t]*(\d+)(?![\d.,])", re.ASCII | re.IGNORECASE)
"""A word of an axis whose number has no decimal point."""


def numbers_of_increments(text: str) -> list[tuple[str, float]]:
    """Return the axis words of a line that may count increments: letter, and number without its sign."""
    words = _WORD.findall(text.split(";")[0])
    return [(letter.upper(), float(digits)) for letter, digits in words if float(digits) >= FEWEST_INCREMENTS]


@contextmanager
def machine_hints(machine: Machine, dialect: Dialect, text_of: Callable[[int], str]) -> Iterator[None]:
    """Let an `InputError` at a line say if a number of that line may count increments, or which machine has the axis that it names."""
    try:
        yield
    except InputError as error:
        if error.what == UNKNOWN_AXIS and error.value is not None:
            letter = str(error.value)[:1].upper()
            fit = [one.path.stem for one in bundled_machines() if letter in one.names and one.path is not None]
            error.expected += (
                f"; {letter} is an axis of {' and '.join(fit)}" if fit else f"; no machine of twin has {letter}"
            )
        if dialect.has_increments and error.line is not None and INCREMENTS not in error.what:
            ranges = {
                axis.name: axis.upper - axis.lower
                for axis in machine.axes
                if axis.lower is not None and axis.upper is not None
            }
            if any(number > ranges.get(name, number) for name, number in numbers_of_increments(text_of(error.line))):
                error.what += f"; {INCREMENTS}"
        raise


# --- Motions of a program: moves with known end points, one by one or in columns ------------------

COLUMNS: Final = ("move", "line", "rapid", "tcp", "start", "end", "by_vector")
"""Names of the arrays of `MotionColumns`."""


@final
@dataclass(frozen=True)
class PathMotion:
    """One move with known end points, in words of its own mode."""

    move: Move
    start: np.ndarray  # (axes,) words of the start point; NaN where the program has not given them
    end: np.ndarray  # (axes,) words of the end point; with rotary words also where the program gave a tool vector

    def along(self, fractions: np.ndarray) -> np.ndarray:
        """Return (k, axes) words at fractions (0…1]: on the line or arc, with rotary words and pitch in proportion."""
        words = self.start + fractions[:, None] * (self.end - self.start)
        arc = self.move.arc
        if arc is not None:
            plane = list(arc.plane[:2])
            # With a centre rounded to the increment, start and end radius differ: the radius changes linearly.
            first, last = self.start[plane] - arc.centre_mm, self.end[plane] - arc.centre_mm
            radius = np.hypot(*first) + fractions * (np.hypot(*last) - np.hypot(*first))
            begin, finish = np.arctan2(first[1], first[0]), np.arctan2(last[1], last[0])
            sweep = arc.angle_rad + np.mod(finish - begin - arc.angle_rad + np.pi, 2 * np.pi) - np.pi
            angle = begin + fractions * sweep
            words[:, plane] = np.add(arc.centre_mm, radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
            words[fractions == 1.0] = self.end
        return np.asarray(words)

    def chords(self, tolerance_mm: float) -> int:
        """Return the number of chords that stay within a tolerance of the motion: 1 for a line."""
        arc = self.move.arc
        if arc is None:
            return 1
        radius = float(np.hypot(*(self.start[list(arc.plane[:2])] - arc.centre_mm)))
        step = np.pi / 2 if radius <= tolerance_mm else 2.0 * np.arccos(1.0 - tolerance_mm / radius)
        return max(1, int(np.ceil(abs(arc.angle_rad) / step)))


@final
@dataclass(frozen=True)
class MotionColumns(MadeOnAccess[PathMotion]):
    """Motions in columns; `PathMotion` objects are created on access."""

    move: np.ndarray  # (n,) index of each motion's move among the moves converted with it
    line: np.ndarray  # (n,) index of its line
    rapid: np.ndarray  # (n,) whether it is a rapid
    tcp: np.ndarray  # (n,) whether its words are tool-tip coordinates
    start: np.ndarray  # start, end: (n, axes) as in `PathMotion`
    end: np.ndarray
    by_vector: np.ndarray  # (n,) whether it has a tool vector
    special: dict[int, Move]  # by index, moves with further data: arcs, and blocks that stay whole

    @classmethod
    def of(cls, motions: dict[int, PathMotion], width: int) -> MotionColumns:
        """Create columns from motions by the index of their move; ``width``: number of axes."""
        moves = [motion.move for motion in motions.values()]
        return cls(
            np.array([*motions], dtype=int),
            np.array([move.line for move in moves], dtype=int),
            np.array([move.kind is Kind.RAPID for move in moves], dtype=bool),
            np.array([move.tcp for move in moves], dtype=bool),
            np.array([motion.start for motion in motions.values()]).reshape(-1, width),
            np.array([motion.end for motion in motions.values()]).reshape(-1, width),
            np.array([move.vector is not None for move in moves], dtype=bool),
            {i: move for i, move in enumerate(moves) if move.arc is not None or move.whole},
        )

    @classmethod
    def joined(cls, parts: Sequence[MotionColumns]) -> MotionColumns:
        """Concatenate one or more column sets."""
        begins = np.cumsum([0, *map(len, parts)]).tolist()
        special = {at + i: move for at, part in zip(begins, parts, strict=False) for i, move in part.special.items()}
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS}
        return cls(special=special, **columns)

    def part(self, begin: int, end: int) -> MotionColumns:
        """Return the motions from index ``begin`` up to ``end``."""
        if (begin, end) == (0, len(self)):
            return self
        special = {i - begin: move for i, move in self.special.items() if begin <= i < end}
        return MotionColumns(special=special, **{name: getattr(self, name)[begin:end] for name in COLUMNS})

    @cached_property
    def known(self) -> np.ndarray:
        """(motions,) whether the program has given the whole start point."""
        return np.isfinite(self.start).all(axis=1)

    @cached_property
    def spacings(self) -> np.ndarray:
        """(motions,) length of each motion in units of the largest distance between two samples."""
        limits = np.repeat(SAMPLE_SPACING, [3, self.start.shape[1] - 3])
        shares = [np.abs(b - a) / limit for a, b, limit in zip(self.start.T, self.end.T, limits, strict=True)]
        return np.asarray(np.maximum.reduce(shares))

    def __len__(self) -> int:
        return len(self.line)

    def item(self, index: int) -> PathMotion:
        """Return one motion."""
        move = self.special.get(index)
        if move is None:
            kind = Kind.RAPID if self.rapid[index] else Kind.LINEAR
            end = tuple(self.end[index].tolist())
            move = Move(int(self.line[index]), kind, bool(self.tcp[index]), end, frozenset())
        return PathMotion(move, self.start[index], self.end[index])


@final
@dataclass(frozen=True)
class ProgramMotions(MadeOnAccess[PathMotion]):
    """Motions of a whole program with their moves as read, created on access."""

    columns: MotionColumns
    moves: Sequence[Move]  # the moves of the program

    def __len__(self) -> int:
        return len(self.columns)

    def item(self, index: int) -> PathMotion:
        """Return one motion with its move as read."""
        columns = self.columns
        return PathMotion(self.moves[int(columns.move[index])], columns.start[index], columns.end[index])


@final
@dataclass(frozen=True)
class Passage:
    """Axis positions after a line between two motions that is passed through unchanged."""

    before: int  # index of the next motion
    commands: np.ndarray  # (axes,) new positions of the moved axes, mm and degrees, command order; NaN where unknown
    moved: np.ndarray  # (axes,) whether each axis was moved


class LostBlock(NamedTuple):
    """A block that is passed through unchanged because nothing is known of where it goes."""

    line: int  # 0-based index of its line
    cutting: bool  # whether it is a feed
    reason: str  # why, in words


def by_reason(moves: Iterable[LostBlock]) -> dict[str, list[LostBlock]]:
    """Return blocks by the reason why nothing is known of them, in order."""
    lost: dict[str, list[LostBlock]] = {}
    for move in moves:
        lost.setdefault(move.reason, []).append(move)
    return lost


@final
@dataclass(frozen=True)
class ToolPath:
    """A program as motions."""

    motions: Sequence[PathMotion]  # motions with all positions known
    columns: MotionColumns  # the same in columns
    # notices on lines that move axes but are passed through unchanged, and on assumptions
    notices: tuple[Notice, ...] = ()
    # axis positions after those lines, and after lines that leave an axis at an unknown position
    passages: tuple[Passage, ...] = ()
    unknown: tuple[LostBlock, ...] = ()  # blocks that go to unknown places

    def part(self, begin: int, end: int) -> ToolPath:
        """Return the motions from index ``begin`` up to ``end``, with the passages between them."""
        columns = self.columns.part(begin, end)
        passages = tuple(
            replace(passage, before=passage.before - begin)
            for passage in self.passages
            if begin < passage.before < end or passage.before == begin == 0
        )
        return ToolPath(columns, columns, (), passages)

    def dense(self, of: np.ndarray, fractions: np.ndarray) -> np.ndarray:
        """Return (n, axes) words at (n,) fractions of motions, their indices ascending; the end if the start is unknown."""
        columns = self.columns
        start, end = columns.start[of], columns.end[of]
        words = start + fractions[:, None] * (end - start)
        unknown = ~columns.known[of]
        words[unknown] = end[unknown]
        for i, move in columns.special.items():
            if move.arc is not None and columns.known[i]:
                rows = slice(*np.searchsorted(of, [i, i + 1]))
                words[rows] = self.motions[i].along(fractions[rows])
        return words
