"""Zero offset: a constant error of an axis along its own motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Parameter, along
from twin.machine.effects.specification import EXTENDING, NOT_TWICE, Advice, Specification
from twin.machine.machine import Axis


@final
class ZeroOffset(AlongAxis):
    """Zero offset of an axis: E_aa += offset.

    Args:
        axis: the axis.
        offset: actual minus commanded position, µm or µrad, along the command.
    """

    def __init__(self, axis: Axis, offset: float) -> None:
        super().__init__("zero_offset", axis)
        self.offset = offset

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset."""
        return (self._number("offset", self.unit, self.offset),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, 0.0 * positions[self.axis.name] + 1.0),)


ZERO_OFFSET: Final = Specification(
    name="zero_offset",
    kind="machine",
    title=lambda where: f"zero offset of {where}",
    family="zero offsets",
    advice=Advice(
        "Set-up: reference mark and homing of {axis}; ask whether there was a collision.",
        f"Set the zero of {{axis}} in the control, or {EXTENDING}.",
        NOT_TWICE,
    ),
    evidence=lambda fit: f"the zero of {fit.where} is off by {fit.measure}",
    parameters=("offset",),
    limits={"um": 20_000.0, "urad": 50_000.0},
    places=places.axes,
    make=lambda machine, where, numbers, payloads: ZeroOffset(machine.by_name[where], numbers["offset"]),
    constant=True,
)
