"""ISO programs processed in chunks: read, written and read back, with the modal state carried from chunk to chunk.

Runs of simple lines are processed together (`twin.nc.lines.scan`, `twin.nc.lines.bulk`), all other lines by the interpreter and the writer
of blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, final

import numpy as np

from twin.nc.blocks import AxisWords, FrameChange, LostPositions, Move, Notice, Program, Rewrite
from twin.nc.columns import MoveBuilder, MoveColumns
from twin.nc.lines.bulk import LARGEST_STEPS, Formatting, Grids, NewPositions
from twin.nc.lines.compiled import ARRAYS, LineCode, line_code
from twin.nc.iso.interpreter import IsoInterpreter
from twin.nc.lines.scan import MOST_DIGITS, Scan
from twin.nc.iso.writer import IsoWriter
from twin.nc.text import BLANK, MM_PER_INCH, Style
from twin.nc.writer import Segments

SHORTEST_RUN: Final = 12
"""Smallest number of simple lines processed together; fewer are faster one by one."""
CHUNK_LINES: Final = 4096
"""Lines per chunk of a program in memory, few enough to fit in cache."""
DELETED_LINE: Final = ";\0\n"
"""A comment that occurs in no program, in place of a deleted line, so that the other lines keep their numbers."""


@final
class Chunk:
    """A chunk of whole lines of a program.

    Args:
        data: their bytes.
        first: 0-based index of the first line in the program.
        names: axis names.
        code: how simple lines are read.

    Attributes:
        scan: its simple lines.
        first: as given.
    """

    def __init__(self, data: bytes, first: int, names: tuple[str, ...], code: LineCode = ARRAYS) -> None:
        self.scan = code.scan(data, names)
        self.first = first

    def __len__(self) -> int:
        return len(self.scan.start)

    def text_of(self, line: int) -> str:
        """Return the text of a line, by its index in the program."""
        return self.scan.line(line - self.first)


def runs(bulk: np.ndarray, blank: np.ndarray) -> Iterator[tuple[int, int, bool]]:
    """Split lines into runs to process together and single lines.

    Args:
        bulk: (lines,) whether the line can be processed together with its neighbours.
        blank: (lines,) whether it is empty or a comment.

    Yields:
        First line, the line after the last, and whether to process them together.
    """
    stops = np.append(np.flatnonzero(~(bulk | blank)), len(bulk)).tolist()
    at = 0
    for stop in stops:
        if stop - at >= SHORTEST_RUN:
            yield at, stop, True
        else:
            yield from ((line, line + 1, False) for line in range(at, stop))
        if stop < len(bulk):
            yield stop, stop + 1, False
        at = stop + 1


def chunks(program: Program, names: tuple[str, ...]) -> Iterator[Chunk]:
    """Yield a program in memory in chunks, with `DELETED_LINE` in place of empty texts."""
    code = line_code(len(program.texts))
    for first in range(0, len(program.texts), CHUNK_LINES):
        text = "".join(one or DELETED_LINE for one in program.texts[first : first + CHUNK_LINES])
        yield Chunk(text.encode("latin-1"), first, names, code)


@final
class IsoReader:
    """Reader of a program, chunk by chunk.

    Args:
        source: file name for messages.
        axes: axis words.
        tcp: whether tool centre point control is on from the start.

    Attributes:
        drills: whether some block so far makes several moves because of a drilling cycle.
    """

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        self._interpreter = IsoInterpreter(source, axes, tcp=tcp)
        self._notices = self._left = 0
        self.drills = False

    def read(self, chunk: Chunk) -> MoveColumns:
        """Return the moves of the next chunk.

        Raises:
            InputError: as `twin.nc.dialect.Dialect.moves`.
        """
        found = MoveBuilder(self._interpreter.names)
        self.read_into(found, chunk)
        return found.moves()

    def read_into(self, found: MoveBuilder, chunk: Chunk) -> None:
        """As `read`, with the moves added to a builder."""
        scan, first = chunk.scan, chunk.first
        for begin, end, together in runs(scan.simple, scan.blank):
            at = begin
            while at < end and not (together and self._run(chunk, at, end, found)):
                self._line(first + at, scan.line(at), found)
                at += 1

    def notices(self) -> list[Notice]:
        """Return the notices since the last call."""
        found = self._interpreter.notices[self._notices :]
        self._notices += len(found)
        return found

    def lost_positions(self) -> list[LostPositions]:
        """Return the unknown axis positions since the last call."""
        found = self._interpreter.lost_positions[self._left :]
        self._left += len(found)
        return found

    @property
    def frames(self) -> tuple[FrameChange, ...]:
        """Changes of the frame so far."""
        return tuple(self._interpreter.frames)

    def _line(self, line: int, text: str, found: MoveBuilder) -> None:
        if text in BLANK:
            return
        block = self._interpreter.step(line, text)
        if block is not None:
            self.drills = self.drills or len(block.moves) > 1
            for one in block.moves:
                found.add(one)

    def _run(self, chunk: Chunk, begin: int, end: int, found: MoveBuilder) -> bool:
        """Read simple lines together; return False if the modal state does not allow it."""
        state = self._interpreter
        if not state.runs_allowed:
            return False
        scan = chunk.scan
        lines = begin + np.flatnonzero(scan.simple[begin:end])
        if not lines.size:
            return True
        motion = _motions(scan, lines, state.motion)
        if motion is None:
            return False
        words = slice(scan.first[lines[0]], scan.first[lines[-1] + 1])
        axis, value = scan.words.axis[words], scan.words.value[words]
        if state.inch:
            value = np.where(axis < state.linear, value * MM_PER_INCH, value)
        position = np.full((len(lines), len(state.names)), np.nan)
        row = np.repeat(np.arange(len(lines)), np.diff(scan.first)[lines])
        position[row, axis] = value
        said = ~np.isnan(position)
        named = said @ (1 << np.arange(len(state.names)))
        fill_forward(position, said, state.position)
        found.extend(chunk.first + lines, motion == 0, state.tcp, named, position)
        state.position = position[-1].tolist()
        state.motion = int(motion[-1])
        return True


@final
class IsoRewriter:
    """Writer of a program, chunk by chunk.

    Args:
        source: file name for messages.
        axes: axis words.
        newline: line ending of the program.
        style: its number format (`twin.nc.text.style_in`).
        tcp: whether tool centre point control is on at the first move.
        expand_cycles: whether drilling cycles are expanded into blocks.
        code: how simple lines are written.
    """

    def __init__(
        self,
        source: str,
        axes: AxisWords,
        newline: str,
        style: Style,
        *,
        tcp: bool,
        expand_cycles: bool = False,
        code: LineCode = ARRAYS,
    ) -> None:
        self._code = code
        self._interpreter = IsoInterpreter(source, axes, tcp=tcp)
        self._writer = IsoWriter(source, axes, newline, style, expand_cycles=expand_cycles)
        self._grids = Grids(axes.names, [axes.increment[name] for name in axes.names])

    def write(
        self,
        chunk: Chunk,
        moves: MoveColumns,
        new: NewPositions,
        segments: Mapping[int, Mapping[int, Segments]] | None = None,
    ) -> bytes:
        """Return the next chunk with its moves replaced.

        Args:
            chunk: the chunk.
            moves: its moves.
            new: their replacements.
            segments: the same by line and by move in the line, if known.
        """
        scan = chunk.scan
        at_line = moves.line - chunk.first
        move_of = np.full(len(chunk), -1)
        move_of[at_line] = np.arange(len(moves))
        general = new.count == 0
        general[list(moves.special)] = True
        bulk = np.zeros(len(chunk), dtype=bool)
        bulk[at_line] = ~general & self._exact_in_steps(
            moves.named[~general], new.positions[new.rows(np.flatnonzero(~general))]
        )
        bulk &= scan.simple
        out: list[bytes] = []
        for begin, end, together in runs(bulk, scan.blank):
            at = begin
            while at < end:
                run = self._run(scan, at, end, move_of, moves, new) if together else None
                if run is not None:
                    out.append(run)
                    break
                line, text = chunk.first + at, scan.line(at)
                mine = _segments(int(move_of[at]), moves, new) if segments is None else segments.get(line)
                block = self._interpreter.step(line, text)
                out.append((text if block is None else self._writer.block(line, block, mine)).encode("latin-1"))
                at += 1
        return b"".join(out)

    def _exact_in_steps(self, named: np.ndarray, positions: np.ndarray) -> bool:
        """Return whether values are exact in steps, and each axis has a value in all rows, or in none and no word either."""
        known = np.isfinite(positions)
        everywhere = known.all(axis=0)
        written = np.bitwise_or.reduce(named, initial=0) >> np.arange(known.shape[1]) & 1 > 0
        if not self._grids.exact or not np.all(everywhere | ~(known.any(axis=0) | written)):
            return False
        return bool(np.abs(positions[:, everywhere]).max(initial=0.0) < LARGEST_STEPS * self._grids.step.min())

    def _run(
        self, scan: Scan, begin: int, end: int, move_of: np.ndarray, moves: MoveColumns, new: NewPositions
    ) -> bytes | None:
        """Return simple lines written together; None (and nothing done) if the modal state does not allow it."""
        state, writer = self._interpreter, self._writer
        if not state.runs_allowed or state.inch or state.feed_mode == "93" or writer.style.min_decimals > MOST_DIGITS:
            return None
        lines = begin + np.flatnonzero(scan.simple[begin:end])
        if not lines.size:
            return None
        motion = _motions(scan, lines, state.motion)
        if motion is None or (scan.code[lines[0]] < 0 and writer.motion != motion[0]):
            return None
        which = move_of[lines]
        formatting = Formatting(writer.style, writer.spaced, writer.lower)
        text, formatting = self._code.rewritten_lines(
            scan,
            slice(int(scan.start[begin]), int(scan.end[end - 1])),
            lines,
            new.count[which],
            new.positions[new.rows(which)],
            writer.said,
            formatting,
            self._grids,
        )
        writer.style, writer.spaced, writer.lower = formatting.style, formatting.spaced, formatting.lower
        coded = lines[scan.code[lines] >= 0]
        if coded.size:
            writer.wide = bool(scan.wide[coded[-1]])
        writer.motion = state.motion = int(motion[-1])
        state.position = moves.position[which[-1]].tolist()
        return text


def _segments(which: int, moves: MoveColumns, new: NewPositions) -> Mapping[int, Segments] | None:
    """Return the replacement of a move in the form of the writer of blocks; None for -1 and for an unchanged move."""
    if which < 0 or not new.count[which]:
        return None
    move: Move = moves[which]
    part = slice(new.first[which], new.first[which] + new.count[which])
    rewrite = Rewrite(move, new.positions[part], None if move.vector is None else new.vectors[part])
    return {0: (rewrite, rewrite.positions.tolist())}


def _motions(scan: Scan, lines: np.ndarray, before: int | None) -> np.ndarray | None:
    """Return (lines,) the motion code in force on each line; None if one is neither G0 nor G1."""
    code = scan.code[lines].astype(np.int64)
    if code[0] < 0:
        if before not in (0, 1):
            return None
        code[0] = before
    said = code >= 0
    return np.asarray(code[np.maximum.accumulate(np.where(said, np.arange(len(code)), 0))])


def fill_forward(values: np.ndarray, said: np.ndarray, before: Sequence[float]) -> None:
    """Fill the gaps in every column of an array with the last value before them; ``before``: the values before its first row."""
    if said.all():
        return
    values[0] = np.where(said[0], values[0], before)
    at = np.where(said, np.arange(len(values))[:, None], 0)
    np.maximum.accumulate(at, axis=0, out=at)
    values[:] = np.take_along_axis(values, at, axis=0)
