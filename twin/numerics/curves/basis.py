"""A curve basis: the functions an error curve is a sum of, ``e(q) = Σ c_k f_k(q)``, q in mm or degrees.

Every basis evaluates NumPy arrays and CasADi expressions with the same lines, so that the curve that is compiled is the
curve that is plotted. What describes a basis stands in its own file; nothing outside this folder asks for a basis by its name.
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
    """A family of functions on a domain; two are equal if they have the same functions.

    Attributes:
        name: ``basis:`` in a calibration file.
        formula: of its functions, one sentence for the documentation.
        order_noun: what `order` counts.
        takes_knots: whether a curve of it has knots.
        knots: those knots, mm or degrees; empty if it takes none.
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
        """Values of the first ``count`` functions.

        Args:
            q: axis position, mm or degrees: an array of any shape, or a CasADi expression.
            domain: (lo, hi) in the same unit.
            count: how many.
        """

    @abstractmethod
    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """Why a curve of this basis cannot have that many coefficients on that kind of axis; None if it can."""

    def knots_misfit(self, domain: tuple[float, float]) -> str | None:
        """Why the knots do not belong to a curve of that domain; None if they do."""
        return None

    @property
    def periodic(self) -> bool:
        """Whether the functions themselves repeat every turn."""
        return False

    @property
    def nested(self) -> bool:
        """Whether the first functions are the same however many follow, so that a coefficient can be put to zero or added."""
        return True

    @classmethod
    def order(cls, count: int) -> int:
        """What a curve of ``count`` coefficients is called by: its degree, or what ``order_noun`` names instead."""
        return max(count - 1, 0)

    @classmethod
    def preference(cls, *, rotary: bool, endless: bool) -> int | None:
        """Place of this basis among those that `identify` tries on a kind of axis, 0 first; None: it does not try it.

        Args:
            rotary: whether the axis turns.
            endless: whether it turns without limits.
        """
        return None

    def largest(self, count: int) -> int:
        """The largest number of coefficients, at most ``count``, that `identify` may seek."""
        return count

    def groups(self, first: int, count: int) -> list[tuple[int, ...]]:
        """Indices of the functions ``first`` … ``count − 1`` that come and go together, lowest order first."""
        return [(k,) for k in range(first, count)]

    def powers(self, count: int) -> Exact | None:
        """(m, count) coefficients of each of ``count`` functions in powers of u, a column each; None if they are no polynomials."""
        return None

    def of_powers(self, count: int) -> Exact | None:
        """(count, m) coefficients in ``count`` functions of those powers of u that they make, u⁰ to u^(m−1); None if they make none."""
        return None

    def into(self, count: int, target: Basis, target_count: int) -> np.ndarray | None:
        """What writes a curve of ``count`` coefficients in another basis, or in more functions of this one.

        Polynomials go through exact powers of u, rounded once at the end.

        Returns:
            (target_count, count); None where the target cannot make what this basis makes.
        """
        if self == target and self.nested:
            return np.eye(target_count, count)
        there, back = self.powers(count), target.of_powers(target_count)
        if there is None or back is None or len(there) > len(back[0]):
            return None
        return rounded_product(back, there)

    def together(self, count: int, other: Basis, other_count: int) -> tuple[Basis, int]:
        """The basis, and how many of its functions, that a curve of this basis is written in when one of another is added."""
        return self, max(count, other_count)

    def over(self, domain: tuple[float, float], count: int) -> tuple[Basis, int]:
        """The basis, and how many of its functions, that part of a curve is written in, over a smaller domain."""
        return self, count

    def value(self, q: Any, domain: tuple[float, float], coefficients: Sequence[float]) -> Any:
        """The curve: Σ c_k f_k(q), in the unit of its coefficients."""
        functions = self.functions(q, domain, len(coefficients))
        total = coefficients[0] * functions[0]
        for coefficient, function in zip(coefficients[1:], functions[1:], strict=True):
            total = total + coefficient * function
        return total


def rounded_product(left: Exact, right: Exact) -> np.ndarray:
    """The product, rounded; the left one may have more columns than the right one has rows."""
    rows = len(right)
    return np.array(
        [[float(sum(row[k] * right[k][j] for k in range(rows))) for j in range(len(right[0]))] for row in left]
    )
