"""What a diagnosis comes to, in a few sentences for whoever runs the machine: page, text and notebook say the same."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, Literal

import numpy as np

from twin.diagnosis.result import Answer, Cause, Extension
from twin.diagnosis.wording.words import (
    advice,
    capital,
    column,
    contests,
    held_out_words,
    kind,
    listed,
    lower,
    percent,
    plain,
    side,
)

Mood = Literal["well", "wrong", "unknown", "disturbed"]
SHOWN: Final = 4
"""Causes that are told of before the others are counted."""
COVERED: Final = 0.9
"""Share of the residual below which the calibration's uncertainty is what makes it consistent."""
RESTLESS: Final = 1.2
"""Times the stated scatter from which it is doubted."""
NEXT: Final = "“What to measure next”"
SIZED: Final = re.compile(r"\d (µm|µrad|mm|°|ppm)")


def headline(diagnosis: Answer) -> tuple[str, Mood]:
    """The verdict in one sentence, and what kind of news it is."""
    kinds = {kind(cause.effect) for cause in diagnosis.causes}
    if diagnosis.verdict == "consistent":
        return "Nothing is wrong that these readings could show", "well"
    if diagnosis.verdict == "unexplained":
        if kinds and restless(diagnosis):
            return (
                "The readings scatter more than was stated; what was found in them may be no more than that",
                "unknown",
            )
        if kinds:
            return "Something is wrong, and what was found does not explain all of it", "unknown"
        if diagnosis.unexplained is not None and not diagnosis.unexplained.depends_on:
            return "The readings scatter more than was stated", "unknown"
        return "Something is wrong that no known cause explains", "unknown"
    if diagnosis.verdict == "ambiguous":
        if not diagnosis.causes[0].equivalent:
            return (
                "Something is wrong; most of it is found, and for a part these readings leave open what it is",
                "wrong",
            )
        return "Something is wrong, and these readings leave open which of several things it is", "wrong"
    if kinds == {"instrument"}:
        return (
            "The measurement was disturbed; nothing is wrong with the machine that these readings could show",
            "disturbed",
        )
    if kinds == {"calibration"}:
        return "The calibration is wrong, not the machine. Found:", "wrong"
    if "instrument" in kinds:
        return "The machine has an error its model does not know, and the measurement was disturbed. Found:", "wrong"
    many = "an error" if len(diagnosis.causes) == 1 else f"{len(diagnosis.causes)} errors"
    return f"The machine has {many} its model does not know. Found:", "wrong"


