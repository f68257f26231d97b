"""What follows from the numbers, in words a shop can act on: what is wrong most, what to do, what to measure, what never."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, Final, Literal, final

from twin._common.json_form import json_form
from twin.diagnosis.words import listed, lower
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
class Advice:
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
) -> Advice:
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
    total = found.total.rms_um
    if not found.errors and not left_out:
        return Advice(
            "This calibration says nothing is wrong: it names no error.",
            "unknown",
            (),
            (
                Step("measure", "Measure it", "A file without errors is no perfect machine. " + _IDENTIFY),
                Step(
                    "never", "Take it for accurate", "Every error of this machine counts as zero here: nobody has told."
                ),
            ),
        )
    headline = (
        f"The tool point is off by {figure(total, 'µm')} RMS over the working volume, and by up to "
        f"{figure(found.total.max_um, 'µm')}."
    )
    steps = [
        *_illustrative(calibration),
        *_incomplete(left_out, identified),
        *_settled(calibration.settled and (identified is None or identified.file.converged)),
        *_misfit(points, calibration),
        *_control(calibration, outcome),
        *_one_of(
            _compensate(calibration, found, outcome),
            _adjust(found),
            _tables(found, tables),
        ),
        *_measure(found, outcome),
        *_never(calibration, found),
    ]
    return Advice(
        headline,
        "well" if found.total.max_um <= SMALL_UM else "wrong",
        tuple(_line(one) for one in found.errors[:NAMED]),
        tuple(sorted(steps, key=lambda step: _ORDER.index(step.kind))),
    )


def _one_of(*ways: list[Step]) -> list[Step]:
    """Ways to the same end, of which one is enough: each to be done after the first begins with "Or"."""
    found: list[Step] = []
    for step in (step for way in ways for step in way):
        again = step.kind == "do" and any(one.kind == "do" for one in found)
        found.append(replace(step, title=f"Or {lower(step.title)}") if again else step)
    return found


_ORDER: Final = ("unknown", "do", "measure", "never")
_IDENTIFY: Final = (
    "`twin plan` says where, `twin identify` makes a calibration of it, with its uncertainty; `twin report` shows that."
)


def _line(one: Contribution) -> str:
    return (
        f"{one.words} ({one.name}): up to {with_half(one.peak, one.peak_half, one.unit)}, which makes "
        f"{figure(one.rms_um, 'µm')} RMS at the tool, up to {figure(one.max_um, 'µm')} "
        f"(U {expanded(one.u_rms_um, complete=one.u_complete)})"
    )


def _illustrative(calibration: Calibration) -> list[Step]:
    drawn = [curve.name for curve in calibration.curves.values() if curve.illustrative]
    if not drawn:
        return []
    return [
        Step(
            "never",
            "Cut, adjust or fill tables with this calibration",
            f"{len(drawn)} of its {len(calibration.curves)} error motions are ILLUSTRATIVE: drawn, not measured. The numbers "
            "below show what such a report looks like, nothing about your machine.",
        )
    ]


def _incomplete(left_out: Mapping[str, tuple[str, ...]], identified: Identified | None) -> list[Step]:
    steps = [
        Step(
            "unknown",
            f"{listed(names)} left out",
            f"It depends on {channel}, which nobody gave: {options_of([channel])}. Every number here is without it.",
        )
        for channel, names in left_out.items()
    ]
    if identified is None:
        return steps
    if identified.others:
        steps.append(
            Step(
                "unknown",
                "The identification is not this calibration's",
                f"{identified.path.name} gives other numbers for {listed(identified.others)}: it belongs to another calibration, or "
                "this one was changed since. What it says of the fit does not hold for these numbers.",
            )
        )
    fit = identified.file.misfit
    lack = fit.lack_of_fit_p_value
    if lack is not None and lack < REPEATS:
        steps.append(
            Step(
                "measure",
                "Find out what the model leaves out",
                f"The readings differ from the model by something that repeats (reduced chi² {fit.reduced_chi2:.3g}): the "
                "uncertainties here do not cover it. `twin diagnose` names it.",
            )
        )
    elif fit.p_value is not None and fit.p_value < REPEATS:
        steps.append(
            Step(
                "measure",
                "See why the readings scatter",
                f"They scatter more than was stated (reduced chi² {fit.reduced_chi2:.3g}): the uncertainties here are too "
                "small. Identify again with `--uncertainty repeats`, or `twin diagnose`.",
            )
        )
    return steps


def _settled(settled: bool) -> list[Step]:
    return [] if settled else [Step("never", "Use this calibration", "The estimate it comes from did not settle.")]


def _misfit(points: Sequence[Checked], calibration: Calibration) -> list[Step]:
    """Of measured points that this calibration does not explain."""
    return [
        Step(
            "measure",
            "Find out why points do not fit",
            f"{one.far:,} of the {one.points:,} points of {Path(one.source).name} are further off than scatter goes "
            f"({figure(one.rms_after_um, 'µm')} RMS a coordinate over all). "
            f"`twin diagnose {Path(one.source).name}{_about(calibration)}` names the cause.",
        )
        for one in points
        if one.far
    ]


def _control(calibration: Calibration, outcome: After) -> list[Step]:
    control = calibration.control
    if control is None:
        return []
    alike: dict[tuple[str, ...], list[str]] = {}
    for one in control.tables:
        alike.setdefault(one.classes, []).append(one.file.name)
    names = "; ".join(f"{listed(files)}: {' '.join(classes)}" for classes, files in alike.items())
    if control.errors_are == "remaining":
        text = f"These errors were measured with its tables on ({names}): they are what is left. A new table is added to them."
        text += f" {control.caution}" if control.caution else ""
    else:
        bare = outcome.bare
        was = (
            ""
            if bare is None
            else f", from {figure(bare.rms_um, 'µm')} to {figure(outcome.before.rms_um, 'µm')} RMS at the tool"
        )
        text = (
            f"Its tables ({names}) take their part out by themselves{was}. All numbers here are with them switched on."
        )
    return [Step("do", "Leave the control's tables on", text)]


def _compensate(calibration: Calibration, found: Budget, outcome: After) -> list[Step]:
    if outcome.exact is None:
        return [
            Step(
                "unknown", "No programs on this machine", "Compensation needs three linear and at most two rotary axes."
            )
        ]
    if found.total.rms_um <= 0.0:
        return []
    how = f"`twin compensate part.nc -o part.compensated.nc{_about(calibration)}{_tool(found)}{_conditions(found)}`"
    start = figure(outcome.before.rms_um, "µm")
    if outcome.likely is None:
        text = (
            f"{how}. From {start} RMS to {figure(outcome.exact.rms_um, 'µm')} if the calibration were exactly true. What it really "
            f"leaves is {UNKNOWN}: the calibration gives no uncertainty."
        )
    else:
        least = "" if outcome.complete else "at least "
        text = (
            f"{how}. From {start} RMS to {least}{figure(outcome.likely.rms_um, 'µm')} to be expected "
            f"({figure(outcome.exact.rms_um, 'µm')} if the calibration were exactly true); 95 % of positions within "
            f"{least}{figure(outcome.likely.quantile(0.95), 'µm')}."
        )
    if outcome.out_of_range:
        share = 100.0 * outcome.out_of_range / outcome.poses
        text += (
            f" At {share:.2g} % of the positions, at the ends of the travel, the correction asks for more than the axes have: up to "
            f"{figure(outcome.out_of_range_um, 'µm')} stays there."
        )
    return [Step("do", _with_measured("compensate the programs", calibration), text)]


def _with_measured(what: str, calibration: Calibration) -> str:
    """A title: what is not to be done with these numbers is said to be for others."""
    return f"With measured numbers: {what}" if calibration.illustrative else f"{what[0].upper()}{what[1:]}"


def _about(calibration: Calibration) -> str:
    """The options that name machine and calibration."""
    file = "" if calibration.path is None else f" --calibration {calibration.path.name}"
    return f"{calibration.machine.as_option}{file}"


def _conditions(found: Budget) -> str:
    """The options that give what the numbers were taken at."""
    at = found.kinematics.conditions
    warm = "".join(f" {name}={value:g}" for name, value in at.temperature_degC.items())
    return f"{' --temperature' if warm else ''}{warm}{'' if at.time_s is None else f' --time {at.time_s:g}'}"


def _adjust(found: Budget) -> list[Step]:
    """What a mechanic could put right, where it is large enough and known to be there."""
    done, doubted = [], []
    for one in found.errors:
        if one.iso_class not in MECHANICAL or one.illustrative:
            continue
        saved = found.total.rms_um - found.rms_without_um(one.name)
        size = with_half(one.peak, one.peak_half, one.unit)
        if not isfinite(one.peak_half):
            if saved >= WORTH * found.total.rms_um:
                doubted.append(f"{lower(one.words)} ({one.name})")
        elif one.peak > one.peak_half and saved >= WORTH * found.total.rms_um:
            rest = found.total.rms_um - saved
            done.append(f"{one.words} ({one.name}) by {size}: put right, the volume comes to {figure(rest, 'µm')} RMS.")
    steps = []
    if done:
        text = f"{' '.join(done)} Service, by mechanical alignment; afterwards measure again: this calibration then no longer holds."
        steps.append(Step("do", "Have it adjusted", text))
    if doubted:
        steps.append(
            Step(
                "measure",
                "Before anything is adjusted",
                f"How well {listed(doubted)} is known is {UNKNOWN}: measure it first.",
            )
        )
    return steps


def _tables(found: Budget, tables: Sequence[TablesLeft]) -> list[Step]:
    """What the control's own tables could take out, as `twin control` works it out."""
    if not tables:
        return []
    best = tables[0]
    # An error within its own 95 % half-width is not shown to be there: nothing is promised of it.
    shown = {one.name for one in found.errors if one.rms_um > 0.0 and not one.peak <= one.peak_half}
    classes = {one.iso_class for one in best.carried if one.share != "no" and one.name in shown}
    names = [f"{words} ({name})" for name, words in TABLES.items() if name in classes]
    if not names:
        return []
    where = ", ".join(f"{name} {value:g}" for name, value in best.at.items())
    text = (
        f"They take out {listed(names)} for all programs at once. RMS at the tool, {figure(best.remains.before.rms_um, 'µm')} without: "
        f"{'; '.join(_leaves(one) for one in tables)}. For tool length {best.tool_length_mm:g} mm, with the other axes at {where}."
    )
    if best.remains.worth >= WORTH:
        calibration = found.kinematics.calibration
        title = _with_measured("fill the control's axis tables", calibration)
        how = f"twin control --to {best.kind} -o tables/{_about(calibration)}{_tool(found)}{_conditions(found)}"
        return [Step("do", title, f"{text} `{how}` writes them.")]
    return [Step("never", "Expect much of the control's axis tables alone", text)]


