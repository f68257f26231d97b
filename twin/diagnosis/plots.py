"""Plots of a diagnosis: the residuals, a cause with the readings that show it, the ranking of causes. Needs the extra ``plots``.

Dots are means over groups of readings, with the 95 % interval of the mean from their spread; a line is the fitted cause. Every
function returns a new `Figure` in the colours of `twin.display.figures`; marker shapes repeat the distinction that the colours make.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from twin._common.errors import InputError
from twin._common.messages import Message, joined, say
from twin._common.records import APPROACH
from twin.diagnosis.candidates import SPECIFICATIONS
from twin.diagnosis.result import Cause, DiagnosisResult
from twin.diagnosis.text import cause_title, column, side
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, heading, new_figure, style_axes
from twin.display.numbers import COVERAGE_FACTOR, listed
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.measurement.observation import machine_state
from twin.model.effects import Effect
from twin.model.effects.base import axis_of, motion_in_words
from twin.model.effects.specification import Drawing

MOST_POSITIONS: Final = 24  # number of distinct positions up to which each forms a group
BINS: Final = 16  # number of groups, equally filled, for more positions
LEAST_READINGS: Final = 2  # smallest number of readings whose mean is drawn
ALIKE_CORRELATION: Final = 0.9  # rank correlation of two columns above which only one of them is plotted
LEAST_CHI2_SHARE: Final = 0.2  # columns whose χ² is below this share of that of the clearest column are not plotted
SIDES: Final = (
    (-1.0, Message("moving −")),
    (0.0, Message("unknown")),
    (1.0, Message("moving +")),
)  # names of the approach directions
MAX_PANELS: Final = 3  # largest number of panels of residuals
LEAST_CAUSE_SHARE: Final = 0.02  # share of its largest value below which a cause is not plotted in its unit
MANY_TURNS: Final = 4  # periods in the range from which on a periodic error is plotted over one period
WIDEST_INTERVAL: Final = 4.0  # directions whose intervals are wider than this multiple of the narrowest are not plotted
UNMEASURED_SHARE: Final = 0.02  # share of the largest mean square below which a direction counts as not measured


@final
@dataclass(frozen=True)
class Scale:
    """The horizontal axis of a panel."""

    label: str  # in words with the unit
    values: np.ndarray  # (n,) of each reading
    ticks: tuple[tuple[float, str], ...] = ()  # values with their names, if they are not numbers


@final
@dataclass(frozen=True)
class Series:
    """One set of readings in a panel."""

    name: str  # in the legend
    x: np.ndarray  # (k,)
    y: np.ndarray  # (k,)
    weight: np.ndarray  # (k,) in a mean
    predicted: np.ndarray | None = None  # (k,) by the cause; None for residuals
    smooth: bool = False  # the prediction depends on x alone: it is drawn as a line and not averaged


@final
@dataclass(frozen=True)
class Panel:
    """The contents of one plot."""

    title: str
    x: str  # label, with unit
    y: str  # label, with unit
    series: tuple[Series, ...]
    ticks: tuple[tuple[float, str], ...] = ()  # named values along x
    limit: float | None = None  # smallest half range of y; None for automatic


def residual_panels(diagnosis: DiagnosisResult, *, after: bool = False) -> list[Panel]:
    """Return the residuals against the columns they depend on, clearest first, or against every axis if they depend on none."""
    scales, data = scales_of(diagnosis), diagnosis.data
    before = directed(diagnosis, diagnosis.residual_um)
    values = directed(diagnosis, diagnosis.after_um) if after else before
    panels = []
    axes = [(f"{axis.name}_{axis.unit}", axis.side) for axis in diagnosis.calibration.machine.axes]
    for name, carrier in _clearest_columns(diagnosis, scales)[:MAX_PANELS] or axes:
        rows = data.carrier == carrier if carrier in data.carrier else np.ones(len(data), dtype=bool)
        x = scales[name]
        if np.ptp(x.values[rows]) == 0.0:
            continue
        reach = {label: _reach(x.values[rows], part[rows]) for label, part in before.items()}
        sharpest = min(half for _, half in reach.values())
        shown = [label for label, (_, half) in reach.items() if half <= WIDEST_INTERVAL * sharpest]
        series = tuple(_series(label, x.values[rows], values[label][rows]) for label in shown)
        where = side(carrier) if carrier in data.carrier else Message("all points")
        best = "" if len(shown) == len(values) else Message(", {names} (measured best)", names=listed(shown))
        only = joined("", [" ", shown[0]]) if len(shown) == 1 else ""
        limit = max(reach[label][0] for label in shown)
        title = Message("against {column}, {where}{best}", column=column(name), where=where, best=best)
        panels.append(Panel(title, x.label, Message("residual{only} [µm]", only=only), series, x.ticks, limit))
    return panels


def _clearest_columns(diagnosis: DiagnosisResult, scales: Mapping[str, Scale]) -> list[tuple[str, str]]:
    """Return (column, side) pairs that show the residuals; of correlated columns one, if possible a column of a cause."""
    of_causes = {name for cause in diagnosis.causes for name in _columns_of(diagnosis, cause)}
    unexplained = diagnosis.unexplained
    wanted = [(name, unexplained.carrier) for name in unexplained.depends_on] if unexplained is not None else []
    least = LEAST_CHI2_SHARE * max((trend.explains for trend in diagnosis.trends), default=0.0)
    wanted += [(trend.column, trend.carrier) for trend in diagnosis.trends if trend.explains >= least]
    chosen: list[tuple[str, str]] = []
    for name, carrier in wanted:
        alike = [
            scale for scale in scales if name in scales and (scale == name or _correlated(scales[scale], scales[name]))
        ]
        if alike and not any(other in alike for other, _ in chosen):
            chosen.append((next((other for other in alike if other in of_causes), name), carrier))
    return chosen


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the ranks, starting at one; ties share their mean rank."""
    _, of, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[of])


