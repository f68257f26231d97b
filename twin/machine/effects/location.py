"""Position and orientation of the axis average line of a rotary axis (ISO 230-1, 3.5; contract §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects.base import Effect, Frame, Parameter
from twin.machine.effects.names import motion_in_words, split_name, unit_of
from twin.machine.effects.places import single_parameter_form
from twin.machine.effects.specification import EXTENDING, NOT_TWICE, Advice, Drawing, Specification


@final
class AxisLocation(Effect):
    """``E_X0C``, ``E_Y0C`` (µm), ``E_A0C``, ``E_B0C`` (µrad): constant, in the frame that precedes the axis's error motions.

    Args:
        name: ISO 230-1 name.
        offset: µm or µrad.
    """

    def __init__(self, name: str, offset: float) -> None:
        self.name = name
        self.offset = offset
        self._component, _, self._axis = split_name(name)
        self.frame = Frame(self._axis, "location")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset."""
        return (Parameter(self.name, unit_of(self.name), self.offset),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return ({self._component: 0.0 * positions[self._axis] + 1.0},)


AXIS_LOCATION: Final = Specification(
    name="axis_location",
    kind="machine",
    title=motion_in_words,
    family="locations of rotary axes",
    advice=Advice(
        "Set-up: position and orientation of rotary axis {axis} in the control's kinematics, and how they were measured.",
        f"Enter the new values in the control, or {EXTENDING}.",
        NOT_TWICE,
    ),
    evidence=lambda fit: f"{fit.where}: the axis average line differs from the model by {fit.measure}",
    limits={"um": 20_000.0, "urad": 20_000.0},
    places=lambda machine: machine.location_names,
    forms=lambda machine, where, state, payloads: single_parameter_form(
        ("offset", unit_of(where)), lambda value: AxisLocation(where, value)
    ),
    constant=True,
    drawing=Drawing(beyond=True),
)
