"""Spaces of functions, orthonormalised over a domain from those of a basis in order, in which curves are fitted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin.numerics.curves.basis import Basis
from twin.numerics.curves.conversion import legendre_in_basis

NODES: Final = 400
"""Points of the Gauss-Legendre rule that defines "orthonormal": exact far beyond any order used."""


@final
@dataclass(frozen=True)
class CurveSpace:
    """The space of functions in which one error motion is fitted.

    Attributes:
        name: ISO 230-1 name.
        basis: the basis.
        domain: (lo, hi) mm or degrees.
        first: index of the first orthonormal function that is not fixed by the datum.
        count: number of functions, those before ``first`` included.
    """

    name: str
    basis: Basis
    domain: tuple[float, float]
    first: int
    count: int

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
        x, w = _rule()
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
        x, w = _rule()
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
def _rule() -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights of the Gauss-Legendre rule; cached."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    return read_only(x), read_only(w)


def _norms(count: int) -> np.ndarray:
    """Return factors (count,) that make the mean square of each Legendre polynomial one."""
    return np.asarray(np.sqrt(2.0 * np.arange(count) + 1.0))
