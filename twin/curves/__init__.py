"""Bases for error curves and tool paths."""

from twin.curves.basis import BASES, FOURIER, POWER, Basis, Bernstein, Fourier, Power, basis_named
from twin.curves.conversion import conversion, of_legendre
from twin.curves.fg_bernstein import Bidiagonal, FGBernstein

__all__ = [
    "BASES",
    "FOURIER",
    "POWER",
    "Basis",
    "Bernstein",
    "Bidiagonal",
    "FGBernstein",
    "Fourier",
    "Power",
    "basis_named",
    "conversion",
    "of_legendre",
]
