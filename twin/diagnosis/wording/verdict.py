"""The verdict of a diagnosis in a few sentences for whoever runs the machine, shared by page, text and notebook."""

from __future__ import annotations

import re
from collections.abc import Iterable
from math import isnan
from typing import Final, Literal

import numpy as np

from twin.diagnosis.result import Cause, DiagnosisResult, Extension
from twin.diagnosis.wording.words import (
    advice,
    cause_title,
    column,
    held_out_words,
    kind,
    micrometres,
    percent,
    separating_points,
    side,
)
from twin.display.sentences import capital, listed, lower

Mood = Literal["well", "wrong", "unknown", "disturbed"]
SHOWN: Final = 4
"""Causes described one by one; the rest are counted."""
WELL_BELOW: Final = 0.8
"""Share of the expected RMS residual below which the residuals are called less than expected."""
COVERED: Final = 0.9
"""Ratio of the RMS residual with and without the calibration's uncertainty below which that uncertainty makes it consistent."""
NOISY: Final = 1.2
"""Ratio of the residual to the stated noise above which the stated noise is doubted."""
NEXT: Final = "“What to measure next”"
SIZED: Final = re.compile(r"\d (µm|µrad|mm|°|ppm)")


def headline(diagnosis: DiagnosisResult) -> tuple[str, Mood]:
    """Return the verdict in one sentence, and its mood (the colour it is shown in)."""
    kinds = {kind(cause.effect) for cause in diagnosis.causes}
    if diagnosis.verdict == "consistent":
        return "The readings agree with the model: no error found", "well"
    if diagnosis.verdict == "unexplained":
        if kinds and noisier_than_stated(diagnosis):
            return (
                "The readings are noisier than stated; the causes found may be artefacts of that noise",
                "unknown",
            )
        if kinds:
            return "There is an error, and the causes found do not explain all of it", "unknown"
        if diagnosis.unexplained is not None and not diagnosis.unexplained.depends_on:
            return "The readings are noisier than stated", "unknown"
        return "There is an error that no known cause explains", "unknown"
    if diagnosis.verdict == "ambiguous":
        if diagnosis.causes and not diagnosis.causes[0].equivalent:
            return (
                "There are errors: most causes are identified, but for some these readings cannot decide between alternatives",
                "wrong",
            )
        return "There is an error, but these readings cannot decide which of several causes it has", "wrong"
    if kinds == {"instrument"}:
        return (
            "The measurement was disturbed; these readings show no error of the machine",
            "disturbed",
        )
    if kinds == {"calibration"}:
        return "The calibration is wrong, not the machine. Found:", "wrong"
    if "instrument" in kinds:
        return (
            "The machine has an error that its model does not contain, and the measurement was disturbed. Found:",
            "wrong",
        )
    many = "an error" if len(diagnosis.causes) == 1 else f"{len(diagnosis.causes)} errors"
    return f"The machine has {many} that its model does not contain. Found:", "wrong"


