"""Accounts of compensation tables, those made and those that a control has: their contents, the remaining error, how to load them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.files import check_writable, scratch_folder, write_atomic
from twin._common.provenance import ILLUSTRATIVE, warning_texts, warnings_to_json
from twin._common.records import APPROACH, json_form
from twin.compensation.tables.design import RequiredCorrections, Table
from twin.compensation.tables.make import ControlTables, design_of
from twin.compensation.tables.remains import CorrectedShare, RemainingErrors, corrected_shares, remaining_errors
from twin.controls import ControlSection, Correction, TableEntry, TableFormat, TableSum, format_named
from twin.display import readable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions, values_in_words

SCHEMA: Final = "twin.compensation.tables/1"
DONE_TWICE: Final = (
    "While these tables are switched on, compensate NC programs only with the calibration.yaml in this folder. It records what the "
    "control corrects itself; with the original calibration these errors would be corrected twice."
)

FROM_NOW_ON: Final = (
    "While these tables are switched on, use only the calibration.yaml in this folder for this machine. It records what the control "
    "corrects itself."
)


@final
@dataclass(frozen=True)
class Account:
    """Compensation tables, the error that remains with them, and the steps to load them."""

    made: ControlTables
    remains: RemainingErrors  # error at the tool without and with the tables
    carried: tuple[CorrectedShare, ...]  # every error of the calibration and whether the tables correct it
    # effects not included because a temperature or the time is not given, by channel
    missing: Mapping[str, tuple[str, ...]]
    errors: Calibration  # the calibration the tables were made from

    @property
    def source(self) -> str:
        """Path of the calibration, as text."""
        return str(self.errors.path or "no file: the nominal machine")

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        unmet = list(self.made.unmet)
        unmet += [
            f"not included: {', '.join(names)} ({channel} is not given)" for channel, names in self.missing.items()
        ]
        if self.remains.tables.rms_um > self.remains.before.rms_um:
            unmet.append("over the volume the error is larger with the tables than without them")
        return tuple(unmet)

    def to_text(self) -> str:
        """Return the text that is printed and written into the folder of the tables."""
        made, required = self.made, self.made.required
        request = made.request
        where = ", ".join(f"{name} {value:g}" for name, value in required.at.items())
        lines = [f"Compensation tables for {required.machine.name}: {request.kind}"]
        lines += warning_texts(self.errors.warnings)
        lines += [
            f"calibration: {self.source}",
            f"tool length {required.tool_length_mm:g} mm; positions of the other axes while one moves: {where}",
            f"files: {', '.join(made.files)}",
            "",
            *_rows(made.tables),
            "",
            "  Y by X: correction of Y as a function of the position of X; times Z: multiplied by the position of Z.\n"
            "  between nodes: largest deviation of the model from the interpolation between nodes.\n"
            "  read back: largest deviation of the file, read again, from the model at random positions; in brackets its limit.",
            "",
            *self.remains.to_lines(),
        ]
        lines += self._unproven()
        lines += ["", "Error motions", *_shares(self.carried), *self._limits()]
        lines += [
            "",
            "How to load the tables and switch them on",
            *(f"  {i}. {text}" for i, text in enumerate(self.load, start=1)),
        ]
        if made.increment:
            lines.append(
                "  These files contain the old and the new tables combined: load them in place of the old ones. The folder added/ "
                "holds the new part alone, which only twin needs: do not load it."
            )
        if request.form.unchecked:
            lines += ["", "NOT CHECKED against public documentation of the control:"]
            lines += [f"  - {text}" for text in request.form.unchecked]
        lines += ["", _trial(made), DONE_TWICE if required.machine.runs_programs else FROM_NOW_ON]
        if self.unmet:
            lines += ["", "Not met:", *(f"  - {text}" for text in self.unmet)]
        return "\n".join(lines) + "\n"

    def _unproven(self) -> list[str]:
        """Return the lines on tables whose U exceeds their correction."""
        made = self.made
        if not made.unproven:
            return []
        what = "WRITTEN ALTHOUGH" if made.request.unproven else "Not written, because"
        return [
            "",
            f"{what} U of the correction (95 %) exceeds the correction: not shown to be an improvement",
            *(f"  {one.text}" for one in made.unproven),
        ]

    @property
    def load(self) -> tuple[str, ...]:
        """Steps to load the tables into the control and switch them on."""
        return self.made.request.form.loading(self.made.correction, self.made.largest)

    def _limits(self) -> list[str]:
        """Return the lines that say for which axis positions and tool lengths the tables are valid."""
        made, limits = self.made, list[str]()
        if made.held:
            limits += [
                "",
                f"The tables are for {values_in_words(made.held)}, and do not follow them: at others make new tables.",
            ]
        if isinstance(made.correction, TableSum):
            products = any(len(term.factors) > 1 for term in made.correction.terms)
            limits += [
                "",
                "A table over one axis is exact where the other axes stand at the positions given above. Elsewhere an angular error "
                "adds its angle times the distance from there"
                + (": the products of tables correct this." if products else ", which remains uncorrected."),
            ]
        if not made.request.form.knows_machine:
            length = f"{made.required.tool_length_mm:g} mm"
            limits.append(
                f"The effect of angular errors depends on the tool length: for a length other than {length} make new tables."
            )
        return limits

    def to_dict(self) -> dict[str, Any]:
        """Return the account as JSON (``schema: twin.compensation.tables/1``)."""
        made, required = self.made, self.made.required
        return {
            "schema": SCHEMA,
            "machine": required.machine.name,
            "calibration": self.source,
            "illustrative": ILLUSTRATIVE in self.errors.warnings,
            "warnings": warnings_to_json(self.errors.warnings),
            "format": made.request.kind,
            "classes": list(made.request.carried_classes),
            "tool_length_mm": required.tool_length_mm,
            "at": dict(required.at),
            "conditions": dict(made.held),
            "files": list(made.files),
            "tables": [_row(table) for table in made.tables],
            "unproven_tables": [{**json_form(one), "written": made.request.unproven} for one in made.unproven],
            "error_at_tool": self.remains.to_dict(),
            "errors": json_form(self.carried),
            "unchecked": list(made.request.form.unchecked),
            "load": list(self.load),
            "unmet": list(self.unmet),
        }


def _row(one: Table) -> dict[str, Any]:
    """Return one table's row of the JSON; the keys carry the unit."""
    what = one.content
    return {
        "table": what.name,
        "from": what.low,
        "to": what.high,
        "nodes": what.nodes,
        "step": what.step,
        f"largest_{what.unit}": what.largest,
        f"between_nodes_{what.unit}": one.deviation,
        f"read_back_{what.unit}": one.read_back_deviation,
        f"allowed_{what.unit}": one.deviation + one.rounding,
        "holds": one.holds,
        "within_tolerance": one.within_tolerance,
    }


