"""Bases for error curves and tool paths.

Manual: `twin doc curves`.
"""

from __future__ import annotations

from functools import cache
from typing import Final

from twin._common.errors import InputError, closest_name
from twin.numerics.curves.bases import Bernstein, CubicSpline, Fourier, Power
from twin.numerics.curves.basis import Basis, CurveSpace, conversion, legendre_in_basis
from twin.numerics.curves.fg_bernstein import FGBernstein

BASES: Final[tuple[type[Basis], ...]] = (Power, Fourier, Bernstein, CubicSpline)
POWER: Final = Power()


def basis_named(name: str) -> type[Basis]:
    """Return the basis with a name as in a calibration file. Raises `InputError`: there is no such basis."""
    basis_named = next((basis for basis in BASES if basis.name == name), None)
    if basis_named is None:
        known = [basis.name for basis in BASES]
        expected = f"one of {', '.join(known)}"
        raise InputError("no such basis", expected=expected, value=name, nearest=closest_name(name, known))
    return basis_named


@cache
def basis_of(name: str, knots: tuple[float, ...] = ()) -> Basis:
    """Return a basis by its name and knots; cached. Raises `InputError`: there is no basis of that name, or none with these knots."""
    return basis_named(name)(knots)


def bases_for(*, rotary: bool, endless: bool) -> tuple[Basis, ...]:
    """Return the bases that `identify` tries for the curves of one kind of axis (endless: without limits), the first choice first."""
    places = [(basis.preference(rotary=rotary, endless=endless), basis) for basis in BASES]
    tried = sorted(((place, basis) for place, basis in places if place is not None), key=lambda one: one[0])
    return tuple(basis() for _, basis in tried)


__all__ = [
    "BASES",
    "POWER",
    "Basis",
    "CurveSpace",
    "FGBernstein",
    "bases_for",
    "basis_named",
    "basis_of",
    "conversion",
    "legendre_in_basis",
]
