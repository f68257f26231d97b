"""Names, advice and numbers in the words of the workshop.

The report, the text and the notebook all take their words from here. The symbols (ISO 230-1 names, ``reversal Y``) are given with them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import ceil, exp, floor, isfinite, log10
from typing import Any, Final, final

from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.display.numbers import COVERAGE_FACTOR, figure
from twin.display.sentences import capital, listed
from twin.machine.effects.names import axis_of
from twin.machine.effects.specification import Advice, Kind, title_of

ENOUGH: Final = 25.0
"""Expected χ² between the predictions of two causes that rules one of them out."""
HOPELESS: Final = 1000.0
"""Number of readings at one position above which the measurement is not suggested."""


def micrometres(value: float) -> str:
    """Return a size in µm with two significant digits and no exponent."""
    return figure(value, "µm", digits=2)


def kind(effect: str) -> Kind:
    """Return whether the cause is an error of the machine, of the calibration file or of the instrument."""
    return SPECIFICATIONS[effect].kind


def symbol(effect: str, where: str) -> str:
    """Return effect and place as in the JSON: ``reversal Y``."""
    return effect if where == "—" else f"{effect} {where}"


def cause_title(effect: str, where: str) -> str:
    """Return the name of a cause in words, without symbols."""
    return title_of(SPECIFICATIONS.get(effect), effect, where)


def family(effect: str) -> str:
    """Return the plural name of all causes of one effect."""
    return SPECIFICATIONS[effect].plural


def advice(effect: str, where: str) -> Advice:
    """Return where to look for a cause, what to do about it, and what to avoid."""
    found, axis = SPECIFICATIONS[effect].advice, axis_of(where)
    texts = (text.replace("{axis}", axis).replace("{where}", where) for text in (found.look, found.do, found.never))
    return Advice(*texts)


def column(name: str) -> str:
    """Return a column of the table in words: ``approach_Y`` → the approach direction of Y."""
    if name.startswith("approach_"):
        return f"the approach direction of {name.removeprefix('approach_')}"
    if name.startswith("T_") and name.endswith("_degC"):
        return f"the temperature of {name[2:-5]}"
    if name.startswith("readback_"):
        return f"the position of {name.split('_')[1]} reported by the control"
    return {"time_s": "time", "round": "the round"}.get(name, name.rsplit("_", 1)[0])


def side(carrier: str) -> str:
    """Return in words which points a statement is about."""
    return {"tool": "points on the tool side", "work": "points on the work side"}.get(carrier, "points on both sides")


def grouped(keys: Iterable[tuple[str, str]]) -> list[str]:
    """Return one line per effect with its places: ``zero offsets: X, Y and Z``."""
    by_effect: dict[str, list[str]] = {}
    for effect, where in keys:
        by_effect.setdefault(effect, []).append(where)
    return [f"{family(effect)}: {listed(places)}" for effect, places in by_effect.items()]


def missing(entries: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return one line per missing column with the effects that need it.

    Args:
        entries: (effect, where, missing column).
    """
    by_column: dict[str, dict[str, list[str]]] = {}
    for effect, where, wanted in entries:
        by_column.setdefault(wanted, {}).setdefault(effect, []).append(where)
    shown: dict[str, list[str]] = {}
    for wanted, effects in by_column.items():
        shown.setdefault(", ".join(family(effect) for effect in effects), []).append(wanted)
    return [f"{listed(columns)}: {families}" for families, columns in shown.items()]


def measured(value: float, u: float, unit: str) -> str:
    """Return a value with its 95 % interval to two digits of the interval (9.29 ± 0.51 µm), or words if either is not finite."""
    sign = "" if unit == "1" else f" {unit}"
    if not isfinite(value):
        return "not determined"
    if not isfinite(u):
        return f"{value:.4g}{sign}, uncertainty unknown".replace("-", "−")
    if u <= 0.0:
        return f"{value:.4g}{sign}".replace("-", "−")
    half = COVERAGE_FACTOR * u
    decimals = max(1 - floor(log10(half)), 0)
    # Adding zero turns −0.0 into 0.0.
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {half:.{decimals}f}{sign}".replace("-", "−")