def _shares(carried: tuple[CorrectedShare, ...]) -> list[str]:
    """Return the error motions in three groups: corrected, corrected in part, not corrected; with the reasons."""
    titles = {"whole": "  corrected", "line": "  corrected in part", "no": "  not corrected"}
    shares = []
    for share, title in titles.items():
        by_reason: dict[str, list[str]] = {}
        for one in carried:
            if one.share == share:
                by_reason.setdefault(one.why, []).append(one.name)
        shares += [
            f"{title}: {' '.join(names)}" + (f" ({reason})" if reason else "") for reason, names in by_reason.items()
        ]
    return shares


def _trial(made: ControlTables) -> str:
    """Return the check on the machine that reveals a wrong sign; empty without a table."""
    # A gauge measures a displacement directly; an angular correction exists only for a rotary axis.
    tables = [table.content for table in made.tables if table.content.nodes]
    best = max(tables, key=lambda one: (one.unit == "um", one.largest), default=None)
    if best is None:
        return ""
    against = "dial gauge or interferometer" if best.unit == "um" else "reference encoder or polygon and autocollimator"
    return (
        f"Before cutting, check the sign with the largest correction ({best.name}, up to {best.largest:.1f} "
        f"{readable(best.unit)}): move the axis over its range and measure the error with a {against}, first with the tables "
        "off, then with the tables on. The error must become smaller. If it doubles, the control interprets the sign the opposite "
        "way: switch the tables off."
    )


def _rows(tables: Sequence[Table]) -> list[str]:
    """Return the tables as text, one line each below a header."""
    width = max([len(table.content.name) for table in tables] + [5])
    rows = [f"  {'table':<{width}}  {'range':>17}  nodes    step    largest   between nodes   read back   (allowed)"]
    for table in tables:
        what = table.content
        span = f"{what.low:g} … {what.high:g}"
        nodes = f"{what.nodes:>5}  {what.step:>6g}" if what.nodes else f"{'':>5}  {'':>6}"
        marks = ("" if table.holds else "  READ-BACK FAILED") + ("" if table.within_tolerance else "  ABOVE TOLERANCE")
        rows.append(
            f"  {what.name:<{width}}  {span:>17}  {nodes}  {what.largest:>8.2f}  {table.deviation:>14.3f}  "
            f"{table.read_back_deviation:>10.4f}  {table.deviation + table.rounding:>10.4f} {readable(what.unit)}{marks}"
        )
    return rows


# --- Write the output folder: the control's files, README.txt, and the calibration that records what the control corrects

README: Final = "README.txt"
CALIBRATION: Final = "calibration.yaml"
ADDED: Final = "added"


