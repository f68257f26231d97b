"""Display of results: one line of text, and in a notebook HTML from one renderer.

Every result states `Result.brief`. A result that a notebook displays also states `DisplayedResult.display`; only `Display.html` makes
HTML of it. The full text of a result is its ``to_text()``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

from twin.display.markup import ACCENT, WARNING, Cell, Html, pairs, part

LONGEST: Final = 200
"""Characters of the one line; a line with a long path or list is cut."""


class Result(ABC):
    """Base class of results: ``str`` and ``repr`` are one short line. A dataclass needs ``repr=False``."""

    @property
    @abstractmethod
    def brief(self) -> str:
        """One line: kind of result and its most important figures with units."""

    def __str__(self) -> str:
        text = " ".join(self.brief.split())
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self}>"


@final
@dataclass(frozen=True)
class Display:
    """Content of a display in a notebook."""

    title: str
    rows: Sequence[tuple[str, Cell]] = ()  # names with their values, one per line; empty values are omitted
    above: Sequence[Cell] = ()  # notes, tables and pictures above the rows
    below: Sequence[Cell] = ()  # the same below them
    small: str = ""  # small text next to the title
    illustrative: bool = False  # whether some numbers are assumed, not measured; adds a warning under the title
    wrong: bool = False  # whether a requirement was not met; sets the warning colour

    def html(self) -> Html:
        """Return the display as HTML."""
        edge = WARNING if self.wrong or self.illustrative else ACCENT
        content = (*self.above, pairs(self.rows), *self.below)
        return part("card", self.title, content, self.small, self.illustrative, edge)


class DisplayedResult(Result):
    """Base class of results that a notebook displays as HTML."""

    @abstractmethod
    def display(self) -> Display:
        """Return the content of the display."""

    @final
    def _repr_html_(self) -> str:
        return self.display().html().text
