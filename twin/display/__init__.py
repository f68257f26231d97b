"""How results look in a notebook: tables, numbers with their uncertainty, small pictures. HTML and inline SVG, nothing fetched.

One place for all `_repr_html_` methods, which only say what goes where, and for pages: `render` fills in their templates, and
`twin.display.figures` (extra ``plots``) has what their pictures share. Colours of a display are those of whatever surrounds it
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
    render,
    spans,
    table,
)
from twin.display.numbers import (
    UNKNOWN,
    compact,
    expanded,
    figure,
    finite,
    fixed,
    measured,
    place,
    plain,
    readable,
    rounded,
    several,
    span,
    with_half,
)
from twin.display.pictures import graph, histogram, strip

__all__ = [
    "UNKNOWN",
    "Cell",
    "Html",
    "bar",
    "card",
    "chain",
    "chips",
    "compact",
    "expanded",
    "figure",
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
    "place",
    "plain",
    "readable",
    "render",
    "rounded",
    "several",
    "span",
    "spans",
    "strip",
    "table",
    "with_half",
]
