"""What a comparison means, in sentences a technician can act on: nothing that the numbers do not say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.comparison.result import Changes, ErrorChange
from twin.comparison.significance import SHARE
from twin.display import readable
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.effects import split_name
from twin.machine.machine import Machine

MOST_NAMED: Final = 6


def meaning_of(found: Changes) -> tuple[str, ...]:
    """Sentences, the most important first."""
    verdict = found.verdict
    said: list[str] = []
    if verdict == "same":
        said.append("The two calibrations are the very same numbers: nothing to compare.")
    elif verdict == "unknown":
        same = any(error.status == "same" for error in found.errors)
        why = (
            "what both give are the very same numbers or without uncertainty"
            if same
            else "for no error do both calibrations give an uncertainty"
        )
        said.append(f"Whether anything changed cannot be said: {why}. The differences are listed as they are.")
    elif verdict == "unchanged":
        said += _unchanged(found)
    else:
        said += _changed(found)
    if verdict == "reworded":
        said.insert(
            0,
            "The numbers changed and the tool did not: what one error adds another takes away, as where the same constant or slope "
            "stands under another name. Both calibrations compensate alike; the machine need not be touched.",
        )
    if found.unjudged and verdict in ("unchanged", "changed"):
        left_out = {name for name, _ in found.left_out}
        names = [name for name in dict.fromkeys(found.unjudged) if name not in left_out]
        if left_out:
            needs = ", ".join(f"{name} (needs {channel})" for name, channel in found.left_out)
            said.append(f"What is said of the tool leaves out {needs}.")
    else:
        names = []
    if names:
        said.append(f"This does not cover what could not be compared or judged: {_list(names, MOST_NAMED)}.")
    said += _tolerance(found)
    return tuple(said)


def number(value: float) -> str:
    """Three digits that count, without an exponent where one can do without."""
    if value == 0.0 or not np.isfinite(value):
        return f"{value:g}"
    digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{min(digits, 4)}f}"


def with_sign(value: float) -> str:
    """The same with its sign."""
    return ("+" if value > 0.0 else "") + number(value)


def plus_minus(value: float, half: float) -> str:
    """A change with the half width of its 95 % interval, to the digits that one has."""
    if not np.isfinite(half) or half <= 0.0:
        return with_sign(value)
    digits = min(max(0, 1 - int(np.floor(np.log10(half)))), 4)
    return f"{value:+.{digits}f} ± {half:.{digits}f}"


def place(where: Mapping[str, float]) -> str:
    """Positions by axis, whole mm and degrees."""
    return ", ".join(f"{name} {value:.0f}" for name, value in where.items())


def _list(names: Sequence[str], most: int) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _unchanged(found: Changes) -> list[str]:
    row = found.tool.judged
    said = [
        "All changes that could be judged are within the uncertainty of the two calibrations: the older one stands."
    ]
    if row is not None and np.isfinite(row.limit_um):
        said.append(
            f"That is as sharp as the two are: a change that moves the tool by less than some {number(row.limit_um)} µm RMS over the "
            "volume may not have shown, unless it is in one or a few errors: these show earlier."
        )
    if found.culprits.shows_from:
        shown = ", ".join(f"{name} {number(size)} {readable(own)}" for name, size, own in found.culprits.shows_from)
        said.append(f"Alone, with all else unchanged, these would have shown in 19 of 20 comparisons from: {shown}.")
    return said


def _changed(found: Changes) -> list[str]:
    culprits = found.culprits
    said = []
    if culprits.errors:
        only = (
            "Only "
            if len(culprits.errors) == 1 and culprits.left_p_value > SHARE and not culprits.alternatives[0]
            else ""
        )
        for error, others, trend in zip(culprits.errors, culprits.alternatives, culprits.trends, strict=True):
            said.append(_one(found, error, others, trend, only))
        if culprits.left_p_value > SHARE:
            said.append(
                "With that everything else is within uncertainty; this is estimated with all else taken as unchanged."
            )
        else:
            said.append("That does not account for all of it: more has changed than can be pinned to single errors.")
        if found.verdict != "reworded":
            said += _pattern(found)
    else:
        own = [error.name for error in found.errors if error.significant]
        if own:
            said.append(f"Changed beyond its uncertainty, seen by itself: {_list(own, MOST_NAMED)}.")
        else:
            said.append(
                "Something has changed, but these two calibrations do not say which error: no single one stands out. Seen by: "
                f"{', '.join(found.seen_by)}."
            )
    return said


def _one(found: Changes, error: ErrorChange, others: Sequence[str], trend: str, only: str) -> str:
    half = error.band if error.kind == "curve" else COVERAGE_FACTOR * error.u
    axis = found.machine.by_name[error.axis]
    size = f"{plus_minus(error.largest, half)} {readable(error.unit)}"
    what = f"{_kind(error, found.machine)} {error.name}"
    what = what if only else what[0].upper() + what[1:]
    if error.kind == "curve":
        shape = {
            "constant": f", the same all along {error.axis}",
            "line": f", evenly along {error.axis}",
            "bow": f", as a bow along {error.axis}",
            "turn": f", once a turn of {error.axis}",
        }.get(trend, "")
        text = f"{only}{what} changed, by up to {size} (95 %) at {error.axis} {error.at:.0f} {axis.unit}{shape}"
    elif error.kind == "number":
        text = f"{only}{what} changed, by {size} (95 %)"
    else:
        text = f"{only}{what} changed: {error.label} by {size} (95 %)"
    row = found.tool.by_cause.get(error.name)
    if row is not None:
        text += (
            f": {number(row.max_um)} µm at the tool at {place(row.where)}, {number(row.rms_um)} µm RMS over the volume"
        )
    if others:
        text += f"; a change of {_list(others, 3)} instead would account for it about as well"
    return text + "."


def _kind(error: ErrorChange, machine: Machine) -> str:
    if not error.name.startswith("E_"):
        return "the effect"
    component, average, axis = split_name(error.name)
    if average:
        if machine.by_name[axis].linear:
            return "the squareness"
        return f"where {axis}'s average line {'lies,' if component < 3 else 'points,'}"
    return {
        "L-POS": "the positioning error",
        "R-POS": "the positioning error",
        "L-STR": "the straightness",
        "R-RAX": "the axial or radial error motion",
    }.get(error.iso_class, "the angular error motion")


def _pattern(found: Changes) -> list[str]:
    """What those that changed have in common, where they have something."""
    errors, machine = found.culprits.errors, found.machine
    if any(found.culprits.alternatives):
        return ["Measure again, or with other poses, before anything is adjusted: which error it is is not settled."]
    axes = list(dict.fromkeys(error.axis for error in errors))
    classes = {error.iso_class for error in errors}
    scales = [error for error in errors if error.iso_class == "L-POS" and error.kind == "curve"]
    lines = all(trend == "line" for trend in found.culprits.trends)
    if len(errors) == 1:
        return [_remedy(errors[0], found.culprits.trends[0], machine)]
    if len(scales) == len(errors) and lines and _alike(scales, machine):
        rates = ", ".join(f"{e.axis} {_rate(e, machine):+.1f} ± {_rate_u(e, machine):.1f} µm/m" for e in scales)
        return [
            f"All scales changed alike ({rates}): that is what a temperature that was not corrected for looks like, or the "
            "instrument's own scale (wavelength, refractive index). Check these before the machine."
        ]
    if len(axes) == 1:
        at = axes[0]
        if classes <= {"R-POR"}:
            return [
                f"Only where {at} lies changed: the rotary table has moved as a whole, or was set up anew. Its fixing comes first."
            ]
        return [
            f"Everything that changed is at one axis, {at}: that is what a knock, a loose part or wear at {at}'s guide, bearing or "
            "joint would do. Look there first; the numbers do not tell which of these."
        ]
    if classes <= {"L-SQU"}:
        return [
            "Only squareness changed: the axes have settled against each other, as after moving or levelling the machine."
        ]
    return [
        f"Changes at several axes ({', '.join(axes)}): as after a collision, moving or levelling the machine, or a measurement under "
        "other conditions than the first. Make sure of temperature and set-up before the machine is touched."
    ]


def _remedy(error: ErrorChange, trend: str, machine: Machine) -> str:
    newer = "compensate with the newer calibration" if machine.runs_programs else "use the newer calibration"
    _, average, axis = split_name(error.name) if error.name.startswith("E_") else (0, False, error.axis)
    if error.iso_class == "L-SQU":
        return f"Re-align {axis}, or {newer}."
    if error.name.startswith("reversal"):
        return f"Lost motion of {axis} changed: look at its drive (preload, bearing, belt), or {newer}."
    if average:
        return f"Determine where {axis} lies anew in the control, or {newer}."
    if trend == "constant":
        return (
            f"A constant is {axis}'s zero, or where the measurement counted from: check the reference run, and whether both "
            "measurements were touched off alike, before anything else."
        )
    if error.iso_class == "L-POS":
        return f"Check the temperature at which {axis}'s scale was measured; if that was right, {newer}."
    return f"Look at {axis}'s guide or bearing, or {newer}."


def _rate(error: ErrorChange, machine: Machine) -> float:
    """µm a metre of a change that is a straight line without a constant in the middle of its range."""
    return error.largest / _arm(error, machine) * 1e3


def _rate_u(error: ErrorChange, machine: Machine) -> float:
    return abs(COVERAGE_FACTOR * error.u / _arm(error, machine)) * 1e3


def _arm(error: ErrorChange, machine: Machine) -> float:
    lo, hi = machine.by_name[error.axis].domain
    return error.at - (lo + hi) / 2.0 or 1.0


def _alike(scales: Sequence[ErrorChange], machine: Machine) -> bool:
    """Whether all slopes are one number within their uncertainty."""
    rates = np.array([_rate(error, machine) for error in scales])
    u = np.array([_rate_u(error, machine) for error in scales])
    if len(rates) < 2 or np.any(u <= 0.0):
        return False
    weight = u**-2
    mean = float(np.sum(weight * rates) / np.sum(weight))
    return bool(np.all(np.abs(rates - mean) <= 1.5 * u))


def _tolerance(found: Changes) -> list[str]:
    left, answer = found.tool.left, found.good_enough
    if not left.poses:
        return ["What the older calibration would leave cannot be said: none of the poses is in reach."]
    if found.tolerance_mm is None:
        return []
    limit = f"{number(found.tolerance_mm * 1e3)} µm"
    most = f"{number(left.max_um)} µm at most"
    if answer is True:
        return [
            f"The older calibration is good enough for {limit}: it leaves {most}, with all uncertainty no more than "
            f"{number(left.surely_um)} µm (95 %)."
        ]
    if answer is False:
        return [
            f"The older calibration is not good enough for {limit}: it leaves {most} (at {place(left.where)}), with all uncertainty no "
            f"less than {number(left.at_least_um)} µm (95 %)."
        ]
    if np.isfinite(left.surely_um):
        return [
            f"Whether the older calibration is good enough for {limit} cannot be told: these two say it leaves {most}, with their "
            f"uncertainty something from {number(max(left.at_least_um, 0.0))} to {number(left.surely_um)} µm (95 %)."
        ]
    return [
        f"Whether the older calibration is good enough for {limit} cannot be told: it leaves {most} if both are right, and how "
        "uncertain that is is not known."
    ]
