"""Display of results in notebooks and pages: tables, numbers with their uncertainty, small pictures, as self-contained HTML and SVG.

All `_repr_html_` methods use these functions. `render` fills in page templates; `twin.display.figures` (extra ``plots``) holds the
common style of matplotlib pictures. Displays use the surrounding text colour (``currentColor``), light or dark, and two accent colours
that are legible on both. Text is escaped unless it is `Html`. This package is independent of the objects that it displays.
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
