"""What a compensation did and what it leaves, for a person and for a program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np

from twin._common.provenance import ILLUSTRATIVE, SourceWarning, texts, to_json
from twin._common.units import URAD
from twin.compensation.comparison import Compared
from twin.compensation.correction import Corrections
from twin.compensation.shortfalls import SHOWN, Shortfall, line_numbers
from twin.display import bar, card, note, pairs, several, table
from twin.machine.conditions import TIME
from twin.numerics.spatial import tilt
from twin.uncertainty.at_tool import DEFINITION

SCHEMA = "twin.compensation/1"
NO_ERRORS = "NOTHING CORRECTED: the calibration has no error motion in scope, so no position is changed"


@final
@dataclass(frozen=True)
class Deviation:
    """How far the tool is from where it was meant to be, over all ends and dense points between them.

    Attributes:
        rms_um, max_um: distance at the functional point.
        rms_urad, max_urad: angle of the tool axis.
        tilt_rms_urad, tilt_max_urad: how it leans about x and about y of the tool frame, largest by amount
            (`twin.kinematics.forward.Poses.tilt_urad`).
        worst_line: program line of the largest distance.
        points: how many poses.
    """

    rms_um: float
    max_um: float
    rms_urad: float
    max_urad: float
    worst_line: int
    points: int
    tilt_rms_urad: tuple[float, float] = (0.0, 0.0)
    tilt_max_urad: tuple[float, float] = (0.0, 0.0)


@final
class DeviationTally:
    """A `Deviation` in the making: poses come a stretch of program at a time."""

    def __init__(self) -> None:
        self._points = self._worst_line = 0
        self._squares = np.zeros(4)
        self._largest = np.zeros(4)

    def add(self, found: Compared, lines: np.ndarray) -> None:
        """Take some poses; ``lines`` (n,) says which program line each belongs to."""
        distance = found.distance_mm * 1e3
        if not distance.size:
            return
        size = np.stack([distance, found.angle_rad * 1e6, *np.abs(tilt(found.leaning).T / URAD)])
        largest = int(np.argmax(distance))
        if not self._points or distance[largest] > self._largest[0]:
            self._worst_line = int(lines[largest])
        self._points += len(distance)
        self._squares += np.einsum("ij,ij->i", size, size)
        self._largest = np.maximum(self._largest, size.max(axis=1))

    def deviation(self) -> Deviation:
        """Of all that was added."""
        rms = np.sqrt(self._squares / max(self._points, 1)).tolist()
        largest = self._largest.tolist()
        return Deviation(
            rms_um=rms[0],
            max_um=largest[0],
            rms_urad=rms[1],
            max_urad=largest[1],
            worst_line=self._worst_line,
            points=self._points,
            tilt_rms_urad=(rms[2], rms[3]),
            tilt_max_urad=(largest[2], largest[3]),
        )


@final
@dataclass(frozen=True)
class ClassShare:
    """The share of one ISO/TR 16907 class.

    Attributes:
        name: the class.
        corrected: whether the scope has it; None where the method does not work by class. Blocks that are not are in the account.
        before_rms_um, before_max_um: what its error motions alone do at the functional point.
        before_max_urad: what they do to the tool axis.
        left_rms_um: what of it stays at the functional point; None as above, and where blocks that are not corrected keep some of it.
    """

    name: str
    corrected: bool | None
    before_rms_um: float
    before_max_um: float
    before_max_urad: float
    left_rms_um: float | None


@final
@dataclass(frozen=True)
class LineNote:
    """A remark on one program line."""

    line: int
    text: str


def grouped(notes: Sequence[LineNote]) -> list[str]:
    """One line for all notes of the same text."""
    found: dict[str, list[int]] = {}
    for one in notes:
        found.setdefault(one.text, []).append(one.line)
    return [f"{line_numbers(lines)}: {text}" for text, lines in found.items()]


@final
@dataclass(frozen=True)
class ReversalNote:
    """What was done about the reversal of one axis.

    Attributes:
        axis: its name.
        unit: ``um`` or ``urad``.
        size: its size, in ``unit``.
        corrected: whether the scope has it.
        taken_up: at how many turns of the axis moves were added that take it up.
    """

    axis: str
    unit: str
    size: float
    corrected: bool
    taken_up: int


@final
@dataclass(frozen=True)
class ControlNote:
    """What the control corrects by itself, so that the program is not corrected for it a second time.

    Attributes:
        errors_are: ``uncorrected``: the tables take out of the calibration's errors what follows; ``remaining``: the errors are what
            they leave.
        tables: the files.
        axes: what they move; empty where they are part of the errors.
        rms_um, max_um: how far they move the tool over the program; None likewise.
        caution: what is to be minded beside; nothing if empty.
    """

    errors_are: str
    tables: tuple[str, ...]
    axes: tuple[str, ...]
    rms_um: float | None
    max_um: float | None
    caution: str = ""

    @property
    def sentence(self) -> str:
        """As the report says it."""
        files = ", ".join(self.tables)
        if self.rms_um is None or self.max_um is None:
            return (
                f"these errors were measured with its tables on ({files}): leave them on; "
                f"the program is corrected for what they leave{'. ' if self.caution else ''}{self.caution}"
            )
        return (
            f"corrects by itself ({files}; moves {' '.join(self.axes)}): {self.rms_um:.3f} µm RMS, {self.max_um:.3f} µm at most "
            "at the tool; the program is corrected for what that leaves and is right only with these tables on"
        )


@final
@dataclass(frozen=True)
class Report:
    """A compensation's account of itself; every field is in the JSON under its name.

    Attributes:
        rounding_um: largest distance that rounding to the least increment leaves at a block's end.
        solver_um: largest distance the solver leaves there.
        not_corrected: blocks that could not be corrected, or not within the tolerance, by reason.
        cutting: how many moves cut: all but rapids.
        idle: whether there is nothing to correct: no error motion of the calibration is in scope.
        notes: lines passed through as written, and assumptions.
        uncertainty: of the correction, from the calibration's covariance.
        conditions: temperatures (``T_X_degC``) and time (``time_s``) over the program that its effects were taken at.
        reversals: by axis; the side each axis comes from follows from the program.
        control: what the control corrects by itself; None where the calibration says nothing of it.
        warnings: of where the calibration's numbers come from; they stand at the head of the program, too.
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

    @property
    def illustrative(self) -> bool:
        """Whether some of the errors are drawn, not measured."""
        return ILLUSTRATIVE in self.warnings

    @property
    def complete(self) -> bool:
        """Whether something was corrected, and nothing that cuts is off by more than the tolerance (exit status 0, else 3)."""
        return not (self.nothing_corrected or any(one.missed for one in self.not_corrected))

    @property
    def strictly_complete(self) -> bool:
        """Whether everything was corrected: rapids and the orientation, too."""
        return not (self.nothing_corrected or self.not_corrected)

    @property
    def nothing_corrected(self) -> bool:
        """Whether the program is written as it came."""
        return self.rewritten == 0

    @property
    def headline(self) -> str:
        """What came of it, in one line."""
        if self.idle:
            return NO_ERRORS
        outside = self._lines_of(lambda one: one.lines if one.kind == "range" else ())
        hint = "; is the work offset missing?" if 2 * outside > self.moves else ""
        if self.nothing_corrected:
            return f"NOTHING CORRECTED: {outside:,} of {several(self.moves, 'block')} would leave the range of an axis{hint}"
        missed = self._lines_of(lambda one: one.missed)
        if missed:
            return f"NOT ALL CORRECTED: {missed:,} of {self.cutting:,} cutting blocks stay off by more than the tolerance{hint}"
        left = self._lines_of(lambda one: one.lines)
        return f"corrected, but for {left:,} of {several(self.moves, 'block')} (listed below)" if left else "corrected"

    def _lines_of(self, lines: Callable[[Shortfall], Sequence[int]]) -> int:
        return len({line for one in self.not_corrected for line in lines(one)})

    def to_dict(self) -> dict[str, Any]:
        """The JSON."""
        data = asdict(self)
        data["largest_correction"] = {
            name: {"value": value, "unit": unit} for name, (value, unit) in self.largest_correction.items()
        }
        data["uncertainty"] = self.uncertainty.to_dict()
        data["illustrative"] = self.illustrative
        data["warnings"] = to_json(self.warnings)
        data["not_corrected"] = [one.to_dict() for one in self.not_corrected]
        return {
            "schema": SCHEMA,
            "complete": self.complete,
            "strictly_complete": self.strictly_complete,
            "headline": self.headline,
            **data,
        }

    def _repr_html_(self) -> str:
        worst = max(self.before.max_um, self.after.max_um, 1e-9)
        errors = [
            (
                words,
                f"{d.rms_um:.2f}",
                f"{d.max_um:.2f}",
                f"{d.worst_line}",
                f"{d.rms_urad:.1f}",
                bar(d.rms_um / worst, loud=loud),
            )
            for words, d, loud in (("before", self.before, True), ("after, as predicted", self.after, False))
        ]
        done = {True: "corrected", False: "not in scope", None: ""}
        classes = [
            (
                one.name,
                f"{one.before_rms_um:.2f}",
                f"{one.before_max_um:.2f}",
                done[one.corrected],
                bar(one.before_rms_um / worst, loud=True),
            )
            for one in self.classes
        ]
        largest = ", ".join(
            f"{name} {value * 1e3:.1f} µm" if unit == "mm" else f"{name} {value:.4f}°"
            for name, (value, unit) in self.largest_correction.items()
        )
        rows = [
            ("calibration", self.calibration_source if self.calibration == "none" else self.calibration),
            *((one.label, one.headline) for one in self.uncertainty),
            ("", self.uncertainty.unknown or ""),
            ("control", "" if self.control is None else self.control.sentence),
            ("method", f"{self.method}, scope {self.scope}, tool length {self.tool_length_mm:g} mm"),
            (
                "program",
                f"{several(self.moves, 'move')}: {self.rewritten:,} rewritten, {self.split:,} split (+{self.added:,} blocks)",
            ),
            ("largest move of an axis", largest),
            ("rounding leaves", f"up to {self.rounding_um:.2f} µm at a block's end"),
        ]
        notes = [note(f"not corrected: {one.text}", loud=bool(one.missed)) for one in self.not_corrected]
        notes += [note(text) for text in grouped(self.notes)]
        headers = (
            f"error at the tool over {self.before.points:,} poses",
            "RMS, µm",
            "largest, µm",
            "line",
            "axis RMS, µrad",
            "",
        )
        by_class = ("ISO/TR 16907 class, alone", "RMS before, µm", "largest, µm", "", "")
        parts = (
            note(self.headline, loud=not self.complete),
            table(headers, errors, right=range(1, 5)),
            pairs(rows),
            table(by_class, classes, right=(1, 2)),
            *notes,
        )
        title = f"{Path(self.program).name} on {self.machine}, compensated"
        return card(title, *parts, illustrative=self.illustrative, wrong=not self.complete).text

    def to_text(self) -> str:
        """The report as a machinist reads it."""
        out = [
            f"{self.program} on {self.machine}: {self.headline}",
            f"  calibration   {self.calibration}",
        ]
        out += [f"                {text}" for text in texts(self.warnings)]
        out += [f"  {one.label:<14}{one.headline}" for one in self.uncertainty]
        out += [] if self.uncertainty.unknown is None else [f"  {self.uncertainty.unknown}"]
        out += [
            *([] if self.control is None else [f"  control       {self.control.sentence}"]),
            f"  method        {self.method}, scope {self.scope}, tool length {self.tool_length_mm:g} mm",
            f"  program       {self.lines} lines, {self.moves} moves: {self.rewritten} rewritten, "
            f"{self.split} split where {self.tolerance_um:g} µm between ends asked for it (+{self.added} blocks)",
            *self._channels_text(),
            "  largest move  "
            + ", ".join(
                f"{name} {value * 1e3:.1f} µm" if unit == "mm" else f"{name} {value:.4f}°"
                for name, (value, unit) in self.largest_correction.items()
            ),
            "",
            f"  error at the tool over {self.before.points} poses   RMS        max      tool axis RMS   max",
            f"    before               {_um(self.before.rms_um)} {_um(self.before.max_um)} "
            f"(line {self.before.worst_line})   {self.before.rms_urad:8.1f} {self.before.max_urad:8.1f} µrad",
            f"    after, as predicted  {_um(self.after.rms_um)} {_um(self.after.max_um)} "
            f"(line {self.after.worst_line})   {self.after.rms_urad:8.1f} {self.after.max_urad:8.1f} µrad",
            f"    the tool axis's tilt about x / y of the tool, RMS: before {_tilt(self.before)}, after {_tilt(self.after)} µrad",
            f"    rounding leaves up to {self.rounding_um:.3f} µm at a block's end, the solver {self.solver_um:.1e} µm",
            *self._uncertainty_text(),
            "",
            "  by class (ISO/TR 16907)   before RMS     max        left",
        ]
        corrected = "corrected" if not self.not_corrected else "corrected, but for the blocks below"
        for share in self.classes:
            left = (
                ""
                if share.left_rms_um is None and not share.corrected
                else corrected
                if share.corrected
                else f"{_um(share.left_rms_um or 0.0)} (not in scope)"
            )
            out.append(f"    {share.name:<22}{_um(share.before_rms_um)} {_um(share.before_max_um)}  {left}")
        lists = (("not corrected", [one.text for one in self.not_corrected]), ("notes", grouped(self.notes)))
        for title, lines in lists:
            if lines:
                out += ["", f"  {title}", *(f"    {line}" for line in lines)]
        return "\n".join(out) + "\n"

    def _channels_text(self) -> list[str]:
        """What the effects that need more than positions were given."""
        out = []
        given = [
            f"{value:g} s on the clock of the measured table" if name == TIME else f"{name[2:-5]} {value:g} °C"
            for name, value in self.conditions.items()
        ]
        if given:
            out.append(f"  taken at      {', '.join(given)}, over the whole program")
        for one in self.reversals:
            size = f"{one.axis} {one.size:.1f} {'µm' if one.unit == 'um' else 'µrad'}"
            done = f"taken up by extra moves at {one.taken_up} turns of {one.axis}"
            out.append(f"  reversal      {size}: {done if one.corrected else 'not in scope'}")
        return out

    def _uncertainty_text(self) -> list[str]:
        """What "after" is worth: it is what the calibration itself predicts."""
        known = [one for one in self.uncertainty if one.known]
        if not known:
            return []
        out = ["", f"  {DEFINITION}; not in it: rounding, repeatability, temperature"]
        return out + [line for one in known for line in one.to_text(SHOWN)]


def _tilt(deviation: Deviation) -> str:
    about_x, about_y = deviation.tilt_rms_urad
    return f"{about_x:.1f} / {about_y:.1f}"


def _um(value: float) -> str:
    return f"{value:8.3f} µm"
