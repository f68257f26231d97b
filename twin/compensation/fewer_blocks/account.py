"""Build the report of a refitted program: the output read back, executed densely and compared with the input."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.counts import count_with_noun
from twin.compensation.account import LineNote, Report
from twin.compensation.account.uncorrected import of_unknown
from twin.compensation.compensator import Compensation
from twin.compensation.fewer_blocks.emit import Shortened
from twin.compensation.fewer_blocks.report import PathReport, RunReport, ToleranceShares, UncertaintyContribution
from twin.compensation.fewer_blocks.run_refitter import RefittedRun, RunRefitter
from twin.compensation.fewer_blocks.verify import Executed, execute_words, path_distance_mm
from twin.compensation.toolpath import ToolPath
from twin.nc.blocks import Interpretation, Program
from twin.nc.dialect import Dialect


@final
@dataclass(frozen=True)
class RefitJob:
    """The input of a refit and its results.

    Attributes:
        program: as read.
        reading: its moves.
        path: its motions.
        fitted: its runs.
        shares: division of the tolerance.
        shortened: the program with fewer blocks.
        text: the output.
        dialect: language of the output.
        result: the compensation, or the posted program without one; None if there is neither.
        compensation_requested: whether the machine's errors were to be compensated.
    """

    program: Program
    reading: Interpretation
    path: ToolPath
    fitted: tuple[RefittedRun, ...]
    shares: ToleranceShares
    shortened: Shortened
    text: str
    dialect: Dialect
    result: Compensation | None
    compensation_requested: bool


def account(refitter: RunRefitter, job: RefitJob) -> PathReport:
    """Execute the output on the machine with its errors, and return the report.

    Args:
        refitter: made the fewer blocks; its prepared has the whole tolerance.
        job: the input and the results.
    """
    prepared, errors = refitter.prepared, refitter.prepared.calibration
    tolerance = prepared.options.tolerance_mm
    runs = tuple(_runs(refitter, job))
    notes = [LineNote(notice.line + 1, notice.text) for notice in (*job.reading.notices, *job.path.notices)]
    if not runs:
        notes.insert(0, LineNote(1, "no run of short feed blocks found: nothing was refitted"))
    compensation = job.result.report if job.result is not None and refitter.compensated else None
    return PathReport(
        program=job.program.source,
        machine=prepared.machine.name,
        calibration=str(errors.path or "none"),
        warnings=errors.warnings if refitter.compensated else (),
        shares=job.shares,
        lever_mm=refitter.lever,
        angle_deg=float(np.degrees(tolerance / refitter.lever)),
        runs=runs,
        not_met=tuple(_not_met(job, runs, tolerance)),
        notes=tuple(notes),
        contributions=tuple(_contributions(runs, compensation)),
        compensation=compensation,
        compensation_requested=job.compensation_requested,
    )


def _not_met(job: RefitJob, runs: Sequence[RunReport], tolerance_mm: float) -> Iterator[LineNote]:
    """Yield runs off the input path by more than the tolerance, and blocks that go to unknown places."""
    for run in runs:
        if run.total_um > tolerance_mm * 1e3 * (1.0 + 1e-9):
            text = f"executed path up to {run.total_um:.2f} µm from the input path, to line {run.last_line}"
            yield LineNote(run.first_line, text)
    for found in of_unknown(job.path.unknown):
        if found.missed.any():
            cutting = found.lines[found.missed]
            yield LineNote(int(cutting[0]), f"{count_with_noun(len(cutting), 'cutting block')}: {found.reason}")


def _runs(refitter: RunRefitter, job: RefitJob) -> Iterator[RunReport]:
    """Yield the report of each run, from executing the input, the shortened program and the output."""
    space, nominal = refitter.space, refitter.space.nominal
    members = {line for run in job.fitted for line in run.end_points.run.lines}
    moves, short_moves = job.reading.moves, job.shortened.reading.moves
    in_run = np.array([move.line in members for move in short_moves])
    nominal_path = execute_words(
        job.program, job.reading, space, nominal, np.array([move.line in members for move in moves])
    )
    exact = execute_words(job.shortened.program, job.shortened.reading, space, nominal, in_run)
    counts = np.ones(len(short_moves), dtype=int) if job.result is None else np.maximum(job.result.new.count, 1)
    begins = np.cumsum(counts) - counts
    done = _done(refitter, job, np.repeat(in_run, counts), begins)
    ins = {move.line: i for i, move in enumerate(moves)}
    outs = {move.line: i for i, move in enumerate(short_moves)}
    lever, tolerance = refitter.lever, refitter.prepared.options.tolerance_mm
    for run in job.fitted:
        lines = run.end_points.run.lines
        kept = np.flatnonzero(run.end_points.kept)
        first, last = outs[lines[kept[0]]], outs[lines[kept[-1]]]
        executed = done.between(int(begins[first]), int(begins[last] + counts[last] - 1))
        yield RunReport(
            first_line=lines[0] + 1,
            last_line=lines[-1] + 1,
            blocks=len(lines),
            blocks_out=len(kept),
            corners=run.corners,
            control_points=run.control_points,
            degrees=tuple(f"{'t' if p.basis.kind == 'trigonometric' else ''}{p.degree}" for p in run.pieces),
            fit_share_um=run.tolerance_use.share_mm * 1e3,
            fit_um=run.tolerance_use.fit_mm * 1e3,
            chord_um=run.tolerance_use.chord_mm * 1e3,
            path_um=run.tolerance_use.path_mm * 1e3,
            machine_um=path_distance_mm(executed, exact.between(first, last), lever, tolerance) * 1e3,
            total_um=path_distance_mm(executed, nominal_path.between(ins[lines[0]], ins[lines[-1]]), lever, tolerance)
            * 1e3,
            why=run.why,
        )


def _done(refitter: RunRefitter, job: RefitJob, dense: np.ndarray, begins: np.ndarray) -> Executed:
    """Return the executed output; ``begins``: index of the first output move of each move of the shortened program."""
    read_back = job.dialect.read(job.text.encode("latin-1"), job.program.source)
    tcp = refitter.prepared.options.tcp and not refitter.posted
    reading = job.dialect.moves(read_back, refitter.space.axes, tcp=tcp)
    executed = execute_words(read_back, reading, refitter.space, refitter.prepared.real, dense)
    if job.result is None:
        return executed
    # A move that only takes up backlash has no nominal position.
    moves = job.result.moves
    place = np.arange(len(moves)) - np.searchsorted(moves, moves)
    return executed.without((begins[moves] + place)[job.result.backlash_move])


def _contributions(runs: tuple[RunReport, ...], compensation: Report | None) -> Iterator[UncertaintyContribution]:
    """Yield the uncertainty budget at a point of the path."""
    path = max((run.path_um for run in runs), default=0.0)
    between_ends = max((run.machine_um for run in runs), default=0.0)
    yield UncertaintyContribution.within("path: fit and chords", path, "largest distance from the input")
    yield UncertaintyContribution.within(
        "compensation between end points, rounding", between_ends, "largest distance from the blocks"
    )
    known = None if compensation is None else compensation.uncertainty.point
    if known is not None:
        standard = float(np.linalg.norm(known.standard_rms)) if known.known else float("nan")
        how = "RMS over the program" if known.known else "no covariance in the calibration"
        yield UncertaintyContribution("the machine as calibrated", standard, how)
