"""Results of standard tests: values with the standard's symbols, tests that were not possible, and the check of tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, Final, Literal, Protocol, final

import numpy as np

from twin._common.distributions import Verdict, decide, is_accepted
from twin._common.errors import InputError
from twin._common.messages import Message, Number, joined, say
from twin._common.provenance import SourceWarning, warning_texts, warnings_to_json
from twin._common.records import json_form
from twin._common.units import count_with_noun
from twin.display import figure, note, readable, table
from twin.display.numbers import COVERAGE_FACTOR, with_joined_units
from twin.display.results import Display, DisplayedResult
from twin.measurement.columns import RowNote, grouped_notes
from twin.standards.iso230_1 import AngularError, SquarenessError, Straightness
from twin.standards.iso230_2 import Positioning, UnidirectionalPositioning
from twin.standards.iso230_3 import DriftSeries
from twin.standards.iso230_4 import CircularTest, RotaryMotion

SCHEMA: Final = "twin.evaluation/1"
WIDTH: Final = 110
INDENT: Final = "    "
HARD_SPACE: Final = "\u00a0"
FEW_TESTS: Final = 3
"""Number of tests up to which the text gives the remarks with every test; for more tests, equal remarks are listed once."""
Conformity = Literal["conforming", "nonconforming", "neither", "unknown"]
CONFORMITY: Final[Mapping[Verdict, Conformity]] = {
    "pass": "conforming",
    "fail": "nonconforming",
    "undecided": "neither",
}
SENTENCES: Final[Mapping[Conformity, Message]] = {
    "conforming": Message("conformity is proven: the value plus U is within the tolerance"),
    "nonconforming": Message("nonconformity is proven: the value minus U is outside the tolerance"),
    "neither": Message("neither conformity nor nonconformity is proven: the margin is within U"),
    "unknown": Message(
        "by the value alone: the uncertainty of the readings is unknown, so that conformity cannot be proven"
    ),
}
WORDS: Final = {
    "PASS": Message("PASS"),
    "FAIL": Message("FAIL"),
    "UNDECIDED": Message("UNDECIDED"),
    "NOT EVALUATED": Message("NOT EVALUATED"),
}
KINDS: Final[Mapping[str, Message]] = {
    text: text
    for text in (
        Message("positioning"),
        Message("straightness"),
        Message("squareness"),
        Message("angular error"),
        Message("circular"),
        Message("rotary error motion"),
        Message("kinematic"),
    )
}
"""Kinds of tests in the language of a page."""
"""Decision by ISO 14253-1, in words."""


@final
@dataclass(frozen=True)
class StandardValue:
    """One value of a test."""

    symbol: str  # the standard's symbol; ↑ and ↓ for the direction of approach
    key: str  # the symbol in ASCII, for JSON and tolerances: ``A``, ``A_forward``, ``R``
    value: float  # in ``unit``; NaN if the data do not determine it
    unit: str  # ``um`` or ``urad``
    meaning: str  # the standard's term
    u: float = float("nan")  # standard uncertainty from that of the readings alone; NaN if unknown
    interval: float | None = None  # half width of the 95 % interval where it is not that of a normal distribution

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %)."""
        return COVERAGE_FACTOR * self.u if self.interval is None else self.interval

    @property
    def text(self) -> str:
        """Symbol, value and unit with hard spaces, so that lines do not break within."""
        parts: list[str | Number] = [
            self.symbol,
            Number(figure(self.value, readable(self.unit)).replace(" ", HARD_SPACE)),
        ]
        if self.interval is not None:
            parts += ["±", Number(figure(self.interval, readable(self.unit)).replace(" ", HARD_SPACE))]
        return joined(HARD_SPACE, parts)


@final
@dataclass(frozen=True)
class ArtefactValue:
    """A squareness or scale error with its budget."""

    name: str  # ``E_C0Y`` …, or ``scale X``
    value: float  # µrad, or µm/m
    u: float  # standard uncertainty
    U95: float  # half width of the 95 % interval
    budget: Mapping[str, float]  # standard uncertainty by contribution


Detail = (
    ArtefactValue
    | Positioning
    | UnidirectionalPositioning
    | CircularTest
    | AngularError
    | Straightness
    | SquarenessError
    | RotaryMotion
    | DriftSeries
    | np.ndarray
)


class EvaluatedData(Protocol):
    """A table or record that was evaluated: its file, what was not used, and its number of rows."""

    @property
    def source(self) -> str:
        """The file."""

    @property
    def notices(self) -> tuple[Message, ...]:
        """Facts to know before using the result."""

    @property
    def set_aside(self) -> tuple[RowNote, ...]:
        """Rows that were not used."""

    def __len__(self) -> int: ...


