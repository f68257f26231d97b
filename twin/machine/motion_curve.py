"""One error motion as a function of its axis's position: what a calibration file holds under its name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin.machine.display import motion_html
from twin.machine.effects import ErrorMotion, unit_of
from twin.numerics.curves import BASES, POWER, Basis, basis_named, conversion


@final
@dataclass(frozen=True)
class Curve:
    """One error motion.

    Attributes:
        name: ISO 230-1 name.
        unit: ``um`` or ``urad``.
        domain: (lo, hi) in mm or degrees.
        basis: name of its basis.
        coefficients: in ``unit``.
        covariance: (k, k) of the coefficients, or None where it is not known.
        source: where the numbers come from.
        illustrative: whether they are drawn, not measured.
    """

    name: str
    unit: str
    domain: tuple[float, float]
    basis: str
    coefficients: tuple[float, ...]
    covariance: np.ndarray | None = None
    source: str = ""
    illustrative: bool = False

    def __call__(self, q: Any) -> np.ndarray:
        """The curve at axis positions q (mm or degrees, any shape), in ``unit``.

        Raises:
            InputError: a position outside the domain.
        """
        positions = np.asarray(q, dtype=float)
        lo, hi = self.domain
        outside = ~((positions >= lo) & (positions <= hi))
        if np.any(outside):
            raise InputError(
                f"{self.name} outside its domain",
                expected=f"a position from {lo:g} to {hi:g}",
                value=float(np.asarray(positions)[outside].flat[0]),
            )
        return np.asarray(basis_of(self.basis).value(positions, self.domain, self.coefficients))

    def _repr_html_(self) -> str:
        motion = ErrorMotion(self.name, basis_of(self.basis), self.domain, self.coefficients, wrapped=False)
        return motion_html(motion, self.covariance, source=self.source, illustrative=self.illustrative).text

    def in_powers(self) -> Curve | None:
        """The same curve in powers of u; None if it is no polynomial."""
        count = len(self.coefficients)
        return (
            None if conversion(basis_of(self.basis), POWER, count, count) is None else self.written(POWER.name, count)
        )

    def written(self, basis: str, count: int) -> Curve:
        """The same curve, with its covariance, as ``count`` coefficients of another basis.

        Raises:
            InputError: no such basis; one that cannot make this curve.
        """
        matrix = conversion_of(self.name, basis_of(self.basis), basis_of(basis), len(self.coefficients), count)
        return replace(
            self,
            basis=basis,
            coefficients=tuple(float(v) for v in matrix @ self.coefficients),
            covariance=None if self.covariance is None else locked(matrix @ self.covariance @ matrix.T),
        )


def added(curve: Curve | None, motion: ErrorMotion) -> Curve:
    """A curve with another over the same domain added, in the basis of the first.

    Raises:
        InputError: other domains, or a basis that cannot hold the sum.
    """
    unit = unit_of(motion.name)
    if curve is None:
        return Curve(motion.name, unit, motion.domain, motion.basis.name, motion.coefficients)
    if curve.domain != motion.domain:
        raise InputError(
            f"{motion.name} cannot be added to a curve of another domain",
            expected=f"{curve.domain}",
            value=f"{motion.domain}",
        )
    basis, count = basis_of(curve.basis), max(len(curve.coefficients), len(motion.coefficients))
    own = conversion_of(curve.name, basis, basis, len(curve.coefficients), count) @ curve.coefficients
    total = own + conversion_of(curve.name, motion.basis, basis, len(motion.coefficients), count) @ motion.coefficients
    return replace(curve, coefficients=tuple(float(v) for v in total), covariance=None)


def conversion_of(name: str, source: Basis, target: Basis, count: int, into: int) -> np.ndarray:
    """(into, count) coefficients of one basis as those of another, for a curve of that name.

    Raises:
        InputError: there is none.
    """
    matrix = conversion(source, target, count, into)
    if matrix is None or into < count:
        raise InputError(
            f"{name} cannot be written in another basis",
            expected=f"{source.name}, {count} coefficients or more",
            value=f"{target.name}, {into}",
        )
    return matrix


def basis_of(name: str) -> Basis:
    """A basis by its name.

    Raises:
        InputError: there is none.
    """
    basis = basis_named(name)
    if basis is None:
        raise InputError("no such basis", expected=known_bases(), value=name)
    return basis


def known_bases() -> str:
    """What an error message says of them."""
    return "one of " + ", ".join(basis.name for basis in BASES)
