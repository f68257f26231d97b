"""Decision rule of ISO 14253-1:2017: a value with its expanded uncertainty U against a tolerance. Every command decides by it."""

from __future__ import annotations

from typing import Literal

Verdict = Literal["pass", "fail", "undecided"]


def decide(value: float, half: float, tolerance: float) -> Verdict:
    """Return the verdict on a value: ``pass`` if value + U ≤ tolerance, ``fail`` if value − U > tolerance, else ``undecided``.

    Args:
        value: absolute value; NaN if unknown.
        half: its expanded uncertainty U (95 %); NaN if unknown.
        tolerance: largest permitted absolute value, in the same unit.
    """
    return decide_interval(value - half, value + half, tolerance)


def decide_interval(low: float, high: float, tolerance: float) -> Verdict:
    """Return the verdict on a value of which the limits of the 95 % interval are known; ``undecided`` for NaN.

    Args:
        low: lower limit of the absolute value.
        high: upper limit.
        tolerance: largest permitted absolute value, in the same unit.
    """
    if high <= tolerance:
        return "pass"
    return "fail" if low > tolerance else "undecided"


def is_accepted(verdict: Verdict, value: float, tolerance: float) -> bool:
    """Return whether a command is done: no verdict ``fail``, and a known value within its tolerance.

    An undecided value above its tolerance is more probably out of it than within.
    """
    return verdict != "fail" and value <= tolerance
