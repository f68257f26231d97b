"""Pictures of a machine report. Needs the extra ``plots`` (matplotlib).

Every function returns a new `Figure`, narrow enough for a phone. Colours are those of `twin.display.figures`, which colour-blind
readers can distinguish; markers and line styles also distinguish the curves without colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator

from twin._common.messages import Message, Number, say
from twin._common.units import DEG, TURN
from twin.display import figure, readable, with_half
from twin.display.figures import (
    BACKWARD,
    BOTH,
    FORWARD,
    RUN,
    SHADE,
    THIRD,
    add_plain_axes,
    add_plain_polar,
    draw_plain_axes,
    draw_plain_polar,
    new_figure,
    plot_markers,
    polar_ticks,
    style_axes,
    text_box_style,
)
from twin.reporting.compensation import CompensationForecast
from twin.reporting.contributions import Contribution, Field, Motion, Slice
from twin.reporting.identified import PointComparison, PositionEstimates
from twin.reporting.result import Constant
from twin.reporting.scene.draw import chosen_factor
from twin.reporting.scene.path import scale_top_um, viridis

WIDTH: Final = 4.4
"""Width of a figure in inches, so that text keeps its size on a phone."""
LEAN: Final = 0.34
"""Drawn angle of the largest squareness, rad."""
LETTERS: Final = 9.5
NUMBERS: Final = 9.0
BARS: Final = 18
"""Largest number of errors drawn as bars; the table lists all."""
LETTER: Final = 0.072
"""Width of a letter of a label, inches."""
BELOW_ROWS: Final = 0.48
"""Height of the numbers and the label below a plot of named rows, inches."""
LINE: Final = 0.19
"""Height of a line of a legend, inches."""
ABOVE_TURN: Final = 1.077
"""Height of the title above a wide polar plot, so that it is clear of the label at 90°, in heights of the plot."""
LEGEND_LINE: Final = 0.17
"""Height of a line of its legend, inches."""
SIDE: Final = 2.75
MOST_HIGH: Final = 3.4
"""Largest width and height of a plane, inches; both axes have the same scale."""
SIDES: Final = {
    0: ("s", BACKWARD, Message("readings")),
    1: ("^", BACKWARD, Message("readings, from below")),
    -1: ("v", THIRD, Message("from above")),
}
VIRIDIS: Final = ListedColormap(viridis(np.linspace(0.0, 1.0, 256)).tolist(), "viridis of the field")


def plot_budget(rows: Sequence[Contribution], *, total: Contribution) -> Figure:
    """Draw the error budget as horizontal bars, the total last: RMS at the tool, largest value as a marker, U as a whisker."""
    shown = [*rows[:BARS], total]
    names = [
        f"{say('all') if one is total else one.name}{' *' if one.illustrative else ''}{'' if np.isfinite(one.u_rms_um) else ' ?'}"
        for one in shown
    ]
    # Names of effects can have more than twenty letters.
    plot = _plot(WIDTH, 0.75 + 0.27 * len(shown), left=max(0.85, 0.2 + LETTER * max(map(len, names))), plain=True)
    at = np.arange(len(shown))[::-1]
    colours = [FORWARD] * (len(shown) - 1) + [BOTH]
    plot.barh(at, [one.rms_um for one in shown], height=0.62, color=colours, label=say("RMS over the volume"))
    plot_markers(plot, [one.max_um for one in shown], at, BACKWARD, "D", label=say("largest"))
    whisker: dict[str, Any] = {"color": "#777777", "linewidth": 1.6}
    for y, one in zip(at, shown, strict=True):
        if np.isfinite(one.u_rms_um) and (one is not total or one.u_rms_um <= total.max_um):
            ends = [max(one.rms_um - one.u_rms_um, 0.0), one.rms_um + one.u_rms_um]
            plot.plot(ends, [y, y], **whisker, solid_capstyle="butt")
    if any(np.isfinite(one.u_rms_um) for one in shown):
        plot.plot([], [], **whisker, label="U (95 %)")
    plot.set_xlim(left=0.0)
    plot.set(xlabel=say("error of the tool point [µm]"), ylim=(-0.6, len(shown) - 0.4))
    _name_rows(plot, at, names)
    draw_plain_axes(plot, NUMBERS, grid="x")
    _legend(plot, columns=3)
    return cast(Figure, plot.figure)


def plot_motion(motion: Motion, stops: Sequence[PositionEstimates] = ()) -> Figure:
    """Draw an error motion with its 95 % interval and estimates from readings; polar for a rotary axis of up to one turn."""
    within_turn = float(motion.position[-1] - motion.position[0]) <= TURN + 1e-9
    return _polar(motion, stops) if not motion.linear and within_turn else _along(motion, stops)


def plot_constants(found: Sequence[Constant]) -> Figure:
    """Draw squareness and locations (at least one) with their 95 % intervals, lengths and angles in separate plots."""
    groups = [[one for one in found if one.unit == unit] for unit in ("urad", "um")]
    groups = [group for group in groups if group]
    heights = np.array([len(group) + 1.2 for group in groups])
    height = 0.35 + 0.3 * float(heights.sum())
    heights *= (height - 0.04 - BELOW_ROWS * len(groups)) / heights.sum()
    drawing, bottom = new_figure(WIDTH, height, layout=None), height - 0.04
    for high, group in zip(heights, groups, strict=True):
        bottom -= high
        plot = add_plain_axes(drawing, (0.66 / WIDTH, bottom / height, 3.7 / WIDTH, high / height))
        bottom -= BELOW_ROWS
        _dress(plot, plain=True)
        at = np.arange(len(group))[::-1]
        for y, one in zip(at, group, strict=True):
            if one.known:
                plot.plot([one.value - one.half, one.value + one.half], [y, y], color=FORWARD, linewidth=2.0)
            plot_markers(plot, one.value, y, FORWARD, "o", 6, markerfacecolor=FORWARD if one.known else "white")
        plot.axvline(0.0, color=BOTH, linewidth=0.8)
        plot.set(
            ylim=(-0.6, len(group) - 0.4), xlabel=say("value and 95 % interval [{unit}]", unit=readable(group[0].unit))
        )
        _name_rows(plot, at, [one.name + ("" if one.known else " ?") for one in group])
        draw_plain_axes(plot, NUMBERS)
    return drawing


def plot_squareness(one: Constant, largest_urad: float) -> Figure:
    """Draw two axes with their nominal and their actual angle, exaggerated, and its 95 % interval as a wedge; faint if not significant.

    ``largest_urad``: largest absolute value or end of an interval of all sketches, which have one scale.
    """
    drawing = new_figure(2.3, 2.3)
    plot = drawing.subplots()
    plot.set_axis_off()
    plot.set_aspect("equal")
    scale = LEAN * one.leans / max(largest_urad, 1e-9)
    lean = scale * one.value
    faint = one.known and abs(one.value) <= one.half
    if one.known:
        edge = scale * np.linspace(one.value - one.half, one.value + one.half, 20)
        plot.fill([0.0, *np.sin(edge)], [0.0, *np.cos(edge)], color=BACKWARD, alpha=SHADE, linewidth=0.0)
    tip = float(np.sin(lean)), float(np.cos(lean))
    plot.annotate("", (1.06, 0.0), (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": BOTH, "linewidth": 1.8})
    plot.plot([0.0, 0.0], [0.0, 1.0], color=RUN, linestyle="--", linewidth=1.3)
    plot.annotate(
        "",
        tip,
        (0.0, 0.0),
        arrowprops={
            "arrowstyle": "->",
            "color": BACKWARD,
            "linewidth": 1.2 if faint else 2.2,
            "alpha": 0.5 if faint else 1.0,
        },
    )
    middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": LETTERS}
    plot.text(1.0, -0.13, f"{one.to}+", **middle)
    plot.text(tip[0], 1.08, f"{one.axis}+", **middle, color=BACKWARD)
    size = say(with_half(one.value, one.half, "urad")).replace(" ±", "\n±").replace(" (±", "\n(±")
    plot.text(0.5, 0.4, size + (f"\n{say('not significant')}" if faint else ""), fontsize=LETTERS)
    plot.set(xlim=(-0.35, 1.3), ylim=(-0.25, 1.2))
    return drawing


def plot_field(field: Field) -> Figure:
    """Draw the error field as arrows, coloured by magnitude, with the exaggeration factor."""
    rows = field.drawn
    points, errors, size = field.point_mm[rows], field.error_um[rows], field.size_um[rows]
    factor, top = chosen_factor(points, errors), scale_top_um(float(size.max(initial=0.0)))
    drawing = new_figure(6.4, 4.9, layout=None)
    plot: Any = drawing.add_axes((0.056, 0.009, 0.753, 0.983), projection="3d")
    colours = viridis(np.clip(size / top, 0.0, 1.0))
    arrows = factor * errors * 1e-3
    if len(points):
        # Head lines follow the shafts in matplotlib's list, two each.
        tints = np.concatenate([colours, np.repeat(colours, 2, axis=0)])
        plot.quiver(*points.T, *arrows.T, colors=tints, linewidth=1.1, arrow_length_ratio=0.3)
    for text, a, b in field.edges():
        plot.plot(*np.stack([a, b]).T, color="#9aa3ad", linewidth=0.7)
        if text:
            plot.text(*((a + b) / 2.0), text, fontsize=8, ha="center", zorder=50, bbox=text_box_style(0.8, 0.5))
    plot.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    plot.tick_params(labelsize=7)
    if len(points) > 1:
        plot.set_box_aspect(np.maximum(np.ptp(np.concatenate([points, points + arrows]), axis=0), 1.0), zoom=0.92)
    plot.view_init(elev=24, azim=-62)
    bar = drawing.colorbar(
        ScalarMappable(Normalize(0.0, top), VIRIDIS), cax=drawing.add_axes((0.873, 0.156, 0.026, 0.688))
    )
    bar.set_label(say("error [µm]; arrows × {factor}", factor=f"{factor:,.0f}".replace(",", " ")))
    return drawing


def plot_slice(one: Slice, values: np.ndarray, top: float, label: str) -> Figure:
    """Draw (b, a) values in µm over a plane of the field as a contour map; ``top``: end of the colour scale of all planes."""
    high = float(np.ptp(one.up)) / float(np.ptp(one.across))
    wide = min(SIDE, MOST_HIGH / high)
    height = wide * high + 0.72
    drawing = new_figure(WIDTH, height, layout=None)
    plot = add_plain_axes(drawing, (0.72 / WIDTH, 0.55 / height, wide / WIDTH, wide * high / height))
    _dress(plot, plain=True)
    levels = np.linspace(0.0, top, 9)
    plot.contourf(one.across, one.up, np.minimum(values, top), levels=levels, cmap=VIRIDIS)
    lines = plot.contour(one.across, one.up, values, levels=levels[1:-1], colors="white", linewidths=0.6)
    plot.clabel(lines, fmt=lambda value: say(Number(f"{value:g}")), fontsize=8)
    plot.set(xlabel=f"{one.horizontal} [mm]", ylabel=f"{one.vertical} [mm]")
    draw_plain_axes(plot, NUMBERS, grid="")
    beside = add_plain_axes(drawing, ((0.72 + wide + 0.12) / WIDTH, 0.55 / height, 0.13 / WIDTH, wide * high / height))
    middles = 0.5 * (levels[1:] + levels[:-1])
    beside.pcolormesh([0.0, 1.0], levels, middles[:, None], cmap=VIRIDIS, vmin=0.0, vmax=top)
    beside.yaxis.set_major_locator(FixedLocator(levels.tolist()))
    beside.set_ylabel(label)
    draw_plain_axes(beside, 10.0, grid="", right=True, scale=False)
    return drawing


def plot_compensation(outcome: CompensationForecast) -> Figure:
    """Draw the cumulative distribution of the error over the positions, before and after compensation."""
    levels = [level for level in outcome.levels if level is not outcome.expected_before]
    plot = _plot(6.2, 3.3 + LINE * len(levels), legend=len(levels))
    colours = [*([RUN] if outcome.without_tables is not None else []), BACKWARD, THIRD, FORWARD]
    smallest = [level.size_um[level.size_um > 0.0].min(initial=np.inf) for level in levels]
    for level, colour, style in zip(levels, colours, ("-", "--", "-.", ":"), strict=False):
        share = 100.0 * (np.arange(len(level.size_um)) + 1) / len(level.size_um)
        thin = np.unique(np.linspace(0, len(share) - 1, 600).astype(int))
        text = say("{name}: {rms}", name=level.name, rms=figure(level.rms_um, "µm RMS"))
        plot.plot(level.size_um[thin], share[thin], color=colour, linestyle=style, linewidth=2.0, label=text)
    if any(level.size_um[-1] > 0.0 for level in levels):
        plot.set_xscale("log")
        plot.set_xlim(left=max(min(smallest), 0.01))
        plot.xaxis.set_major_formatter(lambda value, position: f"{value:g}")
    plot.set(ylim=(0.0, 101.0), xlabel=say("error of the tool point [µm]"), ylabel=say("share of positions below [%]"))
    _legend(plot, columns=1)
    return cast(Figure, plot.figure)


def plot_residuals(one: PointComparison) -> Figure:
    """Draw the cumulative distribution of residuals of measured points, for the nominal machine and for the calibration."""
    plot = _plot(WIDTH, 3.0)
    for values, colour, style, text in (
        (one.before_um, BACKWARD, "--", say("nominal machine")),
        (one.after_um, FORWARD, "-", say("with this calibration")),
    ):
        ordered = np.maximum(np.sort(values), 1e-3)
        share = 100.0 * (np.arange(len(ordered)) + 1) / max(len(ordered), 1)
        plot.plot(ordered, share, color=colour, linestyle=style, linewidth=1.8, label=text)
    plot.set_xscale("log")
    plot.xaxis.set_major_formatter(lambda value, position: f"{value:g}")
    plot.set(ylim=(0.0, 101.0), xlabel=say("residual of a point [µm]"), ylabel=say("share of points below [%]"))
    _legend(plot, columns=2)
    return cast(Figure, plot.figure)


def _along(motion: Motion, stops: Sequence[PositionEstimates]) -> Figure:
    plot = _plot(WIDTH, 3.0, legend=2, plain=True)
    _curves(plot, motion, 1.0, say("approach from below (+)"), (1.8, 1.4))
    _stops(plot, stops, 1.0)
    plot.axhline(0.0, color=BOTH, linewidth=0.7)
    plot.set(xlabel=f"{motion.axis} [{motion.axis_unit}]", ylabel=f"{motion.name} [{readable(motion.unit)}]")
    draw_plain_axes(plot, NUMBERS)
    _legend(plot, columns=2)
    return cast(Figure, plot.figure)


def _polar(motion: Motion, stops: Sequence[PositionEstimates]) -> Figure:
    low, high = float(motion.position[0]), float(motion.position[-1])
    wide = high - low > 200.0
    height = 4.3 if wide else 3.2
    drawing = new_figure(WIDTH, height, layout=None)
    plot = add_plain_polar(drawing, (0.0, 0.0, 1.0, 1.0))
    q = motion.position * DEG
    lines = _curves(plot, motion, DEG, say("from below (+)"), (1.6, 1.3))
    _stops(plot, stops, DEG)
    reach = np.nan_to_num(motion.half, nan=0.0)
    extent = max(
        float((np.abs(np.array(lines)) + reach).max()), *(float(np.abs(s.value).max(initial=0.0)) for s in stops), 1e-9
    )
    plot.plot(q, np.zeros(len(q)), color=BOTH, linewidth=1.1)
    ticks, full = polar_ticks(plot, extent, (low, high))
    plot.set_rlabel_position(100.0 if full else (low + high) / 2.0)
    angles = np.arange(np.ceil(low / 30.0) * 30.0, high + (0.0 if full else 1.0), 30.0) * DEG
    draw_plain_polar(plot, angles, ticks, sizes=(8.0, 7.5))
    title = f"{motion.name} [{readable(motion.unit)}]"
    plot.set_title(title, loc="left", fontsize=LETTERS, y=ABOVE_TURN if wide else 1.0)
    _legend(plot, columns=2, size=8.0)
    rows = -(-len(plot.get_legend_handles_labels()[0]) // 2)
    downward = float(np.sin(angles).min(initial=0.0)) < -0.4
    below, above = LEGEND_LINE * rows + (0.41 if downward else 0.16), 0.475 if wide else 0.26
    plot.set_position((0.02, below / height, 0.96, (height - below - above) / height))
    return drawing


def _curves(plot: Axes, motion: Motion, scale: float, below: str, widths: tuple[float, float]) -> list[np.ndarray]:
    """Draw interval, curve (or both directions) and the remainder after the control's tables; return the curves."""
    q = motion.position * scale
    if np.all(np.isfinite(motion.half)):
        low, high = motion.value - motion.half, motion.value + motion.half
        plot.fill_between(q, low, high, color=FORWARD, alpha=SHADE, linewidth=0, label=say("95 % interval"))
    lines = [motion.value] if motion.ways is None else list(motion.ways)
    labels = [say("calibration")] if motion.ways is None else [below, say("from above (−)")]
    for values, text, colour, style in zip(lines, labels, (FORWARD, THIRD), ("-", "--"), strict=False):
        plot.plot(q, values, color=colour, linestyle=style, linewidth=widths[0], label=text)
    if motion.corrected is not None:
        label = say("after the control's tables")
        plot.plot(q, motion.corrected, color=BOTH, linewidth=widths[1], linestyle=":", label=label)
    return lines


