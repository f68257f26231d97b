"""Fitting of changed values at the nodes of a link to the curves, each in its own basis."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.machine.datum.links import DatumLink, Numbers
from twin.machine.effects import unit_of
from twin.machine.motion_curve import Curve, conversion_of
from twin.numerics.curves import Basis, bases_for, legendre_in_basis

FIT_TOLERANCE: Final = 3e-5
"""Largest difference of a converted curve from the converted values, µm or µrad: 0.03 nm."""
MAX_COEFFICIENTS: Final = 60
"""Largest number of coefficients of a converted curve."""


def with_values(
    curve: Curve | None, name: str, link: DatumLink, difference: np.ndarray, numbers: Numbers
) -> Curve | None:
    """Return a curve with values at the nodes added, with as few coefficients as possible; None for a new curve that would be zero.

    Raises:
        InputError: no number of coefficients can represent them.
    """
    if curve is None:
        if np.abs(difference).max() <= FIT_TOLERANCE:
            return None
        basis = bases_for(rotary=not link.axis.linear, endless=link.axis.lower is None)[0]
        illustrative = any(known.illustrative for known in numbers.curves.values())
        curve = Curve(
            name, unit_of(name), link.domain, basis.name, (0.0,), None, "from a change of datum", illustrative
        )
    if curve.domain != link.domain and link.axis.lower is not None:
        curve = _over(curve, link)
    basis, own = curve.family, len(curve.coefficients)
    for count in range(own, max(MAX_COEFFICIENTS, own) + 1):
        if basis.count_problem(count, rotary=not link.axis.linear) is not None:
            continue
        added = fit(basis, curve.domain, link, count) @ difference
        if np.abs(functions(basis, curve.domain, link, count) @ added - difference).max() <= FIT_TOLERANCE:
            total = conversion_of(name, basis, basis, own, count) @ curve.coefficients + added
            return replace(curve, coefficients=tuple(float(v) for v in total), covariance=None)
    raise InputError(
        f"{name} cannot be converted to this datum in basis {basis.name}",
        expected="a curve over the whole range of its axis, in a basis that can represent the constants and waves of the datum",
        value=f"domain {curve.domain[0]:g} to {curve.domain[1]:g}",
    )


def _over(curve: Curve, link: DatumLink) -> Curve:
    """Return the same curve over the range that all curves of its axis cover.

    Raises:
        InputError: the basis cannot represent it.
    """
    values = functions(curve.family, curve.domain, link, len(curve.coefficients)) @ curve.coefficients
    basis, count = curve.family.restricted(link.domain, len(curve.coefficients))
    found = fit(basis, link.domain, link, count) @ values
    own = tuple(float(v) for v in found)
    return replace(curve, domain=link.domain, coefficients=own, covariance=None, knots=basis.knots)


def functions(basis: Basis, domain: tuple[float, float], link: DatumLink, count: int) -> np.ndarray:
    """Return the functions (n, count) of a basis at a link's nodes, wrapped for an unlimited axis."""
    lo, hi = domain
    q = link.nodes
    if link.axis.lower is None and not basis.periodic:
        q = np.where(q == link.nodes[-1], hi, lo + np.mod(q - lo, hi - lo)) if domain == link.domain else (
            lo + np.mod(q - lo, hi - lo)
        )  # fmt: skip
    return np.stack(basis.functions(q, domain, count), axis=1)


def fit(basis: Basis, domain: tuple[float, float], link: DatumLink, count: int) -> np.ndarray:
    """Return the matrix (count, n) from values at the nodes to coefficients, by least squares over the range."""
    legendre = legendre_in_basis(basis, count) if domain == link.domain else None
    if legendre is not None:
        polynomials = np.polynomial.legendre.legvander(link.u, count - 1) * (2.0 * np.arange(count) + 1.0)
        return np.asarray(legendre @ (polynomials * link.weights[:, None]).T)
    root = np.sqrt(link.weights)
    return np.asarray(np.linalg.pinv(functions(basis, domain, link, count) * root[:, None], rcond=1e-13) * root)
