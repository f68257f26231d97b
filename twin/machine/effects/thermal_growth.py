"""Thermal growth of the structure: the tool side moves with the temperature of a sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin._common.records import is_temperature, sensor_of
from twin.machine.effects.base import Parameter, channel
from twin.machine.effects.payload import Payload
from twin.machine.effects.places import single_parameter_form
from twin.machine.effects.specification import EXTENDING, Advice, Drawing, Forms, Specification, State
from twin.machine.effects.thermal_expansion import REFERENCE_DEGC
from twin.machine.effects.tool_side import ToolSide, ToolSideShift, directions, tool_side
from twin.machine.machine import Machine


@final
class ThermalGrowth(ToolSideShift):
    """The tool side moves along a direction of the base frame with the temperature of a sensor: c·(T − 20 °C).

    Args:
        side: tool side and direction.
        sensor: name of the sensor, from column ``T_<sensor>_degC``.
        coefficient: c, µm/K.
    """

    def __init__(self, side: ToolSide, sensor: str, coefficient: float) -> None:
        super().__init__(f"thermal_growth:{side.direction} by {sensor}", side)
        self.sensor = sensor
        self.coefficient = coefficient

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient."""
        return (self._number("coefficient", "um/K", self.coefficient),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<sensor>_degC``."""
        warm = channel(positions, f"T_{self.sensor}_degC", self.name) - REFERENCE_DEGC
        return (self._shifted(warm),)


def direction_and_sensor(machine: Machine, where: str, specification: Specification) -> tuple[ToolSide, str]:
    """Return the tool side with the direction, and the sensor, of a place such as ``Z by bed``.

    Raises:
        InputError: the machine has no such place.
    """
    direction, _, sensor = where.partition(" by ")
    side = tool_side(machine, direction)
    if side is None or not sensor:
        raise specification.no_place(machine, where)
    return side, sensor


def sensors_of(state: State) -> list[str]:
    """Return the names of the temperature sensors of a table, and of the axes whose scales have one."""
    return [sensor_of(name) for name in state if is_temperature(name)]


def varying_sensors(state: State) -> list[str]:
    """Return the names of those whose temperature changed."""
    return [name for name in sensors_of(state) if np.ptp(state[f"T_{name}_degC"]) > 0.0]


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> ThermalGrowth:
    side, sensor = direction_and_sensor(machine, where, THERMAL_GROWTH)
    return ThermalGrowth(side, sensor, numbers["coefficient"])


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    sensors, ways = sensors_of(state), directions(machine)
    if not sensors and ways:
        return [], [(", ".join(ways), "T_<sensor>_degC")]
    return [f"{way} by {sensor}" for way in ways for sensor in sensors], []


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    return single_parameter_form(
        ("coefficient", "um/K"), lambda value: _make(machine, where, {"coefficient": value}, ())
    )


THERMAL_GROWTH: Final = Specification(
    name="thermal_growth",
    kind="machine",
    title=lambda where: f"growth along {where[:1].lower()} with the temperature of {where.partition(' by ')[2]}",
    family="growth with temperature",
    advice=Advice(
        "Shop floor and service: heat sources near that sensor: coolant, drives, sunlight, draughts.",
        f"Keep the temperature steady, or {EXTENDING} and give the temperature of that sensor.",
        "Do not correct it with a zero offset: it would be wrong at the next temperature.",
    ),
    evidence=lambda fit: f"{fit.where}: the tool side moves with the temperature of that sensor",
    parameters=("coefficient",),
    limits={"um/K": 500.0},
    places=lambda machine: tuple(f"{way} by" for way in directions(machine)),
    open_places=True,
    channels=lambda where: (f"T_{where.partition(' by ')[2]}_degC",),
    expected=lambda machine: "X, Y or Z of the base frame and a sensor, such as Z by bed",
    make=_make,
    forms=_forms,
    candidates=_candidates,
    varies="with time",
    drawing=Drawing(columns=lambda where: (f"T_{where.split(' by ')[1]}_degC",), of_base=True),
)
