"""Convert a program's moves to motions, tracking the position of every axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.toolpath.motions import LostBlock, MotionColumns, Passage, PathMotion, ProgramMotions, ToolPath
from twin.compensation.toolpath.samples import CHORD_MM, MOST_SAMPLES, SAMPLE_SPACING
from twin.compensation.toolpath.words import WordSpace
from twin.nc.blocks import Interpretation, Kind, LostPositions, Move, Notice, Program
from twin.nc.columns import MoveColumns, as_columns

TextOf = Callable[[int], str]
"""Function from a line's index in the program to its text."""


def follow(
    program: Program, reading: Interpretation, space: WordSpace, later: Sequence[tuple[int, WordSpace]] = ()
) -> ToolPath:
    """Return a program as motions with known end points.

    Args:
        program: as read.
        reading: its moves.
        space: conversion from words to commands.
        later: other conversions that apply from a line (0-based index) on, in order.

    Raises:
        InputError: a feed move from or to a position the program has not given, or a tool vector the machine cannot reach.
    """
    follower = Follower(program.source, space, later)
    moves = as_columns(space.axes.names, reading.moves)
    columns = follower.columns(moves, reading.lost_positions, lambda line: program.texts[line])
    passed = tuple(follower.notices), tuple(follower.passages), tuple(follower.unknown)
    return ToolPath(ProgramMotions(columns, moves), columns, *passed)


def motionless(source: str, unknown: Sequence[LostBlock] = ()) -> InputError:
    """Return the error for a program without a motion between known positions; ``unknown``: its blocks that go to unknown places."""
    what = "no block moves an axis to a known position"
    if not unknown:
        return InputError(what, expected="a program with axis motion", file=source)
    expected = "statements whose effect is known, or machine coordinates of every axis after them"
    return InputError(f"{what}: {unknown[0].reason}", expected=expected, file=source, line=unknown[0].line + 1)


