"""The result of a comparison of two calibrations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.provenance import ILLUSTRATIVE, SourceWarning, warnings_to_json
from twin._common.records import json_form
from twin.display import finite_or_none, first_rows, measured, note, readable, table
from twin.display.results import Display, DisplayedResult
from twin.machine.machine import Machine
from twin.monitoring.pairs import FALSE_ALARMS, FALSE_ALARMS_OF_A_TEST, NotCompared, Status
from twin.monitoring.tool import ToolChange

SCHEMA: Final = "twin.monitoring/1"
Verdict = Literal["same", "unchanged", "changed", "reworded", "unknown"]
AT_TOOL: Final = MappingProxyType(
    {
        "judged": "judged_aligned",
        "by_class": "by_class_aligned",
        "by_cause": "fewest_alone_aligned",
        "by_error": "by_error_aligned",
    }
)
"""Keys in JSON of results after aligning the workpiece."""
CANCELLED_RATIO: Final = 0.05
"""Ratio of the joint effect of changes at the tool to their single effects below which they cancel."""


@final
@dataclass(frozen=True)
class ErrorChange:
    """The change of one error, second calibration less first."""

    name: str  # ISO 230-1 name, or the effect's own
    kind: Literal["curve", "number", "effect"]  # ``curve``, ``number`` (squareness, location) or ``effect``
    iso_class: str  # class of ISO/TR 16907
    axis: str
    unit: str  # for an effect, that of the number ``label``
    status: Status  # ``known``; ``same``: identical numbers; ``unknown``: a calibration does not state its uncertainty
    label: str  # for an effect, the number that ``largest`` belongs to: the one with the largest change in standard uncertainties
    rms: float  # of a curve, over the common part of both domains; else the absolute value of ``largest``
    largest: float  # the largest change of a curve with its sign, or the change of the number
    at: float  # position of the axis of the largest change, mm or degrees; NaN unless a curve
    u: float  # standard uncertainty (k = 1) of ``largest``; NaN if unknown
    band: float  # half width at ``at`` of the simultaneous 95 % band of the whole curve; for a number 1.96 u; NaN if unknown.
    p_value: float  # of the χ² of the change; NaN if unknown
    p_adjusted: float  # p-value corrected for the number of errors tested (Holm)
    without_variance: float  # largest change in directions without an uncertainty, in ``unit``; zero if none
    notes: tuple[str, ...]  # assumptions made

    @property
    def significant(self) -> bool | None:
        """Return whether the change is significant by itself, corrected for the number of errors; None if unknown."""
        if self.status == "same":
            return False
        return None if self.status == "unknown" else self.p_adjusted <= FALSE_ALARMS_OF_A_TEST

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON; null for unknown values."""
        renamed = {"name": "error", "iso_class": "class", "label": "number", "band": "band95"}
        entry = json_form(self, rename=renamed, leave_out=("without_variance", "notes"))
        return entry | {
            "number": self.label or None,
            "significant": self.significant,
            "without_uncertainty": self.without_variance,
            "notes": list(self.notes),
        }


@final
@dataclass(frozen=True)
class Culprits:
    """The smallest set of errors that explains the change, all others taken as unchanged."""

    errors: tuple[ErrorChange, ...]  # strongest first; ``p_adjusted`` is corrected for all sets tried
    alternatives: tuple[tuple[str, ...], ...]  # for each, the errors that would explain the change equally well
    trends: tuple[str, ...]  # ``constant``, ``line``, ``bow``, ``turn`` (one wave per turn), or empty
    left_p_value: float  # p-value of the change they do not explain; NaN if nothing could be tested
    shows_from: tuple[tuple[str, float, str], ...] = ()  # (name, size, unit) found in 19 of 20 comparisons