def outputs_of(folder: Path, kind: str, machine: Machine) -> list[Path]:
    """Return every file that may be written into a folder for a format."""
    names = format_named(kind).files(machine)
    return [folder / name for name in (*names, README, CALIBRATION)]


def written_by(made: ControlTables) -> tuple[str, ...]:
    """Return the names of the files written into the folder; other files in it do not belong to these tables."""
    return (*made.files, README, CALIBRATION, *([ADDED] if made.increment else []))


def account_of(
    made: ControlTables, errors: Calibration, known: Calibration, missing: Mapping[str, tuple[str, ...]]
) -> Account:
    """Return the account of tables, from the files as read back; ``missing``: effects that ``known`` leaves out, by channel."""
    with scratch_folder() as folder:
        section = _section(made, _write(made.increment or made.files, folder, made.request.form))
        remaining = remaining_errors(made.required, known.with_control(section))
    request = made.request
    return Account(
        made,
        remaining,
        corrected_shares(
            made.required,
            replace(request, products=request.products and not made.left_out),
            design_of(request.form),
            made.unproven,
        ),
        missing,
        errors,
    )


def write_folder(
    made: ControlTables,
    errors: Calibration,
    known: Calibration,
    missing: Mapping[str, tuple[str, ...]],
    folder: Path,
    *,
    alone: bool = True,
) -> Account:
    """Write the folder, `calibration.yaml` last; ``alone``: whether these tables are all that is written.

    Raises:
        InputError: an output is also an input, or cannot be written; the machine would be worse with the tables alone, and
            ``unproven`` is not set in the request.
    """
    outputs = outputs_of(folder, made.request.kind, made.required.machine)
    inputs = [errors.path] if errors.path is not None else []
    inputs += [entry.file for entry in errors.control.tables] if errors.control is not None and made.increment else []
    for path in outputs:
        if path.resolve() in {one.resolve() for one in inputs}:
            raise InputError("an output is one of the inputs", expected="another folder", file=path)
    account = account_of(made, errors, known, missing)
    before, after = account.remains.before.rms_um, account.remains.tables.rms_um
    if alone and after > before and not made.request.unproven:
        # Tables are proven one by one, and errors that cancel may have only one of theirs proven.
        rest = len(made.unproven)
        unproven = f"; {rest} more not written, as U exceeds their correction" if rest else ""
        raise InputError(
            f"the error over the volume is larger with these tables than without them{unproven}",
            expected="a calibration with smaller uncertainties, or the tables all the same",
            file=errors.path,
            value=f"{after:.1f} um for {before:.1f} um RMS",
            setting="force",
        )
    folder.mkdir(parents=True, exist_ok=True)
    paths = _write(made.files, folder, made.request.form)
    if made.increment:
        (folder / ADDED).mkdir(exist_ok=True)
        check_writable([folder / ADDED / name for name in made.increment])
        paths = _write(made.increment, folder / ADDED, made.request.form)
    write_atomic(folder / README, account.to_text())
    marked = replace(errors, source=f"{errors.source}; the control has compensation tables ({made.request.kind})")
    section = _section(made, paths)
    # Kinematics that the control holds already stay as they are.
    held = () if errors.control is None else errors.control.kinematics
    marked.with_control(replace(section, kinematics=held)).save(folder / CALIBRATION)
    return account


def _write(files: Mapping[str, str], folder: Path, form: TableFormat[Any]) -> list[Path]:
    """Write the files and return the paths of those that are read back."""
    for name, text in files.items():
        write_atomic(folder / name, text)
    return [folder / name for name in form.to_read(files)]


def _section(made: ControlTables, paths: Sequence[Path]) -> ControlSection:
    """Return the ``control:`` section of the calibration for these table files."""
    request = made.request
    return ControlSection(
        "uncorrected",
        tuple(TableEntry.of(path, request.kind, request.carried_classes) for path in paths),
        tool_length_mm=made.required.tool_length_mm,
    )


# --- Existing tables of a control, compared with a calibration ------------------------------------

POSITIONS = 1001


@final
@dataclass(frozen=True)
class Difference:
    """Correction of one axis along the range of another, compared with the correction the model requires."""

    moved: str  # the axis that is corrected
    along: str  # the axis that moves; all others stand still
    unit: str  # ``um`` or ``urad``
    largest: float  # largest correction in the tables
    differs: float  # largest difference from the model's correction
    constant: float  # mean of the difference


