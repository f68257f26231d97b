"""Base class of curve bases: an error curve is ``e(q) = Σ c_k f_k(q)``, q in mm or degrees.

Every basis evaluates NumPy arrays and CasADi expressions with the same code, so that the compiled curve equals the plotted one. Each
basis is described in its own module; no code outside this package refers to a basis by its name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from math import comb
from typing import Any, ClassVar, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message

Exact = list[list[Fraction]]
"""A matrix of rational numbers, row by row."""


@dataclass(frozen=True)
class Basis(ABC):
    """A family of functions on a domain; two bases are equal if they have the same functions."""

    name: ClassVar[str]  # value of ``basis:`` in a calibration file
    formula: ClassVar[str]  # formula of its functions, for the documentation
    order_noun: ClassVar[str] = Message("degree")  # noun for what `order` counts
    takes_knots: ClassVar[bool] = False  # whether its curves have knots
    knots: tuple[float, ...] = ()  # the knots, mm or degrees; empty if it takes none

    def __post_init__(self) -> None:
        if self.knots and not self.takes_knots:
            raise InputError(f"{self.name} curves have no knots", expected="no entry `knots:`", value=self.knots)

    @abstractmethod
    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """Return the values of the first ``count`` functions at positions q, mm or degrees: an array or a CasADi expression."""

    @abstractmethod
    def count_problem(self, count: int, *, rotary: bool) -> str | None:
        """Return what is expected instead if ``count`` coefficients are not allowed on that kind of axis; None if they are."""

    def knots_problem(self, domain: tuple[float, float]) -> str | None:
        """Return what is expected instead if the knots do not fit the domain; None if they do."""
        return None

    @property
    def periodic(self) -> bool:
        """Whether the functions have a period of one revolution."""
        return False

    @property
    def nested(self) -> bool:
        """Whether the first functions do not depend on the number of functions, so that coefficients may be dropped or added."""
        return True

    @classmethod
    def order(cls, count: int) -> int:
        """Return the order of a curve of ``count`` coefficients: its degree, or what ``order_noun`` names."""
        return max(count - 1, 0)

    @classmethod
    def preference(cls, *, rotary: bool, endless: bool) -> int | None:
        """Return the rank of this basis among those that `identify` tries on a kind of axis, 0 first; None if it is not tried."""
        return None

    def largest(self, count: int) -> int:
        """Return the largest number of coefficients, at most ``count``, that `identify` may fit."""
        return count

    def groups(self, first: int, count: int) -> list[tuple[int, ...]]:
        """Return the functions ``first`` … ``count − 1`` in groups of indices that are only used together, lowest order first."""
        return [(k,) for k in range(first, count)]

    def to_powers(self, count: int) -> Exact | None:
        """Return the matrix (m, count) of the functions' coefficients in powers of u, one column each; None if not polynomials."""
        return None

    def from_powers(self, count: int) -> Exact | None:
        """Return the matrix (count, m) of coefficients of the powers u⁰ … u^(m−1) in the functions; None if they span none."""
        return None

    def conversion_to(self, count: int, target: Basis, target_count: int) -> np.ndarray | None:
        """Return the matrix (target_count, count) from coefficients of this basis to another's, or to more functions of this one.

        Polynomials are converted through exact powers of u and rounded once. None if the target does not span these functions.
        """
        if self == target and self.nested:
            return np.eye(target_count, count)
        there, back = self.to_powers(count), target.from_powers(target_count)
        if there is None or back is None or len(there) > len(back[0]):
            return None
        return rounded_product(back, there)

    def common_basis(self, count: int, other: Basis, other_count: int) -> tuple[Basis, int]:
        """Return basis and number of functions for the sum of a curve of this basis and one of another."""
        return self, max(count, other_count)

    def restricted(self, domain: tuple[float, float], count: int) -> tuple[Basis, int]:
        """Return basis and number of functions for part of a curve over a smaller domain."""
        return self, count

    def value(self, q: Any, domain: tuple[float, float], coefficients: Sequence[float]) -> Any:
        """Return Σ c_k f_k(q), in the unit of the coefficients."""
        functions = self.functions(q, domain, len(coefficients))
        total = coefficients[0] * functions[0]
        for coefficient, function in zip(coefficients[1:], functions[1:], strict=True):
            total = total + coefficient * function
        return total


def rounded_product(left: Exact, right: Exact) -> np.ndarray:
    """Return the matrix product in floating point; ``left`` may have more columns than ``right`` has rows."""
    rows = len(right)
    return np.array(
        [[float(sum(row[k] * right[k][j] for k in range(rows))) for j in range(len(right[0]))] for row in left]
    )


