"""The errors `twin` raises. Each carries its data, and says what was expected instead."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, Final, final

_CONTROL: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that steer a terminal, turn the direction of writing, end a line, or are half of a pair; not tab, CR and LF."""


@final
class InputError(ValueError):
    """Something the user gave cannot be used; the command line turns it into one line and exit status 2.

    Attributes:
        what: what is wrong, as a sentence without the place.
        expected: what would have been right.
        file: the file it stands in, if it stands in one.
        line: 1-based line in that file.
        value: the offending text or value.
        nearest: the right name that was probably meant (`nearest`), or None.
        setting: the setting that may be missing, in words (``work offset``), or None; the command line adds its option.
    """

    def __init__(
        self,
        what: str,
        *,
        expected: str,
        file: str | Path | None = None,
        line: int | None = None,
        value: object = None,
        nearest: str | None = None,
        setting: str | None = None,
    ) -> None:
        self.what = what
        self.expected = expected
        self.file = None if file is None else str(file)
        self.line = line
        self.value = value
        self.nearest = nearest
        self.setting = setting
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        """For a pickle, in which the value is its text: what a worker process raises is raised here (`twin.compute.parallel`)."""
        value = None if self.value is None else str(self.value)
        keywords: dict[str, Any] = {"expected": self.expected, "file": self.file, "line": self.line, "value": value}
        return partial(InputError, **keywords, nearest=self.nearest, setting=self.setting), (self.what,)

    def __str__(self) -> str:
        place = ""
        if self.file is not None:
            place = self.file if self.line is None else f"{self.file}:{self.line}"
            place += ": "
        shown = "" if self.value is None else f": {_one_line(self.value)!r}"
        return printable(f"{place}{self.what}{shown}{_is_it(self.nearest)}; expected {self.expected}", one_line=True)


def control_character(text: str) -> str | None:
    """Return the first control character of a text other than tab and line ends, escaped; None if there is none."""
    found = _CONTROL.search(text)
    return None if found is None else _escaped(found[0])


def printable(text: str, *, one_line: bool = False) -> str:
    """Return a text with control and format characters escaped, so that what a file or its name holds cannot steer a terminal.

    Args:
        text: any text.
        one_line: whether tabs and line ends are escaped too.
    """
    if text.isprintable():
        return text
    kept = "" if one_line else "\t\r\n"
    return "".join(one if one in kept or not _steers(one) else _escaped(one) for one in text)


def _steers(one: str) -> bool:
    category = unicodedata.category(one)
    return category[0] == "C" or category in ("Zl", "Zp")


def _escaped(one: str) -> str:
    return one.encode("unicode_escape").decode("ascii")


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that was probably meant by another; None if none is near.

    Case counts for nothing, so that ``e_xx`` finds ``E_XX``.
    """
    names = list(known)
    close = get_close_matches(name.casefold(), [one.casefold() for one in names], n=1)
    # X_mm and x_mm are two columns: of names that are alike but for case, the one written most like it.
    alike = [one for one in names if close and one.casefold() == close[0]]
    return max(alike, key=lambda one: SequenceMatcher(None, name, one).ratio(), default=None)


def is_it(name: str, known: Iterable[str]) -> str:
    """What follows a name that is not known: `` (is it X?)``; empty if none is near."""
    return _is_it(nearest(name, known))


def _is_it(name: str | None) -> str:
    return "" if name is None else f" (is it {name}?)"


def _one_line(value: object, limit: int = 80) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= limit else text[: limit - 1] + "…"


@final
class OutputError(RuntimeError):
    """What was about to be written does not say what was meant: a defect of `twin`, caught before it reached steel."""
