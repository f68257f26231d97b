"""Causes in the words of the shop: what each is called, where to look, what to do about it and what not.

The one place where the report, the text and the notebook take their words from. ISO 230-1 and the contract's names (``reversal Y``)
stand beside them as symbols.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, exp, floor, isfinite, log10
from types import MappingProxyType
from typing import Any, Final, Literal, final

from twin.machine.effects import split_name
from twin.machine.machine import DIRECTIONS

Kind = Literal["machine", "calibration", "instrument"]
MANY: Final = 8
"""Things a list names before it counts the rest."""
COVERAGE: Final = 1.96
ENOUGH: Final = 25.0
"""Chi² between two causes at which one of them is out."""
HOPELESS: Final = 1000.0
"""Readings at one place beyond which nobody takes them."""
EXTENDED: Final = "Compensate with the extended calibration"
EXTENDING: Final = "compensate with the extended calibration"
NOT_TWICE: Final = "Not both in the control and in the calibration: it would be corrected twice."
NOTHING: Final = "Compensate nothing and repair nothing on the machine because of this."


@final
@dataclass(frozen=True)
class Advice:
    """What follows from a cause.

    Attributes:
        look: where to look, and who.
        do: until it is put right.
        never: what would make it worse.
    """

    look: str
    do: str
    never: str


INSTRUMENTS: Final = (
    "frame_shift",
    "target_shift",
    "station_drift",
    "refraction_scale",
    "affine_scale",
    "time_skew",
    "read_back",
)


def kind(effect: str, origin: str) -> Kind:
    """Where a cause sits: in the machine, in the file that describes it, or in what measured it."""
    return "calibration" if effect == "misplaced" else "instrument" if origin == "instrument" else "machine"


def symbol(effect: str, where: str) -> str:
    """The contract's name: ``reversal Y``."""
    return effect if where == "—" else f"{effect} {where}"


def plain(effect: str, where: str) -> str:
    """What a cause is called where nobody knows the symbols: ``Lost motion of Y``."""
    name = PLAIN.get(effect)
    return f"{capital(effect.replace('_', ' '))} {where}" if name is None else capital(name(where))


def advice(effect: str, where: str) -> Advice:
    """What follows from a cause: where to look, what to do, what never."""
    found = ADVICE.get(effect)
    if found is None:
        return Advice("Service of the machine.", f"{EXTENDED}.", NOT_TWICE)
    axis = _axis(where)
    return Advice(*(text.replace("{axis}", axis).replace("{where}", where) for text in found))


def motion(name: str) -> str:
    """An error motion in words: ``E_ZY`` → error of Y in z; ``E_BX`` → tilt of X about y."""
    component, average, axis = split_name(name)
    direction = "xyz"[component % 3]
    if average:
        return (
            f"axis of {axis} displaced along {direction}"
            if component < 3
            else f"axis of {axis} tilted about {direction}"
        )
    if DIRECTIONS[component] == axis:
        return f"position of {axis}" if component < 3 else f"angle of {axis}"
    return f"error of {axis} in {direction}" if component < 3 else f"tilt of {axis} about {direction}"


def column(name: str) -> str:
    """A column of the table in words: ``approach_Y`` → the side Y came from."""
    if name.startswith("approach_"):
        return f"the side {name.removeprefix('approach_')} came from"
    if name.startswith("T_") and name.endswith("_degC"):
        return f"the temperature of {name[2:-5]}"
    if name.startswith("readback_"):
        return f"what the control reported of {name.split('_')[1]}"
    return {"time_s": "time", "round": "the round"}.get(name, name.rsplit("_", 1)[0])


def side(carrier: str) -> str:
    """Where the targets sit of which something is said."""
    return {"tool": "targets on the tool side", "work": "targets on the work side"}.get(
        carrier, "targets on both sides"
    )


def listed(names: Sequence[str], *, most: int = MANY) -> str:
    """A, B and C; beyond ``most``, how many more."""
    if len(names) > most:
        return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def grouped(keys: Iterable[tuple[str, str]]) -> list[str]:
    """(effect, where) by effect: ``zero_offset: X, Y, Z``."""
    by_effect: dict[str, list[str]] = {}
    for effect, where in keys:
        by_effect.setdefault(effect, []).append(where)
    return [
        f"{FAMILIES.get(effect, effect.replace('_', ' '))}: {listed(places)}" for effect, places in by_effect.items()
    ]


