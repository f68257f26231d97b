"""Summary of a machine report in words: largest errors, recommended actions, measurements, and what to avoid."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any, Final, Literal, final

from twin._common.errors import InputError
from twin._common.messages import Message, Number, Quoted, joined
from twin._common.records import json_form
from twin.controls.kinematics.format import rotary_axes
from twin.display import expanded, figure, with_half
from twin.display.numbers import capital, listed, lower
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.calibration_file import UnidentifiedEntry
from twin.model.conditions import SETTINGS, needed_values
from twin.reporting.compensation import CompensationForecast, TablesLeft
from twin.reporting.contributions import Budget
from twin.reporting.identified import Identified, PointComparison

Kind = Literal["do", "measure", "never", "unknown"]
Rating = Literal["well", "wrong", "unknown"]
NAMED: Final = 3
WORTH: Final = 0.05
"""Smallest share of the RMS error over the volume that an action must remove to be recommended."""
LOCATION: Final = "R-POR"
MECHANICAL: Final = ("L-SQU", LOCATION)
TABLES: Final = {
    "L-POS": Message("positioning"),
    "L-STR": Message("straightness"),
    "L-SQU": Message("squareness"),
    "L-ANG": Message("angular errors of the linear axes"),
    "R-POS": Message("angular positioning"),
}
"""Errors that axis tables can compensate, by class."""
SMALL_UM: Final = 2.0
"""Error below which no action is needed: about the effect of rounding three axes to 1 µm, and of splitting blocks."""
REPEATS: Final = 1e-3


@final
@dataclass(frozen=True)
class Step:
    """One recommended action, or one action to avoid."""

    kind: Kind
    title: str
    text: str  # with numbers
    short: str = ""  # one sentence for the first page; empty for what does not belong there


@final
@dataclass(frozen=True)
class MachineAdvice:
    """Summary at the top of the report."""

    headline: str  # in one sentence
    rating: Rating  # selects the colour
    largest_errors: tuple[str, ...]  # one line each
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
    """Return the summary of a report in words; ``left_out``: effects omitted for want of a channel; ``tables``: the best first."""
    if not found.errors and not left_out:
        steps = (
            Step(
                "measure",
                Message("Measure the machine"),
                joined(" ", [Message("An empty calibration does not describe an accurate machine."), _IDENTIFY]),
                _IDENTIFY,
            ),
            Step(
                "never",
                Message("Assume that the machine is accurate"),
                Message("No error is known, so every error counts as zero here."),
            ),
        )
        return MachineAdvice(
            Message("This calibration contains no errors: the state of the machine is unknown."), "unknown", (), steps
        )
    every = [
        *_void(calibration, calibration.settled and (identified is None or identified.file.converged)),
        *_incomplete(calibration, left_out, identified),
        *_misfit(points, calibration),
        *_control(calibration, outcome),
        *_corrections(calibration, found, outcome, identified, tables),
        *_unknown(calibration, outcome),
        *_measure(found, outcome, None if identified is None else identified.relative_instrument),
        *_never(calibration, found),
    ]
    live = calibration.corrected_in_control
    return MachineAdvice(
        _headline(outcome, live=live),
        "well" if found.total.max_um <= SMALL_UM else "unknown" if live else "wrong",
        tuple(
            Message(
                "{words} ({name}): up to {peak}; effect at the tool {rms} RMS, up to {largest} (U {u})",
                words=one.words,
                name=one.name,
                peak=with_half(one.peak, one.peak_half, one.unit),
                rms=figure(one.rms_um, "µm"),
                largest=figure(one.max_um, "µm"),
                u=expanded(one.u_rms_um, complete=one.u_complete),
            )
            for one in found.errors[:NAMED]
        ),
        tuple(sorted(every, key=lambda step: _ORDER.index(step.kind))),
    )


def _corrections(
    calibration: Calibration,
    found: Budget,
    outcome: CompensationForecast,
    identified: Identified | None,
    tables: Sequence[TablesLeft],
) -> Iterator[Step]:
    if calibration.corrected_in_control:
        yield from _module(calibration, found, outcome)
    elif identified is not None and identified.doubtful:
        text = Message(
            "The corrections would contain errors of another kind, with a wrong size. Find the cause of the residuals first."
        )
        yield Step("never", Message("Compensate or adjust with this calibration"), text)
    else:
        yield from _one_of(
            _kinematics(calibration, found, outcome),
            _compensate(calibration, found, outcome),
            _tables(found, tables, outcome),
            _adjust(found),
        )


def _module(calibration: Calibration, found: Budget, outcome: CompensationForecast) -> Iterator[Step]:
    """Yield the steps for errors that a kinematics module in the control corrects already."""
    sizes = {"rms": figure(outcome.start.rms_um, "µm"), "largest": figure(outcome.start.max_um, "µm")}
    texts = [
        Message(
            "A kinematics module in the control corrects these errors while it is switched on. With it switched off the error is {rms} "
            "RMS and up to {largest}.",
            **sizes,
        )
    ]
    if outcome.judged is None:
        texts.append(Message("What remains with it is unknown, because the calibration gives no uncertainty."))
    else:
        texts.append(
            Message(
                "With it, {expected} RMS are expected, from the uncertainty of the calibration.",
                expected=figure(outcome.judged.rms_um, "µm"),
            )
        )
        texts += _not_corrected(outcome)
    texts.append(Message("Programs run as they are."))
    yield Step("do", Message("Keep the correction in the control switched on"), joined(" ", texts), texts[-1])
    text = Message(
        "A measurement with it switched on shows the errors that remain: `twin identify measured.csv -o remaining.yaml{machine} "
        "--control linuxcnc-kinematics={file}`. `twin control --to linuxcnc-kinematics --add -c remaining.yaml -o live2/` then makes a "
        "module for both.",
        machine=calibration.machine.as_option,
        file="calibration.yaml" if calibration.path is None else calibration.path.name,
    )
    yield Step("measure", Message("Measure what remains"), text, Message("With the module switched off."))
    control = calibration.control
    text = Message(
        "Programs, tables and kinematics made from these errors would correct them a second time. `twin compensate` and `twin control` "
        "refuse this calibration. With the module switched off, {file} is the calibration. After an adjustment of the machine, make a "
        "new module from a new measurement.",
        file="" if control is None else control.live[-1].file.name,
    )
    yield Step("never", Message("Compensate programs or write tables beside the module"), text)


def _headline(outcome: CompensationForecast, *, live: bool) -> str:
    """Return the error at the tool, and which errors it does not contain; ``live``: a module in the control corrects it."""
    sizes = {"rms": figure(outcome.start.rms_um, "µm"), "largest": figure(outcome.start.max_um, "µm")}
    if live:
        return Message(
            "With the correction in the control switched off, the error at the tool point is {rms} RMS over the working volume and up "
            "to {largest}.",
            **sizes,
        )
    if not outcome.not_identified:
        return Message("The error at the tool point is {rms} RMS over the working volume and up to {largest}.", **sizes)
    return Message(
        "The error at the tool point is {rms} RMS over the working volume and up to {largest}, without {names}, which could not be "
        "determined.",
        **sizes,
        names=listed(outcome.not_identified),
    )


_ORDER: Final = ("unknown", "do", "measure", "never")
_IDENTIFY: Final = Message(
    "`twin plan` gives the positions to measure; `twin identify` makes a calibration with uncertainty from the readings."
)


_DIAGNOSE: Final = Message("`twin diagnose` names it.")


def _one_of(*ways: Iterator[Step]) -> Iterator[Step]:
    """Yield the steps of alternative actions; the title of each alternative after the first begins with "Or"."""
    again = False
    for step in chain(*ways):
        yield (
            replace(step, title=Message("Or {title}", title=lower(step.title))) if again and step.kind == "do" else step
        )
        again = again or step.kind == "do"


def _incomplete(
    calibration: Calibration, left_out: Mapping[str, tuple[str, ...]], identified: Identified | None
) -> Iterator[Step]:
    for channel, names in left_out.items():
        text = Message(
            "It needs {channel}: give {values}. No number in this report includes it.",
            channel=channel,
            values=needed_values([channel]),
        )
        yield Step("unknown", Message("{names} omitted", names=listed(names)), text)
    if identified is None:
        misfit = calibration.misfit
        if misfit is not None and misfit.warning is not None:
            yield Step(
                "unknown",
                capital(lower(misfit.warning.title)),
                Message("The identification reported: {text}", text=Quoted(misfit.says or misfit.verdict)),
            )
        return
    if identified.others:
        text = Message(
            "{file} gives other numbers for {names}: it belongs to another calibration, or this one was changed since. Its quality of "
            "fit does not apply to these numbers.",
            file=identified.path.name,
            names=listed(identified.others),
        )
        yield Step("unknown", Message("The identification belongs to another calibration"), text)
    fit = identified.file.misfit
    if fit.lack_of_fit_p_value is not None and fit.lack_of_fit_p_value < REPEATS:
        text = Message(
            "The residuals contain a repeatable part (reduced chi² {chi2:.3g}), which the uncertainties count as random. "
            "`twin diagnose` looks for its cause.",
            chi2=fit.reduced_chi2,
        )
        yield Step("measure", Message("Find the cause of the lack of fit"), text, _DIAGNOSE)
    elif identified.doubtful:
        text = Message(
            "The residuals are larger than the stated noise (reduced chi² {chi2:.3g}), and no reading was repeated: "
            "either the noise is larger than stated, or the machine has errors that were not identified. These numbers then contain a "
            "part of those errors. `twin diagnose` looks for the cause.",
            chi2=fit.reduced_chi2,
        )
        yield Step("unknown", Message("The calibration does not describe the readings"), text, _DIAGNOSE)
    elif fit.p_value is not None and fit.p_value < REPEATS:
        text = Message(
            "The noise of the readings is larger than stated (reduced chi² {chi2:.3g}): the uncertainties here are too small. "
            "Identify again with `--uncertainty repeats`, or use `twin diagnose`.",
            chi2=fit.reduced_chi2,
        )
        yield Step("measure", Message("Find the cause of the noise"), text, _DIAGNOSE)


def _misfit(points: Sequence[PointComparison], calibration: Calibration) -> Iterator[Step]:
    for point in points:
        if point.far:
            text = Message(
                "{far:,} of the {points:,} points of {file} deviate by more than the measurement noise (RMS residual {residual} per "
                "coordinate over all). `twin diagnose {file}{options}` looks for the cause.",
                far=point.far,
                points=point.points,
                file=Path(point.source).name,
                residual=figure(point.rms_after_um, "µm"),
                options=_about(calibration),
            )
            yield Step("measure", Message("Find the cause of the outliers"), text, _DIAGNOSE)


def _control(calibration: Calibration, outcome: CompensationForecast) -> Iterator[Step]:
    control, without_tables = calibration.control, outcome.without_tables
    if control is not None and control.live and control.errors_are == "remaining":
        text = Message(
            "These errors were measured with the kinematics module active and remain in addition. `twin control --to "
            "linuxcnc-kinematics --add{options} -o live2/` makes a module for both.",
            options=_about(calibration),
        )
        yield Step("do", Message("Keep the correction in the control switched on"), text)
    if control is None or not control.tables:
        return
    alike: dict[tuple[str, ...], list[str]] = {}
    for table in control.tables:
        alike.setdefault(table.classes, []).append(table.file.name)
    names = joined(
        "; ",
        [
            Message("{files}: {classes}", files=listed(files), classes=" ".join(classes))
            for classes, files in alike.items()
        ],
    )
    texts: list[str]
    if control.errors_are == "remaining":
        texts = [
            Message(
                "These errors were measured with the tables active ({names}) and remain in addition. Add a new table to them.",
                names=names,
            ),
            *([control.caution] if control.caution else []),
        ]
    else:
        active = Message("All numbers here are with the tables active.")
        if without_tables is None:
            texts = [Message("The tables ({names}) compensate a part of the errors.", names=names), active]
        else:
            compensated = Message(
                "The tables ({names}) compensate a part of the errors and reduce the error at the tool from {without} to {rms} RMS.",
                names=names,
                without=figure(outcome.with_u(without_tables.rms_um), "µm"),
                rms=figure(outcome.start.rms_um, "µm"),
            )
            texts = [compensated, active]
    short = Message("All figures are with them.") if control.errors_are != "remaining" else texts[0]
    yield Step("do", Message("Keep the control's tables active"), joined(" ", texts), short)


def _compensate(calibration: Calibration, found: Budget, outcome: CompensationForecast) -> Iterator[Step]:
    if outcome.exact is None:
        text = Message("Compensation needs three linear and at most two rotary axes.")
        yield Step("unknown", Message("Programs cannot be compensated"), text)
        return
    if found.total.rms_um <= 0.0:
        return
    start, exact = (figure(level.rms_um, "µm") for level in (outcome.start, outcome.exact))
    if outcome.judged is not None and outcome.judged.rms_um >= outcome.before.rms_um:
        text = Message(
            "Its uncertainty is too large: the expected RMS error would change from {start} to {expected}. Measure more first.",
            start=start,
            expected=figure(outcome.judged.rms_um, "µm"),
        )
        yield Step("never", Message("Compensate programs with this calibration"), text)
        return
    known = {"options": _options(found, calibration), "start": start, "exact": exact}
    texts = list[str]()
    if outcome.judged is None:
        texts.append(
            Message(
                "`twin compensate part.nc -o part.compensated.nc{options}` reduces the error from {start} RMS to {exact} for an exact "
                "calibration. The expected error is unknown, because the calibration gives no uncertainty.",
                **known,
            )
        )
    else:
        known |= {"rms": figure(outcome.judged.rms_um, "µm"), "within": figure(outcome.judged.quantile(0.95), "µm")}
        texts.append(
            Message(
                "`twin compensate part.nc -o part.compensated.nc{options}` reduces the error from {start} RMS to {rms}, including the "
                "uncertainty of the calibration ({exact} for an exact one); 95 % of positions within {within}.",
                **known,
            )
            if outcome.complete
            else Message(
                "`twin compensate part.nc -o part.compensated.nc{options}` reduces the error from {start} RMS to at least {rms}, "
                "including the uncertainty of the calibration ({exact} for an exact one); 95 % of positions within at least {within}.",
                **known,
            )
        )
        texts += _not_corrected(outcome)
    if outcome.out_of_range:
        texts.append(
            Message(
                "At {share:.2g} % of the positions, at the ends of travel, the correction exceeds the axis range: up to {largest} "
                "remains there.",
                share=100.0 * outcome.out_of_range / outcome.poses,
                largest=figure(outcome.out_of_range_um, "µm"),
            )
        )
    short = Message("It leads to the figure above: run the programs that `twin compensate` writes.")
    yield Step("do", _with_measured(Message("compensate the programs"), calibration), joined(" ", texts), short)


def _not_corrected(outcome: CompensationForecast) -> list[Message]:
    """Return the sentence on errors that could not be determined; none if there are none."""
    if not outcome.not_identified or outcome.with_uncertainty is None:
        return []
    text = Message(
        "This does not include {names}, which could not be determined and which no program corrects: with their plausible size {rms} "
        "RMS remain.",
        names=listed(outcome.not_identified),
        rms=figure(outcome.with_uncertainty.rms_um, "µm"),
    )
    return [text]


def _with_measured(what: Message, calibration: Calibration) -> str:
    """Return a title; for an illustrative calibration it states that measured numbers are needed."""
    return Message("With measured numbers: {what}", what=what) if calibration.illustrative else capital(what)


def _about(calibration: Calibration) -> str:
    file = "" if calibration.path is None else f" --calibration {calibration.path.name}"
    return f"{calibration.machine.as_option}{file}"


def _options(found: Budget, calibration: Calibration) -> str:
    """Return the options for machine, calibration, tool length, temperatures, time and spindle speed."""
    at = found.kinematics.conditions
    warm = "".join(f" {name}={value:g}" for name, value in at.temperature_degC.items())
    held = "".join(f" --{SETTINGS[name]} {at.channels[name]:g}" for name in SETTINGS if name in at.channels)
    tool = f" --tool-length {found.kinematics.tool_length_mm:g}"
    return f"{_about(calibration)}{tool}{' --temperature' if warm else ''}{warm}{held}"


def _kinematics(calibration: Calibration, found: Budget, outcome: CompensationForecast) -> Iterator[Step]:
    """Yield the entry of the rotary axes' locations in the control's kinematics, if they matter and the control can hold them."""
    if not has_table_kinematics(found.kinematics.machine) or (calibration.control and calibration.control.kinematics):
        return
    names = [error for error in found.errors if error.iso_class == LOCATION and not error.illustrative]
    significant = [error for error in names if isfinite(error.peak_half) and error.peak > error.peak_half]
    rest = found.rms_without_um(*(error.name for error in names)) if significant else found.total.rms_um
    if found.total.rms_um - rest < WORTH * found.total.rms_um:
        return
    sizes = {"start": figure(outcome.start.rms_um, "µm"), "rest": figure(outcome.with_u(rest), "µm")}
    texts = [
        Message(
            "{names}: the kinematics of tool centre point mode hold these values. RMS error at the tool in that mode: {start} "
            "before, {rest} after. `twin control --kinematics siemens-chain -o kinematics/{options}` writes them (other controls: "
            "`twin doc control`); `twin report --kinematics` shows them beside the present ones. Compensate programs and write tables "
            "with the `calibration.yaml` written beside them.",
            names=listed(
                [
                    Message("{words} ({size})", words=e.words, size=with_half(e.peak, e.peak_half, e.unit))
                    for e in significant
                ]
            ),
            options=_options(found, calibration),
            **sizes,
        )
    ]
    unknown = [
        error.name for error in calibration.not_identifiable if error.name in found.kinematics.machine.location_names
    ]
    if unknown:
        texts.append(Message("First determine {names}: without them no kinematics are written.", names=listed(unknown)))
    yield Step(
        "do",
        Message("Enter the location of the rotary axes in the control's kinematics"),
        joined(" ", texts),
        joined(
            " ",
            [
                Message(
                    "It removes {share:.0f} % of the RMS error in tool centre point mode.",
                    share=100.0 * (1.0 - rest / found.total.rms_um),
                ),
                *([Message("First determine {names}.", names=listed(unknown))] if unknown else []),
            ],
        ),
    )


def has_table_kinematics(machine: Machine) -> bool:
    """Return whether a control's kinematics can be written for a machine (`twin.controls.kinematics.format`)."""
    try:
        rotary_axes(machine)
    except InputError:
        return False
    return True