def _stops(plot: Axes, stops: Sequence[PositionEstimates], scale: float) -> None:
    for stop in stops:
        marker, colour, text = SIDES[stop.side]
        looks: dict[str, Any] = {"marker": marker, "markersize": 3.5, "color": colour, "linewidth": 0.9, "capsize": 2}
        plot.errorbar(stop.position * scale, stop.value, stop.half, linestyle="", **looks, label=say(text))


def _name_rows(plot: Axes, at: np.ndarray, names: Sequence[str]) -> None:
    """Give the rows of a plot their names; `Axes.set_yticks` would make matplotlib's ticks."""
    plot.yaxis.set_major_locator(FixedLocator(at.tolist()))
    plot.yaxis.set_major_formatter(FixedFormatter(list(names)))


def _plot(width: float, height: float, *, left: float = 0.72, legend: int = 1, plain: bool = False) -> Axes:
    """Return one plot with fixed margins for labels and legend (automatic layout is as slow as drawing); ``plain``: without axes."""
    drawing = new_figure(width, height, layout=None)
    below = 0.52 + LINE * legend
    place = left / width, below / height, (width - left - 0.12) / width, (height - below - 0.14) / height
    plot = add_plain_axes(drawing, place) if plain else drawing.add_axes(place)
    _dress(plot, plain=plain)
    return plot


def _legend(plot: Axes, *, columns: int, size: float = 8.5) -> None:
    handles, names = plot.get_legend_handles_labels()
    cast(Figure, plot.figure).legend(
        handles,
        names,
        loc="lower center",
        ncols=columns,
        frameon=False,
        fontsize=size,
        columnspacing=1.2,
        borderpad=0.0,
    )


def _dress(plot: Axes, *, plain: bool = False) -> None:
    if plain:
        plot.spines[["top", "right"]].set_visible(False)
    else:
        style_axes(plot)
        plot.tick_params(labelsize=NUMBERS)
    plot.xaxis.label.set_fontsize(LETTERS)
    plot.yaxis.label.set_fontsize(LETTERS)
