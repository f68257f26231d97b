"""HTML of a display: a card with tables in it; and the way to every template of the package."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, final

from twin.display.numbers import UNKNOWN, compact, expanded, figure, fixed, place, readable, tied, with_half

if TYPE_CHECKING:
    from jinja2 import Environment

ACCENT: Final = "#3d85c6"
"""Blue and vermilion, over 3:1 against white and against near black, and apart for every kind of colour vision."""
WARNING: Final = "#d55e00"
ROWS: Final = 6
"""Rows of a long array that are shown."""
KIT: Final = "display/templates/kit.html.j2"
PARTS: Final = "display/templates/parts.html.j2"


@final
@dataclass(frozen=True)
class Html:
    """Text that is markup already."""

    text: str

    def __html__(self) -> str:
        """Return the text as it is, for a template."""
        return self.text


Cell = str | Html


@cache
def templates() -> Environment:
    """Return the package's templates by their path in it; text is escaped unless it is `Html`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # takes its time, and only HTML needs it

    found = Environment(
        loader=PackageLoader("twin", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.globals |= {"ACCENT": ACCENT, "WARNING": WARNING, "UNKNOWN": UNKNOWN}
    found.globals |= {
        one.__name__: one for one in (compact, expanded, figure, fixed, isfinite, place, readable, with_half)
    }
    found.filters["tied"] = lambda text: tied(str(text), "&nbsp;")
    found.globals["page"] = found.get_template(PARTS).module
    return found


def render(template: str, **context: Any) -> str:
    """Return a template with its names filled in.

    Args:
        template: path of the file in the package.
        context: what its names stand for.
    """
    return templates().get_template(template).render(context)


def part(name: str, *arguments: Any) -> Html:
    """Return a part of a display: a macro of `KIT`, filled in."""
    return Html(str(getattr(_kit(), name)(*arguments)).strip())


@cache
def _kit() -> Any:
    return templates().get_template(KIT).module


def joined(*parts: Cell) -> Html:
    """Parts, one after the other."""
    return part("joined", parts)


def card(title: str, *parts: Cell, small: str = "", illustrative: bool = False, wrong: bool = False) -> Html:
    """The whole display.

    Args:
        title: what it is.
        parts: what stands below, `Html` or plain text.
        small: said beside the title.
        illustrative: whether its numbers are drawn, not measured; said right under the title.
        wrong: whether something was not met: another edge.
    """
    return part("card", title, parts, small, illustrative, WARNING if wrong or illustrative else ACCENT)


def table(
    headers: Sequence[str], rows: Iterable[Sequence[Cell]], *, right: Iterable[int] = (), title: str = ""
) -> Html:
    """A table; nothing without rows.

    Args:
        headers: of the columns, with their units.
        rows: cells, as many as columns.
        right: columns of numbers.
        title: said above.
    """
    body = list(rows)
    return part("table", headers, body, set(right), title) if body else Html("")


def pairs(rows: Iterable[tuple[str, Cell]]) -> Html:
    """Names and what they are, one a line; nothing where a value is empty."""
    told = [(name, value) for name, value in rows if value not in ("", Html(""))]
    return part("pairs", told) if told else Html("")


def note(text: Cell, *, loud: bool = False) -> Html:
    """A sentence below."""
    return part("note", text, loud)


def chips(texts: Iterable[Cell]) -> Html:
    """Short things side by side, that wrap."""
    return part("chips", texts)


def chain(links: Sequence[tuple[str, str]]) -> Html:
    """A chain of boxes from end to end.

    Args:
        links: text of every box, and ``axis``, ``fixed`` or ``end``.
    """
    return part("chain", links)


def bar(share: float, *, loud: bool = False) -> Html:
    """A bar, from 0 to 1 of its column."""
    return part("bar", f"{7.0 * min(max(share, 0.0), 1.0):.2f}", loud)


def spans(values: Iterable[tuple[str, float, float, str]]) -> Html:
    """Names with the range they go over: (name, low, high, unit)."""
    return chips(
        f"{name} {f'{low:g}' if low == high else f'{low:g} … {high:g}'} {unit}".replace("-", "−")
        for name, low, high, unit in values
    )


def framed(page: str, height_px: int) -> Html:
    """A whole page inside another, as wide as there is room; the page's own scripts run in a frame of their own."""
    return part("framed", page, height_px)


def first_rows(count: int, row: Callable[[int], Sequence[Cell]]) -> tuple[list[Sequence[Cell]], Html]:
    """The first rows of a long array, and how many are not shown."""
    shown = min(count, ROWS)
    rest = note(f"… and {count - shown:,} more") if count > shown else Html("")
    return [row(i) for i in range(shown)], rest
