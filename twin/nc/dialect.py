"""Interface of a language of NC programs, as used by the rest of the package."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from math import isnan, nan
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.nc.blocks import AxisWords, Interpretation, MoveBuilder, NewPositions, Program, as_columns, encoded
from twin.nc.chunks import CHUNK_LINES, DELETED_LINE, Chunk, ChunkReader, ChunkWriter
from twin.nc.inline import Inliner
from twin.nc.lines import LineCode, line_code
from twin.nc.text import MM_PER_INCH, Style, format_number, read_lines
from twin.nc.writer import OutputState


@final
class FeedUnit(Enum):
    """Unit of a feed word."""

    MINUTE = "mm per minute"
    TURN = "mm per revolution"
    INVERSE = "blocks per minute"


class LineWords(NamedTuple):
    """Feed, speed and dwell in one line; None where it says nothing, NaN for a word whose value is not a number.

    Attributes:
        feed: the number of the feed word, in the units of the program.
        unit: the unit of this and all following feeds.
        inch: whether the program counts in inches from here on.
        metric: whether the feed is in millimetres even if the program counts in inches.
        speed_rpm: the number of the speed word.
        turning: whether the spindle is switched on or off.
        off_after: whether it is switched off at the end of the line.
        dwell_s: time for which the line waits.
        varying: a word after which the speed follows the cutting speed, or None.
    """

    feed: float | None = None
    unit: FeedUnit | None = None
    inch: bool | None = None
    metric: bool = False
    speed_rpm: float | None = None
    turning: bool | None = None
    off_after: bool = False
    dwell_s: float = 0.0
    varying: str | None = None


NOTHING = LineWords()


@final
@dataclass(frozen=True)
class Technology:
    """Feed, speed and dwell of every line, with what earlier lines said carried on.

    Attributes:
        feed: (lines,) mm, degrees or blocks by ``unit``; NaN if unknown.
        speed_rpm: (lines,) spindle speed, 0 while it is switched off, and before the first speed word.
        dwell_s: (lines,) time for which each line waits.
        says_speed: whether any line has a speed word.
    """

    feed: np.ndarray
    unit: np.ndarray
    speed_rpm: np.ndarray
    dwell_s: np.ndarray
    says_speed: bool


class Dialect(ABC):
    """One language of NC programs: conversion between text and the data of `twin.nc.blocks`.

    A new language is a module or package with such a class, and an entry in `twin.nc.DIALECTS`.

    Attributes:
        name: its name in messages and reports.
        suffixes: file name suffixes in small letters, with the dot; several languages may have one.
        evidence: pattern of a line that programs of this language have and those of the others do not (`twin.nc.text.line_pattern`).
        opening: pattern of a line that no program of another language has; it decides where there is evidence of several.
        vector_decimals: decimals of a tool vector (7: 0.1 µrad).
        linear_increment_mm: least increment of the linear words, None for that of the machine's axes.
        cutter_locations: whether its programs are cutter locations, which can be posted to a language with axis words.
        numbers_lines: whether its lines are numbered, so that a line inserted changes all later ones.
        has_increments: whether controls exist that count numbers without a decimal point in least increments.
    """

    name: str
    suffixes: tuple[str, ...]
    evidence: re.Pattern[bytes]
    opening: re.Pattern[bytes] | None = None
    vector_decimals: int = 7
    linear_increment_mm: float | None = None
    cutter_locations: bool = False
    numbers_lines: bool = False
    has_increments: bool = False

    @abstractmethod
    def reader(self, source: str, axes: AxisWords, *, tcp: bool) -> ChunkReader:
        """Return a reader of a program; ``source``: its name, for messages, ``tcp``: whether that control is on at its start."""

    @abstractmethod
    def rewriter(self, source: str, texts: Iterable[str], lines: int, axes: AxisWords, *, tcp: bool) -> ChunkWriter:
        """Return a writer of a program with some moves replaced and every other byte kept.

        Unchanged moves keep their text. A rewritten block gets every axis word whose value differs from the last value in the output
        for that axis, whether or not the original block has that word. ``lines``: about how many there are; ``tcp``: whether tool
        centre point control is on at the first move.
        """

    def poster(self, source: str, axes: AxisWords, into: Dialect) -> ChunkWriter:
        """Return a writer of cutter locations as axis words of another language; raise `ValueError` if they are axis words already."""
        raise ValueError(f"{self.name} programs cannot be written in {into.name}")

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Interpretation:
        """Interpret a program; ``tcp``: whether tool centre point control is on from the start.

        It raises `InputError` with file, line and value, for anything that cannot be understood or must not pass uncompensated.
        """
        reader, found = self.reader(program.source, axes, tcp=tcp), MoveBuilder(axes.names)
        for chunk in self.chunks(program, axes):
            found.extend(reader.read(chunk))
        beside = tuple(reader.lost_positions()), tuple(reader.frames()), tuple(reader.drilled())
        return Interpretation(found.moves(), reader.notices, *beside, reader.control)

    def rewrite(self, program: Program, axes: AxisWords, reading: Interpretation, new: NewPositions) -> str:
        """Return the text with some moves replaced, as by `rewriter`."""
        if not np.any(new.count):
            return program.text
        tcp = bool(as_columns(axes.names, reading.moves).tcp[0])
        writer = self.rewriter(program.source, program.texts, len(program.texts), axes, tcp=tcp)
        return self.written(writer, program, axes, reading, new)

    def written(
        self, writer: ChunkWriter, program: Program, axes: AxisWords, reading: Interpretation, new: NewPositions
    ) -> str:
        """Return a program in memory as a writer writes it."""
        moves, out, at = as_columns(axes.names, reading.moves), list[bytes](), 0
        writer.drill(reading.drilled, lambda line: program.texts[line], moves, new)
        for chunk in self.chunks(program, axes):
            last = int(np.searchsorted(moves.line, chunk.first + len(chunk)))
            out.append(writer.write(chunk, moves.part(at, last), new.part(at, last)))
            at = last
        text = b"".join([*out, writer.end()]).decode("latin-1")
        return writer.finished(text.replace(DELETED_LINE, ""))

    def chunks(self, program: Program, axes: AxisWords) -> Iterator[Chunk]:
        """Yield a program in memory in chunks."""
        code, first = line_code(len(program.texts)), 0
        for data in self.stretches(program):
            chunk = self.chunk(data, first, axes.names, code)
            yield chunk
            first += len(chunk)

    def stretches(self, program: Program) -> Iterator[bytes]:
        """Yield a program in memory in whole statements, with `DELETED_LINE` in place of empty texts."""
        first, texts = 0, program.texts
        while first < len(texts):
            last = first + CHUNK_LINES
            while last < len(texts) and (self.continues(texts[last - 1]) or self.follows(texts[last])):
                last += 1
            yield encoded(texts, first, last, DELETED_LINE)
            first = last

    def chunk(self, data: bytes, first: int, names: tuple[str, ...], code: LineCode) -> Chunk:
        """Return whole statements as a chunk; arguments as for `Chunk`."""
        return Chunk(data, first, names, code)

    def continues(self, text: str) -> bool:
        """Return whether the statement of a line goes on in the next one, so that both are read together."""
        return False

    def follows(self, text: str) -> bool:
        """Return whether a line may change how the block before it is to be written, so that both are read together."""
        return False

    @abstractmethod
    def with_comments(self, text: str, comments: Sequence[str]) -> str:
        """Return the text, or a first part of it, with comments in its header that are not there yet: ASCII without brackets."""

    @abstractmethod
    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """Return a new program with one straight block per point.

        ``points``: (n, columns) mm and degrees of the axes ``names``; three further columns are a tool vector. ``feed``: mm/min, or
        None for no feed word; ``remark``: a comment, ASCII without brackets; ``title``: for languages in which a program has a name.
        """

    @abstractmethod
    def is_comment(self, text: str) -> bool:
        """Return whether the control ignores a line (blank or comment)."""

    @abstractmethod
    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """Return whether a line has nothing but a position and a feed; ``names``: the axes."""

    @abstractmethod
    def line_words(self, text: str) -> LineWords:
        """Return what a line says about feed, spindle speed and dwell."""

    def technology(self, program: Program) -> Technology:
        """Return feed, spindle speed and dwell of every line.

        A spindle that the program never switches on or off is taken to turn from the first speed word on: the calling program has
        switched it on. It raises `InputError` for a speed that follows the cutting speed, or is not a number.
        """
        lines = [self.line_words(text) for text in program.texts]
        switched = any(line.turning is not None or line.off_after for line in lines)
        turning, speed, feed, unit, scale = not switched, nan, nan, FeedUnit.MINUTE, 1.0
        feeds, units, speeds = [], [], []
        for i, words in enumerate(lines):
            _check(program, i, words)
            scale = scale if words.inch is None else MM_PER_INCH if words.inch else 1.0
            feed = nan if words.unit not in (None, unit) else feed
            unit = words.unit or unit
            if words.feed is not None:
                feed = words.feed * (1.0 if unit is FeedUnit.INVERSE or words.metric else scale)
            speed = speed if words.speed_rpm is None else words.speed_rpm
            turning = turning if words.turning is None else words.turning
            feeds.append(feed)
            units.append(unit)
            speeds.append(0.0 if isnan(speed) or not turning else speed)
            turning = turning and not words.off_after
        return Technology(
            feed=read_only(np.array(feeds)),
            unit=read_only(np.array(units, dtype=object)),
            speed_rpm=read_only(np.array(speeds)),
            dwell_s=read_only(np.array([line.dwell_s for line in lines])),
            says_speed=any(line.speed_rpm is not None for line in lines),
        )

    def read(self, data: bytes, source: str) -> Program:
        """Split bytes into lines; raise `InputError` if they are empty or not text."""
        return read_lines(data, source, self.name)

    def renumbered(self, program: Program, text: str) -> str:
        """Return the text with consecutive block numbers if the program's blocks are numbered consecutively."""
        return text

    def can_post_to(self, other: Dialect) -> bool:
        """Return whether programs can be written in another language."""
        return other.name == self.name or self.cutter_locations

    def inliner(self, program: Program, folders: Sequence[Path]) -> Inliner | None:
        """Return what writes out the subprograms of a program; None if the language has none.

        ``folders``: where they may be, in the order of search; none for only the program itself.
        """
        return None

    def expanded(self, program: Program, folders: Sequence[Path]) -> Program:
        """Return a program with its subprograms, loops and jumps written out as executed; the program itself if it has none.

        It raises `InputError` for a call that cannot be written out, with file and line. ``folders``: as for `inliner`.
        """
        inliner = self.inliner(program, folders)
        return program if inliner is None else inliner.expanded()

    def new_program(self, axes: AxisWords) -> NewProgram:
        """Return a new, empty program in axis words; raise `ValueError` if the language has none (an error of the caller)."""
        raise ValueError(f"{self.name} has no axis words")


