"""The benchmark's table, as text and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

from tests.scored_cases.scores import SCORES, Score, mean

PROBABILITIES: Final = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Limits of the rows of the reliability table."""
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


def reliability(stated: Mapping[str, Sequence[tuple[float, bool]]]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the reliability table: of the causes with a probability in a range, the share that is there.

    Args:
        stated: by method, the probability of each cause and whether it is there.
    """
    body = []
    for method, causes in stated.items():
        for low, high in pairwise(PROBABILITIES):
            within = [(p, there) for p, there in causes if low < p <= high or p == low == 0.0]
            if within:
                shares = [sum(p for p, _ in within) / len(within), sum(there for _, there in within) / len(within)]
                span = f"{100.0 * low:g} to {100.0 * high:g} %"
                body.append([method, span, str(len(within)), *(f"{100.0 * share:.1f} %" for share in shares)])
    return ["method", "probability stated", "causes", "mean", "there"], body


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
