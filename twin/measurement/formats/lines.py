"""Numbers, lines and texts of foreign files, read with file, line and value in every message."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from twin._common.errors import InputError
from twin._common.files import read_bytes

MAX_BYTES: Final = 2**26
"""Largest file of another program; a ball bar test has less than 1 MB."""
MAX_NUMBER: Final = 1e9
"""Largest absolute value of a number in any unit."""


def file_text(path: Path) -> str:
    """Return the text of a file; text that is not UTF-8 is read as Latin-1 (names and remarks in other programs' files).

    Raises:
        InputError: it cannot be read, is larger than `MAX_BYTES`, or has NUL characters.
    """
    data = read_bytes(path, most_bytes=MAX_BYTES)
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise InputError("not a text file", expected="text without NUL", file=path, line=line)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def file_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a file that are not blank, stripped, with their numbers.

    Raises:
        InputError: as `file_text`.
    """
    text = file_text(path).replace("\r\n", "\n").replace("\r", "\n")
    return [(number, line.strip()) for number, line in enumerate(text.split("\n"), start=1) if line.strip()]


def number_in(text: str, what: str, path: Path, line: int) -> float:
    """Return a number with a decimal point.

    Raises:
        InputError: it is not a number, not finite, or exceeds `MAX_NUMBER`.
    """
    try:
        value = float(text) if "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_NUMBER:
        raise InputError(
            f"{what} is not a number", expected="a number with a decimal point", file=path, line=line, value=text
        )
    return value


def whole_number_in(text: str, what: str, path: Path, line: int, most: int) -> int:
    """Return a whole number from 1 to ``most``.

    Raises:
        InputError: it is not one.
    """
    value = number_in(text, what, path, line)
    if value != int(value) or not 1 <= value <= most:
        raise InputError(
            f"{what} is not valid", expected=f"a whole number, 1 to {most}", file=path, line=line, value=text
        )
    return int(value)


def numbers_in(words: Sequence[str], what: str, path: Path, line: int) -> list[float]:
    """Return several numbers.

    Raises:
        InputError: as `number_in`.
    """
    return [number_in(word, what, path, line) for word in words]


def code_in(text: str, known: Mapping[str, str], what: str, path: Path, line: int) -> str:
    """Return the meaning of a code.

    Raises:
        InputError: it is unknown.
    """
    if text not in known:
        raise InputError(f"unknown {what}", expected=" or ".join(known), file=path, line=line, value=text)
    return known[text]
