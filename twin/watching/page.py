"""The watch as one HTML file: verdict, history of every error, temperatures, checks. Needs the extra ``plots``."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from twin._common.provenance import warning_texts
from twin.display import Html, readable, render
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, embedded, new_figure, plot_markers, style_axes
from twin.watching.change import WatchedError
from twin.watching.check import Check
from twin.watching.result import Watch
from twin.watching.words import (
    HEADS,
    calibration_sentences,
    error_in_words,
    headline,
    rate_sentences,
    rows_of,
    sentences,
    unseen,
)

COLOURS: Final = {"alarm": "#fbe4de", "doubt": "#fdf3d8", "none": "#e8f3ea"}
MOST_ERRORS: Final = 24
"""Number of errors that are drawn; the table lists all."""
BAND: Final = 3.0
"""Half width of the band about the level, in standard deviations of one check."""
PANEL: Final = 1.35
"""Height of a panel, inches."""
MOST_COLUMNS: Final = 6
"""Columns of the legend of the temperatures."""
WIDTH: Final = 10.0
ORDER: Final = ("changed", "undecided", "follows temperature", "steady")
SENSOR_COLOURS: Final = (FORWARD, BACKWARD, THIRD, BOTH, RUN)


def watch_html(watch: Watch) -> str:
    """Return one self-contained HTML page.

    Args:
        watch: the result of `twin.watch`.
    """
    state = "alarm" if not watch.met else "doubt" if watch.tolerance_mm is not None and watch.good is None else "none"
    drawn = sorted(watch.errors, key=lambda one: ORDER.index(one.verdict))[:MOST_ERRORS]
    return render(
        "watching/templates/watch.html.j2",
        watch=watch,
        title=f"{headline(watch)}: {watch.machine}",
        headline=headline(watch),
        colour=COLOURS[state],
        sentences=sentences(watch),
        judged=bool(calibration_sentences(watch)),
        badges=warning_texts(watch.warnings),
        picture=embedded(history(watch, drawn), "History of the errors and temperatures", kind="big")
        if drawn
        else Html(""),
        not_drawn=len(watch.errors) - len(drawn),
        heads=HEADS,
        rows=rows_of(watch),
        unseen=unseen(watch),
        notes=rate_sentences(watch),
        band=BAND,
        said=[(one.said_at, one.checks, one.text.splitlines()[0]) for one in reversed(watch.statements)],
        chi2=lambda check: f"{check.reduced_chi2:.2g}" if np.isfinite(check.reduced_chi2) else "",
    )


def history(watch: Watch, findings: list[WatchedError]) -> Figure:
    """Plot the deviations of errors over the dates, the evidence of a change beside them, and the temperatures below.

    Args:
        watch: the result.
        findings: the errors to be drawn.
    """
    sensors = list(dict.fromkeys(name for check in watch.checks for name in check.temperature_degC))
    rows = len(findings) + bool(sensors)
    figure = new_figure(WIDTH, PANEL * rows + 0.7)
    grid = figure.subplots(rows, 2, sharex=True, squeeze=False, gridspec_kw={"width_ratios": (2.3, 1.0)})
    for (left, right), one in zip(grid, findings, strict=False):
        _deviations(left, one)
        _evidence(right, one, watch.limit)
    grid[0, 0].set_title("deviation from the calibration", loc="left", fontweight="bold", fontsize=10)
    grid[0, 1].set_title("evidence of a change (log10)", loc="left", fontweight="bold", fontsize=10)
    if sensors:
        _temperatures(grid[-1, 0], watch.checks, sensors)
        grid[-1, 1].set_visible(False)
        grid[-2, 1].tick_params(labelbottom=True)
    for column, most in ((0, 7), (1, 3)):
        for plot in grid[:, column]:
            locator = AutoDateLocator(minticks=2, maxticks=most)  # type: ignore[no-untyped-call]
            plot.xaxis.set_major_locator(locator)
            plot.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    figure.align_ylabels(list(grid[:, 0]))
    return figure


def _deviations(plot: Axes, found: WatchedError) -> None:
    """Plot the deviations of one error with the band of a check, and its change."""
    series, dates = found.series, found.series.days  # matplotlib counts days since 1970 too
    style_axes(plot)
    colour = BACKWARD if found.alarming else THIRD if found.verdict == "follows temperature" else FORWARD
    change, half = found.change, BAND * found.repeatability
    parts = [slice(None)]
    if found.alarming and change is not None and change.shape == "step":
        parts = [slice(change.after + 1), slice(change.after + 1, None)]
    for part in parts:
        if np.isfinite(half):
            low, high = found.fitted[part] - half, found.fitted[part] + half
            plot.fill_between(dates[part], low, high, color=RUN, alpha=0.18, linewidth=0)
        plot.plot(dates[part], found.fitted[part], color=RUN, linewidth=1.0)
    if found.alarming and change is not None:
        plot.axvspan(change.earliest_day, change.latest_day, color=BACKWARD, alpha=0.25, linewidth=0)
    plot_markers(plot, dates, series.value, colour, size=4.0)
    if found.alarm is not None and found.alarming:
        at = found.alarm
        plot_markers(
            plot, dates[at : at + 1], series.value[at : at + 1], BACKWARD, marker="o", size=10.0, fillstyle="none"
        )
    plot.set_ylabel(f"{series.name}\n[{readable(series.unit)}]", fontsize=9)
    label = f"{error_in_words(series.name)}: {found.verdict}"
    plot.annotate(label, (0.01, 0.95), xycoords="axes fraction", verticalalignment="top", fontsize=8, color=BOTH)
    plot.margins(y=0.25)


def _evidence(plot: Axes, found: WatchedError, limit: float) -> None:
    """Plot the evidence of a change, with and without temperature as a possible cause, and the alarm limit."""
    dates, scale = found.series.days, 1.0 / np.log(10.0)
    style_axes(plot)
    plot.plot(dates, found.log_evidence * scale, color=BOTH, linewidth=1.2, marker=".", markersize=3)
    if np.isfinite(found.log_evidence_apart).all():
        plot.plot(dates, found.log_evidence_apart * scale, color=FORWARD, linewidth=1.2, linestyle="--")
    plot.axhline(limit * scale, color=BACKWARD, linewidth=1.0, linestyle=":")
    plot.set_ylim(
        min(-1.0, float(found.log_evidence.min()) * scale),
        max(1.3 * limit, 1.1 * float(found.log_evidence.max())) * scale,
    )


def _temperatures(plot: Axes, checks: tuple[Check, ...], sensors: list[str]) -> None:
    dates = np.array([check.day for check in checks])
    style_axes(plot)
    for i, name in enumerate(sensors):
        values = [check.temperature_degC.get(name, np.nan) for check in checks]
        plot.plot(
            dates, values, color=SENSOR_COLOURS[i % len(SENSOR_COLOURS)], marker=".", linewidth=1.0, label=f"T_{name}"
        )
    plot.set_ylabel("temperature\n[°C]", fontsize=9)
    plot.legend(loc="upper left", frameon=False, fontsize=8, ncols=min(len(sensors), MOST_COLUMNS))
    plot.margins(y=0.15 + 0.2 * -(-len(sensors) // MOST_COLUMNS))
