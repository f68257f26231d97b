"""The parts of a machine's report below its first screen, as HTML."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from twin.control import Left
from twin.diagnosis.wording.words import capital, listed, probability
from twin.display.page import bullets, embedded, escaped, facts, table
from twin.numerics.curves import Basis, basis_named
from twin.report.after import Level
from twin.report.contributions import Contribution
from twin.report.field import Slice
from twin.report.motions import Motion
from twin.report.numbers import SIGNS, UNKNOWN, bound, expanded, figure, place, with_half
from twin.report.plots import (
    BARS,
    plot_after,
    plot_budget,
    plot_checked,
    plot_constants,
    plot_field,
    plot_motion,
    plot_slice,
    plot_squareness,
)
from twin.report.readings import Stops
from twin.report.result import MachineReport
from twin.report.scene.field import field_html
from twin.report.scene.path import scale_top_um
from twin.report.words import CLASSES
from twin.uncertainty.at_tool import DEFINITION, NORMAL_95

ROWS: Final = 40
"""Rows set aside that are listed."""
VIEWER: Final = "<!-- the field in 3D -->"
"""Stands for the viewer until the text around it is done."""
AT_TOOL: Final = ("at the tool, RMS [µm]", "largest [µm]", "U [µm]")


def budget_part(report: MachineReport) -> str:
    """What each error makes at the tool."""
    found = report.budget
    if not found.errors:
        return "<p>The calibration names no error.</p>"
    pictures = [
        embedded(
            plot_budget(found.errors, total=found.total),
            f"errors by what they make at the tool: {listed([one.name for one in found.errors])}",
            "By error motion" + (": the largest ones" if len(found.errors) > len(found.errors[:BARS]) else ""),
        ),
        embedded(
            plot_budget(found.classes, total=found.total),
            f"classes by what they make at the tool: {listed([one.name for one in found.classes])}",
            "By class of ISO/TR 16907",
        ),
    ]
    marks = "? uncertainty unknown" + ("; * drawn, not measured" if report.illustrative else "")
    return (
        f"<p>Each error alone, the others taken as zero, over {len(found.positions):,} positions spread over all axes; "
        f"together they do not "
        f"add up: they partly cancel. U is what the error's own uncertainty makes at the tool. {marks}.</p>"
        f'<div class="figures two">{"".join(pictures)}</div>'
        + _classes(found.classes, found.total)
        + "<h3>All of them</h3>"
        + table(
            ["error", "largest value, 95 % interval", *AT_TOOL],
            [_row(one) for one in found.errors],
            numbers=(1, 2, 3, 4),
        )
    )


def _classes(rows: Iterable[Contribution], total: Contribution) -> str:
    cells = [
        (
            f"{escaped(capital(CLASSES.get(one.name, one.name)))} <span class=symbol>{escaped(one.name)}</span>",
            figure(one.rms_um),
            figure(one.max_um),
            bound(one.u_rms_um, complete=one.u_complete),
        )
        for one in (*rows, total)
    ]
    return table(["class", *AT_TOOL], cells, numbers=(1, 2, 3))


def _row(one: Contribution) -> tuple[str, ...]:
    star = " *" if one.illustrative else ""
    return (
        f"{escaped(one.words)} <span class=symbol>{escaped(one.name)}{star}</span>",
        escaped(with_half(one.peak, one.peak_half, SIGNS[one.unit])),
        figure(one.rms_um),
        figure(one.max_um),
        bound(one.u_rms_um, complete=one.u_complete),
    )


def motions_part(report: MachineReport) -> str:
    """Error motions with their intervals and stops."""
    if not report.motions:
        return "<p>The calibration names no error motion: each counts as zero.</p>"
    text = (
        "<p>Line: the calibration. Band: 95 % interval; no band: not known. Rotary axes: angle is the command, the bold "
        "circle is zero, the "
        "radius the deviation."
    )
    if any(motion.ways is not None for motion in report.motions):
        text += " Where it matters from which side an axis comes, both are drawn."
    if report.checked:
        text += (
            " Marks: what the measured points at that position say, all else held, with 95 % intervals from their own "
            "scatter; at points "
            "the calibration was identified from, they show how it fits, not how true it is."
        )
    text += "</p>"
    for axis in dict.fromkeys(motion.axis for motion in report.motions):
        of = [motion for motion in report.motions if motion.axis == axis]
        pictures = "".join(_motion(motion, _stops_of(report, motion.name)) for motion in of)
        sourced = any(motion.source for motion in of)
        text += f"<h3>Axis {escaped(axis)}</h3><div class=figures>{pictures}</div>" + table(
            [
                "error motion",
                "largest",
                "at",
                "95 % interval",
                "degree",
                *(["<span class=source>source</span>"] if sourced else []),
            ],
            [_motion_row(report, motion)[: None if sourced else -1] for motion in of],
            numbers=(1, 2, 3),
        )
    extra = [effect for effect in report.kinematics.calibration.extra]
    if extra:
        rows = []
        shares = {one.name: one for one in report.budget.errors}
        known = report.calibration.covariance
        for effect in extra:
            numbers = []
            for parameter in effect.parameters:
                half = (
                    NORMAL_95 * known.of([parameter.name]).matrix[0, 0] ** 0.5
                    if parameter.name in known.names
                    else np.nan
                )
                unit = SIGNS.get(parameter.unit, parameter.unit)
                numbers.append(f"{parameter.name.rpartition('.')[2]} {with_half(parameter.value, half, unit)}")
            one = shares[effect.name]
            rows.append(
                (
                    f"{escaped(one.words)} <span class=symbol>{escaped(effect.name)}</span>",
                    escaped("; ".join(numbers)),
                    figure(one.rms_um),
                )
            )
        text += "<h3>Effects a diagnosis added</h3>" + table(["effect", "numbers", AT_TOOL[0]], rows, numbers=(2,))
        text += "<p class=small>They are in the curves above wherever they act along an axis's own error motion.</p>"
    return text


def _stops_of(report: MachineReport, name: str) -> tuple[Stops, ...]:
    return tuple(stop for one in report.checked for stop in one.stops.get(name, ()))


def _motion(motion: Motion, stops: tuple[Stops, ...]) -> str:
    peak, at = motion.peak
    unit, position = SIGNS[motion.unit], "mm" if motion.linear else "°"
    interval = "interval unknown" if not np.isfinite(motion.widest) else f"± {figure(motion.widest, unit)} at most"
    star = ", drawn, not measured" if motion.illustrative else ""
    words = f"{motion.name} against {motion.axis}: {figure(peak, unit)} at {at:.0f} {position}, {interval}{star}"
    return embedded(plot_motion(motion, stops), words, f"{motion.words}{' *' if motion.illustrative else ''}")


def _motion_row(report: MachineReport, motion: Motion) -> tuple[str, ...]:
    peak, at = motion.peak
    unit = SIGNS[motion.unit]
    told = None if report.identified is None else report.identified.orders.get(motion.name)
    order = "–" if motion.order is None else str(motion.order)
    if told is not None and not (report.identified is not None and report.identified.others):
        order = str(told)
    noun = basis_named(motion.basis).order_noun if motion.basis else Basis.order_noun
    kind = "" if noun == Basis.order_noun else f"{noun} "
    added = f" + {', '.join(motion.added)}" if motion.added else ""
    half = f"± {figure(motion.widest, unit)}" if np.isfinite(motion.widest) else UNKNOWN
    return (
        f"{escaped(motion.words)} <span class=symbol>{motion.name}{' *' if motion.illustrative else ''}</span>",
        figure(peak, unit),
        f"{at:.0f} {'mm' if motion.linear else '°'}".replace("-", "−"),
        half,
        escaped(f"{kind}{order}{added}"),
        f"<span class=source>{escaped(motion.source)}</span>",
    )


def constants_part(report: MachineReport) -> str:
    """Squareness and locations, in numbers and drawn."""
    found = report.constants
    if not found:
        machine = report.machine
        if not machine.squareness_names and not machine.location_names:
            return "<p>This machine has neither: there is no second linear axis, and none that turns.</p>"
        return "<p>The calibration names neither: both count as zero.</p>"
    squares = "".join(
        embedded(
            plot_squareness(one), f"{one.words}: {with_half(one.value, one.half, 'µrad')}", f"{one.words} ({one.name})"
        )
        for one in found
        if one.travel_mm is not None
    )
    text = ""
    if squares:
        text = f"<div class=squares>{squares}</div><p class=small>Angles drawn much too large, and all alike; dashed: square.</p>"
    text += embedded(plot_constants(found), f"values with intervals: {listed([one.name for one in found])}", "")
    rows = [
        (
            f"{escaped(one.words)} <span class=symbol>{one.name}</span>",
            escaped(with_half(one.value, one.half, SIGNS[one.unit])),
            "" if one.over_travel_um is None else f"{figure(one.over_travel_um, 'µm')} over {one.travel_mm:g} mm",
            figure(one.rms_um),
        )
        for one in found
    ]
    hollow = " Hollow, ?: the interval is not known." if any(not np.isfinite(one.half) for one in found) else ""
    return (
        text
        + f"<p class=small>Dots: values; bars: 95 % intervals.{hollow}</p>"
        + f"<p class=small>{escaped(capital(report.datum))}</p>"
        + table(["", "value, 95 % interval", "at the end of the travel", AT_TOOL[0]], rows, numbers=(1, 2, 3))
    )


def field_part(report: MachineReport) -> str:
    """The field in 3D, and planes of it."""
    if not report.budget.errors:
        return "<p>Nothing to draw: without a named error, the tool is taken to be where it was meant to be.</p>"
    field = report.field
    over = _over(report)
    mean = ", ".join(f"{axis} {figure(float(value), 'µm')}" for axis, value in zip("xyz", field.mean_um, strict=True))
    spread = float(np.sqrt(np.mean(np.sum((field.error_um - field.mean_um) ** 2, axis=1))))
    text = (
        f"<p>Where the tool point really is less where it was meant to be, in the frame of the table, {escaped(over)}: "
        f"{figure(float(np.sqrt(np.mean(field.size_um**2))), 'µm')} RMS, {figure(float(field.size_um.max()), 'µm')} at "
        f"most. The mean is "
        f"{mean}: touching off takes such a constant out, and {figure(spread, 'µm')} RMS stays.</p>"
        f"{VIEWER}"
        + embedded(plot_field(field), f"error field {over}", "").replace("<figure>", "<figure class=paper>", 1)
        + "<p class=small>Arrows: from where the tool should be, the error drawn so many times longer, coloured by its size. "
        "Drag: turn; wheel or "
        "two fingers: zoom.</p>"
    )
    if not field.slices:
        return text + "<p>There are no planes to show: that takes two linear axes.</p>"
    pictures = _planes("error", [(one, one.error_um) for one in field.slices], field.size_um)
    return text + f"<h3>Planes</h3>{pictures}{_grid_note(report)}"


def _planes(what: str, planes: Sequence[tuple[Slice, np.ndarray]], everywhere_um: np.ndarray) -> str:
    """Planes of the volume with one scale, each with its values in µm."""
    top = scale_top_um(float(everywhere_um.max()))
    pictures = "".join(
        embedded(
            plot_slice(one, values, top, f"{what} [µm]"),
            f"{what} over {one.horizontal} and {one.vertical}, {place(one.fixed)}: up to {figure(float(values.max()), 'µm')}",
            place(one.fixed) if one.fixed else f"{one.horizontal} and {one.vertical}",
        )
        for one, values in planes
    )
    return f"<div class=figures>{pictures}</div>"


def _over(report: MachineReport) -> str:
    field = report.field
    stands = f", {place(field.standing)} standing still" if field.standing else ""
    return f"over {listed(list(field.spread))}{stands}"


def viewer(report: MachineReport) -> str:
    """The field to be turned, in a frame of its own."""
    field, rows = report.field, report.field.drawn
    inner = field_html(
        field.point_mm[rows],
        field.error_um[rows],
        title=f"Error of the tool point {_over(report)}",
        edges=field.edges(),
        illustrative=bool(report.illustrative),
    )
    return f'<iframe title="Error field in 3D: drag to turn" srcdoc="{html.escape(inner)}"></iframe>'


def _grid_note(report: MachineReport) -> str:
    steps = ", ".join(
        f"{name} {(high - low) / max(count - 1, 1):.3g} mm"
        for name, count, low, high in zip(
            report.field.spread,
            report.field.counts,
            report.field.positions.min(axis=0)[[report.field.axes.index(name) for name in report.field.spread]],
            report.field.positions.max(axis=0)[[report.field.axes.index(name) for name in report.field.spread]],
            strict=True,
        )
    )
    return (
        f"<p class=small>Size of the error; positions every {steps}: shorter waves do not show. Each axis between its two "
        "directions.</p>"
    )


def after_part(report: MachineReport) -> str:
    """Before and after compensation, and measured points."""
    if not report.budget.errors:
        return f"<p>Nothing to compensate.</p>{_checked(report)}"
    outcome = report.after
    rows = [_level(level, outcome.complete or level is not outcome.likely) for level in outcome.levels]
    if outcome.exact is not None and outcome.likely is None:
        rows.append(("compensated, with what is not known", *[UNKNOWN] * 4))
    text = (
        f"<div class=after>{embedded(plot_after(outcome), 'share of positions below an error, before and after', '')}</div>"
        + table(["error at the tool", "RMS [µm]", "half below", "95 % below", "largest"], rows, numbers=(1, 2, 3, 4))
    )
    items = []
    if outcome.exact is None:
        items.append("The machine runs no programs (three linear and at most two rotary axes): nothing to compensate.")
    else:
        items.append(
            "“Were the calibration exactly true” is what the least increments and the ends of the travel leave. What is not "
            "known of the "
            "calibration comes on top"
            + (
                f", drawn from its covariance at every position (seed {outcome.seed})."
                if outcome.likely is not None
                else f": it is {UNKNOWN} here, not zero."
            )
        )
        if outcome.likely is not None and not outcome.complete:
            items.append("Some errors have no uncertainty: what is left is at least this much.")
        if outcome.machines is not None:
            fitting = outcome.machines[1]
            items.append(
                f"From machine to machine among those that fit this calibration, what stays beside rounding is between "
                f"{figure(fitting.low, 'µm')} and {figure(fitting.high, 'µm')} RMS (95 %)."
            )
        if outcome.out_of_range:
            items.append(
                f"At {outcome.out_of_range:,} of {outcome.poses:,} positions the correction leaves the travel of an axis: up to "
                f"{figure(outcome.out_of_range_um, 'µm')} stays there. Keep away from the ends, or place the workpiece so."
            )
        if outcome.no_orientation:
            items.append(
                f"At {outcome.no_orientation:,} positions, close to where the rotary axes have no say or at their ends, the "
                f"tool's direction is not "
                "corrected; the point is."
            )
        after = outcome.tilt_after_urad
        if after is not None:
            (a, b), (c, d) = outcome.tilt_before_urad[0], after[0]
            items.append(
                f"Lean of the tool, RMS about x and y: {figure(a, 'µrad')} and {figure(b, 'µrad')} before, {figure(c, 'µrad')} and "
                f"{figure(d, 'µrad')} after."
            )
    text += bullets(escaped(item) for item in items)
    return text + _tables(report) + _checked(report)


def _tables(report: MachineReport) -> str:
    """What tables in the control would leave: the figures of `twin control`."""
    if not report.tables:
        return ""
    first = report.tables[0]
    rows = [("none", *_left(first.remains.before))]
    rows += [(escaped(one.kind), *_left(one.remains.tables)) for one in report.tables]
    u, where = first.remains.known_to, place(dict(first.at))
    known = f"U of the point is {expanded(u.rms_um, complete=not u.without_uncertainty)} RMS with and without them."
    return (
        "<h3>Tables in the control</h3>"
        + table(
            ["tables for", "RMS by the model [µm]", "RMS expected [µm]", "largest by the model [µm]"],
            rows,
            numbers=(1, 2, 3),
        )
        + f"<p class=small>For tool length {first.tool_length_mm:g} mm, with the other axes at {escaped(where)}. {known} "
        "“Expected” has the uncertainty of the calibration counted in. <code>twin control</code> writes the tables and gives the same "
        "figures for the same tool length and place.</p>"
    )


def _left(left: Left) -> tuple[str, str, str]:
    return figure(left.rms_um), figure(left.expected_rms_um), figure(left.max_um)


def _checked(report: MachineReport) -> str:
    text = ""
    for one in report.checked:
        text += (
            f"<h3>Measured points: {escaped(one.source.rpartition('/')[2])}</h3>"
            f"<p>{one.points:,} points. Stations and targets fitted, nothing else: {figure(one.rms_before_um, 'µm')} RMS a "
            f"coordinate is left "
            f"with the machine as drawn, <b>{figure(one.rms_after_um, 'µm')}</b> with this calibration. The readings scatter by "
            f"{escaped(one.scatter)}.</p>{embedded(plot_checked(one), 'share of points below a distance', '')}"
        )
        if one.far:
            text += (
                f"<p>{one.far:,} of them are further off than scatter goes: <code>twin diagnose</code> says why.</p>"
            )
        if one.left_out:
            text += f"<p>Not in it, for want of a column in the table: {escaped(listed(one.left_out))}.</p>"
    return text


def _level(level: Level, complete: bool) -> tuple[str, ...]:
    least = "" if complete else "≥ "
    numbers = (level.rms_um, level.quantile(0.5), level.quantile(0.95), level.max_um)
    return escaped(level.name), *(f"{least}{figure(value)}" for value in numbers)


def known_part(report: MachineReport) -> str:
    """U over the working space."""
    field, total = report.field, report.budget.total
    if report.calibration.empty:
        return f"<p>The calibration names no error; how wrong that is, is {UNKNOWN}.</p>"
    if not np.isfinite(total.u_rms_um):
        return (
            f"<p><b>U at the tool is {UNKNOWN}</b>, everywhere: the calibration gives no number an uncertainty. It is not zero.</p>"
            "<p>A calibration with uncertainties comes from measured points: <code>twin identify</code>.</p>"
        )
    least = "" if total.u_complete else " It is a lower bound: some errors have none (below)."
    text = (
        f"<p>{escaped(DEFINITION[0].upper() + DEFINITION[1:])}. Over the volume "
        f"{expanded(total.u_rms_um, complete=total.u_complete)} RMS, "
        f"{figure(total.u_max_um, 'µm')} at most.{least} It holds the calibration's own numbers: no repeatability, no "
        f"temperature, no "
        "rounding, and nothing of an error that is not named.</p>"
    )
    if not field.known or not field.slices:
        return text
    pictures = _planes("U", [(one, one.u_um) for one in field.slices], field.u_um)
    stands = f"{escaped(place(field.standing))} standing still." if field.standing else ""
    return text + f"{pictures}<p class=small>U of the tool point. {stands}</p>"


def gaps_part(report: MachineReport) -> str:
    """What is absent, unknown, not identifiable."""
    gaps, told = report.gaps, report.identified
    text = ""
    if gaps.absent:
        text += f"<p><b>Not named, so counted as zero</b>, which nobody has measured here: {escaped(', '.join(gaps.absent))}.</p>"
    if gaps.without_uncertainty:
        text += f"<p><b>A value, but no uncertainty</b> ({UNKNOWN}, not zero): {escaped(', '.join(gaps.without_uncertainty))}.</p>"
    for channel, names in gaps.left_out.items():
        text += f"<p><b>Left out</b>: {escaped(', '.join(names))}, which needs {escaped(channel)}.</p>"
    if gaps.unused:
        text += f"<p>Given and not needed: {escaped(', '.join(gaps.unused))}.</p>"
    if told is None:
        return text + (
            "<p>The calibration file alone cannot tell how well the model fitted, which rows were left out, or which errors "
            "the data could not "
            "show. <code>twin identify … --json identified.json</code> writes it, <code>twin report --identified "
            "identified.json</code> "
            "shows it here.</p>"
        )
    if told.others:
        text += (
            f"<p><b>? {escaped(told.path.name)} gives other numbers than this calibration</b> for "
            f"{escaped(listed(told.others))}: what follows "
            "may be of another calibration.</p>"
        )
    by_reason: dict[str, list[str]] = {}
    for name, reason in told.not_identifiable:
        by_reason.setdefault(reason, []).append(name)
    if by_reason:
        text += "<p><b>Not identifiable</b> from the data, however large: they look the same with and without it.</p>"
        text += bullets(f"{escaped(', '.join(names))}: {escaped(reason)}" for reason, names in by_reason.items())
    judged = (
        f"reduced chi² {told.reduced_chi2:.3f} ({told.dof:,.0f} degrees of freedom, {probability(told.p_value)})"
        if told.dof > 0
        else "no degrees of freedom to judge the fit by"
    )
    fit = [
        ("From", f"{told.data}: {told.used:,} points used, {told.set_aside:,} set aside; scatter: {told.spread}"),
        (
            "Fit",
            f"{figure(told.rms_um, 'µm')} RMS a coordinate left; {judged}",
        ),
    ]
    if told.lack_p_value is not None:
        fit.append(("Against repeats", f"lack of fit {probability(told.lack_p_value)}"))
    if not told.converged:
        fit.append(("Warning", "THE ESTIMATE DID NOT SETTLE: do not use it"))
    text += facts(*fit)
    if told.rows:
        rows = [f"line {line}: {escaped(reason)}" for line, reason in told.rows[:ROWS]]
        rows += [f"and {len(told.rows) - ROWS} more, all in --json"] if len(told.rows) > ROWS else []
        text += f"<p>Rows set aside:</p>{bullets(rows)}"
    return text + bullets(escaped(notice) for notice in told.notices)


def sources_part(report: MachineReport) -> str:
    """Files, programs, seeds."""
    origin = report.sources
    files = table(
        ["", "file", "sha256"],
        [(escaped(one.role), escaped(str(one.path)), f"<span class=hash>{one.sha256}</span>") for one in origin.files],
    ).replace("<td><span class=hash>", "<td class=hash><span>")
    programs = ", ".join(f"{name} {version}" for name, version in origin.programs)
    seeds = "; ".join(f"{what}: {seed}" for what, seed in origin.seeds)
    text = f"<p>{escaped(report.calibration.source)}</p>{files}" + facts(
        ("Programs", programs), ("Seeds", seeds), ("Made", origin.made.strftime("%Y-%m-%d %H:%M %Z").strip())
    )
    control = report.control
    if control is not None:
        names = listed([f"{one.file.name} ({' '.join(one.classes)})" for one in control.tables])
        text += f"<p>Control: {escaped(names)}; the calibration's errors are those {control.errors_are}.</p>"
    for one in report.checked:
        if one.rows:
            rows = [f"line {line}: {escaped(reason)}" for line, reason in one.rows[:ROWS]]
            text += f"<p>{escaped(one.source)}: {len(one.rows)} rows set aside</p>{bullets(rows)}"
        text += bullets(escaped(notice) for notice in one.notices)
    return f"<div class=small>{text}</div>"