def _correlated(a: Scale, b: Scale) -> bool:
    """Return whether two columns are rank-correlated so closely that their plots look the same."""
    moved = np.ptp(a.values) > 0.0 and np.ptp(b.values) > 0.0
    return bool(moved and abs(np.corrcoef(_ranks(a.values), _ranks(b.values))[0, 1]) > ALIKE_CORRELATION)


def cause_panels(diagnosis: DiagnosisResult, cause: Cause) -> list[Panel]:
    """Return a cause against the columns it depends on: in its own unit if it is one error motion, else as shifts of the targets."""
    effect = cause.effects[0] if len(cause.effects) == 1 else None
    parts = _single(effect, diagnosis) if effect is not None else None
    if effect is not None and parts is not None:
        return _own_unit(diagnosis, cause, effect, *parts)
    rows = _affected(diagnosis, cause)
    if not np.any(rows):
        return []
    title = cause_title(cause.effect, cause.where)
    if not drawing_of(cause).by_state:
        return [_against_prediction(title, cause.pattern_um[rows], diagnosis.after_um[rows], diagnosis.precision[rows])]
    predicted, residual = directed(diagnosis, cause.pattern_um), directed(diagnosis, diagnosis.after_um)
    x = _scales_of_cause(diagnosis, cause)[0]
    series = tuple(
        _series(name, x.values[rows], (part + residual[name])[rows], part[rows]) for name, part in predicted.items()
    )
    return [Panel(title, x.label, Message("shift of the points [µm]"), series, x.ticks)]


def _affected(diagnosis: DiagnosisResult, cause: Cause) -> np.ndarray:
    """Return (n,) which readings a cause affects, with the others of the same station or target."""
    size = np.linalg.norm(np.nan_to_num(cause.pattern_um), axis=1)
    rows = size > 1e-3 * max(float(size.max(initial=0.0)), 1e-12)
    shared = drawing_of(cause).shared
    if not shared:
        return rows
    names = diagnosis.data.station if shared == "station" else diagnosis.data.target
    return np.isin(names, names[rows])


def _against_prediction(title: str, predicted: np.ndarray, residual: np.ndarray, precision: np.ndarray) -> Panel:
    """Return all measured coordinates against the prediction of the cause."""
    read = np.isfinite(predicted) & np.isfinite(residual)
    x, y = predicted[read], (predicted + residual)[read]
    some = np.abs(x) > LEAST_CAUSE_SHARE * np.abs(x).max(initial=0.0)
    weight = np.einsum("nii->ni", precision)[read][some]
    series = Series("", x[some], y[some], weight, x[some], smooth=True)
    return Panel(title, Message("shift predicted by this cause [µm]"), Message("measured shift [µm]"), (series,))


