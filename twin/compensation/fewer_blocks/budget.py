"""An uncertainty from what contributes to it, the path's own error among them.

Díaz Pérez et al. (2019), eq. 15: the error at a place of a trajectory is that of the system plus that of the trajectory's definition.
Their table 2 combines standard uncertainties as ISO/TR 230-9 does: U = k √Σu², k = 2; an error known by its limits ±a counts as a/√3
(JCGM 100:2008, 4.3.7), a resolution r as r/√12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Final, final

COVERAGE_FACTOR: Final = 2.0


@final
@dataclass(frozen=True)
class Contribution:
    """One contribution to an uncertainty.

    Attributes:
        name: what it is.
        standard_um: standard uncertainty (k = 1), µm; NaN where it is not known.
        how: where the number comes from.
    """

    name: str
    standard_um: float
    how: str

    @classmethod
    def within(cls, name: str, limit_um: float, how: str) -> Contribution:
        """Of an error that lies anywhere within ± a limit."""
        return cls(name, limit_um / sqrt(3.0), f"{how}: ± {limit_um:.3f} µm/√3")

    @classmethod
    def resolution(cls, name: str, step_um: float, how: str) -> Contribution:
        """Of a value rounded to multiples of a step."""
        return cls(name, step_um / sqrt(12.0), f"{how}: {step_um:g} µm/√12")


def combined(contributions: Sequence[Contribution], coverage_factor: float = COVERAGE_FACTOR) -> float:
    """U = k √Σu² in µm; NaN where a contribution is not known."""
    return coverage_factor * sqrt(sum(one.standard_um**2 for one in contributions))
