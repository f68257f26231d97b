"""A diagnosis in words: names and advice, and the verdict.

The report, the text and the notebook all take their words from here. The symbols (ISO 230-1 names, ``reversal Y``) are given with them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import ceil, exp, floor, isfinite, isnan, log10
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.messages import Message, Number, joined, parts
from twin._common.provenance import CORRECTED_IN_CONTROL
from twin.diagnosis.candidates import SPECIFICATIONS
from twin.diagnosis.result import Cause, DiagnosisResult, Extension, Unexplained
from twin.display.numbers import (
    COVERAGE_FACTOR,
    capital,
    either,
    figure,
    listed,
    lower,
)
from twin.model.effects.base import axis_of
from twin.model.effects.specification import Advice, Kind, title_of

RULED_OUT_CHI2: Final = 25.0  # expected χ² between the predictions of two causes that rules one of them out
INSTEAD_DESCRIBED: Final = 3  # number of other sets of columns that are described in a sentence
BELOW_INCREMENT: Final = (
    "Nothing: the error is below the least increment of the axes, so no command and no compensation can correct it."
)
LEAST_REST: Final = 0.01  # smallest share of the excess that is stated beside causes and pattern
PARAMETERS: Final[Mapping[str, Message]] = {
    "amplitude": Message("amplitude"),
    "angle": Message("angle"),
    "coefficient": Message("coefficient"),
    "largest": Message("largest value"),
    "offset": Message("offset"),
    "order": Message("order"),
    "rate": Message("rate"),
    "size": Message("size"),
    "time_constant": Message("time constant"),
}
"""Names in words of the parameters that most causes have."""
MOST_READINGS: Final = 1000.0  # number of readings at one position above which the measurement is not suggested
MOST_IN_ONE_COURSE: Final = 30.0  # the same, where another course of time and temperatures separates them


def micrometres(value: float) -> str:
    """Return a size in µm with two significant digits and no exponent."""
    return figure(value, "µm", digits=2)


def kind(effect: str) -> Kind:
    """Return whether it is an error of the machine, of the calibration file or of the instrument."""
    return SPECIFICATIONS[effect].kind


def symbol(effect: str, where: str) -> str:
    """Return effect and place as in the JSON: ``reversal Y``."""
    return effect if where == "—" else f"{effect} {where}"


def named(effect: str, where: str) -> str:
    """Return the name of a cause in words, and its symbol in brackets."""
    return joined("", [cause_title(effect, where), f" ({symbol(effect, where)})"])


def parameter(name: str) -> str:
    """Return the name of a parameter of a cause in words."""
    return PARAMETERS.get(name, name.replace("_", " "))


def cause_title(effect: str, where: str) -> str:
    """Return the name of a cause in words, without symbols."""
    return title_of(SPECIFICATIONS.get(effect), effect, where)


def family(effect: str) -> str:
    """Return the plural name of all causes of one effect."""
    return SPECIFICATIONS[effect].plural


def advice(effect: str, where: str) -> Advice:
    """Return where to look for a cause, what to do about it, and what to avoid."""
    given, axis = SPECIFICATIONS[effect].advice, axis_of(where)
    return Advice(*(Message(text, axis=axis, where=where) for text in (given.look, given.do, given.never)))


def column(name: str) -> str:
    """Return a column of the table in words: ``approach_Y`` → the approach direction of Y."""
    if name.startswith("approach_"):
        return Message("the approach direction of {axis}", axis=name.removeprefix("approach_"))
    if name.startswith("T_") and name.endswith("_degC"):
        return Message("the temperature of {name}", name=name[2:-5])
    if name.startswith("readback_"):
        return Message("the position of {axis} reported by the control", axis=name.split("_")[1])
    return {"time_s": Message("time"), "round": Message("the round")}.get(name, name.rsplit("_", 1)[0])


def side(carrier: str) -> str:
    """Return in words which points a statement is about."""
    return {"tool": Message("points on the tool side"), "work": Message("points on the work side")}.get(
        carrier, Message("points on both sides")
    )


def grouped(keys: Iterable[tuple[str, str]]) -> list[str]:
    """Return one line per effect with its places: ``zero offsets: X, Y and Z``."""
    by_effect: dict[str, list[str]] = {}
    for effect, where in keys:
        by_effect.setdefault(effect, []).append(where)
    return [joined(": ", [family(effect), listed(places)]) for effect, places in by_effect.items()]


def missing(entries: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return one line per missing column with the effects that need it, from (effect, where, missing column)."""
    by_column: dict[str, dict[str, list[str]]] = {}
    for effect, where, wanted in entries:
        by_column.setdefault(wanted, {}).setdefault(effect, []).append(where)
    shown: dict[str, list[str]] = {}
    for wanted, effects in by_column.items():
        shown.setdefault(joined(", ", [family(effect) for effect in effects]), []).append(wanted)
    return [joined(": ", [listed(columns), families]) for families, columns in shown.items()]


