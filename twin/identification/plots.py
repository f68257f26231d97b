"""Plots of an identification. They need the extra ``plots`` (matplotlib).

Every function returns a new `Figure` in the colours of `twin.display.figures`; its `savefig` writes it. Colours are distinguishable
for colour-blind readers; line styles and markers without colour.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, cast, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from twin._common.distributions import chi2_isf
from twin._common.errors import InputError
from twin._common.provenance import warning_texts
from twin._common.units import DEG, TURN, count_with_noun
from twin.display import readable, render
from twin.display.figures import (
    BACKWARD,
    BOTH,
    FORWARD,
    RUN,
    SHADE,
    THIRD,
    embedded,
    heading,
    legend_below,
    new_figure,
    plot_markers,
    polar_ticks,
    style_axes,
    text_box_style,
)
from twin.display.numbers import COVERAGE_FACTOR
from twin.identification.result import THESIS_FUNCTIONS, Identification
from twin.identification.thesis import ThesisIdentification
from twin.machine.machine import Axis
from twin.model.datum.conditions import turning_patterns
from twin.model.effects import split_name
from twin.model.motion_curve import Curve
from twin.tool.uncertainty import DEFINITION, UncertaintyMap

FINE: Final = 361
"""Number of points with which a curve is drawn."""


def plot_motions(
    found: Identification,
    axis: str,
    *,
    thesis: ThesisIdentification | None = None,
    truth: Mapping[str, Curve] | None = None,
    title: str = "",
) -> Figure:
    """Plot the six error motions of one axis with their 95 % intervals: against position, or polar for a rotary axis within a turn.

    Args:
        found: the estimate.
        axis: its name.
        thesis: the thesis's points and curves from the same data, in this estimate's datum: components that the datum excludes
            (line, mean, rotating shift) are fitted to the points and subtracted from points and curve. A rotary axis is then plotted
            against its angle, because these curves would cross the centre of a polar plot.
        truth: true curves of a simulation, by ISO 230-1 name: drawn dotted, in this estimate's datum.
        title: a heading.

    Raises:
        InputError: an axis without error motions in this estimate.
    """
    curves = found.calibration.curves
    names = [name for name in curves if split_name(name)[2] == axis]
    if not names:
        raise InputError(
            "no error motions of this axis were identified",
            expected=f"one of {', '.join(dict.fromkeys(split_name(name)[2] for name in curves))}",
            value=axis,
        )
    one = found.calibration.machine.by_name[axis]
    half = not one.linear and one.lower is not None
    turn = all(np.ptp(curves[name].domain) <= TURN + 1e-9 for name in names)
    polar = not one.linear and thesis is None and turn
    figure = new_figure(12.0, (6.4 if half else 8.8) if polar else 7.4)
    points = _thesis_points(thesis, one) if thesis is not None else {}
    dotted = _in_datum(truth, one) if truth is not None else {}
    for name in names:
        place = (2, 3, split_name(name)[0] + 1)
        if polar:
            _polar(cast(PolarAxes, figure.add_subplot(*place, projection="polar")), found, name, dotted.get(name))
        else:
            _along(figure.add_subplot(*place), found, name, points.get(name), dotted.get(name))
    legend_below(figure)
    how = "; angle: command, radius: deviation from the bold circle" if polar else ""
    heading(figure, title or f"Axis {axis}: error motions with their 95 % intervals{how}")
    return figure


def plot_orders(found: Identification, names: Sequence[str] = (), *, title: str = "") -> Figure:
    """Plot the held-out error against the number of functions: the same for all curves, and for some curves one by one.

    Args:
        found: the estimate.
        names: curves to show one by one; if empty, the four whose held-out error increases most with degree 8.
        title: a heading.
    """
    choice = found.choice
    # By the increase of a curve's held-out error by degree 8.
    loss = {name: own.get(THESIS_FUNCTIONS, 0.0) - min(own.values()) for name, own in choice.by_curve.items()}
    shown = list(names) or sorted(loss, key=lambda name: -loss[name])[:4]
    figure = new_figure(12.0, 4.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    style_axes(left)
    style_axes(right)
    _same_for_all(left, found)
    _one_by_one(right, found, shown)
    for plot in (left, right):
        plot.set_ylabel("error of held-out readings, RMS\n[standard deviations of a reading]")
        plot.set_xlabel("functions of a curve, the datum's included (degree + 1)")
        plot.xaxis.set_major_locator(MaxNLocator(integer=True))
        plot.legend(frameon=False, fontsize=9)
    heading(figure, title or "Prediction error of held-out readings")
    return figure


def _same_for_all(plot: Axes, found: Identification) -> None:
    """Plot the same number of functions for every curve."""
    choice, sizes = found.choice, sorted(found.choice.uniform)
    errors = [choice.uniform[n] for n in sizes]
    plot.plot(sizes, errors, color=FORWARD, marker="o", markersize=4, label="same number for all")
    if THESIS_FUNCTIONS in choice.uniform:
        error = choice.uniform[THESIS_FUNCTIONS]
        label = f"degree 8 everywhere: {error:.3f}"
        plot_markers(plot, THESIS_FUNCTIONS, error, BACKWARD, "s", 9, markerfacecolor="none", label=label)
    plot.axhline(choice.held_out, color=THIRD, linestyle="--", label=f"chosen curve by curve: {choice.held_out:.3f}")
    plot.axhline(1.0, color=RUN, linewidth=0.8, linestyle=":", label="noise of the readings alone")
    plot.set_yscale("log")
    plot.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
    plot.minorticks_off()
    plot.set_title("same number for all curves", loc="left", fontsize=10)


def _one_by_one(plot: Axes, found: Identification, names: Sequence[str]) -> None:
    """Plot some curves, the others with their chosen number of functions."""
    choice = found.choice
    styles = zip(names, (FORWARD, BACKWARD, THIRD, BOTH), "osD^", ("-", "--", "-.", ":"), strict=False)
    for name, colour, marker, style in styles:
        scores, count = choice.by_curve[name], choice.counts[name]
        looks: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 4, "linestyle": style}
        plot.plot(list(scores), list(scores.values()), **looks, label=name)
        plot_markers(plot, count, scores[count], colour, "o", 13, markerfacecolor="none")
    plot.axvline(THESIS_FUNCTIONS, color=RUN, linewidth=0.9, linestyle=":", label="degree 8")
    plot_markers(plot, [], [], RUN, "o", 11, markerfacecolor="none", label="chosen")
    low = choice.held_out
    high = max(max(value for n, value in choice.by_curve[name].items() if n >= choice.counts[name]) for name in names)
    plot.set_ylim(low - 0.06 * (high - low), high + 0.1 * (high - low))
    plot.set_title("one curve at a time, the others as chosen (higher values cut off)", loc="left", fontsize=10)


def plot_residuals(found: Identification, *, title: str = "") -> Figure:
    """Plot the residuals in standard deviations: by axis position, and by station and target.

    Means at each position of a moving axis, and the RMS of each target from each station, are within their grey bands in 95 % of the
    cases. The bands are narrower than for independent readings, because the estimate was fitted to these.

    Args:
        found: the estimate.
        title: a heading.
    """
    data, machine = found.data, found.calibration.machine
    moved = [i for i in range(len(machine.axes)) if np.ptp(data.positions[:, i]) > 0.0]
    columns = max(-(-(len(moved) + 1) // 2), 1)
    figure = new_figure(4.0 * columns, 7.0)
    panels = figure.subplots(2, columns, squeeze=False).ravel()
    read = found.network.read & found.used[:, None]
    for plot, i in zip(panels, moved, strict=False):
        style_axes(plot)
        _by_position(plot, found, read, i)
    last = panels[len(moved)]
    style_axes(last)
    _by_target(last, found, read)
    for plot in panels[len(moved) + 1 :]:
        plot.set_visible(False)
    legend_below(figure)
    fit = found.misfit
    statistics = f"reduced chi² {fit.reduced:.3f} ({fit.dof:.0f} degrees of freedom, p = {fit.p_value:.2g})"
    heading(figure, title or f"Residuals: {statistics}")
    return figure


def _by_position(plot: Axes, found: Identification, read: np.ndarray, i: int) -> None:
    """Plot whitened residuals along one axis, with their means and the band of such means."""
    data, axis = found.data, found.calibration.machine.axes[i]
    at = np.round(data.positions[:, i], 3)
    # An axis is at rest during most of a plan: only rows of a line along this axis are informative.
    mine = _moving(data.positions, i)
    width = 0.012 * np.ptp(at[mine])
    for k, (colour, marker) in enumerate(zip((FORWARD, BACKWARD, THIRD), "osD", strict=True)):
        rows = mine & read[:, k]
        x, label = at[rows] + (k - 1) * width, f"whitened, {'xyz'[k]} of the station"
        plot_markers(plot, x, found.whitened[rows, k], colour, marker, 2.5, alpha=0.35, label=label)
    places = np.unique(at[mine])
    of = [read & (mine & (at == place))[:, None] for place in places]
    count = np.array([max(np.count_nonzero(one), 1) for one in of])
    mean = np.array([found.whitened[one].sum() for one in of]) / count
    half = COVERAGE_FACTOR * np.sqrt(np.maximum(count - _fitted(found, of)[0], 0.0)) / count
    plot.fill_between(places, -half, half, color=RUN, alpha=0.45, linewidth=0, label="95 % of means")
    plot.plot(places, mean, color=BOTH, marker="o", markersize=4, linewidth=1.0, label="mean")
    label = f"{axis.name} [{readable(axis.unit)}]"
    plot.set(xlabel=label, ylabel="residual [standard deviations]", ylim=(-4.6, 4.6))


def correlation(found: Identification) -> tuple[tuple[str, ...], np.ndarray]:
    """Return how strongly the reported errors are confounded: the largest correlation of any part of one with any part of another.

    For two curves this is their largest canonical correlation (Hotelling 1936), which does not depend on their functions;
    for two numbers it is the absolute correlation. From the covariance of the estimate with the stated noise.

    Args:
        found: the estimate.

    Returns:
        Names, and (n, n) values from 0 to 1.
    """
    unknowns = found.network.unknowns
    covariance = found.solution.covariance()[: len(unknowns), : len(unknowns)]
    names = (*found.calibration.curves, *found.calibration.squareness, *found.calibration.location)
    roots = {name: _inverse_root(covariance[np.ix_(unknowns.of(name), unknowns.of(name))]) for name in names}
    values = np.eye(len(names))
    for i, one in enumerate(names):
        for j, other in enumerate(names[:i]):
            cross = covariance[np.ix_(unknowns.of(one), unknowns.of(other))]
            values[i, j] = values[j, i] = np.linalg.norm(roots[one] @ cross @ roots[other].T, 2)
    return names, np.clip(values, 0.0, 1.0)


def plot_correlation(found: Identification, *, title: str = "") -> Figure:
    """Plot `correlation`, from white (separable) to dark (only the combination is determined).

    Args:
        found: the estimate.
        title: a heading.
    """
    names, values = correlation(found)
    size = max(5.0, 2.2 + 0.22 * len(names))
    figure = new_figure(size + 1.0, size)
    plot = figure.subplots()
    picture = plot.imshow(values, cmap="Blues", vmin=0.0, vmax=1.0)
    plot.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    plot.set_yticks(range(len(names)), names, fontsize=8)
    group = [split_name(name)[1:] for name in names]
    for i in range(1, len(names)):
        if group[i] != group[i - 1]:
            plot.axhline(i - 0.5, color=RUN, linewidth=0.8)
            plot.axvline(i - 0.5, color=RUN, linewidth=0.8)
    plot.tick_params(length=0)
    bar = figure.colorbar(picture, ax=plot, shrink=0.8)
    bar.set_label("largest correlation of any part of one with any part of the other")
    heading(figure, title or "Errors that are confounded in these data")
    return figure


def plot_uncertainty(found: UncertaintyMap, horizontal: str, vertical: str, *, title: str = "") -> Figure:
    """Plot U of the tool point over a plane of a grid (`ToolUncertainty.on_grid`), the other axes at the grid's middle position.

    Args:
        horizontal: name of the horizontal axis of the plot.
        vertical: name of the vertical axis of the plot.
        title: a heading.

    Raises:
        InputError: axes along which the map has a single position.
    """
    at = {name: np.unique(found.positions[:, i]) for i, name in enumerate(found.axes)}
    if not all(len(at.get(name, ())) > 1 for name in (horizontal, vertical)) or horizontal == vertical:
        spread = [name for name, places in at.items() if len(places) > 1]
        raise InputError(
            "not a plane of this map", expected=f"two of {', '.join(spread)}", value=f"{horizontal}, {vertical}"
        )
    across, up = at[horizontal], at[vertical]
    rest = {name: float(at[name][len(at[name]) // 2]) for name in found.axes if name not in (horizontal, vertical)}
    keep = np.all([found.positions[:, found.axes.index(name)] == value for name, value in rest.items()], axis=0)
    columns = [found.axes.index(vertical), found.axes.index(horizontal)]
    order = np.lexsort(found.positions[keep][:, columns[::-1]].T)
    values = found.uncertainty.expanded_um[keep][order].reshape(len(up), len(across))
    figure = new_figure(8.4, 5.4)
    plot = figure.subplots()
    filled = plot.contourf(across, up, values, levels=10, cmap="cividis")
    lines = plot.contour(filled, levels=np.asarray(filled.levels)[::2], colors="white", linewidths=0.7)
    plot.clabel(lines, fmt="%g", fontsize=8)
    plot.set(xlabel=f"{horizontal} [mm]", ylabel=f"{vertical} [mm]", aspect="equal")
    figure.colorbar(filled, ax=plot).set_label("U of the tool point [µm]")
    where = ", ".join(f"{name} {value:g}" for name, value in rest.items())
    plot.set_title(f"{where}\n{DEFINITION}", loc="left", fontsize=9)
    heading(figure, title or "Uncertainty of the tool point from the calibration")
    return figure


def _along(
    plot: Axes, found: Identification, name: str, points: _Points | None, dotted: tuple[np.ndarray, np.ndarray] | None
) -> None:
    style_axes(plot)
    curve = found.calibration.curves[name]
    _interval(plot, found, name, 1.8, 1.0)
    if dotted is not None:
        plot.plot(*dotted, color=BOTH, linewidth=1.3, linestyle=":", label="true (simulated)")
    if points is not None:
        mark: dict[str, Any] = {"color": BACKWARD, "marker": "s", "markersize": 4, "linestyle": "", "capsize": 2}
        label = "thesis: mean ± s of the rounds"
        plot.errorbar(points.at, points.value, points.deviation, **mark, linewidth=0.9, label=label)
        plot.plot(points.fine, points.curve, color=BACKWARD, linewidth=1.0, linestyle="--", label="thesis: degree 8")
    plot.axhline(0.0, color=BOTH, linewidth=0.6)
    plot.set_title(name, loc="left", fontweight="bold", fontsize=10)
    axis = found.calibration.machine.by_name[split_name(name)[2]]
    plot.set(xlabel=f"{axis.name} [{readable(axis.unit)}]", ylabel=f"{name} [{readable(curve.unit)}]")


def _interval(plot: Axes, found: Identification, name: str, width: float, scale: float) -> float:
    """Draw a curve with its 95 % interval; return the largest distance of the interval from zero."""
    q = np.linspace(*found.calibration.curves[name].domain, FINE)
    value, u = found.interval(name, q)
    low, high = value - COVERAGE_FACTOR * u, value + COVERAGE_FACTOR * u
    plot.fill_between(q * scale, low, high, color=FORWARD, alpha=SHADE, linewidth=0, label="95 % interval")
    plot.plot(q * scale, value, color=FORWARD, linewidth=width, label="identified")
    return float(max(np.abs(low).max(), np.abs(high).max()))


def _polar(plot: PolarAxes, found: Identification, name: str, dotted: tuple[np.ndarray, np.ndarray] | None) -> None:
    curve = found.calibration.curves[name]
    extent = max(_interval(plot, found, name, 1.6, DEG), 1e-9)
    if dotted is not None:
        plot.plot(dotted[0] * DEG, dotted[1], color=BOTH, linewidth=1.3, linestyle=":", label="true (simulated)")
        extent = max(extent, float(np.abs(dotted[1]).max()))
    plot.plot(np.linspace(*curve.domain, FINE) * DEG, np.zeros(FINE), color=BOTH, linewidth=1.1)
    ticks, full = polar_ticks(plot, extent, curve.domain)
    plot.set_yticks([tick for tick, _ in ticks], [""] * len(ticks))
    plot.set_xticks(np.arange(curve.domain[0], curve.domain[1] + (0.0 if full else 1.0), 30.0) * DEG)
    plot.tick_params(labelsize=8)
    for tick, label in ticks:  # by hand, above the curves
        looks: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 6, "bbox": text_box_style(0.8, 0.5)}
        plot.text((105.0 if full else 98.0) * DEG, tick, label, fontsize=7, **looks)
    plot.set_title(f"{name} [{readable(curve.unit)}]", loc="left", fontweight="bold", fontsize=10)


@final
@dataclass(frozen=True)
class _Points:
    """The thesis's points of one error motion and its curve, in the datum of an identification; µm or µrad, mm or degrees."""

    at: np.ndarray
    value: np.ndarray
    deviation: np.ndarray
    fine: np.ndarray
    curve: np.ndarray


