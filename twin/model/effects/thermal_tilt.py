"""Tilt of the structure with a temperature: an axis, and all that it carries, turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.model.effects.base import Effect, Frame, Payload, channel, direction_of, split_name
from twin.model.effects.specification import EXTENDING, Advice, Drawing, Specification, State
from twin.model.effects.thermal_expansion import REFERENCE_DEGC
from twin.model.effects.thermal_growth import varying_sensors

FIRST_ANGLE: Final = 3


@final
class ThermalTilt(Effect):
    """One angular error motion or orientation of an axis changes with a sensor: E_AZ += c·(T − 20 °C), at every position of the axis.

    For a linear axis it is its error motion (column, head, saddle), for a rotary axis the orientation of its average line (ISO 230-1),
    ``E_A0C``.
    """

    units = (("coefficient", "urad/K"),)

    def __init__(self, name: str, sensor: str, coefficient: float) -> None:
        self._component, constant, axis = split_name(name)
        self.name = f"thermal_tilt:{name} by {sensor}"
        self.frame = Frame(axis, "location" if constant else "motion")
        self.sensor = sensor
        self.coefficient = coefficient

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<sensor>_degC``."""
        warm = channel(positions, f"T_{self.sensor}_degC", self.name) - REFERENCE_DEGC
        return ({self._component: warm},)


def _angles(machine: Machine) -> tuple[str, ...]:
    """Return the angular error motions of linear axes, and the orientations of the average lines of rotary axes."""
    motions = [name for name in machine.motion_names if machine.by_name[split_name(name)[2]].linear]
    return tuple(name for name in (*motions, *machine.location_names) if split_name(name)[0] >= FIRST_ANGLE)


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> ThermalTilt:
    name, _, sensor = where.partition(" by ")
    if name not in _angles(machine) or not sensor:
        raise THERMAL_TILT.no_place(machine, where)
    return ThermalTilt(name, sensor, numbers["coefficient"])


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    return [f"{name} by {sensor}" for name in _angles(machine) for sensor in varying_sensors(state)], []


def _title(where: str) -> str:
    name, _, sensor = where.partition(" by ")
    return Message(
        "tilt of {axis} about {direction} with the temperature of {sensor}",
        axis=split_name(name)[2],
        direction=direction_of(name),
        sensor=sensor,
    )


THERMAL_TILT: Final = Specification(
    name="thermal_tilt",
    kind="machine",
    title=_title,
    family="tilts with temperature",
    advice=Advice(
        "Shop floor and service: a heat source on one side of the part that tilts: coolant, drives, sunlight, a warm spindle.",
        f"Keep the temperature steady, or {EXTENDING} and give the temperature of that sensor.",
        "Do not correct it with a zero offset or a tool offset: it depends on the position and on the length of the tool.",
    ),
    evidence=lambda fit: f"{fit.where}: the axis tilts by {fit.measure} with the temperature of that sensor",
    parameters=("coefficient",),
    limits={"urad/K": 500.0},
    places=lambda machine: tuple(f"{name} by" for name in _angles(machine)),
    open_places=True,
    channels=lambda where: (f"T_{where.partition(' by ')[2]}_degC",),
    expected=lambda machine: (
        "an angular error motion of a linear axis, or an orientation of a rotary one, and a sensor: E_AZ by bed"
    ),
    make=_make,
    candidates=_candidates,
    varies="with time",
    rare=True,
    drawing=Drawing(columns=lambda where: (f"T_{where.split(' by ')[1]}_degC",), spread=True),
)
