"""Thermal expansion of the scale of a linear axis, and growth about its fixed point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, final

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import AlongAxis, Payload, along_scale, channel
from twin.model.effects.specification import (
    EXTENDED,
    NOT_TWICE,
    Advice,
    Drawing,
    FittedCause,
    Forms,
    Specification,
    State,
    linear_axes,
    linear_forms,
)

REFERENCE_DEGC: Final = 20.0
"""Reference temperature (ISO 1)."""


@final
class ThermalExpansion(AlongAxis):
    """Thermal expansion of the scale of a linear axis: E_aa += c·(T_a − 20 °C)·q."""

    units = (("coefficient", "um/(m.K)"),)

    def __init__(self, axis: Axis, coefficient: float) -> None:
        super().__init__("thermal_expansion", axis)
        self.coefficient = coefficient

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<axis>_degC``."""
        warm = channel(positions, f"T_{self.axis.name}_degC", self.name) - REFERENCE_DEGC
        return along_scale(self.axis, positions, warm)[:1]


THERMAL_EXPANSION: Final = Specification(
    name="thermal_expansion",
    kind="machine",
    title=lambda where: Message("thermal expansion of the scale of {where}", where=where),
    family="thermal expansion of scales",
    advice=Advice(
        "Service: where the scale of {axis} is fixed, and what the control's own temperature compensation does.",
        f"{EXTENDED} and give the temperature of {{axis}}.",
        "Do not reset zero or scale for one temperature: they would be wrong at the next. " + NOT_TWICE,
    ),
    evidence=lambda fit: Message(
        "the scale of {where} lengthens by {measure} when it warms", where=fit.where, measure=fit.measure
    ),
    parameters=("coefficient",),
    limits={"um/(m.K)": 100.0},
    places=linear_axes,
    channels=lambda where: (f"T_{where}_degC",),
    make=lambda machine, where, numbers, payloads: ThermalExpansion(machine.by_name[where], numbers["coefficient"]),
    varies="with time",
    drawing=Drawing(columns=lambda where: (f"T_{where}_degC",), split=lambda where: where, spread=True),
)


@final
class ScaleGrowth(AlongAxis):
    """Thermal expansion of a scale about its fixed point: E_aa += (c·q + g)·(T_a − 20 °C), fixed at q = −g/c."""

    units = (("coefficient", "um/(m.K)"), ("offset", "um/K"))
    linear = 2

    def __init__(self, axis: Axis, coefficient: float, offset: float) -> None:
        super().__init__("scale_growth", axis)
        self.coefficient = coefficient
        self.offset = offset

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<axis>_degC``."""
        warm = channel(positions, f"T_{self.axis.name}_degC", self.name) - REFERENCE_DEGC
        return along_scale(self.axis, positions, warm)


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    axis = machine.by_name[where]
    return linear_forms(ScaleGrowth.units, lambda values, fixed: ScaleGrowth(axis, *values))


def _evidence(fit: FittedCause) -> str:
    coefficient, offset = fit.numbers.get("coefficient", 0.0), fit.numbers.get("offset", 0.0)
    at = Message(", fixed at {at:.0f} mm", at=-1000.0 * offset / coefficient) if coefficient else ""
    return Message(
        "the scale of {where} lengthens by {coefficient:.3g} µm/(m·K) when it warms{at}",
        where=fit.where,
        coefficient=coefficient,
        at=at,
    )


SCALE_GROWTH: Final = replace(
    THERMAL_EXPANSION,
    name="scale_growth",
    title=lambda where: Message("thermal expansion of the scale of {where} about its fixed point", where=where),
    family="thermal expansion of scales about their fixed points",
    advice=replace(
        THERMAL_EXPANSION.advice,
        look="Service: where the scale of {axis} is fixed, and what the control's own temperature compensation assumes.",
    ),
    evidence=_evidence,
    parameters=("coefficient", "offset"),
    limits={"um/(m.K)": 100.0, "um/K": 500.0},
    make=lambda machine, where, numbers, payloads: ScaleGrowth(machine.by_name[where], *numbers.values()),
    forms=_forms,
    variant_of="thermal_expansion",
)
