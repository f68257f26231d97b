"""Read a program of any length: stretches of whole lines, several of which form a part that is solved together.

Compensate a program of any length part by part, from file to file, in bounded memory.

Each part is read, solved, written, read back, compared with the intended positions and added to the report, like a whole program
(`twin.compensation.programs.compensator`), with all modal state carried on. A part needs from the one before it only the end of its
last motion, where its first block begins. Text is read and written in stretches, several per part.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from contextvars import copy_context
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise
from pathlib import Path
from time import monotonic
from typing import BinaryIO, Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError, OutputError
from twin._common.files import open_input
from twin._common.resources import Progress
from twin.compensation.programs.account import CompensationAccount
from twin.compensation.programs.correction import Corrected, correct, new_positions
from twin.compensation.programs.follow import Follower, motionless
from twin.compensation.programs.motions import SAMPLES_A_PIECE, LostBlock, MotionColumns, ToolPath, increments_hinted
from twin.compensation.programs.path_errors import EndState
from twin.compensation.programs.pieces import Pieces, even_cuts, repeat_with_index
from twin.compensation.programs.prepared import CorrectionAim, PreparedMachine
from twin.compensation.programs.report import Report
from twin.compute.native import equal_portions
from twin.nc.blocks import MoveColumns, NewPositions, Notice, lines_in
from twin.nc.iso.dialect import Iso, IsoRewriter, iso_reader
from twin.nc.lines.chunks import Chunk
from twin.nc.lines.compiled import line_code
from twin.nc.text import HEAD_LINES, Style, TextCheck, ending, style_in

STRETCH_BYTES: Final = 3 << 17
"""Bytes read, written and read back at once."""
PART_LINES: Final = 24_576
"""Lines solved together: more need fewer calls and more memory. All parts of a long program are about equally long."""


@final
class ProgramFile:
    """File of a program.

    Attributes:
        size: bytes.
        lines: approximate number of lines.
        parts: number of parts in which it is solved.

    Raises:
        InputError: it cannot be read, or is not a program.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check = TextCheck(str(path))
        for data in self._blocks():
            check.add(data)
        check.finish()
        self.size, self.lines = check.size, check.newlines or check.returns
        self.parts = max(self.lines // PART_LINES, 1)

    def begins(self) -> tuple[str, Style]:
        """Return its line ending and the style of its numbers."""
        lines = (line for data in self.stretches() for line in lines_in(data))
        first = next(lines)
        return ending(first) or "\n", style_in(chain((first,), lines), Style(point=True))

    def line(self, number: int) -> str:
        """Return the text of a line by its number."""
        lines = (line for data in self.stretches() for line in lines_in(data))
        return next(islice(lines, number - 1, None))

    def stretches(self) -> Iterator[bytes]:
        """Yield the file in stretches of whole lines."""
        left = b""
        for block in self._blocks():
            data = left + block
            # A carriage return as the last byte may be half of a line ending.
            cut = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
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


class ReadStretch(NamedTuple):
    """A stretch as read: its lines and its moves."""

    stretch: Chunk
    moves: MoveColumns


@final
@dataclass(frozen=True)
class ProgramPart:
    """Stretches as read, to be solved together.

    Attributes:
        read: the stretches.
        motions: their motions; moves are counted through the whole part.
        aim: errors to correct; None until a motion has been read.
    """

    read: Sequence[ReadStretch]
    motions: MotionColumns
    aim: CorrectionAim | None

    @property
    def moves(self) -> int:
        """Number of moves."""
        return sum(len(stretch.moves) for stretch in self.read)


@final
class PartReader:
    """Reads a program part by part.

    Args:
        prepared: machine, calibration and options.
        turns: whether it moves rotary axes; None to decide from its first motions.

    Attributes:
        lines: number of lines read so far.
        turns_later: whether rotary motion appears only later, so that the program must be compensated again from its start.
        drills: whether it has a drilling cycle, or a tilted plane.
        failed: the error that ended reading; None if there is none.
    """

    def __init__(self, prepared: PreparedMachine, source: ProgramFile, turns: bool | None) -> None:
        self._prepared, self._source = prepared, source
        self._aim = None if turns is None else prepared.aim(turns=turns)
        self._reader = iso_reader(str(source.path), prepared.space.axes, tcp=prepared.options.tcp)
        self._code = line_code(source.lines)
        self._follower = Follower(str(source.path), prepared.space)
        self._notices: list[Notice] = []
        self._turns = False
        self.lines = 0
        self.turns_later = self.drills = False
        self.failed: InputError | None = None

    @property
    def notices(self) -> list[Notice]:
        """Notices on the lines read so far."""
        return [*self._notices, *self._follower.notices]

    @property
    def unknown(self) -> list[LostBlock]:
        """Blocks read so far that go to unknown places."""
        return self._follower.unknown

    def parts(self) -> Iterator[ProgramPart]:
        """Yield the program as read; if reading `failed`, everything before."""
        a_part = self._source.lines / self._source.parts
        full, read, motions = a_part, list[ReadStretch](), list[MotionColumns]()
        try:
            for data in self._source.stretches():
                read.append(self._read(data))
                motions.append(self._followed(read[-1], sum(len(stretch.moves) for stretch in read[:-1])))
                if self.drills:
                    break  # such a program is compensated as a whole
                if self.lines >= full:
                    full += a_part
                    yield self._part(read, motions)
                    read, motions = [], []
        except InputError as error:
            self.failed = error
        yield self._part(read, motions)

    def _part(self, read: list[ReadStretch], motions: list[MotionColumns]) -> ProgramPart:
        none = MotionColumns.of({}, len(self._prepared.space.axes.names))
        return ProgramPart(read, MotionColumns.joined(motions or [none]), self._aim)

    def _read(self, data: bytes) -> ReadStretch:
        stretch = Chunk(data, self.lines, self._prepared.space.axes.names, self._code)
        self.lines += len(stretch)
        moves = self._reader.read(stretch)
        self._notices += self._reader.notices()
        self.drills = self._reader.drills or bool(self._reader.frames)
        return ReadStretch(stretch, moves)

    def _followed(self, read: ReadStretch, before: int) -> MotionColumns:
        """Return the motions of a stretch; ``before``: number of earlier moves in its part."""
        motions = self._follower.columns(read.moves, self._reader.lost_positions(), read.stretch.text_of)
        self._turns = self._turns or read.moves.turns(self._prepared.space.axes.rotary)
        if self._aim is None and len(motions):
            self._aim = self._prepared.aim(turns=self._turns)
        self.turns_later = self._turns and self._aim is not None and not self._aim.turns
        return replace(motions, move=motions.move + before)


# --- Check of the output: the written program is read back and compared with the intended positions

PRINTED_MM: Final = 2e-4
"""Largest difference (mm, degrees) that printing can cause: half a unit of the last decimal, also for inch words."""


def check(source: str, lines: np.ndarray, new: NewPositions, got: np.ndarray) -> None:
    """Compare the output with the intended positions.

    Args:
        source: the program's name.
        lines: (moves,) line numbers of the program's moves.
        new: positions that replace them.
        got: (n, axes) end positions of the moves read back from the output.

    Raises:
        OutputError: they differ.
    """
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


# --- Write a program of any length stretch by stretch, and read it back ---------------------------

ISO: Final = Iso()


@final
class PartWriter:
    """Writes a program part by part.

    Args:
        prepared: machine, calibration and options.
        source: the original program.
        out: output stream.

    Attributes:
        moves: number of moves written.
        bytes: bytes of the original program that have been written.
    """

    def __init__(self, prepared: PreparedMachine, source: ProgramFile, out: BinaryIO) -> None:
        self._prepared, self._axes, self._name = prepared, prepared.space.axes, str(source.path)
        self._source_lines = source.lines
        self._code = line_code(source.lines)
        self._begins = source.begins()
        self._out = out
        self._checker = iso_reader(self._name, self._axes, tcp=prepared.options.tcp)
        self._rewriter: IsoRewriter | None = None
        self._pending: list[bytes] = []
        self._head: bytes | None = b""
        self._lines = self.moves = self.bytes = 0

    def write(self, part: ProgramPart, new: NewPositions) -> None:
        """Write a part, and read back what was written.

        Raises:
            OutputError: it differs from the intended positions.
        """
        first = 0
        for read in part.read:
            own = slice(first, first + len(read.moves))
            idle = part.aim is not None and part.aim.idle
            self._write(read, replace(new, first=new.first[own], count=new.count[own]), idle=idle)
            first = own.stop

    def _write(self, read: ReadStretch, new: NewPositions, *, idle: bool) -> None:
        stretch, moves = read
        if self._rewriter is None and not len(moves):
            self._pending.append(
                stretch.scan.data
            )  # the mode of the lines before the first move is that of the first move
            return
        if self._rewriter is None:
            newline, style = self._begins
            self._rewriter = IsoRewriter(
                self._name, self._axes, newline, style, tcp=bool(moves.tcp[0]), code=self._code
            )
            if self._pending:
                stretch = Chunk(b"".join(self._pending) + stretch.scan.data, 0, self._axes.names, self._code)
                self._pending = []
        data = stretch.scan.data if idle else self._rewriter.write(stretch, moves, new)
        # Arcs and splitting may make a short program long.
        written = Chunk(data, self._lines, self._axes.names, line_code(max(self._source_lines, self._lines)))
        try:
            read_back = self._checker.read(written)
        except InputError as error:
            raise unreadable(self._name, error) from error
        self._lines += len(written)
        check(self._name, moves.line + 1, new, read_back.position)
        self._put(data, last=False)
        self.moves += len(moves)
        self.bytes += len(stretch.scan.data)

    def _put(self, data: bytes, *, last: bool) -> None:
        """Write data; the first lines are held until the head is complete and then written with the warning comments."""
        if self._head is None:
            self._out.write(data)
            return
        self._head += data
        if last or self._lines >= HEAD_LINES:
            comments = self._prepared.comments
            self._out.write(ISO.with_comments(self._head.decode("latin-1"), comments).encode("latin-1"))
            self._head = None

    def finish(self) -> None:
        """Write the lines still held."""
        self._put(b"", last=True)


# --- Compensate a program of any length part by part, from file to file, in bounded memory --------

POSES: Final = 12 * PART_LINES
"""Poses solved and checked at once before any block is split: six for each short block of the longest part. Longer blocks need more
poses, so fewer of them are solved at once.
"""
PARTS_AHEAD: Final = 1
"""Parts read ahead while an earlier one is solved."""
PARTS_BEHIND: Final = 1
"""Parts by which the report may lag. Larger parts use the memory of more of them, some 25 MB each, better."""


Solved = tuple[NewPositions, Sequence[Corrected]]
"""A solved part: the positions that replace its moves, and the data for the report."""


@final
class Streamed:
    """Compensation of one ISO program from file to file.

    Args:
        prepared: machine, calibration and options. The calibration must have no backlash, because an approach direction is not known
            before the axis's next reversal, any number of blocks later.
        source: the program.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: the program cannot be read.
    """

    def __init__(self, prepared: PreparedMachine, source: Path, progress: Progress) -> None:
        self._prepared = prepared
        self._source = ProgramFile(source)
        self._progress = progress
        self._account: CompensationAccount | None = None
        self._end: EndState | None = None

    def run(self, out: BinaryIO) -> Report | None:
        """Compensate the program.

        Args:
            out: output stream.

        Returns:
            The report; None if the program has a drilling cycle, which can only be processed in one piece.

        Raises:
            InputError: the program cannot be read, or contains something that must not pass uncompensated. If there are several such
                errors, the one in the first stretch is raised.
            OutputError: the output, read back, differs from the intended positions.
        """
        with increments_hinted(self._prepared.machine, ISO, self._source.line):
            return self._run(out)

    def _run(self, out: BinaryIO) -> Report | None:
        for turns in (None, True):
            _empty(out)
            self._account = self._end = None
            reader = PartReader(self._prepared, self._source, turns)
            writer = PartWriter(self._prepared, self._source, out)
            began = monotonic()
            with closing(self._solved(reader)) as parts:
                for part, new in parts:
                    writer.write(part, new)
                    rate = writer.moves / max(monotonic() - began, 1e-3)
                    self._progress(f"{writer.moves:,} blocks, {rate:,.0f}/s", 0.99 * writer.bytes / self._source.size)
            if reader.failed is not None:
                raise reader.failed
            if reader.drills:
                return None
            if not reader.turns_later:
                break
        if self._account is None:
            raise motionless(str(self._source.path), reader.unknown)
        writer.finish()
        report = self._account.report(
            lines=reader.lines,
            moves=writer.moves,
            notices=reader.notices,
            unknown=reader.unknown,
            text_of=self._source.line,
        )
        if not report.rewritten:
            _empty(out)
            for data in self._source.stretches():
                out.write(data)
        self._progress("done", 1.0)
        return report

    def _solved(self, reader: PartReader) -> Generator[tuple[ProgramPart, NewPositions], None, None]:
        """Yield parts and the positions that replace their moves; ends early if reading does.

        Reading and writing, solving, and reporting run through the parts in order, each on its own thread.
        """
        waiting: deque[tuple[ProgramPart, Future[Solved], Future[None]]] = deque()
        accounted: deque[Future[None]] = deque()
        with ThreadPoolExecutor(1) as solving, ThreadPoolExecutor(1) as accounting:
            try:
                for part in chain(reader.parts(), (None,)):
                    if reader.turns_later or reader.drills:
                        return
                    if part is not None:
                        solved = solving.submit(copy_context().run, self._solve, part)
                        waiting.append((part, solved, accounting.submit(copy_context().run, self._add, solved)))
                    while waiting and (len(waiting) > PARTS_AHEAD or part is None):
                        first, solved, account = waiting.popleft()
                        new, _ = solved.result()
                        accounted.append(account)
                        if len(accounted) > PARTS_BEHIND:
                            accounted.popleft().result()
                        yield first, new
                for account in accounted:
                    account.result()
            finally:
                solving.shutdown(cancel_futures=True)
                accounting.shutdown(cancel_futures=True)

    def _solve(self, part: ProgramPart) -> Solved:
        """Return the positions that replace the moves of a part, and its corrected stretches.

        Raises:
            InputError: a position that the calibration does not cover.
        """
        cuts: list[Corrected] = []
        if len(part.motions) and part.aim is not None:
            ends = _ends(part.motions, self._prepared.options.tolerance_mm)
            for begin, end in pairwise([0, *ends]):
                motions = part.motions.part(begin, end)
                path = ToolPath(motions, motions)
                pieces = Pieces(self._prepared, path, part.aim, ISO, source=str(self._source.path))
                with equal_portions(self._source.parts * len(ends)):
                    cuts.append(correct(pieces, _silent, before=self._end))
                self._end = cuts[-1].end
        return new_positions(cuts, part.moves, len(self._prepared.space.axes.names)), cuts

    def _add(self, solved: Future[Solved]) -> None:
        """Add a part to the report."""
        cuts = solved.result()[1]
        with equal_portions(self._source.parts * len(cuts)):
            for cut in cuts:
                if self._account is None:
                    self._account = CompensationAccount(self._prepared, cut.pieces.aim, str(self._source.path))
                self._account.add(cut)


def _empty(out: BinaryIO) -> None:
    out.seek(0)
    out.truncate()


def _silent(stage: str, fraction: float) -> None:
    """Ignore the progress of a single stretch."""


def _ends(motions: MotionColumns, tolerance_mm: float) -> list[int]:
    """Return where to cut motions so that each cut has at most about `POSES` poses before any block is split, and their number."""
    long = motions.spacings
    poses = 1.0 + np.maximum(SAMPLES_A_PIECE, np.where(np.isfinite(long), long, 0.0))
    for i, move in motions.special.items():
        if move.arc is not None and np.isfinite(motions.start[i]).all():
            poses[i] *= motions[i].chords(tolerance_mm)
    return [*(cut for cut in even_cuts(poses, POSES) if cut), len(motions)]
