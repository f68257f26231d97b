"""First page of a report: the job, items with tolerance and verdict, the largest findings, the facts of the test."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from math import isfinite, nan
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final
from xml.etree import ElementTree

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from twin._common.distributions import Verdict, decide, is_accepted
from twin._common.errors import InputError, closest_name
from twin._common.files import read_bytes
from twin._common.provenance import UNSETTLED_ESTIMATE
from twin._common.records import json_form
from twin._common.yaml_files import load_yaml
from twin.display import UNKNOWN, readable, with_half
from twin.machine.machine import Machine
from twin.model.effects import unit_of
from twin.reporting.contributions import Contribution
from twin.reporting.result import MachineReport

SCHEMA: Final = "twin.job/1"
LOGO_BYTES: Final = 512 * 1024
"""Largest size of a logo."""
PNG: Final = b"\x89PNG\r\n\x1a\n"
EXPECTED: Final = "a PNG or an SVG picture"
Line = Annotated[str, Field(max_length=80)]


def _country(value: object) -> object:
    """Return a country code of ISO 3166-1; raise an error for anything else, such as NO without quotes, which YAML reads as false."""
    if isinstance(value, str) and re.fullmatch("[A-Z]{2}", value):
        return value
    expected = 'two capital letters of ISO 3166-1, in quotes: "NO"'
    raise PydanticCustomError("country", "Input should be {expected}", {"expected": expected})


Country = Annotated[str, BeforeValidator(_country)]
Name = Annotated[str, Field(min_length=1, max_length=120)]


class Contact(BaseModel):
    """Name and address of a laboratory or customer."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Name
    email: Name
    city: Name
    street: str = ""
    post_code: str = ""
    country: Country | None = None


class Person(BaseModel):
    """A person responsible for the certificate."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Name
    role: str = ""


class CertificateFacts(BaseModel):
    """Facts that a certificate must state and twin cannot know: entry ``dcc`` of a job file."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    number: Name
    country: Country
    begin: date
    end: date
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
    manufacturer: Name
    laboratory: Contact
    customer: Contact
    responsible: Annotated[tuple[Person, ...], Field(min_length=1)]


class Job(BaseModel):
    """Facts of a test; every entry is optional, and what is missing is filled in by hand on paper."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal["twin.job/1"] = Field(default="twin.job/1", alias="schema")
    machine: Line = ""
    serial_number: Line = ""
    operator: Line = ""
    customer: Line = ""
    place: Line = ""
    date: Line = ""
    instrument: Line = ""
    instrument_serial: Line = ""
    certificate: Line = ""
    temperature: Line = ""
    dcc: CertificateFacts | None = None


def load_job(path: Path) -> Job:
    """Read a job file (``schema: twin.job/1``); `InputError` for an unknown key, or a value that is not text of 80 characters."""
    return load_yaml(path, Job, SCHEMA)[0]


def logo_uri(path: Path) -> str:
    """Return a PNG or SVG picture as a data URI; raise `InputError` if the file is larger than 512 KiB, or not such a picture."""
    content = read_bytes(path, most_bytes=LOGO_BYTES)
    if content.startswith(PNG):
        return _uri("png", content)
    if b"<!ENTITY" in content or not content.strip():
        raise InputError("not a logo", expected=EXPECTED, file=path)
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError:
        raise InputError("not a logo", expected=EXPECTED, file=path) from None
    if root.tag != "{http://www.w3.org/2000/svg}svg":
        raise InputError("not a logo", expected=EXPECTED, file=path)
    return _uri("svg+xml", content)


def _uri(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


TOOL: Final = ("tool", "tool_after")
"""Names of the error of the tool point before compensation, and as expected after it."""
FINDINGS: Final = 3
ROWS: Final = 17
"""Largest number of items on the first page, so that it stays one page."""
_REASONS: Final = {
    "unknown": "unknown",
    "incomplete": "U incomplete",
    "assumed": "assumed, not measured",
    "unsettled": "the identification did not converge",
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
        tolerance = "" if self.tolerance is None else f", tolerance {self.tolerance:g} {readable(self.unit)}"
        reason = f" ({_REASONS[self.reason]})" if self.reason else ""
        return f"{(self.verdict or '').upper()} {self.name}: {known}{tolerance}{reason}"

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"half": "U_95"}, leave_out=("to",))


@final
@dataclass(frozen=True)
class FrontPage:
    """Content of the first page."""

    job: Job
    items: tuple[FrontItem, ...]  # the tool point, then the errors in the order of their effect at the tool
    findings: tuple[Contribution, ...]  # of largest effect at the tool
    logo: str = field(default="", repr=False)

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
        """Items on the first page: the tool point, then failed, undecided and passed items, then those of largest effect."""
        rest = sorted(self.items[len(TOOL) :], key=lambda item: _URGENCY[item.verdict])
        return (*self.items[: len(TOOL)], *rest)[:ROWS]

    @property
    def hidden(self) -> tuple[FrontItem, ...]:
        """Items that only the appendix lists."""
        shown = {item.name for item in self.shown}
        return tuple(item for item in self.items if item.name not in shown)

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
            "job": {
                name: text for name, text in self.job.model_dump().items() if text and name not in ("schema_", "dcc")
            },
            "decision_rule": "ISO 14253-1, guard band U",
            "verdict": self.verdict,
            "items": [item.to_dict() for item in self.items],
            "findings": [finding.name for finding in self.findings],
        }


def front_page(
    report: MachineReport, job: Job | None = None, tolerances: Mapping[str, float] | None = None, logo: str = ""
) -> FrontPage:
    """Return the content of the first page; raise `InputError` for a tolerance of an unknown name.

    ``tolerances``: largest permitted absolute value, µm or µrad, by ISO 230-1 name, ``tool`` or ``tool_after``; ``logo``: data URI of
    `logo_uri`.
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
    return FrontPage(Job() if job is None else job, tuple(items), tuple(errors[:FINDINGS]), logo)


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

    Before: U is the largest over the volume, which is conservative. After: mean and 95 % interval over machines drawn from the
    covariance, so that the value contains the uncertainty of the calibration (`CompensationForecast.with_uncertainty`).
    """
    outcome, total = report.compensation, report.budget.total
    # Errors that are absent from the calibration count as zero in the total, so its U is a lower bound.
    complete = total.u_complete and not report.gaps.absent and not report.gaps.left_out
    after = outcome.with_uncertainty
    halves = (total.u_max_um, nan if after is None else after.max_half_um)
    rows = []
    for name, level, half in zip(TOOL, (outcome.before, after), halves, strict=True):
        if level is None or not report.budget.errors:
            rows.append(FrontItem(name, "um", nan, nan, given.get(name), None, ""))
        else:
            item = FrontItem(name, "um", level.max_um, half, given.get(name), None, "")
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