def _thesis_points(thesis: ThesisIdentification, axis: Axis) -> dict[str, _Points]:
    """Return the thesis's points and curves without the components that the datum excludes, fitted to the points by least squares."""
    motions = {name: motion for name, motion in thesis.motions.items() if split_name(name)[2] == axis.name}
    excluded = _excluded_by_datum(axis, {name: (motion.position, motion.mean) for name, motion in motions.items()})
    thesis_points = {}
    for name, motion in motions.items():
        q = motion.position
        fine = np.linspace(q.min(), q.max(), FINE)
        # The curve of a straightness was fitted after its own line's slope had been subtracted.
        slope = np.polyfit(q, motion.mean, 1)[0] if _straightness(axis, name) else 0.0
        curve = thesis.calibration.curves[name](fine) + slope * fine - excluded[name](fine)
        thesis_points[name] = _Points(q, motion.mean - excluded[name](q), motion.deviation, fine, curve)
    return thesis_points


def _in_datum(truth: Mapping[str, Curve], axis: Axis) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return positions and values of curves in the datum of an identification."""
    curves = {name: curve for name, curve in truth.items() if split_name(name)[2] == axis.name}
    lines = {name: (q, curve(q)) for name, curve in curves.items() for q in [np.linspace(*curve.domain, FINE)]}
    excluded = _excluded_by_datum(axis, lines)
    return {name: (q, values - excluded[name](q)) for name, (q, values) in lines.items()}


def _excluded_by_datum(
    axis: Axis, lines: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Return the components that the datum of `twin.identification.network` excludes, by least squares over the points.

    For a linear axis: the line of a straightness, otherwise the mean. For a rotary axis: the mean and, in pairs across the axis, the
    effect of a shift or tilt of everything that rotates with it.
    """
    if axis.linear:
        return {name: np.poly1d(np.polyfit(*line, int(_straightness(axis, name)))) for name, line in lines.items()}
    excluded_by_datum: dict[str, Callable[[np.ndarray], np.ndarray]] = {}
    for letters in ("XYZ", "ABC"):
        names = [f"E_{letter}{axis.name}" for letter in letters]
        present = [name for name in names if name in lines]
        shapes = {name: partial(_shapes, axis, present, name, k) for k, name in enumerate(names) if name in lines}
        if present:
            matrix = np.concatenate([shapes[name](lines[name][0]) for name in present])
            size, *_ = np.linalg.lstsq(matrix, np.concatenate([lines[name][1] for name in present]), rcond=None)
            excluded_by_datum |= {name: partial(_summed, shapes[name], size) for name in present}
    return excluded_by_datum


