"""Parts of sentences in plain text: lists of names, capital and small first letters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

MANY: Final = 8
"""Items listed by name; the rest are counted."""


def capital(text: str) -> str:
    """Return the text with a capital first letter."""
    return text[:1].upper() + text[1:]


def lower(text: str) -> str:
    """Return a name for the middle of a sentence, in lower case unless it starts with the letter of an axis."""
    return text if text[1:2] == " " else text[:1].lower() + text[1:]


def listed(names: Sequence[str], *, most: int = MANY) -> str:
    """Return the names as "A, B and C"; above ``most`` names, the first ones and the number of the others."""
    if len(names) > most:
        return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
