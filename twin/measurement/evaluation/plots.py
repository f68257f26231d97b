"""The plots that belong to the evaluations. Needs the extra ``plots`` (matplotlib).

Every function returns a `Figure` of its own, which draws on no screen and shares no state; `save` writes it. Colours tell apart
for colour-blind readers, and line styles and markers do so without colour.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin._common.units import DEG
from twin.measurement.evaluation.circular import RotaryMotion as ErrorMotion
from twin.measurement.evaluation.iso230_2 import Positioning
from twin.measurement.evaluation.straightness import Straightness

FORWARD: Final = "#0072b2"
BACKWARD: Final = "#d55e00"
BOTH: Final = "#222222"
THIRD: Final = "#009e73"
RUN: Final = "#8a8a8a"
SIGNS: Final = {"um": "µm", "urad": "µrad", "arcsec": "arcsec", "mm": "mm", "deg": "°"}


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> None:
    """Writes a figure; the ending says how (png, pdf, svg).

    Args:
        figure: what to write.
        path: where to.
        dpi: dots an inch, for a png.
    """
    figure.savefig(path, dpi=dpi)


def plot_positioning(result: Positioning, *, title: str = "") -> Figure:
    """ISO 230-2: the deviations of every run, the means, the bands of ±2s, and what the standard makes of them.

    Args:
        result: the evaluation.
        title: a heading; the axis and the standard if empty.
    """
    figure, plot = _figure(11.0, 6.2)
    order = np.argsort(result.target)
    target, unit = result.target[order], SIGNS[result.unit]
    for runs, mean, s, colour, marker, arrow, style in (
        (result.forward, result.mean_forward, result.s_i_forward, FORWARD, "^", "↑", "-"),
        (result.backward, result.mean_backward, result.s_i_backward, BACKWARD, "v", "↓", "--"),
    ):
        middle, two_s = mean[order], 2.0 * s[order]
        plot.fill_between(target, middle - two_s, middle + two_s, color=colour, alpha=0.15, linewidth=0)
        plot.plot(target, middle + two_s, color=colour, linewidth=0.8, linestyle=style, label=f"x̄{arrow} ± 2s{arrow}")
        plot.plot(target, middle - two_s, color=colour, linewidth=0.8, linestyle=style)
        lines = plot.plot(target, runs[order], color=colour, linewidth=0, marker=marker, markersize=3.5, alpha=0.55)
        lines[0].set_label(f"runs {arrow} ({result.cycles})")
        plot.plot(target, middle, color=colour, linewidth=1.8, linestyle=style, label=f"mean x̄{arrow}")
    plot.plot(target, result.mean[order], color=BOTH, linewidth=1.2, linestyle=":", label="mean of both x̄")
    _mark_values(plot, result)
    heading = f"Axis {result.axis}: positioning" if result.axis else "Positioning"
    plot.set_title(title or f"{heading} by ISO 230-2:2014", loc="left", fontweight="bold")
    plot.set_xlabel(f"target position [{SIGNS[result.target_unit]}]")
    plot.set_ylabel(f"deviation, actual − target [{unit}]")
    plot.legend(loc="upper left", bbox_to_anchor=(1.14, 1.0), frameon=False, borderaxespad=0.0, fontsize=9)
    decimals = 1 if result.A >= 10.0 else 2
    rows = (
        ("", "↑", "↓", "both"),
        ("B", "", "", f"{result.B:.{decimals}f}"),
        ("B̄", "", "", f"{result.B_mean:.{decimals}f}"),
        ("R", f"{result.R_forward:.{decimals}f}", f"{result.R_backward:.{decimals}f}", f"{result.R:.{decimals}f}"),
        ("E", f"{result.E_forward:.{decimals}f}", f"{result.E_backward:.{decimals}f}", f"{result.E:.{decimals}f}"),
        ("M", "", "", f"{result.M:.{decimals}f}"),
        ("A", f"{result.A_forward:.{decimals}f}", f"{result.A_backward:.{decimals}f}", f"{result.A:.{decimals}f}"),
    )
    for i, row in enumerate(rows):
        for column, text in enumerate(row):
            plot.text(
                1.15 + 0.095 * column + 0.02 * (column > 0),
                0.46 - 0.058 * i,
                text,
                transform=plot.transAxes,
                horizontalalignment="left" if column == 0 else "right",
                fontweight="bold" if column in (0, 3) and i else "normal",
                color=BOTH if i else RUN,
            )
    plot.text(1.15, 0.52, f"values in {unit}", transform=plot.transAxes, color=RUN, fontsize=9)
    if result.shortfalls:
        figure.text(
            0.01, 0.01, "Not by the standard (4.3): " + "; ".join(result.shortfalls), color=BACKWARD, fontsize=8
        )
    return figure


def _mark_values(plot: Axes, result: Positioning) -> None:
    """Brackets beside the curves: A, E and M where they are taken, and B at its target."""
    low = min(
        (result.mean_forward - 2 * result.s_i_forward).min(), (result.mean_backward - 2 * result.s_i_backward).min()
    )
    means = np.concatenate([result.mean_forward, result.mean_backward])
    at = plot.get_yaxis_transform()
    for x, name, start, value in (
        (1.020, "M", float(result.mean.min()), result.M),
        (1.055, "E", float(means.min()), result.E),
        (1.090, "A", float(low), result.A),
    ):
        plot.annotate(
            "",
            (x, start + value),
            (x, start),
            xycoords=at,
            textcoords=at,
            arrowprops={"arrowstyle": "|-|,widthA=0.25,widthB=0.25", "color": BOTH, "shrinkA": 0, "shrinkB": 0},
            annotation_clip=False,
        )
        plot.text(x, start + value, f"{name}\n", transform=at, horizontalalignment="center", verticalalignment="center")
    i = int(np.argmax(np.abs(result.B_i)))
    where, ends = float(result.target[i]), (float(result.mean_backward[i]), float(result.mean_forward[i]))
    arrow = {"arrowstyle": "<->", "color": BOTH, "shrinkA": 0, "shrinkB": 0, "linewidth": 1.2}
    plot.annotate("", (where, ends[1]), (where, ends[0]), arrowprops=arrow)
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.6}
    plot.annotate(
        "B",
        (where, (ends[0] + ends[1]) / 2.0),
        (6, 0),
        textcoords="offset points",
        verticalalignment="center",
        bbox=paper,
    )


def plot_straightness(result: Straightness, *, title: str = "") -> Figure:
    """Straightness: what was measured with its three reference lines, and below it the deviations from each.

    Args:
        result: the evaluation.
        title: a heading; the error motion's name if empty.
    """
    figure = Figure(figsize=(10.0, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True)
    _dress(above)
    _dress(below)
    position, axis = result.position_mm, result.name[-1:]
    above.plot(position, result.deviation_um, color=RUN, linewidth=0.8, marker="o", markersize=4, label="measured")
    zone = result.minimum_zone
    for line, colour, style, marker in zip(
        result.lines, (FORWARD, BACKWARD, THIRD), ("-", "--", "-."), ("o", "s", "D"), strict=True
    ):
        label = f"{line.kind}: {line.value_um:.2f} µm"
        slope = f"{line.kind}: slope {line.slope_urad:.2f} µrad"
        if line.u_slope_urad is not None:
            slope = f"{line.kind}: slope ({line.slope_urad:.2f} ± {2.0 * line.u_slope_urad:.2f}) µrad, k = 2"
        above.plot(
            position, line.at_um(position), color=colour, linestyle=style, linewidth=1.6, label=slope.replace("-", "−")
        )
        below.plot(
            position,
            line.residual_um,
            color=colour,
            linestyle=style,
            linewidth=1.2,
            marker=marker,
            markersize=3.5,
            label=label,
        )
    half, middle = zone.value_um / 2.0, zone.at_um(position)
    above.fill_between(position, middle - half, middle + half, color=THIRD, alpha=0.12, linewidth=0)
    contacts = list(zone.contacts)
    above.plot(
        position[contacts],
        result.deviation_um[contacts],
        color=THIRD,
        linestyle="",
        marker="o",
        markersize=11,
        markerfacecolor="none",
        label="points that carry the minimum zone",
    )
    below.axhspan(-half, half, color=THIRD, alpha=0.12, linewidth=0)
    below.axhline(0.0, color=BOTH, linewidth=0.8)
    above.set_title(
        title or f"Straightness {result.name} by ISO 230-1:2012".replace("  ", " "), loc="left", fontweight="bold"
    )
    above.set_ylabel("measured deviation [µm]")
    below.set_ylabel("deviation from the line [µm]")
    below.set_xlabel(f"{axis} position [mm]".strip())
    above.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    below.legend(
        frameon=False,
        fontsize=9,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        title="straightness error about",
        alignment="left",
    )
    return figure


def plot_error_motion(result: ErrorMotion, *, title: str = "") -> Figure:
    """Polar plot of a rotary axis's error motion: every turn, their mean, and the two circles that contain the mean.

    Args:
        result: the evaluation.
        title: a heading; the error motion's name if empty.
    """
    figure = Figure(figsize=(9.5, 6.8))
    FigureCanvasAgg(figure)
    polar = figure.add_subplot(projection="polar", position=(0.05, 0.07, 0.6, 0.8))
    unit = SIGNS[result.unit]
    angle = np.append(result.angle_deg, result.angle_deg[0] + 360.0) * DEG
    extent = max(float(np.abs(result.total).max()), 1e-12)
    turns = len(result.total)
    if turns > 1:
        for i, turn in enumerate(result.total):
            label = f"{turns} turns" if i == 0 else "_"
            polar.plot(angle, np.append(turn, turn[0]), color=RUN, linewidth=0.6, alpha=0.8, label=label)
    closed = np.append(result.synchronous, result.synchronous[0])
    polar.plot(angle, closed, color=FORWARD, linewidth=1.8, label="synchronous" if turns > 1 else "measured, one turn")
    around = np.linspace(0.0, 2.0 * np.pi, 361)
    lowest, highest = float(result.synchronous.min()), float(result.synchronous.max())
    polar.plot(
        around,
        np.zeros(361),
        color=BOTH,
        linewidth=0.9,
        label="mean" if result.kind == "axial" else "least-squares circle",
    )
    polar.plot(
        around, np.full(361, highest), color=BACKWARD, linewidth=1.1, linestyle="--", label="circles containing it"
    )
    polar.plot(around, np.full(361, lowest), color=BACKWARD, linewidth=1.1, linestyle="--")
    polar.set_ylim(
        -2.2 * extent, 1.15 * extent
    )  # room in the middle: the circle's size is arbitrary, deviations are not
    ticks = _ticks(extent)
    polar.set_yticks(ticks, [""] * len(ticks))
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.8}
    for tick in ticks:  # by hand, above the curves
        label = f"{tick:+g}".replace("-", "−") if tick else "0"
        polar.text(105.0 * DEG, tick, label, fontsize=8, horizontalalignment="center", zorder=5, bbox=paper)
    polar.set_xticks(np.arange(0.0, 360.0, 30.0) * DEG)
    polar.grid(color="#cccccc", linewidth=0.5)
    heading = (
        f"{result.name}: {result.kind} error motion" if result.name else f"{result.kind.capitalize()} error motion"
    )
    figure.text(0.04, 0.95, title or f"{heading} by ISO 230-7:2015", fontweight="bold", fontsize=12)
    count = len(result.angle_deg)
    figure.text(
        0.04,
        0.915,
        f"{count} angles, {turns} turn{'' if turns == 1 else 's'}; radial scale [{unit}]",
        fontsize=9,
        color=RUN,
    )
    fundamental = "fundamental" if result.kind == "axial" else "once per turn, removed"
    rows = [("total", result.total_value), ("synchronous", result.synchronous_value)]
    rows += [(fundamental, result.fundamental_value), ("residual synchronous", result.residual_value)]
    if result.asynchronous_value is not None:
        rows.append(("asynchronous", result.asynchronous_value))
    figure.text(0.70, 0.60, f"values [{unit}]", fontsize=9, color=RUN)
    for i, (label, value) in enumerate(rows):
        figure.text(0.70, 0.56 - 0.037 * i, label)
        figure.text(0.97, 0.56 - 0.037 * i, f"{value:.2f}", horizontalalignment="right", fontweight="bold")
    _bars(figure.add_axes((0.74, 0.09, 0.23, 0.2)), result, unit)
    polar.legend(
        loc="upper left", bbox_to_anchor=(0.69, 0.88), bbox_transform=figure.transFigure, frameon=False, fontsize=9
    )
    return figure


def _bars(plot: Axes, result: ErrorMotion, unit: str) -> None:
    """Amplitudes of the harmonics; those that were removed with the centre are left out."""
    shown = [h for h in result.harmonics if h.order > 1 or result.kind == "axial"]
    _dress(plot)
    plot.bar([h.order for h in shown], [h.amplitude for h in shown], color=FORWARD, width=0.7)
    plot.set_xticks([h.order for h in shown])
    plot.tick_params(labelsize=8)
    plot.set_xlabel("harmonic [periods a turn]", fontsize=8)
    plot.set_ylabel(f"amplitude [{unit}]", fontsize=8)


def _ticks(extent: float) -> list[float]:
    """Round radii on both sides of zero."""
    rough = extent / 2.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= rough * (1.0 + 1e-9)))
    return [float(f"{k * step:.12g}") for k in range(-int(extent / step), int(extent / step) + 1)]


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    plot = figure.add_axes((0.07, 0.11, 0.60, 0.81))
    _dress(plot)
    return figure, plot


def _dress(plot: Axes) -> None:
    plot.grid(color="#dddddd", linewidth=0.6)
    plot.set_axisbelow(True)
    plot.spines[["top", "right"]].set_visible(False)