def _adjust(found: Budget) -> Iterator[Step]:
    """Yield mechanical adjustments of errors that are large and significant, without those that the control's kinematics can hold."""
    significant, without_interval, names = list[Message](), list[Message](), list[Message]()
    in_control = has_table_kinematics(found.kinematics.machine)
    for error in found.errors:
        if in_control and error.iso_class == LOCATION:
            continue
        # The RMS error cannot fall by more than that of the error removed.
        if error.iso_class not in MECHANICAL or error.illustrative or error.rms_um < WORTH * found.total.rms_um:
            continue
        rest = found.rms_without_um(error.name)
        if found.total.rms_um - rest < WORTH * found.total.rms_um:
            continue
        if not isfinite(error.peak_half):
            words = Message("{words} ({name})", words=lower(error.words), name=error.name)
            without_interval.append(words)
        elif error.peak > error.peak_half:
            size = with_half(error.peak, error.peak_half, error.unit)
            names.append(Message("{words} ({size})", words=error.words, size=size))
            significant.append(
                Message(
                    "{words} ({name}) by {size}: this reduces the error over the volume to {rms} RMS.",
                    words=error.words,
                    name=error.name,
                    size=size,
                    rms=figure(rest, "µm"),
                )
            )
    if significant:
        again = Message("Measure again after the adjustment: this calibration is then no longer valid.")
        short = Message("{names}; measure again afterwards.", names=listed(names))
        yield Step("do", Message("Adjust the machine mechanically"), joined(" ", [*significant, again]), short)
    if without_interval:
        text = Message("The uncertainty of {names} is unknown.", names=listed(without_interval))
        yield Step("measure", Message("Measure before any adjustment"), text)