@final
@dataclass(frozen=True)
class Existing:
    """Existing tables compared with a calibration."""

    kind: str  # name of the format
    files: tuple[Path, ...]  # the files that were read
    correction: Correction  # corrections in the tables
    calibration: Calibration  # the calibration they are compared with
    required: RequiredCorrections  # corrections that the calibration requires
    differences: tuple[Difference, ...]  # differences between the two, along every axis
    # error at the tool over the volume; None if the calibration was measured with tables on
    remains: RemainingErrors | None

    @property
    def source(self) -> str:
        """Path of the calibration, as text."""
        return str(self.calibration.path or "the nominal machine")

    def to_text(self) -> str:
        """Return the text that is printed."""
        where = ", ".join(f"{name} {value:g}" for name, value in self.required.at.items())
        contents = self.correction.contents()
        width = max([len(content.name) for content in contents] + [5])
        lines = [f"{self.kind}: {', '.join(file.name for file in self.files)}"]
        lines += [
            f"  {content.name:<{width}}  {content.low:g} … {content.high:g}, {content.nodes} nodes, step {content.step:g}, "
            f"largest {content.largest:.3f} {readable(content.unit)}"
            for content in contents
        ]
        lines += [
            "",
            f"Compared with {self.source}; tool length {self.required.tool_length_mm:g} mm, the other axes at {where}",
        ]
        lines += [f"  {text}" for text in warning_texts(self.calibration.warnings)]
        if self.remains is None:
            lines.append(
                "  This calibration was measured with tables switched on: it requires only what is still to be added, so the "
                "differences do not show whether these tables are right."
            )
        lines.append("  moved  along   largest correction  difference   of which constant")
        lines += [
            f"  {difference.moved:<5}  {difference.along:<5}  {difference.largest:>12.2f} {readable(difference.unit):<6}  "
            f"{difference.differs:>10.2f}  {difference.constant:>18.2f}"
            for difference in self.differences
        ]
        if self.remains is not None:
            found = self.remains
            lines += ["", *found.to_lines()]
            if found.tables.rms_um > found.before.rms_um:
                lines.append(
                    "  According to this calibration the machine is worse with these tables: wrong sign, axes or machine."
                )
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as JSON (``schema: twin.compensation.tables-read/1``)."""
        return {
            "schema": "twin.compensation.tables-read/1",
            "format": self.kind,
            "files": [str(file) for file in self.files],
            "tables": json_form(self.correction.contents()),
            "calibration": self.source,
            "calibration_errors_are_remaining": self.remains is None,
            "illustrative": ILLUSTRATIVE in self.calibration.warnings,
            "warnings": warnings_to_json(self.calibration.warnings),
            "tool_length_mm": self.required.tool_length_mm,
            "at": dict(self.required.at),
            "differences": json_form(self.differences),
            "error_at_tool": None if self.remains is None else self.remains.to_dict(),
        }


def compare_tables(
    machine: Machine,
    calibration: Calibration,
    kind: str,
    files: Sequence[Path],
    at: Mapping[str, float],
    tool_length_mm: float | None,
    conditions: Conditions,
) -> Existing:
    """Read tables and compare them with a calibration; ``at``: positions of the other axes; `InputError` as of the format."""
    form = format_named(kind)
    correction = form.read(files, machine)
    remaining = calibration.control is not None and calibration.control.errors_are == "remaining"
    required = RequiredCorrections(machine, calibration, at, tool_length_mm, frozenset(BASIC), conditions)
    section = ControlSection("uncorrected", tuple(TableEntry.of(file, kind, ()) for file in files))
    error = None if remaining else remaining_errors(required, calibration.with_control(section))
    return Existing(
        kind, tuple(files), correction, calibration, required, _differences(correction, required, form), error
    )


def _differences(
    correction: Correction, required: RequiredCorrections, form: TableFormat[Any]
) -> tuple[Difference, ...]:
    """Return the differences between tables and model, for every corrected axis along every axis."""
    machine = required.machine
    linear = [machine.axes[i].name for i in machine.linear]
    # Tables of single axes correct errors of the linear axes only; a control with a kinematic model also those of rotary axes.
    about = tuple(machine.names) if form.knows_machine else tuple(linear)
    differences = []
    for axis, moved in product(machine.axes, (machine.by_name[name] for name in correction.axes)):
        if moved.name != axis.name and not (moved.linear and (axis.linear or form.knows_machine)):
            continue
        q = np.linspace(*required.range_of(axis), POSITIONS)
        line = required.positions_along(axis, q)
        said, off = [], []
        for side in (1, -1):
            state: dict[str, Any] = dict(zip(machine.names, line.T, strict=True))
            state |= {f"{APPROACH}{name}": np.full(POSITIONS, float(side)) for name in machine.names}
            said.append(np.broadcast_to(correction.shift(moved.name, state), POSITIONS))
            wants = (
                required.linear_corrections(about, line, side)[:, linear.index(moved.name)] if moved.linear else None
            )
            off.append(said[-1] - (required.rotary_correction(moved, q, side) if wants is None else wants))
        largest, differs = (float(np.abs(one).max()) for one in (said, off))
        unit = "um" if moved.linear else "urad"
        differences.append(Difference(moved.name, axis.name, unit, largest, differs, float(np.mean(off))))
    return tuple(differences)
