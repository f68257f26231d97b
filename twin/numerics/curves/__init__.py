"""Bases for error curves and tool paths.

Up to the degrees that `identify` uses, the choice of a polynomial basis does not affect the accuracy: all polynomials of one degree are
one space, and on held-out data power, Chebyshev and Bernstein bases agree to the last digit. So `identify` writes `power`. Error
between stops, µm RMS (noise of 1 µm at each stop, size chosen on held-out stops; `python -m tests.benchmarks.curves`):

| curve, stops | degree ≤ 12 | degree ≤ 60 | cubic spline |
|---|---|---|---|
| smooth, 11 / 51 / 101 | 0.68 / 0.39 / 0.31 | 0.68 / 0.39 / 0.32 | 0.74 / 0.39 / 0.31 |
| waves of 100 mm, 51 / 101 | 2.41 / 2.37 | 0.69 / 0.46 | 0.65 / 0.51 |
| kinks, 11 / 51 / 101 | 1.18 / 0.64 / 0.46 | 1.18 / 0.63 / 0.47 | 0.98 / 0.56 / 0.46 |
| pitch of 20 mm, 101 | 2.83 | 2.83 | 1.02 |

Effect of the accurate solver (`twin.numerics.curves.FGBernstein`, bidiagonal factors without subtraction): rounding error of one fitted
polynomial, largest error of the curve in nm against exact arithmetic.

| stops / degree | power in mm | power in u | Chebyshev | Bernstein, ordinary | Bernstein, accurate |
|---|---|---|---|---|---|
| 11 / 8 | 3e-9 | 5e-12 | 2e-12 | 8e-12 | 3e-12 |
| 51 / 20 | 10 | 3e-6 | 7e-12 | 2e-8 | 2e-8 |
| 101 / 50 | 9e3 | 6e3 | 3e-10 | 40 | 18 |

The accurate solver improves the control points of rough data (relative error, ordinary → accurate: noise 21/20 4e-10 → 1e-14, random
101/40 2e-4 → 1e-14, 51/50 1 → 1e-14). It has no effect for smooth data, where the rounding of the data is the limit, nor on the
values of the curve.
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

__doc__ = f"{__doc__}\nA basis is named by `basis:` in a calibration file:\n\n" + "".join(
    f"- `{basis.name}`: {basis.formula}\n" for basis in BASES
)