def _tables(found: Budget, tables: Sequence[TablesLeft], outcome: CompensationForecast) -> Iterator[Step]:
    """Yield the compensation by tables in the control, computed as by `twin control`."""
    if not tables:
        return
    best = tables[0]
    # An error smaller than its own 95 % half-width is not significant.
    shown = {error.name for error in found.errors if error.rms_um > 0.0 and not error.peak <= error.peak_half}
    classes = {one.iso_class for one in best.carried if one.share != "no" and one.name in shown}
    names = [Message("{words} ({name})", words=words, name=name) for name, words in TABLES.items() if name in classes]
    if not names:
        return
    where = ", ".join(f"{name} {value:g}" for name, value in best.at.items()).replace("-", "−")
    text = Message(
        "They compensate {names} for all programs. RMS error at the tool: {rms} without tables; {remaining}. Valid for tool length "
        "{length:g} mm and the other axes at {where}.",
        names=listed(names),
        rms=figure(outcome.with_u(best.remains.before.rms_um), "µm"),
        remaining=joined("; ", [_remaining(table, outcome) for table in tables]),
        length=best.tool_length_mm,
        where=Number(where),
    )
    tables_left = best.remains.tables
    larger = outcome.with_u(tables_left.rms_um) >= best.remains.before.rms_um
    if best.remains.reduction >= WORTH and not larger:
        calibration = found.kinematics.calibration
        how = Message(
            "`twin control --to {kind} -o tables/{options}` writes the tables.",
            kind=best.kind,
            options=_options(found, calibration),
        )
        title = _with_measured(Message("use the control's axis tables"), calibration)
        short = Message(
            "They remove {share:.0f} % of the RMS error ({kind}).", share=100.0 * best.remains.reduction, kind=best.kind
        )
        yield Step("do", title, joined(" ", [text, how]), short)
    else:
        yield Step("never", Message("Rely on the control's axis tables alone"), text)


