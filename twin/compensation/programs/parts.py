"""A program compensated part by part: read, solved, written, read back and added to the report, with all modal state carried on.

A program in memory is one part. A file is read in stretches of whole statements, several of which form a part, so that memory does not
grow with its length. It is one part, too, where something needs the whole: backlash (the direction of approach is not known before an
axis's next reversal, any number of blocks later), conditions of every block (its time counts from the beginning), subprograms (their
text is elsewhere). A part never ends within a drilling cycle.

A part needs from the one before it the end of its last motion, where its first block begins.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, nullcontext
from contextvars import copy_context
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise
from pathlib import Path
from time import monotonic
from typing import BinaryIO, Final, NamedTuple, TypeVar, final

import numpy as np

from twin._common.errors import InputError, OutputError
from twin._common.files import open_input
from twin._common.resources import Progress
from twin.compensation.programs.account import CompensationAccount
from twin.compensation.programs.block_conditions import CONSTANT, BlockConditions, block_conditions
from twin.compensation.programs.correction import Corrected, correct, new_positions
from twin.compensation.programs.follow import Follower, Section, SectionMotions, Sections, motionless, motions_of
from twin.compensation.programs.motions import SAMPLES_A_PIECE, LostBlock, MotionColumns, ToolPath, machine_hints
from twin.compensation.programs.path_errors import EndState
from twin.compensation.programs.pieces import Pieces, even_cuts, repeat_with_index
from twin.compensation.programs.prepared import PreparedMachine
from twin.compensation.programs.report import Report
from twin.compensation.programs.uncorrected import frame_uses
from twin.compensation.programs.words import WordSpace
from twin.compute.native.compiler import equal_portions
from twin.nc.blocks import (
    Interpretation,
    Move,
    MoveBuilder,
    MoveColumns,
    NewPositions,
    Notice,
    Program,
    as_columns,
    lines_in,
)
from twin.nc.chunks import DELETED_LINE, Chunk, ChunkWriter
from twin.nc.dialect import Dialect
from twin.nc.inline import Line, errors_in_files
from twin.nc.lines import line_code
from twin.nc.text import HEAD_LINES, TextCheck

STRETCH_BYTES: Final = 3 << 17
"""Bytes read, written and read back at once."""
WRITTEN_OUT: Final = "subprograms, loops and jumps are written out as they are executed: the output needs none of them"
"""Notice on a program that calls subprograms."""
PART_LINES: Final = 24_576
"""Lines solved together: more need fewer calls and more memory. All parts of a long program are about equally long."""


Entry = TypeVar("Entry", Notice, LostBlock)


class ProgramSource(ABC):
    """A program to be read in stretches and solved in ``parts``; ``program``: the program, if it is in memory."""

    name: str
    dialect: Dialect
    lines: int
    parts = 1
    program: Program | None = None

    @abstractmethod
    def stretches(self) -> Iterator[bytes]:
        """Yield the program in stretches of whole statements."""

    def __iter__(self) -> Iterator[str]:
        return (line for data in self.stretches() for line in lines_in(data))

    def text_at(self, line: int) -> str:
        """Return the text of a line by its 0-based index."""
        return next(islice(self, line, None), "")

    def text_of(self, number: int) -> str:
        """Return the text of a line by its number."""
        return self.text_at(number - 1)

    def numbers(self, lines: np.ndarray) -> np.ndarray:
        """Return the numbers of (n,) lines by their 0-based indices."""
        return lines + 1

    def errors(self) -> AbstractContextManager[None]:
        """Return the context in which an error names the file and line that a line is from."""
        return nullcontext()


@final
class ProgramInMemory(ProgramSource):
    """A program in memory: one part."""

    def __init__(self, program: Program, dialect: Dialect) -> None:
        self.name, self.dialect, self.lines = program.source, dialect, len(program.texts)
        self.program: Program = program

    def stretches(self) -> Iterator[bytes]:
        """See `ProgramSource.stretches`; with `DELETED_LINE` in place of empty texts."""
        return self.dialect.stretches(self.program)

    def text_at(self, line: int) -> str:
        """See `ProgramSource.text_at`."""
        return self.program.texts[line] if line < len(self.program.texts) else ""

    def text_of(self, number: int) -> str:
        """See `ProgramSource.text_of`."""
        return self.program.texts[int(np.flatnonzero(self.program.numbers == number)[0])]

    def numbers(self, lines: np.ndarray) -> np.ndarray:
        """See `ProgramSource.numbers`."""
        return self.program.numbers[lines]

    def errors(self) -> AbstractContextManager[None]:
        """See `ProgramSource.errors`."""
        return errors_in_files(self.program)


@final
class ProgramFile(ProgramSource):
    """File of a program; ``calls``: whether it may call subprograms. Raises `InputError`: it cannot be read, or is not a program."""

    def __init__(self, path: Path, dialect: Dialect, subprograms: Sequence[Path] = ()) -> None:
        self.path, self.name, self.dialect = path, str(path), dialect
        check, self.calls = TextCheck(self.name), False
        inliner = dialect.inliner(Program(self.name, dialect.name, ()), (path.parent, *subprograms))
        for data in self.stretches():
            check.add(data)
            text = data.decode("latin-1")
            if inliner is not None and not self.calls and inliner.likely_within(text):
                lines = (Line(line, self.name, 0) for line in lines_in(data) if inliner.likely(line))
                self.calls = any(inliner.calls(line) for line in lines)
        check.finish()
        self.lines = check.newlines or check.returns
        self.parts = max(self.lines // PART_LINES, 1)

    def stretches(self) -> Iterator[bytes]:
        """See `ProgramSource.stretches`."""
        left = b""
        for block in self._blocks():
            data = left + block
            # A carriage return as the last byte may be half of a line ending.
            cut = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
            while cut:
                begin = max(data.rfind(b"\n", 0, cut - 1), data.rfind(b"\r", 0, max(cut - 2, 0))) + 1
                after = data[cut:].splitlines(keepends=True)[:1]
                known = bool(after) and after[0][-1:] in (b"\n", b"\r")
                if not self.dialect.continues(data[begin:cut].decode("latin-1")) and (
                    known and not self.dialect.follows(after[0].decode("latin-1"))
                ):
                    break
                cut = begin
            if cut:
                yield data[:cut]
            left = data[cut:]
        if left:
            yield left

    def _blocks(self) -> Iterator[bytes]:
        try:
            with open_input(self.path) as stream:
                while data := stream.read(STRETCH_BYTES):
                    yield data
        except OSError as error:
            raise InputError(
                "cannot be read", expected="a readable file", file=self.path, value=error.strerror
            ) from error


@final
@dataclass(frozen=True)
class ProgramPart:
    """Stretches as read, to be solved together."""

    chunks: Sequence[Chunk]  # the stretches
    moves: MoveColumns
    drilled: Sequence[range]  # the ranges of lines that execute a drilling cycle
    path: ToolPath  # their motions
    sections: Sequence[Section]  # the sections that begin among them
    turns: bool  # whether the program moves rotary axes, in the parts up to this one or as assumed

    def text_of(self, line: int) -> str:
        """Return the text of a line by its index in the program; empty if it is in a part before."""
        found = next((chunk for chunk in reversed(self.chunks) if chunk.first <= line), None)
        return "" if found is None else found.text_of(line)


_NO_PATH: Final = ToolPath((), MotionColumns.of({}, 1))


@final
class PartReader:
    """Reads a program part by part.

    ``turns``: whether it moves rotary axes; None to decide from its first motions. ``turns_later``: whether rotary motion appears only
    later, so that the program must be compensated again from its start. ``reading``: its moves, if they are known more exactly than
    from its text: one part then. ``failed``: the error that ended reading.
    """

    def __init__(
        self,
        prepared: PreparedMachine,
        source: ProgramSource,
        turns: bool | None = None,
        reading: Interpretation | None = None,
    ) -> None:
        space = prepared.space
        self._source, self._axes, self._assumed, self._given = source, space.axes, turns, reading
        self._reader = source.dialect.reader(source.name, space.axes, tcp=prepared.options.tcp)
        self.follower, self.sections = Follower(source.name, space), Sections(space, source.name)
        self._turns = False
        self.lines = 0
        self.turns_later = False
        self.failed: InputError | None = None
        self.reading = Interpretation(()) if reading is None else reading

    def parts(self) -> Iterator[ProgramPart]:
        """Yield the program as read; if reading `failed`, everything before."""
        a_part = self._source.lines / self._source.parts
        full, chunks = a_part, list[Chunk]()
        code = line_code(self._source.lines)
        found, after = MoveBuilder(self._axes.names), 0
        try:
            for data in self._source.stretches():
                chunk = self._source.dialect.chunk(data, self.lines, self._axes.names, code)
                chunks.append(chunk)
                self.lines += len(chunk)
                if self._given is None:
                    found.extend(moves := self._reader.read(chunk))
                    after = int(moves.line[-1]) + 1 if len(moves) else after
                    if self.lines >= full and self._source.parts > 1 and self._reader.may_end(_tail(chunks, after)):
                        full += a_part
                        yield self._part(chunks, found.moves())
                        if self.failed is not None:
                            return
                        chunks, found = [], MoveBuilder(self._axes.names)
        except InputError as error:
            self.failed = error
        yield self._part(chunks, found.moves() if self._given is None else self._given.moves)

    def _part(self, chunks: Sequence[Chunk], given: Sequence[Move]) -> ProgramPart:
        moves, reader = as_columns(self._axes.names, given), self._reader
        if self._given is None:
            beside = tuple(reader.lost_positions()), tuple(reader.frames()), tuple(reader.drilled())
            self.reading = Interpretation(moves, reader.notices, *beside)
        part = ProgramPart(chunks, moves, self.reading.drilled, _NO_PATH, (), False)
        try:
            sections = self.sections.add(moves, self.reading.frames)
            self.follower.enter(sections)
            columns = self.follower.columns(moves, self.reading.lost_positions, part.text_of)
        except InputError as error:
            self.failed = error
            return part
        if self._source.parts == 1:
            path = self.follower.path(columns, moves)
        else:
            path = ToolPath(columns, columns)
        self._turns = self._turns or moves.turns(self._axes.rotary)
        if self._assumed is None and len(columns):
            self._assumed = self._turns
        self.turns_later = self._turns and self._assumed is False
        return replace(part, path=path, sections=sections, turns=bool(self._assumed))


def _tail(chunks: Sequence[Chunk], after: int) -> str:
    """Return the text of some chunks from a line (its index in the program) on."""
    cuts = [(chunk.scan, max(after - chunk.first, 0)) for chunk in chunks if after < chunk.first + len(chunk)]
    return b"".join(scan.data[int(scan.start[line]) :] for scan, line in cuts).decode("latin-1")


# --- Check of the output: the written program is read back and compared with the intended positions

PRINTED_MM: Final = 2e-4
"""Largest difference (mm, degrees) that printing can cause: half a unit of the last decimal, also for inch words."""


def check(source: str, lines: np.ndarray, new: NewPositions, got: np.ndarray) -> None:
    """Compare (n, axes) positions read back from the output with the intended ones; `OutputError`, with the line, if they differ."""
    one_each = len(got) == len(new.count) == len(new.positions) and bool(np.all(new.count == 1))
    if one_each and np.all(np.abs(got - new.positions) <= PRINTED_MM):  # the usual case
        return
    of, within = repeat_with_index(np.arange(len(lines)), np.maximum(new.count, 1))
    if len(got) != len(of):
        line = int(lines[of[min(len(got), len(of) - 1)]]) if len(of) else 0
        raise OutputError(f"{source}:{line}: {len(got)} moves in the output, {len(of)} expected")
    changed = new.count[of] > 0
    wanted = new.positions[(new.first[of] + within)[changed]]
    got = got[changed]
    off = np.abs(got - wanted) > PRINTED_MM
    if np.any(off):
        at = int(np.flatnonzero(off.any(axis=1))[0])
        raise OutputError(f"{source}:{int(lines[of[changed][at]])}: the output has {got[at]}, expected {wanted[at]}")


def unreadable(source: str, error: InputError) -> OutputError:
    """Return the error for output that cannot be read back; the line number is that of the output, not of the program."""
    return OutputError(f"{source}: line {error.line} of the output cannot be read back: {error.what}")


# --- Write a program part by part, and read it back -----------------------------------------------


@final
class PartWriter:
    """Writes a program part by part."""

    def __init__(self, prepared: PreparedMachine, source: ProgramSource, into: Dialect, out: BinaryIO) -> None:
        self._prepared, self._axes, self._source, self._into = prepared, prepared.space.axes, source, into
        self._posted = into.name != source.dialect.name
        self._out = out
        self._checker = into.reader(source.name, self._axes, tcp=prepared.options.tcp and not self._posted)
        self._writer: ChunkWriter | None = None
        self._pending: list[Chunk] = []
        self._head: bytes | None = b""
        self._lines = self.lines = self.moves = 0

    def write(self, part: ProgramPart, new: NewPositions) -> None:
        """Write a part, and read back what was written. Raises `OutputError`: it differs from the intended positions."""
        self._pending += part.chunks
        self.lines += sum(map(len, part.chunks))
        if self._writer is None and not len(part.moves):
            return  # the mode of the lines before the first move is that of the first move
        if self._writer is None:
            name, lines, tcp = self._source.name, self._source.lines, bool(part.moves.tcp[0])
            self._writer = (
                self._source.dialect.poster(name, self._axes, self._into)
                if self._posted
                else self._source.dialect.rewriter(name, self._source, lines, self._axes, tcp=tcp)
            )
        self._writer.drill(part.drilled, part.text_of, part.moves, new)
        idle = self._prepared.aim(turns=part.turns).idle and not self._posted
        first = 0
        for chunk in self._pending:
            last = int(np.searchsorted(part.moves.line, chunk.first + len(chunk)))
            moves, of_moves = part.moves.part(first, last), new.part(first, last)
            self._write(chunk.scan.data if idle else self._writer.write(chunk, moves, of_moves), moves, of_moves)
            first = last
        self._pending = []
        self.moves += len(part.moves)

    def finish(self) -> None:
        """Write what follows the last part, and the lines still held."""
        if self._writer is not None:
            none = np.zeros(0, dtype=int)
            width = len(self._axes.names)
            nothing = NewPositions(none, none, np.zeros((0, width)), np.zeros((0, 3)))
            self._write(self._writer.end(), MoveColumns.of(self._axes.names, []), nothing)
            self._put(b"", last=True)

    def _write(self, data: bytes, moves: MoveColumns, new: NewPositions) -> None:
        """Check a chunk as written, and write it."""
        data = data.replace(DELETED_LINE.encode(), b"")
        # Arcs and splitting may make a short program long.
        code = line_code(max(self._source.lines, self._lines))
        written = self._into.chunk(data.replace(b"\0", b""), self._lines, self._axes.names, code)
        try:
            read_back = self._checker.read(written)
        except InputError as error:
            raise unreadable(self._source.name, error) from error
        self._lines += len(written)
        check(self._source.name, self._source.numbers(moves.line), new, read_back.position)
        self._put(data, last=False)

    def _put(self, data: bytes, *, last: bool) -> None:
        """Write data; the first lines are held until the head is complete, or all where a comment changes later numbers."""
        if self._head is None:
            self._out.write(data)
            return
        self._head += data
        if last or (self._lines >= HEAD_LINES and not self._into.numbers_lines):
            text = self._head.decode("latin-1")
            text = text if self._writer is None else self._writer.finished(text)
            self._out.write(self._into.with_comments(text, self._prepared.comments).encode("latin-1"))
            self._head = None


# --- Compensate a program part by part ------------------------------------------------------------

POSES: Final = 12 * PART_LINES
"""Poses solved and checked at once before any block is split: six for each short block of the longest part. Longer blocks need more
poses, so fewer of them are solved at once.
"""
PARTS_AHEAD: Final = 1
"""Parts read ahead while an earlier one is solved."""
PARTS_BEHIND: Final = 1
"""Parts by which the report may lag. Larger parts use the memory of more of them, some 25 MB each, better."""


class Solved(NamedTuple):
    """A solved part: the positions that replace its moves, and its corrected stretches, for the report."""

    new: NewPositions
    stretches: Sequence[Corrected]


@final
class ProgramRun:
    """Compensation of one program; ``last``: the last part, as read and as solved; the whole program if it is one part.

    ``reading``: the program's moves, if they are known more exactly than from its text.
    """

    reader: PartReader
    last: tuple[ProgramPart, Solved]

    def __init__(
        self,
        prepared: PreparedMachine,
        source: ProgramSource,
        into: Dialect,
        progress: Progress,
        reading: Interpretation | None = None,
    ) -> None:
        self._prepared, self._source, self._into, self._progress = prepared, source, into, progress
        self._reading = reading
        self._posted = into.name != source.dialect.name

    def write(self, out: BinaryIO) -> Report:
        """Compensate the program; of several errors in its text, the one in the first part is raised."""
        source, machine = self._source, self._prepared.machine
        with source.errors(), machine_hints(machine, source.dialect, lambda line: source.text_at(line - 1)):
            return self._write(out)

    def _write(self, out: BinaryIO) -> Report:
        source = self._source
        for turns in (None, True):
            _empty(out)
            self._account: CompensationAccount | None = None
            self._space = self._prepared.space
            self._end: EndState | None = None
            self._motion: tuple[WordSpace, MotionColumns] | None = None
            self.reader = reader = PartReader(self._prepared, source, turns, self._reading)
            writer = PartWriter(self._prepared, source, self._into, out)
            began = monotonic()
            self._stage("reading", 0.0)
            with closing(self._solved(reader)) as parts:
                for part, solved in parts:
                    if reader.failed is None:
                        writer.write(part, solved.new)
                    self.last = part, solved
                    rate, done = writer.moves / max(monotonic() - began, 1e-3), writer.lines / max(source.lines, 1)
                    self._progress(f"{writer.moves:,} blocks, {rate:,.0f}/s", min(0.99, done))
            if reader.failed is not None:
                raise reader.failed
            if not reader.turns_later:
                break
        unknown = reader.follower.unknown
        if self._account is None:
            raise motionless(source.name, unknown)
        writer.finish()
        report = self._account.report(
            lines=reader.lines,
            moves=writer.moves,
            notices=[self._numbered(notice) for notice in (*reader.reading.notices, *reader.follower.notices)]
            + [Notice(0, WRITTEN_OUT)] * bool(source.program is not None and source.program.origins),
            unknown=[self._numbered(block) for block in unknown],
            frames=frame_uses(reader.sections.found, self._number) if reader.sections.selects else (),
            text_of=source.text_of if source.dialect.has_increments else lambda number: "",
        )
        if not report.rewritten and not self._posted:
            _empty(out)
            for data in source.stretches():
                out.write(data.replace(DELETED_LINE.encode(), b""))
        self._progress("done", 1.0)
        return report

    def _number(self, line: int) -> int:
        """Return the number of a line by its 0-based index."""
        return int(self._source.numbers(np.array([line]))[0])

    def _numbered(self, entry: Entry) -> Entry:
        """Return a notice or block with its line's index by the number of the line."""
        return entry._replace(line=self._number(entry.line) - 1)

    def _solved(self, reader: PartReader) -> Generator[tuple[ProgramPart, Solved], None, None]:
        """Yield parts as read and as solved, until reading ends; writing, solving and reporting each run on their own thread."""
        waiting: deque[tuple[ProgramPart, Future[Solved], Future[None]]] = deque()
        accounted: deque[Future[None]] = deque()
        with ThreadPoolExecutor(1) as solving, ThreadPoolExecutor(1) as accounting:
            try:
                for part in chain(reader.parts(), (None,)):
                    if reader.turns_later:
                        return
                    if part is not None:
                        solved = solving.submit(copy_context().run, self._solve, part)
                        waiting.append((part, solved, accounting.submit(copy_context().run, self._add, solved)))
                    while waiting and (len(waiting) > PARTS_AHEAD or part is None):
                        first, solved, account = waiting.popleft()
                        accounted.append(account)
                        found = solved.result()
                        if len(accounted) > PARTS_BEHIND:
                            accounted.popleft().result()
                        yield first, found
                for account in accounted:
                    account.result()
            finally:
                solving.shutdown(cancel_futures=True)
                accounting.shutdown(cancel_futures=True)

    def _solve(self, part: ProgramPart) -> Solved:
        """Return a solved part. Raises `InputError`: a position that the calibration does not cover."""
        found: list[Corrected] = []
        columns = part.path.columns
        if len(columns):
            sections = motions_of(self._space, part.sections, part.path, self._motion)
            conditions = self._conditions(part, sections)
            for section in sections:
                found += self._solve_section(part, section, conditions)
            self._space = sections[-1].space
            self._motion = self._space, columns.part(len(columns) - 1, len(columns))
        return Solved(new_positions(found, len(part.moves), len(self._prepared.space.axes.names)), found)

    def _conditions(self, part: ProgramPart, sections: Sequence[SectionMotions]) -> BlockConditions:
        """Return the conditions of every motion of a part."""
        if self._source.program is None:
            return CONSTANT
        spaces = [(section.begin, section.space) for section in sections]
        calibration, conditions = self._prepared.calibration, self._prepared.options.conditions
        return block_conditions(self._source.program, self._source.dialect, part.path, spaces, calibration, conditions)

    def _solve_section(
        self, part: ProgramPart, section: SectionMotions, conditions: BlockConditions
    ) -> Iterator[Corrected]:
        """Yield the stretches of a section as corrected, each from the end of the one before on."""
        within, context = self._prepared.within(section.space), section.context
        whole = bool(context or self._prepared.backlash.axes or self._prepared.by_block)
        columns = section.path.columns
        ends = [len(columns)] if whole else _ends(columns, within.options.tolerance_mm)
        portions = self._source.parts * len(ends) * max(len(part.moves) / len(columns), 1.0)
        self._end = None if context else self._end
        for begin, end in pairwise([0, *ends]):
            pieces = Pieces(
                within,
                section.path if len(ends) == 1 else section.path.part(begin, end),
                within.aim(turns=part.turns and (section.space.tilt is None or bool(columns.tcp[context:].all()))),
                self._source.dialect,
                source=self._source.name,
                number_of=self._source.numbers,
                conditions=conditions.part(section.begin - context, section.end),
                posted=self._posted,
            )
            with equal_portions(portions):
                corrected = correct(pieces, self._stage, context=context, before=self._end)
            self._end = corrected.end
            yield corrected

    def _stage(self, stage: str, fraction: float) -> None:
        """Show the progress of a program in one part."""
        if self._source.parts == 1:
            self._progress(stage, fraction)

    def _add(self, solved: Future[Solved]) -> None:
        """Add a part to the report."""
        stretches = solved.result().stretches
        with equal_portions(self._source.parts * len(stretches)):
            for stretch in stretches:
                if self._account is None:
                    self._account = CompensationAccount(self._prepared, self._source.name)
                self._account.add(stretch)


def _empty(out: BinaryIO) -> None:
    out.seek(0)
    out.truncate()


def _ends(motions: MotionColumns, tolerance_mm: float) -> list[int]:
    """Return where to cut motions so that each cut has at most about `POSES` poses before any block is split, and their number."""
    long = motions.spacings
    poses = 1.0 + np.maximum(SAMPLES_A_PIECE, np.where(np.isfinite(long), long, 0.0))
    for i, move in motions.special.items():
        if move.arc is not None and np.isfinite(motions.start[i]).all():
            poses[i] *= motions[i].chords(tolerance_mm)
    return [*(cut for cut in even_cuts(poses, POSES) if cut), len(motions)]
