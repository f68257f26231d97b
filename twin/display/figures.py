"""What all pictures share: palette, axes, polar plots, headings; how one is saved or put into a page. Needs the extra ``plots``.

Every function that draws returns a `Figure` of its own, which draws on no screen and shares no state; `save` writes it. Colours tell
apart for colour-blind readers, and line styles and markers do so without colour.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from twin.display.markup import Html, part
from twin.display.numbers import signed

FORWARD: Final = "#0072b2"
BACKWARD: Final = "#d55e00"
BOTH: Final = "#222222"
THIRD: Final = "#009e73"
RUN: Final = "#8a8a8a"
SHADE: Final = 0.22
"""Opacity of a 95 % band."""
HOLLOW: Final = 2.0
"""Radius of a polar plot's zero, in units of the largest deviation: the circle's size is arbitrary, deviations are not."""
HEADROOM: Final = 1.15
DEG: Final = np.pi / 180.0


def blank(width: float, height: float, layout: str | None = "constrained") -> Figure:
    """Return an empty figure of so many inches.

    Args:
        width: inches.
        height: inches.
        layout: who finds room for labels; None where the axes are placed by hand.
    """
    figure = Figure(figsize=(width, height), layout=layout)  # type: ignore[arg-type]
    FigureCanvasAgg(figure)
    return figure


def dress(plot: Axes) -> None:
    """A pale grid behind what is drawn, and no frame above and to the right."""
    plot.grid(color="#dddddd", linewidth=0.6)
    plot.set_axisbelow(True)
    plot.spines[["top", "right"]].set_visible(False)


def dots(plot: Axes, x: Any, y: Any, colour: str, marker: str = "o", size: float = 4.0, **more: Any) -> None:
    """Markers without a line; ``more`` as for `Axes.plot`."""
    plot.plot(x, y, color=colour, marker=marker, markersize=size, linestyle="", **more)


def paper(alpha: float, pad: float) -> dict[str, Any]:
    """Return the white box behind a text that stands in a picture."""
    return {"facecolor": "white", "edgecolor": "none", "alpha": alpha, "pad": pad}


def heading(figure: Figure, text: str, size: float = 12.0) -> None:
    """A heading over all of a figure's plots."""
    figure.suptitle(text, x=0.01, horizontalalignment="left", fontweight="bold", fontsize=size)


def legend_below(figure: Figure, *, columns: int | None = None, size: float = 9.0) -> None:
    """The legend of a figure's first plot, below all of them.

    Args:
        figure: the figure.
        columns: entries side by side; all if None.
        size: of its letters.
    """
    handles, labels = figure.axes[0].get_legend_handles_labels()
    where: dict[str, Any] = {"loc": "outside lower center", "ncols": columns or len(labels)}
    figure.legend(handles, labels, **where, frameon=False, fontsize=size)


def polar_ticks(plot: PolarAxes, extent: float, domain: Sequence[float]) -> tuple[list[tuple[float, str]], bool]:
    """Room for deviations inside and outside of a polar plot's zero, and a range of its own where it is less than a turn.

    Args:
        plot: the plot.
        extent: largest deviation.
        domain: ends of the angle, degrees.

    Returns:
        Round radii with their labels, to be drawn; and whether the plot is a full turn.
    """
    plot.set_ylim(-HOLLOW * extent, HEADROOM * extent)
    full = domain[1] - domain[0] > 350.0
    if not full:
        plot.set_thetamin(domain[0])
        plot.set_thetamax(domain[1])
    plot.grid(color="#cccccc", linewidth=0.5)
    ticks = [tick for tick in MaxNLocator(4, symmetric=True).tick_values(-extent, extent) if abs(tick) <= extent]
    return [(tick, radius_label(tick)) for tick in ticks], full


def radius_label(tick: float) -> str:
    """Return a deviation with its sign; none before nothing."""
    return signed(f"{tick:+g}") if tick else "0"


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> None:
    """Write a figure; the ending says how (png, pdf, svg).

    Args:
        figure: what to write.
        path: where to.
        dpi: dots an inch, for a png.
    """
    figure.savefig(path, dpi=dpi)


def embedded(figure: Figure, words: str, caption: str = "", kind: str = "") -> Html:
    """A picture in the page itself, the same bytes for the same picture.

    Args:
        figure: the picture.
        words: what it shows, for whoever cannot see it.
        caption: plain text below it; none if empty.
        kind: its class in the style sheet; none if empty.
    """
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "twin", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return part("figure", base64.b64encode(buffer.getvalue()).decode(), words, caption, kind)
