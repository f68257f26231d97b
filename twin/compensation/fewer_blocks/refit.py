"""Refit a program or a table of points with fewer blocks within a tolerance, and report it.

The tolerance holds between the path that the machine with its errors executes and the path of the input, in both directions. It is
divided between rounding, compensation between block end points, and the path itself. Of the share of the path the curve gets the
smallest part that saves blocks, and the blocks get the rest. The output is read back and executed densely before it is returned.

Uncertainty budget, after Díaz Pérez et al. (2019), eq. 15: the error at a point of a trajectory is that of the system plus that of the
definition of the trajectory. Their table 2 combines standard uncertainties as ISO/TR 230-9 does: U = k √Σu², k = 2; an error known by
its limits ±a counts as a/√3 (JCGM 100:2008, 4.3.7).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.bundled import DEFAULT_TOLERANCE_MM
from twin._common.errors import InputError
from twin._common.provenance import ILLUSTRATIVE, SourceWarning, warning_texts
from twin._common.records import json_form
from twin._common.resources import Progress, silent
from twin._common.units import count_with_noun
from twin.compensation.fewer_blocks.emit import (
    Executed,
    Shortened,
    execute_words,
    is_points,
    path_distance_mm,
    points_program,
    shortened,
)
from twin.compensation.fewer_blocks.runs import RefittedRun, Run, RunRefitter, ToleranceShares, find_runs
from twin.compensation.programs.compensator import Compensation, Compensator
from twin.compensation.programs.follow import follow, motionless
from twin.compensation.programs.motions import ToolPath, machine_hints
from twin.compensation.programs.prepared import Options, PreparedMachine
from twin.compensation.programs.report import NO_ERRORS, LineNote, Report, grouped
from twin.compensation.programs.uncorrected import of_unknown
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS, dialect_for, dialect_to_write, read_program
from twin.nc.blocks import Interpretation, Move, Program
from twin.nc.dialect import Dialect

SCHEMA = "twin.path/1"
SHOWN = 8
"""Lines of a list that the text prints before it counts the rest; the JSON report has all."""
EXPANSION_FACTOR: Final = 2.0
PARTS: Final = ("fit", "chord", "path", "machine", "total")
"""Steps that use the tolerance."""


@final
@dataclass(frozen=True)
class UncertaintyContribution:
    """One contribution to an uncertainty budget."""

    name: str
    standard_um: float  # standard uncertainty (k = 1), µm; NaN if unknown
    how: str  # origin of the number

    @classmethod
    def within(cls, name: str, limit_um: float, how: str) -> UncertaintyContribution:
        """Return the contribution of an error with a rectangular distribution within ± ``limit_um``."""
        return cls(name, limit_um / sqrt(3.0), f"{how}: ± {limit_um:.3f} µm/√3")


def combined(contributions: Sequence[UncertaintyContribution]) -> float:
    """Return the expanded uncertainty U = k √Σu² in µm; NaN if a contribution is unknown."""
    return EXPANSION_FACTOR * sqrt(sum(contribution.standard_um**2 for contribution in contributions))


@final
@dataclass(frozen=True)
class RunReport:
    """Report of one run."""

    first_line: int  # first_line, last_line: lines of the input
    last_line: int
    blocks: int  # blocks, blocks_out: number of blocks in the input, and after refitting, before compensation
    blocks_out: int
    corners: int  # number of vertices kept as corners, without the end points of the run
    control_points: int  # control points of all its curves; a block left unchanged counts one
    degrees: tuple[str, ...]  # degrees of its curves in order, with ``t`` for a trigonometric one (an arc)
    fit_share_um: float  # tolerance of the curve within the share of the path
    fit_um: float  # largest distance between curve and input at the tool, in both directions
    chord_um: float  # largest distance between blocks and curve
    path_um: float  # largest distance between blocks and input: fit and chord together
    # largest distance between executed path and blocks: compensation between end points and rounding together
    machine_um: float
    total_um: float  # largest distance between executed path and input, in both directions; compared with the tolerance
    why: str  # why it was left unchanged; empty if it was refitted


@final
@dataclass(frozen=True, repr=False)
class PathReport(Result):
    """Report of one refitted program; every field is in the JSON report under its name.

    Attributes:
        warnings: warnings on the origin of the calibration's numbers; none if the program is not compensated.
        shares: division of the tolerance, for the run with the smallest share for its path: one with rotary motion, if any.
        lever_mm: distance from the tool tip at which the tool axis must keep the tolerance.
        angle_deg: resulting tolerance of the rotary words: the tolerance divided by the lever.
        blocks_out: feed blocks of the output in place of the runs, before compensation split any.
        not_met: runs whose executed path exceeds the tolerance.
        contributions: uncertainty budget of the path.
        compensation: report of the compensation; None without one.
        compensation_requested: whether the machine's errors were to be compensated.
    """

    program: str
    machine: str
    calibration: str
    warnings: tuple[SourceWarning, ...]
    shares: ToleranceShares
    lever_mm: float
    angle_deg: float
    runs: tuple[RunReport, ...]
    not_met: tuple[LineNote, ...]
    notes: tuple[LineNote, ...]
    contributions: tuple[UncertaintyContribution, ...]
    compensation: Report | None
    compensation_requested: bool = False

    @property
    def illustrative(self) -> bool:
        """Whether some of the compensated errors are illustrative, not measured."""
        return ILLUSTRATIVE in self.warnings

    @property
    def blocks(self) -> int:
        """Number of blocks of all runs in the input."""
        return sum(run.blocks for run in self.runs)

    @property
    def blocks_out(self) -> int:
        """Number of blocks of all runs after refitting."""
        return sum(run.blocks_out for run in self.runs)

    @property
    def expanded_um(self) -> float:
        """U (k = 2) of a point of the path, µm; NaN if a contribution is unknown."""
        return combined(self.contributions)

    @property
    def complete(self) -> bool:
        """Whether every requirement was met; determines the exit status."""
        compensated = not self.compensation_requested if self.compensation is None else self.compensation.complete
        return compensated and not self.not_met

    @property
    def strictly_complete(self) -> bool:
        """Whether everything was met and corrected, rapids and the orientation included."""
        return self.complete and (self.compensation is None or self.compensation.strictly_complete)

    @property
    def headline(self) -> str | None:
        """Result of the compensation in one line; None if none was requested."""
        if self.compensation is not None:
            return self.compensation.headline
        return NO_ERRORS if self.compensation_requested else None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON report."""
        uncertainty = {
            "coverage_factor": EXPANSION_FACTOR,
            "expanded_um": self.expanded_um,
            "contributions": self.contributions,
        }
        entry = {
            "schema": SCHEMA,
            "complete": self.complete,
            "strictly_complete": self.strictly_complete,
            "headline": self.headline,
            "program": self.program,
            "machine": self.machine,
            "calibration": self.calibration,
            "illustrative": self.illustrative,
            "warnings": self.warnings,
            "shares_um": self.shares,
            "used_um": self.used(),
            "lever_mm": self.lever_mm,
            "angle_deg": self.angle_deg,
            "blocks": self.blocks,
            "blocks_out": self.blocks_out,
            "control_points": sum(run.control_points for run in self.runs),
            "runs": self.runs,
            "not_met": self.not_met,
            "notes": self.notes,
            "uncertainty": uncertainty,
            "compensation": self.compensation,
        }
        return dict(json_form(entry))

    @property
    def brief(self) -> str:
        """Numbers of blocks before and after, and the part of the tolerance used."""
        used = f"{self.used()['total']:.3g} of {self.shares.tolerance:g} µm used"
        blocks = f"{count_with_noun(self.blocks, 'block')}, now {self.blocks_out:,}; {used}"
        return f"{Path(self.program).name} on {self.machine}: {blocks}{'; NOT MET' if self.not_met else ''}"

    def used(self) -> dict[str, float]:
        """Return by step the largest part of the tolerance used, over all runs, µm."""
        return {part: max((getattr(run, f"{part}_um") for run in self.runs), default=0.0) for part in PARTS}

    def to_text(self) -> str:
        """Return the report as text."""
        used, shares, u = self.used(), self.shares, self.expanded_um
        unknown = "unknown (the calibration has no covariance),"
        fitted = [run for run in self.runs if not run.why]
        headline = "" if self.headline is None else f": {self.headline}"
        calibration = ["  not compensated: executed on the machine without errors"]
        if self.compensation is not None:
            calibration = [f"  calibration   {self.calibration}"]
            calibration += [f"                {text}" for text in warning_texts(self.warnings)]
        fit_share = max((run.fit_share_um for run in self.runs), default=0.0)
        added = 0 if self.compensation is None else self.compensation.added
        more = f" (+{added} by splitting and backlash moves in the compensation)" if added else ""
        out = [
            f"{self.program} on {self.machine}{headline}",
            *calibration,
            f"  blocks        {self.blocks} in {count_with_noun(len(self.runs), 'run')}, now {self.blocks_out}{more}",
            f"  curves        {sum(run.control_points for run in fitted)} control points for "
            f"{count_with_noun(sum(run.blocks for run in fitted), 'block')} in {count_with_noun(len(fitted), 'run')}, "
            f"{count_with_noun(sum(run.corners for run in self.runs), 'corner')} kept",
            f"  rotary words  {self.angle_deg:.4f}°: the tolerance at {self.lever_mm:g} mm from the tip",
            "",
            f"  of {shares.tolerance:g} µm                                  share     used",
            f"    curve from input path                     {fit_share:8.3f} {used['fit']:8.3f} µm",
            f"    blocks from curve                                – {used['chord']:8.3f}",
            f"    both together: blocks from input path     {shares.path:8.3f} {used['path']:8.3f}",
            f"    compensation between end points, rounding {shares.compensation + shares.rounding:8.3f} {used['machine']:8.3f}",
            f"    executed path from input path             {shares.tolerance:8.3f} {used['total']:8.3f}",
            "",
            f"  uncertainty at a point of the path: {unknown if u != u else f'U (k = 2) {u:.2f} µm,'} contributions (k = 1)",
            *(
                f"    {contribution.name:<44}{_um(contribution.standard_um)}  {contribution.how}"
                for contribution in self.contributions
            ),
        ]
        unchanged = tuple(
            LineNote(run.first_line, f"{run.blocks} blocks to line {run.last_line}: {run.why}")
            for run in self.runs
            if run.why
        )
        compensation = self.compensation
        lists = (
            ("not met", grouped(self.not_met)),
            ("not corrected", [] if compensation is None else [error.text for error in compensation.not_corrected]),
            ("left unchanged", grouped(unchanged)),
            ("notes", grouped(self.notes)),
        )
        for title, lines in lists:
            if lines:
                out += ["", f"  {title}: {len(lines)}", *(f"    {line}" for line in lines[:SHOWN])]
                if len(lines) > SHOWN:
                    out.append(f"    … and {len(lines) - SHOWN} more (all in the JSON report)")
        return "\n".join(out) + "\n"


