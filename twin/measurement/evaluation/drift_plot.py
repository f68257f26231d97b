"""Plot of displacements over time (ISO 230-3). It needs the extra ``plots`` (matplotlib)."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.display import readable
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, new_figure, style_axes
from twin.measurement.evaluation.drift import DriftSeries

SERIES: Final = (FORWARD, BACKWARD, THIRD, BOTH, "#cc79a7", "#e69f00", "#56b4e9", RUN)
STYLES: Final = ("-", "--", ":", "-.")
HOUR: Final = 3600.0
LEGEND_ROWS: Final = 8


def plot_drift(result: DriftSeries, *, title: str = "") -> Figure:
    """Plot displacements and tilts over time, with temperatures and spindle speed below.

    Args:
        result: the test; further target positions have dashed lines.
        title: heading.
    """
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
        plot.set_ylabel("temperature [°C]")
    if speed is not None:
        plot = next(rest)
        plot.plot(hours, speed, color=BOTH, linewidth=1.0)
        plot.set_ylabel("speed [rpm]")
    for plot in plots:
        _finish(plot, result)
    plots[0].set_title(title, loc="left", fontweight="bold")
    plots[-1].set_xlabel("time [h]")
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
                label=name if len(result.targets) == 1 else f"{name}, target {target}",
            )
    plot.set_ylabel(f"{'tilt' if unit == 'urad' else 'displacement'} [{readable(unit)}]")


def _finish(plot: Axes, result: DriftSeries) -> None:
    """Add grid, legend, and lines where the spindle started and stopped."""
    style_axes(plot)
    handles = plot.get_legend_handles_labels()[0]
    if handles:
        columns = 1 + (len(handles) - 1) // LEGEND_ROWS
        plot.legend(loc="upper left", frameon=False, fontsize=8, bbox_to_anchor=(1.01, 1.0), ncols=columns)
    for at in result.running_s or ():
        plot.axvline((at - result.time_s[0]) / HOUR, color=RUN, linewidth=0.8)
