"""HTML elements of displays, and access to the templates of the package."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, final

from twin._common.messages import Message, Number, Quoted, is_translated, say, say_html
from twin.display.numbers import (
    UNKNOWN,
    capital,
    compact,
    expanded,
    figure,
    fixed,
    listed,
    lower,
    p_value_text,
    place,
    readable,
    with_half,
    with_joined_units,
)

if TYPE_CHECKING:
    from jinja2 import Environment

ACCENT: Final = "#3d85c6"
"""Accent colours, blue and vermilion: contrast above 3:1 on white and on near black, distinct for all colour vision."""
WARNING: Final = "#d55e00"
ROWS: Final = 6
"""Number of rows of a long array that are shown."""
KIT: Final = "display/templates/kit.html.j2"
PARTS: Final = "display/templates/parts.html.j2"


@final
@dataclass(frozen=True)
class Html:
    """Text that is HTML and must not be escaped."""

    text: str

    def __html__(self) -> str:
        """Return the unescaped text, for templates."""
        return self.text


Cell = str | Html


@cache
def templates() -> Environment:
    """Return the environment of the package's templates, by path in the package; text is escaped unless it is `Html`.

    In templates, ``_`` makes a message; ``number`` and the filter ``quoted`` mark text as in `twin._common.messages`.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # slow to import and needed only for HTML

    templates = Environment(
        loader=PackageLoader("twin", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_in_language,
    )
    templates.globals |= {"ACCENT": ACCENT, "WARNING": WARNING, "UNKNOWN": UNKNOWN, "_": Message, "number": Number}
    templates.globals |= {
        one.__name__: one
        for one in (
            capital,
            compact,
            expanded,
            figure,
            fixed,
            isfinite,
            listed,
            lower,
            p_value_text,
            place,
            readable,
            with_half,
        )
    }
    templates.filters["quoted"] = Quoted
    templates.filters["with_joined_units"] = lambda text: with_joined_units(str(text), "&nbsp;")
    templates.globals["say"] = say
    templates.globals["page"] = templates.get_template(PARTS).module
    return templates


def _in_language(value: Any) -> Any:
    """Return a value for a template: text that the current language changes as HTML in that language, all else as it is."""
    return Html(say_html(value)) if is_translated(value) else value


def render(template: str, **context: Any) -> str:
    """Return a template, given by its path in the package, rendered with its variables."""
    return templates().get_template(template).render(context)


def part(name: str, *arguments: Any) -> Html:
    """Return an element of a display: the result of a macro of `KIT`."""
    return Html(str(getattr(_kit(), name)(*arguments)).strip())


@cache
def _kit() -> Any:
    return templates().get_template(KIT).module


def joined(*parts: Cell) -> Html:
    """Return the concatenation of parts."""
    return part("joined", parts)


def table(
    headers: Sequence[str], rows: Iterable[Sequence[Cell]], *, right: Iterable[int] = (), title: str = ""
) -> Html:
    """Return a table with a title above it, or empty text if there are no rows; ``right``: indices of right-aligned columns."""
    body = list(rows)
    return part("table", headers, body, set(right), title) if body else Html("")


def pairs(rows: Iterable[tuple[str, Cell]]) -> Html:
    """Return names with their values, one per line; empty values are omitted."""
    shown = [(name, value) for name, value in rows if value not in ("", Html(""))]
    return part("pairs", shown) if shown else Html("")


def note(text: Cell, *, loud: bool = False) -> Html:
    """Return a note, highlighted if ``loud``."""
    return part("note", text, loud)


def chips(texts: Iterable[Cell]) -> Html:
    """Return short texts in a row that wraps."""
    return part("chips", texts)


def chain(links: Sequence[tuple[str, str]]) -> Html:
    """Return a chain of connected boxes: text and kind (``axis``, ``fixed`` or ``end``) of each."""
    return part("chain", links)


def bar(share: float, *, loud: bool = False) -> Html:
    """Return a bar whose length is a share, 0 … 1, of its column."""
    return part("bar", f"{7.0 * min(max(share, 0.0), 1.0):.2f}", loud)


def spans(values: Iterable[tuple[str, float, float, str]]) -> Html:
    """Return names with their ranges, each given as (name, low, high, unit)."""
    return chips(
        f"{name} {f'{low:g}' if low == high else f'{low:g} … {high:g}'} {unit}".replace("-", "−")
        for name, low, high, unit in values
    )


def in_iframe(page: str, height_px: int) -> Html:
    """Return a page in an iframe of full width, which isolates its scripts."""
    return part("framed", page, height_px)


def first_rows(count: int, row: Callable[[int], Sequence[Cell]]) -> tuple[list[Sequence[Cell]], Html]:
    """Return the first rows of a long array, and a note with the number of rows not shown."""
    shown = min(count, ROWS)
    rest = note(f"… and {count - shown:,} more") if count > shown else Html("")
    return [row(i) for i in range(shown)], rest
