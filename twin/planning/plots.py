"""Plots of a plan: stations and reflectors, and the predicted uncertainty of every error. Needs the extra ``plots``.

Every function returns a new `Figure` in the colours of `twin.display.figures`; every colour also has its own marker.

Examples:
    >>> machine = twin.Machine.load("dmu50")
    >>> twin.planning_plots.plot_places(twin.thesis_plan.plan(machine), machine).savefig("places.png")
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from twin._common.errors import InputError
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, heading, new_figure, plot_markers, style_axes
from twin.identification.result import Identification
from twin.machine.machine import Machine
from twin.measurement.observation import Observation
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import split_name
from twin.planning.plan import Forecast

STYLES: Final = ((BACKWARD, "s"), (FORWARD, "o"), (THIRD, "^"))
"""Colour and marker of each plan, in the order given."""
VIEWS: Final = ((0, 1, "from above"), (0, 2, "from the front"))
SIDES: Final = (("tool", FORWARD, "o"), ("work", BACKWARD, "s"))
PANELS: Final = ((3, "µm"), (6, "µrad"))
PLAIN: Final = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
"""Tick labels of a logarithmic axis: 1, 2, 5 times powers of ten."""


def plot_places(table: Measurements, machine: Machine, *, title: str = "") -> Figure:
    """Plot stations and reflector positions in the base frame, from above and from the front.

    Args:
        table: a plan with the poses of its stations and the positions of its targets.
        title: heading of the figure.

    Raises:
        InputError: poses of stations or positions of targets are missing.
    """
    if not (np.isfinite(table.place_mm).all() and np.isfinite(table.station_pose).all()):
        raise InputError(
            "positions of stations or targets are missing",
            expected="place_… and station_… in every row",
            file=table.source,
        )
    points = Observation(machine).points_mm(Calibration.zero(machine), table, table.place_mm)
    figure = new_figure(12.0, 6.2)
    for plot, (i, j, view) in zip(figure.subplots(1, 2), VIEWS, strict=True):
        for name in dict.fromkeys(table.station):
            rows = table.station == name
            eye = table.station_pose[rows][0][[i, j]]
            for point in points[rows][:, [i, j]]:
                plot.plot(*np.stack([eye, point]).T, color=RUN, linewidth=0.3, alpha=0.5, zorder=1)
            plot_markers(plot, eye[0], eye[1], BOTH, "D", 8, zorder=4)
            words = f"{name}: {np.count_nonzero(rows)} readings"
            plot.annotate(words, eye, textcoords="offset points", xytext=(8, 8), fontsize=9)
        for side, colour, marker in SIDES:
            of = table.carrier == side
            if np.any(of):
                label = f"reflectors on the {side} side"
                plot_markers(plot, points[of, i], points[of, j], colour, marker, 3.5, label=label, zorder=3)
        plot.set_aspect("equal", adjustable="datalim")
        plot.margins(0.12)
        plot.set(xlabel=f"{'xyz'[i]} [mm]", ylabel=f"{'xyz'[j]} [mm]")
        plot.set_title(view, loc="left", fontsize=10)
        style_axes(plot)
    figure.axes[0].legend(loc="upper left", fontsize=9, frameon=True)
    heading(figure, title or "Stations and reflectors of the plan")
    return figure


def plot_uncertainties(
    forecasts: Mapping[str, Forecast], found: Mapping[str, Identification] | None = None, *, title: str = ""
) -> Figure:
    """Plot the standard uncertainty of every error for up to three plans: open markers predicted, filled markers identified.

    Args:
        forecasts: forecasts by the name of the plan.
        found: identifications from the measured plans, by the same names.
        title: heading of the figure.

    Raises:
        InputError: no forecast, or more than three.
    """
    if not 1 <= len(forecasts) <= len(STYLES):
        raise InputError("number of plans for one figure", expected=f"1 to {len(STYLES)}", value=len(forecasts))
    every = list(dict.fromkeys(name for forecast in forecasts.values() for name in forecast.errors))
    figure = new_figure(12.0, 5.8)
    below = 0
    for plot, (limit, unit) in zip(figure.subplots(2, 1), PANELS, strict=True):
        names = [name for name in every if below <= split_name(name)[0] < limit]
        below = limit
        for (label, one), (colour, marker) in zip(forecasts.items(), STYLES, strict=False):
            style = {"markerfacecolor": "white", "label": f"{label}: predicted"}
            _marks(plot, names, one.errors, colour, marker, 7, **style)
            if found is not None and label in found:
                _marks(plot, names, _stated(found[label]), colour, marker, 4, label=f"{label}: identified")
        plot.set_yscale("log")
        plot.yaxis.set_major_formatter(PLAIN)
        plot.yaxis.set_minor_formatter(PLAIN)
        plot.set_xticks(range(len(names)), names, rotation=60, fontsize=8)
        plot.set_ylabel(f"standard uncertainty [{unit}]")
        plot.grid(color="#dddddd", linewidth=0.6, which="both", axis="y")
        plot.set_axisbelow(True)
        plot.spines[["top", "right"]].set_visible(False)
    legend: dict[str, Any] = {"loc": "outside lower center", "fontsize": 9, "ncols": 2 * len(forecasts)}
    figure.legend(*figure.axes[0].get_legend_handles_labels(), **legend)
    heading(figure, title or "Standard uncertainty of every error (for a curve the largest over its range)")
    return figure


def _marks(
    plot: Axes, names: list[str], values: Mapping[str, float], colour: str, marker: str, size: float, **more: Any
) -> None:
    """Draw the value of each name above its tick."""
    known = [(k, values[name]) for k, name in enumerate(names) if name in values]
    plot_markers(plot, [k for k, _ in known], [value for _, value in known], colour, marker, size, **more)


def _stated(found: Identification) -> dict[str, float]:
    """Return the standard uncertainty by name in µm or µrad; of a curve the largest over its range."""
    return {str(row["name"]): float(row["u_max"] if "u_max" in row else row["u"]) for row in found.rows()}
