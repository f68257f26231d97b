"""Programs processed in chunks: read and written, with the modal state carried from chunk to chunk.

Runs of simple lines are processed together (`twin.nc.lines.scan`), all other lines by the interpreter and the
writer of blocks of the language.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple, Protocol, final

import numpy as np

from twin.nc.blocks import (
    NO_VECTOR,
    AxisWords,
    FrameChange,
    LostPositions,
    MoveBuilder,
    MoveColumns,
    NewPositions,
    Notice,
    fill_forward,
)
from twin.nc.lines import ARRAYS, MOST_DIGITS, LineCode, Scan
from twin.nc.modal import CORRECTION_DEG, Interpreter
from twin.nc.text import MM_PER_INCH
from twin.nc.writer import LARGEST_STEPS, Formatting, Segments, WordWriter

SHORTEST_RUN: Final = 8
"""Smallest number of simple lines processed together; fewer are faster one by one (measured without a compiler)."""
CHUNK_LINES: Final = 4096
"""Lines per chunk of a program in memory, few enough to fit in cache."""
DELETED_LINE: Final = ";\0\n"
"""A comment that occurs in no program, in place of a deleted line, so that the other lines keep their numbers."""

Scanner = Callable[[bytes, tuple[str, ...], LineCode], Scan]
"""Function that finds the simple lines of a language in whole lines of text: bytes, axis names, code for ISO lines."""


@final
class Chunk:
    """A chunk of whole lines of a program, with its simple lines as the scanner of its language finds them; None is that of ISO."""

    def __init__(
        self, data: bytes, first: int, names: tuple[str, ...], code: LineCode = ARRAYS, scanner: Scanner | None = None
    ) -> None:
        self.scan = code.scan(data, names) if scanner is None else scanner(data, names, code)
        self.first = first

    def __len__(self) -> int:
        return len(self.scan.start)

    def text_of(self, line: int) -> str:
        """Return the text of a line, by its index in the program."""
        return self.scan.line(line - self.first)


def runs(bulk: np.ndarray, blank: np.ndarray) -> Iterator[tuple[int, int, bool]]:
    """Yield runs of lines to process together and single lines: first line, the line after the last, whether together.

    ``bulk``: (lines,) whether a line can be processed with its neighbours; ``blank``: whether it is empty or a comment.
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


class Record(Protocol):
    """Record that an interpreter keeps beside its moves, in order."""

    notices: list[Notice]
    late_notices: list[Notice]
    lost_positions: list[LostPositions]
    frames: list[FrameChange]
    drilled: list[range]


