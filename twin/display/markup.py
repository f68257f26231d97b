"""HTML of a display: a card with tables in it. No style sheet, since many displays share one page: every style stands where it acts."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, final

ACCENT: Final = "#3d85c6"
"""Blue and vermilion, over 3:1 against white and against near black, and apart for every kind of colour vision."""
WARNING: Final = "#d55e00"
ROWS: Final = 6
"""Rows of a long array that are shown."""
_LINE: Final = "rgba(128,128,128,.4)"
_PALE: Final = "opacity:.75"


@final
@dataclass(frozen=True)
class Html:
    """Text that is markup already."""

    text: str


Cell = str | Html


def markup(cell: Cell) -> str:
    """A cell as markup: plain text escaped."""
    return cell.text if isinstance(cell, Html) else html.escape(cell)


def joined(*parts: Cell) -> Html:
    """Parts, one after the other."""
    return Html("".join(markup(part) for part in parts))


def card(title: str, *parts: Cell, small: str = "", illustrative: bool = False, wrong: bool = False) -> Html:
    """The whole display.

    Args:
        title: what it is.
        parts: what stands below, `Html` or plain text.
        small: said beside the title.
        illustrative: whether its numbers are drawn, not measured; said right under the title.
        wrong: whether something was not met: another edge.
    """
    edge = WARNING if wrong or illustrative else ACCENT
    beside = f" <span style='{_PALE};font-weight:400'>{html.escape(small)}</span>" if small else ""
    drawn = (
        f"<div style='margin:.3em 0;padding:.15em .6em;border:1px solid {WARNING};border-radius:.25em;display:inline-block'>"
        "<b>ILLUSTRATIVE</b>: some of its numbers are drawn, not measured. Do not cut with it.</div>"
        if illustrative
        else ""
    )
    return Html(
        f"<div style='border-left:.3em solid {edge};padding:.2em 0 .3em .9em;margin:.2em 0;max-width:58em;overflow-x:auto;"
        "line-height:1.4'>"
        f"<div><b style='font-size:1.08em'>{html.escape(title)}</b>{beside}</div>{drawn}{''.join(map(markup, parts))}</div>"
    )


def table(
    headers: Sequence[str], rows: Iterable[Sequence[Cell]], *, right: Iterable[int] = (), title: str = ""
) -> Html:
    """A table; nothing without rows.

    Args:
        headers: of the columns, with their units.
        rows: cells.
        right: columns of numbers.
        title: said above.
    """
    body = list(rows)
    if not body:
        return Html("")
    aligned = ["right" if i in set(right) else "left" for i in range(len(headers))]
    cell = "padding:.12em .7em .12em 0;vertical-align:top;background:none;border:none;font-variant-numeric:tabular-nums"
    head = "".join(
        f"<th style='{cell};text-align:{side};font-weight:600;border-bottom:1px solid {_LINE}'>{html.escape(name)}</th>"
        for name, side in zip(headers, aligned, strict=True)
    )
    lines = "".join(
        "<tr style='background:none'>"
        + "".join(
            f"<td style='{cell};text-align:{side}'>{markup(text)}</td>" for text, side in zip(row, aligned, strict=True)
        )
        + "</tr>"
        for row in body
    )
    above = f"<div style='margin-top:.5em;{_PALE}'>{html.escape(title)}</div>" if title else ""
    return Html(
        f"{above}<table style='border-collapse:collapse;margin:.2em 0;font-size:.95em;border:none'>"
        f"<thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"
    )


def pairs(rows: Iterable[tuple[str, Cell]]) -> Html:
    """Names and what they are, one a line; nothing where a value is empty."""
    lines = "".join(
        f"<tr style='background:none'><td style='{_PALE};padding:0 1em 0 0;text-align:left;vertical-align:top;border:none;"
        f"white-space:nowrap'>{html.escape(name)}</td>"
        f"<td style='padding:0;text-align:left;border:none'>{markup(value)}</td></tr>"
        for name, value in rows
        if markup(value)
    )
    style = "border-collapse:collapse;margin:.2em 0;font-size:.95em;border:none"
    return Html(f"<table style='{style}'><tbody>{lines}</tbody></table>" if lines else "")


def note(text: Cell, *, loud: bool = False) -> Html:
    """A sentence below."""
    style = f"border-left:3px solid {WARNING};padding-left:.5em" if loud else _PALE
    return Html(f"<div style='margin:.25em 0;font-size:.92em;{style}'>{markup(text)}</div>")


def chips(texts: Iterable[Cell]) -> Html:
    """Short things side by side, that wrap."""
    style = "display:inline-block;margin:0 1.3em .1em 0;white-space:nowrap;font-variant-numeric:tabular-nums"
    return Html("".join(f"<span style='{style}'>{markup(text)}</span> " for text in texts))


def chain(links: Sequence[tuple[str, str]]) -> Html:
    """A chain of boxes from end to end.

    Args:
        links: text of every box, and ``axis``, ``fixed`` or ``end``.
    """
    border = {
        "axis": f"1.5px solid {ACCENT}",
        "fixed": f"1.5px solid {_LINE};background:rgba(128,128,128,.18)",
        "end": f"1.5px dashed {_LINE}",
    }
    boxes = [
        f"<span style='display:inline-block;border:{border[kind]};border-radius:.3em;padding:.05em .5em'>{html.escape(text)}</span>"
        for text, kind in links
    ]
    return Html(f"<div style='margin:.4em 0;line-height:2'>{' – '.join(boxes)}</div>")


def bar(share: float, *, loud: bool = False) -> Html:
    """A bar, from 0 to 1 of its column."""
    width, colour = 7.0 * min(max(share, 0.0), 1.0), WARNING if loud else ACCENT
    return Html(
        f"<span style='display:inline-block;height:.65em;width:{width:.2f}em;min-width:1px;background:{colour}'></span>"
    )


def spans(values: Iterable[tuple[str, float, float, str]]) -> Html:
    """Names with the range they go over: (name, low, high, unit)."""
    return chips(
        f"{name} {low:g} … {high:g} {unit}".replace("-", "−")
        if low != high
        else f"{name} {low:g} {unit}".replace("-", "−")
        for name, low, high, unit in values
    )


def framed(page: str, height_px: int) -> Html:
    """A whole page inside another, as wide as there is room; the page's own scripts run in a frame of their own."""
    style = f"width:100%;height:{height_px}px;border:1px solid {_LINE};border-radius:.3em"
    return Html(f'<div><iframe srcdoc="{html.escape(page)}" style="{style}"></iframe></div>')


def first_rows(count: int, row: Callable[[int], Sequence[Cell]]) -> tuple[list[Sequence[Cell]], Html]:
    """The first rows of a long array, and how many are not shown."""
    shown = min(count, ROWS)
    rest = note(f"… and {count - shown:,} more") if count > shown else Html("")
    return [row(i) for i in range(shown)], rest
