"""Harmonics of a rotary axis's angle."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any, final

from twin._common.messages import Message
from twin.numerics.curves.basis import Basis
from twin.numerics.functions import cos, sin


@final
@dataclass(frozen=True)
class Fourier(Basis):
    """``basis: fourier``: f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself (not scaled to the domain)."""

    name = "fourier"
    formula = "f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself; rotary axes only."
    order_noun = Message("harmonics")

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        angle = q * (pi / 180.0)
        functions = [0.0 * angle + 1.0]
        for order in range(1, (count + 1) // 2):
            functions += [cos(order * angle), sin(order * angle)]
        return functions

    def count_problem(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.count_problem`."""
        if not rotary:
            return "a rotary axis (fourier is in the axis angle)"
        return None if count % 2 == 1 else "an odd number of coefficients: constant, then cos and sin of each order"

    @property
    def periodic(self) -> bool:
        """Every harmonic has a period of one revolution."""
        return True

    @classmethod
    def order(cls, count: int) -> int:
        """Return the number of harmonics."""
        return max((count - 1) // 2, 0)

    @classmethod
    def preference(cls, *, rotary: bool, endless: bool) -> int | None:
        """Return 0 for rotary axes without limits, 1 for other rotary axes (after powers), None for linear axes."""
        if not rotary:
            return None
        return 0 if endless else 1

    def largest(self, count: int) -> int:
        """Return an odd number: the constant, then cosine and sine of every harmonic."""
        return count - 1 + count % 2

    def groups(self, first: int, count: int) -> list[tuple[int, ...]]:
        """Return the indices of cosine and sine of each harmonic."""
        return [tuple(k for k in (n, n + 1) if k < count) for n in range(max(first, 1), count, 2)]
