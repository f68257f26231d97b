"""The errors `twin` raises. Each carries its data, and says what was expected instead."""

from __future__ import annotations

from pathlib import Path
from typing import Any, final


@final
class InputError(ValueError):
    """Something the user gave cannot be used; the command line turns it into one line and exit status 2.

    Attributes:
        what: what is wrong, as a sentence without the place.
        expected: what would have been right.
        file: the file it stands in, if it stands in one.
        line: 1-based line in that file.
        value: the offending text or value.
    """

    def __init__(
        self,
        what: str,
        *,
        expected: str,
        file: str | Path | None = None,
        line: int | None = None,
        value: object = None,
    ) -> None:
        self.what = what
        self.expected = expected
        self.file = None if file is None else str(file)
        self.line = line
        self.value = value
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        """For a pickle, in which the value is its text: what a worker process raises is raised here (`twin.parallel`)."""
        return _again, (self.what, self.expected, self.file, self.line, None if self.value is None else str(self.value))

    def __str__(self) -> str:
        place = ""
        if self.file is not None:
            place = self.file if self.line is None else f"{self.file}:{self.line}"
            place += ": "
        shown = "" if self.value is None else f": {_one_line(self.value)!r}"
        return f"{place}{self.what}{shown}; expected {self.expected}"


def _again(what: str, expected: str, file: str | None, line: int | None, value: str | None) -> InputError:
    return InputError(what, expected=expected, file=file, line=line, value=value)


def _one_line(value: object, limit: int = 80) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= limit else text[: limit - 1] + "…"


@final
class OutputError(RuntimeError):
    """What was about to be written does not say what was meant: a defect of `twin`, caught before it reached steel."""
