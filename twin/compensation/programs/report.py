"""Report of a compensation as text, HTML and JSON: what was corrected, what was not, and how sure the correction is.

A machine without any error would be given a correction of up to its expanded uncertainty U in 95 % of cases. A correction no larger
than U is therefore not shown to be an improvement. Just above U the error is significant, and removing it reduces it with probability
Φ(U/2u): 84 % if the uncertainty lies along the correction, 92 % if it is equal in all directions; more for larger corrections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.provenance import ILLUSTRATIVE, SourceWarning, warning_texts
from twin._common.records import json_form
from twin._common.units import count_with_noun
from twin.compensation.programs.uncorrected import LINES_SHOWN, FrameUse, Shortfall, line_numbers
from twin.display import bar, note, readable, rounded, table
from twin.display.results import Display, DisplayedResult
from twin.model.conditions import values_in_words
from twin.tool.uncertainty import DEFINITION, ToolUncertainty


@final
class CompensationTally:
    """Running sums of squares over ``count`` places, and all quantities and the line at the place where each is ``largest``."""

    def __init__(self, quantities: int, squares: int) -> None:
        self.count = 0
        self.largest = np.zeros((quantities, quantities))
        self.lines = np.zeros(quantities, dtype=int)
        self._squares = np.zeros(squares)

    def add(self, values: np.ndarray, squares: np.ndarray, lines: np.ndarray, count: int | None = None) -> None:
        """Add (quantities, n) values at (n,) lines, or only the largest of ``count`` places; ``squares``: sums over all."""
        if not lines.size:
            return
        at = np.argmax(values, axis=1)
        larger = np.diagonal(values[:, at]) > np.diagonal(self.largest) if self.count else np.full(len(at), True)
        self.largest[larger] = values[:, at[larger]].T
        self.lines[larger] = lines[at[larger]]
        self.count += len(lines) if count is None else count
        self._squares += squares

    @property
    def rms(self) -> list[float]:
        """Root mean squares over all places."""
        return np.sqrt(self._squares / max(self.count, 1)).tolist()


# --- Correction of a program compared with its own uncertainty: which corrections are a proven improvement

BELOW: Final = np.dtype([("line", int), ("correction", float), ("expanded", float)])
NAMED = 8
"""Names without uncertainty that the text prints before it counts the rest; the JSON report has all."""


@final
@dataclass(frozen=True)
class ToolCorrection:
    """Correction of the tool point or of the tool axis at block end points, with its uncertainty."""

    of: str  # ``tool point`` or ``tool axis``
    unit: str  # ``um`` or ``urad``, for every number below
    blocks: int
    rms: float  # rms, max: RMS and largest length of the correction
    max: float
    max_expanded: float  # max_expanded, max_line: U at the largest correction, and its line
    max_line: int
    expanded_rms: float  # RMS of U over the program; NaN if unknown
    expanded_max: float  # expanded_max, expanded_max_line: largest U, and its line
    expanded_max_line: int
    # standard uncertainties (k = 1) along or about x, y, z of the work frame, RMS over the program
    standard_rms: tuple[float, float, float]
    # blocks whose correction is no larger than its own U: ``line``, ``correction`` and ``expanded`` of each, RMS over the end points
    # of its pieces
    below: np.recarray = field(compare=False)
    known: bool  # whether any of the corrected errors has an uncertainty
    without_uncertainty: tuple[str, ...]  # corrected errors without uncertainty; if there are any, U is a lower bound

    @property
    def label(self) -> str:
        """Label in the report."""
        return "correction" if self.unit == "um" else "orientation"

    @property
    def shown(self) -> bool | None:
        """Whether the correction exceeds its uncertainty; None if that uncertainty is unknown, or known only in part."""
        if not self.known:
            return None
        if self.rms <= self.expanded_rms:
            return False
        return None if self.without_uncertainty else True

    @property
    def headline(self) -> str:
        """Summary in one sentence."""
        sign = readable(self.unit)
        if not self.known:
            return f"{self.rms:.1f} {sign} RMS at the block end points, its uncertainty unknown"
        size, expanded = rounded(self.rms, self.expanded_rms)
        least = " at least" if self.without_uncertainty else ""
        if self.shown is False:
            return f"not shown to be an improvement: correction {size} {sign}, its uncertainty U{least} {expanded} {sign} (RMS)"
        if self.shown is None:
            return f"{size} {sign} RMS at the block end points, U at least {expanded} {sign}"
        return f"{size} ± {expanded} {sign} RMS at the block end points (± U, 95 %)"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report; unknown values are null."""
        end = f"_{self.unit}"
        entry = {
            "known": self.known,
            "complete": self.known and not self.without_uncertainty,
            "shown": self.shown,
            "headline": self.headline,
            "blocks": self.blocks,
            "correction_rms" + end: self.rms,
            "correction_max" + end: self.max,
            "correction_max_line": self.max_line,
            "expanded_at_correction_max" + end: self.max_expanded,
            "expanded_rms" + end: self.expanded_rms,
            "expanded_max" + end: self.expanded_max,
            "expanded_max_line": self.expanded_max_line if self.known else None,
            "standard_rms" + end: self.standard_rms,
            "below": [
                dict(zip(("line", "correction" + end, "expanded" + end), block, strict=True))
                for block in self.below.tolist()
            ],
            "without_uncertainty": self.without_uncertainty,
        }
        return dict(json_form(entry))

    def to_text(self, shown: int) -> list[str]:
        """Return the lines of the report below the headline, with at most ``shown`` entries of a list."""
        if not self.known:
            return []
        sign = readable(self.unit)
        size, expanded = rounded(self.max, self.max_expanded)
        along = "along" if self.unit == "um" else "about"
        x, y, z, widest = (rounded(value, value)[1] for value in (*self.standard_rms, self.expanded_max))
        out = [
            f"    {self.of:<12}largest {size} ± {expanded} {sign} (line {self.max_line}); largest U {widest} {sign} "
            f"(line {self.expanded_max_line}); u (k = 1) {along} x {x}, y {y}, z {z} {sign}"
        ]
        if len(self.below):
            out.append(
                f"    {self.of}: correction not larger than its own uncertainty in {len(self.below)} of {self.blocks} blocks, "
                "which are not shown to be improved:"
            )
            for block in self.below[:shown]:
                size, expanded = rounded(block.correction, block.expanded)
                out.append(f"      line {block.line}: correction {size} {sign}, U {expanded} {sign}")
            if len(self.below) > shown:
                out.append(f"      … and {len(self.below) - shown} more (all in the JSON report)")
        return out