def _remaining(one: TablesLeft, outcome: CompensationForecast) -> str:
    """Return the remaining error with the tables of a format, with the meaning of the error before."""
    remaining = one.remains.tables
    if outcome.expected_before is None:
        return Message("{kind} {rms} by the model, U unknown", kind=one.kind, rms=figure(remaining.rms_um, "µm"))
    expected = expanded(outcome.with_u(remaining.rms_um), complete=not one.remains.uncertainty.least)
    return Message("{kind} {rms}", kind=one.kind, rms=expected)


def grouped_sentences(errors: Iterable[UnidentifiedEntry], what: Literal["why", "remedy"]) -> list[str]:
    """Return each reason, or remedy, once with the names of its errors."""
    names: dict[str, list[str]] = {}
    sentences = {text: text for error in errors if (text := getattr(error, what))}
    for error in errors:
        if text := getattr(error, what):
            names.setdefault(text, []).append(error.name)
    return [
        Message("{names}: {why}", names=listed(names[text]), why=text if isinstance(text, Message) else Quoted(text))
        for text in sentences
    ]


def _unknown(calibration: Calibration, outcome: CompensationForecast) -> Iterator[Step]:
    if not calibration.not_identifiable:
        return
    by_reason = grouped_sentences(calibration.not_identifiable, "why")
    reasons = by_reason[:NAMED]
    if len(by_reason) > NAMED:
        reasons.append(Message("{count} more: see the file of the calibration", count=len(by_reason) - NAMED))
    reasons += grouped_sentences(calibration.not_identifiable, "remedy")[:NAMED]
    texts = [Message("{reasons}.", reasons=joined(". ", reasons))]
    if outcome.not_identified:
        names = listed(outcome.not_identified)
        texts.append(Message("U at the tool includes the plausible size of {names} (machine file).", names=names))
    names = listed([error.name for error in calibration.not_identifiable])
    short = Message("{names}: page 2 says what to measure, and where.", names=names)
    yield Step("measure", Message("Determine the errors that were not identified"), joined(" ", texts), short)


