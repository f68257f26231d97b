"""What the words of the command line mean: several words of one option, and numbers that arithmetic can bear."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from twin._common.errors import InputError

MANY_WORDS: Final[Mapping[str, re.Pattern[str]]] = {
    "--work-offset": re.compile(r"[A-Za-z]\w*=.*"),
    "--at": re.compile(r"[A-Za-z]\w*=.*"),
    "--temperature": re.compile(r"[^\W\d][\w.-]*=.*"),
    "--scope": re.compile(r"[LR]-[A-Z]{3}\+?|FOR", re.I),
    "--only": re.compile(r"E_[A-Z0-9*?]+"),
    "--reduce": re.compile(r"E_[A-Z0-9*?]+"),
}
"""Options that take several words (contract §3), and what every word after the first looks like."""
VARIABLE: Final = "_TWIN_COMPLETE"
WORDS: Final = "COMP_WORDS"
WORD: Final = "COMP_CWORD"
"""What bash sets: the whole line, and the number of the word that is being written."""
SMALLEST: Final = 1e-12
LARGEST: Final = 1e12
"""Of a number on the command line, whatever its unit: less than an atom, more than the seconds since 1970."""


def gathered(arguments: list[str]) -> list[str]:
    """Options that take several words (contract §3: ``--work-offset X=1 Y=2``, ``--scope L-POS L-STR``), one option a word."""
    patterns = MANY_WORDS
    out: list[str] = []
    gathering: str | None = None
    fresh = False
    for word in arguments:
        if word in patterns:
            gathering, fresh = word, True
        elif gathering and fresh:
            parts = [part for part in re.split(r"[\s,]+", word) if part] or [word]
            for part in parts:
                out += [gathering, part]
            fresh = False
        elif gathering and patterns[gathering].fullmatch(word):
            out += [gathering, word]
        else:
            gathering = None
            out.append(word)
    return [*out, gathering] if gathering and fresh else out


def told_word_by_word() -> None:
    """Make the line that bash hands over one that the parser understands: an option of several words once for each of them."""
    if os.environ.get(VARIABLE) != "complete_bash" or WORDS not in os.environ:
        return
    line = os.environ[WORDS].split()
    try:
        at = int(os.environ.get(WORD, ""))
    except ValueError:
        return
    before, now = line[1:at], line[at] if at < len(line) else ""
    if any(mark in " ".join(line) for mark in "\"'\\"):
        return  # quoted words are the shell's affair
    words = gathered(before)
    if len(words) >= 2 and words[-2] in MANY_WORDS and not now.startswith("-") and not Path(now).exists():
        words.append(words[-2])
    os.environ[WORDS] = " ".join([line[0] if line else "twin", *words, now])
    os.environ[WORD] = str(len(words) + 1)


def three_numbers(option: str, text: str, shown: str, expected: str) -> tuple[float, float, float]:
    """Three numbers with commas between.

    Raises:
        InputError: it is not; with what was expected.
    """
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"{option} is not three numbers", expected=expected, value=shown)
    x, y, z = (number(option, part, shown) for part in parts)
    return x, y, z


def number(option: str, text: str, shown: str) -> float:
    """Return a number as `usable_number` wants it.

    Raises:
        InputError: it is not; with what was expected.
    """
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    usable_number(option, value, shown)
    return value


def usable_number(option: str, value: float, shown: object) -> None:
    """Raise `InputError` unless a number is finite and of a size that can be squared and divided by.

    Args:
        option: what it was given with.
        value: the number.
        shown: the text it was given as, for the message.

    Raises:
        InputError: it is not.
    """
    if not abs(value) < float("inf"):
        raise InputError(f"{option} is no number", expected="a finite number", value=shown)
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise InputError(
            f"{option} is beyond any machine",
            expected=f"0, or a number between {SMALLEST:g} and {LARGEST:g} in size",
            value=shown,
        )


def positive(option: str, value: float) -> None:
    """Nothing, if a value is a positive number.

    Raises:
        InputError: it is not; with what was expected.
    """
    if not 0.0 < value < float("inf"):
        raise InputError(f"{option} is out of place", expected="a positive number", value=value)