@final
class Follower:
    """Converts a program's moves to motions, in one stretch or several, tracking the position of every axis.

    Args:
        source: the program's name.
        space: conversion from words to commands.
        later: other conversions that apply from a line (0-based index) on, in order.

    Attributes:
        notices: notices on lines that move axes but are passed through unchanged, and on assumptions, so far.
        passages: axis positions after lines between motions, so far.
        unknown: blocks that go to unknown places, so far.
    """

    def __init__(self, source: str, space: WordSpace, later: Sequence[tuple[int, WordSpace]] = ()) -> None:
        self.notices: list[Notice] = []
        self.passages: list[Passage] = []
        self.unknown: list[LostBlock] = []
        self._count = 0
        self._source = source
        self._space = space
        self._later = list(later)[::-1]
        self._words = np.full(len(space.axes.names), np.nan)
        self._tcp: bool | None = None
        self._assumed = False
        self._left: list[LostPositions] = []

    def columns(self, moves: MoveColumns, left: Sequence[LostPositions], text_of: TextOf) -> MotionColumns:
        """Return the motions of the next moves; consecutive plain ones are converted together.

        Args:
            moves: the moves.
            left: lines among them that leave axes at unknown positions.
            text_of: function that returns the text of a line.

        Raises:
            InputError: as for `follow`.
        """
        self._left = [*left[::-1], *self._left]
        if np.any(moves.by_vector):
            self._space.branches  # noqa: B018  # refuses a machine that cannot follow tool vectors
        single = {i for i, move in moves.special.items() if move.arc is not None or move.passes}
        changes = np.searchsorted(moves.line, [one.line for one in left], side="right")
        later = np.searchsorted(moves.line, [line for line, _ in self._later])
        modes = (np.diff(moves.tcp) | np.diff(moves.by_vector)).nonzero()[0] + 1
        stops = np.array(sorted({*single, *(i + 1 for i in single), *modes, *changes, *later, len(moves)}), dtype=int)
        parts: list[MotionColumns] = []
        loose: dict[int, PathMotion] = {}
        at = 0
        while at < len(moves):
            self._forget_before(int(moves.line[at]))
            end = int(stops[np.searchsorted(stops, at, side="right")])
            plain = (
                end > at + 1 and at not in single and self._tcp == bool(moves.tcp[at]) and not self._moved(moves, at)
            )
            if plain and np.isfinite(self._words).all():
                found = self._plain(moves, at, end)
                if len(found):
                    parts += [MotionColumns.of(loose, len(self._words)), found]
                    loose = {}
                    at += len(found)
                    continue
            motion = self._step(moves[at], text_of)
            if motion is not None:
                loose[at] = motion
            at += 1
        return self._checked(MotionColumns.joined([*parts, MotionColumns.of(loose, len(self._words))]), text_of)

    def _moved(self, moves: MoveColumns, at: int) -> bool:
        """Return whether a conversion begins at a move that is not yet in force."""
        return bool(self._later) and self._later[-1][0] <= int(moves.line[at])

    def _plain(self, moves: MoveColumns, begin: int, end: int) -> MotionColumns:
        """Return the motions of moves that only name positions or tool vectors, when every axis position is known.

        They end before the first tool vector that the machine cannot reach.
        """
        part = slice(begin, end)
        named = moves.position[part]
        ends = np.where(np.isnan(named), self._words, named)
        if np.isfinite(moves.vector[begin, 0]):
            solutions = self._space.branches.all(moves.vector[part])
            rotary = self._space.branches.along(solutions, self._words[3:], self._space.offset[3:])
            ends = ends[: len(rotary)]
            ends[:, 3:] = rotary
            part = slice(begin, begin + len(rotary))
        starts = np.concatenate([self._words[None, :], ends[:-1]])[: len(ends)]
        self._words = ends[-1].copy() if len(ends) else self._words
        self._count += len(ends)
        return MotionColumns(
            np.arange(part.start, part.stop),
            moves.line[part],
            moves.rapid[part],
            moves.tcp[part],
            starts,
            ends,
            moves.by_vector[part],
            {},
        )

    def _forget_before(self, line: int) -> None:
        """Mark axis positions as unknown that lines before this one have made unknown."""
        while self._left and self._left[-1].line < line:
            left, words = self._left.pop(), self._words
            forgotten = np.isin(np.arange(len(words)), left.axes)
            self._pass(np.full(len(words), np.nan), forgotten)
            if left.moved:
                self._words = np.where(forgotten, np.nan, words)
                self._assumed = self._assumed and not forgotten[3:].any()

    def _pass(self, commands: np.ndarray, moved: np.ndarray) -> None:
        """Record a passage; both arguments are in word order."""
        ordered, which = np.empty_like(commands), np.empty_like(moved)
        ordered[self._space.order], which[self._space.order] = commands, moved
        self.passages.append(Passage(self._count, ordered, which))

    def _step(self, move: Move, text_of: TextOf) -> PathMotion | None:
        """Return one move as a motion; None if it is not a motion between known positions."""
        self._forget_before(move.line)
        while self._later and self._later[-1][0] <= move.line:
            self._change_space(self._later.pop()[1])
        if move.tcp != self._tcp:
            if self._tcp is not None:
                self._words = self._switched(move.tcp)
            self._tcp = move.tcp
        if move.unknown:
            self._lose(move)
            return None
        words, end = self._words, np.array(move.position)
        if move.machine:
            self._pass(end, np.isfinite(end))
            self._words = np.where(self._named(move), end - self._space.offset, words)
            if move.tcp or self._space.tilt is not None:
                self._words[:3] = np.nan  # the position of the tip then depends on the control
            self.notices.append(Notice(move.line, "machine coordinates: passed through unchanged"))
            return None
        end = np.where(np.isnan(end), words, end)
        if move.vector is not None:
            end[3:] = self._along_vector(move, words[3:])
        if np.isnan(end[3:]).any():
            end[3:] = self._assume(move.line, end[3:])
        start = words.copy()
        start[3:] = np.where(np.isnan(start[3:]), end[3:], start[3:])
        self._words = end
        if np.isnan(end[:3]).any():
            self._unknown_position(move, end, text_of)
            return None
        self._count += 1
        return PathMotion(move, start, end)

    def _lose(self, move: Move) -> None:
        """Pass a block to an unknown place through."""
        self.unknown.append(LostBlock(move.line, move.kind is not Kind.RAPID, move.unknown))
        everywhere = np.full(len(self._words), np.nan)
        known = not self.passages or np.isfinite(self.passages[-1].commands).any() or not self.passages[-1].moved.all()
        if known or self.passages[-1].before != self._count:
            self._pass(everywhere, np.ones(len(everywhere), dtype=bool))
        self._words, self._assumed = everywhere, False

    def _checked(self, motions: MotionColumns, text_of: TextOf) -> MotionColumns:
        """Return motions; raise `InputError` for the first that needs more than `MOST_SAMPLES` samples."""
        long = motions.spacings > MOST_SAMPLES
        for i, move in motions.special.items():
            long[i] |= move.arc is not None and motions[i].chords(CHORD_MM) > MOST_SAMPLES
        if not long.any():
            return motions
        line = int(motions.line[int(np.argmax(long))])
        most_mm, most_deg = (MOST_SAMPLES * one for one in SAMPLE_SPACING)
        raise InputError(
            "the motion is too long",
            expected=f"at most {most_mm:,.0f} mm, {most_deg:,.0f}° or {MOST_SAMPLES:,} chords of an arc: is a decimal point missing?",
            file=self._source,
            line=line + 1,
            value=text_of(line).strip(),
        )

    def _named(self, move: Move) -> np.ndarray:
        """Return (axes,) which words a move has."""
        return np.array([name in move.named for name in self._space.axes.names])

    def _change_space(self, space: WordSpace) -> None:
        """Convert the axis positions to words of another conversion, in which the program goes on."""
        words, tcp, tilt = self._words, bool(self._tcp), space.tilt
        known = np.isfinite(words).all()
        self._words = words + self._space.offset - space.offset
        if known and (tilt is None or tilt.stays):
            mode = np.array([tcp])
            commands = self._space.commands(words[None, :], mode)
            if tilt is not None:
                commands[:, space.order[3:]] = tilt.rotary_deg
            self._words = space.words(commands, mode)[0]
        elif tcp or tilt is not None or self._space.tilt is not None:
            self._words[:3] = np.nan
        if tilt is not None:
            self._words[3:] = space.start
        self._space = space

    def _switched(self, tcp: bool) -> np.ndarray:
        """Return the axis positions in the words of the other mode."""
        if not np.isfinite(self._words).all():
            return np.concatenate([np.full(3, np.nan), self._words[3:]])
        return self._space.switched(self._words[None, :], tcp=tcp)[0]

    def _assume(self, line: int, rotary: np.ndarray) -> np.ndarray:
        """Return rotary words, with the set-up's values for unknown ones; a notice is recorded the first time."""
        space, unknown = self._space, np.isnan(rotary)
        if not self._assumed:
            assumed = {
                name: value
                for name, value, missing in zip(space.axes.rotary, space.start, unknown, strict=True)
                if missing
            }
            at = ", ".join(f"{name} = {value:g}°" for name, value in assumed.items())
            self.notices.append(
                Notice(
                    line, f"the program gives no position of {' and '.join(assumed)} before this line: taken as {at}"
                )
            )
            self._assumed = True
        return np.where(unknown, space.start, rotary)

    def _unknown_position(self, move: Move, end: np.ndarray, text_of: TextOf) -> None:
        """Pass a rapid move to an unknown position through; raise `InputError` for a feed move."""
        space = self._space
        names = ", ".join(name for name, value in zip(space.axes.linear, end, strict=False) if np.isnan(value))
        if move.kind is not Kind.RAPID:
            raise InputError(
                f"feed move before the program has given a position of {names}",
                expected="a position of every linear axis before the first feed move",
                file=self._source,
                line=move.line + 1,
                value=text_of(move.line).strip(),
            )
        self.notices.append(Notice(move.line, f"position of {names} not yet known: rapid passed through unchanged"))
        commands = end + space.offset
        if move.tcp or space.tilt is not None:
            commands[:3] = np.nan
        self._pass(commands, self._named(move))

    def _along_vector(self, move: Move, before: np.ndarray) -> np.ndarray:
        space = self._space
        standing = np.where(np.isnan(before), space.start, before) + space.offset[3:]
        (found,) = space.branches.nearest(space.branches.all(np.array([move.vector])), standing[None])
        if np.isnan(found).any():
            raise InputError(
                f"{space.machine.name} cannot reach this tool vector",
                expected="a tool vector within the ranges of its rotary axes",
                file=self._source,
                line=move.line + 1,
                value=move.vector,
            )
        return np.asarray(found - space.offset[3:])