def missing(entries: Iterable[tuple[str, str, str]]) -> list[str]:
    """What could be tried if a column were there: (effect, where, column) by column."""
    by_column: dict[str, dict[str, list[str]]] = {}
    for effect, where, wanted in entries:
        by_column.setdefault(wanted, {}).setdefault(effect, []).append(where)
    shown: dict[str, list[str]] = {}
    for wanted, effects in by_column.items():
        family = ", ".join(FAMILIES.get(effect, effect.replace("_", " ")) for effect in effects)
        shown.setdefault(family, []).append(wanted)
    return [f"{listed(columns)}: {family}" for family, columns in shown.items()]


def measured(value: float, u: float, unit: str) -> str:
    """Return a number with its 95 % interval, to two digits of that: 9.29 ± 0.51 µm; words where either is not finite."""
    sign = "" if unit == "1" else f" {unit}"
    if not isfinite(value):
        return "not determined"
    if not isfinite(u):
        return f"{value:.4g}{sign}, uncertainty unknown".replace("-", "−")
    if u <= 0.0:
        return f"{value:.4g}{sign}".replace("-", "−")
    half = COVERAGE * u
    decimals = max(1 - floor(log10(half)), 0)
    # Plus zero: no minus before a nothing.
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {half:.{decimals}f}{sign}".replace("-", "−")


@final
@dataclass(frozen=True)
class Contest:
    """Two causes and where to measure next to tell them apart.

    Attributes:
        names: of the two, in words with their symbols.
        rows: position, sides of approach, target, station, and what a reading there tells.
        verdict: what it comes to.
    """

    names: tuple[str, str]
    rows: tuple[tuple[str, str, str, str, str], ...]
    verdict: str


def contests(wanted: Iterable[Mapping[str, Any]], sigma_um: float) -> list[Contest]:
    """The points of `Diagnosis.next_measurement`, by what they tell apart.

    Args:
        wanted: as there; entries that compare nothing are left out.
        sigma_um: what a coordinate scatters by.
    """
    by_pair: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for one in wanted:
        if "separates" in one:
            a, b = (str(name) for name in one["separates"])
            by_pair.setdefault((a, b), []).append(one)
    found = []
    for pair, points in by_pair.items():
        a, b = (_both(*_parted(name)) for name in pair)
        posed = [one for one in points if "pose" in one]
        if not posed:
            found.append(Contest((a, b), (), capital(str(points[0]["text"]).rpartition(": ")[2]) + "."))
            continue
        best = max(float(one["expected_chi2"]) for one in posed)
        apart = best**0.5 * sigma_um
        if ENOUGH > HOPELESS * best:
            text = f"No position that was tried tells them apart: they differ by {apart:.1g} µm at most. To compensate, either will do."
            found.append(Contest((a, b), (), text))
            continue
        rows = tuple(
            (
                " ".join(f"{axis}{value:g}" for axis, value in one["pose"].items()),
                " ".join(f"{axis}{'+' if sign > 0 else '−'}" for axis, sign in one["approach"].items()),
                str(one["target"]),
                str(one["station"]),
                f"{float(one['expected_chi2']) ** 0.5 * sigma_um:.2g} µm",
            )
            for one in posed
        )
        many = max(ceil(ENOUGH / best), 1)
        readings = "one reading decides" if many == 1 else f"some {many} readings decide"
        text = f"They differ most at these positions; {readings} at the first."
        if not any(name.startswith("misplaced") for name in pair):
            plan = f'twin plan -o plan.csv --separate "{pair[0]}" "{pair[1]}" --after <this table>'
            text += f" A whole plan, new stations included: {plan}."
        found.append(Contest((a, b), rows, text))
    return found


def _parted(name: str) -> tuple[str, str]:
    effect, _, where = name.partition(" ")
    return effect, where


def _both(effect: str, where: str) -> str:
    return f"{plain(effect, where)} ({symbol(effect, where)})"


def probability(p: float) -> str:
    """A p-value as a number."""
    return "p < 1e-99" if p < 1e-99 else f"p = {p:.2g}"


def chance(p: float) -> str:
    """A p-value in words: under 1 in a million; 1 in 5,000; 12 %."""
    if p < 1e-6:
        return "under 1 in a million"
    if p < 0.01:
        return f"1 in {_round_number(1.0 / p):,}"
    return f"{100.0 * p:.0f} %"


