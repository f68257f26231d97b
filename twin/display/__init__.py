"""Display of results in notebooks and pages: tables and numbers with their uncertainty, as self-contained HTML.

`twin.display.results` shows every result with them; `render` fills in page templates; `twin.display.figures` (extra ``plots``) holds
the common style of matplotlib pictures. Displays use the surrounding text colour (``currentColor``), light or dark, and two accent
colours that are legible on both. Text is escaped unless it is `Html`. This package is independent of the objects that it displays.
"""

from twin.display.markup import (
    Cell,
    Html,
    bar,
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

__all__ = [
    "UNKNOWN",
    "Cell",
    "Html",
    "bar",
    "chain",
    "chips",
    "compact",
    "expanded",
    "figure",
    "finite_or_none",
    "first_rows",
    "fixed",
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
    "table",
    "with_half",
]
