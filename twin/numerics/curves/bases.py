"""Bases with a closed form: powers, harmonics, Bernstein polynomials."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import comb, pi
from typing import Any, final

from twin._common.messages import Message
from twin.numerics.curves.basis import Basis, Exact
from twin.numerics.curves.fg_bernstein import MOST_DEGREE
from twin.numerics.functions import cos, sin


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


@final
@dataclass(frozen=True)
class Bernstein(Basis):
    """``basis: bernstein``: f_k = C(n,k) x^k (1 − x)^(n−k), x = (q − lo)/(hi − lo), n one less than the number of coefficients.

    They span the polynomials of degree n, as `Power` does, on rotary axes too. The functions are not negative and sum to one: a curve
    starts and ends at its first and last coefficient and stays between the smallest and the largest; errors of the coefficients are not
    amplified. Trigonometric fg-Bernstein functions are not offered for calibrations: of even degree, over part of a revolution, they
    span the same space as `Fourier`; of odd degree they contain no constant; over a full revolution they do not exist.
    """

    name = "bernstein"
    formula = "f_k = C(n,k) x^k (1 − x)^(n−k), x = (q − lo)/(hi − lo), n = coefficients − 1."

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        lo, hi = domain
        x, y = (q - lo) / (hi - lo), (hi - q) / (hi - lo)
        up, down = [0.0 * x + 1.0], [0.0 * y + 1.0]
        for _ in range(count - 1):
            up.append(up[-1] * x)
            down.append(down[-1] * y)
        return [float(comb(count - 1, k)) * up[k] * down[count - 1 - k] for k in range(count)]

    def count_problem(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.count_problem`."""
        return None if 1 <= count <= MOST_DEGREE + 1 else f"1 to {MOST_DEGREE + 1} coefficients"

    @property
    def nested(self) -> bool:
        """All functions have the full degree, so the basis is not nested."""
        return False

    def to_powers(self, count: int) -> Exact | None:
        """See `Basis.to_powers`: x = (1 + u)/2."""
        n = count - 1
        return [[Fraction(comb(n, i) * _mixed(n, i, k), 2**n) for i in range(count)] for k in range(count)]

    def from_powers(self, count: int) -> Exact | None:
        """See `Basis.from_powers`: u^k = (x − y)^k (x + y)^(n−k), y = 1 − x."""
        n = count - 1
        return [[Fraction((-1) ** k * _mixed(n, n - k, i), comb(n, i)) for k in range(count)] for i in range(count)]


def _mixed(n: int, i: int, k: int) -> int:
    """Return the coefficient of z^k in (1 + z)^i (1 − z)^(n−i)."""
    return sum((-1) ** (k - j) * comb(i, j) * comb(n - i, k - j) for j in range(max(0, k - n + i), min(i, k) + 1))
