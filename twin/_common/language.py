"""Languages of reports."""

from enum import StrEnum


class Language(StrEnum):
    """Language of a report."""

    en = "en"
    de = "de"