@final
class CorrectionTally:
    """Collects a `ToolCorrection`; block end points are added stretch by stretch, those of one block together."""

    def __init__(self, of: str, unit: str) -> None:
        self._of, self._unit = of, unit
        self._tally = CompensationTally(2, 5)
        self._blocks = 0
        self._below: list[np.recarray] = []
        self._known = False
        self._without: tuple[str, ...] = ()

    def add(
        self, lines: np.ndarray, blocks: np.ndarray, size: np.ndarray, known: np.ndarray, tool: ToolUncertainty
    ) -> None:
        """Add (n,) lengths of the correction; ``known``: (n, 4) its U and three standard uncertainties; ``blocks``: (n,) ascending."""
        expanded = known[:, 0]
        first = np.flatnonzero(np.append(True, blocks[1:] != blocks[:-1]))
        count = np.diff(np.append(first, len(blocks)))
        of_block, u_of_block = size, expanded
        if len(first) < len(blocks):
            of_block, u_of_block = (np.sqrt(np.add.reduceat(values**2, first) / count) for values in (size, expanded))
        below = of_block <= u_of_block
        columns = [lines[first[below]], of_block[below], u_of_block[below]]
        self._below.append(np.rec.fromarrays(columns, dtype=BELOW))
        squares = np.array([np.einsum("i,i", size, size), *np.einsum("ij,ij->j", known, known)])
        self._tally.add(np.stack([size, expanded]), squares, lines)
        self._blocks += len(first)
        self._known, self._without = bool(tool.parameters), tool.without_uncertainty

    def correction(self) -> ToolCorrection | None:
        """Return the correction over everything added; None if nothing was."""
        if not self._tally.count:
            return None
        rms, expanded_rms, x, y, z = self._tally.rms
        (size, expanded), (_, widest) = self._tally.largest.tolist()
        line, widest_line = self._tally.lines.tolist()
        return ToolCorrection(
            of=self._of,
            unit=self._unit,
            blocks=self._blocks,
            rms=rms,
            max=size,
            max_expanded=expanded,
            max_line=line,
            expanded_rms=expanded_rms,
            expanded_max=widest,
            expanded_max_line=widest_line,
            standard_rms=(x, y, z),
            below=np.concatenate(self._below).view(np.recarray),
            known=self._known,
            without_uncertainty=self._without,
        )


