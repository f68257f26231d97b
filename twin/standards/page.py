"""The standard tests as one HTML file with the standards' plots: tolerances, values, what was not evaluated. Needs the extra ``plots``.

Every function ``plot_…`` returns a new `Figure`; `twin.display.figures.save` writes it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from twin._common.messages import Message, Number, joined, say
from twin._common.provenance import warning_texts
from twin._common.units import DEG, HOUR
from twin.display import Html, figure, readable, render
from twin.display.figures import (
    BACKWARD,
    BOTH,
    FORWARD,
    RUN,
    THIRD,
    embedded,
    new_figure,
    plot_markers,
    radius_label,
    style_axes,
    text_box_style,
)
from twin.display.sheet import Sheet
from twin.measurement.columns import grouped_notes
from twin.standards.iso230_1 import AngularError, Straightness
from twin.standards.iso230_2 import Positioning, UnidirectionalPositioning
from twin.standards.iso230_3 import DriftSeries
from twin.standards.iso230_4 import CircularTest, RotaryMotion
from twin.standards.result import FEW_TESTS, SENTENCES, WORDS, EvaluationResult, StandardTest, grouped_remarks

BESIDE: Final[dict[str, Any]] = {"loc": "upper left", "frameon": False, "borderaxespad": 0.0, "fontsize": 9}
"""Options of a legend to the right of its plot."""


def plot_positioning(result: Positioning, *, title: str = "") -> Figure:
    """Plot an ISO 230-2 evaluation: deviations of all runs, means, bands of ±2s, and the values of the standard."""
    figure = new_figure(11.0, 6.2, layout=None)
    plot = figure.add_axes((0.07, 0.11, 0.60, 0.81))
    style_axes(plot)
    order = np.argsort(result.target)
    target, unit = result.target[order], readable(result.unit)
    for runs, mean, s, colour, marker, arrow, style in (
        (result.forward, result.mean_forward, result.s_i_forward, FORWARD, "^", "↑", "-"),
        (result.backward, result.mean_backward, result.s_i_backward, BACKWARD, "v", "↓", "--"),
    ):
        middle, two_s = mean[order], 2.0 * s[order]
        edge: dict[str, Any] = {"color": colour, "linewidth": 0.8, "linestyle": style}
        plot.fill_between(target, middle - two_s, middle + two_s, color=colour, alpha=0.15, linewidth=0)
        plot.plot(target, middle + two_s, **edge, label=f"x̄{arrow} ± 2s{arrow}")
        plot.plot(target, middle - two_s, **edge)
        lines = plot.plot(target, runs[order], color=colour, linewidth=0, marker=marker, markersize=3.5, alpha=0.55)
        lines[0].set_label(say("runs {arrow} ({count})", arrow=arrow, count=result.cycles))
        plot.plot(target, middle, color=colour, linewidth=1.8, linestyle=style, label=say("mean x̄{arrow}", arrow=arrow))
    plot.plot(target, result.mean[order], color=BOTH, linewidth=1.2, linestyle=":", label=say("mean of both x̄"))
    _mark_values(plot, result)
    heading = say("Axis {axis}: positioning", axis=result.axis) if result.axis else say("Positioning")
    plot.set_title(title or say("{heading} by ISO 230-2:2014", heading=heading), loc="left", fontweight="bold")
    plot.set(
        xlabel=say("target position [{unit}]", unit=readable(result.target_unit)),
        ylabel=say("deviation, actual − target [{unit}]", unit=unit),
    )
    plot.legend(bbox_to_anchor=(1.14, 1.0), **BESIDE)
    _write_values(plot, result, unit)
    if result.shortfalls:
        text = say("Not by the standard (4.3): {reasons}", reasons=joined("; ", result.shortfalls))
        figure.text(0.01, 0.01, text, color=BACKWARD, fontsize=8)
    return figure


def plot_unidirectional(result: UnidirectionalPositioning, *, title: str = "") -> Figure:
    """Plot an ISO 230-2 evaluation of one direction of approach: deviations of all runs, mean, and band of ±2s."""
    figure = new_figure(9.0, 5.0)
    plot = figure.subplots()
    style_axes(plot)
    order = np.argsort(result.target)
    target, mean, two_s = result.target[order], result.mean[order], 2.0 * result.s_i[order]
    colour, marker, arrow = (FORWARD, "^", "↑") if result.direction > 0 else (BACKWARD, "v", "↓")
    if np.isfinite(two_s).all():
        plot.fill_between(target, mean - two_s, mean + two_s, color=colour, alpha=0.15, linewidth=0, label="± 2s")
    runs = plot.plot(target, result.deviations[order], color=colour, linewidth=0, marker=marker, markersize=3.5)
    runs[0].set_label(say("runs {arrow} ({count})", arrow=arrow, count=result.deviations.shape[1]))
    plot.plot(target, mean, color=colour, linewidth=1.8, label=say("mean x̄{arrow}", arrow=arrow))
    plot.set_title(
        title or say("Axis {axis}: positioning by ISO 230-2:2014", axis=result.axis), loc="left", fontweight="bold"
    )
    unit = readable(result.unit)
    plot.set(
        xlabel=say("target position [{unit}]", unit=readable(result.target_unit)),
        ylabel=say("deviation, actual − target [{unit}]", unit=unit),
    )
    plot.legend(bbox_to_anchor=(1.01, 1.0), **BESIDE)
    return figure


def _write_values(plot: Axes, result: Positioning, unit: str) -> None:
    """Write the standard's values as a table next to the plot."""
    rows: tuple[tuple[str, float | None, float | None, float], ...] = (
        ("B", None, None, result.B),
        ("B̄", None, None, result.B_mean),
        ("R", result.R_forward, result.R_backward, result.R),
        ("E", result.E_forward, result.E_backward, result.E),
        ("M", None, None, result.M),
        ("A", result.A_forward, result.A_backward, result.A),
    )
    decimals = 1 if result.A >= 10.0 else 2
    values = [(name, *("" if v is None else f"{v:.{decimals}f}" for v in of)) for name, *of in rows]
    for i, row in enumerate([("", "↑", "↓", "both"), *values]):
        for column, text in enumerate(row):
            looks: dict[str, Any] = {
                "horizontalalignment": "left" if column == 0 else "right",
                "fontweight": "bold" if column in (0, 3) and i else "normal",
                "color": BOTH if i else RUN,
            }
            x = 1.15 + 0.095 * column + 0.02 * (column > 0)
            plot.text(x, 0.46 - 0.058 * i, text, transform=plot.transAxes, **looks)
    plot.text(1.15, 0.52, say("values in {unit}", unit=unit), transform=plot.transAxes, color=RUN, fontsize=9)