def facts(diagnosis: Answer) -> list[tuple[str, str]]:
    """What it makes at the tool, what to do and what not: a heading and a sentence or two each."""
    causes = diagnosis.causes
    if diagnosis.verdict == "consistent":
        why = f"as their own scatter lets expect ({diagnosis.expected_rms_um:.3g} µm)"
        if diagnosis.absorbed_rms_um < COVERED * diagnosis.rms_um:
            why = (
                f"more than their own scatter ({diagnosis.expected_rms_um:.3g} µm): the uncertainty that the calibration states "
                "covers the rest"
            )
        return [
            ("Seen", f"The readings differ from the model by {diagnosis.rms_um:.3g} µm, {why}."),
            ("Do", "Nothing. Compensate with the calibration as it is."),
            ("Mind", f"This holds for what these readings can show. What they cannot is listed under {NEXT}."),
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
            found.append((plain(one.effect, one.where), f"{look} {to_do(one)}"))
        if any(one.origin == "instrument" for one in causes):
            found.append(("Beware", "Compensate nothing of what belongs to the instrument."))
    return [fact for fact in [*found, *extended(diagnosis)] if fact[1]]


def extended(diagnosis: Answer) -> list[tuple[str, str]]:
    """What was made of what is left unexplained, or why nothing was; nothing where it was not asked for."""
    left = diagnosis.unexplained
    if left is None or left.extension is None:
        return []
    made = left.extension
    if not made.written:
        return [("Not extended", f"What is left unexplained is not written: {made.reason}.")]
    names = " and ".join(f"“{term.where}”" for term in made.made)
    text = (
        f"{names} is in the extended calibration without a known cause. It corrects what was measured, {inside(made)}; it says "
        "nothing outside, where it is refused. If the instrument did it and not the machine, it makes parts worse."
    )
    held = made.held_out
    if held is not None and held.ci95_um is not None:
        low, high = held.ci95_um
        text += (
            f" On {held_out_words(held.of)} held out it takes the residual from {held.before_um:.3g} to {held.after_um:.3g} µm "
            f"(less by {low:.2g} to {high:.2g}, 95 %)."
        )
    others = [str(term.reason) for term in made.terms if term.reason is not None]
    if others:
        text += f" Another part of what is left is not written: {'; '.join(others)}."
    return [("Extended", text)]


def inside(made: Extension) -> str:
    """The ranges it holds in: ``inside X_mm 0 to 500 and Y_mm 0 to 450``."""
    ranges = [f"{name} {low:g} to {high:g}" for name, (low, high) in made.ranges.items()]
    return f"inside {' and '.join(ranges)}" if ranges else "at all angles"


def advised(cause: Cause) -> list[tuple[str, str]]:
    """Where to look, what to do, what not."""
    told = advice(cause.effect, cause.where)
    return [("Look here", told.look), ("Do", to_do(cause)), ("Beware", told.never)]


def to_do(cause: Cause) -> str:
    """What to do about a cause: nothing is compensated that is in no calibration."""
    if cause.promised:
        return advice(cause.effect, cause.where).do
    return (
        "Nothing is compensated: what repeats at these positions does not foretell others. Measure at positions closer together, "
        "not evenly spaced."
    )


def sentence(cause: Cause) -> str:
    """Its evidence without symbol and statistician's brackets; how far it moves a point where that gives no size."""
    text = re.sub(r" \(\d+ standard uncertainties\)", "", cause.evidence).removeprefix(f"{cause.where}: ")
    return f"{capital(text)}.{'' if SIZED.search(text) else f' {moves(cause)}'}"


def moves(cause: Cause) -> str:
    """How far it moves a point at most."""
    size = np.linalg.norm(np.nan_to_num(cause.pattern_um), axis=1).max(initial=0.0)
    what = "shifts readings" if cause.origin == "instrument" else "moves the measured points"
    return f"It {what} by up to {size:.2g} µm."


def restless(diagnosis: Answer) -> bool:
    """Whether the readings scatter more than stated, whatever is taken out of them."""
    if diagnosis.gain is None or diagnosis.unexplained is None or _written(diagnosis):
        return False
    ratio = diagnosis.gain.rms_after_um / diagnosis.expected_rms_um
    # Five standard deviations of a mean square, and enough to matter.
    return bool(ratio > RESTLESS and ratio**2 - 1.0 > 5.0 * np.sqrt(2.0 / max(diagnosis.dof, 1)))


def either_side(causes: Iterable[Cause]) -> bool:
    """Whether the machine and the instrument stand in for one another."""
    return any(
        (kind(effect) == "instrument") != (one.origin == "instrument") for one in causes for effect, _ in one.equivalent
    )


def _at_tool(diagnosis: Answer) -> str:
    gain, kinds = diagnosis.gain, {kind(cause.effect) for cause in diagnosis.causes}
    if kinds == {"instrument"}:
        return "Nothing: it is in the readings only."
    if gain is None or gain.tool_before_um <= 0.0:
        return ""
    made = f"{gain.tool_before_um:.2g} µm (RMS over the working volume)"
    if _written(diagnosis):
        return f"{made}, inside the range measured. Compensated it leaves {gain.tool_after_um:.2g} µm there."
    if diagnosis.verdict == "unexplained":
        return f"What was found makes {made}; what the rest makes is not known."
    given = ", if it is this," if diagnosis.verdict == "ambiguous" else ""
    left = f"Compensated{given} it leaves {gain.tool_after_um:.2g} µm."
    return f"{made}. {left} It matters where a tolerance is not several times larger."


def _written(diagnosis: Answer) -> bool:
    """Whether what is left unexplained is in the extended calibration."""
    left = diagnosis.unexplained
    return left is not None and left.extension is not None and left.extension.written


def _when_unexplained(diagnosis: Answer) -> list[tuple[str, str]]:
    left = diagnosis.unexplained
    if left is None:
        return []
    share = f"{percent(left.share)} of what is beyond the scatter"
    check = "Check the instrument, and the uncertainties stated for it, before anything on the machine."
    none = "where readings scatter more than stated, causes are seen that are none."
    if restless(diagnosis) and diagnosis.gain is not None:
        times = diagnosis.gain.rms_after_um / diagnosis.expected_rms_um
        rest = f"With all of that taken out they still scatter by {diagnosis.gain.rms_after_um:.2g} µm"
        return [
            ("Left over", f"{rest}, {times:.2g} times what was stated."),
            ("Do", f"{check} Then diagnose again."),
            ("Beware", f"Do not compensate with this: {none}"),
        ]
    if not left.depends_on:
        over = f"{share}, without any pattern in the columns of the table."
        if not diagnosis.causes:
            stated = f"where {diagnosis.expected_rms_um:.3g} µm were stated"
            over = f"They differ from the model by {diagnosis.rms_um:.3g} µm {stated}, without any pattern."
        return [
            ("Left over" if diagnosis.causes else "Seen", over),
            ("Do", check),
            ("Beware", f"Do not compensate yet: {none}"),
        ]
    names = listed([column(name) for name in left.depends_on])
    beware = "Do not compensate and do not repair at a guess: nothing that is known here does this."
    if _written(diagnosis):
        beware = "Do not repair at a guess: nothing that is known here does this. What is compensated may change with its cause."
    elif diagnosis.causes:
        beware = "Compensating what was found is not enough: the rest stays, and it may have pulled at the sizes found."
    return [
        ("Left over", f"{share} goes with {names} ({side(left.carrier)})."),
        ("Do", f"Look for what depends on {names}, and measure there more closely."),
        ("Beware", beware),
    ]


def _when_ambiguous(diagnosis: Answer) -> list[tuple[str, str]]:
    causes, found = diagnosis.causes[:SHOWN], []
    certain = [one for one in causes if not one.equivalent]
    for one in causes:
        name = plain(one.effect, one.where)
        if one.equivalent:
            names = listed([lower(plain(*key)) for key in one.equivalent], most=4)
            found.append(
                (
                    f"{name}, or else" if len(causes) > 1 else "Or else",
                    f"{capital(names)}. These readings fit as well with that.",
                )
            )
        else:
            found.append((name, f"{advice(one.effect, one.where).look} {to_do(one)}"))
    wanted = contests(diagnosis.next_measurement, diagnosis.expected_rms_um)
    if any(one.rows for one in wanted):
        found.append(("Do", f"First measure the points under {NEXT}: they tell which it is. Then compensate."))
    elif wanted:
        found.append(("Do", " ".join(dict.fromkeys(one.verdict for one in wanted))))
    if either_side(causes):
        what = "What is left open" if certain else "It"
        found.append(
            ("Mind", f"{what} may be the instrument and not the machine; of that nothing is to be compensated.")
        )
    found.append(("Beware", "Order no repair on what is left open." if certain else "Order no repair on this alone."))
    return found
