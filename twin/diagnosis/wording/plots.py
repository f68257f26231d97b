"""Plots of a diagnosis: the residuals, a cause with the readings that show it, the ranking of causes. Needs the extra ``plots``.

Dots are means over groups of readings, with the 95 % interval of the mean from their spread; a line is the fitted cause. Every
function returns a new `Figure` in the colours of `twin.display.figures`; marker shapes repeat the distinction that the colours make.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from twin._common.errors import InputError
from twin.diagnosis.result import DiagnosisResult
from twin.diagnosis.wording.panels import (
    FEWEST,
    Panel,
    cause_panels,
    directed,
    group_means,
    group_numbers,
    residual_panels,
    scales_of,
)
from twin.diagnosis.wording.words import cause_title
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, heading, new_figure, style_axes

WIDE: Final = 3
"""Panels in a row."""
TICKS: Final = 6
CELLS: Final = 6
"""Cells along each side of a map."""
DIRECTIONS: Final = ("in x", "in y", "in z")
"""Each direction keeps its style, whichever directions are drawn."""
NOTHING: Final = "#dddddd"
"""Colour of cells without a reading; the middle of the colour scale is white."""
ABOVE: Final[dict[str, Any]] = {
    "fontsize": 8, "frameon": False, "ncols": 3, "loc": "lower left", "bbox_to_anchor": (-0.02, 0.99), "borderaxespad": 0.0,
    "columnspacing": 1.2, "handletextpad": 0.4,
}  # fmt: skip
"""Options of a legend placed above its panel."""
STYLES: Final = ((FORWARD, "o", "-"), (BACKWARD, "s", "--"), (THIRD, "^", "-."))


def plot_residuals(found: DiagnosisResult, *, after: bool = False, title: str = "") -> Figure:
    """Plot the residuals against the columns that show them most clearly, in the directions of the machine's base.

    Args:
        found: the diagnosis.
        after: plot the residuals with the causes in the model, on the same scale.
        title: heading; a default if empty.
    """
    about = "Residuals with the causes in the model" if after else "Residuals"
    return _drawn(residual_panels(found, after=after), title or about)


def plot_cause(found: DiagnosisResult, cause: int = 0, *, title: str = "") -> Figure:
    """Plot a fitted cause, and the readings after removing all other causes.

    Args:
        found: the diagnosis.
        cause: index in `DiagnosisResult.causes`.
        title: heading; a default if empty.

    Raises:
        InputError: no such cause.
    """
    if not 0 <= cause < len(found.causes):
        raise InputError("no such cause", expected=f"less than {len(found.causes)}", value=cause)
    one = found.causes[cause]
    return _drawn(
        cause_panels(found, one), title or f"{cause_title(one.effect, one.where)}: fitted (line), measured (dots)"
    )


def plot_ranking(found: DiagnosisResult, *, title: str = "") -> Figure:
    """Plot the χ² that each cause tested explains by itself.

    Args:
        found: the diagnosis.
        title: heading; a default if empty.
    """
    rows = found.ranking[::-1]
    figure = new_figure(9.0, 0.9 + 0.34 * max(len(rows), 1))
    plot = figure.add_subplot()
    named = {(cause.effect, cause.where) for cause in found.causes}
    doubted = {key for cause in found.causes for key in cause.equivalent}
    for colour, of, label in (
        (BACKWARD, named, "found"),
        (FORWARD, doubted - named, "confounded with a cause found"),
        (RUN, {(effect, where) for effect, where, *_ in rows} - named - doubted, "less likely"),
    ):
        at = [i for i, (effect, where, *_) in enumerate(rows) if (effect, where) in of]
        if at:
            plot.barh(at, [rows[i][2] for i in at], color=colour, label=label)
    plot.set_yticks(range(len(rows)), [cause_title(effect, where) for effect, where, *_ in rows], fontsize=9)
    plot.set_xlabel("χ² explained by this cause alone [1]")
    plot.spines[["top", "right"]].set_visible(False)
    if rows:
        plot.legend(loc="lower right", frameon=False, fontsize=9)
    heading(figure, title or f"The best of {found.tried} causes tested", 11)
    return figure


def plot_unexplained(found: DiagnosisResult, *, title: str = "") -> Figure | None:
    """Plot the unexplained residuals over the two columns they depend on, in the clearest direction; None for fewer columns.

    Args:
        found: the diagnosis.
        title: heading; a default if empty.
    """
    left, scales, data = found.unexplained, scales_of(found), found.data
    names = [name for name in left.depends_on if name in scales and not scales[name].ticks] if left is not None else []
    if left is None or len(names) < 2:
        return None
    x, y = scales[names[0]], scales[names[1]]
    rows = data.carrier == left.carrier if left.carrier in data.carrier else np.ones(len(data), dtype=bool)
    edges = [np.linspace(v.min(), v.max(), CELLS + 1) for v in (x.values[rows], y.values[rows])]
    maps = {}
    for name, values in directed(found, found.after_um).items():
        of = rows & np.isfinite(values)
        count, *_ = np.histogram2d(x.values[of], y.values[of], edges)
        total, *_ = np.histogram2d(x.values[of], y.values[of], edges, weights=values[of])
        maps[name] = np.where(count >= FEWEST, total / np.maximum(count, 1.0), np.nan)
    direction = max(maps, key=lambda name: float(np.nansum(maps[name] ** 2)))
    figure = new_figure(4.2, 3.1)
    plot = figure.add_subplot()
    most = float(np.nanmax(np.abs(maps[direction]), initial=1e-9))
    plot.set_facecolor(NOTHING)
    mesh = plot.pcolormesh(edges[0], edges[1], maps[direction].T, cmap="PuOr", vmin=-most, vmax=most)
    figure.colorbar(mesh, label=f"mean residual {direction} [µm]")
    plot.set(xlabel=x.label, ylabel=y.label)
    if title:
        heading(figure, title, 11)
    return figure


def plot_panel(panel: Panel) -> Figure:
    """Plot one panel as a figure without a title."""
    figure = new_figure(4.2, 3.1)
    draw(figure.add_subplot(), panel, titled=False)
    return figure


def draw(plot: Axes, panel: Panel, *, titled: bool = True) -> None:
    """Draw a panel on existing axes.

    Args:
        plot: the axes.
        panel: what to draw.
        titled: whether its title is drawn too.
    """
    style_axes(plot)
    plot.axhline(0.0, color=RUN, linewidth=0.8)
    entries = [entry for k in range(len(panel.series)) for entry in _draw_series(plot, panel, k)]
    if panel.ticks:
        plot.set_xticks([at for at, _ in panel.ticks], [name for _, name in panel.ticks])
        plot.margins(x=0.25)
    else:
        plot.xaxis.set_major_locator(MaxNLocator(TICKS))
    if panel.limit is not None:
        low, high = plot.get_ylim()
        plot.set_ylim(min(low, -panel.limit), max(high, panel.limit))
    if len(entries) > 1:
        plot.legend(*zip(*entries, strict=True), **ABOVE)
    if titled:
        plot.set_title(panel.title, loc="left", fontsize=9, pad=20.0 if len(entries) > 1 else 6.0)
    plot.set(xlabel=panel.x, ylabel=panel.y)


def _draw_series(plot: Axes, panel: Panel, k: int) -> list[tuple[Any, str]]:
    """Draw the k-th series of a panel and return its entries in the legend; the cause has an entry only if the series is single."""
    one, count = panel.series[k], len(panel.series)
    lone = count == 1 and one.predicted is not None
    colour, marker, style = STYLES[DIRECTIONS.index(one.name) if one.name in DIRECTIONS else k % len(STYLES)]
    groups = group_numbers(one.x)
    centre, mean, half = group_means(one.x, one.y, one.weight, groups)
    # Shifted, so that the series do not hide each other.
    offset = 0.0 if lone else 0.008 * (float(np.ptp(one.x)) or 1.0) * (k - 0.5 * (count - 1))
    looks: dict[str, Any] = {"marker": marker, "markersize": 4.0, "linewidth": 0.0, "elinewidth": 1.0}
    dots = plot.errorbar(centre + offset, mean, half, color=BOTH if lone else colour, **looks)
    if one.predicted is None:
        if not panel.ticks:
            plot.plot(centre + offset, mean, color=colour, linestyle=style, linewidth=0.8, alpha=0.6)
        return [(dots, one.name)]
    order = np.argsort(one.x)
    x, predicted = (
        (one.x[order], one.predicted[order])
        if one.smooth
        else group_means(one.x, one.predicted, one.weight, groups)[:2]
    )
    colour, style = (BACKWARD, "-") if lone else (colour, style)
    (line,) = plot.plot(x, predicted, color=colour, linestyle=style, linewidth=2.0, alpha=0.75)
    return [(dots, "measured"), (line, "fitted cause")] if lone else [(dots, one.name)]


def _drawn(panels: Sequence[Panel], title: str) -> Figure:
    across = min(max(len(panels), 1), WIDE)
    down = -(-max(len(panels), 1) // across)
    figure = new_figure(max(4.4 * across, 6.4), 3.5 * down + 0.4)
    titled = any(panel.title not in title for panel in panels)
    for k, panel in enumerate(panels):
        draw(figure.add_subplot(down, across, k + 1), panel, titled=titled)
    heading(figure, title, 11)
    return figure
