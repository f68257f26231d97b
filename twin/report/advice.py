"""What follows from the numbers, in words a shop can act on: what is wrong most, what to do, what to measure, what never."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any, Final, Literal, final

from twin._common.json_form import json_form
from twin.diagnosis.wording.words import capital, listed, lower
from twin.display import UNKNOWN, expanded, figure, with_half
from twin.machine.calibration import Calibration
from twin.machine.conditions import options_of
from twin.report.after import After
from twin.report.contributions import Budget, Contribution
from twin.report.identified import Identified
from twin.report.readings import Checked
from twin.report.tables import TablesLeft

Kind = Literal["do", "measure", "never", "unknown"]
Mood = Literal["well", "wrong", "unknown"]
NAMED: Final = 3
WORTH: Final = 0.05
"""Share of the error over the volume that a step must take away to be worth a visit to the machine."""
MECHANICAL: Final = ("L-SQU", "R-POR")
TABLES: Final = {
    "L-POS": "positioning",
    "L-STR": "straightness",
    "L-SQU": "squareness",
    "L-ANG": "tilts of the linear axes",
    "R-POS": "angular positioning",
}
"""What tables of axes take out, by class."""
SMALL_UM: Final = 2.0
"""About what rounding to a µm of three axes, and splitting, leave: what is smaller is nothing to act on."""
REPEATS: Final = 1e-3


@final
@dataclass(frozen=True)
class Step:
    """One thing to do or to leave.

    Attributes:
        kind: ``do``, ``measure``, ``never`` or ``unknown``.
        title: in a few words.
        text: with its numbers.
    """

    kind: Kind
    title: str
    text: str


@final
@dataclass(frozen=True)
class MachineAdvice:
    """The first screen.

    Attributes:
        headline: one sentence.
        mood: how it is coloured.
        wrong: what is wrong most, a line each.
        steps: what to do, to measure, to leave.
    """

    headline: str
    mood: Mood
    wrong: tuple[str, ...]
    steps: tuple[Step, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return json_form(self, rename={"wrong": "wrong_most"}, leave_out=("mood",))


def advise(
    calibration: Calibration,
    found: Budget,
    outcome: After,
    identified: Identified | None,
    left_out: Mapping[str, tuple[str, ...]],
    points: Sequence[Checked] = (),
    tables: Sequence[TablesLeft] = (),
) -> MachineAdvice:
    """Put the numbers into words.

    Args:
        calibration: as given.
        found: what each error makes.
        outcome: what compensation would leave.
        identified: what `identify` said, or None.
        left_out: effects that could not be worked out, by channel.
        points: measured ones against the calibration.
        tables: what tables in the control would leave, the best first; none where they are in use already.
    """
    rms, most = (figure(size, "µm") for size in (found.total.rms_um, found.total.max_um))
    if not found.errors and not left_out:
        steps = (
            Step("measure", "Measure it", f"A file without errors is no perfect machine. {_IDENTIFY}"),
            Step("never", "Take it for accurate", "Every error of this machine counts as zero here: nobody has told."),
        )
        return MachineAdvice("This calibration says nothing is wrong: it names no error.", "unknown", (), steps)
    every = [
        *_void(calibration, calibration.settled and (identified is None or identified.file.converged)),
        *_incomplete(left_out, identified),
        *_misfit(points, calibration),
        *_control(calibration, outcome),
        *_one_of(_compensate(calibration, found, outcome), _adjust(found), _tables(found, tables)),
        *_measure(found, outcome),
        *_never(calibration, found),
    ]
    return MachineAdvice(
        f"The tool point is off by {rms} RMS over the working volume, and by up to {most}.",
        "well" if found.total.max_um <= SMALL_UM else "wrong",
        tuple(_line(one) for one in found.errors[:NAMED]),
        tuple(sorted(every, key=lambda step: _ORDER.index(step.kind))),
    )


_ORDER: Final = ("unknown", "do", "measure", "never")
_IDENTIFY: Final = (
    "`twin plan` says where, `twin identify` makes a calibration of it, with its uncertainty; `twin report` shows that."
)


def _one_of(*ways: Iterator[Step]) -> Iterator[Step]:
    """Ways to the same end, of which one is enough: each to be done after the first begins with "Or"."""
    again = False
    for step in chain(*ways):
        yield replace(step, title=f"Or {lower(step.title)}") if again and step.kind == "do" else step
        again = again or step.kind == "do"


def _line(one: Contribution) -> str:
    return (
        f"{one.words} ({one.name}): up to {with_half(one.peak, one.peak_half, one.unit)}, which makes "
        f"{figure(one.rms_um, 'µm')} RMS at the tool, up to {figure(one.max_um, 'µm')} "
        f"(U {expanded(one.u_rms_um, complete=one.u_complete)})"
    )


def _incomplete(left_out: Mapping[str, tuple[str, ...]], identified: Identified | None) -> Iterator[Step]:
    for channel, names in left_out.items():
        text = f"It depends on {channel}, which nobody gave: {options_of([channel])}. Every number here is without it."
        yield Step("unknown", f"{listed(names)} left out", text)
    if identified is None:
        return
    if identified.others:
        text = (
            f"{identified.path.name} gives other numbers for {listed(identified.others)}: it belongs to another calibration, or "
            "this one was changed since. What it says of the fit does not hold for these numbers."
        )
        yield Step("unknown", "The identification is not this calibration's", text)
    fit = identified.file.misfit
    if fit.lack_of_fit_p_value is not None and fit.lack_of_fit_p_value < REPEATS:
        text = (
            f"The readings differ from the model by something that repeats (reduced chi² {fit.reduced_chi2:.3g}): the "
            "uncertainties here do not cover it. `twin diagnose` names it."
        )
        yield Step("measure", "Find out what the model leaves out", text)
    elif fit.p_value is not None and fit.p_value < REPEATS:
        text = (
            f"They scatter more than was stated (reduced chi² {fit.reduced_chi2:.3g}): the uncertainties here are too "
            "small. Identify again with `--uncertainty repeats`, or `twin diagnose`."
        )
        yield Step("measure", "See why the readings scatter", text)


def _misfit(points: Sequence[Checked], calibration: Calibration) -> Iterator[Step]:
    """Of measured points that this calibration does not explain."""
    for one in points:
        if one.far:
            name, left = Path(one.source).name, figure(one.rms_after_um, "µm")
            text = (
                f"{one.far:,} of the {one.points:,} points of {name} are further off than scatter goes "
                f"({left} RMS a coordinate over all). `twin diagnose {name}{_about(calibration)}` names the cause."
            )
            yield Step("measure", "Find out why points do not fit", text)


def _control(calibration: Calibration, outcome: After) -> Iterator[Step]:
    control, bare = calibration.control, outcome.bare
    if control is None:
        return
    alike: dict[tuple[str, ...], list[str]] = {}
    for one in control.tables:
        alike.setdefault(one.classes, []).append(one.file.name)
    names = "; ".join(f"{listed(files)}: {' '.join(classes)}" for classes, files in alike.items())
    if control.errors_are == "remaining":
        text = f"These errors were measured with its tables on ({names}): they are what is left. A new table is added to them."
        text += f" {control.caution}" if control.caution else ""
    else:
        ends = None if bare is None else [figure(level.rms_um, "µm") for level in (bare, outcome.before)]
        was = "" if ends is None else f", from {ends[0]} to {ends[1]} RMS at the tool"
        text = (
            f"Its tables ({names}) take their part out by themselves{was}. All numbers here are with them switched on."
        )
    yield Step("do", "Leave the control's tables on", text)


def _compensate(calibration: Calibration, found: Budget, outcome: After) -> Iterator[Step]:
    if outcome.exact is None:
        text = "Compensation needs three linear and at most two rotary axes."
        yield Step("unknown", "No programs on this machine", text)
        return
    if found.total.rms_um <= 0.0:
        return
    start, exact = (figure(level.rms_um, "µm") for level in (outcome.before, outcome.exact))
    text = f"`twin compensate part.nc -o part.compensated.nc{_options(found, calibration)}`. From {start} RMS to "
    if outcome.likely is None:
        text += (
            f"{exact} if the calibration were exactly true. What it really leaves is {UNKNOWN}: the calibration gives no "
            "uncertainty."
        )
    else:
        least = "" if outcome.complete else "at least "
        text += (
            f"{least}{figure(outcome.likely.rms_um, 'µm')} to be expected ({exact} if the calibration were exactly true); 95 % of "
            f"positions within {least}{figure(outcome.likely.quantile(0.95), 'µm')}."
        )
    if outcome.out_of_range:
        share = 100.0 * outcome.out_of_range / outcome.poses
        text += (
            f" At {share:.2g} % of the positions, at the ends of the travel, the correction asks for more than the axes have: up to "
            f"{figure(outcome.out_of_range_um, 'µm')} stays there."
        )
    yield Step("do", _with_measured("compensate the programs", calibration), text)


def _with_measured(what: str, calibration: Calibration) -> str:
    """A title: what is not to be done with these numbers is said to be for others."""
    return f"With measured numbers: {what}" if calibration.illustrative else capital(what)


def _about(calibration: Calibration) -> str:
    """The options that name machine and calibration."""
    file = "" if calibration.path is None else f" --calibration {calibration.path.name}"
    return f"{calibration.machine.as_option}{file}"


def _options(found: Budget, calibration: Calibration) -> str:
    """Those, and the options that give the tool and what the numbers were taken at."""
    at = found.kinematics.conditions
    warm = "".join(f" {name}={value:g}" for name, value in at.temperature_degC.items())
    time = "" if at.time_s is None else f" --time {at.time_s:g}"
    tool = f" --tool-length {found.kinematics.tool_length_mm:g}"
    return f"{_about(calibration)}{tool}{' --temperature' if warm else ''}{warm}{time}"


def _adjust(found: Budget) -> Iterator[Step]:
    """What a mechanic could put right, where it is large enough and known to be there."""
    done, doubted = [], []
    for one in found.errors:
        if one.iso_class not in MECHANICAL or one.illustrative:
            continue
        rest = found.rms_without_um(one.name)
        if found.total.rms_um - rest < WORTH * found.total.rms_um:
            continue
        if not isfinite(one.peak_half):
            doubted.append(f"{lower(one.words)} ({one.name})")
        elif one.peak > one.peak_half:
            size = with_half(one.peak, one.peak_half, one.unit)
            done.append(f"{one.words} ({one.name}) by {size}: put right, the volume comes to {figure(rest, 'µm')} RMS.")
    if done:
        text = f"{' '.join(done)} Service, by mechanical alignment; afterwards measure again: this calibration then no longer holds."
        yield Step("do", "Have it adjusted", text)
    if doubted:
        text = f"How well {listed(doubted)} is known is {UNKNOWN}: measure it first."
        yield Step("measure", "Before anything is adjusted", text)


def _tables(found: Budget, tables: Sequence[TablesLeft]) -> Iterator[Step]:
    """What the control's own tables could take out, as `twin control` works it out."""
    if not tables:
        return
    best = tables[0]
    # An error within its own 95 % half-width is not shown to be there: nothing is promised of it.
    shown = {one.name for one in found.errors if one.rms_um > 0.0 and not one.peak <= one.peak_half}
    classes = {one.iso_class for one in best.carried if one.share != "no" and one.name in shown}
    names = [f"{words} ({name})" for name, words in TABLES.items() if name in classes]
    if not names:
        return
    where = ", ".join(f"{name} {value:g}" for name, value in best.at.items())
    text = (
        f"They take out {listed(names)} for all programs at once. RMS at the tool, {figure(best.remains.before.rms_um, 'µm')} without: "
        f"{'; '.join(_leaves(one) for one in tables)}. For tool length {best.tool_length_mm:g} mm, with the other axes at {where}."
    )
    if best.remains.reduction >= WORTH:
        calibration = found.kinematics.calibration
        how = f"`twin control --to {best.kind} -o tables/{_options(found, calibration)}` writes them."
        yield Step("do", _with_measured("fill the control's axis tables", calibration), f"{text} {how}")
    else:
        yield Step("never", "Expect much of the control's axis tables alone", text)