def scales_of(diagnosis: DiagnosisResult) -> dict[str, Scale]:
    """Return all columns that residuals can be plotted against, by their name in the table."""
    data, machine = diagnosis.data, diagnosis.calibration.machine
    scales = {}
    for i, axis in enumerate(machine.axes):
        unit = "mm" if axis.linear else "°"
        scales[f"{axis.name}_{axis.unit}"] = Scale(f"{axis.name} [{unit}]", np.asarray(data.positions[:, i]))
        if np.any(data.approach[:, i]):
            sides = np.asarray(data.approach[:, i], dtype=float)
            ticks = tuple((at, name) for at, name in SIDES if at != 0.0 or not np.all(sides))
            scales[f"approach_{axis.name}"] = Scale(
                Message("approach direction of {name} [+/−]", name=axis.name), sides, ticks
            )
    if np.all(np.isfinite(data.time_s)):
        since = np.asarray(data.time_s) - float(np.min(data.time_s))
        unit, seconds = ("h", 3600.0) if float(np.ptp(since)) > 7200.0 else ("min", 60.0)
        scales["time_s"] = Scale(Message("time from the first reading [{unit}]", unit=unit), since / seconds)
    rounds = list(dict.fromkeys(data.round))
    names = tuple((float(i), str(name)) for i, name in enumerate(rounds)) if len(rounds) <= 12 else ()
    scales["round"] = Scale(
        Message("round [number]"), np.array([float(rounds.index(name)) for name in data.round]), names
    )
    for name, values in data.temperature_degC.items():
        if np.all(np.isfinite(values)):
            of = Message("{name}'s scale", name=name) if name in machine.names else name
            scales[f"T_{name}_degC"] = Scale(Message("temperature of {of} [°C]", of=of), np.asarray(values))
    for name, values in data.channels.items():
        if np.all(np.isfinite(values)):
            what, _, unit = name.partition("_")
            scales[name] = Scale(f"{what} [{unit.replace('_', '/')}]", np.asarray(values))
    return scales


def _series(name: str, x: np.ndarray, y: np.ndarray, predicted: np.ndarray | None = None) -> Series:
    keep = np.isfinite(y)
    return Series(
        name, x[keep], y[keep], np.ones(np.count_nonzero(keep)), None if predicted is None else predicted[keep]
    )


def directed(diagnosis: DiagnosisResult, values_um: np.ndarray) -> dict[str, np.ndarray]:
    """Return measured coordinates as (n,) shifts by direction of the base, or along the beam if only lengths were measured."""
    read = np.isfinite(values_um)
    values = np.where(read, values_um, 0.0)
    nothing = np.where(read.any(axis=1), 0.0, np.nan)
    base = np.einsum("nij,ni->nj", diagnosis.directions, values)
    along_axes = np.abs(diagnosis.directions[read[:, 0], 0]).max(axis=1, initial=0.0).min(initial=1.0) >= 0.99
    if not (read[:, 1:].any() or along_axes):
        return {ALONG_BEAM: values[:, 0] + nothing}
    square = np.mean(np.einsum("nij->nj", diagnosis.directions**2), axis=0)
    seen = square > UNMEASURED_SHARE * max(float(square.max()), 1e-30)
    return {PLOT_DIRECTIONS[j]: base[:, j] + nothing for j in range(3) if seen[j]}


def _single(effect: Effect, diagnosis: DiagnosisResult) -> tuple[int, np.ndarray] | None:
    """Return the only component of an effect and its (n,) value at each reading; None for several components."""
    machine = diagnosis.calibration.machine
    parts = effect.components(machine_state(diagnosis.data, machine))
    largest = {i: float(np.abs(np.asarray(v, dtype=float)).max(initial=0.0)) for i, v in parts.items()}
    most = max(largest.values(), default=0.0)
    strong = [i for i, size in largest.items() if size > 1e-6 * most]
    if most == 0.0 or len(strong) != 1:
        return None
    return strong[0], np.broadcast_to(np.asarray(parts[strong[0]], dtype=float), len(diagnosis.data))