@final
@dataclass(frozen=True, repr=False)
class Changes(DisplayedResult):
    """The changes between two calibrations of one machine."""

    machine: Machine
    first: str  # names of the two (their files)
    second: str
    errors: tuple[ErrorChange, ...]  # change of each error that both contain, tested by itself
    not_compared: tuple[NotCompared, ...]  # errors that could not be compared, with the reason
    not_identified: tuple[NotCompared, ...]  # in neither; U of what remains includes their plausible size
    joint_p_value: float  # of the χ² of all known changes together; NaN and 0 if none is known
    joint_dof: int
    culprits: Culprits
    tool: ToolChange
    tolerance_mm: float | None  # largest error at the tool that the older calibration may leave; None if not given
    left_out: tuple[tuple[str, str], ...]  # effects not included at the tool, with the channels they need
    notices: tuple[str, ...]  # assumptions and limits
    meaning: tuple[str, ...] = ()  # in sentences
    warnings: tuple[SourceWarning, ...] = ()  # on the origin of the numbers of either

    @property
    def illustrative(self) -> bool:
        """Return whether either has illustrative curves, not measured ones."""
        return ILLUSTRATIVE in self.warnings

    @cached_property
    def seen_by(self) -> tuple[str, ...]:
        """Return which of the four tests detect a change: ``all together``, ``error by error``, ``fewest errors``, ``tool``."""
        seen = []
        if self.joint_p_value <= FALSE_ALARMS_OF_A_TEST:
            seen.append("all together")
        if any(error.significant for error in self.errors):
            seen.append("error by error")
        if self.culprits.errors:
            seen.append("fewest errors")
        if self.tool.judged is not None:
            rows = (self.tool.judged, *self.tool.by_class.values())
            if any(row.rms_um > row.limit_um for row in rows):
                seen.append("tool")
        return tuple(seen)

    @property
    def verdict(self) -> Verdict:
        """Return the verdict.

        ``changed`` if any of the four tests is significant; ``unchanged``; ``unknown`` if nothing could be tested; ``same`` for
        identical numbers; ``reworded`` if the numbers changed but their effects cancel at the tool, for example if a constant is
        attributed to a different error.
        """
        if self.seen_by:
            return "reworded" if self._cancelled else "changed"
        if not self.not_compared and all(error.status == "same" for error in self.errors):
            return "same"
        return "unchanged" if any(error.status == "known" for error in self.errors) else "unknown"

    @cached_property
    def _cancelled(self) -> bool:
        tool = self.tool
        if tool.judged is None or self.unjudged or tool.judged.rms_um > tool.judged.limit_um:
            return False
        names = {error.name for error in (*self.errors, *self.culprits.errors) if error.significant}
        alone = np.sqrt(sum(tool.by_error[name].rms_um ** 2 for name in names))
        return len(names) > 1 and bool(tool.judged.rms_um <= CANCELLED_RATIO * alone)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Return the names of errors that could not be compared or tested (exit status 3 on the command line)."""
        return (
            *(one.name for one in self.not_compared),
            *(error.name for error in self.errors if error.status == "unknown" or error.without_variance > 0.0),
            *(name for name, _ in self.left_out),
        )

    @property
    def good_enough(self) -> bool | None:
        """Return whether the older calibration leaves less than the tolerance on the machine of the newer; None if undecided."""
        return None if self.tolerance_mm is None else self.tool.left.enough(self.tolerance_mm * 1e3)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON (``schema: twin.monitoring/1``); null for unknown values."""
        culprits = self.culprits
        return {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "first": self.first,
            "second": self.second,
            "illustrative": self.illustrative,
            "warnings": warnings_to_json(self.warnings),
            "verdict": self.verdict,
            "seen_by": list(self.seen_by),
            "false_alarms": {"of_all": FALSE_ALARMS, "of_each_look": FALSE_ALARMS_OF_A_TEST},
            "joint": {"p_value": finite_or_none(self.joint_p_value), "dof": self.joint_dof},
            "meaning": list(self.meaning),
            "errors": [error.to_dict() for error in self.errors],
            "fewest": {
                "errors": [
                    {**error.to_dict(), "alternatives": list(others), "trend": trend or None}
                    for error, others, trend in zip(
                        culprits.errors, culprits.alternatives, culprits.trends, strict=True
                    )
                ],
                "left_p_value": finite_or_none(culprits.left_p_value),
                "shows_from": [{"error": name, "size": size, "unit": unit} for name, size, unit in culprits.shows_from],
            },
            "not_compared": [json_form(one, rename={"name": "error"}) for one in self.not_compared],
            "not_identified": [{"error": one.name, "why": one.why} for one in self.not_identified],
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

    @property
    def brief(self) -> str:
        """Verdict and change at the tool."""
        return f"{self.second} less {self.first}: {self.verdict}; at the tool {self._at_tool}"

    @property
    def _at_tool(self) -> str:
        whole = self.tool.everything_aligned
        return f"{whole.rms_um:.3g} µm RMS, {whole.max_um:.3g} µm largest"

    def to_text(self) -> str:
        """Return the text report."""
        from twin.monitoring.comparison_words import comparison_text  # imports this module

        return comparison_text(self)

    def display(self) -> Display:
        """Return the meaning and the errors, the significant ones first."""
        other = [error for error in self.errors if error.status != "same"]
        other.sort(key=lambda error: (not error.significant, -self._alone_um(error)))
        shown, more = first_rows(len(other), lambda i: self._cells(other[i]))
        headers = ("error", "class", "largest change", "significant", "at the tool, µm RMS")
        rows = [
            ("at the tool, workpiece aligned", self._at_tool),
            ("could not be compared or tested", ", ".join(self.unjudged)),
        ]
        return Display(
            self.verdict.upper(),
            rows,
            above=[note(sentence) for sentence in self.meaning],
            below=(table(headers, shown, right=(4,)), more),
            small=f"{self.second} less {self.first}",
            illustrative=self.illustrative,
            wrong=bool(self.unjudged),
        )

    def _cells(self, error: ErrorChange) -> tuple[str, ...]:
        return (
            error.name,
            error.iso_class,
            measured(error.largest, error.u, readable(error.unit)),
            "unknown" if error.significant is None else "yes" if error.significant else "no",
            f"{self._alone_um(error):.3g}" if error.name in self.tool.by_error else "",
        )

    def _alone_um(self, error: ErrorChange) -> float:
        """Return the RMS at the tool of one error alone; zero if it was not tested."""
        found = self.tool.by_error.get(error.name)
        return 0.0 if found is None else found.rms_um
