"""Lost motion: where an axis really is depends on the side it came from (ISO 230-1, 3.4.16; ISO 230-2, 2.15)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Parameter, along, channel
from twin.machine.effects.specification import EXTENDED, NOT_TWICE, Advice, Drawing, Specification
from twin.machine.machine import Axis


@final
class Reversal(AlongAxis):
    """Lost motion: E_aa += ± size/2, by the side the axis came from.

    Args:
        axis: the axis.
        size: actual position coming from below (+) less that coming from above (−), µm or µrad, along the command.
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
    title=lambda where: f"lost motion of {where}",
    family="lost motion",
    advice=Advice(
        "Service: nut and preload of {axis}'s screw (a rotary axis: worm or gear), thrust bearing, coupling, seat of the scale.",
        f"{EXTENDED}: it knows from which side {{axis}} comes. Or enter it as backlash in the control.",
        f"{NOT_TWICE} Do not shift the zero of {{axis}}: that moves the error and leaves it as large.",
    ),
    evidence=lambda of: f"{of.where} stands {abs(of.size):.3g} {of.unit} apart depending on the side it came from",
    parameters=("size",),
    largest={"um": 1000.0, "urad": 5000.0},
    places=places.axes,
    channels=places.approach,
    make=lambda machine, where, numbers, payloads: Reversal(machine.by_name[where], numbers["size"]),
    drawn=Drawing(split=lambda where: f"approach_{where}", also=places.approach),
)
