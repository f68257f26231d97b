"""The result of a diagnosis, with its text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from twin.diagnosis.result import DiagnosisResult
from twin.diagnosis.wording.text import diagnosis_brief, diagnosis_text


@final
@dataclass(frozen=True)
class Diagnosis(DiagnosisResult):
    """The errors that measured data show beyond the model, and their causes; see `DiagnosisResult` for the numbers."""

    def to_text(self) -> str:
        """Return the diagnosis in words, in lines of at most 100 characters."""
        return diagnosis_text(self)

    def _repr_html_(self) -> str:
        return diagnosis_brief(self)
