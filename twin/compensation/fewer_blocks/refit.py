"""Refit a program or a table of points with fewer blocks within a tolerance.

The tolerance holds between the path that the machine with its errors executes and the path of the input, in both directions. It is
divided between rounding, compensation between block end points, and the path itself. Of the share of the path the curve gets the
smallest part that saves blocks, and the blocks get the rest. The output is read back and executed densely before it is returned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from twin._common.defaults import DEFAULT_TOLERANCE_MM
from twin._common.errors import InputError
from twin._common.progress import Progress, silent
from twin.compensation.compensator import Compensation, Compensator
from twin.compensation.fewer_blocks.account import RefitJob, account
from twin.compensation.fewer_blocks.emit import Shortened, shortened
from twin.compensation.fewer_blocks.points import is_points, points_program
from twin.compensation.fewer_blocks.report import PathReport, ToleranceShares
from twin.compensation.fewer_blocks.run_refitter import RunRefitter
from twin.compensation.fewer_blocks.runs import Run, find_runs
from twin.compensation.prepared import Options, PreparedMachine
from twin.compensation.toolpath import ToolPath, follow, increments_hinted, motionless
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.nc import DIALECTS, dialect_for, read_program
from twin.nc.blocks import Move, Program
from twin.nc.dialect import Dialect


@final
@dataclass(frozen=True)
class Refit:
    """A refitted program.

    Attributes:
        text: the program, to be written as latin-1.
        report: its report.
    """

    text: str
    report: PathReport

    def _repr_html_(self) -> str:
        return self.report._repr_html_()


@final
class Refitter:
    """Refits programs on one machine with one calibration.

    Args:
        machine: the machine.
        calibration: its errors.
        options: as in `twin.compensation.Options`; ``tolerance_mm`` is the whole tolerance.
        compensated: whether the output is compensated; otherwise it is for the machine without errors.

    Raises:
        InputError: the machine cannot run programs.
    """

    def __init__(
        self, machine: Machine, calibration: Calibration, options: Options | None = None, *, compensated: bool = True
    ) -> None:
        chosen = Options(tolerance_mm=DEFAULT_TOLERANCE_MM) if options is None else options
        if not compensated:
            chosen = replace(chosen, setup=replace(chosen.setup, one_tool=False))
        self.prepared = PreparedMachine(machine, calibration if compensated else Calibration.zero(machine), chosen)
        self.compensation_requested = compensated
        self.compensated = compensated and not self.prepared.calibration.empty

    def refit(
        self,
        program: Program,
        dialect: Dialect,
        progress: Progress = silent,
        *,
        into: Dialect | None = None,
        printed: bool = False,
    ) -> Refit:
        """Refit one program.

        Args:
            program: as read.
            dialect: its language.
            progress: called with a stage and the fraction done.
            into: the language to write; another than the program's own only for cutter locations, which are then posted.
            printed: whether every block is written rounded to the least increments, fitted or not; used for points.

        Raises:
            InputError: the program cannot be read, or contains something that must not pass; rounding alone exceeds the tolerance.
            OutputError: the output, read back, differs from the intended positions.
        """
        with increments_hinted(self.prepared.machine, dialect, lambda line: "".join(program.texts[line - 1 : line])):
            return self._refit(program, dialect, progress, into, printed=printed)

    def _refit(
        self, program: Program, dialect: Dialect, progress: Progress, into: Dialect | None, *, printed: bool
    ) -> Refit:
        progress("reading", 0.0)
        space = self.prepared.space
        written_in = dialect if into is None else into
        posted = written_in.name != dialect.name
        increment = self.prepared.printed_increment(dialect, posted=posted)
        refitter = RunRefitter(self.prepared, increment, compensated=self.compensated, posted=posted, printed=printed)
        reading = dialect.moves(program, space.axes, tcp=self.prepared.options.tcp)
        if reading.frames or program.origins:
            raise InputError(
                "tilted planes and subprograms cannot be refitted",
                expected="a program without them",
                file=program.source,
            )
        path = follow(program, reading, space)
        if not path.motions:
            raise motionless(program.source, path.unknown)
        runs = find_runs(program, dialect, path, space)
        fitted = []
        for i, run in enumerate(runs):
            progress("fitting", 0.05 + 0.5 * i / len(runs))
            fitted.append(refitter.refit(run, path))
        progress("writing", 0.55)
        others = _others(path, runs) if printed else ()
        places = [one.end_points for one in fitted]
        short = shortened(program, dialect, reading, places, self.prepared, posted=posted, others=others)
        shares = min((one.shares for one in fitted), key=lambda one: one.path, default=refitter.shares(False))
        result = self._result(short, dialect, shares, progress, into=into) if self.compensated or posted else None
        text = short.program.text if result is None else result.text
        if not posted:
            text = dialect.renumbered(program, text)
        progress("checking", 0.9)
        job = RefitJob(
            program, reading, path, tuple(fitted), shares, short, text, written_in, result, self.compensation_requested
        )
        report = account(refitter, job)
        progress("done", 1.0)
        return Refit(text, report)

    def _result(
        self, short: Shortened, dialect: Dialect, shares: ToleranceShares, progress: Progress, *, into: Dialect | None
    ) -> Compensation:
        """Return the shortened program compensated, posted, or both, as requested."""
        share = shares.compensation if self.compensated else shares.tolerance
        options = replace(self.prepared.options, tolerance_mm=share * 1e-3)
        compensator = Compensator(self.prepared.machine, self.prepared.calibration, options)
        return compensator.compensate(
            short.program,
            dialect,
            lambda stage, fraction: progress(stage, 0.55 + 0.35 * fraction),
            into=into,
            reading=short.reading,
        )


def _others(path: ToolPath, runs: Sequence[Run]) -> list[tuple[int, Move, np.ndarray]]:
    """Return moves outside all runs, with their indices and end points."""
    members = {line for run in runs for line in run.lines}
    moving = zip(path.columns.move.tolist(), path.motions, strict=True)
    return [(i, m.move, m.end) for i, m in moving if m.move.line not in members and not m.move.machine]


def refit(
    program: str | Path,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    options: Options | None = None,
    compensated: bool = True,
    output: str | Path | None = None,
    feed: float | None = None,
    progress: Progress = silent,
) -> Refit:
    """Refit the program of a file (or a sample program of twin), or the points of a table.

    Args:
        program: its path; ``.csv`` is a table of points (`twin.compensation.fewer_blocks.points`).
        machine: the machine it runs on.
        calibration: the machine's errors; the machine file's own if None.
        options: as for `Refitter`.
        compensated: whether the output is compensated.
        output: name of the output, which determines its language; if None that of the program, ISO for points.
        feed: mm/min of a program made of points.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: the input cannot be read, or the output's language does not fit it.
        OutputError: as for `Refitter.refit`.
    """
    errors = Calibration.default(machine) if calibration is None else calibration
    refitter = Refitter(machine, errors, options, compensated=compensated)
    source = Path(program)
    points = is_points(source)
    target = dialect_for(Path(output)) if output is not None else None
    if points:
        target = target or DIALECTS[0]
        read, dialect = points_program(source, refitter.prepared.space.axes, DIALECTS, target, feed)
    else:
        if feed is not None:
            raise InputError(
                "a feed was given for a program",
                expected="a feed for points only; a program has its own",
                value=feed,
                setting="feed",
            )
        read, dialect = read_program(source)
    if target is not None and not dialect.can_post_to(target):
        raise InputError(
            f"the program cannot be converted from {dialect.name} to {target.name}",
            expected=f"a file name ending in {' '.join(dialect.suffixes)}",
            file=output,
            setting="output",
        )
    return refitter.refit(read, dialect, progress, into=target, printed=points)