# --- Conversion of curves between bases, with cached matrices -------------------------------------


@cache
def conversion(source: Basis, target: Basis, count: int, into: int) -> np.ndarray | None:
    """Return the matrix (into, count) that converts coefficients from one basis to another, cached; see `Basis.conversion_to`."""
    matrix = source.conversion_to(count, target, into)
    return None if matrix is None else read_only(matrix)


@cache
def legendre_in_basis(target: Basis, count: int) -> np.ndarray | None:
    """Return the coefficients (count, count) of the Legendre polynomials 0, 1 … in a basis, one column each; None if it lacks any."""
    back = target.from_powers(count)
    if back is None or len(back[0]) < count:
        return None
    legendre = [[Fraction(0)] * count for _ in range(count)]
    for n in range(count):
        # P_n = 2^−n Σ_k (−1)^k C(n,k) C(2n−2k,n) u^(n−2k)
        for k in range(n // 2 + 1):
            legendre[n - 2 * k][n] = Fraction((-1) ** k * comb(n, k) * comb(2 * n - 2 * k, n), 2**n)
    return read_only(rounded_product(back, legendre))


# --- Spaces of functions, orthonormalised over a domain from those of a basis in order, in which curves are fitted

NODES: Final = 400
"""Points of the Gauss-Legendre rule that defines "orthonormal": exact far beyond any order used."""


@final
@dataclass(frozen=True)
class CurveSpace:
    """The space of functions in which one error motion is fitted."""

    name: str  # ISO 230-1 name
    basis: Basis
    domain: tuple[float, float]  # (lo, hi) mm or degrees
    first: int  # index of the first orthonormal function that is not fixed by the datum
    count: int  # number of functions, those before ``first`` included

    @cached_property
    def transform(self) -> np.ndarray:
        """(count, count) basis coefficients of each orthonormal function, one column each."""
        return self.transform_of(self.count)

    def transform_of(self, count: int) -> np.ndarray:
        """Return the basis coefficients (count, count) of the first ``count`` orthonormal functions, one column each.

        For a nested basis the matrix is upper triangular and a leading block of `transform`; for Bernstein polynomials it differs with
        every degree. The orthonormal polynomials are Legendre's, P_k √(2k + 1).
        """
        legendre = legendre_in_basis(self.basis, count)
        if legendre is not None:
            return np.asarray(legendre * _norms(count))
        x, w = gauss_legendre(NODES)
        lo, hi = self.domain
        values = self._raw((lo + hi) / 2.0 + x * (hi - lo) / 2.0, count)
        _, triangle = np.linalg.qr(values * np.sqrt(w / 2.0)[:, None])
        return np.asarray(np.linalg.inv(triangle * np.sign(np.diag(triangle))[:, None]))

    def functions(self, q: np.ndarray) -> np.ndarray:
        """Return the orthonormal functions (n, count) at positions, mm or degrees."""
        if legendre_in_basis(self.basis, self.count) is None:
            return self._raw(q, self.count) @ self.transform
        lo, hi = self.domain
        return np.asarray(np.polynomial.legendre.legvander((2.0 * q - (lo + hi)) / (hi - lo), self.count - 1)) * _norms(
            self.count
        )

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and weights of a quadrature of the mean over the domain."""
        x, w = gauss_legendre(NODES)
        lo, hi = self.domain
        return (lo + hi) / 2.0 + x * (hi - lo) / 2.0, w / 2.0

    def groups(self) -> list[tuple[int, ...]]:
        """Return groups of indices that are only used together, lowest order first: single powers, cosine and sine of a harmonic."""
        return self.basis.groups(self.first, self.count)

    def below(self, unseen: np.ndarray) -> CurveSpace:
        """Return the space of the orders below the first with a function marked in ``unseen`` (count − first,)."""
        if not np.any(unseen):
            return self
        kept = [0, *(group[-1] + 1 for group in self.groups() if group[-1] - self.first < np.argmax(unseen))]
        return CurveSpace(self.name, self.basis, self.domain, self.first, kept[-1])

    def _raw(self, q: np.ndarray, count: int) -> np.ndarray:
        return np.stack(self.basis.functions(q, self.domain, count), axis=1)


@cache
def gauss_legendre(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights of the Gauss-Legendre rule from −1 to 1; cached."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    return read_only(x), read_only(w)


def _norms(count: int) -> np.ndarray:
    """Return factors (count,) that make the mean square of each Legendre polynomial one."""
    return np.asarray(np.sqrt(2.0 * np.arange(count) + 1.0))