class ChunkReader(ABC):
    """Reader of a program, chunk by chunk."""

    def __init__(self, record: Record) -> None:
        self._record = record
        self._taken: Counter[str] = Counter()

    @abstractmethod
    def read(self, chunk: Chunk) -> MoveColumns:
        """Return the moves of the next chunk; raise `InputError` as `twin.nc.dialect.Dialect.moves`."""

    def may_end(self, tail: str) -> bool:
        """Return whether the program may be divided here; ``tail``: the lines after its last move."""
        return True

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices so far."""
        return (*self._record.notices, *self._record.late_notices)

    @property
    def control(self) -> str:
        """The control whose words the program has so far; empty if they are those of several."""
        return str(getattr(self._record, "variant", ""))

    def lost_positions(self) -> list[LostPositions]:
        """Return the unknown axis positions since the last call."""
        return self._new("lost_positions")

    def frames(self) -> list[FrameChange]:
        """Return the changes of the frame since the last call."""
        return self._new("frames")

    def drilled(self) -> list[range]:
        """Return the ranges of lines since the last call that execute a drilling cycle."""
        return self._new("drilled")

    def _new(self, name: str) -> list[Any]:
        new: list[Any] = getattr(self._record, name)[self._taken[name] :]
        self._taken[name] += len(new)
        return new


@final
class BlockReader(ChunkReader):
    """Reader of a program whose lines are blocks, chunk by chunk."""

    def __init__(self, interpreter: Interpreter) -> None:
        super().__init__(interpreter)
        self._interpreter = interpreter
        self._open = ""
        """Path that is left to the control and whose second block is in the next chunk."""

    def read(self, chunk: Chunk) -> MoveColumns:
        """See `ChunkReader.read`."""
        found = MoveBuilder(self._interpreter.names)
        scan, first = chunk.scan, chunk.first
        for begin, end, together in runs(scan.simple, scan.blank):
            at = begin
            while at < end and not (together and self._run(chunk, at, end, found)):
                for move in self._interpreter.moves(first + at, scan.line(at)):
                    found.add(move)
                at += 1
        moves = self._interpreter.checked(found.moves(), chunk.text_of)
        return self._with_whole(moves, chunk.text_of) if self._interpreter.corners or self._open else moves

    def _with_whole(self, moves: MoveColumns, text_of: Callable[[int], str]) -> MoveColumns:
        """Return moves with those beside a path that is left to the control (`Interpreter.shape_corner`) marked as whole."""
        state, special = self._interpreter, dict(moves.special)
        which = {0: self._open} if self._open and len(moves) else {}
        self._open = "" if len(moves) else self._open
        for name, behind, both, line in state.corners:
            at = int(np.searchsorted(moves.line, behind)) - 1
            if at < 0:
                raise state.error(
                    f"{name} without a block before it", "a block that moves before it", text_of(line).strip(), line + 1
                )
            which |= {one: name for one in range(at, min(at + 1 + both, len(moves)))}
            self._open = name if both and at + 1 == len(moves) else self._open
        state.corners.clear()
        for at, name in which.items():
            move, line = moves[at], int(moves.line[at])
            turned = np.abs(np.diff(state.turned_to[at : at + 2], axis=0)) > CORRECTION_DEG
            several = np.count_nonzero(moves.line[max(at - 1, 0) : at + 2] == line) > 1 or line in state.only_divided
            if move.passes or move.tcp or move.vector is not None or turned.any() or several:
                what = f"{name} beside a helix, or a block in which the tool turns, drills or goes to a place that is not known"
                expected = "the path as straight and circular blocks"
                raise state.error(what, expected, text_of(line).strip(), line + 1)
            special[at] = move._replace(whole=True)
        return replace(moves, special=special)

    def may_end(self, tail: str) -> bool:
        """See `ChunkReader.may_end`."""
        return self._interpreter.may_end(tail)

    def _run(self, chunk: Chunk, begin: int, end: int, found: MoveBuilder) -> bool:
        """Read simple lines together; return False if the modal state does not allow it."""
        state = self._interpreter
        if not state.runs_allowed:
            return False
        scan = chunk.scan
        lines = begin + np.flatnonzero(scan.simple[begin:end])
        if not lines.size:
            return True
        motion = motions(scan, lines, state.motion)
        if motion is None:
            return False
        words = slice(scan.first[lines[0]], scan.first[lines[-1] + 1])
        axis, value = scan.words.axis[words], scan.words.value[words]
        repeated = state.repeated
        if repeated is not None and not only_places(scan, lines, state.linear - 1):
            return False
        if state.inch:
            value = np.where(axis < state.linear, value * MM_PER_INCH, value)
        shape = len(lines), len(state.names)
        each = np.diff(scan.first)[lines]
        if np.all(each == shape[1]) and np.all(axis.reshape(shape) == np.arange(shape[1])):
            position = value.reshape(shape)  # every line has all axes in order
        else:
            position = np.full(shape, np.nan)
            position[np.repeat(np.arange(len(lines)), each), axis] = value
        said = ~np.isnan(position)
        if not state.plane_allows(bool(said[:, state.linear :].any())):
            return False  # the interpreter refuses one of these lines
        bits = 1 << np.arange(len(state.names))
        named = np.full(len(said), bits.sum()) if said.all() else said @ bits
        fill_forward(position, said, state.position)
        rapid, of = motion == 0, chunk.first + lines
        if repeated is not None:
            state.drilled.append(range(int(of[0]), int(of[-1]) + 1))
            of, position, named, rapid = _with_repeated(repeated, state.linear - 1, of, position, named, rapid)
        vector, tcp = np.broadcast_to(NO_VECTOR, (len(of), 3)), np.full(len(of), state.tcp)
        found.extend(MoveColumns(state.names, of, rapid, tcp, named, position, vector, {}))
        state.position = position[-1].tolist()
        state.motion = int(motion[-1])
        return True


def only_places(scan: Scan, lines: np.ndarray, drilling: int) -> bool:
    """Return whether simple lines have no motion code and no word of the axis ``drilling``."""
    words = slice(scan.first[lines[0]], scan.first[lines[-1] + 1])
    return not (np.any(scan.code[lines] >= 0) or np.any(scan.words.axis[words] == drilling))


def _with_repeated(
    repeated: tuple[tuple[float, bool], ...],
    drilling: int,
    line: np.ndarray,
    position: np.ndarray,
    named: np.ndarray,
    rapid: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return columns of `MoveColumns` with the moves of a drilling cycle (see `Interpreter`) along one axis behind each."""
    each = 1 + len(repeated)
    line, position, named, rapid = (np.repeat(column, each, axis=0) for column in (line, position, named, rapid))
    for place, (height, fast) in enumerate(repeated, 1):
        position[place::each, drilling], named[place::each], rapid[place::each] = height, 1 << drilling, fast
    return line, position, named, rapid


