"""Programs of any length: compensated stretch by stretch, from file to file, in bounded memory.

Each stretch is read, solved, written, read back, compared with what was meant, and accounted for, as a whole program is
(`twin.compensation.compensator`), with all modal state carried on. What one stretch needs of the one before it is its last motion: that
is where the first block of the next one begins.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import BinaryIO, Final, final

import numpy as np

from twin.compensation.account import Account
from twin.compensation.bench import Aim, Bench, Progress
from twin.compensation.pieces import SAMPLE_SPACING, SAMPLES_A_PIECE, Pieces, Rows, even_cuts
from twin.compensation.report import Report
from twin.errors import InputError, OutputError
from twin.nc.blocks import Notice
from twin.nc.bulk import NewPositions
from twin.nc.columns import MoveColumns
from twin.nc.iso import Iso
from twin.nc.iso_stream import IsoReader, IsoRewriter, Stretch
from twin.nc.text import Style, TextCheck, ending, lines_in, style_in
from twin.toolpath import Follower, MotionColumns, check_domains, chords
from twin.toolpath import Path as ToolPath

PRINTED_MM: Final = 2e-4
"""What printing may change of a word (mm, degrees): half a unit of the last decimal, of inch words too."""
STRETCH_BYTES: Final = 5 << 19
"""Read at once: more than 50,000 short blocks, from which solving is compiled (`twin.native`), and not much more: they take memory."""
POSES: Final = 420_000
"""Solved and checked at once before any block is split; of longer blocks fewer are."""
AHEAD: Final = 1
"""Stretches that are read while an earlier one is being solved."""


@final
@dataclass(frozen=True)
class Part:
    """A stretch as read.

    Attributes:
        stretch: its lines.
        moves: its moves.
        motions: its motions, behind the last one of the stretch before.
        context: how many those of the stretch before are: 1, or 0 at the first.
    """

    stretch: Stretch
    moves: MoveColumns
    motions: MotionColumns
    context: int


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
        self._size = 0

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
        """Go through the program once; False if it has to be done again, None if this is not the way."""
        began = monotonic()
        waiting: deque[tuple[Part, Future[NewPositions]]] = deque()
        with ThreadPoolExecutor(1) as pool:
            try:
                parts = attempt.parts(self._data())
                while True:
                    try:
                        part = next(parts, None)
                    except InputError:
                        for earlier, solved in waiting:  # theirs come first
                            attempt.write(earlier, solved.result())
                        raise
                    if part is None or attempt.changed or attempt.drills:
                        break
                    waiting.append((part, pool.submit(attempt.solve, part)))
                    if len(waiting) > AHEAD:
                        earlier, solved = waiting.popleft()
                        attempt.write(earlier, solved.result())
                        rate = attempt.moves / max(monotonic() - began, 1e-3)
                        self._say(f"{attempt.moves:,} blocks, {rate:,.0f}/s", 0.99 * attempt.bytes / self._size)
                if not (attempt.changed or attempt.drills):
                    for earlier, solved in waiting:
                        attempt.write(earlier, solved.result())
            finally:
                pool.shutdown(cancel_futures=True)
        return None if attempt.drills else not attempt.changed

    def _check(self) -> None:
        """Whether it is a program at all."""
        check = TextCheck(str(self._source))
        for data in self._blocks():
            check.add(data)
            self._size += len(data)
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
        self._notices: list[Notice] = []
        self._lines = self._written_lines = self.moves = self.bytes = 0
        self._turns = False
        self.changed = self.drills = False

    def parts(self, data: Iterator[bytes]) -> Iterator[Part]:
        """The program as read."""
        last: MotionColumns | None = None
        for one in data:
            stretch = Stretch(one, self._lines, self._axes.names)
            self._lines += len(stretch)
            moves = self._reader.read(stretch)
            self._notices += self._reader.notices()
            motions = self._follower.columns(moves, self._reader.left(), stretch.text_of)
            self.drills = self._reader.drills
            self._turns = self._turns or moves.turns(self._axes.rotary)
            if self._aim is None and len(motions):
                self._aim = self._bench.aim(turns=self._turns)
            self.changed = self._turns and self._aim is not None and not self._aim.turns
            context = 0 if last is None else 1
            if len(motions):
                joined = motions if last is None else MotionColumns.joined([last, motions], len(self._axes.names))
                yield Part(stretch, moves, joined, context)
                last = motions.part(len(motions) - 1, len(motions))
            else:
                yield Part(stretch, moves, motions, 0)

    def solve(self, part: Part) -> NewPositions:
        """What replaces the moves of a part; it is accounted for.

        Raises:
            InputError: a position that the calibration does not cover.
        """
        bench, width = self._bench, len(self._axes.names)
        count, first = np.zeros(len(part.moves), dtype=int), np.zeros(len(part.moves), dtype=int)
        if not len(part.motions) or self._aim is None:
            return NewPositions(first, count, np.zeros((0, width)), np.zeros((0, 3)))
        if self._account is None:
            self._account = Account(bench, self._aim, self._source)
        positions: list[np.ndarray] = []
        vectors: list[np.ndarray] = []
        begin = part.context
        for end in _ends(part, bench.options.tolerance_mm):
            context = min(begin, 1)
            motions = part.motions.part(begin - context, end)
            pieces = Pieces(bench, ToolPath(motions, ()), self._aim, _ISO, posted=False)
            commands = bench.space.commands(pieces.end[context:], pieces.tcp[context:])
            check_domains(bench.full, self._source, motions.line[context:] + 1, commands)
            rows = pieces.solve(_silent)
            before = sum(len(words) for words in positions)
            if not pieces.idle:
                own = motions.move[context:]
                starts, count[own] = _new(pieces, rows, context)
                first[own] = starts + before
            self._account.add(
                pieces, rows, rewritten=int(np.count_nonzero(count[motions.move[context:]])), context=context
            )
            words = np.array(rows.printed)
            words[np.ix_(pieces.by_vector[rows.motion] | (not pieces.turns), range(3, width))] = np.nan
            positions.append(words)
            vectors.append(rows.vectors)
            begin = end
        return NewPositions(first, count, np.concatenate(positions), np.concatenate(vectors))

    def write(self, part: Part, new: NewPositions) -> None:
        """Write a part, and read back what was written.

        Raises:
            OutputError: it does not say what was meant.
        """
        if self._rewriter is None and not len(part.moves):
            self._held.append(part.stretch.scan.data)  # the first move tells who does the kinematics in front of it
            return
        stretch = part.stretch
        if self._rewriter is None:
            newline, style = self._begins
            self._rewriter = IsoRewriter(self._source, self._axes, newline, style, tcp=bool(part.moves.tcp[0]))
            held = b"".join(self._held)
            if held:
                stretch = Stretch(held + stretch.scan.data, 0, self._axes.names)
                self._held = []
        idle = self._account is not None and self._account.idle
        data = stretch.scan.data if idle else self._rewriter.write(stretch, part.moves, new)
        written = Stretch(data, self._written_lines, self._axes.names)
        again = self._checker.read(written)
        self._written_lines += len(written)
        _verify(self._source, part.moves, new, again)
        self._out.write(data)
        self.moves += len(part.moves)
        self.bytes += len(stretch.scan.data)

    def report(self) -> Report:
        """The account of all of it.

        Raises:
            InputError: nothing moves.
        """
        if self._account is None:
            raise InputError(
                "no block that moves an axis to a known place", expected="a program with motion", file=self._source
            )
        notices = [*self._notices, *self._follower.passed]
        return self._account.report(lines=self._lines, moves=self.moves, notices=notices)


_ISO: Final = Iso()


def _silent(stage: str, fraction: float) -> None:
    """Stages of one stretch are not worth telling."""


def _ends(part: Part, tolerance_mm: float) -> list[int]:
    """Where to cut the motions of a part so that each cut has no more than some `POSES` to check before any block is split."""
    motions = part.motions
    size = np.abs(motions.end - motions.start)
    size = np.where(np.isfinite(size), size, 0.0)
    spacing = np.maximum(
        size[:, :3].max(axis=1) / SAMPLE_SPACING[0], size[:, 3:].max(axis=1, initial=0.0) / SAMPLE_SPACING[1]
    )
    poses = 1.0 + np.maximum(SAMPLES_A_PIECE, spacing)
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