def measured(value: float, u: float, unit: str) -> str:
    """Return a value with its 95 % interval to two digits of the interval (9.29 ± 0.51 µm), or words if either is not finite."""
    sign = "" if unit == "1" else f" {unit}"
    if not isfinite(value):
        return Message("not determined")
    if not isfinite(u):
        return Message("{value}, uncertainty unknown", value=Number(f"{value:.4g}{sign}".replace("-", "−")))
    if u <= 0.0:
        return Number(f"{value:.4g}{sign}".replace("-", "−"))
    half = COVERAGE_FACTOR * u
    decimals = max(1 - floor(log10(half)), 0)
    # Adding zero turns −0.0 into 0.0.
    return Number(f"{round(value, decimals) + 0.0:.{decimals}f} ± {half:.{decimals}f}{sign}".replace("-", "−"))


Row = tuple[str, str, str, str, str]
"""Position, approach directions, target, station, and the difference between two predictions."""


@final
@dataclass(frozen=True)
class SeparatingPoints:
    """A cause, those it is confounded with, and the points whose measurement separates them."""

    names: tuple[str, str]  # in words with their symbols
    rows: tuple[Row, ...]
    verdict: str  # whether and how they can be separated


def compared(diagnosis: DiagnosisResult) -> list[SeparatingPoints]:
    """Return the causes to separate; none if no position separates any: what to do has said so (`_when_ambiguous`)."""
    pairs = separating_points(diagnosis.next_measurement, diagnosis.expected_rms_um)
    return pairs if diagnosis.verdict != "ambiguous" or any(pair.rows for pair in pairs) else []


def separating_points(wanted: Iterable[Mapping[str, Any]], sigma_um: float) -> list[SeparatingPoints]:
    """Return the points of `Diagnosis.next_measurement` by the causes that they, or the same words, separate; ``sigma_um``: noise."""
    by_pair: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for entry in wanted:
        if "separates" in entry:
            a, b = (str(name) for name in entry["separates"])
            by_pair.setdefault((a, b), []).append(entry)
    best = {pair: max(float(p.get("expected_chi2", 0.0)) for p in points) for pair, points in by_pair.items()}
    nowhere = {pair: chi2 for pair, chi2 in best.items() if RULED_OUT_CHI2 > MOST_READINGS * chi2}
    least = RULED_OUT_CHI2 / MOST_IN_ONE_COURSE
    in_course = {pair: chi2 for pair, chi2 in best.items() if chi2 < least and _courses_decide(*pair)}
    separated: dict[tuple[str, str, tuple[Row, ...]], list[str]] = {}
    for pair, points in by_pair.items():
        rows: tuple[Row, ...] = ()
        if "pose" not in points[0]:
            text = capital(points[0]["decided_by"]) + "."
        elif pair in in_course:
            text = Message(
                "No position separates them in the course of time and temperatures that was measured: their "
                "predictions differ by at most {best:.1g} µm. Measure again in another course (after a pause, or "
                "while the machine cools). Until then compensate only for work in the same course.",
                best=max(in_course.values()) ** 0.5 * sigma_um,
            )
        elif pair in nowhere:
            text = Message(
                "No position that was tried separates them: their predictions differ by at most {best:.1g} µm. "
                "Either can be used for compensation.",
                best=max(nowhere.values()) ** 0.5 * sigma_um,
            )
        else:
            rows, text = tuple(_row(point, sigma_um) for point in points), _most_different(pair, best[pair])
        separated.setdefault((named(*pair[0].partition(" ")[::2]), text, rows), []).append(
            named(*pair[1].partition(" ")[::2])
        )
    return [SeparatingPoints((a, either(names)), rows, text) for (a, text, rows), names in separated.items()]


