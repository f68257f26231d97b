"""Bases of error curves: powers, harmonics, Bernstein polynomials, cubic splines with knots."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise
from math import comb, isfinite, pi, prod
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
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


DEGREE: Final = 3
MOST_KNOTS: Final = 500


@final
@dataclass(frozen=True)
class CubicSpline(Basis):
    """``basis: cubic_spline``: cubic B-splines N_k,3 over two or more increasing ``knots``, which include both ends of the domain.

    N_k,0 is one from t_k to t_(k+1) and zero elsewhere;
    N_k,d = (q − t_k)/(t_(k+d) − t_k) N_k,d−1 + (t_(k+d+1) − q)/(t_(k+d+1) − t_(k+1)) N_k+1,d−1,
    each end of the domain taken four times (C. de Boor, A Practical Guide to Splines, 1978, chapter X). Between knots a curve is a
    cubic; at knots its second derivative is continuous. The functions are not negative and sum to one: a curve stays between its
    smallest and its largest coefficient, and a constant is added to every coefficient. There are two more coefficients than knots; the
    first and the last are the values at the ends of the domain.

    Raises:
        InputError: fewer than two knots, more than `MOST_KNOTS`, not increasing, or not finite.
    """

    name = "cubic_spline"
    formula = (
        "cubic B-splines over `knots:`, mm or degrees, both ends of the domain among them (each taken four times); "
        "two coefficients more than knots (C. de Boor, A Practical Guide to Splines, 1978, chapter X)."
    )
    order_noun = Message("spans")
    takes_knots = True

    def __post_init__(self) -> None:
        rising = all(a < b for a, b in pairwise(self.knots))
        if not (2 <= len(self.knots) <= MOST_KNOTS and rising and all(map(isfinite, self.knots))):
            expected = f"knots: 2 to {MOST_KNOTS} increasing numbers, both ends of the domain among them"
            raise InputError("invalid knots of a cubic spline", expected=expected, value=list(self.knots))

    @property
    def count(self) -> int:
        """Number of functions."""
        return len(self.knots) + DEGREE - 1

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`; beyond the end knots the first and the last cubic are extrapolated."""
        t = self._repeated
        # Step functions at the knots; the first and last span are unbounded.
        begun = [0.0 * q + 1.0, *(1.0 * (q >= knot) for knot in self.knots[1:-1]), 0.0 * q]
        spans = [start - end for start, end in pairwise(begun)]
        splines: list[Any] = [None] * DEGREE + spans + [None] * DEGREE
        for d in range(1, DEGREE + 1):
            splines = [
                _sum(
                    _scaled(q - t[k], t[k + d] - t[k], left), _scaled(t[k + d + 1] - q, t[k + d + 1] - t[k + 1], right)
                )
                for k, (left, right) in enumerate(pairwise(splines))
            ]
        return splines[:count]

    def count_problem(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.count_problem`."""
        return None if count == self.count else f"{self.count} coefficients, two more than there are knots"

    def knots_problem(self, domain: tuple[float, float]) -> str | None:
        """See `Basis.knots_problem`."""
        lo, hi = domain
        ends = self.knots[0], self.knots[-1]
        return None if ends == (lo, hi) else f"knots from {lo:g} to {hi:g}, the ends of the domain"

    @property
    def nested(self) -> bool:
        """All functions depend on the knots, so the basis is not nested."""
        return False

    @classmethod
    def order(cls, count: int) -> int:
        """Number of spans between knots."""
        return max(count - DEGREE, 0)

    def from_powers(self, count: int) -> Exact | None:
        """See `Basis.from_powers`: a coefficient is the polar form of the power at the three knots within its function's support."""
        if count != self.count:
            return None
        lo, hi = Fraction(self.knots[0]), Fraction(self.knots[-1])
        u = [(2 * Fraction(knot) - lo - hi) / (hi - lo) for knot in self._repeated]
        return [
            [
                sum(
                    (Fraction(prod(combination)) for combination in combinations(u[k + 1 : k + 1 + DEGREE], power)),
                    Fraction(0),
                )
                / comb(DEGREE, power)
                for power in range(DEGREE + 1)
            ]
            for k in range(count)
        ]

    def conversion_to(self, count: int, target: Basis, target_count: int) -> np.ndarray | None:
        """See `Basis.conversion_to`; exact if the target has all of these knots. Collocated at the averages of three knots each."""
        if not (isinstance(target, CubicSpline) and set(self.knots) <= set(target.knots)):
            return None
        same_ends = (self.knots[0], self.knots[-1]) == (target.knots[0], target.knots[-1])
        if not same_ends or (count, target_count) != (self.count, target.count):
            return None
        if self == target:
            return np.eye(count)
        t = np.array(target._repeated)
        at = np.clip((t[1:-3] + t[2:-2] + t[3:-1]) / DEGREE, t[0], t[-1])
        there, back = (np.stack(one.functions(at, (t[0], t[-1]), one.count), axis=1) for one in (self, target))
        return np.asarray(np.linalg.solve(back, there))

    def common_basis(self, count: int, other: Basis, other_count: int) -> tuple[Basis, int]:
        """Return a spline with the knots of both; with these knots if the other has none."""
        whole = CubicSpline(tuple(sorted({*self.knots, *other.knots})))
        return whole, whole.count

    def restricted(self, domain: tuple[float, float], count: int) -> tuple[Basis, int]:
        """Return a spline with the knots within the smaller domain and its ends."""
        lo, hi = domain
        part = CubicSpline((lo, *(knot for knot in self.knots if lo < knot < hi), hi))
        return part, part.count

    @property
    def _repeated(self) -> list[float]:
        """The knots, with each end of the domain repeated four times."""
        return [self.knots[0]] * DEGREE + list(self.knots) + [self.knots[-1]] * DEGREE


def _scaled(rise: Any, width: float, function: Any) -> Any:
    """Return ``rise / width`` times the function; None if it is zero everywhere."""
    return None if function is None or width == 0.0 else rise * (1.0 / width) * function


def _sum(one: Any, other: Any) -> Any:
    return other if one is None else one if other is None else one + other
