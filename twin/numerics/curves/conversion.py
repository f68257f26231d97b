"""The same curve in other functions: polynomials as powers of u, Bernstein or Legendre polynomials, u from −1 to 1 over the domain.

The matrices are made of whole numbers and rounded once at the end: going through powers costs nothing that way.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb

import numpy as np

from twin._common.arrays import locked
from twin.numerics.curves.basis import Basis, Exact


@cache
def conversion(source: Basis, target: Basis, count: int, into: int) -> np.ndarray | None:
    """What writes a curve of one basis in another.

    Args:
        source: its basis.
        target: the other.
        count: coefficients it has.
        into: coefficients it gets, ``count`` or more.

    Returns:
        (into, count); None where the one basis cannot make what the other makes.
    """
    if source is target and source.nested:
        return locked(np.eye(into, count))
    there, back = source.powers(count), target.of_powers(into)
    return None if there is None or back is None else locked(_floats(back, there))


@cache
def of_legendre(target: Basis, count: int) -> np.ndarray | None:
    """(count, count) coefficients of the Legendre polynomials of degree 0, 1 …, a column each; None if it makes no polynomials."""
    back = target.of_powers(count)
    if back is None:
        return None
    legendre = [[Fraction(0)] * count for _ in range(count)]
    for n in range(count):
        # P_n = 2^−n Σ_k (−1)^k C(n,k) C(2n−2k,n) u^(n−2k)
        for k in range(n // 2 + 1):
            legendre[n - 2 * k][n] = Fraction((-1) ** k * comb(n, k) * comb(2 * n - 2 * k, n), 2**n)
    return locked(_floats(back, legendre))


def _floats(left: Exact, right: Exact) -> np.ndarray:
    """The product, rounded; the left one may have more columns than the right one has rows."""
    rows = len(right)
    return np.array(
        [[float(sum(row[k] * right[k][j] for k in range(rows))) for j in range(len(right[0]))] for row in left]
    )
