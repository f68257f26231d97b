"""Base class of curve bases: an error curve is ``e(q) = Σ c_k f_k(q)``, q in mm or degrees.

Every basis evaluates NumPy arrays and CasADi expressions with the same code, so that the compiled curve equals the plotted one. Each
basis is described in its own module; no code outside this package refers to a basis by its name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from twin._common.errors import InputError

Exact = list[list[Fraction]]
"""A matrix of rational numbers, row by row."""


@dataclass(frozen=True)
class Basis(ABC):
    """A family of functions on a domain; two bases are equal if they have the same functions.

    Attributes:
        name: value of ``basis:`` in a calibration file.
        formula: formula of its functions, for the documentation.
        order_noun: noun for what `order` counts.
        takes_knots: whether its curves have knots.
        knots: the knots, mm or degrees; empty if it takes none.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    order_noun: ClassVar[str] = "degree"
    takes_knots: ClassVar[bool] = False
    knots: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.knots and not self.takes_knots:
            raise InputError(f"{self.name} curves have no knots", expected="no entry `knots:`", value=self.knots)

    @abstractmethod
    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """Return the values of the first ``count`` functions.

        Args:
            q: axis position, mm or degrees: an array of any shape, or a CasADi expression.
            domain: (lo, hi) in the same unit.
            count: number of functions.
        """

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
        """Return the rank of this basis among those that `identify` tries on a kind of axis, 0 first; None if it is not tried.

        Args:
            rotary: whether the axis is rotary.
            endless: whether it has no limits.
        """
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
        """Return the matrix that converts ``count`` coefficients to another basis, or to more functions of this one.

        Polynomials are converted through exact powers of u and rounded once at the end.

        Returns:
            (target_count, count); None if the target does not span the functions of this basis.
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
