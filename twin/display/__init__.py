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
    in_iframe,
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
    finite_or_none,
    fixed,
    measured,
    place,
    plain,
    readable,
    rounded,
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
    "finite_or_none",
    "first_rows",
    "fixed",
    "graph",
    "histogram",
    "in_iframe",
    "joined",
    "measured",
    "note",
    "pairs",
    "place",
    "plain",
    "readable",
    "render",
    "rounded",
    "span",
    "spans",
    "strip",
    "table",
    "with_half",
]
