"""Thermal expansion of the scale of a linear axis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Parameter, along, channel
from twin.machine.effects.specification import EXTENDED, NOT_TWICE, Advice, Drawing, Specification
from twin.machine.machine import Axis

REFERENCE_DEGC: Final = 20.0
"""Reference temperature (ISO 1)."""


@final
class ThermalExpansion(AlongAxis):
    """Thermal expansion of the scale of a linear axis: E_aa += c·(T_a − 20 °C)·q.

    Args:
        axis: the axis.
        coefficient: c, µm/(m·K).
    """

    def __init__(self, axis: Axis, coefficient: float) -> None:
        super().__init__("thermal_expansion", axis)
        self.coefficient = coefficient

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient."""
        return (self._number("coefficient", "um/(m.K)", self.coefficient),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<axis>_degC``."""
        warm = channel(positions, f"T_{self.axis.name}_degC", self.name) - REFERENCE_DEGC
        return (along(self.axis, 1e-3 * positions[self.axis.name] * warm),)


THERMAL_EXPANSION: Final = Specification(
    name="thermal_expansion",
    kind="machine",
    title=lambda where: f"thermal expansion of the scale of {where}",
    family="thermal expansion of scales",
    advice=Advice(
        "Service: where the scale of {axis} is fixed, and what the control's own temperature compensation does.",
        f"{EXTENDED} and give the temperature of {{axis}}.",
        "Do not reset zero or scale for one temperature: they would be wrong at the next. " + NOT_TWICE,
    ),
    evidence=lambda fit: f"the scale of {fit.where} lengthens by {fit.measure} when it warms",
    parameters=("coefficient",),
    limits={"um/(m.K)": 100.0},
    places=places.linear,
    channels=lambda where: (f"T_{where}_degC",),
    make=lambda machine, where, numbers, payloads: ThermalExpansion(machine.by_name[where], numbers["coefficient"]),
    varies="with time",
    drawing=Drawing(columns=lambda where: (f"T_{where}_degC",), split=lambda where: where, spread=True),
)
