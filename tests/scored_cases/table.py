"""The benchmark's table, as text and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from tests.scored_cases.scores import SCORES, Score, mean

PLAIN: Final = ("group size", "seconds")
"""Scores that are not shares."""


def rows(
    answers: Sequence[tuple[str, str, str, Score]], *, names: Sequence[str] = tuple(SCORES)
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows: one row per method, machine and kind of case, in order of appearance.

    Args:
        answers: method, machine, kind and scores of every answer.
        names: names of the scores.
    """
    groups: dict[tuple[str, str, str], list[Score]] = {}
    for method, machine, kind, score in answers:
        groups.setdefault((method, machine, kind), []).append(score)
    used = [name for name in names if any(name in score for *_, score in answers)]
    body = [
        [*key, str(len(found)), *(_shown(name, mean(found, name)) for name in used)] for key, found in groups.items()
    ]
    return ["method", "machine", "case", "cases", *used], body


def _shown(name: str, value: float) -> str:
    if math.isnan(value):
        return "–"
    return f"{value:.1f}" if name in PLAIN else f"{100.0 * value:.0f} %"


def text(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Return the table as text with aligned columns."""
    every = [header, *body]
    widths = [max(len(row[i]) for row in every) for i in range(len(header))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in every]
    return "\n".join(lines) + "\n"


def markdown(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Return the table as Markdown."""
    lines = ["| " + " | ".join(row) + " |" for row in (header, ["---"] * len(header), *body)]
    return "\n".join(lines) + "\n"