def _mark_values(plot: Axes, result: Positioning) -> None:
    """Draw brackets next to the curves for A, E and M, and B at its target."""
    low = min(
        (result.mean_forward - 2 * result.s_i_forward).min(), (result.mean_backward - 2 * result.s_i_backward).min()
    )
    means = np.concatenate([result.mean_forward, result.mean_backward])
    at = plot.get_yaxis_transform()
    ends = {"color": BOTH, "shrinkA": 0, "shrinkB": 0}
    bracket: dict[str, Any] = ends | {"arrowstyle": "|-|,widthA=0.25,widthB=0.25"}
    beside: dict[str, Any] = {"xycoords": at, "textcoords": at, "arrowprops": bracket, "annotation_clip": False}
    for x, name, start, value in (
        (1.020, "M", float(result.mean.min()), result.M),
        (1.055, "E", float(means.min()), result.E),
        (1.090, "A", float(low), result.A),
    ):
        plot.annotate("", (x, start + value), (x, start), **beside)
        plot.text(x, start + value, f"{name}\n", transform=at, horizontalalignment="center", verticalalignment="center")
    i = int(np.argmax(np.abs(result.B_i)))
    where, low, high = float(result.target[i]), float(result.mean_backward[i]), float(result.mean_forward[i])
    plot.annotate("", (where, high), (where, low), arrowprops=ends | {"arrowstyle": "<->", "linewidth": 1.2})
    offset: dict[str, Any] = {
        "textcoords": "offset points",
        "verticalalignment": "center",
        "bbox": text_box_style(0.85, 0.6),
    }
    plot.annotate("B", (where, (low + high) / 2.0), (6, 0), **offset)


