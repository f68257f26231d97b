"""Summary of a machine report in words: largest errors, recommended actions, measurements, and what to avoid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import hypot, isfinite
from pathlib import Path
from typing import Any, Final, Literal, final

from twin._common.errors import InputError
from twin._common.records import json_form
from twin.compensation.tables import CorrectedShare, RemainingErrors, Request, account_of, make
from twin.controls import TableSum, table_formats
from twin.display import UNKNOWN, expanded, figure, with_half
from twin.display.numbers import capital, listed, lower
from twin.model.calibration import Calibration
from twin.model.conditions import SETTINGS, needed_values
from twin.reporting.compensation import CompensationForecast
from twin.reporting.contributions import Budget, Contribution
from twin.reporting.identified import Identified, PointComparison
from twin.tool.forward import Kinematics


@final
@dataclass(frozen=True)
class TablesLeft:
    """Errors that remain with the tables of one format.

    Attributes:
        kind: name of the format; only formats with tables of single axes, not the volumetric ones ``isg`` and ``grid``.
        at: positions of the other axes while one moves, by axis; mm, degrees.
        tool_length_mm: tool length for which the tables are made.
        remains: the error at the tool with them.
        carried: every error of the calibration, and the part of it that the format compensates.
    """

    kind: str
    at: Mapping[str, float]
    tool_length_mm: float
    remains: RemainingErrors
    carried: tuple[CorrectedShare, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"kind": "format", "remains": "error_at_tool"}, leave_out=("carried",))


def tables_left(
    real: Kinematics, errors: Calibration, missing: Mapping[str, tuple[str, ...]]
) -> tuple[TablesLeft, ...]:
    """Make the tables of every format and return the remaining errors, the most effective format first.

    The result is empty if the control has tables already, the estimate did not converge or there are no errors. Formats that cannot
    hold tables of this machine are omitted.

    Args:
        real: machine, errors that can be evaluated under the conditions, tool length, conditions.
        errors: the calibration as given.
        missing: effects omitted for want of a channel, by channel.
    """
    if errors.control is not None or not errors.settled or real.calibration.empty:
        return ()
    tables: list[TablesLeft] = []
    required = None
    for form in table_formats():
        if form.correction is not TableSum:
            continue
        request = Request(form.name, tool_length_mm=real.tool_length_mm, conditions=real.conditions)
        try:
            made = make(real.machine, real.calibration, request, required)
        except InputError:
            continue
        required = made.required
        account = account_of(made, errors, real.calibration, missing)
        tables.append(TablesLeft(form.name, made.required.at, real.tool_length_mm, account.remains, account.carried))
    return tuple(sorted(tables, key=lambda one: -one.remains.reduction))


# --- Summary of a machine report in words: largest errors, recommended actions, measurements, and what to avoid

Kind = Literal["do", "measure", "never", "unknown"]
Rating = Literal["well", "wrong", "unknown"]
NAMED: Final = 3
WORTH: Final = 0.05
"""Smallest share of the RMS error over the volume that an action must remove to be recommended."""
MECHANICAL: Final = ("L-SQU", "R-POR")
TABLES: Final = {
    "L-POS": "positioning",
    "L-STR": "straightness",
    "L-SQU": "squareness",
    "L-ANG": "angular errors of the linear axes",
    "R-POS": "angular positioning",
}
"""Errors that axis tables can compensate, by class."""
SMALL_UM: Final = 2.0
"""Error below which no action is needed: about the effect of rounding three axes to 1 µm, and of splitting blocks."""
REPEATS: Final = 1e-3


@final
@dataclass(frozen=True)
class Step:
    """One recommended action, or one action to avoid.

    Attributes:
        kind: ``do``, ``measure``, ``never`` or ``unknown``.
        title: the action, in a few words.
        text: explanation, with numbers.
    """

    kind: Kind
    title: str
    text: str


@final
@dataclass(frozen=True)
class MachineAdvice:
    """Summary at the top of the report.

    Attributes:
        headline: the main result in one sentence.
        rating: overall rating, which selects the colour.
        largest_errors: the largest errors, one line each.
        steps: actions to take, to measure and to avoid.
    """

    headline: str
    rating: Rating
    largest_errors: tuple[str, ...]
    steps: tuple[Step, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, leave_out=("rating",))


def advise(
    calibration: Calibration,
    found: Budget,
    outcome: CompensationForecast,
    identified: Identified | None,
    left_out: Mapping[str, tuple[str, ...]],
    points: Sequence[PointComparison] = (),
    tables: Sequence[TablesLeft] = (),
) -> MachineAdvice:
    """Return the summary of a report in words.

    Args:
        found: the error budget.
        outcome: errors before and after compensation.
        identified: result of the identification, or None.
        left_out: effects omitted for want of a channel, by channel.
        points: measured points compared with the calibration.
        tables: remaining errors with tables in the control, the best first; empty if tables are in use already.
    """
    rms, most = (figure(size, "µm") for size in (found.total.rms_um, found.total.max_um))
    if not found.errors and not left_out:
        steps = (
            Step(
                "measure",
                "Measure the machine",
                f"An empty calibration does not describe an accurate machine. {_IDENTIFY}",
            ),
            Step(
                "never", "Assume that the machine is accurate", "No error is known, so every error counts as zero here."
            ),
        )
        return MachineAdvice(
            "This calibration contains no errors: the state of the machine is unknown.", "unknown", (), steps
        )
    every = [
        *_void(calibration, calibration.settled and (identified is None or identified.file.converged)),
        *_incomplete(calibration, left_out, identified),
        *_misfit(points, calibration),
        *_control(calibration, outcome),
        *(
            _wait()
            if identified is not None and identified.doubtful
            else _one_of(_compensate(calibration, found, outcome), _adjust(found), _tables(found, tables))
        ),
        *_unknown(calibration, outcome),
        *_measure(found, outcome, None if identified is None else identified.relative_instrument),
        *_never(calibration, found),
    ]
    return MachineAdvice(
        f"The error at the tool point is {rms} RMS over the working volume and up to {most}{_without(outcome)}.",
        "well" if found.total.max_um <= SMALL_UM else "wrong",
        tuple(_line(error) for error in found.errors[:NAMED]),
        tuple(sorted(every, key=lambda step: _ORDER.index(step.kind))),
    )


def _without(outcome: CompensationForecast) -> str:
    """Return in words which errors a figure of the known errors does not contain."""
    return (
        f", without {listed(outcome.not_identified)}, which could not be determined" if outcome.not_identified else ""
    )


_ORDER: Final = ("unknown", "do", "measure", "never")
_IDENTIFY: Final = "`twin plan` gives the positions to measure; `twin identify` makes a calibration with uncertainty from the readings."


def _one_of(*ways: Iterator[Step]) -> Iterator[Step]:
    """Yield the steps of alternative actions; the title of each alternative after the first begins with "Or"."""
    again = False
    for step in chain(*ways):
        yield replace(step, title=f"Or {lower(step.title)}") if again and step.kind == "do" else step
        again = again or step.kind == "do"


def _line(one: Contribution) -> str:
    return (
        f"{one.words} ({one.name}): up to {with_half(one.peak, one.peak_half, one.unit)}; effect at the tool "
        f"{figure(one.rms_um, 'µm')} RMS, up to {figure(one.max_um, 'µm')} "
        f"(U {expanded(one.u_rms_um, complete=one.u_complete)})"
    )


def _incomplete(
    calibration: Calibration, left_out: Mapping[str, tuple[str, ...]], identified: Identified | None
) -> Iterator[Step]:
    for channel, names in left_out.items():
        text = f"It needs {channel}: give {needed_values([channel])}. No number in this report includes it."
        yield Step("unknown", f"{listed(names)} omitted", text)
    if identified is None:
        misfit = calibration.misfit
        if misfit is not None and misfit.warning is not None:
            yield Step(
                "unknown",
                capital(lower(misfit.warning.title)),
                f"The identification reported: {misfit.says or misfit.verdict}",
            )
        return
    if identified.others:
        text = (
            f"{identified.path.name} gives other numbers for {listed(identified.others)}: it belongs to another calibration, or "
            "this one was changed since. Its quality of fit does not apply to these numbers."
        )
        yield Step("unknown", "The identification belongs to another calibration", text)
    fit = identified.file.misfit
    if fit.lack_of_fit_p_value is not None and fit.lack_of_fit_p_value < REPEATS:
        text = (
            f"The residuals contain a repeatable part (reduced chi² {fit.reduced_chi2:.3g}), which the uncertainties count as "
            "random. `twin diagnose` looks for its cause."
        )
        yield Step("measure", "Find the cause of the lack of fit", text)
    elif identified.doubtful:
        text = (
            f"The residuals are larger than the stated noise (reduced chi² {fit.reduced_chi2:.3g}), and no reading was repeated: "
            "either the noise is larger than stated, or the machine has errors that were not identified. These numbers then contain a "
            "part of those errors. `twin diagnose` looks for the cause."
        )
        yield Step("unknown", "The calibration does not describe the readings", text)
    elif fit.p_value is not None and fit.p_value < REPEATS:
        text = (
            f"The noise of the readings is larger than stated (reduced chi² {fit.reduced_chi2:.3g}): the uncertainties here are "
            "too small. Identify again with `--uncertainty repeats`, or use `twin diagnose`."
        )
        yield Step("measure", "Find the cause of the noise", text)


def _wait() -> Iterator[Step]:
    """Yield the step that replaces every correction while the calibration does not describe its own readings."""
    text = "The corrections would contain errors of another kind, with a wrong size. Find the cause of the residuals first."
    yield Step("never", "Compensate or adjust with this calibration", text)


def _misfit(points: Sequence[PointComparison], calibration: Calibration) -> Iterator[Step]:
    """Yield steps on measured points that do not fit this calibration."""
    for point in points:
        if point.far:
            name, residual = Path(point.source).name, figure(point.rms_after_um, "µm")
            text = (
                f"{point.far:,} of the {point.points:,} points of {name} deviate by more than the measurement noise (RMS residual "
                f"{residual} per coordinate over all). `twin diagnose {name}{_about(calibration)}` looks for the cause."
            )
            yield Step("measure", "Find the cause of the outliers", text)


def _control(calibration: Calibration, outcome: CompensationForecast) -> Iterator[Step]:
    control, without_tables = calibration.control, outcome.without_tables
    if control is None or not control.tables:
        return
    alike: dict[tuple[str, ...], list[str]] = {}
    for table in control.tables:
        alike.setdefault(table.classes, []).append(table.file.name)
    names = "; ".join(f"{listed(files)}: {' '.join(classes)}" for classes, files in alike.items())
    if control.errors_are == "remaining":
        text = f"These errors were measured with the tables active ({names}) and remain in addition. Add a new table to them."
        text += f" {control.caution}" if control.caution else ""
    else:
        ends = (
            None
            if without_tables is None
            else [figure(level.rms_um, "µm") for level in (without_tables, outcome.before)]
        )
        was = "" if ends is None else f" and reduce the error at the tool from {ends[0]} to {ends[1]} RMS"
        text = (
            f"The tables ({names}) compensate a part of the errors{was}. All numbers here are with the tables active."
        )
    yield Step("do", "Keep the control's tables active", text)


def _compensate(calibration: Calibration, found: Budget, outcome: CompensationForecast) -> Iterator[Step]:
    if outcome.exact is None:
        text = "Compensation needs three linear and at most two rotary axes."
        yield Step("unknown", "Programs cannot be compensated", text)
        return
    if found.total.rms_um <= 0.0:
        return
    start, exact = (figure(level.rms_um, "µm") for level in (outcome.before, outcome.exact))
    if outcome.judged is not None and outcome.judged.rms_um >= outcome.before.rms_um:
        expected = figure(outcome.judged.rms_um, "µm")
        text = f"Its uncertainty is too large: the expected RMS error would change from {start} to {expected}. Measure more first."
        yield Step("never", "Compensate programs with this calibration", text)
        return
    text = f"`twin compensate part.nc -o part.compensated.nc{_options(found, calibration)}` reduces the error from {start} RMS to "
    if outcome.judged is None:
        text += (
            f"{exact} for an exact calibration. The expected error is {UNKNOWN}, because the calibration gives no "
            "uncertainty."
        )
    else:
        least = "" if outcome.complete else "at least "
        text += (
            f"{least}{figure(outcome.judged.rms_um, 'µm')}, including the uncertainty of the calibration ({exact} for an "
            f"exact one); 95 % of positions within {least}{figure(outcome.judged.quantile(0.95), 'µm')}."
        )
        if outcome.not_identified and outcome.with_uncertainty is not None:
            text += (
                f" This does not include {listed(outcome.not_identified)}, which could not be determined and which no program "
                f"corrects: with their plausible size {figure(outcome.with_uncertainty.rms_um, 'µm')} RMS remain."
            )
    if outcome.out_of_range:
        share = 100.0 * outcome.out_of_range / outcome.poses
        text += (
            f" At {share:.2g} % of the positions, at the ends of travel, the correction exceeds the axis range: up to "
            f"{figure(outcome.out_of_range_um, 'µm')} remains there."
        )
    yield Step("do", _with_measured("compensate the programs", calibration), text)


def _with_measured(what: str, calibration: Calibration) -> str:
    """Return a title; for an illustrative calibration it states that measured numbers are needed."""
    return f"With measured numbers: {what}" if calibration.illustrative else capital(what)


def _about(calibration: Calibration) -> str:
    """Return the options for machine and calibration."""
    file = "" if calibration.path is None else f" --calibration {calibration.path.name}"
    return f"{calibration.machine.as_option}{file}"


def _options(found: Budget, calibration: Calibration) -> str:
    """Return the options for machine, calibration, tool length, temperatures, time and spindle speed."""
    at = found.kinematics.conditions
    warm = "".join(f" {name}={value:g}" for name, value in at.temperature_degC.items())
    held = "".join(f" --{SETTINGS[name]} {at.channels[name]:g}" for name in SETTINGS if name in at.channels)
    tool = f" --tool-length {found.kinematics.tool_length_mm:g}"
    return f"{_about(calibration)}{tool}{' --temperature' if warm else ''}{warm}{held}"


def _adjust(found: Budget) -> Iterator[Step]:
    """Yield mechanical adjustments of errors that are large and significant."""
    significant, without_interval = [], []
    for error in found.errors:
        # The RMS error cannot fall by more than that of the error removed.
        if error.iso_class not in MECHANICAL or error.illustrative or error.rms_um < WORTH * found.total.rms_um:
            continue
        rest = found.rms_without_um(error.name)
        if found.total.rms_um - rest < WORTH * found.total.rms_um:
            continue
        if not isfinite(error.peak_half):
            without_interval.append(f"{lower(error.words)} ({error.name})")
        elif error.peak > error.peak_half:
            size = with_half(error.peak, error.peak_half, error.unit)
            significant.append(
                f"{error.words} ({error.name}) by {size}: this reduces the error over the volume to {figure(rest, 'µm')} RMS."
            )
    if significant:
        text = f"{' '.join(significant)} Measure again after the adjustment: this calibration is then no longer valid."
        yield Step("do", "Adjust the machine mechanically", text)
    if without_interval:
        text = f"The uncertainty of {listed(without_interval)} is {UNKNOWN}."
        yield Step("measure", "Measure before any adjustment", text)


def _tables(found: Budget, tables: Sequence[TablesLeft]) -> Iterator[Step]:
    """Yield the compensation by tables in the control, computed as by `twin control`."""
    if not tables:
        return
    best = tables[0]
    # An error smaller than its own 95 % half-width is not significant.
    shown = {error.name for error in found.errors if error.rms_um > 0.0 and not error.peak <= error.peak_half}
    classes = {one.iso_class for one in best.carried if one.share != "no" and one.name in shown}
    names = [f"{words} ({name})" for name, words in TABLES.items() if name in classes]
    if not names:
        return
    where = ", ".join(f"{name} {value:g}" for name, value in best.at.items()).replace("-", "−")
    text = (
        f"They compensate {listed(names)} for all programs. RMS error at the tool: {figure(best.remains.before.rms_um, 'µm')} without "
        f"tables; {'; '.join(_remaining(table) for table in tables)}. Valid for tool length {best.tool_length_mm:g} mm and the "
        f"other axes at {where}."
    )
    tables_left = best.remains.tables
    known = best.remains.uncertainty.identified_standard_rms_um
    larger = isfinite(known) and hypot(tables_left.rms_um, known) >= best.remains.before.rms_um
    if best.remains.reduction >= WORTH and not larger:
        calibration = found.kinematics.calibration
        how = f"`twin control --to {best.kind} -o tables/{_options(found, calibration)}` writes the tables."
        yield Step("do", _with_measured("use the control's axis tables", calibration), f"{text} {how}")
    else:
        yield Step("never", "Rely on the control's axis tables alone", text)


def _remaining(one: TablesLeft) -> str:
    """Return the remaining error with the tables of a format, for the model and with its uncertainty."""
    remaining, u = one.remains.tables, one.remains.uncertainty
    expected = (
        f"{u.least}{figure(hypot(remaining.rms_um, u.identified_standard_rms_um), 'µm')} with uncertainty"
        if isfinite(u.identified_standard_rms_um)
        else f"U {UNKNOWN}"
    )
    return f"{one.kind} {figure(remaining.rms_um, 'µm')} by the model, {expected}"


def _unknown(calibration: Calibration, outcome: CompensationForecast) -> Iterator[Step]:
    """Yield a step on the errors that the readings could not determine."""
    by_reason: dict[str, list[str]] = {}
    for error in calibration.not_identifiable:
        by_reason.setdefault(error.why, []).append(error.name)
    if not by_reason:
        return
    reasons = [f"{listed(names)}: {why}" for why, names in list(by_reason.items())[:NAMED]]
    more = len(by_reason) - len(reasons)
    text = f"{'. '.join(reasons)}{f'. {more} more: see the file of the calibration' if more > 0 else ''}."
    if outcome.not_identified:
        text += f" U at the tool includes the plausible size of {listed(outcome.not_identified)} (machine file)."
    yield Step("measure", "Determine the errors that were not identified", text)


def _measure(found: Budget, outcome: CompensationForecast, instrument: str | None) -> Iterator[Step]:
    known = [error for error in found.errors if isfinite(error.u_rms_um) and error.u_rms_um > 0.0]
    if not known:
        if found.errors:
            text = f"U at the tool is {UNKNOWN}: the calibration gives no uncertainty. {_IDENTIFY}"
            yield Step("measure", "Determine the uncertainty", text)
        return
    what = ""
    if outcome.judged is not None and outcome.exact is not None and outcome.judged.rms_um > 2.0 * outcome.exact.rms_um:
        what = "The error after compensation is mostly due to the uncertainty of the calibration. Largest uncertainties"
    elif outcome.exact is None and found.total.u_rms_um > found.total.rms_um:
        what = f"U at the tool ({figure(found.total.u_rms_um, 'µm')}) exceeds the error itself. Largest uncertainties"
    if what:
        weak = sorted(known, key=lambda one: -one.u_rms_um)[:NAMED]
        names = listed([f"{lower(one.words)} ({one.name}, U {figure(one.u_rms_um, 'µm')})" for one in weak])
        reduce = " ".join(one.name for one in weak if one.name.startswith("E_")) or "tool"
        aim = f"--reduce {reduce}" if instrument is None else f"--instrument {instrument}"
        how = f"`twin plan -o plan.csv{found.kinematics.machine.as_option} {aim}` plans the measurement."
        yield Step("measure", "Measure the most uncertain errors again", f"{what}: {names}. {how}")
    if found.without_uncertainty:
        text = f"{listed(found.without_uncertainty)}: the calibration gives a value but no uncertainty."
        yield Step("unknown", "U is a lower bound", text)


def _void(calibration: Calibration, settled: bool) -> Iterator[Step]:
    """Yield reasons against any use of the numbers."""
    drawn = sum(curve.illustrative for curve in calibration.curves.values())
    if drawn:
        text = (
            f"{drawn} of its {len(calibration.curves)} error motions are ILLUSTRATIVE: assumed, not measured. The numbers "
            "below are an example of a report and do not describe your machine."
        )
        yield Step("never", "Use this calibration for compensation, adjustment or tables", text)
    if not settled:
        yield Step("never", "Use this calibration", "The identification did not converge.")


def _never(calibration: Calibration, found: Budget) -> Iterator[Step]:
    insignificant = [
        f"{lower(error.words)} ({with_half(error.peak, error.peak_half, error.unit)})"
        for error in found.errors
        if error.iso_class in MECHANICAL and isfinite(error.peak_half) and 0.0 < error.peak <= error.peak_half
    ]
    if insignificant:
        yield Step(
            "never", "Adjust errors that are not significant", f"{listed(insignificant)}: smaller than its uncertainty."
        )
    if found.total.rms_um > 0.0 and not calibration.illustrative:
        text = (
            "If the control's tables are active, compensate programs only with the `calibration.yaml` written beside them, which "
            "contains what the tables correct. Do not use this calibration after the machine was adjusted."
        )
        yield Step("never", "Correct the same error twice", text)
    tilts = [error.name for error in found.errors if error.unit == "urad" and error.peak > 0.0 and error.rms_um == 0.0]
    if tilts and found.kinematics.tool_length_mm == 0.0:
        text = f"At tool length 0 mm, {listed(tilts)} have no effect: give the tool length in use with `--tool-length`."
        yield Step("unknown", "Computed for tool length zero", text)
