"""Notes about rows of a measurement table that are not used, and the words for them in a text report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, final

FIRST_LINES: Final = 5
"""Line numbers of a group of notes that a text lists; the JSON has all."""


@final
@dataclass(frozen=True)
class RowNote:
    """Something about one line of the file.

    Attributes:
        line: 1-based line.
        text: what it is, with this row's own figures.
        kind: the reason without the row's figures, the same for all rows set aside for it; the text where empty.
        size: how bad it is, in any one unit; None where rows of this kind are equally bad.
    """

    line: int
    text: str
    kind: str = ""
    size: float | None = None


def grouped_notes(notes: Iterable[RowNote]) -> list[str]:
    """Return one line of text a reason: a count, the first lines and the worst row; a single row stands as it is.

    Args:
        notes: notes of any kinds; the groups keep the order in which their reasons first appear.
    """
    groups: dict[str, list[RowNote]] = {}
    for note in notes:
        groups.setdefault(note.kind or note.text, []).append(note)
    return [_group_text(kind, group) for kind, group in groups.items()]


def _group_text(kind: str, group: Sequence[RowNote]) -> str:
    if len(group) == 1:
        return f"line {group[0].line}: {group[0].text}"
    lines = ", ".join(str(note.line) for note in group[:FIRST_LINES])
    more = f" and {len(group) - FIRST_LINES:,} more" if len(group) > FIRST_LINES else ""
    text = f"{len(group):,} rows (lines {lines}{more}): {kind}"
    sized = [note for note in group if note.size is not None]
    if not sized:
        return text
    worst = max(sized, key=lambda note: note.size or 0.0)
    return f"{text}; worst, line {worst.line}: {worst.text}"
