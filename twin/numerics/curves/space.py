"""Functions that are orthonormal over a domain, made from those of a basis in their order: what a curve is sought in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin.numerics.curves.basis import Basis
from twin.numerics.curves.conversion import of_legendre

NODES: Final = 400
"""Points of the Gauss-Legendre rule that defines "orthonormal": exact far beyond any order used."""


@final
@dataclass(frozen=True)
class CurveSpace:
    """The functions one error motion is sought in.

    Attributes:
        name: ISO 230-1 name.
        basis: family.
        domain: (lo, hi) mm or degrees.
        first: index of the first orthonormal function the datum leaves to it.
        count: how many functions, those before ``first`` included.
    """

    name: str
    basis: Basis
    domain: tuple[float, float]
    first: int
    count: int

    @cached_property
    def transform(self) -> np.ndarray:
        """(count, count) coefficients of the basis for each orthonormal function, a column each."""
        return self.written(self.count)

    def written(self, count: int) -> np.ndarray:
        """(count, count) coefficients of the basis for each of the first ``count`` orthonormal functions, a column each.

        Upper triangular, and the corner of `transform`, where the basis is nested; a curve of Bernstein polynomials has other ones for
        every degree. Orthonormal polynomials are Legendre's, P_k √(2k + 1).
        """
        legendre = of_legendre(self.basis, count)
        if legendre is not None:
            return np.asarray(legendre * _norms(count))
        x, w = _rule()
        lo, hi = self.domain
        values = self._raw((lo + hi) / 2.0 + x * (hi - lo) / 2.0, count)
        _, triangle = np.linalg.qr(values * np.sqrt(w / 2.0)[:, None])
        return np.asarray(np.linalg.inv(triangle * np.sign(np.diag(triangle))[:, None]))

    def functions(self, q: np.ndarray) -> np.ndarray:
        """(n, count) orthonormal functions at positions, mm or degrees."""
        if of_legendre(self.basis, self.count) is None:
            return self._raw(q, self.count) @ self.transform
        lo, hi = self.domain
        return np.asarray(np.polynomial.legendre.legvander((2.0 * q - (lo + hi)) / (hi - lo), self.count - 1)) * _norms(
            self.count
        )

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and weights of a mean over the domain."""
        x, w = _rule()
        lo, hi = self.domain
        return (lo + hi) / 2.0 + x * (hi - lo) / 2.0, w / 2.0

    def groups(self) -> list[tuple[int, ...]]:
        """Indices that come and go together, lowest order first: a power each, cosine and sine of a harmonic together."""
        return self.basis.groups(self.first, self.count)

    def below(self, unseen: np.ndarray) -> CurveSpace:
        """The space below the first order of which a function is among the (count − first,) that are unseen."""
        if not np.any(unseen):
            return self
        kept = [0, *(group[-1] + 1 for group in self.groups() if group[-1] - self.first < np.argmax(unseen))]
        return CurveSpace(self.name, self.basis, self.domain, self.first, kept[-1])

    def _raw(self, q: np.ndarray, count: int) -> np.ndarray:
        return np.stack(self.basis.functions(q, self.domain, count), axis=1)


@cache
def _rule() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the Gauss-Legendre rule, found once."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    return locked(x), locked(w)


def _norms(count: int) -> np.ndarray:
    """(count,) what makes the mean square of each Legendre polynomial one."""
    return np.asarray(np.sqrt(2.0 * np.arange(count) + 1.0))
