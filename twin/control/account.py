"""What was made, what it leaves and how to load it: as text and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, final

from twin._common.provenance import ILLUSTRATIVE, SourceWarning, texts, to_json
from twin.control.loading import rows, steps, trial
from twin.control.make import Made, Table, classes_of
from twin.control.remains import Carried, Remains

SCHEMA: Final = "twin.control/1"
DONE_TWICE: Final = (
    "Programs: with these tables on, compensate them with the calibration.yaml of this folder and no other. It says what the "
    "control takes out by "
    "itself; with the one it was made from the errors would be taken out twice."
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
        source: the calibration's file.
        warnings: of where its numbers come from.
    """

    made: Made
    remains: Remains
    carried: tuple[Carried, ...]
    missing: Mapping[str, tuple[str, ...]]
    source: str
    warnings: tuple[SourceWarning, ...]

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
        lines += texts(self.warnings)
        lines += [
            f"from {self.source}",
            f"tool length {wanted.tool_length_mm:g} mm, the other axes at {where}",
            f"files: {', '.join(made.files)}",
            "",
            *rows(made.tables),
            "",
            "  between nodes: how far the model is at most from the straight lines; read back: how far the file, read again, was "
            "from the model at places drawn.",
            "",
            *self.remains.to_lines(),
        ]
        lines += ["", "Error motions", *_shares(self.carried)]
        if request.kind in ("linuxcnc", "heidenhain", "siemens"):
            lines += [
                "",
                "A table of one axis over another is right where the other axes stand as above. What an angular error makes "
                "elsewhere is its angle times the "
                "distance from there"
                + (
                    ", which the products carry."
                    if any(" times " in one.name for one in made.tables)
                    else ": it stays."
                ),
            ]
        if request.kind in ("linuxcnc", "heidenhain", "siemens", "grid"):
            lines.append(
                f"Angular errors change with the tool: for another length than {wanted.tool_length_mm:g} mm make the tables again."
            )
        lines += ["", "To load and switch on", *(f"  {i}. {text}" for i, text in enumerate(steps(made), start=1))]
        if made.increment:
            lines.append(
                "  These files are the old tables and the new ones together: load them in place of the old ones. added/ has the "
                "new part alone, for twin."
            )
        if made.unchecked:
            lines += [
                "",
                "NOT CHECKED against a public description of the control:",
                *(f"  - {text}" for text in made.unchecked),
            ]
        lines += ["", trial(made), DONE_TWICE if wanted.machine.runs_programs else FROM_NOW_ON]
        if self.unmet:
            lines += ["", "Not met:", *(f"  - {text}" for text in self.unmet)]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        made, wanted = self.made, self.made.wanted
        return {
            "schema": SCHEMA,
            "machine": wanted.machine.name,
            "calibration": self.source,
            "illustrative": ILLUSTRATIVE in self.warnings,
            "warnings": to_json(self.warnings),
            "format": made.request.kind,
            "classes": list(classes_of(made.request.kind, sorted(made.request.classes))),
            "tool_length_mm": wanted.tool_length_mm,
            "at": dict(wanted.at),
            "files": list(made.files),
            "tables": [row(one) for one in made.tables],
            "error_at_tool": self.remains.to_dict(),
            "errors": [asdict(one) for one in self.carried],
            "unchecked": list(made.unchecked),
            "load": list(steps(made)),
            "unmet": list(self.unmet),
        }


def row(one: Table) -> dict[str, Any]:
    """A table, units in its names."""
    return {
        "table": one.name,
        "from": one.low,
        "to": one.high,
        "nodes": one.nodes,
        "step": one.step,
        f"largest_{one.unit}": one.peak,
        f"between_nodes_{one.unit}": one.off,
        f"read_back_{one.unit}": one.back,
        f"allowed_{one.unit}": one.off + one.rounding,
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
