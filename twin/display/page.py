"""What self-contained HTML pages share: their look, pictures embedded in them, and the plainest parts. Needs the extra ``plots``.

Nothing is fetched; symbols stand beside words, never instead of them.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from typing import Final

import matplotlib
from matplotlib.figure import Figure

STYLE: Final = """
*{box-sizing:border-box}
body{font:16px/1.45 system-ui,-apple-system,"Segoe UI",sans-serif;max-width:62rem;margin:0 auto;padding:.6rem 1.2rem 4rem;
color:#1b1b1b;background:#fff;overflow-wrap:anywhere}
h1{font-size:1.55rem;line-height:1.25;margin:.1rem 0 .6rem}
h2{font-size:1.2rem;margin:2.2rem 0 .4rem;border-bottom:1px solid #ccc}
h3{font-size:1.02rem;margin:1.2rem 0 .3rem}p{margin:.4rem 0}ul{margin:.3rem 0;padding-left:1.3rem}
pre{margin:.3rem 0;white-space:pre-wrap;font-size:.9rem}
.verdict{padding:.9rem 1.2rem 1rem;border-radius:.5rem;border:1px solid #0002}
.cause{margin:.5rem 0}.symbol{color:#555;font-size:.85rem;font-weight:400}.small,figcaption{color:#555;font-size:.88rem}
.badge{display:inline-block;background:#1b1b1b;color:#fff;border-radius:.25rem;padding:.05rem .5rem;font-size:.85rem;font-weight:600}
dl{display:grid;grid-template-columns:8.5rem 1fr;gap:.3rem .8rem;margin:.7rem 0 0}dt{font-weight:600}dd{margin:0}
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%;margin:.6rem 0;font-size:.95rem}
td,th{border-bottom:1px solid #ddd;padding:.25rem .5rem;text-align:left;vertical-align:top}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}td.w{white-space:nowrap}
td.bars{width:20%}.bar{display:block;height:.7rem;margin-top:.3rem;background:#8a8a8a;min-width:1px}
.bar.found{background:#d55e00}.bar.doubted{background:#0072b2}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,17rem),1fr));gap:.6rem 1rem;margin:.6rem 0}
.why{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,22rem),1fr));gap:.4rem 1.6rem}
figure{margin:0;max-width:30rem}figure img{width:100%;display:block}
@media(max-width:600px){body{padding:.5rem .8rem 3rem;font-size:15px}h1{font-size:1.3rem}.verdict{padding:.7rem .8rem}
dl{grid-template-columns:1fr;gap:.1rem}dd{margin:0 0 .45rem}td.bars,th.bars{display:none}td,th{padding:.25rem .3rem}}
@media print{body{max-width:none;font-size:10.5pt}h2,h3{break-after:avoid}figure,tr,.verdict{break-inside:avoid}
*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
"""


def document(title: str, body: str, *, more_style: str = "", head: str = "") -> str:
    """The whole page.

    Args:
        title: plain text.
        body: HTML.
        more_style: rules after those of `STYLE`.
        head: HTML of the page's head, before the title.
    """
    return (
        f'<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width,initial-scale=1">{head}'
        f"<title>{escaped(title)}</title><style>{STYLE}{more_style}</style><body>{body}</body></html>\n"
    )


def embedded(figure: Figure, words: str, caption: str) -> str:
    """A picture in the page itself, the same bytes for the same picture.

    Args:
        figure: the picture.
        words: what it shows, for whoever cannot see it.
        caption: plain text below it; none if empty.
    """
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "twin", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    code = base64.b64encode(buffer.getvalue()).decode()
    told = f"<figcaption>{escaped(caption)}</figcaption>" if caption else ""
    return f'<figure><img alt="{escaped(words)}" src="data:image/svg+xml;base64,{code}">{told}</figure>'


def facts(*told: tuple[str, str]) -> str:
    """Names with what there is to say of each, plain text."""
    return "<dl>" + "".join(f"<dt>{escaped(name)}<dd>{escaped(text)}" for name, text in told) + "</dl>" if told else ""


def bullets(items: Iterable[str]) -> str:
    """A list of items that are HTML already; nothing of none."""
    rows = "".join(f"<li>{item}" for item in items)
    return f"<ul>{rows}</ul>" if rows else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = ()) -> str:
    """A table of cells that are HTML already.

    Args:
        head: of the columns.
        rows: cells, as many as columns.
        numbers: columns that are set to the right.
    """
    kinds = [" class=n" if i in numbers else "" for i in range(len(head))]
    top = "".join(f"<th{kind}>{cell}" for kind, cell in zip(kinds, head, strict=True))
    body = "".join("<tr>" + "".join(f"<td{kind}>{cell}" for kind, cell in zip(kinds, row, strict=True)) for row in rows)
    return f"<div class=wide><table><thead><tr>{top}</thead><tbody>{body}</tbody></table></div>"


def escaped(text: str) -> str:
    """Plain text as HTML."""
    return html.escape(text)
