"""Numbers as a report says them: as many digits as mean something, and never a zero for what is not known."""

from __future__ import annotations

from math import floor, isfinite, log10
from typing import Final

UNKNOWN: Final = "unknown"
SIGNS: Final = {"um": "µm", "urad": "µrad", "mm": "mm", "deg": "°"}


def figure(value: float, unit: str = "", *, digits: int = 3) -> str:
    """A number of the shop: three significant digits, no exponent, tenths of a µm at the finest beyond 10.

    Args:
        value: any; not a number is `UNKNOWN`.
        unit: behind it.
        digits: significant ones.
    """
    if not isfinite(value):
        return UNKNOWN
    decimals = 2 if value == 0.0 else min(max(digits - 1 - floor(log10(abs(value))), 0), 2)
    text = f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")
    return f"{text} {unit}" if unit else text


def with_half(value: float, half: float, unit: str) -> str:
    """A number with the half width of its 95 % interval, to two digits of that; without one, it says so."""
    if not isfinite(half):
        return f"{figure(value, unit)} (± {UNKNOWN})"
    if half <= 0.0:
        return figure(value, unit)
    decimals = min(max(1 - floor(log10(half)), 0), 3)
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {half:.{decimals}f} {unit}".replace("-", "−")


def expanded(value: float, *, complete: bool = True) -> str:
    """U in µm; unknown where it is not known, and a lower bound where a part has none."""
    if not isfinite(value):
        return UNKNOWN
    return figure(value, "µm") if complete else f"at least {figure(value, 'µm')}"


def bound(value: float, *, complete: bool = True) -> str:
    """U in µm in a table that names the unit at its head."""
    if not isfinite(value):
        return UNKNOWN
    return figure(value) if complete else f"≥ {figure(value)}"


def place(where: dict[str, float]) -> str:
    """X 467, Y 433, B 125."""
    return ", ".join(f"{name} {round(value):g}".replace("-", "−") for name, value in where.items())