def _shapes(axis: Axis, present: Sequence[str], name: str, component: int, q: np.ndarray) -> np.ndarray:
    """Return (n, k) the effect of the mean of each motion present, and of each rotating shift or tilt, on one motion."""
    own = [np.full(len(q), float(name == one)) for one in present]
    return np.column_stack([*own, *(pattern[component](q) for pattern in turning_patterns(axis))])


def _summed(shapes: Callable[[np.ndarray], np.ndarray], size: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.asarray(shapes(q) @ size)


def _straightness(axis: Axis, name: str) -> bool:
    """Return whether an error motion is a translation across a linear axis."""
    component = split_name(name)[0]
    return axis.linear and component < 3 and component != int(np.argmax(np.abs(axis.direction)))


def _by_target(plot: Axes, found: Identification, read: np.ndarray) -> None:
    data = found.data
    pairs = list(dict.fromkeys(zip(data.target.tolist(), data.station.tolist(), strict=True)))
    several = len(dict.fromkeys(data.station)) > 1
    masks = [read & ((data.target == one) & (data.station == other))[:, None] for one, other in pairs]
    for i, (mask, fitted) in enumerate(zip(masks, _fitted(found, masks)[1], strict=True)):
        values = found.whitened[mask]
        free = max(values.size - float(fitted), 1e-3)
        low, high = np.sqrt(chi2_isf([0.975, 0.025], free) / max(values.size, 1))
        plot.fill_between([i - 0.35, i + 0.35], low, high, color=RUN, alpha=0.45, linewidth=0)
        plot.plot(i, np.sqrt(np.mean(values**2)), color=BOTH, marker="o", markersize=6, linestyle="")
    names = [f"{target}\n{station}" if several else target for target, station in pairs]
    plot.set_xticks(range(len(pairs)), names)
    plot.set_xlabel("target, station" if several else "target")
    plot.set_ylabel("RMS residual [standard deviations]")
    plot.set_ylim(0.8, 1.2)
    low, high = plot.dataLim.intervaly
    plot.set_ylim(min(0.8, low - 0.05), max(1.2, high + 0.05))


def _fitted(found: Identification, masks: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the reduction of variance of some groups of whitened residuals by the fit; each group is (n, 3) booleans.

    Residuals have covariance 1 − F Fᵀ, with F from the estimate's own derivatives.

    Returns:
        (groups,) 1ᵀ F Fᵀ 1, by which the variance of a group's sum is reduced; and the trace, by which the expected sum of squares is.
    """
    solution = found.solution
    by_direction = solution.spectrum.scale[:, None] * solution.basis / np.sqrt(solution.stiffness)
    total, trace = np.zeros((len(masks), by_direction.shape[1])), np.zeros(len(masks))
    for piece in found.network.chunks(solution.theta, solution.setup):
        excluded = piece.jacobian @ by_direction
        for i, mask in enumerate(masks):
            of = excluded[mask[piece.rows]]
            total[i] += of.sum(axis=0)
            trace[i] += np.sum(of**2)
    return np.sum(total**2, axis=1), trace


def _moving(positions: np.ndarray, axis: int) -> np.ndarray:
    """Return (n,) rows on a line along an axis, the others at rest; all rows if there is no line."""
    _, line = np.unique(np.round(np.delete(positions, axis, axis=1), 3), axis=0, return_inverse=True)
    line = line.reshape(-1)
    lengths = [len(np.unique(np.round(positions[line == k, axis], 3))) for k in range(line.max() + 1)]
    moving = np.isin(line, [k for k, length in enumerate(lengths) if length >= 3])
    return moving if moving.any() else np.ones(len(positions), dtype=bool)


def _inverse_root(covariance: np.ndarray) -> np.ndarray:
    """Return (r, p) W with W C Wᵀ = 1 on the combinations with variance."""
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-9 * values[-1]
    return np.asarray((vectors[:, keep] / np.sqrt(values[keep])).T)


# --- An identification as one HTML file: verdict, errors with intervals, residuals and curves. Needs the extra ``plots``


def identification_html(found: Identification) -> str:
    """Return one self-contained HTML page.

    Args:
        found: the result of `twin.identify`.
    """
    calibration = found.calibration
    machine = calibration.machine.name
    axes = list(dict.fromkeys(split_name(name)[2] for name in calibration.curves))
    return render(
        "identification/templates/identification.html.j2",
        title=f"Identification of {machine}",
        machine=machine,
        source=", ".join(Path(name).name for name in found.data.source.split(", ")),
        points=count_with_noun(int(found.used.sum()), "point"),
        badges=warning_texts(calibration.warnings),
        card=found.display().html(),
        residuals=embedded(plot_residuals(found), "Residuals over the readings and over each axis", kind="big"),
        axes=axes,
        motions=lambda axis: embedded(
            plot_motions(found, axis), f"Error motions of axis {axis} with their 95 % intervals", kind="big"
        ),
        orders=embedded(plot_orders(found), "Prediction error by the number of functions", kind="big")
        if found.choice.uniform
        else "",
    )