def _own_unit(
    diagnosis: DiagnosisResult, cause: Cause, effect: Effect, component: int, values: np.ndarray
) -> list[Panel]:
    """Return panels of the error motion itself: its weighted least-squares estimate from each reading, with weights."""
    shift = np.where(np.isfinite(cause.pattern_um), cause.pattern_um, 0.0)
    residual = np.where(np.isfinite(diagnosis.after_um), diagnosis.after_um, 0.0)
    size = np.linalg.norm(shift, axis=1)
    rows = (np.abs(values) > LEAST_CAUSE_SHARE * np.abs(values).max()) & (size > 0.0)
    if not np.any(rows):
        return []
    lever = np.einsum("nij,nj->ni", diagnosis.precision[rows], shift[rows] / values[rows, None])
    weight = np.sum(lever * shift[rows], axis=1) / values[rows]
    read = values[rows] + np.sum(lever * residual[rows], axis=1) / weight
    frame, mark = effect.frame.axis, "0" if effect.frame.role == "location" else ""
    error = f"E_{DIRECTIONS[component]}{mark}{frame}"
    unit = "µm" if component < 3 else "µrad"
    drawn = drawing_of(cause)
    label = (
        Message("shift of the tool side along {direction}", direction=cause.where[0].lower())
        if drawn.of_base
        else joined(", ", [motion_in_words(error), error])
    )
    panels = []
    for x in _scales_of_cause(diagnosis, cause):
        at = x.values[rows]
        if np.ptp(at) == 0.0:
            continue
        series = tuple(
            Series(name, at[of], read[of], weight[of], values[rows][of], not drawn.spread)
            for name, of in ((name, of[rows]) for name, of in _split(diagnosis, cause))
            if np.count_nonzero(of) >= LEAST_READINGS
        )
        panels.append(
            Panel(cause_title(cause.effect, cause.where), x.label, joined("", [label, f" [{unit}]"]), series, x.ticks)
        )
    return panels


def drawing_of(cause: Cause) -> Drawing:
    """Return the drawing options of a cause."""
    return SPECIFICATIONS[cause.effect].drawing


def _split(diagnosis: DiagnosisResult, cause: Cause) -> list[tuple[str, np.ndarray]]:
    """Return the readings in named groups: by approach direction, or by ranges of another axis."""
    data, machine = diagnosis.data, diagnosis.calibration.machine
    by = drawing_of(cause).split(cause.where)
    if by.startswith(APPROACH):
        sides = data.approach[:, machine.names.index(by.removeprefix(APPROACH))]
        return [("moving +", sides > 0), ("moving −", sides < 0)]
    if not by:
        return [("", np.ones(len(data), dtype=bool))]
    q = np.asarray(data.positions[:, machine.names.index(by)])
    low, high = float(q.min()), float(q.max())
    edges = np.linspace(low, high, 4)
    of = np.clip(np.searchsorted(edges, q, side="right") - 1, 0, 2)
    unit = machine.by_name[by].unit
    return [(f"{by} {edges[k]:.0f}…{edges[k + 1]:.0f} {unit}", of == k) for k in range(3)]


def _scales_of_cause(diagnosis: DiagnosisResult, cause: Cause) -> list[Scale]:
    """Return the scales that a cause is plotted against."""
    machine, where, drawn = diagnosis.calibration.machine, cause.where, drawing_of(cause)
    if drawn.size_of:
        return [_derived_scale(diagnosis, where, drawn.size_of)]
    scales = scales_of(diagnosis)
    wanted = () if drawn.columns is None else _named(drawn.columns(where), machine)
    if known := [scales[name] for name in wanted if name in scales]:
        return known
    axes = [name for part in where.split(" ") if (name := axis_of(part)) in machine.by_name]
    if drawn.beyond and axes:
        axes = [*(axis.name for axis in machine.axes if not axis.linear and axis.name != axes[0]), axes[0]]
    scales_shown = [scales[name] for name in _named(dict.fromkeys(axes or machine.names), machine)][:2]
    period = drawn.period({q.name: q.value for q in cause.parameters})
    if period and axes:
        unit = "mm" if machine.by_name[axes[0]].linear else "°"
        whole = scales_shown[0]
        if float(np.ptp(whole.values)) >= MANY_TURNS * period:
            folded = np.mod(whole.values, period)
            whole = Scale(
                Message(
                    "{axis} within its period of {period:.4g} {unit} [{unit}]", axis=axes[0], period=period, unit=unit
                ),
                folded,
            )
        return [whole]
    return scales_shown