def _row(point: Mapping[str, Any], sigma_um: float) -> Row:
    pose = " ".join(f"{axis}{value:g}" for axis, value in point["pose"].items())
    sides = " ".join(f"{axis}{'+' if sign > 0 else '−'}" for axis, sign in point["approach"].items())
    difference = Number(f"{float(point['expected_chi2']) ** 0.5 * sigma_um:.2g} µm")
    return pose, sides, str(point["target"]), str(point["station"]), difference


def _most_different(pair: tuple[str, str], best: float) -> str:
    many = Message("about {many} readings are enough", many=ceil(RULED_OUT_CHI2 / best))
    readings = many if best < RULED_OUT_CHI2 else Message("one reading is enough")
    text = Message("Their predictions differ most at these positions; at the first, {readings}.", readings=readings)
    plan = f'twin plan -o plan.csv --separate "{pair[0]}" "{pair[1]}" --after <this table>'
    complete = Message(" For a complete plan with new station positions: {plan}.", plan=plan)
    return text if any(name.startswith("misplaced") for name in pair) else text + complete


def _courses_decide(*symbols: str) -> bool:
    """Return whether two causes follow different quantities: time, temperatures, speed, or none."""
    follow = []
    for effect, _, where in (name.partition(" ") for name in symbols):
        specification = SPECIFICATIONS.get(effect)
        changes = specification is not None and specification.varies == "with time"
        follow.append((changes, set(specification.channels(where)) if specification is not None and changes else set()))
    return follow[0] != follow[1]


def chance(p: float) -> str:
    """Return a p-value in words: under 1 in a million; 1 in 5,000; 12 %."""
    if p < 1e-6:
        return Message("under 1 in a million")
    if p < 0.01:
        return Message("1 in {round_number:,}", round_number=_round_number(1.0 / p))
    return Number(f"{100.0 * p:.0f} %")


def odds(log_odds: float) -> str:
    """Return in words how many times less likely something is, from the natural log of the odds."""
    if log_odds > 13.8:
        return Message("more than a million times less likely")
    return Message("about {round_number:,} times less likely", round_number=_round_number(exp(log_odds)))


def _round_number(value: float) -> int:
    """Return the value rounded to its first two digits."""
    digits = max(len(str(int(value))) - 2, 0)
    return round(value / 10**digits) * 10**digits


def percent(share: float) -> str:
    """Return a fraction of one in percent."""
    if 0.995 <= share < 1.0:
        return Message("more than 99 %")
    return Message("less than 1 %") if share < 0.005 else Number(f"{100.0 * share:.0f} %")


def rest(diagnosis: DiagnosisResult) -> str:
    """Return the share of the excess that neither causes nor a pattern explain, in a sentence; empty if it is below 1 %."""
    unexplained = diagnosis.unexplained
    share = 1.0 - sum(cause.share for cause in diagnosis.causes) - (0.0 if unexplained is None else unexplained.share)
    if not any(cause.share for cause in diagnosis.causes) or share < LEAST_REST:
        return ""
    return Message(
        "The rest, {share} of the excess, is not significant or too small to be named.", share=percent(share)
    )


HELD_OUT: Final[Mapping[str, Message]] = {
    "rounds": Message("rounds"),
    "positions": Message("positions"),
    "poses": Message("poses"),
    "blocks": Message("blocks of time"),
}


def held_out_words(of: str) -> str:
    """Return in words what was held out: rounds, positions, poses, or blocks of time."""
    return HELD_OUT[of]


def likelihood_words(probability: float, alone: bool) -> str:
    """Return the Bayesian probability of a cause, or of a cause and its equivalents together, in words."""
    size = Message("more than 99 %") if probability > 0.99 else percent(probability)
    what = Message("this cause is present") if alone else Message("this cause or one of its alternatives is present")
    return Message("probability that {what}: {size} (second, Bayesian method)", what=what, size=size)


