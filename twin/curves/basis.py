"""The functions an error curve is a sum of: ``e(q) = Σ c_k f_k(q)``, q in mm or degrees.

Every basis evaluates NumPy arrays and CasADi expressions with the same lines, so that the curve that is compiled is the
curve that is plotted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import pi
from typing import Any, Final, final

from twin.elementary import cos, sin


class Basis(ABC):
    """A family of functions on a domain."""

    name: str

    @abstractmethod
    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """Values of the first ``count`` functions.

        Args:
            q: axis position, mm or degrees: an array of any shape, or a CasADi expression.
            domain: (lo, hi) in the same unit.
            count: how many.
        """

    @abstractmethod
    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """Why a curve of this basis cannot have that many coefficients on that kind of axis; None if it can."""

    @property
    @abstractmethod
    def periodic(self) -> bool:
        """Whether the functions themselves repeat every turn."""

    def value(self, q: Any, domain: tuple[float, float], coefficients: tuple[float, ...]) -> Any:
        """The curve: Σ c_k f_k(q), in the unit of its coefficients."""
        functions = self.functions(q, domain, len(coefficients))
        total = coefficients[0] * functions[0]
        for coefficient, function in zip(coefficients[1:], functions[1:], strict=True):
            total = total + coefficient * function
        return total


@final
class Power(Basis):
    """``basis: power``: f_k = u^k, u = (2q − lo − hi)/(hi − lo)."""

    name: Final = "power"

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        lo, hi = domain
        u = (2.0 * q - (lo + hi)) / (hi - lo)
        powers = [0.0 * u + 1.0]
        for _ in range(count - 1):
            powers.append(powers[-1] * u)
        return powers

    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.misfit`."""
        return None if count >= 1 else "at least one coefficient"

    @property
    def periodic(self) -> bool:
        """Powers do not repeat."""
        return False


@final
class Fourier(Basis):
    """``basis: fourier``: f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself (not scaled to the domain)."""

    name: Final = "fourier"

    def functions(self, q: Any, domain: tuple[float, float], count: int) -> list[Any]:
        """See `Basis.functions`."""
        angle = q * (pi / 180.0)
        found = [0.0 * angle + 1.0]
        for order in range(1, (count + 1) // 2):
            found += [cos(order * angle), sin(order * angle)]
        return found

    def misfit(self, count: int, *, rotary: bool) -> str | None:
        """See `Basis.misfit`."""
        if not rotary:
            return "a rotary axis (fourier is in the axis angle)"
        return None if count % 2 == 1 else "an odd number of coefficients: constant, then cos and sin of each order"

    @property
    def periodic(self) -> bool:
        """Every harmonic repeats each turn."""
        return True


BASES: Final[tuple[Basis, ...]] = (Power(), Fourier())


def basis_named(name: str) -> Basis | None:
    """The basis of that name in a calibration file, or None."""
    return next((basis for basis in BASES if basis.name == name), None)