def _leaves(one: TablesLeft) -> str:
    """What the tables of a format leave, by the model and with what is not known."""
    left, u = one.remains.tables, one.remains.known_to
    expected = f"{u.least}{figure(left.expected_rms_um, 'µm')} to be expected" if isfinite(u.rms_um) else f"U {UNKNOWN}"
    return f"{one.kind} {figure(left.rms_um, 'µm')} by the model, {expected}"


def _tool(found: Budget) -> str:
    return f" --tool-length {found.kinematics.tool_length_mm:g}"


def _measure(found: Budget, outcome: After) -> list[Step]:
    known = [one for one in found.errors if isfinite(one.u_rms_um) and one.u_rms_um > 0.0]
    if not known:
        if not found.errors:
            return []
        return [
            Step(
                "measure", "How sure this is", f"U at the tool is {UNKNOWN}: no number has an uncertainty. {_IDENTIFY}"
            )
        ]
    steps = []
    weak = sorted(known, key=lambda one: -one.u_rms_um)[:NAMED]
    what = None
    if outcome.likely is not None and outcome.exact is not None and outcome.likely.rms_um > 2.0 * outcome.exact.rms_um:
        what = "What compensation leaves is mostly what is not known"
    elif outcome.exact is None and found.total.u_rms_um > found.total.rms_um:
        what = f"U at the tool ({figure(found.total.u_rms_um, 'µm')}) is more than the error itself. Known worst"
    if what is not None:
        names = listed([f"{lower(one.words)} ({one.name}, U {figure(one.u_rms_um, 'µm')})" for one in weak])
        reduce = " ".join(one.name for one in weak if one.name.startswith("E_"))
        text = (
            f"{what}: {names}. `twin plan -o plan.csv{found.kinematics.machine.as_option} --reduce {reduce or 'tool'}`"
        )
        steps.append(Step("measure", "Measure again what is known worst", f"{text} says where to measure."))
    if found.without_uncertainty:
        steps.append(
            Step("unknown", "U is a lower bound", f"{listed(found.without_uncertainty)}: a value, but no uncertainty.")
        )
    return steps


def _never(calibration: Calibration, found: Budget) -> list[Step]:
    steps = []
    unproven = [
        f"{lower(one.words)} ({with_half(one.peak, one.peak_half, one.unit)})"
        for one in found.errors
        if one.iso_class in MECHANICAL and isfinite(one.peak_half) and 0.0 < one.peak <= one.peak_half
    ]
    if unproven:
        steps.append(
            Step("never", "Adjust what is not proven", f"{listed(unproven)}: smaller than its own uncertainty.")
        )
    if found.total.rms_um > 0.0 and not calibration.illustrative:
        steps.append(
            Step(
                "never",
                "Correct the same error twice",
                "In the control's tables and in the programs, or adjusted and still in this calibration. What is changed at the "
                "machine makes this calibration void for it.",
            )
        )
    tilts = [one for one in found.errors if one.unit == "urad" and one.peak > 0.0 and one.rms_um == 0.0]
    if tilts and found.kinematics.tool_length_mm == 0.0:
        steps.append(
            Step(
                "unknown",
                "Taken without a tool",
                f"At tool length 0 mm {listed([one.name for one in tilts])} show nothing: say `--tool-length` as it is used.",
            )
        )
    return steps