def _derived_scale(diagnosis: DiagnosisResult, where: str, size_of: str) -> Scale:
    """Return a scale that is no column of the table: distance from the instrument, or reported less commanded position."""
    if size_of == "distance":
        distance = np.linalg.norm(np.nan_to_num(diagnosis.data.point_mm), axis=1)
        return Scale(Message("distance from the instrument [m]"), 1e-3 * distance)
    machine = diagnosis.calibration.machine
    i = machine.names.index(where)
    off = np.nan_to_num(diagnosis.data.readback[:, i] - diagnosis.data.positions[:, i])
    unit, scale = ("µm", 1e3) if machine.axes[i].linear else ("°", 1.0)
    return Scale(Message("{where}: reported less commanded position [{unit}]", where=where, unit=unit), off * scale)


def _columns_of(diagnosis: DiagnosisResult, cause: Cause) -> list[str]:
    """Return the names of the columns a cause depends on."""
    if also := drawing_of(cause).depends_on(cause.where):
        return _named(also, diagnosis.calibration.machine)
    labels = [scale.label for scale in _scales_of_cause(diagnosis, cause)]
    return [name for name, scale in scales_of(diagnosis).items() if scale.label in labels]


def _named(names: Iterable[str], machine: Machine) -> list[str]:
    """Return names of columns of the table; names of axes get their unit."""
    return [f"{name}_{machine.by_name[name].unit}" if name in machine.by_name else name for name in names]


def group_numbers(x: np.ndarray) -> np.ndarray:
    """Return (n,) group numbers: one group per position, or bins of neighbouring positions."""
    distinct = np.unique(np.round(x, 3))
    if len(distinct) <= MOST_POSITIONS:
        return np.searchsorted(distinct, np.round(x, 3))
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)