def replaces_some(lines: Sequence[range], moves: MoveColumns, new: NewPositions) -> bool:
    """Return whether a move of these ranges of lines, or the move before one, is replaced."""
    at = np.searchsorted(moves.line, [(part.start, part.stop) for part in lines])
    return any(bool(new.count[max(first - 1, 0) : last].any()) for first, last in at.tolist())


class SimpleRun(NamedTuple):
    """Simple lines that are written together.

    Attributes:
        whole: the range of the text that contains the lines.
        lines: (n,) indices of the lines.
        motion: (n,) their motion codes.
        segments: (moves,) number of segments of each of their moves.
        per_line: (n,) number of segments of each line.
        targets: (segments, axes) their end positions.
    """

    scan: Scan
    whole: slice
    lines: np.ndarray
    motion: np.ndarray
    segments: np.ndarray
    per_line: np.ndarray
    targets: np.ndarray


class ChunkWriter(ABC):
    """Writer of a program with some of its moves replaced, chunk by chunk."""

    @abstractmethod
    def write(self, chunk: Chunk, moves: MoveColumns, new: NewPositions) -> bytes:
        """Return the next chunk with its moves replaced by the new positions."""

    def drill(  # noqa: B027  # most languages have nothing to prepare
        self, drilled: Sequence[range], text_of: Callable[[int], str], moves: MoveColumns, new: NewPositions
    ) -> None:
        """Prepare for a part whose ranges of lines ``drilled`` execute cycles; ``text_of``: text of a line by 0-based index."""

    def end(self) -> bytes:
        """Return what follows the last chunk."""
        return b""

    def finished(self, text: str) -> str:
        """Return the text of the whole program as written."""
        return text


