"""The scale of a linear axis lengthens with its temperature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Parameter, along, channel
from twin.machine.effects.specification import EXTENDED, NOT_TWICE, Advice, Drawing, Specification
from twin.machine.machine import Axis

REFERENCE_DEGC: Final = 20.0
"""ISO 1."""


@final
class ThermalExpansion(AlongAxis):
    """The scale of a linear axis lengthens: E_aa += c·(T_a − 20 °C)·q.

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
    title=lambda where: f"scale of {where} lengthens with its temperature",
    family="scales lengthening with temperature",
    advice=Advice(
        "Service: where {axis}'s scale is held, and what the control's own temperature compensation does.",
        f"{EXTENDED} and say the temperature (--temperature {{axis}}=…).",
        "Do not set zero or scale anew for one temperature: they are wrong at the next. " + NOT_TWICE,
    ),
    evidence=lambda of: f"{of.where}'s scale lengthens by {of.measure} as it warms",
    parameters=("coefficient",),
    largest={"um/(m.K)": 100.0},
    places=places.linear,
    channels=lambda where: (f"T_{where}_degC",),
    make=lambda machine, where, numbers, payloads: ThermalExpansion(machine.by_name[where], numbers["coefficient"]),
    varies="with time",
    drawn=Drawing(columns=lambda where: (f"T_{where}_degC",), split=lambda where: where, spread=True),
)
