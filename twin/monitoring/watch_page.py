"""The watch as one HTML file: verdict, history of every error, temperatures, checks. Needs the extra ``plots``."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from twin._common.provenance import warning_texts
from twin._common.units import count_with_noun
from twin.display import Html, figure, place, readable, render, with_half
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD, embedded, new_figure, plot_markers, style_axes
from twin.model.effects import split_name
from twin.model.effects.base import motion_in_words
from twin.monitoring.change import BETTER_LIKELIHOOD_RATIO, TemperatureEffect, WatchedError
from twin.monitoring.check import Check
from twin.monitoring.watched import Watch, date_text

WORDS_WIDTH: Final = 110
FEW_CHECKS: Final = 5
"""Number of checks below which the repeatability is hardly known, so that only large changes are found."""
MOST_NOTICES: Final = 8
SHOWN_CORRELATION: Final = 0.05


def error_in_words(name: str) -> str:
    """Return an error in words: ``E_C0Y`` → squareness of Y; ``E_XX`` → scale of X; ``E_A0B`` → axis of B tilted about x."""
    _, average, axis = split_name(name)
    if not average:
        return f"scale of {axis}"
    return (
        motion_in_words(name)
        if name[4] not in "XYZ"
        else f"squareness of {axis} about {'xyz'[split_name(name)[0] % 3]}"
    )


def headline(watch: Watch) -> str:
    """Return the verdict in one sentence."""
    changed = [alarm for alarm in watch.alarms if alarm.verdict == "changed"]
    if changed:
        names = listed([one.series.name for one in changed])
        first = changed[0].change
        if len(changed) == 1 and first is not None and first.shape == "step":
            days = f"{date_text(first.earliest_day)} and {date_text(first.latest_day)}"
            return f"The machine changed between {days}: {names}"
        return f"The machine changed: {names}"
    if watch.alarms:
        names = listed([alarm.series.name for alarm in watch.alarms])
        if all(less_likely(alarm) for alarm in watch.alarms):
            return f"{names} changed; temperature as the cause is not yet excluded"
        return (
            f"{names} changed or follow{'s' if len(watch.alarms) == 1 else ''} a temperature: these checks cannot tell"
        )
    if watch.good is False:
        return "No error changed, but the calibration is not good enough for the tolerance"
    return "No change of the machine"


def sentences(watch: Watch) -> list[str]:
    """Return the verdict's details: each alarm, what follows a temperature, and the calibration's state."""
    texts = [_alarm(watch, alarm) for alarm in watch.alarms]
    texts += [_following(one) for one in watch.following]
    if not texts:
        first = f"{count_with_noun(len(watch.checks), 'check')} of {count_with_noun(len(watch.errors), 'error')} show no change"
        span = (
            f" from {watch.checks[0].date:%Y-%m-%d} to {watch.checks[-1].date:%Y-%m-%d}"
            if len(watch.checks) > 1
            else ""
        )
        texts = [f"{first}{span}."]
    if len(watch.checks) < FEW_CHECKS:
        texts.append(
            f"With {count_with_noun(len(watch.checks), 'check')} the repeatability is hardly known: only from about "
            f"{FEW_CHECKS} checks on can a change be found."
        )
    return [*texts, *calibration_sentences(watch)]


def _alarm(watch: Watch, found: WatchedError) -> str:
    change, series = found.change, found.series
    if change is None:  # an alarm always has one
        return series.name
    unit, words = readable(series.unit), f"{series.name} ({error_in_words(series.name)})"
    size = with_half(change.size, change.expanded, series.unit)
    if change.shape == "step":
        what = f"{words} changed by {size} between {date_text(change.earliest_day)} and {date_text(change.latest_day)} (95 %)"
    else:
        rate = figure(change.per_month, unit)
        what = (
            f"{words} drifts by {rate} in 30 days since a date between {date_text(change.earliest_day)} and "
            f"{date_text(change.latest_day)} (95 %), {size} until now"
        )
    if not change.sure_shape:
        what += (
            "; a drift is about as likely as a step"
            if change.shape == "step"
            else "; a step is about as likely as a drift"
        )
    if found.verdict == "undecided" and less_likely(found):
        sensor = found.temperatures[0].sensor
        return f"{what}. T_{sensor} as its cause is less likely, but not yet excluded. Check again soon."
    if found.verdict == "undecided":
        sensors = listed([f"T_{temperature.sensor}" for temperature in found.temperatures])
        return (
            f"{what}; or it follows {sensors} with {_coefficient(found.temperatures[0], series.unit)}: time and temperature changed "
            "together. Check again at another temperature."
        )
    if not series.sensors:
        return f"{what}. No check gives a temperature that varies, so a temperature is not excluded as the cause."
    return f"{what}. No single temperature of {listed([f'T_{name}' for name in series.sensors])} explains it."


def less_likely(found: WatchedError) -> bool:
    """Return whether every temperature is a less likely cause of an alarm than a change, by `BETTER_LIKELIHOOD_RATIO`."""
    return all(temperature.log_ratio <= -np.log(BETTER_LIKELIHOOD_RATIO) for temperature in found.temperatures)


def _following(found: WatchedError) -> str:
    first, *others = found.temperatures
    series = found.series
    text = (
        f"{series.name} ({error_in_words(series.name)}) follows T_{first.sensor}, {_coefficient(first, series.unit)}: "
        "an influence of temperature, not a change of the machine"
    )
    if others:
        text += f"; {listed([f'T_{other.sensor}' for other in others])} would explain it about as well"
    return f"{text}."


def _coefficient(effect: TemperatureEffect, unit: str) -> str:
    return with_half(effect.per_kelvin, effect.expanded, f"{unit}/K")


def calibration_sentences(watch: Watch) -> list[str]:
    """Return whether the calibration is still good for the tolerance; nothing if none is given."""
    left = watch.remaining
    if left is None or watch.tolerance_mm is None:
        return []
    limit = figure(watch.tolerance_mm * 1e3, "µm")
    if not left.poses:
        return ["The error at the tool cannot be evaluated: no pose is within reach."]
    most = f"the deviations cause at most {figure(left.max_um, 'µm')} at the tool (at {place(left.where)})"
    if watch.good is True:
        return [
            f"The calibration is still good for {limit}: {most}, and {figure(left.upper_95_um, 'µm')} with their uncertainty (95 %)."
        ]
    if watch.good is False:
        return [
            f"The calibration is no longer good for {limit}: {most}, and no less than {figure(left.lower_95_um, 'µm')} with their "
            "uncertainty (95 %). Measure and identify again."
        ]
    return [
        f"It cannot be decided whether the calibration is still good for {limit}: {most}, with their uncertainty "
        f"{figure(max(left.lower_95_um, 0.0), 'µm')} to {figure(left.upper_95_um, 'µm')} (95 %)."
    ]


def rows_of(watch: Watch) -> list[tuple[str, ...]]:
    """Return the table of errors: error, words, deviation now, repeatability, instrument, verdict."""
    rows: list[tuple[str, ...]] = []
    for error in watch.errors:
        unit = readable(error.series.unit)
        rows.append(
            (
                error.series.name,
                error_in_words(error.series.name),
                figure(error.level, unit),
                figure(error.repeatability, unit),
                figure(float(np.mean(error.series.u)), unit),
                error.verdict,
            )
        )
    return rows


HEADS: Final = ("error", "", "deviation now", "repeatability (1 s)", "instrument (k = 1)", "verdict")


def unseen(watch: Watch) -> list[str]:
    """Return a sentence on the errors that the checks do not determine; nothing if they determine all."""
    if not watch.not_determined:
        return []
    return [f"These checks do not determine: {'; '.join(watch.not_determined)}. A change of them is not seen."]


def rate_sentences(watch: Watch) -> list[str]:
    """Return how the alarm rate is held."""
    rate_sentences = [
        f"An unchanged machine gives an alarm with a probability of at most {watch.alarm_rate * 100:g} %, whatever the number of "
        f"checks and looks; {watch.spent * 100:.2g} % of it belongs to changes until the last check. It is divided over "
        f"{count_with_noun(watch.errors_watched, 'error')} and two tests, one of them with temperatures as a possible cause.",
        "The repeatability is the standard deviation between checks, set-up included, estimated from the checks.",
    ]
    if watch.correlation >= SHOWN_CORRELATION:
        rate_sentences.append(
            f"The deviations are correlated from check to check by {watch.correlation:.1f} (estimated from all errors). This is "
            "allowed for: slow variations are less evidence of a change."
        )
    if watch.remaining is not None:
        rate_sentences.append(
            "The error at the tool contains the deviations of the errors watched, and no other errors."
        )
    return rate_sentences


def watch_text(watch: Watch) -> str:
    """Return the watch as text."""
    lines = [
        f"{watch.machine}: {count_with_noun(len(watch.checks), 'check')} in {watch.folder}, compared with {watch.calibration}",
        *warning_texts(watch.warnings),
        "",
        f"{headline(watch)}."
        if watch.met
        else f"{headline(watch).upper()}."
        if not watch.alarms
        else f"ALARM. {headline(watch)}.",
    ]
    for text in (*sentences(watch), *unseen(watch)):
        lines += wrap(text, WORDS_WIDTH, initial_indent="  ", subsequent_indent="    ")
    lines += ["", f"{'':<9}{'deviation now':>18}{'repeatability':>16}{'instrument':>14}   verdict"]
    for name, words, level, repeatability, u, verdict in rows_of(watch):
        lines.append(f"  {name:<7}{level:>18}{repeatability:>16}{u:>14}   {verdict:<20} {words}")
    lines.append("")
    for text in [*rate_sentences(watch), *(f"note: {notice}" for notice in shortened(watch.notices))]:
        lines += wrap(text, WORDS_WIDTH, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def news_text(watch: Watch) -> str:
    """Return what this look found in the folder."""
    if not watch.news:
        return f"nothing new since {watch.statements[-1].said_at}\n"
    lines = []
    for text in watch.news:
        lines += wrap(text, WORDS_WIDTH, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def shortened(notices: Sequence[str]) -> list[str]:
    """Return the first notices, and the number of the others."""
    rest = len(notices) - MOST_NOTICES
    return [
        *notices[:MOST_NOTICES],
        *([f"and {count_with_noun(rest, 'further notice')}, all in the JSON"] if rest > 0 else []),
    ]


def listed(names: Sequence[str]) -> str:
    """Return names as ``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


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

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> calibration, tracker = twin.Calibration.zero(machine), twin.instruments.LaserTracker()
        >>> plan = twin.thesis_plan.plan(machine)
        >>> along_x = plan.select(plan.approach[:, 0] != 0)
        >>> Path("checks").mkdir()
        >>> for day in range(1, 4):
        ...     data, _ = twin.simulate(along_x, machine, calibration, tracker, np.random.default_rng(day))
        ...     data.save(f"checks/2026-03-0{day}.csv", machine)
        >>> page = twin.watch_html(twin.watch("checks", machine, calibration))
        >>> _ = Path("watch.html").write_text(page, encoding="utf-8")
    """
    state = "alarm" if not watch.met else "doubt" if watch.tolerance_mm is not None and watch.good is None else "none"
    drawn = sorted(watch.errors, key=lambda one: ORDER.index(one.verdict))[:MOST_ERRORS]
    return render(
        "monitoring/templates/watch.html.j2",
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
        said=[
            (statement.said_at, statement.checks, statement.text.splitlines()[0])
            for statement in reversed(watch.statements)
        ],
        chi2=lambda check: f"{check.reduced_chi2:.2g}" if np.isfinite(check.reduced_chi2) else "",
    )


def history(watch: Watch, findings: list[WatchedError]) -> Figure:
    """Plot the deviations of errors over the dates, the evidence of a change beside them, and the temperatures below."""
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