Mood = Literal["well", "wrong", "unknown", "disturbed"]
CAUSES_DESCRIBED: Final = 4  # causes described one by one; the rest are counted
WELL_BELOW: Final = 0.8  # share of the expected RMS residual below which the residuals are called less than expected
COVERED_RATIO: Final = 0.9
"""Ratio of the RMS residual with and without the calibration's uncertainty below which that uncertainty makes it consistent."""
DOUBTED_NOISE_RATIO: Final = 1.2  # ratio of the residual to the stated noise above which the stated noise is doubted
RESULT: Final = Message("Result")
RESIDUAL: Final = Message("Residual")
VERDICTS: Final[Mapping[str, Message]] = {
    "consistent": Message("CONSISTENT"),
    "explained": Message("EXPLAINED"),
    "ambiguous": Message("AMBIGUOUS"),
    "unexplained": Message("UNEXPLAINED"),
}
ORIGINS: Final[Mapping[str, Message]] = {
    "machine": Message("machine"),
    "calibration": Message("calibration"),
    "instrument": Message("instrument"),
}
WHAT_TO_DO: Final = Message("What to do")
NOTE: Final = Message("Note")
AT_THE_TOOL: Final = Message("At the tool")
CAUTION: Final = Message("Caution")
NOT_EXTENDED: Final = Message("Not extended")
EXTENDED: Final = Message("Extended")
WHERE_TO_LOOK: Final = Message("Where to look")
COMPENSATE: Final = Message("Compensate with the present calibration.")
KEEP: Final = Message(
    "Switch the correction in the control on for machining: it holds this calibration, and programs run as they are."
)
SIGMAS: Final = Message(" ({count:.0f} standard uncertainties)", count=0).identifier
NEXT_SECTION: Final = Message("“What to measure next”")
SIZE_IN_TEXT: Final = re.compile(r"\d (µm|µrad|mm|°|ppm)")


def headline(diagnosis: DiagnosisResult) -> tuple[str, Mood]:  # noqa: C901, PLR0911
    """Return the verdict in one sentence, and its mood (the colour it is shown in)."""
    kinds = {kind(cause.effect) for cause in diagnosis.causes}
    if diagnosis.verdict == "consistent":
        return Message("The readings agree with the model: no error found"), "well"
    if diagnosis.verdict == "unexplained":
        if kinds and noisier_than_stated(diagnosis):
            return (
                Message("The readings are noisier than stated; the causes found may be artefacts of that noise"),
                "unknown",
            )
        if kinds:
            part = (
                Message("explain all of it")
                if diagnosis.unexplained is not None
                else Message("predict held-out readings")
            )
            return Message("There is an error, and the causes found do not {part}", part=part), "unknown"
        if diagnosis.unexplained is not None and not diagnosis.unexplained.depends_on:
            return Message("The readings are noisier than stated"), "unknown"
        return Message("There is an error that no known cause explains"), "unknown"
    if diagnosis.verdict == "ambiguous":
        if diagnosis.causes and not diagnosis.causes[0].equivalent:
            return (
                Message(
                    "There are errors: most causes are identified, but for some these readings cannot decide between "
                    "alternatives"
                ),
                "wrong",
            )
        return Message("There is an error, but these readings cannot decide which of several causes it has"), "wrong"
    if kinds == {"instrument"}:
        return (Message("The measurement was disturbed; these readings show no error of the machine"), "disturbed")
    if kinds == {"calibration"}:
        return Message("The calibration is wrong, not the machine"), "wrong"
    if "instrument" in kinds:
        return (
            Message("The machine has an error that its model does not contain, and the measurement was disturbed"),
            "wrong",
        )
    count = len(diagnosis.causes)
    many = Message("an error") if count == 1 else Message("{count} errors", count=count)
    return Message("The machine has {many} that its model does not contain", many=many), "wrong"