@final
@dataclass(frozen=True)
class SeparatingPoints:
    """Two confounded causes and the points whose measurement separates them.

    Attributes:
        names: of the two, in words with their symbols.
        rows: position, approach directions, target, station, and the difference between the two predictions there.
        verdict: whether and how they can be separated, one or two sentences.
    """

    names: tuple[str, str]
    rows: tuple[tuple[str, str, str, str, str], ...]
    verdict: str


def separating_points(wanted: Iterable[Mapping[str, Any]], sigma_um: float) -> list[SeparatingPoints]:
    """Return the points of `Diagnosis.next_measurement`, grouped by the pair of causes they separate.

    Args:
        wanted: entries of `Diagnosis.next_measurement`; those without a pair of causes are ignored.
        sigma_um: standard deviation of the noise of a coordinate.
    """
    by_pair: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for entry in wanted:
        if "separates" in entry:
            a, b = (str(name) for name in entry["separates"])
            by_pair.setdefault((a, b), []).append(entry)
    found = []
    for pair, points in by_pair.items():
        a, b = (_name_and_symbol(*_split_key(name)) for name in pair)
        task = [one for one in points if "pose" in one]
        if not task:
            text = capital(str(points[0]["text"]).rpartition(": ")[2]) + "."
            found.append(SeparatingPoints((a, b), (), text))
            continue
        best = max(float(one["expected_chi2"]) for one in task)
        difference_um = best**0.5 * sigma_um
        if ENOUGH > HOPELESS * best:
            text = (
                f"No position that was tried separates them: their predictions differ by at most {difference_um:.1g} µm. "
                "Either can be used for compensation."
            )
            found.append(SeparatingPoints((a, b), (), text))
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
        readings = "one reading is enough" if many == 1 else f"about {many} readings are enough"
        text = f"Their predictions differ most at these positions; at the first, {readings}."
        if not any(name.startswith("misplaced") for name in pair):
            plan = f'twin plan -o plan.csv --separate "{pair[0]}" "{pair[1]}" --after <this table>'
            text += f" For a complete plan with new station positions: {plan}."
        found.append(SeparatingPoints((a, b), rows, text))
    return found


def _split_key(name: str) -> tuple[str, str]:
    effect, _, where = name.partition(" ")
    return effect, where


def _name_and_symbol(effect: str, where: str) -> str:
    return f"{cause_title(effect, where)} ({symbol(effect, where)})"


def chance(p: float) -> str:
    """Return a p-value in words: under 1 in a million; 1 in 5,000; 12 %."""
    if p < 1e-6:
        return "under 1 in a million"
    if p < 0.01:
        return f"1 in {_round_number(1.0 / p):,}"
    return f"{100.0 * p:.0f} %"


def odds(log_odds: float) -> str:
    """Return in words how many times less likely something is, from the natural log of the odds."""
    if log_odds > 13.8:
        return "more than a million times less likely"
    return f"about {_round_number(exp(log_odds)):,} times less likely"


def _round_number(value: float) -> int:
    """Return the value rounded to its first two digits."""
    digits = max(len(str(int(value))) - 2, 0)
    return round(value / 10**digits) * 10**digits


def percent(share: float) -> str:
    """Return a fraction of one in percent."""
    return "less than 1 %" if share < 0.005 else f"{100.0 * share:.0f} %"


def coefficient(name: str) -> bool:
    """Return whether a parameter is a coefficient of a curve, which means nothing by itself."""
    return name[:1] in ("c", "g") and name[1:].isdigit()


def held_out_words(of: str) -> str:
    """Return in words what was held out: rounds, positions, poses, or blocks of time."""
    return "blocks of time" if of == "blocks" else of


def likelihood_words(probability: float, alone: bool) -> str:
    """Return the Bayesian probability of a cause, or of a cause and its equivalents together, in words."""
    size = "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
    what = "this cause is present" if alone else "this cause or one of its alternatives is present"
    return f"probability that {what}: {size} (second, Bayesian method)"