def plot_straightness(result: Straightness, *, title: str = "") -> Figure:
    """Plot a straightness: the measured deviations with their three reference lines, and below the deviations from each line."""
    figure = new_figure(10.0, 7.2)
    above, below = figure.subplots(2, 1, sharex=True)
    style_axes(above)
    style_axes(below)
    position, axis = result.position_mm, result.name[-1:]
    above.plot(position, result.deviation_um, color=RUN, linewidth=0.8, marker="o", markersize=4, label=say("measured"))
    for line, colour, style, marker in zip(
        result.lines, (FORWARD, BACKWARD, THIRD), ("-", "--", "-."), ("o", "s", "D"), strict=True
    ):
        slope = f"{line.slope_urad:.2f} µrad"
        if line.u_slope_urad is not None:
            slope = f"({line.slope_urad:.2f} ± {2.0 * line.u_slope_urad:.2f}) µrad, k = 2"
        label = say("{line}: slope {slope}", line=say(str(line.kind)), slope=Number(slope)).replace("-", "−")
        looks: dict[str, Any] = {"color": colour, "linestyle": style}
        above.plot(position, line.at_um(position), **looks, linewidth=1.6, label=label)
        looks |= {"linewidth": 1.2, "marker": marker, "markersize": 3.5}
        below.plot(
            position,
            line.residual_um,
            **looks,
            label=say("{line}: {value:.2f} µm", line=say(str(line.kind)), value=line.value_um),
        )
    zone = result.minimum_zone
    half, middle, contacts = zone.value_um / 2.0, zone.at_um(position), list(zone.contacts)
    above.fill_between(position, middle - half, middle + half, color=THIRD, alpha=0.12, linewidth=0)
    carrying: dict[str, Any] = {"markerfacecolor": "none", "label": say("points that define the minimum zone")}
    plot_markers(above, position[contacts], result.deviation_um[contacts], THIRD, size=11, **carrying)
    below.axhspan(-half, half, color=THIRD, alpha=0.12, linewidth=0)
    below.axhline(0.0, color=BOTH, linewidth=0.8)
    heading = title or say("Straightness {name} by ISO 230-1:2012", name=result.name).replace("  ", " ")
    above.set_title(heading, loc="left", fontweight="bold")
    above.set_ylabel(say("measured deviation [µm]"))
    below.set(ylabel=say("deviation from the line [µm]"), xlabel=say("{axis} position [mm]", axis=axis).strip())
    above.legend(bbox_to_anchor=(1.01, 1.0), **BESIDE)
    below.legend(bbox_to_anchor=(1.01, 1.0), **BESIDE, title=say("straightness error about"), alignment="left")
    return figure


def plot_angular_error(result: AngularError, *, title: str = "") -> Figure:
    """Plot an angular error: the mean angular deviation of each direction over the travel, and their range."""
    figure = new_figure(9.0, 4.5)
    plot = figure.subplots()
    style_axes(plot)
    means = (result.forward_urad, result.backward_urad)
    low, high = (float(end(np.concatenate(means))) for end in (np.nanmin, np.nanmax))
    plot.axhspan(
        low, high, color=THIRD, alpha=0.12, linewidth=0, label=say("range {value:.2f} µrad", value=result.value_urad)
    )
    for mean, value, colour, marker, arrow, style in zip(
        means,
        (result.forward_value_urad, result.backward_value_urad),
        (FORWARD, BACKWARD),
        "^v",
        "↑↓",
        ("-", "--"),
        strict=True,
    ):
        if value is not None:
            looks: dict[str, Any] = {"color": colour, "linestyle": style, "marker": marker, "markersize": 4.0}
            read = np.isfinite(mean)
            plot.plot(
                result.position_mm[read],
                mean[read],
                **looks,
                label=say("mean {arrow}: {value:.2f} µrad", arrow=arrow, value=value),
            )
    heading = title or say("Angular error {name} by ISO 230-1:2012", name=result.name)
    plot.set_title(heading, loc="left", fontweight="bold")
    plot.set(xlabel=say("{axis} position [mm]", axis=result.name[-1:]).strip(), ylabel=say("angular deviation [µrad]"))
    plot.legend(bbox_to_anchor=(1.01, 1.0), **BESIDE)
    return figure


