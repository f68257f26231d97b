"""Bases for error curves and tool paths."""

from twin.curves.basis import BASES, Basis, Fourier, Power, basis_named

__all__ = ["BASES", "Basis", "Fourier", "Power", "basis_named"]