def _check(program: Program, line: int, words: LineWords) -> None:
    if words.varying is not None:
        what = f"the spindle speed follows the cutting speed ({words.varying})"
        expected = "a constant speed in every block (G97), or a speed given for the whole program"
    elif (words.speed_rpm is not None and isnan(words.speed_rpm)) or isnan(words.dwell_s):
        what = f"the {'dwell' if isnan(words.dwell_s) else 'spindle speed'} is not a number"
        expected = "a number, or a speed given for the whole program"
    else:
        return
    shown = program.texts[line].strip()
    raise InputError(what, expected=expected, file=program.source, line=line + 1, value=shown)


class NewProgram(ABC):
    """A program in axis words, written from its beginning; ``feed``: that of the following moves, mm/min, 0: none."""

    def __init__(self, axes: AxisWords, style: Style) -> None:
        self.feed = 0.0
        self.out: list[str] = []
        self._names = axes.names
        self._said = OutputState(axes)
        self._style = style
        self._feed_said = -1.0

    def move(self, row: Sequence[float], *, rapid: bool) -> None:
        """Write a move to a position of all axes, mm and degrees; nothing if they are there already."""
        words = [
            word_text(self._names[axis], self._said.number_for(axis, row[axis], False, False, self._style))
            for axis in self._said.axes_to_write(row, 0, False)
        ]
        if words:
            new = not rapid and self.feed > 0 and self.feed != self._feed_said
            self._block(words, rapid, format_number(self.feed, 3, self._style._replace(plus=False)) if new else "")
            self._feed_said = self.feed if new else self._feed_said

    def taken(self) -> bytes:
        """Return what has been written since the last call."""
        text, self.out = "".join(self.out), []
        return text.encode("latin-1")

    @abstractmethod
    def start(self, source: str) -> None:
        """Write the header; ``source`` is the name of the original program."""

    @abstractmethod
    def comment(self, text: str) -> None:
        """Write a comment."""

    @abstractmethod
    def finish(self) -> None:
        """Write the end of the program."""

    @abstractmethod
    def _block(self, words: list[str], rapid: bool, feed: str) -> None:
        """Write a block with axis words; ``feed``: a number, or empty."""


def word_text(name: str, number: str) -> str:
    """Return an axis word: name and number, with ``=`` between if the name has several letters."""
    return f"{name}{'=' if len(name) > 1 else ''}{number}"


def points_words(names: Sequence[str], points: np.ndarray, style: Style) -> list[str]:
    """Return the axis words of each point, mm and degrees with up to nine decimals."""
    return [
        " ".join(word_text(name, format_number(value, 9, style)) for name, value in zip(names, row, strict=True))
        for row in points.tolist()
    ]


def as_comment(text: str, without: str) -> str:
    """Return a text made safe for a comment: one line, without control characters and the characters ``without``."""
    return "".join(" " if c in without or not c.isprintable() else c for c in text).strip()