def plot_error_motion(result: RotaryMotion, *, title: str = "") -> Figure:
    """Plot a rotary axis's error motion in polar coordinates: every turn, their mean, and the two circles that contain the mean."""
    unit, turns, axial = readable(result.unit), len(result.total), result.kind == "axial"
    kind = say("axial error motion") if axial else say("radial error motion")
    heading = f"{result.name}: {kind}" if result.name else kind[:1].upper() + kind[1:]
    about = say(
        "angles: {angles}, turns: {turns}; radial scale [{unit}]", angles=len(result.angle_deg), turns=turns, unit=unit
    )
    figure, polar = _polar(title or say("{heading} by ISO 230-7:2015", heading=heading), about)
    _turns(polar, result)
    rows = [
        (say("total"), result.total_value),
        (say("synchronous"), result.synchronous_value),
        (say("fundamental") if axial else say("once per turn, removed"), result.fundamental_value),
        (say("residual synchronous"), result.residual_value),
        (say("asynchronous"), result.asynchronous_value),
    ]
    _list_values(figure, polar, rows, unit, 0.97)
    _bars(figure.add_axes((0.74, 0.09, 0.23, 0.2)), result, unit)
    return figure


def _polar(title: str, about: str) -> tuple[Figure, Any]:
    """Return a figure with polar axes, its title, and a line below the title."""
    figure = new_figure(9.5, 6.8, layout=None)
    polar: Any = figure.add_subplot(projection="polar", position=(0.05, 0.07, 0.6, 0.8))
    figure.text(0.04, 0.95, title, fontweight="bold", fontsize=12)
    figure.text(0.04, 0.915, about, fontsize=9, color=RUN)
    return figure, polar


def _list_values(figure: Figure, polar: Any, rows: list[tuple[str, float | None]], unit: str, right: float) -> None:
    """Write the legend and the values that are known beside polar axes."""
    figure.text(0.70, 0.60, say("values [{unit}]", unit=unit), fontsize=9, color=RUN)
    for i, (label, value) in enumerate((label, value) for label, value in rows if value is not None):
        figure.text(0.70, 0.56 - 0.037 * i, label)
        figure.text(right, 0.56 - 0.037 * i, f"{value:.2f}", horizontalalignment="right", fontweight="bold")
    place = {"bbox_to_anchor": (0.69, 0.88), "bbox_transform": figure.transFigure}
    polar.legend(**place, loc="upper left", frameon=False, fontsize=9)


def _turns(polar: PolarAxes, result: RotaryMotion) -> None:
    """Draw the curves with their circles, with an arbitrary radius in the middle to which the deviations are added."""
    angle = np.append(result.angle_deg, result.angle_deg[0] + 360.0) * DEG
    extent = max(float(np.abs(result.total).max()), 1e-12)
    turns = len(result.total)
    if turns > 1:
        for i, turn in enumerate(result.total):
            label = say("{turns} turns", turns=turns) if i == 0 else "_"
            polar.plot(angle, np.append(turn, turn[0]), color=RUN, linewidth=0.6, alpha=0.8, label=label)
    closed = np.append(result.synchronous, result.synchronous[0])
    polar.plot(
        angle,
        closed,
        color=FORWARD,
        linewidth=1.8,
        label=say("synchronous") if turns > 1 else say("measured, one turn"),
    )
    around = np.linspace(0.0, 2.0 * np.pi, 361)
    mean = say("mean") if result.kind == "axial" else say("least-squares circle")
    polar.plot(around, np.zeros(361), color=BOTH, linewidth=0.9, label=mean)
    circle: dict[str, Any] = {"color": BACKWARD, "linewidth": 1.1, "linestyle": "--"}
    polar.plot(around, np.full(361, result.synchronous.max()), **circle, label=say("circles containing it"))
    polar.plot(around, np.full(361, result.synchronous.min()), **circle)
    _radial_scale(polar, extent)


