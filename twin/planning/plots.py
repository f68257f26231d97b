"""Pictures of a plan: from where it measures what, and how well every error will be known. Needs the extra ``plots``.

Every function returns a `Figure` of its own, as those of `twin.measurement.evaluation.plots`, whose colours they share; markers tell
apart what colours do.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from twin._common.errors import InputError
from twin.identification.result import Identification
from twin.machine.calibration import Calibration
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.measurement.evaluation.plots import BACKWARD, BOTH, FORWARD, RUN, THIRD
from twin.measurement.observation import Observation
from twin.measurement.table import Measurements
from twin.planning.forecast import Forecast

STYLES: Final = ((BACKWARD, "s"), (FORWARD, "o"), (THIRD, "^"))
"""Colour and marker of each plan, in the order given."""
VIEWS: Final = ((0, 1, "from above", "x", "y"), (0, 2, "from the front", "x", "z"))
PANELS: Final = ((3, "µm"), (6, "µrad"))
PLAIN: Final = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
"""Of ticks on a logarithmic axis: 1, 2, 5 and their tens."""


def plot_places(table: Measurements, machine: Machine, *, title: str = "") -> Figure:
    """Where reflectors are read and stations stand, in the base frame: from above and from the front.

    Args:
        table: a plan that says where its stations and targets are.
        machine: the machine.
        title: a heading.

    Raises:
        InputError: a plan that does not say.
    """
    if not (np.isfinite(table.place_mm).all() and np.isfinite(table.station_pose).all()):
        raise InputError(
            "no picture of places that nobody knows", expected="place_… and station_… in every row", file=table.source
        )
    points = Observation(machine).points_mm(Calibration.zero(machine), table, table.place_mm)
    figure = _figure(6.2, title or "Where the plan measures")
    for plot, (i, j, view, across, up) in zip(figure.subplots(1, 2), VIEWS, strict=True):
        for name in dict.fromkeys(table.station):
            rows = table.station == name
            eye = table.station_pose[rows][0]
            for point in points[rows]:
                plot.plot([eye[i], point[i]], [eye[j], point[j]], color=RUN, linewidth=0.3, alpha=0.5, zorder=1)
            plot.plot(eye[i], eye[j], color=BOTH, marker="D", markersize=8, linestyle="", zorder=4)
            count = np.count_nonzero(rows)
            plot.annotate(
                f"{name}: {count} readings", (eye[i], eye[j]), textcoords="offset points", xytext=(8, 8), fontsize=9
            )
        for side, colour, marker in (("tool", FORWARD, "o"), ("work", BACKWARD, "s")):
            of = table.carrier == side
            if np.any(of):
                style = {"color": colour, "marker": marker, "markersize": 3.5, "linestyle": "", "zorder": 3}
                plot.plot(points[of, i], points[of, j], label=f"reflectors on the {side} side", **style)
        plot.set_aspect("equal", adjustable="datalim")
        plot.margins(0.12)
        plot.set_xlabel(f"{across} [mm]")
        plot.set_ylabel(f"{up} [mm]")
        plot.set_title(view, loc="left", fontsize=10)
        _grid(plot)
    figure.axes[0].legend(loc="upper left", fontsize=9, frameon=True)
    return figure


def plot_uncertainties(
    foretold: Mapping[str, Forecast], found: Mapping[str, Identification] | None = None, *, title: str = ""
) -> Figure:
    """Standard uncertainty of every error, side by side for a few plans: open as foretold, filled as an identification states it.

    Args:
        foretold: what plans will tell, by a name for each: three at most.
        found: what was identified from them, by the same names.
        title: a heading.

    Raises:
        InputError: none, or more than can be told apart.
    """
    if not 1 <= len(foretold) <= len(STYLES):
        raise InputError("too many plans for one picture", expected=f"1 to {len(STYLES)}", value=len(foretold))
    every = list(dict.fromkeys(name for one in foretold.values() for name in one.errors))
    figure = _figure(5.8, title or "How well every error is known (of a curve, where it is known worst)")
    below = 0
    for plot, (limit, unit) in zip(figure.subplots(2, 1), PANELS, strict=True):
        names = [name for name in every if below <= split_name(name)[0] < limit]
        below = limit
        at = {name: k for k, name in enumerate(names)}
        for (label, one), (colour, marker) in zip(foretold.items(), STYLES, strict=False):
            series = [(one.errors, "foretold", {"markerfacecolor": "white", "markersize": 7})]
            if found is not None and label in found:
                series.append((_stated(found[label]), "identified", {"markersize": 4}))
            for values, kind, style in series:
                x = [at[name] for name in names if name in values]
                y = [values[name] for name in names if name in values]
                plot.plot(x, y, color=colour, marker=marker, linestyle="", label=f"{label}: {kind}", **style)
        plot.set_yscale("log")
        plot.yaxis.set_major_formatter(PLAIN)
        plot.yaxis.set_minor_formatter(PLAIN)
        plot.set_xticks(range(len(names)), names, rotation=60, fontsize=8)
        plot.set_ylabel(f"standard uncertainty [{unit}]")
        _grid(plot, which="both", axis="y")
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside lower center", fontsize=9, ncols=2 * len(foretold)
    )
    return figure


def _figure(height: float, title: str) -> Figure:
    figure = Figure(figsize=(12.0, height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, horizontalalignment="left", fontweight="bold")
    return figure


def _grid(plot: Axes, **lines: Any) -> None:
    plot.grid(color="#dddddd", linewidth=0.6, **lines)
    plot.set_axisbelow(True)
    plot.spines[["top", "right"]].set_visible(False)


def _stated(found: Identification) -> dict[str, float]:
    """Standard uncertainty by name, µm or µrad: of a curve the largest over its range."""
    return {str(row["name"]): float(row["u_max"] if "u_max" in row else row["u"]) for row in found.rows()}
