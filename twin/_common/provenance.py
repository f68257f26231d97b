"""Warnings about the origin of numbers, passed on with them: measured table, calibration, programs, tables, reports, JSON.

Each name stands for one cause. The sentences are plain ASCII without brackets, so that every program language and every table format
can hold them in a comment.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

Name = Literal["illustrative", "simulated_readings", "unsettled_estimate", "unknown_uncertainty"]


@final
@dataclass(frozen=True)
class SourceWarning:
    """A warning about the origin of numbers.

    Attributes:
        name: identifier of the warning.
        title: the title shown before the sentence.
        sentence: the explanation.
    """

    name: Name
    title: str
    sentence: str

    @property
    def text(self) -> str:
        """Title and sentence on one line."""
        return f"{self.title}: {self.sentence}"

    def to_dict(self) -> dict[str, str]:
        """Return the warning as JSON data."""
        return {"name": self.name, "text": self.text}


ILLUSTRATIVE: Final = SourceWarning(
    "illustrative", "ILLUSTRATIVE", "some of the error motions are drawn, not measured. Do not cut with them."
)
SIMULATED: Final = SourceWarning(
    "simulated_readings",
    "SIMULATED READINGS",
    "the readings were computed, not measured on a machine. Do not cut with their numbers.",
)
UNSETTLED_ESTIMATE: Final = SourceWarning(
    "unsettled_estimate", "UNSETTLED ESTIMATE", "the identification did not converge. Do not use its numbers."
)
UNKNOWN_UNCERTAINTY: Final = SourceWarning(
    "unknown_uncertainty", "UNKNOWN UNCERTAINTY", "the calibration gives no uncertainty for its errors."
)
PARTLY_UNKNOWN_UNCERTAINTY: Final = SourceWarning(
    "unknown_uncertainty", "UNKNOWN UNCERTAINTY", "the calibration gives no uncertainty for some of its errors."
)


def merge_warnings(*lists: Iterable[SourceWarning]) -> tuple[SourceWarning, ...]:
    """Return the warnings of several sources, each name once (its first occurrence), the most serious first."""
    first: dict[str, SourceWarning] = {}
    for warning in (warning for each in lists for warning in each):
        first.setdefault(warning.name, warning)
    return tuple(
        first[kind.name]
        for kind in (ILLUSTRATIVE, SIMULATED, UNSETTLED_ESTIMATE, UNKNOWN_UNCERTAINTY)
        if kind.name in first
    )


def warnings_to_json(warnings: Sequence[SourceWarning]) -> list[dict[str, str]]:
    """Return the entry ``warnings`` of a JSON file."""
    return [warning.to_dict() for warning in warnings]


def warning_texts(warnings: Sequence[SourceWarning]) -> tuple[str, ...]:
    """Return one line per warning."""
    return tuple(warning.text for warning in warnings)


def program_comments(warnings: Sequence[SourceWarning]) -> tuple[str, ...]:
    """Return one comment per warning for the header of a program."""
    return tuple(f"twin: {warning.text}" for warning in warnings)