def _radial_scale(polar: PolarAxes, extent: float) -> None:
    """Draw the radial scale of deviations up to ``extent`` around a circle of arbitrary radius."""
    polar.set_ylim(-2.2 * extent, 1.15 * extent)
    ticks = _ticks(extent)
    polar.set_yticks(ticks, [""] * len(ticks))
    for tick in ticks:  # by hand, above the curves
        where: dict[str, Any] = {"horizontalalignment": "center", "zorder": 5, "bbox": text_box_style(0.85, 0.8)}
        polar.text(105.0 * DEG, tick, radius_label(tick), fontsize=8, **where)
    polar.set_xticks(np.arange(0.0, 360.0, 30.0) * DEG)
    polar.grid(color="#cccccc", linewidth=0.5)


def plot_circular(result: CircularTest, *, title: str = "") -> Figure:
    """Plot a circular test in polar coordinates: the paths of both directions about their common centre, and the nominal circle."""
    about = say(
        "radius {radius:g} mm, about the centre of the least-squares circle; radial scale [µm]", radius=result.radius_mm
    )
    figure, polar = _polar(title or say("{name}: circular test by ISO 230-4", name=result.name), about)
    centre = result.centre_um
    shown = [
        (arrow, path, path.radius_um - centre @ np.array([np.cos(path.angle_deg * DEG), np.sin(path.angle_deg * DEG)]))
        for arrow, path in result.paths
    ]
    extent = max(max(float(np.abs(values).max()) for _, _, values in shown), 1e-12)
    for (arrow, path, values), colour, style in zip(shown, (FORWARD, BACKWARD), ("-", "--"), strict=False):
        angle = np.append(path.angle_deg, path.angle_deg[0] + 360.0) * DEG
        polar.plot(
            angle,
            np.append(values, values[0]),
            color=colour,
            linestyle=style,
            linewidth=1.4,
            label=say("path {arrow}", arrow=arrow),
        )
    around = np.linspace(0.0, 2.0 * np.pi, 361)
    polar.plot(around, np.zeros(361), color=BOTH, linewidth=0.9, label=say("nominal circle"))
    _radial_scale(polar, extent)
    rows = [("G(b)", result.G_b_um), ("H", result.H_um), ("D", result.D_um)]
    rows += [(f"G{arrow}", path.G_um) for arrow, path in result.paths]
    _list_values(figure, polar, rows, "µm", 0.85)
    return figure


def _bars(plot: Axes, result: RotaryMotion, unit: str) -> None:
    """Draw the amplitudes of the harmonics, without those that were removed with the centre."""
    shown = [h for h in result.harmonics if h.order > 1 or result.kind == "axial"]
    style_axes(plot)
    plot.bar([h.order for h in shown], [h.amplitude for h in shown], color=FORWARD, width=0.7)
    plot.set_xticks([h.order for h in shown])
    plot.tick_params(labelsize=8)
    plot.set_xlabel(say("harmonic [periods a turn]"), fontsize=8)
    plot.set_ylabel(say("amplitude [{unit}]", unit=unit), fontsize=8)


def _ticks(extent: float) -> list[float]:
    """Return round radii on both sides of zero."""
    rough = extent / 2.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= rough * (1.0 + 1e-9)))
    return [float(f"{k * step:.12g}") for k in range(-int(extent / step), int(extent / step) + 1)]


# --- Plot of displacements over time (ISO 230-3). It needs the extra ``plots`` (matplotlib) -------

SERIES: Final = (FORWARD, BACKWARD, THIRD, BOTH, "#cc79a7", "#e69f00", "#56b4e9", RUN)
STYLES: Final = ("-", "--", ":", "-.")
LEGEND_ROWS: Final = 8


