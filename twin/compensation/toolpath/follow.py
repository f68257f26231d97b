"""Blocks → tool path: goes through a program's moves, keeping track of where every axis stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.toolpath.motions import MotionColumns, Passage, Path, PathMotion
from twin.compensation.toolpath.words import WordSpace
from twin.nc.blocks import Kind, Left, Move, Notice, Program, Reading
from twin.nc.columns import MoveColumns

TextOf = Callable[[int], str]
"""The text of a line, by its index in the program."""


def follow(program: Program, reading: Reading, space: WordSpace) -> Path:
    """Go through a program, keeping track of where every axis stands.

    Raises:
        InputError: a feed move from or to a place the program has not said, or a tool vector the machine cannot reach.
    """
    follower = Follower(program.source, space)
    motions = follower.follow(reading, lambda line: program.texts[line])
    columns = MotionColumns.of(motions, len(space.axes.names))
    return Path(tuple(motions.values()), columns, tuple(follower.passed), tuple(follower.passages))


@final
class Follower:
    """Goes through a program, in one stretch or several, keeping track of where every axis stands.

    Args:
        source: the program's name.
        space: words to commands.

    Attributes:
        passed: notices so far on lines that move but are left as written, and on what was assumed.
        passages: what lines between motions did to the axes so far.
    """

    def __init__(self, source: str, space: WordSpace) -> None:
        self.passed: list[Notice] = []
        self.passages: list[Passage] = []
        self._count = 0
        self._source = source
        self._space = space
        self._words = np.full(len(space.axes.names), np.nan)
        self._tcp: bool | None = None
        self._assumed = False
        self._left: list[Left] = []

    def follow(self, reading: Reading, text_of: TextOf) -> dict[int, PathMotion]:
        """The motions of all moves, by the index of the move.

        Raises:
            InputError: as `follow`.
        """
        moves = reading.moves
        vectors = self._enter(
            {i: move for i, move in enumerate(moves) if move.vector is not None}, reading.lost_positions
        )
        steps = ((i, self._step(move, vectors.get(i), text_of)) for i, move in enumerate(moves))
        return {i: motion for i, motion in steps if motion is not None}

    def columns(self, moves: MoveColumns, left: Sequence[Left], text_of: TextOf) -> MotionColumns:
        """The motions of the next moves, those that are plain all at once.

        Args:
            moves: the moves.
            left: what lines among them leave in places unknown.
            text_of: the text of a line.

        Raises:
            InputError: as `follow`.
        """
        vectors = self._enter({i: move for i, move in moves.special.items() if move.vector is not None}, left)
        behind = np.searchsorted(moves.line, np.array([one.line for one in left], dtype=int), side="right")
        stops = np.unique([*moves.special, *np.flatnonzero(np.diff(moves.tcp)) + 1, *behind, len(moves)])
        parts: list[MotionColumns] = []
        loose: dict[int, PathMotion] = {}
        at = 0
        while at < len(moves):
            self._forget_before(int(moves.line[at]))
            end = int(stops[np.searchsorted(stops, at, side="right")])
            plain = end > at + 1 and at not in moves.special and self._tcp == bool(moves.tcp[at])
            if plain and np.isfinite(self._words).all():
                parts += [MotionColumns.of(loose, len(self._words)), self._plain(moves, at, end)]
                loose = {}
                at = end
                continue
            motion = self._step(moves[at], vectors.get(at), text_of)
            if motion is not None:
                loose[at] = motion
            at += 1
        return MotionColumns.joined([*parts, MotionColumns.of(loose, len(self._words))])

    def _enter(self, with_vector: Mapping[int, Move], left: Sequence[Left]) -> dict[int, np.ndarray]:
        """Begin with the next moves: rotary positions for the tool vectors among them."""
        self._left = [*left[::-1], *self._left]
        if not with_vector:
            return {}
        solutions = self._space.branches.all(np.array([move.vector for move in with_vector.values()]))
        return dict(zip(with_vector, solutions, strict=True))

    def _plain(self, moves: MoveColumns, begin: int, end: int) -> MotionColumns:
        """Moves that only name positions, from where every axis is known."""
        part = slice(begin, end)
        said = moves.position[part]
        ends = np.where(np.isnan(said), self._words, said)
        starts = np.concatenate([self._words[None, :], ends[:-1]])
        self._words = ends[-1].copy()
        self._count += end - begin
        return MotionColumns(
            np.arange(begin, end), moves.line[part], moves.rapid[part], moves.tcp[part], starts, ends, {}
        )

    def _forget_before(self, line: int) -> None:
        """What the lines before one left in places unknown."""
        while self._left and self._left[-1].line < line:
            left, words = self._left.pop(), self._words
            forgotten = np.isin(np.arange(len(words)), left.axes)
            self._pass(np.full(len(words), np.nan), forgotten)
            if left.moved:
                self._words = np.where(forgotten, np.nan, words)
                self._assumed = self._assumed and not forgotten[3:].any()

    def _pass(self, commands: np.ndarray, moved: np.ndarray) -> None:
        """Note a passage, both in the order of the words."""
        ordered, which = np.empty_like(commands), np.empty_like(moved)
        ordered[self._space.order], which[self._space.order] = commands, moved
        self.passages.append(Passage(self._count, ordered, which))

    def _step(self, move: Move, solutions: np.ndarray | None, text_of: TextOf) -> PathMotion | None:
        """One move; None if it is no motion from and to places that are known."""
        self._forget_before(move.line)
        if move.tcp != self._tcp:
            if self._tcp is not None:
                self._words = self._switched(move.tcp)
            self._tcp = move.tcp
        words, end = self._words, np.array(move.position)
        if move.machine:
            self._pass(end, np.isfinite(end))
            self._words = np.where(self._named(move), end - self._space.offset, words)
            if move.tcp:
                self._words[:3] = np.nan  # where the tip is then depends on the control
            self.passed.append(Notice(move.line, "machine coordinates: passed through as written"))
            return None
        end = np.where(np.isnan(end), words, end)
        if solutions is not None:
            end[3:] = self._along_vector(move, solutions, words[3:])
        if np.isnan(end[3:]).any():
            end[3:] = self._assume(move.line, end[3:])
        start = words.copy()
        start[3:] = np.where(np.isnan(start[3:]), end[3:], start[3:])
        self._words = end
        if np.isnan(end[:3]).any():
            self._not_said(move, end, text_of)
            return None
        self._count += 1
        return PathMotion(move, start, end)

    def _named(self, move: Move) -> np.ndarray:
        """(axes,) which words a move has."""
        return np.array([name in move.named for name in self._space.axes.names])

    def _switched(self, tcp: bool) -> np.ndarray:
        """Where the axes stand in the words of the other mode."""
        if not np.isfinite(self._words).all():
            return np.concatenate([np.full(3, np.nan), self._words[3:]])
        return self._space.switched(self._words[None, :], tcp=tcp)[0]

    def _assume(self, line: int, rotary: np.ndarray) -> np.ndarray:
        """Rotary words, those not said yet as the set-up has them: noted the first time."""
        space, unsaid = self._space, np.isnan(rotary)
        if not self._assumed:
            taken = {
                name: value
                for name, value, missing in zip(space.axes.rotary, space.start, unsaid, strict=True)
                if missing
            }
            at = ", ".join(f"{name} = {value:g}°" for name, value in taken.items())
            self.passed.append(
                Notice(line, f"the program has not said where {' and '.join(taken)} stand: taken as {at}")
            )
            self._assumed = True
        return np.where(unsaid, space.start, rotary)

    def _not_said(self, move: Move, end: np.ndarray, text_of: TextOf) -> None:
        """Pass a rapid to a place that is not known; a feed move there is an error."""
        space = self._space
        names = ", ".join(name for name, value in zip(space.axes.linear, end, strict=False) if np.isnan(value))
        if move.kind is not Kind.RAPID:
            raise InputError(
                f"a feed move before the program said where {names} stand",
                expected="a position for every linear axis first",
                file=self._source,
                line=move.line + 1,
                value=text_of(move.line).strip(),
            )
        self.passed.append(Notice(move.line, f"{names} not said yet: rapid passed through as written"))
        commands = end + space.offset
        if move.tcp:
            commands[:3] = np.nan
        self._pass(commands, self._named(move))

    def _along_vector(self, move: Move, solutions: np.ndarray, before: np.ndarray) -> np.ndarray:
        space = self._space
        standing = np.where(np.isnan(before), space.start, before) + space.offset[3:]
        found = space.branches.nearest(solutions, standing)
        if found is None:
            raise InputError(
                f"{space.machine.name} cannot point its tool that way",
                expected="a tool vector within the ranges of its rotary axes",
                file=self._source,
                line=move.line + 1,
                value=move.vector,
            )
        return np.asarray(found - space.offset[3:])
