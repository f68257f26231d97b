"""Formatting of numbers: rounded according to their uncertainty, or marked as unknown."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import floor, isfinite, log10
from typing import Final

from twin._common.messages import Message, Number, joined

COVERAGE: Final = 0.95
"""Coverage probability of every interval and radius that twin prints."""
COVERAGE_FACTOR: Final = 1.959963984540054
"""Coverage factor k of a normal distribution for that probability: the interval is the value ± k u (JCGM 100, G.1.3)."""
UNKNOWN: Final = Message("unknown")
LEAST: Final = Message("at least")
"""Before a lower bound."""
TIED: Final = re.compile(r"(\d) (µm|µrad|mm|°|%|ppm)")
"""A number and its unit, to be joined by a non-breaking space."""
_ROUND: Final = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


def finite_or_none(value: float) -> float | None:
    """Return a number for JSON, or None (null) if it is not finite."""
    return float(value) if isfinite(value) else None


def rounded(value: float, expanded: float) -> tuple[str, str]:
    """Return value and uncertainty as text: at most two significant digits (JCGM 100, 7.2.6), the value to the same decimal."""
    decimals = 1 - floor(log10(expanded)) if expanded > 0.0 else 3
    decimals = min(max(decimals, 0), 3)
    return f"{value:.{decimals}f}", f"{expanded:.{decimals}f}"


def measured(value: float, u: float, unit: str) -> str:
    """Return a number with its 95 % interval from u (k = 1): ``9.29 ± 0.51 µm``; ``9.3 µm, ± unknown`` if u is NaN."""
    sign = readable(unit)
    if isfinite(u):
        return Number(f"{_interval(value, COVERAGE_FACTOR * u)} {sign}")
    return Message("{value} {unit}, ± unknown", value=Number(plain(value)), unit=sign)


def with_half(value: float, half: float, unit: str) -> str:
    """Return a number with the half width of its 95 % interval, to two digits of that, or with ``± unknown`` if that is NaN."""
    sign = readable(unit)
    if not isfinite(half):
        return Message("{value} (± unknown)", value=figure(value, sign))
    return figure(value, sign) if half <= 0.0 else Number(f"{_interval(value, half)} {sign}")


def figure(value: float, unit: str = "", *, digits: int = 3) -> str:
    """Return a number with three significant ``digits``, at most two decimals, no exponent, and its unit; `UNKNOWN` for NaN."""
    if not isfinite(value):
        return UNKNOWN
    decimals = 2 if value == 0.0 else min(max(digits - 1 - floor(log10(abs(value))), 0), 2)
    text = fixed(round(value, decimals), decimals)
    return Number(f"{text} {unit}" if unit else text)


def expanded(value: float, *, complete: bool = True, unit: str = "µm", least: str = LEAST) -> str:
    """Return U of the tool point as text: `UNKNOWN` for NaN, with ``least`` in front if incomplete, that is, a lower bound."""
    text = figure(value, unit)
    return text if complete or not isfinite(value) else joined(" ", [least, text])


def place(where: Mapping[str, float]) -> str:
    """Return axis positions as text: ``X 467, Y 433, B 125``."""
    return ", ".join(f"{name} {round(value):g}".replace("-", "−") for name, value in where.items())


def compact(value: float) -> str:
    """Return a number with three significant digits, without trailing zeros and exponent."""
    if value == 0 or not 1e-3 <= abs(value) < 1e9:
        return Number("0" if value == 0 else f"{value:.2g}")
    text = f"{value:.{max(0, 2 - floor(log10(abs(value))))}f}"
    return Number(text.rstrip("0").rstrip(".") if "." in text else f"{int(text):,}".replace(",", "\u202f"))


def plain(value: float) -> str:
    """Return a number of unknown uncertainty with three digits, without decimals from 100 on."""
    return fixed(value, 0) if abs(value) >= 100.0 else signed(f"{value:.3g}")


def fixed(value: float, decimals: int) -> str:
    """Return a number with fixed decimals and a minus sign (U+2212)."""
    return signed(f"{value:.{decimals}f}")


def span(low: float, high: float, unit: str) -> str:
    """Return a range as text: ``−400 … 0 mm``, ``0 … 180°``."""
    sign = readable(unit)
    return f"{low:g} … {high:g}{'' if sign == '°' else ' '}{sign}".replace("-", "−")


def readable(unit: str) -> str:
    """Return a unit as displayed: ``um/(m.K)`` → µm/(m·K), ``deg`` → °."""
    plain = unit.replace("urad", "µrad").replace("um", "µm").replace("m2", "m²").replace(".", "·")
    return "°" if plain == "deg" else plain


def ceiling(value: float) -> float:
    """Return the next round number at or above a value, less than a third larger; 1 for zero or no number."""
    if not isfinite(value) or value <= 0.0:
        return 1.0
    power = 10.0 ** floor(log10(value))
    return next(digit * power for digit in _ROUND if digit * power >= value * (1.0 - 1e-12))


def p_value_text(p: float) -> str:
    """Return a p-value as a number: p = 0.012."""
    return Number("p < 1e-99" if p < 1e-99 else f"p = {p:.2g}")


def with_joined_units(text: str, space: str) -> str:
    """Return a text with the given space between numbers and their units."""
    return TIED.sub(rf"\1{space}\2", text)


def _interval(value: float, half: float) -> str:
    size, uncertainty = rounded(value, half)
    return f"{signed(size)} ± {uncertainty}"


def signed(text: str) -> str:
    """Return a number's text with a minus sign (U+2212), and none before zero."""
    return text.lstrip("-") if not text.strip("-0.") else text.replace("-", "−")


# --- Parts of sentences in plain text: lists of names, capital and small first letters ------------

MANY: Final = 8
"""Items listed by name; the rest are counted."""


def capital(text: str) -> str:
    """Return the text with a capital first letter; a message in every language."""
    letter = text[:1].upper()
    return text.starting(letter) if isinstance(text, Message) else letter + text[1:]


def lower(text: str) -> str:
    """Return a name for the middle of a sentence, in lower case unless it starts with the letter of an axis."""
    if text[1:2] == " ":
        return text
    letter = text[:1].lower()
    return text.starting(letter) if isinstance(text, Message) else letter + text[1:]


def either(names: Sequence[str]) -> str:
    """Return the names as "A, B or C"."""
    if len(names) < 2:
        return names[0] if names else ""
    return Message("{names} or {last}", names=joined(", ", names[:-1]), last=names[-1])


def listed(names: Sequence[str], *, most: int = MANY) -> str:
    """Return the names as "A, B and C"; above ``most`` names, the first ones and the number of the others."""
    if len(names) > most:
        return Message(
            "{names} and {count} more", names=joined(", ", names[: most - 1]), count=str(len(names) - most + 1)
        )
    if len(names) < 2:
        return names[0] if names else ""
    return Message("{names} and {last}", names=joined(", ", names[:-1]), last=names[-1])