def _leaves(one: TablesLeft) -> str:
    """What the tables of a format leave, by the model and with what is not known."""
    left, u = one.remains.tables, one.remains.uncertainty
    expected = f"{u.least}{figure(left.expected_rms_um, 'µm')} to be expected" if isfinite(u.rms_um) else f"U {UNKNOWN}"
    return f"{one.kind} {figure(left.rms_um, 'µm')} by the model, {expected}"


def _measure(found: Budget, outcome: After) -> Iterator[Step]:
    known = [one for one in found.errors if isfinite(one.u_rms_um) and one.u_rms_um > 0.0]
    if not known:
        if found.errors:
            text = f"U at the tool is {UNKNOWN}: no number has an uncertainty. {_IDENTIFY}"
            yield Step("measure", "How sure this is", text)
        return
    what = ""
    if outcome.likely is not None and outcome.exact is not None and outcome.likely.rms_um > 2.0 * outcome.exact.rms_um:
        what = "What compensation leaves is mostly what is not known"
    elif outcome.exact is None and found.total.u_rms_um > found.total.rms_um:
        what = f"U at the tool ({figure(found.total.u_rms_um, 'µm')}) is more than the error itself. Known worst"
    if what:
        weak = sorted(known, key=lambda one: -one.u_rms_um)[:NAMED]
        names = listed([f"{lower(one.words)} ({one.name}, U {figure(one.u_rms_um, 'µm')})" for one in weak])
        reduce = " ".join(one.name for one in weak if one.name.startswith("E_")) or "tool"
        how = f"`twin plan -o plan.csv{found.kinematics.machine.as_option} --reduce {reduce}` says where to measure."
        yield Step("measure", "Measure again what is known worst", f"{what}: {names}. {how}")
    if found.without_uncertainty:
        text = f"{listed(found.without_uncertainty)}: a value, but no uncertainty."
        yield Step("unknown", "U is a lower bound", text)


