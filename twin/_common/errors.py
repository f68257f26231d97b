"""The errors that `twin` raises, with their data and what was expected instead."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher, get_close_matches
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, Final, final

_CONTROL: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that control a terminal, change the writing direction, end a line, or are half of a surrogate pair; not tab, CR and LF."""


@final
class InputError(ValueError):
    """Input that cannot be used. The command line prints it as one line and exits with status 2.

    Attributes:
        what: what is wrong, as a sentence without the place.
        expected: what would have been right.
        file: the file concerned, or None.
        line: 1-based line in that file.
        value: the offending text or value.
        nearest: the known name that was probably meant (function `closest_name`), or None.
        setting: names of settings that may be missing (``work offset``; ``temperature, time``), or None; the command line adds
            their options.
        cure: line of a mapping file (`twin.import_table`) with which this error does not occur, or None.

    Examples:
        >>> try:
        ...     twin.Machine.load("dmu5")
        ... except twin.InputError as error:
        ...     print(error.nearest)
        dmu50
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
        cure: str | None = None,
    ) -> None:
        self.what = what
        self.expected = expected
        self.file = None if file is None else str(file)
        self.line = line
        self.value = value
        self.nearest = nearest
        self.setting = setting
        self.cure = cure
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the error with its value as text, so that errors of worker processes can be raised here (`twin.compute.parallel`)."""
        value = None if self.value is None else str(self.value)
        keywords: dict[str, Any] = {"expected": self.expected, "file": self.file, "line": self.line, "value": value}
        keywords |= {"nearest": self.nearest, "setting": self.setting, "cure": self.cure}
        return partial(InputError, **keywords), (self.what,)

    def __str__(self) -> str:
        return self.text()

    def text(self, options: str = "") -> str:
        """Return the sentence, with the names of options behind what was expected, and at the end the line that cures the error."""
        place = ""
        if self.file is not None:
            place = self.file if self.line is None else f"{self.file}:{self.line}"
            place += ": "
        shown = "" if self.value is None else f": {_one_line(self.value)!r}"
        cure = f"; in a mapping file: {self.cure}" if self.cure else ""
        sentence = f"{place}{self.what}{shown}{_is_it(self.nearest)}; expected {self.expected}{options}{cure}"
        return printable(sentence, one_line=True)


def require_type(name: str, value: object, kind: type) -> None:
    """Raise `TypeError` if an argument is not of its type, and name what makes the right one."""
    if not isinstance(value, kind):
        given = type(value).__name__
        makes = f"{kind.__name__}.load reads one from a file" if isinstance(value, str | PathLike) else ""
        makes = _MAKES.get((kind.__name__, given), makes)
        raise TypeError(f"{name} must be a {kind.__name__}, not {given}{makes and '; '}{makes}")


# What makes an argument of something else, where it is not the class's own ``load``: by the class that is needed and the one that came.
_MAKES: Final[Mapping[tuple[str, str], str]] = {
    ("Measurements", "DataFrame"): "twin.measurements_from_frame makes one from a frame",
    ("Instrument", "str"): "twin.instruments.instrument_named gives one by its name",
}


def control_character(text: str) -> str | None:
    """Return the first control character of a text other than tab and line ends, escaped; None if there is none."""
    match = _CONTROL.search(text)
    return None if match is None else _escaped(match[0])


def printable(text: str, *, one_line: bool = False) -> str:
    """Return a text with control characters escaped, so that it cannot control the terminal; tabs and line ends too if ``one_line``."""
    if text.isprintable():
        return text
    kept = "" if one_line else "\t\r\n"
    return "".join(char if char in kept or not _is_control(char) else _escaped(char) for char in text)


def _is_control(char: str) -> bool:
    category = unicodedata.category(char)
    return category[0] == "C" or category in ("Zl", "Zp")


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


def closest_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name closest to another one, ignoring case (``e_xx`` finds ``E_XX``); None if none is close."""
    names = list(known)
    close = get_close_matches(name.casefold(), [candidate.casefold() for candidate in names], n=1)
    # X_mm and x_mm are different columns: among names that differ only in case, take the most similar spelling.
    alike = [candidate for candidate in names if close and candidate.casefold() == close[0]]
    return max(alike, key=lambda candidate: SequenceMatcher(None, name, candidate).ratio(), default=None)


def require_name(what: str, name: str, known: Iterable[str], **place: Any) -> None:
    """Raise `InputError` unless a name is known; ``what`` says what it is the name of, ``place`` is its file, line or setting."""
    names = list(known)
    if name not in names:
        expected = f"one of {', '.join(names)}"
        raise InputError(f"no such {what}", expected=expected, value=name, nearest=closest_name(name, names), **place)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the hint that follows an unknown name, `` (did you mean X?)``; empty if no known name is close."""
    return _is_it(closest_name(name, known))


def _is_it(name: str | None) -> str:
    return "" if name is None else f" (did you mean {name}?)"


def _one_line(value: object, limit: int = 80) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= limit else text[: limit - 1] + "…"


@final
class OutputError(RuntimeError):
    """The output about to be written does not contain what was intended: a defect of `twin`, found before the file was written."""