def plot_drift(result: DriftSeries, *, title: str = "") -> Figure:
    """Plot displacements and tilts over time, further target positions dashed, with temperatures and spindle speed below."""
    hours = (result.time_s - result.time_s[0]) / HOUR
    units = [unit for unit in ("um", "urad") if unit in result.units.values()]
    temperatures = {name: values for name, values in result.temperature_degC.items() if np.isfinite(values).any()}
    speed = result.speed_rpm if result.speed_rpm is not None and np.nanmax(result.speed_rpm) > 0.0 else None
    heights = [3.2] * len(units) + [2.0] * bool(temperatures) + [1.3] * (speed is not None)
    figure = new_figure(9.0, sum(heights) + 0.4)
    plots = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    rest = iter(plots)
    for unit in units:
        _displacements(next(rest), result, hours, unit)
    if temperatures:
        plot = next(rest)
        for name, values in temperatures.items():
            plot.plot(hours, values, linewidth=0.9, label=name)
        plot.set_ylabel(say("temperature [°C]"))
    if speed is not None:
        plot = next(rest)
        plot.plot(hours, speed, color=BOTH, linewidth=1.0)
        plot.set_ylabel(say("speed [rpm]"))
    for plot in plots:
        _finish(plot, result)
    plots[0].set_title(title, loc="left", fontweight="bold")
    plots[-1].set_xlabel(say("time [h]"))
    return figure


def _displacements(plot: Axes, result: DriftSeries, hours: np.ndarray, unit: str) -> None:
    names = [name for name, own in result.units.items() if own == unit]
    for k, name in enumerate(names):
        for target in result.targets:
            rows = (result.target == target) & np.isfinite(result.displacement[name])
            plot.plot(
                hours[rows],
                result.displacement[name][rows],
                color=SERIES[k % len(SERIES)],
                linestyle=STYLES[(target - 1) % len(STYLES)],
                linewidth=1.1,
                label=name if len(result.targets) == 1 else say("{name}, target {target}", name=name, target=target),
            )
    plot.set_ylabel(f"{say('tilt') if unit == 'urad' else say('displacement')} [{readable(unit)}]")


def _finish(plot: Axes, result: DriftSeries) -> None:
    """Add grid, legend, and lines where the spindle started and stopped."""
    style_axes(plot)
    handles = plot.get_legend_handles_labels()[0]
    if handles:
        columns = 1 + (len(handles) - 1) // LEGEND_ROWS
        plot.legend(loc="upper left", frameon=False, fontsize=8, bbox_to_anchor=(1.01, 1.0), ncols=columns)
    for at in result.running_s or ():
        plot.axvline((at - result.time_s[0]) / HOUR, color=RUN, linewidth=0.8)


# --- The page -------------------------------------------------------------------------------------

MOST_PICTURES: Final = 40
"""Number of tests of one page that are drawn; the values of all are listed."""
PLOTS: Final[tuple[tuple[type, Callable[[Any], Figure]], ...]] = (
    (Positioning, plot_positioning),
    (UnidirectionalPositioning, plot_unidirectional),
    (CircularTest, plot_circular),
    (Straightness, plot_straightness),
    (AngularError, plot_angular_error),
    (RotaryMotion, plot_error_motion),
)
"""Plots by the kind of result."""
COLOURS: Final = {"met": "#e8f3ea", "failed": "#fbe4de", "none": "#f3f3f3"}


