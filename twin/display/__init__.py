"""How results look in a notebook: tables, numbers with their uncertainty, small pictures. HTML and inline SVG, nothing fetched.

One place for all `_repr_html_` methods, which only say what goes where. Colours are those of whatever surrounds the display
(``currentColor``), light or dark, but for two accents that read on both. Text is escaped unless it is an `Html` already. Nothing here
knows what it shows.
"""

from twin.display.markup import (
    Cell,
    Html,
    bar,
    card,
    chain,
    chips,
    first_rows,
    framed,
    joined,
    note,
    pairs,
    spans,
    table,
)
from twin.display.numbers import COVERAGE, UNKNOWN, finite, fixed, measured, plain, readable, rounded, several, span
from twin.display.pictures import graph, histogram, strip

__all__ = [
    "COVERAGE",
    "UNKNOWN",
    "Cell",
    "Html",
    "bar",
    "card",
    "chain",
    "chips",
    "finite",
    "first_rows",
    "fixed",
    "framed",
    "graph",
    "histogram",
    "joined",
    "measured",
    "note",
    "pairs",
    "plain",
    "readable",
    "rounded",
    "several",
    "span",
    "spans",
    "strip",
    "table",
]
