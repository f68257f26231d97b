"""What became of a program: what is about to be written, read back and executed densely, beside the input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from twin.compensation.bench import Bench
from twin.compensation.fewer_blocks.budget import Contribution
from twin.compensation.fewer_blocks.emit import Shortened
from twin.compensation.fewer_blocks.fewer import Fitted
from twin.compensation.fewer_blocks.report import PathReport, RunReport, Shares
from twin.compensation.fewer_blocks.verify import apart_mm, execute_words
from twin.compensation.report import LineNote, Report
from twin.compensation.toolpath import Path
from twin.nc.blocks import Program, Reading, Rewrite
from twin.nc.dialect import Dialect


@final
@dataclass(frozen=True)
class Written:
    """What is about to be written.

    Attributes:
        text: the program.
        dialect: its language.
        posted: whether that is another than the input's.
        compensation: the compensation's report, None without one.
        rewrites: the compensation's, by the id of their move in the shortened program.
        taken: line number and place within its block of the moves that only take up a reversal.
    """

    text: str
    dialect: Dialect
    posted: bool
    compensation: Report | None
    rewrites: Mapping[int, Rewrite]
    taken: frozenset[tuple[int, int]]


@final
@dataclass(frozen=True)
class Job:
    """The input and what was made of it.

    Attributes:
        program: as read.
        dialect: its language.
        reading: what it says.
        path: its motions.
        fitted: its runs.
        shares: of the tolerance.
        lever_mm: of rotary words.
        short: the program with fewer blocks.
    """

    program: Program
    dialect: Dialect
    reading: Reading
    path: Path
    fitted: tuple[Fitted, ...]
    shares: Shares
    lever_mm: float
    short: Shortened


def account(bench: Bench, job: Job, written: Written, *, compensated: bool, asked: bool) -> PathReport:
    """Execute what is about to be written on the machine with its errors, and tell.

    Args:
        bench: the machine, set up; its options have the whole tolerance.
        job: the input and what was made of it.
        written: what is about to be written.
        compensated: whether the machine's errors were compensated.
        asked: whether they were to be.
    """
    tolerance = bench.options.tolerance_mm
    members = {line for one in job.fitted for line in one.places.run.lines}
    moves, short_moves = job.reading.moves, job.short.reading.moves
    counts = [len(written.rewrites[id(m)].positions) if id(m) in written.rewrites else 1 for m in short_moves]
    ends = np.cumsum(counts)
    in_run = np.array([move.line in members for move in short_moves])
    tcp = bench.options.tcp
    meant = execute_words(
        job.program, job.dialect, bench.space, bench.space.nominal,
        tcp=tcp, dense=np.array([move.line in members for move in moves]),
    )  # fmt: skip
    exact = execute_words(job.short.program, job.short, bench.space, bench.space.nominal, tcp=tcp, dense=in_run)
    again = written.dialect.read(written.text.encode("latin-1"), job.program.source)
    done = execute_words(
        again, written.dialect, bench.space, bench.full,
        tcp=tcp and not written.posted, dense=np.repeat(in_run, counts),
    )  # fmt: skip
    # While a reversal is taken up the tool is in no place of its own.
    taken = [
        int(ends[i] - counts[i] + place)
        for i, move in enumerate(short_moves)
        for place in range(counts[i])
        if (job.short.program.lines[move.line].number, place) in written.taken
    ]
    done = done.without(np.array(taken, dtype=int))
    ins = {move.line: i for i, move in enumerate(moves)}
    outs = {move.line: i for i, move in enumerate(short_moves)}
    runs = []
    for one in job.fitted:
        lines = one.places.run.lines
        kept = np.flatnonzero(one.places.kept)
        first, last = outs[lines[kept[0]]], outs[lines[kept[-1]]]
        executed = done.between(int(ends[first] - counts[first]), int(ends[last] - 1))
        original = meant.between(ins[lines[0]], ins[lines[-1]])
        blocks = exact.between(first, last)
        runs.append(
            RunReport(
                first_line=job.program.lines[lines[0]].number,
                last_line=job.program.lines[lines[-1]].number,
                blocks=len(lines),
                blocks_out=len(kept),
                corners=one.corners,
                control_points=one.control_points,
                degrees=tuple(f"{'t' if p.basis.kind == 'trigonometric' else ''}{p.degree}" for p in one.pieces),
                fit_share_um=one.figures.share_mm * 1e3,
                fit_um=one.figures.fit_mm * 1e3,
                chord_um=one.figures.chord_mm * 1e3,
                path_um=one.figures.path_mm * 1e3,
                machine_um=apart_mm(executed, blocks, job.lever_mm, tolerance) * 1e3,
                total_um=apart_mm(executed, original, job.lever_mm, tolerance) * 1e3,
                why=one.why,
            )
        )
    notes = [LineNote(job.program.lines[n.line].number, n.text) for n in (*job.reading.notices, *job.path.passed)]
    if not runs:
        notes.insert(0, LineNote(1, "no run of short feed blocks: nothing was refitted"))
    errors = bench.calibration
    return PathReport(
        program=job.program.source,
        machine=bench.machine.name,
        calibration=str(errors.path or "none"),
        warnings=errors.warnings if compensated else (),
        shares=job.shares,
        lever_mm=job.lever_mm,
        angle_deg=float(np.degrees(tolerance / job.lever_mm)),
        runs=tuple(runs),
        not_met=tuple(
            LineNote(run.first_line, f"{run.total_um:.2f} µm from the input's path, to line {run.last_line}")
            for run in runs
            if run.total_um > tolerance * 1e3 * (1.0 + 1e-9)
        ),
        notes=tuple(notes),
        contributions=_contributions(runs, written.compensation),
        compensation=written.compensation,
        compensation_asked=asked,
    )


def _contributions(runs: list[RunReport], compensation: Report | None) -> tuple[Contribution, ...]:
    """What the uncertainty at a place of the path is made of."""
    path = max((run.path_um for run in runs), default=0.0)
    between_ends = max((run.machine_um for run in runs), default=0.0)
    found = [
        Contribution.within("path: fit and chords", path, "largest distance from the input"),
        Contribution.within("compensation between ends, rounding", between_ends, "largest distance from the blocks"),
    ]
    if compensation is None:
        return tuple(found)
    known = compensation.uncertainty.point
    if known is not None:
        standard = float(np.linalg.norm(known.standard_rms)) if known.known else float("nan")
        how = "RMS over the program" if known.known else "no covariance in the calibration"
        found.append(Contribution("the machine as calibrated", standard, how))
    return tuple(found)
