"""What was made, what it leaves and how to load it: as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

from twin._common.json_form import json_form
from twin._common.provenance import ILLUSTRATIVE, texts, to_json
from twin.control.design import Table
from twin.control.make import Made
from twin.control.remains import Carried, Remains
from twin.machine.calibration import Calibration
from twin.machine.control import Terms

SCHEMA: Final = "twin.control/1"
DONE_TWICE: Final = (
    "Programs: with these tables on, compensate them with the calibration.yaml of this folder and no other. It says what the "
    "control takes out by itself; with the one it was made from the errors would be taken out twice."
)

FROM_NOW_ON: Final = (
    "With these tables on, the calibration.yaml of this folder is the machine's and no other: it says what the control takes out by "
    "itself."
)


@final
@dataclass(frozen=True)
class Account:
    """All there is to say.

    Attributes:
        made: the tables.
        remains: what they leave at the tool.
        carried: every error of the calibration.
        missing: effects left out for want of a temperature or the time, by the channel.
        errors: the calibration they were made from.
    """

    made: Made
    remains: Remains
    carried: tuple[Carried, ...]
    missing: Mapping[str, tuple[str, ...]]
    errors: Calibration

    @property
    def source(self) -> str:
        """The calibration's file."""
        return str(self.errors.path or "no file: the machine as drawn")

    @property
    def unmet(self) -> tuple[str, ...]:
        """What could not be met."""
        found = list(self.made.unmet)
        found += [f"left out: {', '.join(names)} (needs {channel})" for channel, names in self.missing.items()]
        if self.remains.tables.rms_um > self.remains.before.rms_um:
            found.append("over the volume the tables leave more than there was before")
        return tuple(found)

    def to_text(self) -> str:
        """As the account is printed and written beside the files."""
        made, wanted = self.made, self.made.wanted
        request = made.request
        where = ", ".join(f"{name} {value:g}" for name, value in wanted.at.items())
        lines = [f"Compensation tables for {wanted.machine.name}: {request.kind}"]
        lines += texts(self.errors.warnings)
        lines += [
            f"from {self.source}",
            f"tool length {wanted.tool_length_mm:g} mm, the other axes at {where}",
            f"files: {', '.join(made.files)}",
            "",
            *_rows(made.tables),
            "",
            "  between nodes: how far the model is at most from the straight lines; read back: how far the file, read again, was "
            "from the model at places drawn.",
            "",
            *self.remains.to_lines(),
        ]
        lines += ["", "Error motions", *_shares(self.carried), *self._limits()]
        lines += ["", "To load and switch on", *(f"  {i}. {text}" for i, text in enumerate(self.load, start=1))]
        if made.increment:
            lines.append(
                "  These files are the old tables and the new ones together: load them in place of the old ones. added/ has the "
                "new part alone, for twin."
            )
        if request.form.unchecked:
            lines += ["", "NOT CHECKED against a public description of the control:"]
            lines += [f"  - {text}" for text in request.form.unchecked]
        lines += ["", _trial(made), DONE_TWICE if wanted.machine.runs_programs else FROM_NOW_ON]
        if self.unmet:
            lines += ["", "Not met:", *(f"  - {text}" for text in self.unmet)]
        return "\n".join(lines) + "\n"

    @property
    def load(self) -> tuple[str, ...]:
        """How the tables get into the control, step by step."""
        return self.made.request.form.loading(self.made.correction, self.made.largest)

    def _limits(self) -> list[str]:
        """Where the tables are right."""
        made, found = self.made, list[str]()
        if isinstance(made.correction, Terms):
            products = any(len(term.factors) > 1 for term in made.correction.terms)
            found += [
                "",
                "A table of one axis over another is right where the other axes stand as above. What an angular error makes "
                "elsewhere is its angle times the distance from there"
                + (", which the products carry." if products else ": it stays."),
            ]
        if not made.request.form.knows_machine:
            length = f"{made.wanted.tool_length_mm:g} mm"
            found.append(
                f"Angular errors change with the tool: for another length than {length} make the tables again."
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        made, wanted = self.made, self.made.wanted
        return {
            "schema": SCHEMA,
            "machine": wanted.machine.name,
            "calibration": self.source,
            "illustrative": ILLUSTRATIVE in self.errors.warnings,
            "warnings": to_json(self.errors.warnings),
            "format": made.request.kind,
            "classes": list(made.request.carried_classes),
            "tool_length_mm": wanted.tool_length_mm,
            "at": dict(wanted.at),
            "files": list(made.files),
            "tables": [_row(one) for one in made.tables],
            "error_at_tool": self.remains.to_dict(),
            "errors": json_form(self.carried),
            "unchecked": list(made.request.form.unchecked),
            "load": list(self.load),
            "unmet": list(self.unmet),
        }


def _row(one: Table) -> dict[str, Any]:
    """A table, units in its names."""
    what = one.content
    return {
        "table": what.name,
        "from": what.low,
        "to": what.high,
        "nodes": what.nodes,
        "step": what.step,
        f"largest_{what.unit}": what.largest,
        f"between_nodes_{what.unit}": one.off,
        f"read_back_{what.unit}": one.back,
        f"allowed_{what.unit}": one.off + one.rounding,
        "holds": one.holds,
        "within_tolerance": one.fine,
    }


def _shares(carried: tuple[Carried, ...]) -> list[str]:
    titles = {"whole": "  taken out", "line": "  taken out in part", "no": "  not taken out"}
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


def _trial(made: Made) -> str:
    """The check on the machine that shows a sign the wrong way round."""
    # A shift shows by itself; an angle alone only of a rotary axis.
    tables = [one.content for one in made.tables if one.content.nodes]
    best = max(tables, key=lambda one: (one.unit == "um", one.largest), default=None)
    if best is None:
        return ""
    against = "dial gauge or interferometer" if best.unit == "um" else "reference encoder or polygon and autocollimator"
    return (
        f"Before cutting: drive the axis with the largest correction ({best.name}, up to {best.largest:.1f} "
        f"{unit_shown(best.unit)}) against a {against} with the tables off and on. The error must become smaller. If it doubles, "
        "the control reads the sign the other way round: switch the tables off."
    )


def unit_shown(unit: str) -> str:
    """``µm`` of ``um``."""
    return unit.replace("u", "µ", 1)


def _rows(tables: Sequence[Table]) -> list[str]:
    """The tables, a line each."""
    width = max([len(one.content.name) for one in tables] + [5])
    found = [f"  {'table':<{width}}  {'range':>17}  nodes    step    largest   between nodes   read back   (allowed)"]
    for one in tables:
        what = one.content
        span = f"{what.low:g} … {what.high:g}"
        nodes = f"{what.nodes:>5}  {what.step:>6g}" if what.nodes else f"{'':>5}  {'':>6}"
        marks = ("" if one.holds else "  NOT WHAT WAS MEANT") + ("" if one.fine else "  ABOVE TOLERANCE")
        found.append(
            f"  {what.name:<{width}}  {span:>17}  {nodes}  {what.largest:>8.2f}  {one.off:>14.3f}  {one.back:>10.4f}  "
            f"{one.off + one.rounding:>10.4f} {unit_shown(what.unit)}{marks}"
        )
    return found
