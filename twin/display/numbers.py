"""Numbers as people read them: rounded by their uncertainty, unknown where it is not known."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import floor, isfinite, log10
from typing import Final

COVERAGE: Final = 0.95
"""Coverage probability of every interval and radius that twin prints."""
COVERAGE_FACTOR: Final = 1.959963984540054
"""Coverage factor k of a normal distribution for that probability: the interval is the value ± k u (JCGM 100, G.1.3)."""
UNKNOWN: Final = "unknown"
TIED: Final = re.compile(r"(\d) (µm|µrad|mm|°|%|ppm)")
"""A number and its unit, which stay on one line."""
_ROUND: Final = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


def finite(value: float) -> float | None:
    """For JSON: null for what is not known."""
    return float(value) if isfinite(value) else None


def rounded(value: float, expanded: float) -> tuple[str, str]:
    """A value and its uncertainty as printed: at most two significant digits (JCGM 100, 7.2.6), the value to the same place."""
    decimals = 1 - floor(log10(expanded)) if expanded > 0.0 else 3
    decimals = min(max(decimals, 0), 3)
    return f"{value:.{decimals}f}", f"{expanded:.{decimals}f}"


def measured(value: float, u: float, unit: str) -> str:
    """A number with its 95 % interval: ``9.29 ± 0.51 µm``; ``9.3 µm, ± unknown`` where nobody knows it.

    Args:
        value: the number.
        u: its standard uncertainty (k = 1); NaN where it is not known.
        unit: as in files (``um``).
    """
    sign = readable(unit)
    return f"{_interval(value, COVERAGE_FACTOR * u)} {sign}" if isfinite(u) else f"{plain(value)} {sign}, ± {UNKNOWN}"


def with_half(value: float, half: float, unit: str) -> str:
    """A number with the half width of its 95 % interval, to two digits of that; without one, it says so.

    Args:
        value: the number.
        half: half width; NaN where it is not known.
        unit: as in files (``um``).
    """
    sign = readable(unit)
    if not isfinite(half):
        return f"{figure(value, sign)} (± {UNKNOWN})"
    return figure(value, sign) if half <= 0.0 else f"{_interval(value, half)} {sign}"


def figure(value: float, unit: str = "", *, digits: int = 3) -> str:
    """A number of the shop: three significant digits, no exponent, tenths of a µm at the finest beyond 10.

    Args:
        value: any; not a number is `UNKNOWN`.
        unit: behind it, as people write it.
        digits: significant ones.
    """
    if not isfinite(value):
        return UNKNOWN
    decimals = 2 if value == 0.0 else min(max(digits - 1 - floor(log10(abs(value))), 0), 2)
    text = fixed(round(value, decimals), decimals)
    return f"{text} {unit}" if unit else text


def expanded(value: float, *, complete: bool = True, unit: str = "µm", least: str = "at least ") -> str:
    """U of the tool point; unknown where it is not known, and ``least`` before it where a part has none: it is a lower bound."""
    return f"{'' if complete or not isfinite(value) else least}{figure(value, unit)}"


def place(where: Mapping[str, float]) -> str:
    """X 467, Y 433, B 125."""
    return ", ".join(f"{name} {round(value):g}".replace("-", "−") for name, value in where.items())


def compact(value: float) -> str:
    """A number with three significant digits, without zeros at its end and without an exponent."""
    if value == 0 or not 1e-3 <= abs(value) < 1e9:
        return "0" if value == 0 else f"{value:.2g}"
    text = f"{value:.{max(0, 2 - floor(log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else f"{int(text):,}".replace(",", "\u202f")


def plain(value: float) -> str:
    """A number whose uncertainty nobody knows: three digits, none after the point from 100 on."""
    return fixed(value, 0) if abs(value) >= 100.0 else signed(f"{value:.3g}")


def fixed(value: float, decimals: int) -> str:
    """So many decimals, and a true minus."""
    return signed(f"{value:.{decimals}f}")


def span(low: float, high: float, unit: str) -> str:
    """A range: ``−400 … 0 mm``, ``0 … 180°``."""
    sign = readable(unit)
    return f"{low:g} … {high:g}{'' if sign == '°' else ' '}{sign}".replace("-", "−")


def readable(unit: str) -> str:
    """A unit as people write it: ``um/(m.K)`` → µm/(m·K), ``deg`` → °."""
    plain = unit.replace("urad", "µrad").replace("um", "µm").replace("m2", "m²").replace(".", "·")
    return "°" if plain == "deg" else plain


def several(count: int, one: str) -> str:
    """``1 row``, ``1,234 rows``."""
    return f"{count:,} {one}{'' if count == 1 else 's'}"


def ticks(low: float, high: float, most: int = 5) -> Sequence[float]:
    """Round places between two ends (steps of 1, 2 or 5), at most ``most`` of them and two at least."""
    span = high - low
    for power in range(floor(log10(span)) - 2, floor(log10(span)) + 2):
        for digit in (1, 2, 5):
            step = digit * 10.0**power
            first, last = -floor(-low / step + 1e-9), floor(high / step + 1e-9)
            if last - first + 1 <= most:
                return [k * step for k in range(first, last + 1)]
    return [low, high]


def ceiling(value: float) -> float:
    """The next round number that is no smaller, by less than a third; 1 of nothing."""
    if not isfinite(value) or value <= 0.0:
        return 1.0
    power = 10.0 ** floor(log10(value))
    return next(digit * power for digit in _ROUND if digit * power >= value * (1.0 - 1e-12))


def tied(text: str, space: str) -> str:
    """With another space between numbers and their units."""
    return TIED.sub(rf"\1{space}\2", text)


def _interval(value: float, half: float) -> str:
    size, said = rounded(value, half)
    return f"{signed(size)} ± {said}"


def signed(text: str) -> str:
    """A true minus, and none before a nothing."""
    return text.lstrip("-") if not text.strip("-0.") else text.replace("-", "−")
