"""What became of a program's runs, what of the tolerance each part used, and what the uncertainty of the path is made of.

Díaz Pérez et al. (2019), eq. 15: the error at a place of a trajectory is that of the system plus that of the trajectory's definition.
Their table 2 combines standard uncertainties as ISO/TR 230-9 does: U = k √Σu², k = 2; an error known by its limits ±a counts as a/√3
(JCGM 100:2008, 4.3.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Any, Final, final

from twin._common.json_form import json_form
from twin._common.provenance import ILLUSTRATIVE, SourceWarning, texts
from twin.compensation.account import NO_ERRORS, LineNote, Report, grouped
from twin.display import UNKNOWN, bar, card, note, pairs, several, table

SCHEMA = "twin.path/1"
SHOWN = 8
"""Lines of a list that the text shows before it counts the rest; JSON has them all."""
EXPANSION_FACTOR: Final = 2.0
PARTS: Final = ("fit", "chord", "path", "machine", "total")
"""What the tolerance is used for."""


@final
@dataclass(frozen=True)
class UncertaintyContribution:
    """One contribution to an uncertainty.

    Attributes:
        name: what it is.
        standard_um: standard uncertainty (k = 1), µm; NaN where it is not known.
        how: where the number comes from.
    """

    name: str
    standard_um: float
    how: str

    @classmethod
    def within(cls, name: str, limit_um: float, how: str) -> UncertaintyContribution:
        """Of an error that lies anywhere within ± a limit."""
        return cls(name, limit_um / sqrt(3.0), f"{how}: ± {limit_um:.3f} µm/√3")


def combined(contributions: Sequence[UncertaintyContribution]) -> float:
    """U = k √Σu² in µm; NaN where a contribution is not known."""
    return EXPANSION_FACTOR * sqrt(sum(one.standard_um**2 for one in contributions))


@final
@dataclass(frozen=True)
class Shares:
    """How the tolerance is shared out, µm.

    Attributes:
        tolerance: all of it.
        rounding: what rounding to the least increments may take, of point and of rotary words at the lever together.
        compensation: error the machine may make between the ends of a block.
        path: left for the path itself: the curve beside the input, and the blocks beside the curve, together.
    """

    tolerance: float
    rounding: float
    compensation: float
    path: float


@final
@dataclass(frozen=True)
class RunReport:
    """One run.

    Attributes:
        first_line, last_line: of the input.
        blocks, blocks_out: how many it had, and how many say it now, before compensation.
        corners: how many of its vertices stay corners, its ends not counted.
        control_points: of all its curves; a block left as it is counts one.
        degrees: of its curves, one after the other; ``t`` before one of sines (an arc).
        fit_share_um: what the curve was given of the path's share.
        fit_um: how far curve and input are apart, both ways, at the tool.
        chord_um: how far the blocks are from the curve.
        path_um: how far the blocks are from the input: fit and chord together.
        machine_um: compensation between the ends and rounding together: how far the executed path is from the blocks.
        total_um: how far the executed path is from the input's, both ways; what is held against the tolerance.
        why: why it was left as it is; empty where it was not.
    """

    first_line: int
    last_line: int
    blocks: int
    blocks_out: int
    corners: int
    control_points: int
    degrees: tuple[str, ...]
    fit_share_um: float
    fit_um: float
    chord_um: float
    path_um: float
    machine_um: float
    total_um: float
    why: str


@final
@dataclass(frozen=True)
class PathReport:
    """The account of one refitted program; every field is in the JSON under its name.

    Attributes:
        warnings: of where the calibration's numbers come from; none where the program is not compensated.
        shares: of the tolerance, where the path has least of it (runs that turn rotary axes round them, too).
        lever_mm: what a rotary word's deviation is multiplied by: at the tool axis, so far from the tip, it makes that.
        angle_deg: the rotary words' own tolerance: the tolerance at the lever.
        blocks_out: feed blocks of the output in the runs' place, before compensation split any.
        not_met: runs whose executed path leaves the tolerance.
        contributions: what the uncertainty of the path is made of.
        compensation: the compensation's own account, None without one.
        compensation_asked: whether the machine's errors were to be compensated.
    """

    program: str
    machine: str
    calibration: str
    warnings: tuple[SourceWarning, ...]
    shares: Shares
    lever_mm: float
    angle_deg: float
    runs: tuple[RunReport, ...]
    not_met: tuple[LineNote, ...]
    notes: tuple[LineNote, ...]
    contributions: tuple[UncertaintyContribution, ...]
    compensation: Report | None
    compensation_asked: bool = False

    @property
    def illustrative(self) -> bool:
        """Whether some of the errors compensated for are drawn, not measured."""
        return ILLUSTRATIVE in self.warnings

    @property
    def blocks(self) -> int:
        """Blocks of all runs."""
        return sum(run.blocks for run in self.runs)

    @property
    def blocks_out(self) -> int:
        """Blocks they became."""
        return sum(run.blocks_out for run in self.runs)

    @property
    def expanded_um(self) -> float:
        """U (k = 2) of a place of the path, NaN where a contribution is not known."""
        return combined(self.contributions)

    @property
    def complete(self) -> bool:
        """Whether everything asked for was met (the exit status says so)."""
        compensated = not self.compensation_asked if self.compensation is None else self.compensation.complete
        return compensated and not self.not_met

    @property
    def strictly_complete(self) -> bool:
        """Whether everything was met and corrected: rapids and the orientation, too."""
        return self.complete and (self.compensation is None or self.compensation.strictly_complete)

    @property
    def headline(self) -> str | None:
        """What came of the compensation, in one line; None if it was not asked for."""
        if self.compensation is not None:
            return self.compensation.headline
        return NO_ERRORS if self.compensation_asked else None

    def to_dict(self) -> dict[str, Any]:
        """The JSON."""
        uncertainty = {
            "coverage_factor": EXPANSION_FACTOR,
            "expanded_um": self.expanded_um,
            "contributions": self.contributions,
        }
        found = {
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
        return dict(json_form(found))

    def _repr_html_(self) -> str:
        used, shares = self.used(), self.shares
        rows = [
            ("blocks from the input's path", shares.path, used["path"]),
            ("compensation between the ends, rounding", shares.compensation + shares.rounding, used["machine"]),
            ("executed path from the input's", shares.tolerance, used["total"]),
        ]
        cells = [(words, f"{share:.3f}", f"{most:.3f}", bar(most / shares.tolerance)) for words, share, most in rows]
        u = self.expanded_um
        told = [
            ("blocks", f"{self.blocks:,} in {several(len(self.runs), 'run')}, now {self.blocks_out:,}"),
            (
                "U of a place of the path (k = 2)",
                f"{u:.2g} µm" if u == u else f"{UNKNOWN}: the calibration has no covariance",
            ),
        ]
        lists = (("not met", self.not_met, True), ("to know", self.notes, False))
        notes = [
            note(f"{of}, line {one.line}: {one.text}", loud=loud) for of, those, loud in lists for one in those[:SHOWN]
        ]
        title = f"{Path(self.program).name} on {self.machine} with fewer blocks"
        headers = (f"of {shares.tolerance:g} µm", "share, µm", "used, µm", "")
        parts = (pairs(told), table(headers, cells, right=(1, 2)), *notes)
        return card(title, *parts, illustrative=self.illustrative, wrong=not self.complete).text

    def used(self) -> dict[str, float]:
        """The most that each part took of the tolerance, over all runs, µm."""
        return {part: max((getattr(run, f"{part}_um") for run in self.runs), default=0.0) for part in PARTS}

    def to_text(self) -> str:
        """The report as a machinist reads it."""
        used, shares, u = self.used(), self.shares, self.expanded_um
        unknown = "unknown (the calibration has none), and"
        fitted = [run for run in self.runs if not run.why]
        headline = "" if self.headline is None else f": {self.headline}"
        calibration = ["  not compensated: on the machine as drawn"]
        if self.compensation is not None:
            calibration = [f"  calibration   {self.calibration}"]
            calibration += [f"                {text}" for text in texts(self.warnings)]
        fit_share = max((run.fit_share_um for run in self.runs), default=0.0)
        added = 0 if self.compensation is None else self.compensation.added
        more = f" (+{added} where compensation splits or takes up a reversal)" if added else ""
        out = [
            f"{self.program} on {self.machine}{headline}",
            *calibration,
            f"  blocks        {self.blocks} in {len(self.runs)} runs, now {self.blocks_out}{more}",
            f"  curves        {sum(run.control_points for run in fitted)} control points for "
            f"{sum(run.blocks for run in fitted)} blocks in {len(fitted)} runs, {sum(run.corners for run in self.runs)} corners kept",
            f"  rotary words  {self.angle_deg:.4f}°: the tolerance at {self.lever_mm:g} mm from the tip",
            "",
            f"  of {shares.tolerance:g} µm                                  share     used",
            f"    curve from the input                      {fit_share:8.3f} {used['fit']:8.3f} µm",
            f"    blocks from the curve                            – {used['chord']:8.3f}",
            f"    both together: blocks from the input      {shares.path:8.3f} {used['path']:8.3f}",
            f"    compensation between the ends, rounding   {shares.compensation + shares.rounding:8.3f} {used['machine']:8.3f}",
            f"    executed path from the input's            {shares.tolerance:8.3f} {used['total']:8.3f}",
            "",
            f"  uncertainty at a place of the path: {unknown if u != u else f'U (k = 2) {u:.2f} µm,'} made of (k = 1)",
            *(f"    {one.name:<44}{_um(one.standard_um)}  {one.how}" for one in self.contributions),
        ]
        kept = tuple(
            LineNote(run.first_line, f"{run.blocks} blocks to line {run.last_line}: {run.why}")
            for run in self.runs
            if run.why
        )
        compensation = self.compensation
        lists = (
            ("not met", grouped(self.not_met)),
            ("not corrected", [] if compensation is None else [one.text for one in compensation.not_corrected]),
            ("left as they were", grouped(kept)),
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
