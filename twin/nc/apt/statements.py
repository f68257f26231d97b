"""APT statements: lines joined over ``$``, major words and arguments."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from twin.nc.text import BOM

_STATEMENT = re.compile(r"[ \t\f\x1a]*+([A-Za-z][A-Za-z0-9_ -]*+)(?:(/)(.*))?", re.ASCII | re.DOTALL)
_new = tuple.__new__
_CONTINUED = re.compile(r"\$[ \t]*(?:\r\n|\n|\r)")


class AptField(NamedTuple):
    """One argument of a statement: its range in the raw text, without surrounding spaces, and its text."""

    start: int
    end: int
    text: str


class Statement(NamedTuple):
    """One statement: lines joined over ``$``.

    Attributes:
        line: 0-based index of its first line.
        raw: its lines as written.
        word: its major word in capitals, without spaces; empty for comments and blank lines.
        at: start of its arguments in the raw text.
        arguments: the arguments, joined into one line.
    """

    line: int
    raw: str
    word: str
    at: int = 0
    arguments: str = ""

    @property
    def texts(self) -> list[str]:
        """The texts of the arguments."""
        return [field.strip() for field in self._split_arguments()]

    @property
    def fields(self) -> list[AptField]:
        """The arguments with their ranges."""
        found = []
        at = self.at + (1 if self.arguments.startswith(",") else 0)
        for field in self._split_arguments():
            bare = field.strip()
            start = at + field.find(bare)
            found.append(_new(AptField, (start, start + len(bare), bare)))
            at += len(field) + 1
        return found

    def _split_arguments(self) -> list[str]:
        arguments = self.arguments
        return arguments.removeprefix(",").split(",") if arguments else []


def statements(texts: Sequence[str]) -> Iterator[Statement]:
    """Yield the statements of a program's lines in order; their raw texts together are the program."""
    index = 0
    while index < len(texts):
        statement, index = statement_at(texts, index)
        yield statement


def statement_at(texts: Sequence[str], first: int) -> tuple[Statement, int]:
    """Return the statement that begins at a line, and the index of the line after it."""
    raw = text = texts[first]
    index = first + 1
    if "$" in text:
        parts = [text]
        while _continues(text) and index < len(texts):
            text = texts[index]
            parts.append(text)
            index += 1
        raw = "".join(parts)
    return _statement(first, raw), index


def _continues(text: str) -> bool:
    at = text.find("$")
    return at >= 0 and not text.startswith("$$", at) and not text[at + 1 :].strip()


def _statement(line: int, raw: str) -> Statement:
    text = raw
    begin = len(BOM) if line == 0 and raw.startswith(BOM) else 0
    if begin:
        text = " " * begin + raw[begin:]
    if "$" in text:
        text = _CONTINUED.sub(lambda match: " " * len(match.group()), text)
        text = text.split("$$", 1)[0].rstrip("\r\n\t $")
    found = _STATEMENT.match(text)
    if found is None:
        return Statement(line, raw, text.strip(" \t\r\n\f\x1a%") and "?")
    word = found.group(1).upper().replace(" ", "").replace("-", "")
    if found.group(2) is None:
        return Statement(line, raw, word)
    return Statement(line, raw, word, found.start(3), found.group(3).rstrip())
