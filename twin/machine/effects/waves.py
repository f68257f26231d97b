"""Smooth functions of the columns of a table, of which empirical effects and patterns of unknown cause are sums.

- ``half_waves`` of a column x over a range: cos(k π (x − low)/(high − low)), k = 1 … order.
- ``whole_turns`` of a rotary axis at the angle θ: cos(k θ) and sin(k θ), k = 1 … order.
- ``direction``: the direction of approach of an axis, +1 or −1.

Two columns have the functions of each and all their products. With a direction, each function contains the direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, Final, Literal, final

from twin.numerics.elementary import cos, floor, sin

APPROACH: Final = "approach_"
ROUNDING: Final = 1e-6
"""Tolerance for leaving a range, as a fraction of it."""
TURN_DEG: Final = 360.0
Kind = Literal["half_waves", "whole_turns", "direction"]


@final
@dataclass(frozen=True)
class Waves:
    """Functions of one column, without the constant.

    Attributes:
        column: its name in the table (``X_mm``, ``T_bed_degC``, ``approach_X``).
        kind: kind of functions (see the module).
        order: highest k; one for a direction.
        range: lowest and highest value measured, mm, degrees or °C; None where the functions need none.
        wrapped: whether the axis has unlimited rotation, so that whole turns are first subtracted from its position.
    """

    column: str
    kind: Kind
    order: int
    range: tuple[float, float] | None = None
    wrapped: bool = False

    @property
    def half_waves(self) -> tuple[int, ...]:
        """Number of half waves of each function; one for a direction."""
        orders = range(1, self.order + 1)
        return tuple(2 * k for k in orders for _ in range(2)) if self.kind == "whole_turns" else tuple(orders)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each function in a calibration file."""
        if self.kind == "whole_turns":
            return tuple(f"{part}{k}" for k in range(1, self.order + 1) for part in "cs")
        return tuple(str(k) for k in range(1, self.order + 1))

    def up_to(self, half_waves: int) -> Waves:
        """Return the same column with only the functions of at most ``half_waves`` half waves."""
        most = half_waves // 2 if self.kind == "whole_turns" else half_waves
        return replace(self, order=min(self.order, most))

    def values(self, x: Any) -> list[Any]:
        """Return the functions at values ``x`` of the column: arrays or CasADi expressions."""
        if self.kind == "direction":
            return [x]
        orders = range(1, self.order + 1)
        if self.kind == "whole_turns":
            return [f(k * (x * (pi / 180.0))) for k in orders for f in (cos, sin)]
        share = self.share(x)
        return [cos(k * pi * share) for k in orders]

    def share(self, x: Any) -> Any:
        """Return the position of values in the range, 0 to 1 inside; only for half waves."""
        if self.range is None:
            raise ValueError(f"{self.column} has no range")
        low, high = self.range
        if self.wrapped:
            first = 0.5 * (low + high - TURN_DEG)
            x = x - TURN_DEG * floor((x - first) / TURN_DEG)
        return (x - low) / (high - low)

    def outside(self, x: Any) -> Any:
        """Return whether values leave the range by more than rounding; False if there is no range."""
        if self.range is None:
            return x != x
        share = self.share(x)
        return (share < -ROUNDING) | (share > 1.0 + ROUNDING)


def terms(columns: Sequence[Waves]) -> list[tuple[int, ...]]:
    """Return every function of one or two columns, as the number of each column's function from 1; 0 for the constant."""
    first = range(1, len(columns[0].half_waves) + 1)
    if len(columns) == 1:
        return [(i,) for i in first]
    second = range(1, len(columns[1].half_waves) + 1)
    if columns[0].kind == "direction":
        return [(i, j) for i in first for j in (0, *second)]
    return [*((i, 0) for i in first), *((0, j) for j in second), *((i, j) for i in first for j in second)]


def label(columns: Sequence[Waves], term: Sequence[int]) -> str:
    """Return the name of a function in a calibration file: ``3``, ``3,1``, ``c2,0``."""
    return ",".join("0" if i == 0 else own.labels[i - 1] for own, i in zip(columns, term, strict=True))
