"""Harmonics of a rotary axis's angle."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any, final

from twin.numerics.curves.basis import Basis
from twin.numerics.elementary import cos, sin


@final
@dataclass(frozen=True)
class Fourier(Basis):
    """``basis: fourier``: f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself (not scaled to the domain)."""

    name = "fourier"
    formula = "f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself; rotary axes only."
    order_noun = "harmonics"

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        angle = q * (pi / 180.0)
        found = [0.0 * angle + 1.0]
        for order in range(1, (count + 1) // 2):
            found += [cos(order * angle), sin(order * angle)]
        return found

    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.misfit`."""
        if not rotary:
            return "a rotary axis (fourier is in the axis angle)"
        return None if count % 2 == 1 else "an odd number of coefficients: constant, then cos and sin of each order"

    @property
    def periodic(self) -> bool:
        """Every harmonic repeats each turn."""
        return True

    @classmethod
    def order(cls, count: int) -> int:
        """Number of harmonics."""
        return max((count - 1) // 2, 0)

    @classmethod
    def preference(cls, *, rotary: bool, endless: bool) -> int | None:
        """Tried on rotary axes: first on those without limits, after powers on the others."""
        if not rotary:
            return None
        return 0 if endless else 1

    def largest(self, count: int) -> int:
        """An odd number: cosine and sine of every harmonic."""
        return count - 1 + count % 2

    def groups(self, first: int, count: int) -> list[tuple[int, ...]]:
        """Cosine and sine of a harmonic together."""
        return [tuple(k for k in (n, n + 1) if k < count) for n in range(max(first, 1), count, 2)]
