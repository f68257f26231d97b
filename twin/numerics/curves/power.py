"""Powers of the position, scaled to the domain."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, final

from twin.numerics.curves.basis import Basis, Exact


@final
@dataclass(frozen=True)
class Power(Basis):
    """``basis: power``: f_k = u^k, u = (2q − lo − hi)/(hi − lo)."""

    name = "power"
    formula = "f_k = u^k with u = (2q − lo − hi)/(hi − lo)."

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        lo, hi = domain
        u = (2.0 * q - (lo + hi)) / (hi - lo)
        powers = [0.0 * u + 1.0]
        for _ in range(count - 1):
            powers.append(powers[-1] * u)
        return powers

    def count_problem(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.count_problem`."""
        return None if count >= 1 else "at least one coefficient"

    @classmethod
    def preference(cls, *, rotary: bool, endless: bool) -> int | None:
        """Return 0 for axes with limits, None for others."""
        return None if endless else 0

    def to_powers(self, count: int) -> Exact | None:
        """See `Basis.to_powers`."""
        return [[Fraction(int(i == j)) for j in range(count)] for i in range(count)]

    def from_powers(self, count: int) -> Exact | None:
        """See `Basis.from_powers`."""
        return self.to_powers(count)
