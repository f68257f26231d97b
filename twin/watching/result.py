"""The result of a watch: verdict, history of every error, and whether the calibration is still good."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.json_form import json_form
from twin._common.provenance import SourceWarning, warning_texts, warnings_to_json
from twin.comparison.tool import Remaining
from twin.display import card, figure, note, pairs, readable, table
from twin.watching.change import Change, WatchedError
from twin.watching.check import SECONDS_PER_DAY, Check
from twin.watching.evidence import DATES, PRIOR_VARIANCES
from twin.watching.memory import WatchStatement

SCHEMA: Final = "twin.watch/1"
Verdict = Literal["changed", "undecided", "steady"]


def date_text(day: float) -> str:
    """Return a date in days since 1970 as ``2026-03-02``."""
    return f"{datetime.fromtimestamp(day * SECONDS_PER_DAY, UTC):%Y-%m-%d}"


@final
@dataclass(frozen=True)
class Watch:
    """The result of a watch.

    Attributes:
        folder, memory: the folder, and the file beside it that remembers.
        machine: name of the machine.
        calibration: file of the calibration that the checks are compared with, or its source.
        checks: the checks by date.
        errors: one for each error that a check determines.
        not_determined: combinations of constant errors that no check determines, in words.
        alarm_rate: probability of any alarm for an unchanged machine, whatever the number of looks.
        spent: part of it that belongs to changes until the last check.
        errors_watched: number of errors over which it is divided.
        limit: logarithm of the evidence from which an error is an alarm.
        tolerance_mm: largest permitted error at the tool; None if none is given.
        remaining: error at the tool that the calibration leaves now; None without tolerance.
        news: what this look found in the folder: files read, changed, vanished; empty if nothing is new.
        statements: what was said after every look, this one included.
        notices: facts to know before using the result.
        warnings: where the numbers come from.
    """

    folder: Path
    memory: Path
    machine: str
    calibration: str
    checks: tuple[Check, ...]
    errors: tuple[WatchedError, ...]
    not_determined: tuple[str, ...]
    alarm_rate: float
    spent: float
    errors_watched: int
    limit: float
    tolerance_mm: float | None
    remaining: Remaining | None
    news: tuple[str, ...]
    statements: tuple[WatchStatement, ...]
    notices: tuple[str, ...]
    warnings: tuple[SourceWarning, ...]

    @property
    def verdict(self) -> Verdict:
        """Whether an error of the machine changed; ``undecided`` if a temperature could explain every alarm."""
        verdicts = {one.verdict for one in self.errors}
        return "changed" if "changed" in verdicts else "undecided" if "undecided" in verdicts else "steady"

    @property
    def correlation(self) -> float:
        """Estimated correlation of the deviations from one check to the next, which is allowed for."""
        return self.errors[0].series.correlation if self.errors else 0.0

    @property
    def good(self) -> bool | None:
        """Whether the calibration is still good for the tolerance (ISO 14253-1); None if undecided or not asked."""
        if self.remaining is None or self.tolerance_mm is None:
            return None
        return self.remaining.enough(self.tolerance_mm * 1e3)

    @property
    def met(self) -> bool:
        """Whether there is no alarm and the calibration is not proven to be out of tolerance."""
        return self.verdict == "steady" and self.good is not False

    @property
    def alarms(self) -> tuple[WatchedError, ...]:
        """The findings that are alarms, changes first, then by date."""
        found = [one for one in self.errors if one.alarming]
        return tuple(sorted(found, key=lambda one: (one.verdict != "changed", _day(one.change))))

    @property
    def following(self) -> tuple[WatchedError, ...]:
        """The errors that follow a temperature."""
        return tuple(one for one in self.errors if one.verdict == "follows temperature")

    def named(self, name: str) -> WatchedError:
        """Return the finding of an error.

        Raises:
            KeyError: no check determines it.
        """
        for one in self.errors:
            if one.series.name == name:
                return one
        raise KeyError(name)

    def _repr_html_(self) -> str:
        rows = [
            (one.series.name, figure(one.level, readable(one.series.unit)), figure(one.repeatability), one.verdict)
            for one in self.errors
        ]
        good = {True: "still good", False: "no longer good", None: "undecided"}[self.good]
        facts = [
            ("checks", f"{len(self.checks)}, {self.checks[0].date:%Y-%m-%d} to {self.checks[-1].date:%Y-%m-%d}"),
            ("verdict", self.verdict),
            ("calibration", "" if self.tolerance_mm is None else f"{good} for {figure(self.tolerance_mm * 1e3, 'µm')}"),
            ("not determined", "; ".join(self.not_determined)),
        ]
        warnings = [note(text, loud=True) for text in warning_texts(self.warnings)]
        heads = ("error", "deviation now", "repeatability", "verdict")
        title, small = f"Watch of {self.machine}", str(self.folder)
        return card(
            title, *warnings, pairs(facts), table(heads, rows, right=(1, 2)), small=small, wrong=not self.met
        ).text

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON (``schema: twin.watch/1``)."""
        return {
            "schema": SCHEMA,
            "machine": self.machine,
            "calibration": self.calibration,
            "folder": str(self.folder),
            "warnings": warnings_to_json(self.warnings),
            "verdict": self.verdict,
            "met": self.met,
            "alarm_rate": {
                "whole": self.alarm_rate,
                "spent": self.spent,
                "errors": self.errors_watched,
                "log_evidence_limit": self.limit,
                "dates_of_half": DATES,
                "prior_variances": list(PRIOR_VARIANCES),
                "correlation": self.correlation,
            },
            "errors": [_finding(one, self.checks) for one in self.errors],
            "not_determined": list(self.not_determined),
            "tolerance": None
            if self.remaining is None
            else {"mm": self.tolerance_mm, "good": self.good, "remaining": json_form(self.remaining)},
            "checks": [_check(one) for one in self.checks],
            "news": list(self.news),
            "statements": [json_form(one) for one in self.statements],
            "notices": list(self.notices),
        }


