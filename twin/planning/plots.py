"""Pictures of a plan: from where it measures what, and how well every error will be known. Needs the extra ``plots``.

Every function returns a `Figure` of its own, as those of `twin.measurement.evaluation.plots`, whose colours they share; markers tell
apart what colours do.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
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
    figure = Figure(figsize=(12.0, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
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
                plot.plot(
                    points[of, i],
                    points[of, j],
                    color=colour,
                    marker=marker,
                    markersize=3.5,
                    linestyle="",
                    label=f"reflectors on the {side} side",
                    zorder=3,
                )
        plot.set_aspect("equal", adjustable="datalim")
        plot.margins(0.12)
        plot.set_xlabel(f"{across} [mm]")
        plot.set_ylabel(f"{up} [mm]")
        plot.set_title(view, loc="left", fontsize=10)
        plot.grid(color="#dddddd", linewidth=0.6)
        plot.set_axisbelow(True)
        plot.spines[["top", "right"]].set_visible(False)
    figure.axes[0].legend(loc="upper left", fontsize=9, frameon=True)
    figure.suptitle(title or "Where the plan measures", x=0.01, horizontalalignment="left", fontweight="bold")
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
    figure = Figure(figsize=(12.0, 5.8), layout="constrained")
    FigureCanvasAgg(figure)
    below = 0
    for plot, (limit, unit) in zip(figure.subplots(2, 1), PANELS, strict=True):
        names = [name for name in every if below <= split_name(name)[0] < limit]
        below = limit
        at = {name: k for k, name in enumerate(names)}
        for (label, one), (colour, marker) in zip(foretold.items(), STYLES, strict=False):
            mine = [name for name in names if name in one.errors]
            plot.plot(
                [at[name] for name in mine],
                [one.errors[name] for name in mine],
                color=colour,
                marker=marker,
                markerfacecolor="white",
                markersize=7,
                linestyle="",
                label=f"{label}: foretold",
            )
            if found is not None and label in found:
                stated = _stated(found[label])
                mine = [name for name in names if name in stated]
                plot.plot(
                    [at[name] for name in mine],
                    [stated[name] for name in mine],
                    color=colour,
                    marker=marker,
                    markersize=4,
                    linestyle="",
                    label=f"{label}: identified",
                )
        plot.set_yscale("log")
        plot.yaxis.set_major_formatter(PLAIN)
        plot.yaxis.set_minor_formatter(PLAIN)
        plot.set_xticks(range(len(names)), names, rotation=60, fontsize=8)
        plot.set_ylabel(f"standard uncertainty [{unit}]")
        plot.grid(color="#dddddd", linewidth=0.6, which="both", axis="y")
        plot.set_axisbelow(True)
        plot.spines[["top", "right"]].set_visible(False)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside lower center", fontsize=9, ncols=2 * len(foretold)
    )
    figure.suptitle(
        title or "How well every error is known (of a curve, where it is known worst)",
        x=0.01,
        horizontalalignment="left",
        fontweight="bold",
    )
    return figure


def _stated(found: Identification) -> dict[str, float]:
    """Standard uncertainty by name, µm or µrad: of a curve the largest over its range."""
    return {str(row["name"]): float(row["u_max"] if "u_max" in row else row["u"]) for row in found.rows()}