def facts(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    """Return headings with one or two sentences each: the effect at the tool, what to do, what to avoid."""
    causes = diagnosis.causes
    if diagnosis.verdict == "consistent":
        less = diagnosis.rms_um < WELL_BELOW * diagnosis.expected_rms_um
        why = f"{'less than' if less else 'as'} expected from measurement noise ({diagnosis.expected_rms_um:.3g} µm)"
        if diagnosis.rms_um > diagnosis.expected_rms_um and diagnosis.absorbed_rms_um < COVERED * diagnosis.rms_um:
            why = (
                f"more than measurement noise ({diagnosis.expected_rms_um:.3g} µm), but within the uncertainty stated in the "
                "calibration"
            )
        return [
            ("Result", f"The RMS residual is {diagnosis.rms_um:.3g} µm, {why}."),
            ("What to do", "Nothing. Compensate with the present calibration."),
            ("Note", f"This covers only errors that these readings can show. The others are listed under {NEXT}."),
        ]
    found = [("At the tool", _at_tool(diagnosis))]
    if diagnosis.verdict == "unexplained":
        found += _when_unexplained(diagnosis)
    elif diagnosis.verdict == "ambiguous":
        found += _when_ambiguous(diagnosis)
    elif len(causes) == 1:
        found += advised(causes[0])
    else:
        for one in causes[:SHOWN]:
            look = advice(one.effect, one.where).look
            found.append((cause_title(one.effect, one.where), f"{look} {to_do(one)}"))
        if any(one.origin == "instrument" for one in causes):
            found.append(("Caution", "Do not compensate for errors of the instrument."))
    return [fact for fact in [*found, *extended(diagnosis)] if fact[1]]


def extended(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    """Return what the extended calibration contains of the unexplained pattern, or why not; empty if that was not requested."""
    left = diagnosis.unexplained
    if left is None or left.extension is None:
        return []
    made = left.extension
    if not made.written:
        return [("Not extended", f"The unexplained pattern is not in the extended calibration: {made.reason}.")]
    names = " and ".join(f"“{term.where}”" for term in made.made)
    text = (
        f"{names} is in the extended calibration without a known cause. It is valid for the measured conditions only, {inside(made)}; "
        "outside them compensation is refused. If the instrument caused it, and not the machine, it makes parts worse."
    )
    held = made.held_out
    if held is not None and held.ci95_um is not None:
        low, high = held.ci95_um
        text += (
            f" On held-out {held_out_words(held.of)} it reduces the RMS residual from {held.before_um:.3g} to {held.after_um:.3g} µm "
            f"(by {micrometres(low)} to {micrometres(high)}, 95 %)."
        )
    others = [str(term.reason) for term in made.terms if term.reason is not None]
    if others:
        text += f" Another part of the unexplained pattern is not included: {'; '.join(others)}."
    return [("Extended", text)]


def inside(made: Extension) -> str:
    """Return the ranges in which an empirical effect is valid: ``within X_mm 0 to 500 and Y_mm 0 to 450``."""
    ranges = [f"{name} {low:g} to {high:g}" for name, (low, high) in made.ranges.items()]
    return f"within {' and '.join(ranges)}" if ranges else "at all angles"


def advised(cause: Cause) -> list[tuple[str, str]]:
    """Return where to look, what to do and what to avoid, each with its heading."""
    texts = advice(cause.effect, cause.where)
    return [("Where to look", texts.look), ("What to do", to_do(cause)), ("Caution", texts.never)]


def to_do(cause: Cause) -> str:
    """Return what to do about a cause; one that is not in the extended calibration cannot be compensated."""
    if cause.promised:
        return advice(cause.effect, cause.where).do
    if cause.bounded:
        return "It is not compensated: its size is at or beyond a physical limit. Measure at other positions and loads."
    return (
        "It is not compensated: the error at these positions does not predict the error between them. Measure at more closely "
        "and unevenly spaced positions."
    )


def sentence(cause: Cause) -> str:
    """Return the evidence without symbol and statistics; if it contains no size, the largest shift of a point is added."""
    text = re.sub(r" \(\d+ standard uncertainties\)", "", cause.evidence).removeprefix(f"{cause.where}: ")
    return f"{capital(text)}.{'' if SIZED.search(text) else f' {moves(cause)}'}"


def moves(cause: Cause) -> str:
    """Return the largest shift of a reading, in a sentence."""
    size = np.linalg.norm(np.nan_to_num(cause.pattern_um), axis=1).max(initial=0.0)
    what = "shifts readings" if cause.origin == "instrument" else "moves the measured points"
    return f"It {what} by up to {micrometres(size)}."


def noisier_than_stated(diagnosis: DiagnosisResult) -> bool:
    """Return whether the noise is larger than stated even with all causes in the model."""
    if diagnosis.gain is None or diagnosis.unexplained is None or _written(diagnosis):
        return False
    ratio = diagnosis.gain.rms_after_um / diagnosis.expected_rms_um
    # Significant: five standard deviations of a mean square. Relevant: above `NOISY`.
    return bool(ratio > NOISY and ratio**2 - 1.0 > 5.0 * np.sqrt(2.0 / max(diagnosis.dof, 1)))


def machine_or_instrument(causes: Iterable[Cause]) -> bool:
    """Return whether an error of the machine is confounded with one of the instrument."""
    return any(
        (kind(effect) == "instrument") != (one.origin == "instrument") for one in causes for effect, _ in one.equivalent
    )


def _at_tool(diagnosis: DiagnosisResult) -> str:
    gain, kinds = diagnosis.gain, {kind(cause.effect) for cause in diagnosis.causes}
    if kinds == {"instrument"}:
        return "No effect: the error is in the readings only."
    if gain is None or gain.tool_before_um == 0.0:
        return ""
    if isnan(gain.tool_before_um):
        return (
            "Unknown: over the working volume the causes would move the tool point by more than this model describes. The readings do "
            "not determine them there."
        )
    made = f"{micrometres(gain.tool_before_um)} (RMS over the working volume)"
    if _written(diagnosis):
        return f"{made}, within the measured range. After compensation {micrometres(gain.tool_after_um)} remain there."
    if diagnosis.verdict == "unexplained":
        return f"The causes found contribute {made}; the contribution of the rest is unknown."
    condition = ", if this is the cause" if diagnosis.verdict == "ambiguous" else ""
    remaining = f"After compensation {micrometres(gain.tool_after_um)} remain{condition}."
    return f"{made}; relevant if your tolerance is below about five times this. {remaining}"


def _written(diagnosis: DiagnosisResult) -> bool:
    """Return whether the unexplained pattern is in the extended calibration."""
    left = diagnosis.unexplained
    return left is not None and left.extension is not None and left.extension.written


def _when_unexplained(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    left = diagnosis.unexplained
    if left is None:
        return []
    share = f"{percent(left.share)} of the excess over measurement noise"
    check = "Check the instrument and its stated uncertainties before working on the machine."
    spurious = "if the noise is larger than stated, some of the causes found may not exist."
    if noisier_than_stated(diagnosis) and diagnosis.gain is not None:
        times = diagnosis.gain.rms_after_um / diagnosis.expected_rms_um
        rest = f"With these causes in the model the RMS residual is {micrometres(diagnosis.gain.rms_after_um)}"
        return [
            ("Residual", f"{rest}, {times:.2g} times the stated noise."),
            ("What to do", f"{check} Then diagnose again."),
            ("Caution", f"Do not compensate with this result: {spurious}"),
        ]
    if not left.depends_on:
        over = f"{share} remains, without a pattern in any column of the table."
        if not diagnosis.causes:
            stated = f"with {diagnosis.expected_rms_um:.3g} µm expected from the stated noise"
            over = f"The RMS residual is {diagnosis.rms_um:.3g} µm, {stated}. It has no pattern in any column of the table."
        return [
            ("Residual" if diagnosis.causes else "Result", over),
            ("What to do", check),
            ("Caution", f"Do not compensate yet: {spurious}"),
        ]
    names = listed([column(name) for name in left.depends_on])
    caution = "Do not compensate or repair on suspicion: no known error has this pattern."
    if _written(diagnosis):
        caution = (
            "Do not repair on suspicion: no known error has this pattern. The pattern may change if its cause changes."
        )
    elif diagnosis.causes:
        caution = "Compensating for the causes found is not enough: the rest remains and may have biased their sizes."
    return [
        ("Residual", f"{share} depends on {names} ({side(left.carrier)})."),
        ("What to do", f"Look for what depends on {names}, and measure more densely over it."),
        ("Caution", caution),
    ]


def _when_ambiguous(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    causes, found = diagnosis.causes[:SHOWN], []
    certain = [one for one in causes if not one.equivalent]
    for one in causes:
        name = cause_title(one.effect, one.where)
        if one.equivalent:
            names = listed([lower(cause_title(*key)) for key in one.equivalent], most=4)
            found.append(
                (
                    f"{name}, or instead" if len(causes) > 1 else "Or instead",
                    f"{capital(names)}. This fits the readings equally well.",
                )
            )
        else:
            found.append((name, f"{advice(one.effect, one.where).look} {to_do(one)}"))
    wanted = separating_points(diagnosis.next_measurement, diagnosis.expected_rms_um)
    if any(one.rows for one in wanted):
        found.append(
            ("What to do", f"First measure the points under {NEXT}: they separate the causes. Then compensate.")
        )
    elif wanted:
        found.append(("What to do", " ".join(dict.fromkeys(one.verdict for one in wanted))))
    if machine_or_instrument(causes):
        what = "The undecided part" if certain else "The error"
        found.append(
            ("Note", f"{what} may be the instrument's, not the machine's; an instrument error must not be compensated.")
        )
    caution = "Order no repair for the undecided part." if certain else "Order no repair on this result alone."
    found.append(("Caution", caution))
    return found
