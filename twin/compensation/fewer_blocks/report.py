"""Report of a refitted program: its runs, the use of the tolerance, and the uncertainty budget of the path.

Díaz Pérez et al. (2019), eq. 15: the error at a point of a trajectory is that of the system plus that of the trajectory's definition.
Their table 2 combines standard uncertainties as ISO/TR 230-9 does: U = k √Σu², k = 2; an error known by its limits ±a counts as a/√3
(JCGM 100:2008, 4.3.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Any, Final, final

from twin._common.provenance import ILLUSTRATIVE, SourceWarning, warning_texts
from twin._common.records import json_form
from twin._common.units import count_with_noun
from twin.compensation.programs.report import NO_ERRORS, LineNote, Report, grouped
from twin.display.results import Result

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
class ToleranceShares:
    """Division of the tolerance, µm."""

    tolerance: float  # the whole tolerance
    # share of rounding to the least increments, of the point and of the rotary words at the lever together
    rounding: float
    compensation: float  # share of the error between block end points
    path: float  # share of the path: deviation of the curve from the input and of the blocks from the curve, together


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
