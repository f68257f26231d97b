"""What a comparison of two calibrations found, as one immutable value."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.json_form import json_form
from twin._common.provenance import ILLUSTRATIVE, SourceWarning, to_json
from twin.comparison.pairs import Apart, Status
from twin.comparison.significance import FALSE_ALARMS, SHARE
from twin.comparison.tool import ToolChange
from twin.display import card, finite, first_rows, measured, note, pairs, readable, table
from twin.machine.machine import Machine

SCHEMA: Final = "twin.comparison/1"
Verdict = Literal["same", "unchanged", "changed", "reworded", "unknown"]
AT_TOOL: Final = MappingProxyType(
    {
        "judged": "judged_aligned",
        "by_class": "by_class_aligned",
        "by_cause": "fewest_alone_aligned",
        "by_error": "by_error_aligned",
    }
)
"""Names in JSON of what is looked at after the workpiece has been aligned."""
CANCELLED: Final = 0.05
"""Changes that leave no more than this part of their own sizes at the tool take each other away there."""


@final
@dataclass(frozen=True)
class ErrorChange:
    """The change of one error, second calibration less first.

    Attributes:
        name: ISO 230-1 name, or the effect's own.
        kind: ``curve``, ``number`` (squareness, location) or ``effect``.
        iso_class: class of ISO/TR 16907.
        axis: the axis it belongs to.
        unit: ``um`` or ``urad``; of an effect, of the number ``label``.
        status: ``known``; ``same``: the very same numbers; ``unknown``: how uncertain it is is not known on both sides.
        label: of an effect, which of its numbers ``largest`` is of: the one that is most standard uncertainties off.
        rms: of a curve over what both cover; else the amount of ``largest``.
        largest: the largest change of a curve with its sign, or the change of the number.
        at: position of the axis at which it is, mm or degrees; NaN unless a curve.
        u: standard uncertainty (k = 1) of ``largest``; NaN if unknown.
        band: half width at ``at`` of the band that holds the whole curve with 95 % probability; of a number 1.96 u; NaN if unknown.
        p_value: of a change that large or larger in χ² if it has not changed; NaN if unknown.
        p_adjusted: the same, for as many errors as were judged (Holm).
        fixed: largest change along what neither calibration gives an uncertainty for, in ``unit``: zero if none.
        notes: what was assumed.
    """

    name: str
    kind: Literal["curve", "number", "effect"]
    iso_class: str
    axis: str
    unit: str
    status: Status
    label: str
    rms: float
    largest: float
    at: float
    u: float
    band: float
    p_value: float
    p_adjusted: float
    fixed: float
    notes: tuple[str, ...]

    @property
    def significant(self) -> bool | None:
        """Whether it changed, as seen by itself, false alarms counted over all errors; None if it cannot be told."""
        if self.status == "same":
            return False
        return None if self.status == "unknown" else self.p_adjusted <= SHARE

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null where it is unknown."""
        renamed = {"name": "error", "iso_class": "class", "label": "number", "band": "band95"}
        found = json_form(self, rename=renamed, leave_out=("fixed", "notes"))
        return found | {
            "number": self.label or None,
            "significant": self.significant,
            "without_uncertainty": self.fixed,
            "notes": list(self.notes),
        }


@final
@dataclass(frozen=True)
class Culprits:
    """The fewest errors that account for the change, all others taken as unchanged.

    Attributes:
        errors: strongest first, their change estimated so; ``p_adjusted`` counts all that was tried.
        alternatives: of each, the errors that would do as well in its place.
        trends: of each, how it goes along its axis: ``constant``, ``line``, ``bow``, ``turn`` (once round), or empty.
        left_p_value: of what they leave; NaN if nothing could be judged.
        shows_from: of squareness and locations, with their unit: from which size on a change of it alone, all else unchanged, is seen
            in 19 of 20 comparisons.
    """

    errors: tuple[ErrorChange, ...]
    alternatives: tuple[tuple[str, ...], ...]
    trends: tuple[str, ...]
    left_p_value: float
    shows_from: tuple[tuple[str, float, str], ...] = ()