def evaluation_html(result: EvaluationResult, sheet: Sheet | None = None) -> str:
    """Return one self-contained HTML page.

    Args:
        result: the result of `twin.evaluate`.
        sheet: facts of the test, for a certificate.

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> plan, truth = twin.thesis_plan.plan(machine), twin.Calibration.default(machine)
        >>> along_x = plan.select(plan.approach[:, 0] != 0)
        >>> data, _ = twin.simulate(along_x, machine, truth, twin.instruments.LaserTracker(), np.random.default_rng(1))
        >>> page = twin.evaluation_html(twin.evaluate(data, machine))
        >>> _ = Path("tests.html").write_text(page, encoding="utf-8")
    """
    failed = sum(check.word == "FAIL" for check in result.checks)
    undecided = sum(check.word in ("UNDECIDED", "NOT EVALUATED") for check in result.checks)
    count = len(result.checks)
    if not count:
        headline = Message(
            "{count} standard tests evaluated; no tolerance was given, so there is no verdict", count=len(result.tests)
        )
    elif failed:
        headline = Message("FAIL: {failed} of {count} tolerances not met", failed=failed, count=count)
    elif undecided:
        headline = Message("UNDECIDED: {undecided} of {count} tolerances", undecided=undecided, count=count)
    else:
        headline = Message("PASS: all tolerances are met ({count})", count=count)
    pictures = [test for test in result.tests if _figure(test, draw=False)][:MOST_PICTURES]
    return render(
        "standards/templates/evaluation.html.j2",
        found=result,
        sheet=sheet,
        heading=Message("Certificate of a test of a machine tool"),
        machine_name=result.machine,
        words=WORDS,
        title=f"{headline}: {result.machine}",
        headline=headline,
        colour=COLOURS["none" if not result.checks else "failed" if failed or undecided else "met"],
        source=", ".join(Path(name).name for name in result.data.source.split(", ")),
        badges=warning_texts(result.warnings),
        picture=lambda test: _picture(test) if any(test is picture for picture in pictures) else "",
        not_drawn=sum(bool(_figure(test, draw=False)) for test in result.tests) - len(pictures),
        SENTENCES=SENTENCES,
        shown=figure,
        unit=readable,
        grouped_notes=grouped_notes,
        grouped_remarks=grouped_remarks,
        few=FEW_TESTS,
        targets=_targets,
    )


def _picture(test: StandardTest) -> Html:
    drawn = _figure(test)
    return (
        Html("")
        if not isinstance(drawn, Figure)
        else embedded(drawn, joined(", ", [test.title, test.place]), kind="big")
    )


def _figure(test: StandardTest, *, draw: bool = True) -> Figure | bool:
    """Return the standard's plot of a test; without ``draw`` only whether there is one."""
    detail = test.detail
    if isinstance(detail, Positioning) and not np.isfinite(detail.R):
        return False
    if isinstance(detail, DriftSeries):
        return plot_drift(detail, title=joined(", ", [test.title, test.standard])) if draw else True
    if isinstance(detail, np.ndarray):
        return _plot_deviations(test, detail) if draw else True
    for kind, plot in PLOTS:
        if isinstance(detail, kind):
            return plot(detail) if draw else True
    return False


def _plot_deviations(test: StandardTest, deviation_um: np.ndarray) -> Figure:
    """Plot the deviations of a kinematic test over the readings in their order."""
    drawn = new_figure(9.0, 4.0)
    plot = drawn.subplots()
    style_axes(plot)
    for k, (colour, marker) in enumerate(((FORWARD, "o"), (BACKWARD, "s"), (THIRD, "D"))):
        if np.isfinite(deviation_um[:, k]).all():
            label = test.values[0].symbol.removeprefix("range ") if len(test.values) == 1 else "xyz"[k]
            number = np.arange(1, len(deviation_um) + 1)
            plot.plot(number, deviation_um[:, k], color=colour, marker=marker, markersize=3, linewidth=1.0, label=label)
    plot.set_title(say(joined(", ", [test.title, test.standard])), loc="left", fontweight="bold")
    plot.set(xlabel=say("reading"), ylabel=say("deviation from the mean [µm]"))
    plot.legend(bbox_to_anchor=(1.01, 1.0), loc="upper left", frameon=False)
    return drawn


def _targets(test: StandardTest) -> list[tuple[str, ...]]:
    """Return the table by target of a bi-directional positioning test: P, x̄↑, x̄↓, B, s↑, s↓, R; empty for other tests."""
    detail = test.detail
    if not isinstance(detail, Positioning):
        return []
    columns = (
        detail.mean_forward,
        detail.mean_backward,
        detail.B_i,
        detail.s_i_forward,
        detail.s_i_backward,
        detail.R_i,
    )
    return [
        (Number(f"{target:g}".replace("-", "−")), *(figure(float(column[i])) for column in columns))
        for i, target in enumerate(detail.target)
    ]
