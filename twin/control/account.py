"""Account of compensation tables: what they contain, which error remains, how to load them; as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

from twin._common.json_form import json_form
from twin._common.provenance import ILLUSTRATIVE, warning_texts, warnings_to_json
from twin.control.design import Table
from twin.control.make import ControlTables
from twin.control.remains import CorrectedShare, RemainingErrors
from twin.machine.calibration import Calibration
from twin.machine.conditions import values_in_words
from twin.machine.control import TableSum

SCHEMA: Final = "twin.control/1"
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
    """Compensation tables, the error that remains with them, and the steps to load them.

    Attributes:
        made: the tables.
        remains: error at the tool without and with the tables.
        carried: every error of the calibration and whether the tables correct it.
        missing: effects not included because a temperature or the time is not given, by channel.
        errors: the calibration the tables were made from.
    """

    made: ControlTables
    remains: RemainingErrors
    carried: tuple[CorrectedShare, ...]
    missing: Mapping[str, tuple[str, ...]]
    errors: Calibration

    @property
    def source(self) -> str:
        """Path of the calibration, as text."""
        return str(self.errors.path or "no file: the nominal machine")

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        found = list(self.made.unmet)
        found += [
            f"not included: {', '.join(names)} ({channel} is not given)" for channel, names in self.missing.items()
        ]
        if self.remains.tables.rms_um > self.remains.before.rms_um:
            found.append("over the volume the error is larger with the tables than without them")
        return tuple(found)

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
        made, found = self.made, list[str]()
        if made.held:
            found += [
                "",
                f"The tables are for {values_in_words(made.held)}, and do not follow them: at others make new tables.",
            ]
        if isinstance(made.correction, TableSum):
            products = any(len(term.factors) > 1 for term in made.correction.terms)
            found += [
                "",
                "A table over one axis is exact where the other axes stand at the positions given above. Elsewhere an angular error "
                "adds its angle times the distance from there"
                + (": the products of tables correct this." if products else ", which remains uncorrected."),
            ]
        if not made.request.form.knows_machine:
            length = f"{made.required.tool_length_mm:g} mm"
            found.append(
                f"The effect of angular errors depends on the tool length: for a length other than {length} make new tables."
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the account as JSON (``schema: twin.control/1``)."""
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
            "tables": [_row(one) for one in made.tables],
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
    found = []
    for share, title in titles.items():
        by_reason: dict[str, list[str]] = {}
        for one in carried:
            if one.share == share:
                by_reason.setdefault(one.why, []).append(one.name)
        found += [
            f"{title}: {' '.join(names)}" + (f" ({reason})" if reason else "") for reason, names in by_reason.items()
        ]
    return found


def _trial(made: ControlTables) -> str:
    """Return the check on the machine that reveals a wrong sign; empty without a table."""
    # A gauge measures a displacement directly; an angular correction exists only for a rotary axis.
    tables = [one.content for one in made.tables if one.content.nodes]
    best = max(tables, key=lambda one: (one.unit == "um", one.largest), default=None)
    if best is None:
        return ""
    against = "dial gauge or interferometer" if best.unit == "um" else "reference encoder or polygon and autocollimator"
    return (
        f"Before cutting, check the sign with the largest correction ({best.name}, up to {best.largest:.1f} "
        f"{displayed_unit(best.unit)}): move the axis over its range and measure the error with a {against}, first with the tables "
        "off, then with the tables on. The error must become smaller. If it doubles, the control interprets the sign the opposite "
        "way: switch the tables off."
    )


def displayed_unit(unit: str) -> str:
    """Return a unit as displayed: ``µm`` for ``um``."""
    return unit.replace("u", "µ", 1)


def _rows(tables: Sequence[Table]) -> list[str]:
    """Return the tables as text, one line each below a header."""
    width = max([len(one.content.name) for one in tables] + [5])
    found = [f"  {'table':<{width}}  {'range':>17}  nodes    step    largest   between nodes   read back   (allowed)"]
    for one in tables:
        what = one.content
        span = f"{what.low:g} … {what.high:g}"
        nodes = f"{what.nodes:>5}  {what.step:>6g}" if what.nodes else f"{'':>5}  {'':>6}"
        marks = ("" if one.holds else "  READ-BACK FAILED") + ("" if one.within_tolerance else "  ABOVE TOLERANCE")
        found.append(
            f"  {what.name:<{width}}  {span:>17}  {nodes}  {what.largest:>8.2f}  {one.deviation:>14.3f}  "
            f"{one.read_back_deviation:>10.4f}  {one.deviation + one.rounding:>10.4f} {displayed_unit(what.unit)}{marks}"
        )
    return found
