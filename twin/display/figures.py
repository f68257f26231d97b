"""Common style of matplotlib pictures: palette, axes, polar plots, headings; saving and embedding. Needs the extra ``plots``.

Every drawing function returns a new `Figure` without a screen or shared state; `save` writes it. Colour-blind readers can distinguish
the colours; line styles and markers also distinguish curves without colour.
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

GRID: Final[dict[str, Any]] = {"color": "#dddddd", "linewidth": 0.6}
"""Looks of a grid behind the data."""
FORWARD: Final = "#0072b2"
BACKWARD: Final = "#d55e00"
BOTH: Final = "#222222"
THIRD: Final = "#009e73"
RUN: Final = "#8a8a8a"
SHADE: Final = 0.22
"""Opacity of a 95 % band."""
HOLLOW: Final = 2.0
"""Radius of the zero circle of a polar plot, in units of the largest deviation."""
HEADROOM: Final = 1.15
DEG: Final = np.pi / 180.0


def new_figure(width: float, height: float, layout: str | None = "constrained") -> Figure:
    """Return an empty figure of a size in inches.

    Args:
        width: inches.
        height: inches.
        layout: matplotlib's layout engine; None if the axes are placed explicitly.
    """
    figure = Figure(figsize=(width, height), layout=layout)  # type: ignore[arg-type]
    FigureCanvasAgg(figure)
    return figure


def style_axes(plot: Axes) -> None:
    """Add a pale grid behind the data and hide the top and right spines."""
    plot.grid(**GRID)
    plot.set_axisbelow(True)
    plot.spines[["top", "right"]].set_visible(False)


def plot_markers(plot: Axes, x: Any, y: Any, colour: str, marker: str = "o", size: float = 4.0, **more: Any) -> None:
    """Draw markers without a line; ``more`` as for `Axes.plot`."""
    plot.plot(x, y, color=colour, marker=marker, markersize=size, linestyle="", **more)


def text_box_style(alpha: float, pad: float) -> dict[str, Any]:
    """Return the properties of the white box behind a text in a picture."""
    return {"facecolor": "white", "edgecolor": "none", "alpha": alpha, "pad": pad}


def heading(figure: Figure, text: str, size: float = 12.0) -> None:
    """Add a heading above all plots of a figure."""
    figure.suptitle(text, x=0.01, horizontalalignment="left", fontweight="bold", fontsize=size)


def legend_below(figure: Figure, *, columns: int | None = None, size: float = 9.0) -> None:
    """Add the legend of a figure's first plot below all plots.

    Args:
        figure: the figure.
        columns: number of columns; None for one row.
        size: font size.
    """
    handles, labels = figure.axes[0].get_legend_handles_labels()
    where: dict[str, Any] = {"loc": "outside lower center", "ncols": columns or len(labels)}
    figure.legend(handles, labels, **where, frameon=False, fontsize=size)


def polar_ticks(plot: PolarAxes, extent: float, domain: Sequence[float]) -> tuple[list[tuple[float, str]], bool]:
    """Set the radial range of a polar plot around its zero circle, and its angular range if less than a turn.

    Args:
        plot: the plot.
        extent: largest absolute deviation.
        domain: ends of the angular range, degrees.

    Returns:
        Tick radii with their labels, to be drawn by the caller; and whether the plot is a full turn.
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
    """Return a deviation with its sign; zero has none."""
    return signed(f"{tick:+g}") if tick else "0"


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> None:
    """Write a figure in the format of the file's suffix (png, pdf, svg).

    Args:
        figure: the figure.
        path: path of the file.
        dpi: dots per inch, for png.
    """
    figure.savefig(path, dpi=dpi)


def embedded(figure: Figure, words: str, caption: str = "", kind: str = "") -> Html:
    """Return a picture embedded as SVG; the same picture gives the same bytes.

    Args:
        figure: the picture.
        words: alternative text.
        caption: caption as plain text; none if empty.
        kind: CSS class; none if empty.
    """
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "twin", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return part("figure", base64.b64encode(buffer.getvalue()).decode(), words, caption, kind)
