"""Backlash (reversal value): the position of an axis depends on the direction of approach (ISO 230-1, 3.4.16; ISO 230-2, 2.15)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Parameter, along, channel
from twin.machine.effects.specification import EXTENDED, NOT_TWICE, Advice, Drawing, Specification
from twin.machine.machine import Axis


@final
class Reversal(AlongAxis):
    """Backlash: E_aa += ± size/2, by the direction of approach.

    Args:
        axis: the axis.
        size: actual position approached in the + direction minus that approached in the − direction, µm or µrad, along the command.
    """

    def __init__(self, axis: Axis, size: float) -> None:
        super().__init__("reversal", axis)
        self.size = size

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The size."""
        return (self._number("size", self.unit, self.size),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``approach_<axis>``."""
        return (along(self.axis, 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)),)


REVERSAL: Final = Specification(
    name="reversal",
    kind="machine",
    title=lambda where: f"backlash of {where}",
    family="backlash",
    advice=Advice(
        "Service: screw nut and preload of {axis} (rotary axis: worm or gear), thrust bearing, coupling, mounting of the scale.",
        f"{EXTENDED}: it takes the direction of approach of {{axis}} into account. Or enter the value as backlash in the control.",
        f"{NOT_TWICE} Do not shift the zero of {{axis}}: that moves the error but does not reduce it.",
    ),
    evidence=lambda fit: (
        f"{fit.where} has {abs(fit.size):.3g} {fit.unit} of backlash: its position depends on the direction of approach"
    ),
    parameters=("size",),
    limits={"um": 1000.0, "urad": 5000.0},
    places=places.axes,
    channels=places.approach,
    make=lambda machine, where, numbers, payloads: Reversal(machine.by_name[where], numbers["size"]),
    drawing=Drawing(split=lambda where: f"approach_{where}", depends_on=places.approach),
)