def _day(change: Change | None) -> float:
    return np.inf if change is None else change.day


def _finding(found: WatchedError, checks: tuple[Check, ...]) -> dict[str, Any]:
    change, series = found.change, found.series
    return {
        "name": series.name,
        "unit": series.unit,
        "verdict": found.verdict,
        "alarm": None if found.alarm is None else checks[int(series.checks[found.alarm])].name,
        "change": None if change is None or not found.alarming else _change(change),
        "temperatures": [
            {"sensor": one.sensor, "per_kelvin": one.per_kelvin, "U95": json_form(one.expanded)}
            for one in found.temperatures
        ],
        "deviation_now": json_form(found.level),
        "repeatability": json_form(found.repeatability),
        "history": [
            {
                "check": checks[int(i)].name,
                "deviation": float(value),
                "u": float(u),
                "log_evidence": float(plain),
                "log_evidence_apart_from_temperature": json_form(float(apart)),
            }
            for i, value, u, plain, apart in zip(
                series.checks, series.value, series.u, found.log_evidence, found.log_evidence_apart, strict=True
            )
        ],
    }


def _change(change: Change) -> dict[str, Any]:
    return {
        "shape": change.shape,
        "shape_certain": change.sure_shape,
        "date": date_text(change.day),
        "date_95": [date_text(change.earliest_day), date_text(change.latest_day)],
        "size": change.size,
        "U95": json_form(change.expanded),
        "per_30_days": json_form(change.per_month),
    }


def _check(check: Check) -> dict[str, Any]:
    temperatures: Mapping[str, float] = check.temperature_degC
    return {
        "name": check.name,
        "sha256": check.sha256,
        "date": check.date.isoformat(),
        "dated_by": check.dated_by,
        "read_at": check.read_at,
        "instruments": check.instruments,
        "readings": check.rows,
        "errors": list(check.errors),
        "not_determined": list(check.lost),
        "reduced_chi2": json_form(check.reduced_chi2),
        "temperature_degC": dict(temperatures),
        "notices": list(check.notices),
    }