def odds(log_odds: float) -> str:
    """How many times less likely, from the natural log."""
    if log_odds > 13.8:
        return "more than a million times less likely"
    return f"about {_round_number(exp(log_odds)):,} times less likely"


def _round_number(value: float) -> int:
    """Two digits of it."""
    digits = max(len(str(int(value))) - 2, 0)
    return round(value / 10**digits) * 10**digits


def _axis(where: str) -> str:
    """The axis a place is of; the place itself if it is of none."""
    first = where.split(" ")[0]
    return split_name(first)[2] if first.startswith("E_") else first


def capital(text: str) -> str:
    """With a capital at its beginning."""
    return text[:1].upper() + text[1:]


def lower(text: str) -> str:
    """A name in the middle of a sentence: an axis keeps its capital."""
    return text if text[1:2] == " " else text[:1].lower() + text[1:]


def percent(share: float) -> str:
    """A share of one."""
    return "less than 1 %" if share < 0.005 else f"{100.0 * share:.0f} %"


def coefficient(name: str) -> bool:
    """Whether a parameter is one of a curve's many, and means nothing by itself."""
    return name[:1] in ("c", "g") and name[1:].isdigit()


def _squareness(where: str) -> str:
    component, _, axis = split_name(where)
    others = [letter for letter in "XYZ" if letter not in (axis, "XYZ"[component - 3])]
    return (
        f"{axis} out of square to {others[0]}"
        if len(others) == 1
        else f"{axis} out of square about {'xyz'[component - 3]}"
    )


def _turning(where: str) -> str:
    component, _, axis = split_name(where)
    direction = "xyz"[component % 3]
    if component < 3:
        return f"shift of {axis} along {direction} that repeats as it turns"
    if DIRECTIONS[component] == axis:
        return f"angle error of {axis} that repeats as it turns"
    return f"wobble of {axis} about {direction} that repeats as it turns"


def _turns(where: str) -> str:
    component, _, axis = split_name(where)
    direction = "xyz"[component % 3]
    return (
        f"{axis} shifts along {direction} as it turns"
        if component < 3
        else f"{axis} tilts about {direction} as it turns"
    )


def _coupled(where: str) -> str:
    name, _, by = where.partition(" by ")
    component, _, axis = split_name(name)
    direction = "xyz"[component % 3]
    if DIRECTIONS[component] == axis:
        return f"positioning of {axis} changes with {by}"
    return (
        f"straightness of {axis} in {direction} changes with {by}"
        if component < 3
        else f"tilt of {axis} about {direction} changes with {by}"
    )


def _growth(where: str) -> str:
    direction, _, sensor = where.partition(" by ")
    return f"growth along {direction.lower()} with the temperature of {sensor}"


def _again(where: str) -> str:
    station, _, number = where.rpartition("round ")
    return (
        f"instrument at {station.removesuffix(' from ')} re-aligned from round {number} on"
        if station
        else f"instrument re-aligned from round {number} on"
    )


def _bumped(where: str) -> str:
    target, _, number = where.partition(" from round ")
    return f"target {target} displaced from round {number} on"


def _filed(where: str) -> str:
    curve, _, other = where.partition(" as ")
    if other:
        return f"calibration: curve {curve} belongs under {other}"
    if where.endswith("exchanged"):
        return f"calibration: curves of {where.removesuffix(' exchanged')} exchanged"
    axis, _, joint = where.partition(" at ")
    return f"calibration: errors of {axis} put at {joint if joint.startswith('the ') else f'joint {joint}'}"