def facts(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    """Return headings with one or two sentences each: the effect at the tool, what to do, what to avoid."""
    causes = diagnosis.causes
    if diagnosis.verdict == "consistent":
        less = diagnosis.rms_um < WELL_BELOW * diagnosis.expected_rms_um
        why = (
            Message("less than expected from measurement noise ({expected:.3g} µm)", expected=diagnosis.expected_rms_um)
            if less
            else Message("as expected from measurement noise ({expected:.3g} µm)", expected=diagnosis.expected_rms_um)
        )
        if (
            diagnosis.rms_um > diagnosis.expected_rms_um
            and diagnosis.absorbed_rms_um < COVERED_RATIO * diagnosis.rms_um
        ):
            why = Message(
                "more than measurement noise ({expected_rms_um:.3g} µm), but within the uncertainty stated in the "
                "calibration",
                expected_rms_um=diagnosis.expected_rms_um,
            )
        return [
            (RESULT, Message("The RMS residual is {rms_um:.3g} µm, {why}.", rms_um=diagnosis.rms_um, why=why)),
            (
                WHAT_TO_DO,
                Message("Nothing. {what}", what=KEEP if CORRECTED_IN_CONTROL in diagnosis.warnings else COMPENSATE),
            ),
            (
                NOTE,
                Message(
                    "This covers only errors that these readings can show. The others are listed under {NEXT_SECTION}.",
                    NEXT_SECTION=NEXT_SECTION,
                ),
            ),
        ]
    lines: list[tuple[str, str]] = [(AT_THE_TOOL, _at_tool(diagnosis))]
    if diagnosis.verdict == "unexplained":
        lines += _when_unexplained(diagnosis)
    elif all(cause.below_increment for cause in causes):
        lines.append((WHAT_TO_DO, BELOW_INCREMENT))
    elif diagnosis.verdict == "ambiguous":
        lines += _when_ambiguous(diagnosis)
    elif len(causes) == 1:
        lines += advised(causes[0])
    else:
        for cause in causes[:CAUSES_DESCRIBED]:
            title = cause_title(cause.effect, cause.where)
            lines.append((title, joined(" ", [text for _, text in advised(cause)[:2]])))
        if any(cause.origin == "instrument" for cause in causes):
            lines.append((CAUTION, Message("Do not compensate for errors of the instrument.")))
    return [fact for fact in [*lines, *extended(diagnosis)] if fact[1]]


def extended(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    """Return what the extended calibration contains of the unexplained pattern, or why not; empty if that was not requested."""
    unexplained = diagnosis.unexplained
    if unexplained is None or unexplained.extension is None:
        return []
    made = unexplained.extension
    if not made.written:
        return [
            (
                NOT_EXTENDED,
                Message(
                    "The unexplained pattern is not in the extended calibration: {reason}.", reason=made.reason or ""
                ),
            )
        ]
    names = listed([f"“{term.where}”" for term in made.made], most=len(made.made))
    text = Message(
        "{names} is in the extended calibration without a known cause. It is valid for the measured conditions only, "
        "{inside}; outside them compensation is refused. If the instrument caused it, and not the machine, it makes "
        "parts worse.",
        names=names,
        inside=inside(made),
    )
    held = made.held_out
    if held is not None and held.ci95_um is not None:
        low, high = held.ci95_um
        text += Message(
            " On held-out {held_out_words} it reduces the RMS residual from {before_um:.3g} to {after_um:.3g} µm (by "
            "{low} to {high}, 95 %).",
            held_out_words=held_out_words(held.of),
            before_um=held.before_um,
            after_um=held.after_um,
            low=micrometres(low),
            high=micrometres(high),
        )
    others = [str(term.reason) for term in made.terms if term.reason is not None]
    if others:
        text += Message(" Another part of the unexplained pattern is not included: {names}.", names="; ".join(others))
    return [(EXTENDED, text)]


def inside(made: Extension) -> str:
    """Return the ranges in which an empirical effect is valid: ``within X_mm 0 to 500 and Y_mm 0 to 450``."""
    ranges = [
        Message("{name} {low:g} to {high:g}", name=name, low=low, high=high)
        for name, (low, high) in made.ranges.items()
    ]
    return Message("within {names}", names=listed(ranges, most=len(ranges))) if ranges else Message("at all angles")


def advised(cause: Cause) -> list[tuple[str, str]]:
    """Return where to look, what to do and what to avoid, each with its heading; below the least increment only what to do."""
    if cause.below_increment:
        return [(WHAT_TO_DO, BELOW_INCREMENT)]
    texts = advice(cause.effect, cause.where)
    return [(WHERE_TO_LOOK, texts.look), (WHAT_TO_DO, to_do(cause)), (CAUTION, texts.never)]


def to_do(cause: Cause) -> str:
    """Return what to do about a cause; one that is not in the extended calibration cannot be compensated."""
    if cause.promised:
        return advice(cause.effect, cause.where).do
    if cause.bounded:
        return Message(
            "It is not compensated: its size is at or beyond a physical limit. Measure at other positions and loads."
        )
    return Message(
        "It is not compensated: the error at these positions does not predict the error between them. Measure at "
        "more closely and unevenly spaced positions."
    )


def sentence(cause: Cause) -> str:
    """Return the evidence without symbol and statistics; if it contains no size, the largest shift of a point is added."""
    text = joined("", [part for part in parts(cause.evidence) if not _is_statistics(cause, part)])
    return joined("", [capital(text), ".", *([] if SIZE_IN_TEXT.search(text) else [" ", moves(cause)])])


def _is_statistics(cause: Cause, part: str) -> bool:
    """Return whether a part of the evidence is its symbol, or its size in standard uncertainties."""
    return part == f"{cause.where}: " or (isinstance(part, Message) and part.identifier == SIGMAS)


def moves(cause: Cause) -> str:
    """Return the largest shift of a reading, in a sentence."""
    size = np.linalg.norm(np.nan_to_num(cause.pattern_um), axis=1).max(initial=0.0)
    if cause.origin == "instrument":
        return Message("It shifts readings by up to {size}.", size=micrometres(size))
    return Message("It moves the measured points by up to {size}.", size=micrometres(size))


def noisier_than_stated(diagnosis: DiagnosisResult) -> bool:
    """Return whether the noise is larger than stated even with all causes, and a pattern without a cause, in the model."""
    unexplained = diagnosis.unexplained
    if diagnosis.gain is None or unexplained is None or _written(diagnosis):
        return False
    pattern_um = unexplained.size_um if unexplained.depends_on else 0.0
    ratio = np.sqrt(max(diagnosis.gain.rms_after_um**2 - pattern_um**2, 0.0)) / diagnosis.expected_rms_um
    # Significant: five standard deviations of a mean square. Relevant: above `DOUBTED_NOISE_RATIO`.
    return bool(ratio > DOUBTED_NOISE_RATIO and ratio**2 - 1.0 > 5.0 * np.sqrt(2.0 / max(diagnosis.dof, 1)))


def machine_or_instrument(causes: Iterable[Cause]) -> bool:
    """Return whether an error of the machine is confounded with one of the instrument."""
    return any(
        (kind(effect) == "instrument") != (cause.origin == "instrument")
        for cause in causes
        for effect, _ in cause.equivalent
    )


def _at_tool(diagnosis: DiagnosisResult) -> str:
    gain, kinds = diagnosis.gain, {kind(cause.effect) for cause in diagnosis.causes}
    if kinds == {"instrument"} and machine_or_instrument(diagnosis.causes):
        return Message("Unknown: none if the error is the instrument's; if it is the machine's, the tool has it.")
    if kinds == {"instrument"}:
        return Message("No effect: the error is in the readings only.")
    if gain is None or gain.tool_before_um == 0.0:
        return ""
    if isnan(gain.tool_before_um):
        return Message(
            "Unknown: over the working volume the causes would move the tool point by more than this model "
            "describes. The readings do not determine them there."
        )
    made = Message("{tool_before_um} (RMS over the working volume)", tool_before_um=micrometres(gain.tool_before_um))
    if _written(diagnosis):
        return Message(
            "{made}, within the measured range. After compensation {tool_after_um} remain there.",
            made=made,
            tool_after_um=micrometres(gain.tool_after_um),
        )
    if diagnosis.verdict == "unexplained":
        return Message("The causes found contribute {made}; the contribution of the rest is unknown.", made=made)
    condition = Message(", if this is the cause") if diagnosis.verdict == "ambiguous" else ""
    remaining = Message(
        "After compensation {tool_after_um} remain{condition}.",
        tool_after_um=micrometres(gain.tool_after_um),
        condition=condition,
    )
    return Message(
        "{made}; relevant if your tolerance is below about five times this. {remaining}", made=made, remaining=remaining
    )


def _written(diagnosis: DiagnosisResult) -> bool:
    """Return whether the unexplained pattern is in the extended calibration."""
    unexplained = diagnosis.unexplained
    return unexplained is not None and unexplained.extension is not None and unexplained.extension.written


def _when_unexplained(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    unexplained = diagnosis.unexplained
    if unexplained is None:
        return []
    share = Message("{share} of the excess over measurement noise", share=percent(unexplained.share))
    check = Message("Check the instrument and its stated uncertainties before working on the machine.")
    spurious = Message("if the noise is larger than stated, some of the causes found may not exist.")
    if noisier_than_stated(diagnosis) and diagnosis.causes and diagnosis.gain is not None:
        times = diagnosis.gain.rms_after_um / diagnosis.expected_rms_um
        rest = Message(
            "With these causes in the model the RMS residual is {rms_after_um}",
            rms_after_um=micrometres(diagnosis.gain.rms_after_um),
        )
        return [
            (RESIDUAL, Message("{rest}, {times:.2g} times the stated noise.", rest=rest, times=times)),
            (WHAT_TO_DO, Message("{check} Then diagnose again.", check=check)),
            (CAUTION, Message("Do not compensate with this result: {spurious}", spurious=spurious)),
        ]
    if not unexplained.depends_on:
        over = Message("{share} remains, without a pattern in any column of the table.", share=share)
        if not diagnosis.causes:
            stated = Message(
                "with {expected_rms_um:.3g} µm expected from the stated noise",
                expected_rms_um=diagnosis.expected_rms_um,
            )
            over = Message(
                "The RMS residual is {rms_um:.3g} µm, {stated}. It has no pattern in any column of the table.",
                rms_um=diagnosis.rms_um,
                stated=stated,
            )
        return [
            (RESIDUAL if diagnosis.causes else RESULT, over),
            (WHAT_TO_DO, check),
            (CAUTION, Message("Do not compensate yet: {spurious}", spurious=spurious)),
        ]
    names = listed([column(name) for name in unexplained.depends_on])
    caution = Message("Do not compensate or repair on suspicion: no known error has this pattern.")
    if _written(diagnosis):
        caution = Message(
            "Do not repair on suspicion: no known error has this pattern. The pattern may change if its cause changes."
        )
    elif diagnosis.causes:
        caution = Message(
            "Compensating for the causes found is not enough: the rest remains and may have biased their sizes."
        )
    if unexplained.jump:
        moment = Message("All {side} jumped {jump}", side=side(unexplained.carrier), jump=unexplained.jump)
        return [
            (RESIDUAL, joined("", [moment, ": ", share, "."])),
            (
                WHAT_TO_DO,
                Message(
                    "Look for what happened then: a collision, a lost reference, a holder that slipped. Measure again."
                ),
            ),
            (CAUTION, caution),
        ]
    return [
        (
            RESIDUAL,
            Message(
                "{share} depends on {names} ({side}).{instead}",
                share=share,
                names=names,
                side=side(unexplained.carrier),
                instead=instead(unexplained),
            ),
        ),
        (WHAT_TO_DO, Message("Look for what depends on {names}, and measure more densely over it.", names=names)),
        (CAUTION, caution),
    ]


def instead(unexplained: Unexplained) -> str:
    """Return the sentence that names the other columns that a pattern may depend on; empty if there are none."""
    if not unexplained.or_on:
        return ""
    sets = [
        listed([column(name) for name in names], most=len(names)) for names in unexplained.or_on[:INSTEAD_DESCRIBED]
    ]
    return Message(" It may instead depend on {names}: the readings do not tell.", names=either(sets))


def _when_ambiguous(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    causes, when_ambiguous = diagnosis.causes[:CAUSES_DESCRIBED], list[tuple[str, str]]()
    certain = [cause for cause in causes if not cause.equivalent]
    for cause in causes:
        name = cause_title(cause.effect, cause.where)
        if cause.equivalent:
            names = listed(cause.alternatives(lambda *key: lower(cause_title(*key))), most=4)
            when_ambiguous.append(
                (
                    Message("{name}, or instead", name=name) if len(causes) > 1 else Message("Or instead"),
                    Message("{names}. This fits the readings equally well.", names=capital(names)),
                )
            )
        else:
            when_ambiguous.append((name, joined(" ", [text for _, text in advised(cause)[:2]])))
    pairs = separating_points(diagnosis.next_measurement, diagnosis.expected_rms_um)
    if any(pair.rows for pair in pairs):
        when_ambiguous.append(
            (
                WHAT_TO_DO,
                Message(
                    "First measure the points under {NEXT_SECTION}: they separate the causes. Then compensate.",
                    NEXT_SECTION=NEXT_SECTION,
                ),
            )
        )
    elif pairs:
        when_ambiguous.append((WHAT_TO_DO, joined(" ", list(dict.fromkeys(pair.verdict for pair in pairs)))))
    if machine_or_instrument(causes):
        what = Message("The undecided part") if certain else Message("The error")
        when_ambiguous.append(
            (
                NOTE,
                Message(
                    "{what} may be the instrument's, not the machine's; an instrument error must not be compensated.",
                    what=what,
                ),
            )
        )
    caution = (
        Message("Order no repair for the undecided part.")
        if certain
        else Message("Order no repair on this result alone.")
    )
    when_ambiguous.append((CAUTION, caution))
    return when_ambiguous