def _um(value: float) -> str:
    return "   unknown" if value != value else f"{value:7.3f} µm"


# --- Refit a program or a table of points ---------------------------------------------------------


@final
@dataclass(frozen=True)
class RefitJob:
    """The input of a refit and its results."""

    program: Program  # as read
    reading: Interpretation  # its moves
    path: ToolPath  # its motions
    fitted: tuple[RefittedRun, ...]
    shares: ToleranceShares  # division of the tolerance
    shortened: Shortened  # the program with fewer blocks
    text: str  # the output
    dialect: Dialect  # language of the output
    result: Compensation | None  # the compensation, or the posted program without one; None if there is neither
    compensation_requested: bool  # whether the machine's errors were to be compensated


def account(refitter: RunRefitter, job: RefitJob) -> PathReport:
    """Execute the output on the machine with its errors, and return the report."""
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
    for shortfalls in of_unknown(job.path.unknown):
        if shortfalls.missed.any():
            cutting = shortfalls.lines[shortfalls.missed]
            yield LineNote(int(cutting[0]), f"{count_with_noun(len(cutting), 'cutting block')}: {shortfalls.reason}")


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
    tolerance = refitter.prepared.options.tolerance_mm
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
            machine_um=path_distance_mm(executed, exact.between(first, last), tolerance) * 1e3,
            total_um=path_distance_mm(executed, nominal_path.between(ins[lines[0]], ins[lines[-1]]), tolerance) * 1e3,
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


