"""The same curve in other functions, each matrix made once."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb

import numpy as np

from twin._common.arrays import locked
from twin.numerics.curves.basis import Basis, rounded_product


@cache
def conversion(source: Basis, target: Basis, count: int, into: int) -> np.ndarray | None:
    """What writes a curve of one basis in another; see `Basis.into`.

    Args:
        source: its basis.
        target: the other.
        count: coefficients it has.
        into: coefficients it gets, ``count`` or more.

    Returns:
        (into, count); None where the one basis cannot make what the other makes.
    """
    matrix = source.into(count, target, into)
    return None if matrix is None else locked(matrix)


@cache
def of_legendre(target: Basis, count: int) -> np.ndarray | None:
    """(count, count) coefficients of the Legendre polynomials of degree 0, 1 …, a column each; None if it does not make all of them."""
    back = target.of_powers(count)
    if back is None or len(back[0]) < count:
        return None
    legendre = [[Fraction(0)] * count for _ in range(count)]
    for n in range(count):
        # P_n = 2^−n Σ_k (−1)^k C(n,k) C(2n−2k,n) u^(n−2k)
        for k in range(n // 2 + 1):
            legendre[n - 2 * k][n] = Fraction((-1) ** k * comb(n, k) * comb(2 * n - 2 * k, n), 2**n)
    return locked(rounded_product(back, legendre))