def group_means(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, groups: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return by group: mean x, weighted mean y, and half the 95 % interval of that mean from the spread of the readings."""
    count = np.bincount(groups)
    total = np.maximum(np.bincount(groups, weight), 1e-300)
    centre = np.bincount(groups, x) / np.maximum(count, 1)
    mean = np.bincount(groups, weight * y) / total
    spread = np.bincount(groups, weight * (y - mean[groups]) ** 2) / total
    # Effective number of readings of equal weight (Kish).
    effective = total**2 / np.maximum(np.bincount(groups, weight**2), 1e-300)
    half = COVERAGE_FACTOR * np.sqrt(spread / np.maximum(effective - 1.0, 1.0))
    some = count >= LEAST_READINGS
    return centre[some], mean[some], half[some]


def _reach(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the largest distance of means with their intervals from zero, and the median half width of the intervals."""
    keep = np.isfinite(y)
    if np.count_nonzero(keep) < LEAST_READINGS:
        return 0.0, np.inf
    _, mean, half = group_means(x[keep], y[keep], np.ones(np.count_nonzero(keep)), group_numbers(x[keep]))
    return float(np.max(np.abs(mean) + half, initial=0.0)), float(np.median(half)) if len(half) else np.inf


PANELS_IN_A_ROW: Final = 3
TICKS: Final = 6
CELLS: Final = 6  # cells along each side of a map
ALONG_BEAM: Final = Message("along the beam")
PLOT_DIRECTIONS: Final = (
    Message("in x"),
    Message("in y"),
    Message("in z"),
)  # each direction keeps its style, whichever directions are drawn
COLOUR_WITHOUT_READING: Final = "#dddddd"  # colour of cells without a reading; the middle of the colour scale is white
LEGEND_ABOVE: Final[dict[str, Any]] = {
    "fontsize": 8, "frameon": False, "ncols": 3, "loc": "lower left", "bbox_to_anchor": (-0.02, 0.99), "borderaxespad": 0.0,
    "columnspacing": 1.2, "handletextpad": 0.4,
}  # fmt: skip
"""Options of a legend placed above its panel."""
STYLES: Final = ((FORWARD, "o", "-"), (BACKWARD, "s", "--"), (THIRD, "^", "-."))


def plot_residuals(diagnosis: DiagnosisResult, *, after: bool = False, title: str = "") -> Figure:
    """Plot the residuals against the columns that show them most clearly, in the directions of the machine's base.

    Args:
        after: plot the residuals with the causes in the model, on the same scale.
        title: heading; a default if empty.
    """
    about = Message("Residuals with the causes in the model") if after else Message("Residuals")
    return _drawn(residual_panels(diagnosis, after=after), title or about)


def plot_cause(diagnosis: DiagnosisResult, cause: int = 0, *, title: str = "") -> Figure:
    """Plot a fitted cause, and the readings after removing all other causes.

    Args:
        cause: index in `DiagnosisResult.causes`.
        title: heading; a default if empty.

    Raises:
        InputError: no such cause.
    """
    if not 0 <= cause < len(diagnosis.causes):
        raise InputError("no such cause", expected=f"less than {len(diagnosis.causes)}", value=cause)
    chosen = diagnosis.causes[cause]
    return _drawn(
        cause_panels(diagnosis, chosen),
        title or Message("{cause}: fitted (line), measured (dots)", cause=cause_title(chosen.effect, chosen.where)),
    )


def plot_ranking(diagnosis: DiagnosisResult, *, title: str = "") -> Figure:
    """Plot the χ² that each cause tested explains by itself.

    Args:
        title: heading; a default if empty.
    """
    rows = diagnosis.ranking[::-1]
    figure = new_figure(9.0, 0.9 + 0.34 * max(len(rows), 1))
    plot = figure.add_subplot()
    named = {(cause.effect, cause.where) for cause in diagnosis.causes}
    doubted = {key for cause in diagnosis.causes for key in cause.equivalent}
    for colour, of, label in (
        (BACKWARD, named, Message("found")),
        (FORWARD, doubted - named, Message("confounded with a cause found")),
        (RUN, {(effect, where) for effect, where, *_ in rows} - named - doubted, Message("less likely")),
    ):
        at = [i for i, (effect, where, *_) in enumerate(rows) if (effect, where) in of]
        if at:
            plot.barh(at, [rows[i][2] for i in at], color=colour, label=say(label))
    plot.set_yticks(range(len(rows)), [say(cause_title(effect, where)) for effect, where, *_ in rows], fontsize=9)
    plot.set_xlabel(say("χ² explained by this cause alone [1]"))
    plot.spines[["top", "right"]].set_visible(False)
    if rows:
        plot.legend(loc="lower right", frameon=False, fontsize=9)
    heading(figure, title or Message("The best of {tried} causes tested", tried=diagnosis.tried), 11)
    return figure


def plot_unexplained(diagnosis: DiagnosisResult, *, title: str = "") -> Figure | None:
    """Plot the unexplained residuals over the two columns they depend on, in the clearest direction; None for fewer columns.

    Args:
        title: heading; a default if empty.
    """
    unexplained, scales, data = diagnosis.unexplained, scales_of(diagnosis), diagnosis.data
    if unexplained is None:
        return None
    names = [name for name in unexplained.depends_on if name in scales and not scales[name].ticks]
    if len(names) < 2:
        return None
    x, y = scales[names[0]], scales[names[1]]
    rows = np.ones(len(data), dtype=bool)
    if unexplained.carrier in data.carrier:
        rows = data.carrier == unexplained.carrier
    edges = [np.linspace(v.min(), v.max(), CELLS + 1) for v in (x.values[rows], y.values[rows])]
    maps = {}
    for name, values in directed(diagnosis, diagnosis.after_um).items():
        of = rows & np.isfinite(values)
        count, *_ = np.histogram2d(x.values[of], y.values[of], edges)
        total, *_ = np.histogram2d(x.values[of], y.values[of], edges, weights=values[of])
        maps[name] = np.where(count >= LEAST_READINGS, total / np.maximum(count, 1.0), np.nan)
    direction = max(maps, key=lambda name: float(np.nansum(maps[name] ** 2)))
    figure = new_figure(4.2, 3.1)
    plot = figure.add_subplot()
    most = float(np.nanmax(np.abs(maps[direction]), initial=1e-9))
    plot.set_facecolor(COLOUR_WITHOUT_READING)
    mesh = plot.pcolormesh(edges[0], edges[1], maps[direction].T, cmap="PuOr", vmin=-most, vmax=most)
    figure.colorbar(mesh, label=say("mean residual {direction} [µm]", direction=direction))
    plot.set(xlabel=say(x.label), ylabel=say(y.label))
    if title:
        heading(figure, title, 11)
    return figure


def plot_panel(panel: Panel) -> Figure:
    """Plot one panel as a figure without a title."""
    figure = new_figure(4.2, 3.1)
    draw(figure.add_subplot(), panel, titled=False)
    return figure


def draw(plot: Axes, panel: Panel, *, titled: bool = True) -> None:
    """Draw a panel on existing axes."""
    style_axes(plot)
    plot.axhline(0.0, color=RUN, linewidth=0.8)
    entries = [entry for k in range(len(panel.series)) for entry in _draw_series(plot, panel, k)]
    if panel.ticks:
        plot.set_xticks([at for at, _ in panel.ticks], [say(name) for _, name in panel.ticks])
        plot.margins(x=0.25)
    else:
        plot.xaxis.set_major_locator(MaxNLocator(TICKS))
    if panel.limit is not None:
        low, high = plot.get_ylim()
        plot.set_ylim(min(low, -panel.limit), max(high, panel.limit))
    if len(entries) > 1:
        plot.legend(*zip(*entries, strict=True), **LEGEND_ABOVE)
    if titled:
        plot.set_title(say(panel.title), loc="left", fontsize=9, pad=20.0 if len(entries) > 1 else 6.0)
    plot.set(xlabel=say(panel.x), ylabel=say(panel.y))


def _draw_series(plot: Axes, panel: Panel, k: int) -> list[tuple[Any, str]]:
    """Draw the k-th series of a panel and return its entries in the legend; the cause has an entry only if the series is single."""
    series, count = panel.series[k], len(panel.series)
    lone = count == 1 and series.predicted is not None
    colour, marker, style = STYLES[
        PLOT_DIRECTIONS.index(series.name) if series.name in PLOT_DIRECTIONS else k % len(STYLES)
    ]
    groups = group_numbers(series.x)
    centre, mean, half = group_means(series.x, series.y, series.weight, groups)
    # Shifted, so that the series do not hide each other.
    offset = 0.0 if lone else 0.008 * (float(np.ptp(series.x)) or 1.0) * (k - 0.5 * (count - 1))
    looks: dict[str, Any] = {"marker": marker, "markersize": 4.0, "linewidth": 0.0, "elinewidth": 1.0}
    dots = plot.errorbar(centre + offset, mean, half, color=BOTH if lone else colour, **looks)
    if series.predicted is None:
        if not panel.ticks:
            plot.plot(centre + offset, mean, color=colour, linestyle=style, linewidth=0.8, alpha=0.6)
        return [(dots, say(series.name))]
    order = np.argsort(series.x)
    x, predicted = (
        (series.x[order], series.predicted[order])
        if series.smooth
        else group_means(series.x, series.predicted, series.weight, groups)[:2]
    )
    colour, style = (BACKWARD, "-") if lone else (colour, style)
    (line,) = plot.plot(x, predicted, color=colour, linestyle=style, linewidth=2.0, alpha=0.75)
    return [(dots, say("measured")), (line, say("fitted cause"))] if lone else [(dots, say(series.name))]


def _drawn(panels: Sequence[Panel], title: str) -> Figure:
    across = min(max(len(panels), 1), PANELS_IN_A_ROW)
    down = -(-max(len(panels), 1) // across)
    figure = new_figure(max(4.4 * across, 6.4), 3.5 * down + 0.4)
    titled = any(panel.title not in title for panel in panels)
    for k, panel in enumerate(panels):
        draw(figure.add_subplot(down, across, k + 1), panel, titled=titled)
    heading(figure, title, 11)
    return figure
