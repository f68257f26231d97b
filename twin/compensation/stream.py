"""Programs of any length: compensated part by part, from file to file, in bounded memory.

Each part is read, solved, written, read back, compared with what was meant, and accounted for, as a whole program is
(`twin.compensation.compensator`), with all modal state carried on. What one part needs of the one before it is its last motion: that
is where the first block of the next one begins. Text comes and goes in stretches, several to a part.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import BinaryIO, Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError, OutputError
from twin._common.provenance import program_comments
from twin.compensation.account import Account
from twin.compensation.bench import Aim, Bench, Progress
from twin.compensation.pieces import SAMPLES_A_PIECE, Pieces
from twin.compensation.report import Report
from twin.compensation.rows import Rows, even_cuts, spacings
from twin.compensation.toolpath import Follower, MotionColumns, check_domains, chords
from twin.compensation.toolpath import Path as ToolPath
from twin.nc.blocks import Notice
from twin.nc.columns import MoveColumns
from twin.nc.header import HEAD_LINES
from twin.nc.iso.bulk import NewPositions
from twin.nc.iso.dialect import Iso
from twin.nc.iso.stream import IsoReader, IsoRewriter, Stretch
from twin.nc.text import Style, TextCheck, ending, lines_in, style_in

PRINTED_MM: Final = 2e-4
"""What printing may change of a word (mm, degrees): half a unit of the last decimal, of inch words too."""
STRETCH_BYTES: Final = 1 << 18
"""Read, written and read back at once: little enough that what is made of it stays in cache."""
PART_LINES: Final = 60_000
"""Lines solved at once: the parts of a long program are alike, and none has fewer, so that solving is compiled
(`twin.compute.native`); nor many more, since they take memory."""
POSES: Final = 12 * PART_LINES
"""Solved and checked at once before any block is split: six of each of the short blocks in the longest part. Of longer blocks fewer
are."""
AHEAD: Final = 1
"""Parts that are read while an earlier one is being solved."""


class Read(NamedTuple):
    """A stretch as read: its lines and its moves."""

    stretch: Stretch
    moves: MoveColumns


@final
@dataclass(frozen=True)
class Part:
    """Stretches as read, to be solved together.

    Attributes:
        read: each of them.
        motions: their motions, behind the last one of the part before; of moves counted through all of the part.
        context: how many those of the part before are: 1, or 0 at the first.
    """

    read: Sequence[Read]
    motions: MotionColumns
    context: int

    @property
    def moves(self) -> int:
        """How many moves."""
        return sum(len(one.moves) for one in self.read)


class Cut(NamedTuple):
    """What of a part is solved at once.

    Attributes:
        pieces, rows: solved.
        context: how many of its motions belong to what was before.
        rewritten: how many moves were given new words.
    """

    pieces: Pieces
    rows: Rows
    context: int
    rewritten: int


class Solved(NamedTuple):
    """A part as solved: what replaces its moves, and what the account is made of."""

    new: NewPositions
    cuts: Sequence[Cut]


class _Work(NamedTuple):
    """What is done about a part."""

    part: Part
    solved: Future[Solved]
    account: Future[None]


@final
class Streamed:
    """One ISO program, from file to file.

    Args:
        bench: machine, calibration, options; a calibration without reversals, since the side an axis comes from is not settled
            before its next turn, which may be any number of blocks away.
        source: the program.
        progress: called with a stage and the fraction done.
    """

    def __init__(self, bench: Bench, source: Path, progress: Progress) -> None:
        self._bench = bench
        self._source = source
        self._say = progress
        self._size = self._lines = 0

    def run(self, out: BinaryIO) -> Report | None:
        """Compensate.

        Args:
            out: takes the program.

        Returns:
            The account; None if the program has what only can be done in one piece: a drilling cycle.

        Raises:
            InputError: the program cannot be read, or something in it must not pass uncompensated. Of several such things
                that in the first stretch that has one.
            OutputError: what was written does not say what was meant.
        """
        self._check()
        begins = self._start()
        for turns in (None, True):
            attempt = _Attempt(self._bench, str(self._source), begins, out, turns)
            finished = self._all(attempt)
            if finished is None:
                return None
            if finished:
                break
            out.seek(0)
            out.truncate()
        report = attempt.report()
        if not report.rewritten:
            out.seek(0)
            out.truncate()
            for data in self._data():
                out.write(data)
        self._say("done", 1.0)
        return report

    def _all(self, attempt: _Attempt) -> bool | None:
        """Go through the program once; False if it has to be done again, None if this is not the way.

        Reading and writing, solving, and accounting each go through the parts in order, on threads of their own.
        """
        began = monotonic()
        waiting: deque[_Work] = deque()
        accounted: Future[None] | None = None
        with ThreadPoolExecutor(1) as solving, ThreadPoolExecutor(1) as accounting:

            def finish() -> None:
                nonlocal accounted
                part, solved, account = waiting.popleft()
                new = solved.result().new
                if accounted is not None:
                    accounted.result()  # no more than one behind: what it takes is memory
                accounted = account
                attempt.write(part, new)
                rate = attempt.moves / max(monotonic() - began, 1e-3)
                self._say(f"{attempt.moves:,} blocks, {rate:,.0f}/s", 0.99 * attempt.bytes / self._size)

            try:
                parts = attempt.parts(self._data(), self._lines / max(self._lines // PART_LINES, 1))
                while True:
                    try:
                        part = next(parts, None)
                    except InputError:
                        while waiting:  # theirs come first
                            finish()
                        raise
                    if part is None or attempt.changed or attempt.drills:
                        break
                    solved = solving.submit(attempt.solve, part)
                    waiting.append(_Work(part, solved, accounting.submit(attempt.account, solved)))
                    if len(waiting) > AHEAD:
                        finish()
                if not (attempt.changed or attempt.drills):
                    while waiting:
                        finish()
                    if accounted is not None:
                        accounted.result()
            finally:
                solving.shutdown(cancel_futures=True)
                accounting.shutdown(cancel_futures=True)
        return None if attempt.drills else not attempt.changed

    def _check(self) -> None:
        """Whether it is a program at all, and how long."""
        check = TextCheck(str(self._source))
        for data in self._blocks():
            check.add(data)
            self._size += len(data)
            self._lines += data.count(b"\n") or data.count(b"\r")
        check.finish()

    def _start(self) -> tuple[str, Style]:
        """Its line ending, and the style of its numbers."""
        lines = (line for data in self._data() for line in lines_in(data))
        first = next(lines)
        return ending(first) or "\n", style_in(chain((first,), lines), Style(point=True))

    def _blocks(self) -> Iterator[bytes]:
        try:
            with self._source.open("rb") as stream:
                while data := stream.read(STRETCH_BYTES):
                    yield data
        except OSError as error:
            raise InputError(
                "cannot be read", expected="a readable file", file=self._source, value=error.strerror
            ) from error

    def _data(self) -> Iterator[bytes]:
        """Whole lines."""
        left = b""
        for block in self._blocks():
            data = left + block
            # A return at the very end may be half of a line's ending.
            cut = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
            if cut:
                yield data[:cut]
            left = data[cut:]
        if left:
            yield left


@final
class _Attempt:
    """One way through a program.

    Args:
        bench: machine, calibration, options.
        source: the program's name.
        begins: its line ending, and the style of its numbers.
        out: takes the program.
        turns: whether it moves rotary axes; None: as its first motions say.

    Attributes:
        changed: whether it moves rotary axes only later on, so that all is to be done again.
        drills: whether it has a drilling cycle.
        moves: how many were written.
        bytes: how much was read of what was written.
    """

    def __init__(self, bench: Bench, source: str, begins: tuple[str, Style], out: BinaryIO, turns: bool | None) -> None:
        self._bench = bench
        self._source = source
        self._begins = begins
        self._out = out
        self._aim: Aim | None = None if turns is None else bench.aim(turns=turns)
        self._account: Account | None = None
        axes, tcp = bench.space.axes, bench.options.tcp
        self._axes = axes
        self._reader = IsoReader(source, axes, tcp=tcp)
        self._checker = IsoReader(source, axes, tcp=tcp)
        self._follower = Follower(source, bench.space)
        self._rewriter: IsoRewriter | None = None
        self._held: list[bytes] = []
        self._head: bytes | None = b""
        self._notices: list[Notice] = []
        self._lines = self._written_lines = self.moves = self.bytes = 0
        self._turns = False
        self.changed = self.drills = False

    def parts(self, data: Iterator[bytes], lines: float) -> Iterator[Part]:
        """The program as read, in parts of so many lines.

        Raises:
            InputError: it cannot be read; first comes the part of all that was read before.
        """
        context: list[MotionColumns] = []
        read: list[Read] = []
        motions: list[MotionColumns] = []

        def part() -> Part:
            joined = MotionColumns.joined([*context, *motions], len(self._axes.names))
            found = Part([*read], joined, len(context))
            if len(joined):
                context[:] = [joined.part(len(joined) - 1, len(joined))]
            read.clear()
            motions.clear()
            return found

        full = lines
        try:
            for one in data:
                moves = sum(len(earlier.moves) for earlier in read)
                read.append(self._read(one))
                motions.append(self._followed(read[-1], moves))
                if self._lines >= full:
                    full += lines
                    yield part()
        except InputError:
            yield part()
            raise
        yield part()

    def _read(self, data: bytes) -> Read:
        stretch = Stretch(data, self._lines, self._axes.names)
        self._lines += len(stretch)
        moves = self._reader.read(stretch)
        self._notices += self._reader.notices()
        self.drills = self._reader.drills
        return Read(stretch, moves)

    def _followed(self, read: Read, before: int) -> MotionColumns:
        """The motions of a stretch; ``before``: moves of its part that come first."""
        motions = self._follower.columns(read.moves, self._reader.left(), read.stretch.text_of)
        self._turns = self._turns or read.moves.turns(self._axes.rotary)
        if self._aim is None and len(motions):
            self._aim = self._bench.aim(turns=self._turns)
        self.changed = self._turns and self._aim is not None and not self._aim.turns
        return replace(motions, move=motions.move + before)

    def solve(self, part: Part) -> Solved:
        """What replaces the moves of a part.

        Raises:
            InputError: a position that the calibration does not cover.
        """
        bench, width = self._bench, len(self._axes.names)
        count, first = np.zeros(part.moves, dtype=int), np.zeros(part.moves, dtype=int)
        if len(part.motions) == part.context or self._aim is None:
            return Solved(NewPositions(first, count, np.zeros((0, width)), np.zeros((0, 3))), [])
        cuts: list[Cut] = []
        positions: list[np.ndarray] = []
        begin = part.context
        for end in _ends(part, bench.options.tolerance_mm):
            context = min(begin, 1)
            motions = part.motions.part(begin - context, end)
            pieces = Pieces(bench, ToolPath(motions, ()), self._aim, _ISO, source=self._source, posted=False)
            commands = bench.space.commands(pieces.end[context:], pieces.tcp[context:])
            check_domains(bench.full, self._source, motions.line[context:] + 1, commands)
            rows = pieces.solve(_silent)
            before, own = sum(len(words) for words in positions), motions.move[context:]
            if not pieces.idle:
                starts, count[own] = _new(pieces, rows, context)
                first[own] = starts + before
            cuts.append(Cut(pieces, rows, context, int(np.count_nonzero(count[own]))))
            words = np.array(rows.printed)
            words[np.ix_(pieces.by_vector[rows.motion] | (not pieces.turns), range(3, width))] = np.nan
            positions.append(words)
            begin = end
        vectors = np.concatenate([cut.rows.vectors for cut in cuts])
        return Solved(NewPositions(first, count, np.concatenate(positions), vectors), cuts)

    def account(self, solved: Future[Solved]) -> None:
        """Account for a part."""
        for cut in solved.result().cuts:
            if self._account is None:
                self._account = Account(self._bench, cut.pieces.aim, self._source)
            self._account.add(cut.pieces, cut.rows, rewritten=cut.rewritten, context=cut.context)

    def write(self, part: Part, new: NewPositions) -> None:
        """Write a part, and read back what was written.

        Raises:
            OutputError: it does not say what was meant.
        """
        first = 0
        for read in part.read:
            own = slice(first, first + len(read.moves))
            self._write(read, replace(new, first=new.first[own], count=new.count[own]))
            first = own.stop

    def _write(self, read: Read, new: NewPositions) -> None:
        stretch, moves = read
        if self._rewriter is None and not len(moves):
            self._held.append(stretch.scan.data)  # the first move tells who does the kinematics in front of it
            return
        if self._rewriter is None:
            newline, style = self._begins
            self._rewriter = IsoRewriter(self._source, self._axes, newline, style, tcp=bool(moves.tcp[0]))
            held = b"".join(self._held)
            if held:
                stretch = Stretch(held + stretch.scan.data, 0, self._axes.names)
                self._held = []
        idle = self._aim is not None and self._aim.idle
        data = stretch.scan.data if idle else self._rewriter.write(stretch, moves, new)
        written = Stretch(data, self._written_lines, self._axes.names)
        try:
            again = self._checker.read(written)
        except InputError as error:
            raise unreadable(self._source, error) from error
        self._written_lines += len(written)
        _verify(self._source, moves, new, again)
        self._put(data, last=False)
        self.moves += len(moves)
        self.bytes += len(stretch.scan.data)

    def _put(self, data: bytes, *, last: bool) -> None:
        """Write, the first lines not before all of them are there: then with the comments at the head of the program."""
        if self._head is None:
            self._out.write(data)
            return
        self._head += data
        if last or self._written_lines >= HEAD_LINES:
            comments = program_comments(self._bench.calibration.warnings)
            self._out.write(_ISO.commented(self._head.decode("latin-1"), comments).encode("latin-1"))
            self._head = None

    def report(self) -> Report:
        """The account of all of it.

        Raises:
            InputError: nothing moves.
        """
        if self._account is None:
            raise InputError(
                "no block that moves an axis to a known place", expected="a program with motion", file=self._source
            )
        self._put(b"", last=True)
        notices = [*self._notices, *self._follower.passed]
        return self._account.report(lines=self._lines, moves=self.moves, notices=notices)


def unreadable(source: str, error: InputError) -> OutputError:
    """Return the error for a text made of a program that cannot be read back; its line is the output's, not the program's."""
    return OutputError(f"{source}: line {error.line} of what would be written cannot be read back: {error.what}")


_ISO: Final = Iso()


def _silent(stage: str, fraction: float) -> None:
    """Stages of one stretch are not worth telling."""


def _ends(part: Part, tolerance_mm: float) -> list[int]:
    """Where to cut the motions of a part so that each cut has no more than some `POSES` to check before any block is split."""
    motions = part.motions
    long = spacings(motions.start, motions.end)
    poses = 1.0 + np.maximum(SAMPLES_A_PIECE, np.where(np.isfinite(long), long, 0.0))
    for i, move in motions.special.items():
        if move.arc is not None and np.isfinite(motions.start[i]).all():
            poses[i] *= chords(motions[i], tolerance_mm)
    cuts = [part.context + cut for cut in even_cuts(poses[part.context :], POSES) if cut]
    return [*cuts, len(motions)]


def _new(pieces: Pieces, rows: Rows, context: int) -> tuple[np.ndarray, np.ndarray]:
    """(motions,) of each its first row, and how many it has; none for one that stays as it is. Without the context."""
    count = pieces.count(rows)
    first = np.cumsum(count) - count
    count[rows.motion[rows.untouched]] = 0
    return first[context:], count[context:]


def _verify(source: str, moves: MoveColumns, new: NewPositions, again: MoveColumns) -> None:
    """Compare the output, read back: every position with what was meant."""
    each = np.maximum(new.count, 1)
    of = np.repeat(np.arange(len(moves)), each)
    within = np.arange(len(of)) - np.repeat(np.cumsum(each) - each, each)
    if len(again) != len(of):
        line = int(moves.line[min(len(again), len(of) - 1) if len(of) else 0]) + 1 if len(moves) else 0
        raise OutputError(f"{source}:{line}: {len(again)} moves in the output, {len(of)} meant")
    changed = new.count[of] > 0
    wanted = new.positions[(new.first[of] + within)[changed]]
    got = again.position[changed]
    off = (np.abs(got - wanted) > PRINTED_MM).any(axis=1)
    if np.any(off):
        at = int(np.flatnonzero(off)[0])
        line = int(moves.line[of[changed][at]]) + 1
        raise OutputError(f"{source}:{line}: the output says {got[at]}, not {wanted[at]}")
