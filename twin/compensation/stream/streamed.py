"""Compensate a program of any length part by part, from file to file, in bounded memory.

Each part is read, solved, written, read back, compared with the intended positions and added to the report, like a whole program
(`twin.compensation.compensator`), with all modal state carried on. A part needs from the one before it only the end of its last motion,
where its first block begins. Text is read and written in stretches, several per part.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from contextvars import copy_context
from itertools import chain, pairwise
from pathlib import Path
from time import monotonic
from typing import BinaryIO, Final, final

import numpy as np

from twin._common.progress import Progress
from twin.compensation.account import CompensationAccount, Report
from twin.compensation.prepared import PreparedMachine
from twin.compensation.solving import Corrected, EndState, Pieces, correct, new_positions
from twin.compensation.solving.rows import even_cuts
from twin.compensation.stream.parts import PART_LINES, PartReader, ProgramFile, ProgramPart
from twin.compensation.stream.writer import ISO, PartWriter
from twin.compensation.toolpath import SAMPLES_A_PIECE, MotionColumns, ToolPath, increments_hinted, motionless
from twin.compute.native import equal_portions
from twin.nc.columns import NewPositions

POSES: Final = 12 * PART_LINES
"""Poses solved and checked at once before any block is split: six for each short block of the longest part. Longer blocks need more
poses, so fewer of them are solved at once.
"""
AHEAD: Final = 1
"""Parts read ahead while an earlier one is solved."""
BEHIND: Final = 1
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
                    while waiting and (len(waiting) > AHEAD or part is None):
                        first, solved, account = waiting.popleft()
                        new, _ = solved.result()
                        accounted.append(account)
                        if len(accounted) > BEHIND:
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