PLAIN: Final[Mapping[str, Callable[[str], str]]] = MappingProxyType(
    {
        "reversal": lambda where: f"lost motion of {where}",
        "reversal_curve": lambda where: f"lost motion of {where} that changes along its travel",
        "pitch_error": lambda where: f"periodic positioning error of {where}",
        "squareness": _squareness,
        "axis_location": lambda where: motion(where),
        "angular_error_motion": lambda where: (
            f"{split_name(where)[2]} tilts about {'xyz'[split_name(where)[0] - 3]} as it travels"
        ),
        "straightness": lambda where: f"straightness of {split_name(where)[2]} in {'xyz'[split_name(where)[0]]}",
        "positioning": lambda where: f"positioning of {split_name(where)[2]}",
        "error_motion": _turns,
        "harmonic": _turning,
        "thermal_expansion": lambda where: f"scale of {where} lengthens with its temperature",
        "thermal_growth": _growth,
        "thermal_drift": lambda where: f"warm-up drift along {where.lower()}",
        "cross_axis": _coupled,
        "table_load": lambda where: f"table on {where} droops as {where} turns",
        "frame_shift": _again,
        "gravity_compliance": lambda where: f"{where} gives way under the weight it carries",
        "payload": lambda where: f"a load on the {where} side that the machine's description does not have",
        "zero_offset": lambda where: f"zero of {where} off",
        "read_back": lambda where: f"reported positions of {where} were read too early",
        "following_error": lambda where: f"{where} stopped short of where it was told to go",
        "refraction_scale": lambda where: "all lengths read too long or too short",
        "time_skew": lambda where: f"readings and positions of {where} not taken at the same moment",
        "affine_scale": lambda where: f"scales and right angles of the instrument off ({where})",
        "station_drift": lambda where: f"instrument at station {where} creeps",
        "target_shift": _bumped,
        "misplaced": _filed,
    }
)
FAMILIES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "reversal": "lost motion",
        "reversal_curve": "lost motion that changes along the travel",
        "pitch_error": "periodic positioning errors",
        "axis_location": "places of rotary axes",
        "angular_error_motion": "tilts along the travel",
        "error_motion": "errors of rotary axes",
        "harmonic": "errors that repeat with the turn",
        "thermal_expansion": "scales lengthening with temperature",
        "thermal_growth": "growth with temperature",
        "thermal_drift": "warm-up drift",
        "cross_axis": "errors of one axis that change with another",
        "table_load": "droop of the table",
        "frame_shift": "instrument re-aligned",
        "gravity_compliance": "yielding under weight",
        "payload": "loads that the description does not have",
        "zero_offset": "zeros of axes",
        "read_back": "whether the control's reports can be trusted",
        "refraction_scale": "scale of all lengths",
        "time_skew": "delay between readings and positions",
        "affine_scale": "scales and right angles of the instrument",
        "station_drift": "creep of the instrument",
        "target_shift": "displaced targets",
        "misplaced": "curves of the calibration in the wrong place",
    }
)
_ANEW: Final = (
    "Whether the calibration is still this machine's: its date, and what was repaired, moved or levelled since. Then service: guideway "
    "and bearings of {axis}.",
    f"{EXTENDED}, or measure {{axis}} again (twin identify).",
    "Do not shift a zero against it: it changes along the travel, a zero does not.",
)
ADVICE: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {
        "reversal": (
            "Service: nut and preload of {axis}'s screw (a rotary axis: worm or gear), thrust bearing, coupling, seat of the scale.",
            f"{EXTENDED}: it knows from which side {{axis}} comes. Or enter it as backlash in the control.",
            f"{NOT_TWICE} Do not shift the zero of {{axis}}: that moves the error and leaves it as large.",
        ),
        "reversal_curve": (
            "Service: wear of {axis}'s screw and nut where it works most, tension of the screw, friction of the guideway.",
            f"{EXTENDED}: it knows from which side {{axis}} comes, and where it is.",
            f"{NOT_TWICE} Do not enter one backlash in the control: it is right at one place only.",
        ),
        "pitch_error": (
            "Service: what of {axis} has this period: screw (its lead), coupling, gear, or the grating of the scale.",
            f"{EXTENDED}.",
            "Do not check it in steps of its period or a multiple: it would not show. " + NOT_TWICE,
        ),
        "squareness": (
            "Service: levelling of the machine, fixing of column and guideways; ask for a collision or a move.",
            f"{EXTENDED}. After levelling, measure again.",
            "Do not level the machine and go on with the numbers of before.",
        ),
        "axis_location": (
            "Set-up: the place and tilt of {axis}'s axis in the control's kinematics, and how they were measured.",
            f"Enter the new place in the control, or {EXTENDING}.",
            NOT_TWICE,
        ),
        "angular_error_motion": _ANEW,
        "straightness": _ANEW,
        "positioning": (
            _ANEW[0],
            _ANEW[1],
            "Do not fill the control's pitch table as well: it would be corrected twice.",
        ),
        "error_motion": _ANEW,
        "harmonic": (
            "Service: what turns with {axis}: bearing and encoder (once a turn), worm or gear teeth (many times a turn).",
            f"{EXTENDED}.",
            "Do not check {axis} in steps of this period or a multiple: it would not show.",
        ),
        "thermal_expansion": (
            "Service: where {axis}'s scale is held, and what the control's own temperature compensation does.",
            f"{EXTENDED} and say the temperature (--temperature {{axis}}=…).",
            "Do not set zero or scale anew for one temperature: they are wrong at the next. " + NOT_TWICE,
        ),
        "thermal_growth": (
            "Shop and service: what warms at that sensor: coolant, drives, sun, draught.",
            f"Keep the temperature steady, or {EXTENDING} and say the temperature (--temperature).",
            "Do not shift a zero against it: the next temperature asks for another.",
        ),
        "thermal_drift": (
            "Shop: how long the machine ran before work and before it was measured. Service: spindle cooling.",
            f"Warm the machine up before precise work, or {EXTENDING} and say the time (--time).",
            "Do not set zero in the first hours: it will be wrong when the machine is warm.",
        ),
        "cross_axis": (
            "Service: preload and wear of the guideways of both axes, levelling, what hangs over at the end of the travel.",
            f"{EXTENDED}.",
            "Do not correct one axis alone: that is right at one place of the other only.",
        ),
        "table_load": (
            "Set-up: what lay on the table when the calibration was made, and what lies there now. Service: bearings of {axis}.",
            f"{EXTENDED}, for this load.",
            "Do not use it for another load.",
        ),
        "gravity_compliance": (
            "Service: clamp, drive and bearing of {axis}; what it carries.",
            f"{EXTENDED}, for this load.",
            "Do not use it for another load.",
        ),
        "payload": (
            "Set-up: what was mounted on the {where} side when it was measured; weigh it.",
            f"{EXTENDED}, for this load.",
            "Do not use it for another load.",
        ),
        "zero_offset": (
            "Set-up: reference mark and homing of {axis}; ask for a collision.",
            f"Set the zero of {{axis}} in the control, or {EXTENDING}.",
            NOT_TWICE,
        ),
        "following_error": (
            "Service: the drive of {axis}: it does not reach its command. Set-up: the dwell before each reading.",
            "Let {axis} settle and measure again. It does not go into the calibration.",
            "Do not compensate it: how far the axis lags depends on speed and load.",
        ),
        "misplaced": (
            "Whoever made the calibration file.",
            "Correct the file and diagnose again.",
            "Do not look for it in the machine: nothing mechanical is wrong here.",
        ),
        "frame_shift": (
            "Who measured: what happened before {where}: a new alignment, a bumped tripod.",
            "Use the rest: it has been taken out of the account. Better, measure again in one alignment.",
            NOTHING,
        ),
        "refraction_scale": (
            "Who measured: air temperature, pressure and humidity at the instrument, and its certificate.",
            "Use the rest: it has been taken out of the account.",
            NOTHING,
        ),
        "time_skew": (
            "Who measured: how readings and positions of {axis} are brought together: trigger, filter, delay of the instrument.",
            "Use the rest: it has been taken out of the account. Better, measure again at standstill, or at half the feed.",
            NOTHING,
        ),
        "affine_scale": (
            "Who measured: certificate and temperature compensation of the instrument in {where}; measure a calibrated length with it.",
            "Use the rest: it has been taken out of the account. Better, measure again with an instrument that was checked.",
            NOTHING,
        ),
        "station_drift": (
            "Who measured: tripod, floor, and whether the instrument was warm.",
            "Use the rest: it has been taken out of the account. Better, measure again from a steady stand.",
            NOTHING,
        ),
        "target_shift": (
            "Who measured: how that target is held.",
            "Use the rest: it has been taken out of the account.",
            NOTHING,
        ),
        "read_back": (
            "Who measured: when the control's positions were read.",
            "Go by the commands, or wait until {axis} stands still before reading.",
            NOTHING,
        ),
    }
)
"""Where to look, what to do, what never."""


def held_out_words(of: str) -> str:
    """What was held out: rounds, positions, poses, or blocks of time."""
    return "blocks of time" if of == "blocks" else of


def likelihood_words(probability: float, alone: bool) -> str:
    """What the second method says of a cause, or of it and what could as well be."""
    size = "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
    what = "is there" if alone else "or one of those it could as well be is there"
    return f"probability that it {what}: {size} (a second method, independent of the search)"