@final
@dataclass(frozen=True)
class UnknownErrors:
    """Errors that the calibration could not determine: no program corrects them, and they limit how well the result is known."""

    names: tuple[str, ...]  # ISO 230-1 names
    # U of the tool point from their plausible size and the corrected errors together, RMS over the program
    expanded_rms_um: float
    expanded_max_um: float  # expanded_max_um, expanded_max_line: the largest such U, and its line
    expanded_max_line: int

    @property
    def text(self) -> str:
        """The errors and U with them, as a sentence."""
        names = ", ".join(self.names[:NAMED]) + (
            f" and {len(self.names) - NAMED} more" if len(self.names) > NAMED else ""
        )
        return (
            f"{names}: not corrected, because not identified. With their plausible size, U of the tool point is "
            f"{self.expanded_rms_um:.0f} µm RMS, at most {self.expanded_max_um:.0f} µm (line {self.expanded_max_line})"
        )


@final
@dataclass(frozen=True)
class Corrections:
    """Corrections of tool point and tool axis; None for one that is not in scope."""

    point: ToolCorrection | None  # point, axis: the corrections, with the uncertainty of the corrected errors
    axis: ToolCorrection | None
    # errors that the calibration could not determine; None if there are none
    not_identified: UnknownErrors | None = None

    def __iter__(self) -> Iterator[ToolCorrection]:
        """Iterate over those that are in scope."""
        return (correction for correction in (self.point, self.axis) if correction is not None)

    @property
    def unknown(self) -> str | None:
        """Statement of the errors without known uncertainty; None if every uncertainty is known."""
        missing = dict.fromkeys(name for correction in self for name in correction.without_uncertainty)
        if not missing:
            return None
        names = ", ".join(list(missing)[:NAMED]) + (f" and {len(missing) - NAMED} more" if len(missing) > NAMED else "")
        what = "known only in part" if any(correction.known for correction in self) else "unknown"
        return f"uncertainty of the correction: {what} (no covariance in the calibration: {names})"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report."""
        return {"definition": DEFINITION, "unknown": self.unknown, **json_form(self)}


# --- Report of a whole program --------------------------------------------------------------------

SCHEMA = "twin.compensation/1"
NO_ERRORS = "NOTHING CORRECTED: no error motion is in scope, so no position is changed"
IN_SCOPE: Final = {True: "corrected", False: "not in scope", None: ""}


@final
@dataclass(frozen=True)
class Deviation:
    """Deviation of the tool from its nominal pose, over all end points and the dense points between them."""

    rms_um: float  # rms_um, max_um: distance at the functional point
    max_um: float
    rms_urad: float  # rms_urad, max_urad: angle of the tool axis
    max_urad: float
    worst_line: int  # program line of the largest distance
    points: int  # number of poses
    # tilt_rms_urad, tilt_max_urad: tilt about x and about y of the tool frame, RMS and largest amount
    # (`twin.tool.forward.Poses.tilt_urad`)
    tilt_rms_urad: tuple[float, float]
    tilt_max_urad: tuple[float, float]

    @classmethod
    def of(cls, tally: CompensationTally) -> Deviation:
        """Return the deviation from a tally of distances, angles and both tilts."""
        rms, angle_rms, x_rms, y_rms = tally.rms
        largest, angle, x, y = tally.largest.diagonal().tolist()
        line = int(tally.lines[0])
        return cls(rms, largest, angle_rms, angle, line, tally.count, (x_rms, y_rms), (x, y))


@final
@dataclass(frozen=True)
class ClassShare:
    """Share of one ISO/TR 16907 class in the error."""

    name: str  # the class
    # whether the class is in scope; None if the method does not work by class. Blocks that are not corrected are listed in the report
    corrected: bool | None
    before_rms_um: float  # before_rms_um, before_max_um: error of its error motions alone at the functional point
    before_max_um: float
    before_max_urad: float  # their error of the tool axis
    # residual at the functional point; None as above, and where blocks that are not corrected retain some of it
    left_rms_um: float | None


@final
@dataclass(frozen=True)
class LineNote:
    """Note on one program line."""

    line: int
    text: str


def grouped(notes: Sequence[LineNote]) -> list[str]:
    """Return one line per text, with the line numbers of all notes of that text."""
    lines_of: dict[str, list[int]] = {}
    for line_note in notes:
        lines_of.setdefault(line_note.text, []).append(line_note.line)
    return [f"{line_numbers(lines)}: {text}" for text, lines in lines_of.items()]


@final
@dataclass(frozen=True)
class ReversalNote:
    """Treatment of the reversal value (backlash) of one axis."""

    axis: str
    unit: str  # ``um`` or ``urad``
    size: float  # the reversal value, in ``unit``
    corrected: bool  # whether it is in scope
    taken_up: int  # number of reversals at which a move was inserted that takes it up


@final
@dataclass(frozen=True)
class ControlNote:
    """Errors that the control corrects by its own tables, so that the program must not correct them again."""

    # ``uncorrected``: the tables reduce the calibration's errors as stated below; ``remaining``: the calibration's errors were
    # measured with the tables active
    errors_are: str
    tables: tuple[str, ...]  # the files
    axes: tuple[str, ...]  # axes they correct; empty if the errors are the remaining ones
    # rms_um, max_um: displacement of the tool by the tables over the program; None if the errors are the remaining ones
    rms_um: float | None
    max_um: float | None
    caution: str = ""  # a further condition; empty if none
    module: bool = False  # whether the files are those of a kinematics module

    @property
    def sentence(self) -> str:
        """Statement in the report."""
        files = ", ".join(self.tables)
        if self.rms_um is None or self.max_um is None:
            return (
                f"these errors were measured with its {'kinematics module' if self.module else 'tables'} active ({files}): keep "
                f"{'it' if self.module else 'them'} active; "
                f"the program corrects only the remaining errors{'. ' if self.caution else ''}{self.caution}"
            )
        return (
            f"its tables ({files}; axes {' '.join(self.axes)}) correct {self.rms_um:.3f} µm RMS, {self.max_um:.3f} µm at most "
            "at the tool; the program corrects only the remaining errors and is valid only with these tables active"
        )


@final
@dataclass(frozen=True, repr=False)
class Report(DisplayedResult):
    """Report of a compensation; every field is in the JSON report under its name.

    Attributes:
        tool_length_mm: tool length; of the first tool if there are several (``frames``).
        warnings: warnings on the origin of the calibration's numbers; they also stand at the head of the program.
        largest_correction: by axis, in mm or degrees, and that unit.
        rounding_um: largest distance caused by rounding to the least increment at a block end point.
        solver_um: largest distance left by the solver there.
        not_corrected: blocks that could not be corrected, or not within the tolerance, by reason.
        notes: lines passed through unchanged, and assumptions.
        uncertainty: uncertainty of the correction, from the calibration's covariance.
        cutting: number of cutting moves: all but rapids.
        idle: whether there is nothing to correct: no error motion of the calibration is in scope.
        conditions: temperatures (``T_X_degC``) and time (``time_s``) at which the effects were evaluated, over the whole program.
        reversals: treatment of backlash by axis; approach directions follow from the program.
        control: errors that the control corrects itself; None if the calibration has no tables of the control.
        frames: work offsets and tools of the program, if their tables are known.
    """

    program: str
    machine: str
    calibration: str
    calibration_source: str
    warnings: tuple[SourceWarning, ...]
    method: str
    scope: str
    tool_length_mm: float
    tolerance_um: float
    lines: int
    moves: int
    rewritten: int
    split: int
    added: int
    largest_correction: Mapping[str, tuple[float, str]]
    before: Deviation
    after: Deviation
    rounding_um: float
    solver_um: float
    classes: tuple[ClassShare, ...]
    not_corrected: tuple[Shortfall, ...]
    notes: tuple[LineNote, ...]
    uncertainty: Corrections
    cutting: int = 0
    idle: bool = False
    conditions: Mapping[str, float] = field(default_factory=dict)
    reversals: tuple[ReversalNote, ...] = ()
    control: ControlNote | None = None
    frames: tuple[FrameUse, ...] = ()

    @property
    def illustrative(self) -> bool:
        """Whether some of the errors are illustrative, not measured."""
        return ILLUSTRATIVE in self.warnings

    @property
    def complete(self) -> bool:
        """Whether something was corrected and no cutting block is out of tolerance (exit status 0, else 3)."""
        return not (self.nothing_corrected or any(shortfall.missed for shortfall in self.not_corrected))

    @property
    def strictly_complete(self) -> bool:
        """Whether everything was corrected, rapids and the orientation included."""
        return not (self.nothing_corrected or self.not_corrected)

    @property
    def nothing_corrected(self) -> bool:
        """Whether the program is written unchanged."""
        return self.rewritten == 0

    @property
    def headline(self) -> str:
        """Result in one line."""
        if self.idle:
            return NO_ERRORS
        outside = self._lines_of(lambda shortfall: shortfall.lines if shortfall.kind == "range" else ())
        hint = "; is the work offset missing?" if 2 * outside > self.moves else ""
        if self.nothing_corrected:
            return f"NOTHING CORRECTED: {outside:,} of {count_with_noun(self.moves, 'block')} would leave the range of an axis{hint}"
        missed = self._lines_of(lambda shortfall: shortfall.missed)
        if missed:
            unknown = any(error.missed for error in self.not_corrected if error.kind == "unknown")
            how = "are left as written or remain" if unknown else "remain"
            return f"NOT ALL CORRECTED: {missed:,} of {self.cutting:,} cutting blocks {how} out of tolerance{hint}"
        left = self._lines_of(lambda shortfall: shortfall.lines)
        return (
            f"corrected, except {left:,} of {count_with_noun(self.moves, 'block')} (see the list in the report)"
            if left
            else "corrected"
        )

    def _lines_of(self, lines: Callable[[Shortfall], Sequence[int]]) -> int:
        return len({line for shortfall in self.not_corrected for line in lines(shortfall)})

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON report."""
        largest = self.largest_correction.items()
        return {
            "schema": SCHEMA,
            "complete": self.complete,
            "strictly_complete": self.strictly_complete,
            "headline": self.headline,
            **json_form(self),
            "largest_correction": {name: {"value": value, "unit": unit} for name, (value, unit) in largest},
            "illustrative": self.illustrative,
        }

    @property
    def _errors(self) -> tuple[tuple[str, Deviation], tuple[str, Deviation]]:
        return ("before", self.before), ("after, as predicted", self.after)

    @property
    def _how(self) -> str:
        tool = "" if self.frames else f", tool length {self.tool_length_mm:g} mm"
        return f"{self.method}, scope {self.scope}{tool}"

    @property
    def _largest_moves(self) -> str:
        return ", ".join(
            f"{name} {value * 1e3:.1f} µm" if unit == "mm" else f"{name} {value:.4f}°"
            for name, (value, unit) in self.largest_correction.items()
        )

    @property
    def brief(self) -> str:
        """Result, and the error at the tool before and after."""
        change = f"{self.before.rms_um:.2f} → {self.after.rms_um:.2f} µm RMS at the tool"
        return f"{Path(self.program).name} on {self.machine}: {self.headline}; {change}"

    def display(self) -> Display:
        """Return errors before and after, the classes of errors, and what was not corrected."""
        worst = max(self.before.max_um, self.after.max_um, 1e-9)
        headers = (
            f"error at the tool over {self.before.points:,} poses",
            *("RMS, µm", "largest, µm", "line", "axis RMS, µrad", ""),
        )
        errors = [
            (
                words,
                *(f"{one.rms_um:.2f}", f"{one.max_um:.2f}", f"{one.worst_line}", f"{one.rms_urad:.1f}"),
                bar(one.rms_um / worst, loud=one is self.before),
            )
            for words, one in self._errors
        ]
        by_class = ("ISO/TR 16907 class, alone", "RMS before, µm", "largest, µm", "", "")
        classes = [
            (
                one.name,
                *(f"{one.before_rms_um:.2f}", f"{one.before_max_um:.2f}", IN_SCOPE[one.corrected]),
                bar(one.before_rms_um / worst, loud=True),
            )
            for one in self.classes
        ]
        blocks = f"{self.rewritten:,} rewritten, {self.split:,} split (+{self.added:,} blocks)"
        rows = [
            ("calibration", self.calibration_source if self.calibration == "none" else self.calibration),
            *((one.label, one.headline) for one in self.uncertainty),
            ("", self.uncertainty.unknown or ""),
            ("not known", "" if self.uncertainty.not_identified is None else self.uncertainty.not_identified.text),
            ("control", "" if self.control is None else self.control.sentence),
            ("method", self._how),
            ("program", f"{count_with_noun(self.moves, 'move')}: {blocks}"),
            *(("" if i else "set-up", one.sentence) for i, one in enumerate(self.frames)),
            ("largest shift of an axis", self._largest_moves),
            ("error of rounding", f"up to {self.rounding_um:.2f} µm at a block end point"),
        ]
        above = note(self.headline, loud=not self.complete), table(headers, errors, right=range(1, 5))
        below = (
            table(by_class, classes, right=(1, 2)),
            *(note(f"not corrected: {error.text}", loud=bool(error.missed)) for error in self.not_corrected),
            *(note(text) for text in grouped(self.notes)),
        )
        title = f"{Path(self.program).name} on {self.machine}, compensated"
        return Display(title, rows, above=above, below=below, illustrative=self.illustrative, wrong=not self.complete)

    def to_text(self) -> str:
        """Return the report as text."""
        unknown, not_identified = self.uncertainty.unknown, self.uncertainty.not_identified
        tilts = [f"{' / '.join(f'{about:.1f}' for about in one.tilt_rms_urad)}" for _, one in self._errors]
        out = [
            f"{self.program} on {self.machine}: {self.headline}",
            f"  calibration   {self.calibration}",
            *(f"                {text}" for text in warning_texts(self.warnings)),
            *(f"  {one.label:<14}{one.headline}" for one in self.uncertainty),
            *([] if unknown is None else [f"  {unknown}"]),
            *([] if not_identified is None else [f"  not known     {not_identified.text}"]),
            *([] if self.control is None else [f"  control       {self.control.sentence}"]),
            f"  method        {self._how}",
            f"  program       {self.lines} lines, {self.moves} moves: {self.rewritten} rewritten, "
            f"{self.split} split to stay within {self.tolerance_um:g} µm between end points (+{self.added} blocks)",
            *(f"  {'' if i else 'set-up':<14}{one.sentence}" for i, one in enumerate(self.frames)),
            *self._channels_text(),
            f"  largest shift {self._largest_moves}",
            "",
            f"  error at the tool over {self.before.points} poses   RMS        max      tool axis RMS   max",
            *(
                f"    {words:<19}  {_um(one.rms_um)} {_um(one.max_um)} "
                f"(line {one.worst_line})   {one.rms_urad:8.1f} {one.max_urad:8.1f} µrad"
                for words, one in self._errors
            ),
            f"    tilt of the tool axis about x / y of the tool frame, RMS: before {tilts[0]}, after {tilts[1]} µrad",
            f"    residual at block end points: up to {self.rounding_um:.3f} µm by rounding, {self.solver_um:.1e} µm by the solver",
            *self._uncertainty_text(),
            "",
            "  by class (ISO/TR 16907)   before RMS     max        after RMS",
            *self._classes_text(),
        ]
        lists = (("not corrected", [error.text for error in self.not_corrected]), ("notes", grouped(self.notes)))
        for title, lines in lists:
            if lines:
                out += ["", f"  {title}", *(f"    {line}" for line in lines)]
        return "\n".join(out) + "\n"

    def _channels_text(self) -> list[str]:
        """Return lines on temperatures, time and backlash."""
        held = values_in_words(self.conditions)
        out = [f"  conditions    {held}, over the whole program"] if held else []
        for reversal in self.reversals:
            done = (
                f"taken up by extra moves at {reversal.taken_up} reversals of {reversal.axis}"
                if reversal.corrected
                else "not in scope"
            )
            out.append(f"  backlash      {reversal.axis} {reversal.size:.1f} {readable(reversal.unit)}: {done}")
        return out

    def _uncertainty_text(self) -> list[str]:
        """Return lines on the uncertainty of the correction, which limits how well the predicted error is known."""
        known = [correction for correction in self.uncertainty if correction.known]
        if not known:
            return []
        out = ["", f"  {DEFINITION}; without rounding, repeatability and temperature"]
        return out + [line for correction in known for line in correction.to_text(LINES_SHOWN)]

    def _classes_text(self) -> list[str]:
        corrected = "corrected" if not self.not_corrected else "corrected, except the blocks below"
        out = []
        for share in self.classes:
            kept = "" if share.left_rms_um is None else f"{_um(share.left_rms_um)} (not in scope)"
            left = corrected if share.corrected else kept
            out.append(f"    {share.name:<22}{_um(share.before_rms_um)} {_um(share.before_max_um)}  {left}")
        return out


def _um(value: float) -> str:
    return f"{value:8.3f} µm"
