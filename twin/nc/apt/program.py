"""APT programs read and written: runs of simple ``GOTO`` statements together, all other statements one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import final

import numpy as np

from twin.nc.apt.lines import locations, scan
from twin.nc.apt.locations import TogetherJob, together_code
from twin.nc.apt.reader import AptReader
from twin.nc.apt.statements import Statement, statement_at
from twin.nc.apt.writer import AptWriter
from twin.nc.blocks import AxisWords, Interpretation, Program
from twin.nc.columns import MoveBuilder, MoveColumns, NewPositions
from twin.nc.lines.chunks import DELETED_LINE, Chunk, chunks, runs
from twin.nc.text import newline_of


@final
@dataclass(frozen=True)
class _Run:
    """Simple statements to be processed together.

    Attributes:
        chunk: the chunk they are in.
        begin, end: the range of lines in it, with comments in between.
        lines: indices of the statements in it.
    """

    chunk: Chunk
    begin: int
    end: int
    lines: np.ndarray


def read(program: Program, axes: AxisWords) -> Interpretation:
    """Return the moves of a program.

    Raises:
        InputError: as `twin.nc.dialect.Dialect.moves`.
    """
    reader, found = AptReader(program.source, axes), MoveBuilder(axes.names)
    for part in _parts(program, lambda chunk: chunk.scan.simple, lambda: reader.rapid or bool(reader.unknown)):
        if isinstance(part, _Run):
            found.extend(reader.run(part.chunk.first + part.lines, locations(part.chunk.scan, part.lines)))
        elif (move := reader.step(part)) is not None:
            found.add(move)
    return Interpretation(found.moves(), tuple(reader.notices))


def rewritten(program: Program, axes: AxisWords, moves: MoveColumns, new: NewPositions) -> str:
    """Return a program with its moves replaced, and every other byte kept.

    Args:
        program: the program.
        axes: axis words.
        moves: its moves.
        new: their replacements.
    """
    reader = AptReader(program.source, axes)
    writer = AptWriter(newline_of(program), together_code(len(program.texts)))
    out: list[str] = []
    for part in _parts(program, lambda chunk: _replaced_together(chunk, moves, new), lambda: False):
        if isinstance(part, _Run):
            lines, scanned = part.lines, part.chunk.scan
            reader.run(part.chunk.first + lines, locations(scanned, lines))
            which = np.searchsorted(moves.line, part.chunk.first + lines)
            rows = new.rows(which)
            whole = slice(int(scanned.start[part.begin]), int(scanned.end[part.end - 1]))
            positions, vectors = new.positions[rows] / reader.unit, new.vectors[rows]
            out.append(writer.together(TogetherJob(scanned, whole, lines, new.count[which], positions, vectors)))
            continue
        moved = reader.step(part) is not None
        index = int(np.searchsorted(moves.line, part.line)) if moved else -1
        rewrite = new.of_move(index, moves[index]) if moved else None
        if rewrite is None:
            out.append(writer.unchanged(part.raw, tilts=moved and len(part.texts) == 6))
        else:
            out.append(writer.location(part, rewrite, rewrite.positions.tolist(), reader.unit))
    return "".join(out).replace(DELETED_LINE, "")


def _parts(
    program: Program, together: Callable[[Chunk], np.ndarray], alone: Callable[[], bool]
) -> Iterator[_Run | Statement]:
    """Yield runs of statements to process together, and single statements, in order.

    Args:
        program: the program.
        together: function that returns (lines,) which lines of a chunk can be processed together.
        alone: function that returns whether the next statement must be processed alone.
    """
    behind = 0
    for chunk in chunks(program, (), scan):
        able = together(chunk)
        for begin, end, long in runs(able, chunk.scan.blank):
            at = max(chunk.first + begin, behind)
            lines = begin + np.flatnonzero(able[begin:end]) if long else np.zeros(0, dtype=int)
            while at < chunk.first + end:
                if lines.size and lines[-1] >= at - chunk.first and not alone():
                    yield _Run(chunk, at - chunk.first, end, lines[lines >= at - chunk.first])
                    at = chunk.first + end
                else:
                    statement, at = statement_at(program.texts, at)
                    yield statement
            behind = at


def _replaced_together(chunk: Chunk, moves: MoveColumns, new: NewPositions) -> np.ndarray:
    """Return (lines,) which statements of a chunk can be replaced together: feed moves in plain numbers, with a tool vector."""
    scanned, words = chunk.scan, chunk.scan.words
    part = slice(*np.searchsorted(moves.line, [chunk.first, chunk.first + len(chunk)]))
    able = np.zeros(len(chunk), dtype=bool)
    able[moves.line[part] - chunk.first] = (new.count[part] > 0) & ~moves.rapid[part]
    rows = new.rows(np.arange(part.start, part.stop))
    if not (np.isfinite(new.positions[rows, :3]).all() and np.isfinite(new.vectors[rows]).all()):
        return np.zeros(len(chunk), dtype=bool)
    able[words.line[(words.axis < 3) & ((words.sign == ord("+")) | (words.whole == 0))]] = False
    return able & scanned.simple