def _measure(found: Budget, outcome: CompensationForecast, instrument: str | None) -> Iterator[Step]:
    known = [error for error in found.errors if isfinite(error.u_rms_um) and error.u_rms_um > 0.0]
    if not known:
        if found.errors:
            text = Message("U at the tool is unknown: the calibration gives no uncertainty.")
            yield Step("measure", Message("Determine the uncertainty"), joined(" ", [text, _IDENTIFY]), _IDENTIFY)
        return
    reasons = []
    if outcome.judged is not None and outcome.exact is not None and outcome.judged.rms_um > 2.0 * outcome.exact.rms_um:
        reasons = [Message("The error after compensation is mostly due to the uncertainty of the calibration.")]
    elif outcome.exact is None and found.total.u_rms_um > found.total.rms_um:
        size = figure(found.total.u_rms_um, "µm")
        reasons = [Message("U at the tool ({size}) exceeds the error itself.", size=size)]
    if reasons:
        weak = sorted(known, key=lambda one: -one.u_rms_um)[:NAMED]
        names = listed(
            [
                Message("{words} ({name}, U {u})", words=lower(one.words), name=one.name, u=figure(one.u_rms_um, "µm"))
                for one in weak
            ]
        )
        reduce = " ".join(one.name for one in weak if one.name.startswith("E_")) or "tool"
        aim = f"--reduce {reduce}" if instrument is None else f"--instrument {instrument}"
        largest = Message(
            "Largest uncertainties: {names}. `twin plan -o plan.csv{machine} {aim}` plans the measurement.",
            names=names,
            machine=found.kinematics.machine.as_option,
            aim=aim,
        )
        short = Message("{names}.", names=names)
        title = Message("Measure the most uncertain errors again")
        yield Step("measure", title, joined(" ", [*reasons, largest]), short)
    if found.without_uncertainty:
        text = Message(
            "{names}: the calibration gives a value but no uncertainty.", names=listed(found.without_uncertainty)
        )
        yield Step("unknown", Message("U is a lower bound"), text)