@final
@dataclass(frozen=True)
class StandardTest:
    """One test of a standard."""

    # ``positioning``, ``straightness``, ``squareness``, ``angular error``, ``circular``, ``rotary error motion``, ``kinematic``;
    # ``environmental temperature variation``, ``rotating spindle``, ``moving linear axis`` or ``moving rotary axis``
    kind: str
    name: str  # axis (``X``), axes (``XY``) or error (``E_YX``); tolerances select tests by it
    standard: str  # standard and clause
    axes: tuple[str, ...]
    place: str  # positions of the other axes, and target and station, in words
    values: tuple[StandardValue, ...]
    remarks: tuple[Message, ...]  # requirements of the standard that are not met, assumptions, and what is not verified
    detail: Detail  # the complete result of the evaluation; for a kinematic test the (n, 3) deviations in µm

    @property
    def main_values(self) -> tuple[StandardValue, ...]:
        """The values of all directions of approach or travel together, if there are any; else all."""
        main = tuple(value for value in self.values if not value.key.endswith(("_forward", "_backward")))
        return main or self.values

    @property
    def title(self) -> Message:
        """Name and kind: ``X: positioning``."""
        return Message("{name}: {kind}", name=self.name, kind=KINDS.get(self.kind, self.kind))

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON; null for values that are not determined."""
        detail = {"deviations_um": self.detail} if isinstance(self.detail, np.ndarray) else self.detail
        return {
            "test": self.kind,
            "name": self.name,
            "standard": self.standard,
            "axes": list(self.axes),
            "place": self.place,
            "values": {f"{value.key}_{value.unit}": json_form(value.value) for value in self.values},
            "u": {f"{value.key}_{value.unit}": json_form(value.u) for value in self.values},
            "remarks": list(self.remarks),
            "detail": json_form(detail),
        }


@final
@dataclass(frozen=True)
class NotEvaluated:
    """A test that the table does not allow."""

    test: Message  # the test, with its axes if it is one of several
    why: Message


@final
@dataclass(frozen=True)
class ToleranceCheck:
    """One value compared with its tolerance."""

    asked: str  # the tolerance as given: ``A``, ``X:A``
    limit: float  # the tolerance, in the unit of the value
    test: str  # title and place of the test; empty if no test gives the value
    value: StandardValue | None  # the value; None if it could not be evaluated
    met: bool  # whether the absolute value is at most the tolerance; the exit status follows from it
    conformity: Conformity  # decision by ISO 14253-1

    @property
    def word(self) -> str:
        """The verdict in one word; without a known uncertainty it is by the value alone."""
        if self.value is None:
            return "NOT EVALUATED"
        return "UNDECIDED" if self.conformity == "neither" else "PASS" if self.met else "FAIL"

    @property
    def text(self) -> str:
        """The check in one line."""
        word = WORDS[self.word]
        if self.value is None:
            return Message(
                "{asked} = {limit:g}: {word}: no test of this table gives it",
                asked=self.asked,
                limit=self.limit,
                word=word,
            )
        unit, expanded = readable(self.value.unit), self.value.expanded
        u = joined("", [", U ", figure(expanded, unit)]) if np.isfinite(expanded) else ""
        return Message(
            "{word} {test}: {symbol} {value}{u}, tolerance {limit:g} {unit}; {sentence}",
            word=word,
            test=self.test,
            symbol=self.value.symbol,
            value=figure(self.value.value, unit, digits=4),
            u=u,
            limit=self.limit,
            unit=unit,
            sentence=SENTENCES[self.conformity],
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON."""
        value = self.value
        return {
            "name": self.asked,
            "limit": self.limit,
            "unit": None if value is None else value.unit,
            "test": self.test or None,
            "value": None if value is None else json_form(value.value),
            "U95": None if value is None else json_form(value.expanded),
            "met": self.met,
            "conformity": self.conformity,
        }


