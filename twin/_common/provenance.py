"""Warnings about the origin of numbers, passed on with them: measured table, calibration, programs, tables, reports, JSON.

Each name stands for one cause. The sentences are plain ASCII without brackets, so that every program language and every table format
can hold them in a comment.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, final

from twin._common.messages import Message, joined

Name = Literal[
    "illustrative",
    "simulated_readings",
    "unsettled_estimate",
    "not_identifiable",
    "kinematics_not_identified",
    "corrected_in_control",
    "misfit",
    "unknown_uncertainty",
]
ORDER: Final[tuple[Name, ...]] = (
    "illustrative",
    "simulated_readings",
    "unsettled_estimate",
    "corrected_in_control",
    "kinematics_not_identified",
    "not_identifiable",
    "misfit",
    "unknown_uncertainty",
)
"""Names of the warnings, the most serious first."""
NAMED: Final = 8
"""Largest number of errors that a warning names; the others are counted."""


@final
@dataclass(frozen=True)
class SourceWarning:
    """A warning about the origin of numbers."""

    name: Name
    title: str  # shown before the sentence
    explanation: str  # the sentence, without the errors that it is about
    errors: tuple[str, ...] = ()  # names of the errors that it is about; empty if it is about all

    @property
    def sentence(self) -> str:
        """The explanation, after the names of the errors that it is about."""
        if not self.errors:
            return self.explanation
        more = len(self.errors) - NAMED
        names: str = joined(", ", self.errors[:NAMED])
        if more > 0:
            names = Message("{names} and {count} more", names=names, count=str(more))
        return joined(" ", [names, self.explanation])

    @property
    def text(self) -> str:
        """Title and sentence on one line."""
        return Message("{title}: {sentence}", title=self.title, sentence=self.sentence)

    def to_dict(self) -> dict[str, str]:
        """Return the warning as JSON data."""
        return {"name": self.name, "text": self.text}

    def about(self, errors: Iterable[str]) -> SourceWarning:
        """Return the warning about some errors, by name."""
        return replace(self, errors=tuple(dict.fromkeys(errors)))


ILLUSTRATIVE: Final = SourceWarning(
    "illustrative",
    Message("ILLUSTRATIVE"),
    Message("some of the error motions are drawn, not measured. Do not cut with them."),
)
SIMULATED: Final = SourceWarning(
    "simulated_readings",
    Message("SIMULATED READINGS"),
    Message("the readings were computed, not measured on a machine. Do not cut with their numbers."),
)
UNSETTLED_ESTIMATE: Final = SourceWarning(
    "unsettled_estimate",
    Message("UNSETTLED ESTIMATE"),
    Message("the identification did not converge. Do not use its numbers."),
)
NOT_IDENTIFIABLE: Final = SourceWarning(
    "not_identifiable",
    Message("NOT IDENTIFIED"),
    Message("could not be determined from the readings. U includes the plausible range of the machine file for them."),
)
NOMINAL_KINEMATICS: Final = SourceWarning(
    "kinematics_not_identified",
    Message("KINEMATICS NOT IDENTIFIED"),
    Message(
        "were not identified: the values here are not measured. Do not load them into a control that was calibrated otherwise."
    ),
)
CORRECTED_IN_CONTROL: Final = SourceWarning(
    "corrected_in_control",
    Message("CORRECTED IN THE CONTROL"),
    Message(
        "a kinematics module corrects these errors while it is switched on. The numbers are those of the machine with it switched off."
    ),
)
SYSTEMATIC_RESIDUALS: Final = SourceWarning(
    "misfit",
    Message("SYSTEMATIC RESIDUALS"),
    Message(
        "the readings contain a repeatable part that the calibration does not describe. Its uncertainties count it as random."
    ),
)
NOISE_CONTRADICTED: Final = SourceWarning(
    "misfit",
    Message("RESIDUALS LARGER THAN THE STATED UNCERTAINTY"),
    Message(
        "the residuals contradict the noise stated for the readings: the model is incomplete, or the noise is larger."
    ),
)
MODEL_NOT_TESTED: Final = SourceWarning(
    "misfit",
    Message("MODEL NOT TESTED"),
    Message(
        "the calibration was not tested against its readings: they were too few, or its method makes no such test."
    ),
)
UNKNOWN_UNCERTAINTY: Final = SourceWarning(
    "unknown_uncertainty",
    Message("UNKNOWN UNCERTAINTY"),
    Message("the calibration gives no uncertainty for its errors."),
)
PARTLY_UNKNOWN_UNCERTAINTY: Final = SourceWarning(
    "unknown_uncertainty",
    Message("UNKNOWN UNCERTAINTY"),
    Message("the calibration gives no uncertainty for some of its errors."),
)


def merge_warnings(*lists: Iterable[SourceWarning]) -> tuple[SourceWarning, ...]:
    """Return the warnings of several sources, the most serious first, each name once and about the errors of all."""
    first: dict[str, SourceWarning] = {}
    for warning in (warning for each in lists for warning in each):
        same = first.setdefault(warning.name, warning)
        if same.errors:
            first[warning.name] = same.about((*same.errors, *warning.errors)) if warning.errors else warning
    return tuple(first[name] for name in ORDER if name in first)


def warnings_to_json(warnings: Sequence[SourceWarning]) -> list[dict[str, str]]:
    """Return the entry ``warnings`` of a JSON file."""
    return [warning.to_dict() for warning in warnings]


def warning_texts(warnings: Sequence[SourceWarning]) -> tuple[str, ...]:
    """Return one line per warning."""
    return tuple(warning.text for warning in warnings)


def program_comments(warnings: Sequence[SourceWarning]) -> tuple[str, ...]:
    """Return one comment per warning for the header of a program."""
    return tuple(f"twin: {warning.text}" for warning in warnings)
