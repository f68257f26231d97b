"""Bases for error curves and tool paths.

Manual: `twin doc curves`.
"""

from twin.numerics.curves.basis import Basis
from twin.numerics.curves.conversion import conversion, legendre_in_basis
from twin.numerics.curves.family import BASES, POWER, bases_for, basis_named, basis_of
from twin.numerics.curves.fg_bernstein import FGBernstein
from twin.numerics.curves.space import CurveSpace

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