class ChunkRewriter(ChunkWriter):
    """Writer of a program whose lines are blocks, chunk by chunk."""

    def __init__(
        self, axes: AxisWords, interpreter: Interpreter, writer: WordWriter[Any], code: LineCode = ARRAYS
    ) -> None:
        self._state, self._words, self._code = interpreter, writer, code
        self._grids = writer.grids

    @abstractmethod
    def line(self, line: int, text: str, segments: Mapping[int, Segments]) -> str:
        """Return the output for one line (0-based index); ``segments``: replacements of its moves, by the index of the move in it."""

    @abstractmethod
    def formatting(self, run: SimpleRun) -> Formatting | None:
        """Return the formatting in force; None if the modal state does not allow to write these lines together."""

    @abstractmethod
    def written(self, run: SimpleRun, text: bytes, formatting: Formatting) -> bytes:
        """Take over the state after lines that were written together, with formatting after the last, and return their final text."""

    def write(self, chunk: Chunk, moves: MoveColumns, new: NewPositions) -> bytes:
        """See `ChunkWriter.write`."""
        scan = chunk.scan
        at_line = moves.line - chunk.first
        of_line = np.searchsorted(at_line, np.arange(len(chunk) + 1))
        general = new.count == 0
        general[list(moves.special)] = True
        general |= moves.by_vector
        general[~general] = ~self._exact_in_steps(np.flatnonzero(~general), moves.named, new)
        bulk = scan.simple & (np.diff(of_line) > 0)
        bulk[at_line[general]] = False
        out: list[bytes] = []
        for begin, end, together in runs(bulk, scan.blank):
            at = begin
            while at < end:
                run = self._run(scan, at, end, of_line, moves, new) if together else None
                if run is not None:
                    out.append(run)
                    break
                segments = _segments(range(of_line[at], of_line[at + 1]), moves, new)
                out.append(self.line(chunk.first + at, scan.line(at), segments).encode("latin-1"))
                at += 1
        return b"".join(out)

    def _exact_in_steps(self, which: np.ndarray, named: np.ndarray, new: NewPositions) -> np.ndarray:
        """Return (which,) the moves whose values are exact in steps and that have values of the same axes, among them all named ones.

        The axes are those of most moves: in a tilted plane, say, rotary axes have none.
        """
        positions, count = new.positions[new.rows(which)], new.count[which]
        if not (self._grids.exact and len(positions)):
            return np.zeros(len(which), dtype=bool)
        bits = np.isfinite(positions) @ (1 << np.arange(positions.shape[1]))
        first = np.cumsum(count) - count
        low, high = np.minimum.reduceat(bits, first), np.maximum.reduceat(bits, first)
        patterns, times = np.unique(low, return_counts=True)
        usual = patterns[np.argmax(times)]
        same = (low == usual) & (high == usual) & (named[which] & ~usual == 0)
        largest = float(np.fmax.reduce(np.abs(positions), axis=None, initial=0.0))
        return same & (largest < LARGEST_STEPS * float(self._grids.step.min()))

    def _run(
        self, scan: Scan, begin: int, end: int, of_line: np.ndarray, moves: MoveColumns, new: NewPositions
    ) -> bytes | None:
        """Return simple lines written together; None (and nothing done) if the modal state does not allow it."""
        state, writer = self._state, self._words
        if not state.runs_allowed or state.inch or writer.style.min_decimals > MOST_DIGITS:
            return None
        lines = begin + np.flatnonzero(scan.simple[begin:end])
        motion = motions(scan, lines, state.motion) if lines.size else None
        if motion is None:
            return None
        first = of_line[lines]
        which = np.arange(first[0], of_line[lines[-1] + 1])
        segments = new.count[which]
        run = SimpleRun(
            scan,
            slice(int(scan.start[begin]), int(scan.end[end - 1])),
            lines,
            motion,
            segments,
            np.add.reduceat(segments, first - first[0]),
            new.positions[new.rows(which)],
        )
        formatting = self.formatting(run)
        if formatting is None:
            return None
        text, formatting = self._code.rewritten_lines(
            scan, run.whole, lines, run.per_line, run.targets, writer.said, formatting, self._grids
        )
        writer.style, writer.lower = formatting.style, formatting.lower
        state.motion = int(motion[-1])
        state.position = moves.position[which[-1]].tolist()
        return self.written(run, text, formatting)


def _segments(which: range, moves: MoveColumns, new: NewPositions) -> dict[int, Segments]:
    """Return the replacements of the moves of a line in the form of the writer of blocks."""
    segments = {}
    for place, index in enumerate(which):
        rewrite = new.of_move(index, moves[index])
        if rewrite is not None:
            segments[place] = (rewrite, rewrite.positions.tolist())
    return segments


def motions(scan: Scan, lines: np.ndarray, before: int | None) -> np.ndarray | None:
    """Return (lines,) the motion code in force on each line; None if one is neither G0 nor G1."""
    code = scan.code[lines].astype(np.int64)
    if code[0] < 0:
        if before not in (0, 1):
            return None
        code[0] = before
    said = code >= 0
    return np.asarray(code[np.maximum.accumulate(np.where(said, np.arange(len(code)), 0))])
