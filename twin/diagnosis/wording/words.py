"""Causes in the words of the shop: what each is called, where to look, what to do about it and what not.

The one place where the report, the text and the notebook take their words from. ISO 230-1 and the contract's names (``reversal Y``)
stand beside them as symbols.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, exp, floor, isfinite, log10
from typing import Any, Final, final

from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.effects.names import axis_of
from twin.machine.effects.specification import Advice, Kind

MANY: Final = 8
"""Things a list names before it counts the rest."""
ENOUGH: Final = 25.0
"""Chi² between two causes at which one of them is out."""
HOPELESS: Final = 1000.0
"""Readings at one place beyond which nobody takes them."""


def kind(effect: str) -> Kind:
    """Where a cause sits: in the machine, in the file that describes it, or in what measured it."""
    return SPECIFICATIONS[effect].kind


def symbol(effect: str, where: str) -> str:
    """The contract's name: ``reversal Y``."""
    return effect if where == "—" else f"{effect} {where}"


def plain(effect: str, where: str) -> str:
    """What a cause is called where nobody knows the symbols: ``Lost motion of Y``."""
    known = SPECIFICATIONS.get(effect)
    return f"{capital(effect.replace('_', ' '))} {where}" if known is None else capital(known.title(where))


def family(effect: str) -> str:
    """What all causes of one effect are called."""
    return SPECIFICATIONS[effect].plural


def advice(effect: str, where: str) -> Advice:
    """What follows from a cause: where to look, what to do, what never."""
    found, axis = SPECIFICATIONS[effect].advice, axis_of(where)
    texts = (text.replace("{axis}", axis).replace("{where}", where) for text in (found.look, found.do, found.never))
    return Advice(*texts)


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
    return [f"{family(effect)}: {listed(places)}" for effect, places in by_effect.items()]


def missing(entries: Iterable[tuple[str, str, str]]) -> list[str]:
    """What could be tried if a column were there: (effect, where, column) by column."""
    by_column: dict[str, dict[str, list[str]]] = {}
    for effect, where, wanted in entries:
        by_column.setdefault(wanted, {}).setdefault(effect, []).append(where)
    shown: dict[str, list[str]] = {}
    for wanted, effects in by_column.items():
        shown.setdefault(", ".join(family(effect) for effect in effects), []).append(wanted)
    return [f"{listed(columns)}: {families}" for families, columns in shown.items()]


def measured(value: float, u: float, unit: str) -> str:
    """Return a number with its 95 % interval, to two digits of that: 9.29 ± 0.51 µm; words where either is not finite."""
    sign = "" if unit == "1" else f" {unit}"
    if not isfinite(value):
        return "not determined"
    if not isfinite(u):
        return f"{value:.4g}{sign}, uncertainty unknown".replace("-", "−")
    if u <= 0.0:
        return f"{value:.4g}{sign}".replace("-", "−")
    half = COVERAGE_FACTOR * u
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
        task = [one for one in points if "pose" in one]
        if not task:
            found.append(Contest((a, b), (), capital(str(points[0]["text"]).rpartition(": ")[2]) + "."))
            continue
        best = max(float(one["expected_chi2"]) for one in task)
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
            for one in task
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


def held_out_words(of: str) -> str:
    """What was held out: rounds, positions, poses, or blocks of time."""
    return "blocks of time" if of == "blocks" else of


def likelihood_words(probability: float, alone: bool) -> str:
    """What the second method says of a cause, or of it and what could as well be."""
    size = "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
    what = "is there" if alone else "or one of those it could as well be is there"
    return f"probability that it {what}: {size} (a second method, independent of the search)"
