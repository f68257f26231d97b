"""The functions an error curve is a sum of: ``e(q) = Σ c_k f_k(q)``, q in mm or degrees.

Every basis evaluates NumPy arrays and CasADi expressions with the same lines, so that the curve that is compiled is the
curve that is plotted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from fractions import Fraction
from math import comb, pi
from typing import Any, Final, final

from twin.numerics.curves.fg_bernstein import MOST_DEGREE
from twin.numerics.elementary import cos, sin

Exact = list[list[Fraction]]
"""A matrix of rational numbers, row by row."""


class Basis(ABC):
    """A family of functions on a domain."""

    name: str

    @abstractmethod
    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """Values of the first ``count`` functions.

        Args:
            q: axis position, mm or degrees: an array of any shape, or a CasADi expression.
            domain: (lo, hi) in the same unit.
            count: how many.
        """

    @abstractmethod
    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """Why a curve of this basis cannot have that many coefficients on that kind of axis; None if it can."""

    @property
    @abstractmethod
    def periodic(self) -> bool:
        """Whether the functions themselves repeat every turn."""

    @property
    def nested(self) -> bool:
        """Whether the first functions are the same however many follow, so that a coefficient can be put to zero or added."""
        return True

    def powers(self, count: int) -> Exact | None:
        """(count, count) coefficients of each of ``count`` functions in powers of u, a column each; None if they are no polynomials."""
        return None

    def of_powers(self, count: int) -> Exact | None:
        """The inverse: coefficients in ``count`` functions of each power of u."""
        return None

    def value(self, q: Any, domain: tuple[float, float], coefficients: tuple[float, ...]) -> Any:
        """The curve: Σ c_k f_k(q), in the unit of its coefficients."""
        functions = self.functions(q, domain, len(coefficients))
        total = coefficients[0] * functions[0]
        for coefficient, function in zip(coefficients[1:], functions[1:], strict=True):
            total = total + coefficient * function
        return total


@final
class Power(Basis):
    """``basis: power``: f_k = u^k, u = (2q − lo − hi)/(hi − lo)."""

    name: Final = "power"

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        lo, hi = domain
        u = (2.0 * q - (lo + hi)) / (hi - lo)
        powers = [0.0 * u + 1.0]
        for _ in range(count - 1):
            powers.append(powers[-1] * u)
        return powers

    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.misfit`."""
        return None if count >= 1 else "at least one coefficient"

    @property
    def periodic(self) -> bool:
        """Powers do not repeat."""
        return False

    def powers(self, count: int) -> Exact | None:
        """See `Basis.powers`."""
        return [[Fraction(int(i == j)) for j in range(count)] for i in range(count)]

    def of_powers(self, count: int) -> Exact | None:
        """See `Basis.of_powers`."""
        return self.powers(count)


@final
class Fourier(Basis):
    """``basis: fourier``: f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself (not scaled to the domain)."""

    name: Final = "fourier"

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


@final
class Bernstein(Basis):
    """``basis: bernstein``: f_k = C(n,k) x^k (1 − x)^(n−k), x = (q − lo)/(hi − lo), n one less than the number of coefficients.

    The polynomials of degree n, like `Power`, on a rotary axis too. The functions are not negative and sum to one: a curve begins
    and ends at its first and last coefficient and stays between the smallest and the largest; an error of every coefficient is never
    magnified. Trigonometric fg-Bernstein functions are no basis of calibrations: of even degree, over part of a turn, they make what
    `Fourier` makes; of odd degree they make no constant; over a full turn there are none.
    """

    name: Final = "bernstein"

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        lo, hi = domain
        x, y = (q - lo) / (hi - lo), (hi - q) / (hi - lo)
        up, down = [0.0 * x + 1.0], [0.0 * y + 1.0]
        for _ in range(count - 1):
            up.append(up[-1] * x)
            down.append(down[-1] * y)
        return [float(comb(count - 1, k)) * up[k] * down[count - 1 - k] for k in range(count)]

    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.misfit`."""
        return None if 1 <= count <= MOST_DEGREE + 1 else f"1 to {MOST_DEGREE + 1} coefficients"

    @property
    def periodic(self) -> bool:
        """Polynomials do not repeat."""
        return False

    @property
    def nested(self) -> bool:
        """Every one of them has the full degree."""
        return False

    def powers(self, count: int) -> Exact | None:
        """See `Basis.powers`: x = (1 + u)/2."""
        n = count - 1
        return [[Fraction(comb(n, i) * _mixed(n, i, k), 2**n) for i in range(count)] for k in range(count)]

    def of_powers(self, count: int) -> Exact | None:
        """See `Basis.of_powers`: u^k = (x − y)^k (x + y)^(n−k), y = 1 − x."""
        n = count - 1
        return [[Fraction((-1) ** k * _mixed(n, n - k, i), comb(n, i)) for k in range(count)] for i in range(count)]


def _mixed(n: int, i: int, k: int) -> int:
    """Coefficient of z^k in (1 + z)^i (1 − z)^(n−i)."""
    return sum((-1) ** (k - j) * comb(i, j) * comb(n - i, k - j) for j in range(max(0, k - n + i), min(i, k) + 1))


POWER: Final = Power()
FOURIER: Final = Fourier()
BASES: Final[tuple[Basis, ...]] = (POWER, FOURIER, Bernstein())


def basis_named(name: str) -> Basis | None:
    """The basis of that name in a calibration file, or None."""
    return next((basis for basis in BASES if basis.name == name), None)
