"""Counts with their nouns."""

from __future__ import annotations


def count_with_noun(count: int, one: str) -> str:
    """Return a count with its noun: ``1 row``, ``1,234 rows``."""
    return f"{count:,} {one}{'' if count == 1 else 's'}"