def _void(calibration: Calibration, settled: bool) -> Iterator[Step]:
    """What forbids every use of the numbers."""
    drawn = sum(curve.illustrative for curve in calibration.curves.values())
    if drawn:
        text = (
            f"{drawn} of its {len(calibration.curves)} error motions are ILLUSTRATIVE: drawn, not measured. The numbers "
            "below show what such a report looks like, nothing about your machine."
        )
        yield Step("never", "Cut, adjust or fill tables with this calibration", text)
    if not settled:
        yield Step("never", "Use this calibration", "The estimate it comes from did not settle.")


def _never(calibration: Calibration, found: Budget) -> Iterator[Step]:
    unproven = [
        f"{lower(one.words)} ({with_half(one.peak, one.peak_half, one.unit)})"
        for one in found.errors
        if one.iso_class in MECHANICAL and isfinite(one.peak_half) and 0.0 < one.peak <= one.peak_half
    ]
    if unproven:
        yield Step("never", "Adjust what is not proven", f"{listed(unproven)}: smaller than its own uncertainty.")
    if found.total.rms_um > 0.0 and not calibration.illustrative:
        text = (
            "In the control's tables and in the programs, or adjusted and still in this calibration. What is changed at the "
            "machine makes this calibration void for it."
        )
        yield Step("never", "Correct the same error twice", text)
    tilts = [one.name for one in found.errors if one.unit == "urad" and one.peak > 0.0 and one.rms_um == 0.0]
    if tilts and found.kinematics.tool_length_mm == 0.0:
        text = f"At tool length 0 mm {listed(tilts)} show nothing: say `--tool-length` as it is used."
        yield Step("unknown", "Taken without a tool", text)
