"""Pictures of an identification. Needs the extra ``plots`` (matplotlib).

Every function returns a `Figure` of its own, as those of `twin.measurement.evaluation.plots`, whose colours and `save` they share.
Colours tell apart for colour-blind readers; line styles and markers do so without colour.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, cast, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from twin._common.distributions import chi2_isf
from twin._common.errors import InputError
from twin._common.units import DEG, TURN
from twin.identification.result import COVERAGE, THESIS_FUNCTIONS, Identification
from twin.identification.thesis.identify import ThesisIdentification
from twin.machine.datum.conditions import turning_patterns
from twin.machine.effects import split_name
from twin.machine.machine import Axis
from twin.machine.motion_curve import Curve
from twin.measurement.evaluation.plots import BACKWARD, BOTH, FORWARD, RUN, SIGNS, THIRD
from twin.uncertainty.at_tool import DEFINITION, UncertaintyMap

FINE: Final = 361
"""Points a curve is drawn with."""
HEADROOM: Final = 1.15
HOLLOW: Final = 2.0
"""Radius of a polar plot's zero, in units of the largest deviation: the circle's size is arbitrary, deviations are not."""
SHADE: Final = 0.22


def plot_motions(
    found: Identification,
    axis: str,
    *,
    thesis: ThesisIdentification | None = None,
    truth: Mapping[str, Curve] | None = None,
    title: str = "",
) -> Figure:
    """The six error motions of one axis with their 95 % intervals: against position; of a rotary axis alone, within a turn, polar.

    Args:
        found: the estimate.
        axis: its name.
        thesis: the thesis's points and curves on the same data, drawn beside it in this estimate's datum: their line, mean or turning
            shift, whatever the datum has no room for, is taken off as fitted to the points, and off the curve likewise. A rotary
            axis's are drawn against its angle, too: they would cross the middle of a polar plot.
        truth: of a simulation, by ISO 230-1 name: drawn dotted, in this estimate's datum.
        title: a heading.

    Raises:
        InputError: an axis without error motions in this estimate.
    """
    machine = found.calibration.machine
    names = [name for name in found.calibration.curves if split_name(name)[2] == axis]
    if not names:
        raise InputError(
            "no error motions of this axis were identified",
            expected=f"one of {', '.join(dict.fromkeys(split_name(name)[2] for name in found.calibration.curves))}",
            value=axis,
        )
    one = machine.by_name[axis]
    half = not one.linear and one.lower is not None
    reach = [found.calibration.curves[name].domain for name in names]
    polar = not one.linear and thesis is None and all(high - low <= TURN + 1e-9 for low, high in reach)
    figure = Figure(figsize=(12.0, (6.4 if half else 8.8) if polar else 7.4), layout="constrained")
    FigureCanvasAgg(figure)
    points = _thesis_points(thesis, one) if thesis is not None else {}
    dotted = _in_datum(truth, one) if truth is not None else {}
    for name in names:
        place = (2, 3, split_name(name)[0] + 1)
        if polar:
            _polar(cast(PolarAxes, figure.add_subplot(*place, projection="polar")), found, name, dotted.get(name))
        else:
            _along(figure.add_subplot(*place), found, name, points.get(name), dotted.get(name))
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
    how = "; angle: command, radius: deviation from the bold circle" if polar else ""
    _heading(figure, title or f"Axis {axis}: error motions with their 95 % intervals{how}")
    return figure


def plot_orders(found: Identification, names: Sequence[str] = (), *, title: str = "") -> Figure:
    """Held-out error against the number of functions: the same for all curves, and for some curves one by one.

    Args:
        found: the estimate.
        names: curves to show one by one; the four whose held-out error suffers most from degree 8 if empty.
        title: a heading.
    """
    choice = found.choice
    shown = list(names) or sorted(choice.by_curve, key=lambda name: -_loss(choice.by_curve[name]))[:4]
    figure = Figure(figsize=(12.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    sizes = sorted(choice.uniform)
    _dress(left)
    left.plot(
        sizes, [choice.uniform[n] for n in sizes], color=FORWARD, marker="o", markersize=4, label="same number for all"
    )
    if THESIS_FUNCTIONS in choice.uniform:
        left.plot(
            THESIS_FUNCTIONS,
            choice.uniform[THESIS_FUNCTIONS],
            color=BACKWARD,
            marker="s",
            markersize=9,
            markerfacecolor="none",
            linestyle="",
            label=f"degree 8 everywhere: {choice.uniform[THESIS_FUNCTIONS]:.3f}",
        )
    left.axhline(choice.held_out, color=THIRD, linestyle="--", label=f"chosen curve by curve: {choice.held_out:.3f}")
    left.axhline(1.0, color=RUN, linewidth=0.8, linestyle=":", label="scatter of the readings alone")
    left.set_yscale("log")
    left.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
    left.minorticks_off()
    left.set_title("all curves alike", loc="left", fontsize=10)
    left.set_ylabel("error of held-out readings, RMS\n[standard deviations of a reading]")
    _dress(right)
    for name, colour, marker, style in zip(
        shown, (FORWARD, BACKWARD, THIRD, BOTH), "osD^", ("-", "--", "-.", ":"), strict=False
    ):
        scores = choice.by_curve[name]
        right.plot(
            list(scores), list(scores.values()), color=colour, marker=marker, markersize=4, linestyle=style, label=name
        )
        count = choice.counts[name]
        right.plot(count, scores[count], color=colour, marker="o", markersize=13, markerfacecolor="none", linestyle="")
    right.axvline(THESIS_FUNCTIONS, color=RUN, linewidth=0.9, linestyle=":", label="degree 8")
    right.plot([], [], color=RUN, marker="o", markersize=11, markerfacecolor="none", linestyle="", label="chosen")
    low = choice.held_out
    high = max(max(value for n, value in choice.by_curve[name].items() if n >= choice.counts[name]) for name in shown)
    right.set_ylim(low - 0.06 * (high - low), high + 0.1 * (high - low))
    right.set_title("one curve at a time, the others as chosen (higher values cut off)", loc="left", fontsize=10)
    right.set_ylabel("error of held-out readings, RMS\n[standard deviations of a reading]")
    for plot in (left, right):
        plot.set_xlabel("functions of a curve, the datum's included (degree + 1)")
        plot.xaxis.set_major_locator(MaxNLocator(integer=True))
        plot.legend(frameon=False, fontsize=9)
    _heading(figure, title or "What predicts readings it has not seen")
    return figure


def plot_residuals(found: Identification, *, title: str = "") -> Figure:
    """What is left, in standard deviations: by axis position, and by station and target.

    Means at each position of a moving axis, and the RMS of each target from each station, should lie in their grey bands in 95 % of
    cases; the bands are narrower than those of so many free readings, because the estimate has fitted itself to these.

    Args:
        found: the estimate.
        title: a heading.
    """
    data, machine = found.data, found.calibration.machine
    moved = [i for i in range(len(machine.axes)) if np.ptp(data.positions[:, i]) > 0.0]
    columns = max(-(-(len(moved) + 1) // 2), 1)
    figure = Figure(figsize=(4.0 * columns, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, columns, squeeze=False).ravel()
    read = found.network.read & found.used[:, None]
    for plot, i in zip(panels, moved, strict=False):
        _dress(plot)
        axis = machine.axes[i]
        at = np.round(data.positions[:, i], 3)
        # An axis at rest stands at one place for most of a plan: only rows of a line along this axis say something about it.
        mine = _moving(data.positions, i)
        for k, (colour, marker) in enumerate(zip((FORWARD, BACKWARD, THIRD), "osD", strict=True)):
            rows = mine & read[:, k]
            width = 0.012 * np.ptp(at[mine])
            plot.plot(
                at[rows] + (k - 1) * width,
                found.whitened[rows, k],
                color=colour,
                marker=marker,
                markersize=2.5,
                linestyle="",
                alpha=0.35,
                label=f"whitened, {'xyz'[k]} of the station",
            )
        places = np.unique(at[mine])
        of = [read & (mine & (at == place))[:, None] for place in places]
        count = np.array([max(np.count_nonzero(one), 1) for one in of])
        mean = np.array([found.whitened[one].sum() for one in of]) / count
        half = COVERAGE * np.sqrt(np.maximum(count - _fitted(found, of)[0], 0.0)) / count
        plot.fill_between(places, -half, half, color=RUN, alpha=0.45, linewidth=0, label="95 % of means")
        plot.plot(places, mean, color=BOTH, marker="o", markersize=4, linewidth=1.0, label="mean")
        plot.set_xlabel(f"{axis.name} [{SIGNS[axis.unit]}]")
        plot.set_ylabel("residual [standard deviations]")
        plot.set_ylim(-4.6, 4.6)
    last = panels[len(moved)]
    _dress(last)
    _by_target(last, found, read)
    for plot in panels[len(moved) + 1 :]:
        plot.set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
    fit = found.misfit
    _heading(
        figure,
        title
        or f"What is left: reduced chi² {fit.reduced:.3f} ({fit.dof:.0f} degrees of freedom, p = {fit.p_value:.2g})",
    )
    return figure


def correlation(found: Identification) -> tuple[tuple[str, ...], np.ndarray]:
    """How far the data tell the reported errors apart: the largest correlation of any part of one with any part of another.

    Of two curves that is their largest canonical correlation (Hotelling 1936), which does not depend on the functions they are written
    in; of two numbers the size of their correlation. From the covariance of the estimate with the scatter of the readings.

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
    """`correlation` as a picture, from white (told apart) to dark (only their combination is known).

    Args:
        found: the estimate.
        title: a heading.
    """
    names, values = correlation(found)
    size = max(5.0, 2.2 + 0.22 * len(names))
    figure = Figure(figsize=(size + 1.0, size), layout="constrained")
    FigureCanvasAgg(figure)
    plot = figure.subplots()
    picture = plot.imshow(values, cmap="Blues", vmin=0.0, vmax=1.0)
    plot.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    plot.set_yticks(range(len(names)), names, fontsize=8)
    group = [(split_name(name)[1], split_name(name)[2]) for name in names]
    for i in range(1, len(names)):
        if group[i] != group[i - 1]:
            plot.axhline(i - 0.5, color=RUN, linewidth=0.8)
            plot.axvline(i - 0.5, color=RUN, linewidth=0.8)
    plot.tick_params(length=0)
    bar = figure.colorbar(picture, ax=plot, shrink=0.8)
    bar.set_label("largest correlation of any part of one with any part of the other")
    _heading(figure, title or "What the data cannot tell apart")
    return figure


