"""The curve of one error motion as a function of its axis's position, as stored in a calibration file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.display import readable, span
from twin.display.results import Result
from twin.model.effects import ErrorMotion, unit_of
from twin.numerics.curves import POWER, Basis, basis_of, conversion


@final
@dataclass(frozen=True, repr=False)
class Curve(Result):
    """The curve of one error motion.

    Attributes:
        name: ISO 230-1 name.
        unit: ``um`` or ``urad``.
        domain: (lo, hi) in mm or degrees.
        basis: name of its basis.
        coefficients: coefficients in ``unit``.
        covariance: (k, k) covariance of the coefficients, or None if unknown.
        source: origin of the numbers.
        illustrative: whether they are illustrative instead of measured.
        knots: knots of the basis, if it has any, mm or degrees.

    Examples:
        >>> curve = twin.Curve("E_XX", "um", (0.0, 500.0), "power", (0.0, 11.4, 2.0))
        >>> curve([0.0, 250.0, 500.0])  # µm
        array([-9.4,  0. , 13.4])
        >>> curve.written("bernstein", 3).coefficients
        (-9.4, -2.0, 13.4)
    """

    name: str
    unit: str
    domain: tuple[float, float]
    basis: str
    coefficients: tuple[float, ...]
    covariance: np.ndarray | None = None
    source: str = ""
    illustrative: bool = False
    knots: tuple[float, ...] = ()

    @property
    def family(self) -> Basis:
        """The basis.

        Raises:
            InputError: there is no basis of that name, or the knots do not fit it.
        """
        return basis_of(self.basis, self.knots)

    def motion(self, *, wrapped: bool) -> ErrorMotion:
        """Return the curve as an effect.

        Args:
            wrapped: whether the axis has unlimited rotation.
        """
        return ErrorMotion(self.name, self.family, self.domain, self.coefficients, wrapped=wrapped)

    def __call__(self, q: Any) -> np.ndarray:
        """Return the values of the curve at axis positions q (mm or degrees, any shape), in ``unit``.

        Raises:
            InputError: a position is outside the domain.
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
        return np.asarray(self.family.value(positions, self.domain, self.coefficients))

    @property
    def brief(self) -> str:
        """Name, basis, number of coefficients and domain."""
        known = "" if self.covariance is not None else ", uncertainty unknown"
        drawn = ", illustrative" if self.illustrative else ""
        count = count_with_noun(len(self.coefficients), "coefficient")
        return f"{self.name}: {self.basis}, {count} in {readable(self.unit)}, {span(*self.domain, '').strip()}{known}{drawn}"

    def in_powers(self) -> Curve | None:
        """Return the same curve in powers of u; None if it is not a polynomial."""
        count = len(self.coefficients)
        return None if conversion(self.family, POWER, count, count) is None else self.written(POWER.name, count)

    def written(self, basis: str, count: int) -> Curve:
        """Return the same curve, with its covariance, as ``count`` coefficients of another basis.

        Raises:
            InputError: there is no such basis, or it cannot represent this curve.
        """
        matrix = conversion_of(self.name, self.family, basis_of(basis), len(self.coefficients), count)
        return replace(
            self,
            basis=basis,
            knots=(),
            coefficients=tuple(float(v) for v in matrix @ self.coefficients),
            covariance=None if self.covariance is None else read_only(matrix @ self.covariance @ matrix.T),
        )


def sum_of_curves(curve: Curve | None, motion: ErrorMotion) -> Curve:
    """Return the sum of two curves over the same domain, in the basis of the first."""
    family, own = motion.basis, len(motion.coefficients)
    if curve is None:
        unit = unit_of(motion.name)
        return Curve(motion.name, unit, motion.domain, family.name, motion.coefficients, knots=family.knots)
    if curve.domain != motion.domain:
        raise InputError(
            f"{motion.name} cannot be added to a curve of another domain",
            expected=f"{curve.domain}",
            value=f"{motion.domain}",
        )
    basis, count = curve.family.common_basis(len(curve.coefficients), family, own)
    total = conversion_of(curve.name, curve.family, basis, len(curve.coefficients), count) @ curve.coefficients
    total = total + conversion_of(curve.name, family, basis, own, count) @ motion.coefficients
    return replace(curve, coefficients=tuple(float(v) for v in total), covariance=None, knots=basis.knots)


def conversion_of(name: str, source: Basis, target: Basis, count: int, into: int) -> np.ndarray:
    """Return the matrix (into, count) from coefficients of one basis to those of another, for the curve of that name."""
    matrix = conversion(source, target, count, into)
    if matrix is None or into < count:
        raise InputError(
            f"{name} cannot be written in another basis",
            expected=f"{source.name}, {count} coefficients or more",
            value=f"{target.name}, {into}",
        )
    return matrix