@final
@dataclass(frozen=True, repr=False)
class EvaluationResult(DisplayedResult):
    """The standard tests of a measurement table."""

    data: EvaluatedData
    machine: str
    tests: tuple[StandardTest, ...]
    not_evaluated: tuple[NotEvaluated, ...]  # the tests that were not, with the reason
    assumptions: tuple[Message, ...]
    uncertainty: Message  # source of the readings' uncertainty, empty if unknown
    checks: tuple[ToleranceCheck, ...]  # the tolerances asked for; empty if none were
    warnings: tuple[SourceWarning, ...]  # where the readings come from

    @property
    def met(self) -> bool:
        """Whether every tolerance asked for is met; True if none was."""
        return all(check.met for check in self.checks)

    def named(self, name: str, kind: str = "") -> tuple[StandardTest, ...]:
        """Return the tests of a name (``X``, ``E_YX``), of one kind if given."""
        return tuple(test for test in self.tests if test.name == name and kind in ("", test.kind))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON."""
        return {
            "schema": SCHEMA,
            "machine": self.machine,
            "source": self.data.source,
            "warnings": warnings_to_json(self.warnings),
            "points": len(self.data),
            "tests": [test.to_dict() for test in self.tests],
            "not_evaluated": [json_form(one) for one in self.not_evaluated],
            "assumptions": list(self.assumptions),
            "uncertainty": self.uncertainty or None,
            "tolerances": [check.to_dict() for check in self.checks],
            "met": self.met,
            "notices": list(self.data.notices),
            "set_aside": [{"line": one.line, "why": one.text} for one in self.data.set_aside],
        }

    def to_text(self) -> str:
        """Return all tests with their values, the tolerances and what was not evaluated, as text."""
        count = len(self.tests)
        head = Message(
            "{machine}: {count} standard tests from {source}",
            machine=self.machine,
            count=count,
            source=self.data.source,
        )
        lines = [say(head), *map(say, warning_texts(self.warnings))]
        if not self.checks:
            lines.append(say("No tolerance was given, so there is no verdict."))
        for check in self.checks:
            lines += wrap(with_joined_units(say(check.text), HARD_SPACE), WIDTH, subsequent_indent="    ")
        for test in self.tests:
            lines += [
                "",
                f"{say(test.title)}, {say(test.standard)}",
                *wrap(say(test.place), WIDTH, initial_indent="  ", subsequent_indent="  "),
            ]
            lines += wrap(
                "   ".join(say(value.text) for value in test.values),
                WIDTH,
                initial_indent=INDENT,
                subsequent_indent=INDENT,
            )
            for remark in test.remarks if count <= FEW_TESTS else ():
                lines += wrap(say(remark), WIDTH, initial_indent="  ", subsequent_indent="    ")
        for heading, entries in (
            (Message("Remarks:"), grouped_remarks(self.tests) if count > FEW_TESTS else []),
            (
                Message("Not evaluated:"),
                [Message("{test}: {why}", test=one.test, why=one.why) for one in self.not_evaluated],
            ),
            (Message("Assumptions:"), self.assumptions),
            (Message("Uncertainty:"), [self.uncertainty] if self.uncertainty else []),
            (Message("Notes:"), [*self.data.notices, *grouped_notes(self.data.set_aside)]),
        ):
            lines += ["", say(heading)] if entries else []
            for entry in entries:
                lines += wrap(say(entry), WIDTH, initial_indent="  ", subsequent_indent="    ")
        return "\n".join(lines) + "\n"

    @property
    def brief(self) -> str:
        """Number of tests, and whether the tolerances are met."""
        met = "" if not self.checks else "; tolerances met" if self.met else "; TOLERANCES NOT MET"
        return f"{self.machine}: {count_with_noun(len(self.tests), 'standard test')} from {self.data.source}{met}"

    def display(self) -> Display:
        """Return all tests with their values."""
        rows = [
            (test.title, test.place, "   ".join(value.text for value in test.values), test.standard)
            for test in self.tests
        ]
        loud = [note(check.text, loud=not check.met) for check in self.checks]
        warnings = [note(text, loud=True) for text in warning_texts(self.warnings)]
        missing = [note(f"not evaluated: {one.test}: {one.why}") for one in self.not_evaluated]
        shown = table(("test", "at", "values", "standard"), rows)
        above = (*warnings, *loud, shown, *missing)
        return Display("Standard tests", above=above, small=self.machine, wrong=not self.met)


def check_limits(tolerances: Mapping[str, float]) -> None:
    """Raise `InputError` for a tolerance that is negative or not finite."""
    for name, limit in tolerances.items():
        if not (np.isfinite(limit) and limit >= 0.0):
            raise InputError(
                "a tolerance must be positive", expected="µm or µrad, not negative", value=f"{name}={limit}"
            )


def check_tolerances(tolerances: Mapping[str, float], tests: Sequence[StandardTest]) -> tuple[ToleranceCheck, ...]:
    """Compare values with tolerances, by ISO 14253-1 where the uncertainty of the readings is known.

    Tolerances are by key of the value (``A``), for every test that has it, or by name of the test and key (``X:A``); µm and µrad.
    """
    checks: list[ToleranceCheck] = []
    for asked, limit in tolerances.items():
        name, colon, key = asked.rpartition(":")
        values = [
            (test, value)
            for test in tests
            for value in test.values
            if key in (value.key, value.symbol) and (not colon or name == test.name)
        ]
        if not values:
            checks.append(ToleranceCheck(asked, limit, "", None, False, "unknown"))
        for test, value in values:
            size, expanded = abs(value.value), value.expanded
            verdict = decide(size, expanded, limit)
            conformity = CONFORMITY[verdict] if np.isfinite(expanded) and np.isfinite(size) else "unknown"
            title = Message("{title} ({place})", title=test.title, place=test.place) if test.place else test.title
            checks.append(ToleranceCheck(asked, limit, title, value, is_accepted(verdict, size, limit), conformity))
    return tuple(checks)


def grouped_remarks(tests: Sequence[StandardTest]) -> list[Message]:
    """Return each remark once, with the tests to which it applies and their number."""
    grouped: dict[Message, dict[Message, int]] = {}
    for test in tests:
        for remark in test.remarks:
            titles = grouped.setdefault(remark, {})
            titles[test.title] = titles.get(test.title, 0) + 1
    return [
        Message(
            "{tests}: {remark}",
            tests=joined(
                ", ",
                [
                    title if count == 1 else Message("{title} ({count} runs)", title=title, count=count)
                    for title, count in titles.items()
                ],
            ),
            remark=remark,
        )
        for remark, titles in grouped.items()
    ]
