"""Bernstein polynomials."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import comb
from typing import Any, final

from twin.numerics.curves.basis import Basis, Exact
from twin.numerics.curves.fg_bernstein import MOST_DEGREE


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