def _void(calibration: Calibration, settled: bool) -> Iterator[Step]:
    """Yield reasons against any use of the numbers."""
    drawn = sum(curve.illustrative for curve in calibration.curves.values())
    if drawn:
        text = Message(
            "{count} of its {all} error motions are ILLUSTRATIVE: assumed, not measured. The numbers below are an example of a report "
            "and do not describe your machine.",
            count=drawn,
            all=len(calibration.curves),
        )
        yield Step("never", Message("Use this calibration for compensation, adjustment or tables"), text)
    if not settled:
        yield Step("never", Message("Use this calibration"), Message("The identification did not converge."))


def _never(calibration: Calibration, found: Budget) -> Iterator[Step]:
    insignificant = [
        Message("{words} ({size})", words=lower(error.words), size=with_half(error.peak, error.peak_half, error.unit))
        for error in found.errors
        if error.iso_class in MECHANICAL and isfinite(error.peak_half) and 0.0 < error.peak <= error.peak_half
    ]
    if insignificant:
        text = Message("{names}: smaller than its uncertainty.", names=listed(insignificant))
        yield Step("never", Message("Adjust errors that are not significant"), text)
    if found.total.rms_um > 0.0 and not calibration.illustrative and not calibration.corrected_in_control:
        text = Message(
            "If the control's tables are active, compensate programs only with the `calibration.yaml` written beside them, which "
            "contains what the tables correct. Do not use this calibration after the machine was adjusted."
        )
        yield Step("never", Message("Correct the same error twice"), text)
    tilts = [error.name for error in found.errors if error.unit == "urad" and error.peak > 0.0 and error.rms_um == 0.0]
    if tilts and found.kinematics.tool_length_mm == 0.0:
        text = Message(
            "At tool length 0 mm, {names} have no effect: give the tool length in use with `--tool-length`.",
            names=listed(tilts),
        )
        yield Step("unknown", Message("Computed for tool length zero"), text)
