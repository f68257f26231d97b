"""First page of a report: the job, items with tolerance and verdict, the largest findings, the facts of the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from math import isfinite, nan
from pathlib import Path
from typing import Any, Final, final

from twin._common.distributions import Verdict, decide, is_accepted
from twin._common.errors import InputError, closest_name
from twin._common.files import read_json
from twin._common.messages import Message, joined
from twin._common.provenance import UNSETTLED_ESTIMATE
from twin._common.records import json_form
from twin.display import UNKNOWN, readable, with_half
from twin.machine.machine import Machine
from twin.model.effects import unit_of
from twin.reporting.advice import Step
from twin.reporting.result import SCHEMA, MachineReport

TOOL: Final = ("tool", "tool_after")
"""Names of the error of the tool point before compensation, and as expected after it."""
ACTIONS: Final = 3
ROWS: Final = 9
"""Largest number of items on the first page, so that it stays one page."""
_REASONS: Final = {
    "unknown": Message("unknown"),
    "incomplete": Message("U incomplete"),
    "assumed": Message("assumed, not measured"),
    "unsettled": Message("the identification did not converge"),
}
JUDGED: Final[dict[str, Message]] = {
    "fail": Message("FAIL"),
    "undecided": Message("UNDECIDED"),
    "pass": Message("PASS"),
}
_URGENCY: Final = {"fail": 0, "undecided": 1, "pass": 2, None: 3}


@final
@dataclass(frozen=True)
class FrontItem:
    """One item of the first page."""

    name: str  # ISO 230-1 name, or one of `TOOL`
    unit: str  # ``um`` or ``urad``
    value: float  # largest absolute value; NaN if unknown
    half: float  # its expanded uncertainty U (95 %); NaN if unknown
    tolerance: float | None  # largest permitted absolute value; None without a tolerance
    verdict: Verdict | None  # None without a tolerance
    reason: str  # of no decision: unknown, incomplete (U is a lower bound; a fail may be, too), assumed, unsettled; or empty
    to: str = ""  # for a squareness, the reference axis; else empty
    rms: float | None = None  # this and the next: of the error of the tool point over the volume
    quantile_95: float | None = None

    @property
    def accepted(self) -> bool:
        """Whether the item has no tolerance or a known value within it (`twin._common.distributions.is_accepted`)."""
        return self.tolerance is None or self.verdict is None or is_accepted(self.verdict, self.value, self.tolerance)

    @property
    def text(self) -> str:
        """The item and its verdict in one line."""
        known = with_half(self.value, self.half, self.unit) if isfinite(self.value) else UNKNOWN
        unit = readable(self.unit)
        tolerance = (
            "" if self.tolerance is None else Message(", tolerance {limit:g} {unit}", limit=self.tolerance, unit=unit)
        )
        reason = joined("", [" (", _REASONS[self.reason], ")"]) if self.reason else ""
        verdict = JUDGED[self.verdict] if self.verdict else ""
        return joined("", [verdict, f" {self.name}: ", known, tolerance, reason])

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"half": "U_95"}, leave_out=("to",))


@final
@dataclass(frozen=True)
class EarlierReport:
    """The error of the tool point in a report of the same machine."""

    made: datetime
    value: float  # largest error, uncompensated, µm
    half: float  # U (95 %), µm; NaN if unknown


@final
@dataclass(frozen=True)
class FrontPage:
    """Content of the first page."""

    items: tuple[FrontItem, ...]  # the tool point, then the errors in the order of their effect at the tool
    actions: tuple[Step, ...]  # at most `ACTIONS`
    history: tuple[EarlierReport, ...]  # in the order of time, this report last; empty without earlier reports

    @property
    def judged(self) -> tuple[FrontItem, ...]:
        """Items with a tolerance."""
        return tuple(item for item in self.items if item.tolerance is not None)

    @property
    def verdict(self) -> Verdict | None:
        """``fail`` if any item fails, else ``undecided`` if any is; None without tolerances."""
        return min((item.verdict for item in self.judged), key=_URGENCY.__getitem__, default=None)

    @property
    def shown(self) -> tuple[FrontItem, ...]:
        """Items on the first page: the tool point, then those with a tolerance: failed, undecided and passed."""
        rest = sorted((one for one in self.judged if one.name not in TOOL), key=lambda item: _URGENCY[item.verdict])
        return (*self.items[: len(TOOL)], *rest)[:ROWS]

    @property
    def hidden(self) -> tuple[FrontItem, ...]:
        """Items with a tolerance that do not stand on the first page."""
        shown = {item.name for item in self.shown}
        return tuple(item for item in self.judged if item.name not in shown)

    @property
    def not_accepted(self) -> tuple[FrontItem, ...]:
        """Items whose value exceeds its tolerance or is unknown, failed ones first."""
        refused = [item for item in self.judged if not item.accepted]
        return tuple(sorted(refused, key=lambda item: _URGENCY[item.verdict]))

    def count(self, verdict: Verdict) -> int:
        """Return the number of items with a verdict."""
        return sum(item.verdict == verdict for item in self.items)

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return {
            "decision_rule": "ISO 14253-1, guard band U",
            "verdict": self.verdict,
            "items": [item.to_dict() for item in self.items],
            "actions": [action.title for action in self.actions],
            "history": [json_form(one, leave_out=("made",)) | {"made": one.made.isoformat()} for one in self.history],
        }


def front_page(
    report: MachineReport, tolerances: Mapping[str, float] | None = None, history: Sequence[EarlierReport] = ()
) -> FrontPage:
    """Return the content of the first page; raise `InputError` for a tolerance of an unknown name.

    ``tolerances``: largest permitted absolute value, µm or µrad, by ISO 230-1 name, ``tool`` or ``tool_after``; ``history``: earlier
    reports of the machine (`earlier_report`).
    """
    given = dict(tolerances or {})
    check_tolerances(report.machine, given)
    errors = report.budget.errors
    names = {error.name for error in errors}
    to = {constant.name: constant.to for constant in report.constants}
    items = [
        *_tool_items(report, given),
        *(
            _judged(
                FrontItem(e.name, e.unit, e.peak, e.peak_half, given.get(e.name), None, "", to.get(e.name, "")),
                e.u_complete,
                e.illustrative,
            )
            for e in errors
        ),
    ]
    missing = [name for name in given if name not in names and name not in TOOL]
    items += [FrontItem(name, unit_of(name), nan, nan, given[name], "undecided", "unknown") for name in missing]
    if any(warning.name == UNSETTLED_ESTIMATE.name for warning in report.warnings):
        items = [replace(item, verdict="undecided", reason="unsettled") if item.verdict else item for item in items]
    before = items[0]
    now = EarlierReport(report.sources.made, before.value, before.half)
    points = sorted((*history, now), key=lambda one: one.made) if history else ()
    return FrontPage(tuple(items), _actions(report.advice.steps), tuple(points))


def _actions(steps: Sequence[Step]) -> tuple[Step, ...]:
    """Return the actions of the first page: two corrections at most, then what to measure, then further corrections."""
    useful = [step for step in steps if step.short]
    todo, other = ([step for step in useful if (step.kind == "do") is wanted] for wanted in (True, False))
    chosen = [*todo[: ACTIONS - 1], *other, *todo[ACTIONS - 1 :]][:ACTIONS]
    return tuple(step for step in useful if step in chosen)


def earlier_report(path: Path, machine: Machine) -> EarlierReport:
    """Read the JSON of an earlier report of the same machine (`SCHEMA`); `InputError` for another machine or another file."""
    expected = f"JSON of `twin report --json` for {machine.name}"
    found = read_json(path, expected)
    try:
        name, made = str(found["machine"]), datetime.fromisoformat(found["sources"]["made"])
        item = next(one for one in found["first_page"]["items"] if one["name"] == TOOL[0])
        value, half = (nan if item[key] is None else float(item[key]) for key in ("value", "U_95"))
    except (KeyError, TypeError, ValueError, StopIteration):
        raise InputError("not an earlier report", expected=expected, file=path) from None
    if found.get("schema") != SCHEMA or name != machine.name:
        raise InputError("a report of another machine", expected=expected, file=path, value=name)
    return EarlierReport(made, value, half)


def check_tolerances(machine: Machine, tolerances: Mapping[str, float]) -> None:
    """Raise `InputError` unless every tolerance names the tool point or an error of the machine."""
    known = (*TOOL, *machine.motion_names, *machine.squareness_names, *machine.location_names)
    for name in tolerances:
        if name not in known:
            raise InputError(
                "tolerance of an unknown item",
                expected="tool, tool_after, or an ISO 230-1 name such as E_XX or E_C0Y",
                value=name,
                nearest=closest_name(name, known),
            )


def _tool_items(report: MachineReport, given: Mapping[str, float]) -> list[FrontItem]:
    """Return the items of the tool point: the largest error over the volume before compensation, and as expected after it.

    Both have one meaning: mean and 95 % interval over the same machines, drawn from the covariance, without the errors that could
    not be determined. These make U incomplete, as errors do that are absent or have no uncertainty.
    """
    outcome, total = report.compensation, report.budget.total
    gaps = report.gaps.absent or report.gaps.left_out or outcome.not_identified
    complete = total.u_complete and not gaps
    before = outcome.before if outcome.expected_before is None else outcome.expected_before
    rows = []
    for name, level in zip(TOOL, (before, outcome.judged), strict=True):
        if level is None or not report.budget.errors:
            rows.append(FrontItem(name, "um", nan, nan, given.get(name), None, ""))
        else:
            item = FrontItem(name, "um", level.max_um, level.max_half_um, given.get(name), None, "")
            rows.append(replace(item, rms=level.rms_um, quantile_95=level.quantile(0.95)))
    return [_judged(item, complete, bool(report.illustrative)) for item in rows]


def _judged(item: FrontItem, complete: bool, assumed: bool) -> FrontItem:
    """Return an item with its verdict; undecided if it is assumed, or if value or U are unknown.

    An incomplete U is a lower bound: it proves no conformity. A value that exceeds the tolerance by more than that U fails, with the
    reason beside it.
    """
    if item.tolerance is None:
        return item
    unknown = not (isfinite(item.value) and isfinite(item.half))
    reason = "assumed" if assumed else "unknown" if unknown else "" if complete else "incomplete"
    verdict: Verdict = "undecided"
    if reason in ("", "incomplete"):
        verdict = decide(item.value, item.half, item.tolerance)
        if reason and verdict == "pass":
            verdict = "undecided"
    return replace(item, verdict=verdict, reason=reason)