# --- Refit a program or a table of points with fewer blocks within a tolerance --------------------


@final
@dataclass(frozen=True, repr=False)
class Refit(Result):
    """A refitted program.

    Attributes:
        text: the program, to be written as latin-1.
    """

    text: str
    report: PathReport

    @property
    def brief(self) -> str:
        """That of its report."""
        return self.report.brief


@final
class Refitter:
    """Refits programs on one machine; ``tolerance_mm`` of the options is the whole tolerance. `InputError` if it cannot run programs.

    Unless ``compensated``, the output is for the machine without errors.
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
        """Refit one program; errors as of `Compensator.compensate`, and `InputError` if rounding alone exceeds the tolerance.

        ``into``: the language to write; another than the program's own only for cutter locations, which are then posted. ``printed``:
        whether every block is written rounded to the least increments, fitted or not; used for points.
        """
        with machine_hints(self.prepared.machine, dialect, lambda line: "".join(program.texts[line - 1 : line])):
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
                "tilted planes, shifts, loops and subprograms cannot be refitted",
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
        program: its path; ``.csv`` is a table of points (`twin.compensation.fewer_blocks.emit`).
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

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> angle = np.radians(np.arange(0.0, 90.1, 1.0))
        >>> points = np.column_stack([250 + 50 * np.cos(angle), 225 + 50 * np.sin(angle), np.full_like(angle, -200)])
        >>> np.savetxt("arc.csv", points, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
        >>> refit = twin.refit("arc.csv", machine, options=twin.Options(tolerance_mm=0.05), compensated=False, feed=500)
        >>> refit.report.blocks, refit.report.blocks_out < 20
        (90, True)

    References:
        - L. Díaz Pérez et al.: Trajectory Definition with High Relative Accuracy (HRA) by Parametric Representation of Curves in
          Nano-Positioning Systems, 2019.
    """
    errors = Calibration.given(machine, calibration)
    refitter = Refitter(machine, errors, options, compensated=compensated)
    language = None if options is None else options.language
    folders = () if options is None else options.subprograms
    source = Path(program)
    points = is_points(source)
    if points:
        target = DIALECTS[0] if output is None else dialect_for(Path(output), language=language)
        read, dialect = points_program(source, refitter.prepared.space.axes, DIALECTS, target, feed)
    else:
        if feed is not None:
            raise InputError(
                "a feed was given for a program",
                expected="a feed for points only; a program has its own",
                value=feed,
                setting="feed",
            )
        read, dialect = read_program(source, language, folders)
        target = dialect if output is None else dialect_to_write(Path(output), source, dialect)
    if not dialect.can_post_to(target):
        raise InputError(
            f"the program cannot be converted from {dialect.name} to {target.name}",
            expected=f"a file name ending in {' '.join(dialect.suffixes)}",
            file=output,
            setting="output",
        )
    return refitter.refit(read, dialect, progress, into=target, printed=points)