@final
@dataclass(frozen=True)
class Changes:
    """What changed between two calibrations of one machine.

    Attributes:
        machine: the machine.
        first, second: what the two are called (their files).
        errors: change of each error that both have, seen by itself.
        apart: errors that could not be compared, with the reason.
        joint_p_value, joint_dof: χ² of all known changes together; NaN and 0 if none is known.
        culprits: the fewest errors that account for it.
        tool: the change at the tool.
        tolerance_mm: what the older calibration may leave; None if nobody said.
        left_out: effects the comparison at the tool leaves out, with the channels they need.
        notices: what holds for all of it.
        meaning: what it means, in sentences.
        warnings: of where the numbers of either come from.
    """

    machine: Machine
    first: str
    second: str
    errors: tuple[ErrorChange, ...]
    apart: tuple[Apart, ...]
    joint_p_value: float
    joint_dof: int
    culprits: Culprits
    tool: ToolChange
    tolerance_mm: float | None
    left_out: tuple[tuple[str, str], ...]
    notices: tuple[str, ...]
    meaning: tuple[str, ...] = ()
    warnings: tuple[SourceWarning, ...] = ()

    @property
    def illustrative(self) -> bool:
        """Whether either has curves that are drawn, not measured."""
        return ILLUSTRATIVE in self.warnings

    @cached_property
    def seen_by(self) -> tuple[str, ...]:
        """Which of the four looks see a change: ``all together``, ``error by error``, ``fewest errors``, ``tool``."""
        found = []
        if self.joint_p_value <= SHARE:
            found.append("all together")
        if any(error.significant for error in self.errors):
            found.append("error by error")
        if self.culprits.errors:
            found.append("fewest errors")
        if self.tool.judged is not None:
            rows = (self.tool.judged, *self.tool.by_class.values())
            if any(row.rms_um > row.limit_um for row in rows):
                found.append("tool")
        return tuple(found)

    @property
    def verdict(self) -> Verdict:
        """``changed`` if any look sees it; ``unchanged``; ``unknown`` if nothing could be judged; ``same``: the very same numbers.

        ``reworded``: the numbers changed and the tool did not; one error takes away what another adds, as where a constant stands
        under another name.
        """
        if self.seen_by:
            return "reworded" if self._cancelled else "changed"
        if not self.apart and all(error.status == "same" for error in self.errors):
            return "same"
        return "unchanged" if any(error.status == "known" for error in self.errors) else "unknown"

    @cached_property
    def _cancelled(self) -> bool:
        tool = self.tool
        if tool.judged is None or self.unjudged or tool.judged.rms_um > tool.judged.limit_um:
            return False
        names = {error.name for error in (*self.errors, *self.culprits.errors) if error.significant}
        alone = np.sqrt(sum(tool.by_error[name].rms_um ** 2 for name in names))
        return len(names) > 1 and bool(tool.judged.rms_um <= CANCELLED * alone)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Errors whose change could not be compared or judged: exit status 3 on the command line."""
        return (
            *(one.name for one in self.apart),
            *(error.name for error in self.errors if error.status == "unknown" or error.fixed > 0.0),
            *(name for name, _ in self.left_out),
        )

    @property
    def good_enough(self) -> bool | None:
        """Whether the older calibration leaves no more than the tolerance on the machine of the newer; None if it cannot be told."""
        return None if self.tolerance_mm is None else self.tool.left.enough(self.tolerance_mm * 1e3)

    def to_dict(self) -> dict[str, Any]:
        """For JSON (``schema: twin.comparison/1``); null where something is unknown."""
        culprits = self.culprits
        return {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "first": self.first,
            "second": self.second,
            "illustrative": self.illustrative,
            "warnings": to_json(self.warnings),
            "verdict": self.verdict,
            "seen_by": list(self.seen_by),
            "false_alarms": {"of_all": FALSE_ALARMS, "of_each_look": SHARE},
            "joint": {"p_value": finite(self.joint_p_value), "dof": self.joint_dof},
            "meaning": list(self.meaning),
            "errors": [error.to_dict() for error in self.errors],
            "fewest": {
                "errors": [
                    {**error.to_dict(), "alternatives": list(others), "trend": trend or None}
                    for error, others, trend in zip(
                        culprits.errors, culprits.alternatives, culprits.trends, strict=True
                    )
                ],
                "left_p_value": finite(culprits.left_p_value),
                "shows_from": [{"error": name, "size": size, "unit": unit} for name, size, unit in culprits.shows_from],
            },
            "not_compared": [json_form(one, rename={"name": "error"}) for one in self.apart],
            "left_out_at_tool": [{"effect": name, "needs": needs} for name, needs in self.left_out],
            "tool": json_form(self.tool, rename=AT_TOOL, leave_out=("left",)),
            "first_compensating_second": {
                **json_form(self.tool.left),
                "tolerance_mm": self.tolerance_mm,
                "good_enough": self.good_enough,
            },
            "unjudged": list(self.unjudged),
            "notices": list(self.notices),
        }

    def _repr_html_(self) -> str:
        other = [error for error in self.errors if error.status != "same"]
        other.sort(key=lambda error: (not error.significant, -self._alone_um(error)))
        shown, more = first_rows(len(other), lambda i: self._cells(other[i]))
        whole = self.tool.everything_aligned
        headers = ("error", "class", "largest change", "beyond chance", "at the tool, µm RMS")
        return card(
            self.verdict.upper(),
            *(note(sentence) for sentence in self.meaning),
            pairs(
                [
                    ("at the tool, aligned anew", f"{whole.rms_um:.3g} µm RMS, {whole.max_um:.3g} µm largest"),
                    ("could not be compared or judged", ", ".join(self.unjudged)),
                ]
            ),
            table(headers, shown, right=(4,)),
            more,
            small=f"{self.second} less {self.first}",
            illustrative=self.illustrative,
            wrong=bool(self.unjudged),
        ).text

    def _cells(self, error: ErrorChange) -> tuple[str, ...]:
        return (
            error.name,
            error.iso_class,
            measured(error.largest, error.u, readable(error.unit)),
            "unknown" if error.significant is None else "yes" if error.significant else "no",
            f"{self._alone_um(error):.3g}" if error.name in self.tool.by_error else "",
        )

    def _alone_um(self, error: ErrorChange) -> float:
        """RMS at the tool of an error alone, as far as it was judged."""
        found = self.tool.by_error.get(error.name)
        return 0.0 if found is None else found.rms_um