def plot_uncertainty(found: UncertaintyMap, horizontal: str, vertical: str, *, title: str = "") -> Figure:
    """U of the tool point over a plane of a grid (`ToolUncertainty.on_grid`), the other axes where the grid has its middle position.

    Args:
        found: the map.
        horizontal: name of the axis drawn to the right.
        vertical: of the one drawn upwards.
        title: a heading.

    Raises:
        InputError: axes that the map does not spread over.
    """
    columns = [found.axes.index(name) for name in (horizontal, vertical) if name in found.axes]
    across, up = (
        (np.unique(found.positions[:, i]) for i in columns) if len(columns) == 2 else (np.zeros(0), np.zeros(0))
    )
    if min(len(across), len(up)) < 2:
        spread = [name for i, name in enumerate(found.axes) if np.ptp(found.positions[:, i]) > 0.0]
        raise InputError(
            "no plane of this map", expected=f"two of {', '.join(spread)}", value=f"{horizontal}, {vertical}"
        )
    rest = {}
    keep = np.ones(len(found.positions), dtype=bool)
    for i, name in enumerate(found.axes):
        if i not in columns:
            there = np.unique(found.positions[:, i])
            rest[name] = float(there[len(there) // 2])
            keep &= found.positions[:, i] == rest[name]
    table = found.positions[keep][:, columns]
    order = np.lexsort((table[:, 0], table[:, 1]))
    values = found.uncertainty.expanded_um[keep][order].reshape(len(up), len(across))
    figure = Figure(figsize=(8.4, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    plot = figure.subplots()
    filled = plot.contourf(across, up, values, levels=10, cmap="cividis")
    lines = plot.contour(filled, levels=np.asarray(filled.levels)[::2], colors="white", linewidths=0.7)
    plot.clabel(lines, fmt="%g", fontsize=8)
    plot.set_xlabel(f"{horizontal} [mm]")
    plot.set_ylabel(f"{vertical} [mm]")
    plot.set_aspect("equal")
    bar = figure.colorbar(filled, ax=plot)
    bar.set_label("U of the tool point [µm]")
    plot.set_title(
        ", ".join(f"{name} {value:g}" for name, value in rest.items()) + f"\n{DEFINITION}", loc="left", fontsize=9
    )
    _heading(figure, title or "Uncertainty of the tool point from the calibration")
    return figure


def _along(
    plot: Axes, found: Identification, name: str, points: _Points | None, dotted: tuple[np.ndarray, np.ndarray] | None
) -> None:
    _dress(plot)
    curve = found.calibration.curves[name]
    q = np.linspace(*curve.domain, FINE)
    value, u = found.interval(name, q)
    plot.fill_between(
        q, value - COVERAGE * u, value + COVERAGE * u, color=FORWARD, alpha=SHADE, linewidth=0, label="95 % interval"
    )
    plot.plot(q, value, color=FORWARD, linewidth=1.8, label="identified")
    if dotted is not None:
        plot.plot(*dotted, color=BOTH, linewidth=1.3, linestyle=":", label="true (simulated)")
    if points is not None:
        plot.errorbar(
            points.at,
            points.value,
            points.deviation,
            color=BACKWARD,
            marker="s",
            markersize=4,
            linestyle="",
            linewidth=0.9,
            capsize=2,
            label="thesis: mean ± s of the rounds",
        )
        plot.plot(points.fine, points.curve, color=BACKWARD, linewidth=1.0, linestyle="--", label="thesis: degree 8")
    plot.axhline(0.0, color=BOTH, linewidth=0.6)
    plot.set_title(name, loc="left", fontweight="bold", fontsize=10)
    axis = found.calibration.machine.by_name[split_name(name)[2]]
    plot.set_xlabel(f"{axis.name} [{SIGNS[axis.unit]}]")
    plot.set_ylabel(f"{name} [{SIGNS[curve.unit]}]")


def _polar(plot: PolarAxes, found: Identification, name: str, dotted: tuple[np.ndarray, np.ndarray] | None) -> None:
    curve = found.calibration.curves[name]
    q = np.linspace(*curve.domain, FINE)
    value, u = found.interval(name, q)
    low, high = value - COVERAGE * u, value + COVERAGE * u
    largest = [np.abs(low).max(), np.abs(high).max()]
    plot.fill_between(q * DEG, low, high, color=FORWARD, alpha=SHADE, linewidth=0, label="95 % interval")
    plot.plot(q * DEG, value, color=FORWARD, linewidth=1.6, label="identified")
    if dotted is not None:
        plot.plot(dotted[0] * DEG, dotted[1], color=BOTH, linewidth=1.3, linestyle=":", label="true (simulated)")
        largest.append(np.abs(dotted[1]).max())
    extent = float(max([*largest, 1e-9]))
    plot.plot(q * DEG, np.zeros(FINE), color=BOTH, linewidth=1.1)
    plot.set_ylim(-HOLLOW * extent, HEADROOM * extent)
    ticks = [tick for tick in MaxNLocator(4, symmetric=True).tick_values(-extent, extent) if abs(tick) <= extent]
    plot.set_yticks(ticks, [""] * len(ticks))
    full = curve.domain[1] - curve.domain[0] > 350.0
    if not full:
        plot.set_thetamin(curve.domain[0])
        plot.set_thetamax(curve.domain[1])
    plot.set_xticks(np.arange(curve.domain[0], curve.domain[1] + (0.0 if full else 1.0), 30.0) * DEG)
    plot.tick_params(labelsize=8)
    plot.grid(color="#cccccc", linewidth=0.5)
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
    for tick in ticks:  # by hand, above the curves
        label = f"{tick:+g}".replace("-", "−") if tick else "0"
        plot.text(
            (105.0 if full else 98.0) * DEG, tick, label, fontsize=7, ha="center", va="center", zorder=6, bbox=paper
        )
    plot.set_title(f"{name} [{SIGNS[curve.unit]}]", loc="left", fontweight="bold", fontsize=10)


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
    """What the datum has no room for is taken off as least squares over the points has it, off the curve likewise."""
    motions = {name: motion for name, motion in thesis.motions.items() if split_name(name)[2] == axis.name}
    taken = _taken(axis, {name: (motion.position, motion.mean) for name, motion in motions.items()})
    found = {}
    for name, motion in motions.items():
        q = motion.position
        fine = np.linspace(q.min(), q.max(), FINE)
        # The curve of a straightness was fitted to what its own line's slope had been taken off.
        slope = np.polyfit(q, motion.mean, 1)[0] if _straightness(axis, name) else 0.0
        curve = thesis.calibration.curves[name](fine) + slope * fine - taken[name](fine)
        found[name] = _Points(q, motion.mean - taken[name](q), motion.deviation, fine, curve)
    return found


def _in_datum(truth: Mapping[str, Curve], axis: Axis) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Positions and values of curves, in the datum of an identification."""
    curves = {name: curve for name, curve in truth.items() if split_name(name)[2] == axis.name}
    lines = {name: (q, curve(q)) for name, curve in curves.items() for q in [np.linspace(*curve.domain, FINE)]}
    taken = _taken(axis, lines)
    return {name: (q, values - taken[name](q)) for name, (q, values) in lines.items()}


def _taken(
    axis: Axis, lines: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """What the datum of `twin.identification.unknowns` has no room for, by least squares over the points.

    A linear axis: the line of a straightness, else the mean. A rotary one: the mean, and of the pairs across the axis what a shift or
    tilt of all that turns with it does.
    """
    found: dict[str, Callable[[np.ndarray], np.ndarray]] = {}
    if axis.linear:
        for name, (q, values) in lines.items():
            found[name] = np.poly1d(np.polyfit(q, values, 1 if _straightness(axis, name) else 0))
        return found
    for letters in ("XYZ", "ABC"):
        names = [f"E_{letter}{axis.name}" for letter in letters]
        present = [name for name in names if name in lines]
        shapes = [
            {name: (lambda q: np.ones(len(q))) if name == one else (lambda q: np.zeros(len(q))) for name in names}
            for one in present
        ]
        shapes += [dict(zip(names, pattern, strict=True)) for pattern in turning_patterns(axis)]
        matrix = [np.stack([shape[name](lines[name][0]) for shape in shapes], axis=1) for name in present]
        if present:
            size, *_ = np.linalg.lstsq(
                np.concatenate(matrix), np.concatenate([lines[n][1] for n in present]), rcond=None
            )
            for name in present:
                parts = [shape[name] for shape in shapes]
                found[name] = partial(_summed, parts, size)
    return found


def _summed(parts: Sequence[Callable[[np.ndarray], np.ndarray]], size: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.asarray(sum(factor * part(q) for factor, part in zip(size, parts, strict=True)))


def _straightness(axis: Axis, name: str) -> bool:
    """Whether an error motion is a translation across a linear axis."""
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
    """What the estimate has taken from some groups of whitened readings, each (n, 3) booleans.

    Residuals have covariance 1 − F Fᵀ, F from the estimate's own derivatives.

    Returns:
        (groups,) 1ᵀ F Fᵀ 1, by which the variance of the sum of a group is less than its count; and the trace, by which that of the
        sum of its squares is.
    """
    solution = found.solution
    by_direction = solution.spectrum.scale[:, None] * solution.basis / np.sqrt(solution.stiffness)
    total, trace = np.zeros((len(masks), by_direction.shape[1])), np.zeros(len(masks))
    for piece in found.network.pieces(solution.theta, solution.setup):
        taken = piece.jacobian @ by_direction
        for i, mask in enumerate(masks):
            of = taken[mask[piece.rows]]
            total[i] += of.sum(axis=0)
            trace[i] += np.sum(of**2)
    return np.sum(total**2, axis=1), trace


def _moving(positions: np.ndarray, axis: int) -> np.ndarray:
    """(n,) rows on a line along an axis, the others standing still; all rows where there is no line."""
    _, line = np.unique(np.round(np.delete(positions, axis, axis=1), 3), axis=0, return_inverse=True)
    line = line.reshape(-1)
    lengths = [len(np.unique(np.round(positions[line == k, axis], 3))) for k in range(line.max() + 1)]
    found = np.isin(line, [k for k, length in enumerate(lengths) if length >= 3])
    return found if found.any() else np.ones(len(positions), dtype=bool)


def _inverse_root(covariance: np.ndarray) -> np.ndarray:
    """(r, p) W with W C Wᵀ = 1 on what varies."""
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-9 * values[-1]
    return np.asarray((vectors[:, keep] / np.sqrt(values[keep])).T)


def _loss(scores: Mapping[int, float]) -> float:
    """What degree 8 costs one curve in held-out error."""
    return scores.get(THESIS_FUNCTIONS, 0.0) - min(scores.values())


def _heading(figure: Figure, text: str) -> None:
    figure.suptitle(text, x=0.01, horizontalalignment="left", fontweight="bold", fontsize=12)


def _dress(plot: Axes) -> None:
    plot.grid(color="#dddddd", linewidth=0.6)
    plot.set_axisbelow(True)
    plot.spines[["top", "right"]].set_visible(False)
