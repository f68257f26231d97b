"""Pictures of a diagnosis: the misfit as it was seen, a cause as it was found, the causes as they ranked. Needs the extra ``plots``.

Dots are means over readings that belong together, with the 95 % interval of the mean from their own scatter; a line is what a cause
says. Every function returns a `Figure` of its own, with the colours of `twin.display.figures`; shapes tell apart what colours
do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from twin._common.errors import InputError
from twin.diagnosis.result import Answer
from twin.diagnosis.wording.panels import (
    FEWEST,
    Panel,
    cause_panels,
    directed,
    groups_of,
    means,
    residual_panels,
    scales_of,
)
from twin.diagnosis.wording.words import plain
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, blank, dress, heading

WIDE: Final = 3
"""Panels side by side."""
TICKS: Final = 6
CELLS: Final = 6
"""Along either side of a map."""
DIRECTIONS: Final = ("in x", "in y", "in z")
"""Each has its own style, whichever are drawn."""
NOTHING: Final = "#dddddd"
"""Where nothing was read; the middle of the scale is white."""
ABOVE: Final[dict[str, Any]] = {
    "fontsize": 8, "frameon": False, "ncols": 3, "loc": "lower left", "bbox_to_anchor": (-0.02, 0.99), "borderaxespad": 0.0,
    "columnspacing": 1.2, "handletextpad": 0.4,
}  # fmt: skip
"""A legend above its panel."""
STYLES: Final = ((FORWARD, "o", "-"), (BACKWARD, "s", "--"), (THIRD, "^", "-."))


def plot_residuals(found: Answer, *, after: bool = False, title: str = "") -> Figure:
    """What is left of the readings where it shows most, in the directions of the machine's base.

    Args:
        found: the diagnosis.
        after: with the causes taken out, on the scale of before.
        title: a heading.
    """
    about = "What is left with the causes in the model" if after else "What the model does not foresee"
    return _drawn(residual_panels(found, after=after), title or about)


def plot_cause(found: Answer, cause: int = 0, *, title: str = "") -> Figure:
    """What a cause says, and what was read once everything else is taken out.

    Args:
        found: the diagnosis.
        cause: which of `Answer.causes`.
        title: a heading.

    Raises:
        InputError: no such cause.
    """
    if not 0 <= cause < len(found.causes):
        raise InputError("no such cause", expected=f"less than {len(found.causes)}", value=cause)
    one = found.causes[cause]
    return _drawn(cause_panels(found, one), title or f"{plain(one.effect, one.where)}: as found (line), as read (dots)")


def plot_ranking(found: Answer, *, title: str = "") -> Figure:
    """The causes tried, each alone, by how much of the misfit it explains.

    Args:
        found: the diagnosis.
        title: a heading.
    """
    rows = found.ranking[::-1]
    figure = blank(9.0, 0.9 + 0.34 * max(len(rows), 1))
    plot = figure.add_subplot()
    named = {(cause.effect, cause.where) for cause in found.causes}
    doubted = {key for cause in found.causes for key in cause.equivalent}
    for colour, of, label in (
        (BACKWARD, named, "found"),
        (FORWARD, doubted - named, "cannot be told from what was found"),
        (RUN, {(effect, where) for effect, where, *_ in rows} - named - doubted, "less likely"),
    ):
        at = [i for i, (effect, where, *_) in enumerate(rows) if (effect, where) in of]
        if at:
            plot.barh(at, [rows[i][2] for i in at], color=colour, label=label)
    plot.set_yticks(range(len(rows)), [plain(effect, where) for effect, where, *_ in rows], fontsize=9)
    plot.set_xlabel("part of the misfit it explains alone, chi² [1]")
    plot.spines[["top", "right"]].set_visible(False)
    if rows:
        plot.legend(loc="lower right", frameon=False, fontsize=9)
    heading(figure, title or f"Of {found.tried} causes tried", 11)
    return figure


def plot_left(found: Answer, *, title: str = "") -> Figure | None:
    """What is left over the two columns it goes with, in the direction that shows it most; None where it goes with fewer.

    Args:
        found: the diagnosis.
        title: a heading.
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
    figure = blank(4.2, 3.1)
    plot = figure.add_subplot()
    most = float(np.nanmax(np.abs(maps[direction]), initial=1e-9))
    plot.set_facecolor(NOTHING)
    mesh = plot.pcolormesh(edges[0], edges[1], maps[direction].T, cmap="PuOr", vmin=-most, vmax=most)
    figure.colorbar(mesh, label=f"mean of read − foreseen {direction} [µm]")
    plot.set(xlabel=x.label, ylabel=y.label)
    if title:
        heading(figure, title, 11)
    return figure


def alone(panel: Panel) -> Figure:
    """One panel as a figure of its own, its title left to the words around it."""
    figure = blank(4.2, 3.1)
    draw(figure.add_subplot(), panel, titled=False)
    return figure


def draw(plot: Axes, panel: Panel, *, titled: bool = True) -> None:
    """A panel on axes that are there.

    Args:
        plot: the axes.
        panel: what to draw.
        titled: whether its title is drawn too.
    """
    dress(plot)
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
    """One of a panel's sets of readings; returns its entries in the legend. A cause's own line stands beside a single set only."""
    one, count = panel.series[k], len(panel.series)
    lone = count == 1 and one.says is not None
    colour, marker, style = STYLES[DIRECTIONS.index(one.name) if one.name in DIRECTIONS else k % len(STYLES)]
    groups = groups_of(one.x)
    centre, mean, half = means(one.x, one.y, one.weight, groups)
    # Side by side instead of on top of one another.
    aside = 0.0 if lone else 0.008 * (float(np.ptp(one.x)) or 1.0) * (k - 0.5 * (count - 1))
    looks: dict[str, Any] = {"marker": marker, "markersize": 4.0, "linewidth": 0.0, "elinewidth": 1.0}
    dots = plot.errorbar(centre + aside, mean, half, color=BOTH if lone else colour, **looks)
    if one.says is None:
        if not panel.ticks:
            plot.plot(centre + aside, mean, color=colour, linestyle=style, linewidth=0.8, alpha=0.6)
        return [(dots, one.name)]
    order = np.argsort(one.x)
    x, says = (one.x[order], one.says[order]) if one.smooth else means(one.x, one.says, one.weight, groups)[:2]
    colour, style = (BACKWARD, "-") if lone else (colour, style)
    (line,) = plot.plot(x, says, color=colour, linestyle=style, linewidth=2.0, alpha=0.75)
    return [(dots, "read"), (line, "what the cause says")] if lone else [(dots, one.name)]


def _drawn(panels: Sequence[Panel], title: str) -> Figure:
    across = min(max(len(panels), 1), WIDE)
    down = -(-max(len(panels), 1) // across)
    figure = blank(max(4.4 * across, 6.4), 3.5 * down + 0.4)
    titled = any(panel.title not in title for panel in panels)
    for k, panel in enumerate(panels):
        draw(figure.add_subplot(down, across, k + 1), panel, titled=titled)
    heading(figure, title, 11)
    return figure
