"""Conversion of curves between bases, with cached matrices."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb

import numpy as np

from twin._common.arrays import read_only
from twin.numerics.curves.basis import Basis, rounded_product


@cache
def conversion(source: Basis, target: Basis, count: int, into: int) -> np.ndarray | None:
    """Return the matrix that converts coefficients from one basis to another; see `Basis.conversion_to`.

    Args:
        source: basis of the curve.
        target: the other basis.
        count: number of coefficients of the curve.
        into: number of coefficients in the other basis, ``count`` or more.

    Returns:
        (into, count); None if the target does not span the functions of the source.
    """
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
