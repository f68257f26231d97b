"""Growth and tilt of the structure with the temperature of a sensor, at once or with a delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin._common.records import TIME, is_temperature, sensor_of
from twin.machine.machine import Machine
from twin.model.effects.base import (
    Effect,
    Frame,
    HistoryShift,
    Payload,
    ToolSide,
    ToolSideShift,
    channel,
    direction_of,
    directions,
    split_name,
)
from twin.model.effects.specification import EXTENDING, Advice, Drawing, Forms, Specification, State, linear_forms
from twin.model.effects.thermal_drift import LONGEST_S, SHORTEST_S, drift_time_constants, one_step
from twin.model.effects.thermal_expansion import REFERENCE_DEGC
from twin.numerics.functions import lagged


@final
class ThermalGrowth(ToolSideShift):
    """The tool side moves along a direction of the base frame with the temperature of a sensor: c·(T − 20 °C)."""

    units = (("coefficient", "um/K"),)

    def __init__(self, side: ToolSide, sensor: str, coefficient: float) -> None:
        super().__init__(f"thermal_growth:{side.direction} by {sensor}", side)
        self.sensor = sensor
        self.coefficient = coefficient

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<sensor>_degC``."""
        warm = channel(positions, f"T_{self.sensor}_degC", self.name) - REFERENCE_DEGC
        return (self._shifted(warm),)


def direction_and_sensor(machine: Machine, where: str, specification: Specification) -> tuple[ToolSide, str]:
    """Return the tool side with the direction, and the sensor, of a place such as ``Z by bed``; raise `InputError` if there is none."""
    direction, _, sensor = where.partition(" by ")
    return specification.tool_side(machine, where, direction if sensor else ""), sensor


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


THERMAL_GROWTH: Final = Specification(
    name="thermal_growth",
    kind="machine",
    title=lambda where: Message(
        "growth along {direction} with the temperature of {sensor}",
        direction=where[:1].lower(),
        sensor=where.partition(" by ")[2],
    ),
    family="growth with temperature",
    advice=Advice(
        "Shop floor and service: heat sources near that sensor: coolant, drives, sunlight, draughts.",
        f"Keep the temperature steady, or {EXTENDING} and give the temperature of that sensor.",
        "Do not correct it with a zero offset: it would be wrong at the next temperature.",
    ),
    evidence=lambda fit: Message("the tool side moves with the temperature of that sensor"),
    parameters=("coefficient",),
    limits={"um/K": 500.0},
    places=lambda machine: tuple(f"{way} by" for way in directions(machine)),
    open_places=True,
    channels=lambda where: (f"T_{where.partition(' by ')[2]}_degC",),
    expected=lambda machine: "X, Y or Z of the base frame and a sensor, such as Z by bed",
    make=_make,
    candidates=_candidates,
    varies="with time",
    drawing=Drawing(columns=lambda where: (f"T_{where.split(' by ')[1]}_degC",), of_base=True),
)

TIME_CONSTANT_STRIDE: Final = 7
"""Every n-th of the time constants of a drift is tried."""


@final
class ThermalLag(HistoryShift):
    """The tool side moves along a direction of the base frame by c·L, L the first-order lag of T − 20 °C with time constant τ.

    L is equal to T − 20 °C at the first reading. A single temperature given for a program is taken to have been constant.
    """

    units = (("coefficient", "um/K"), ("time_constant", "s"))

    starts_settled = True

    def __init__(self, side: ToolSide, sensor: str, coefficient: float, time_constant: float) -> None:
        super().__init__(f"thermal_lag:{side.direction} by {sensor}", side)
        self.sensor = sensor
        self.coefficient = coefficient
        self.time_constant = time_constant

    def driven(self, positions: Mapping[str, Any]) -> tuple[Any, ...]:
        """See `HistoryShift.driven`; needs ``T_<sensor>_degC``."""
        return (channel(positions, f"T_{self.sensor}_degC", self.name) - REFERENCE_DEGC,)

    def factors(self, state: Mapping[str, Any]) -> Sequence[np.ndarray]:
        """See `HistoryShift.factors`; needs ``T_<sensor>_degC``, and ``time_s`` if there is more than one reading."""
        warm = np.asarray(self.driven(state)[0], dtype=float)
        if warm.size == 1:
            return warm, np.zeros_like(warm)
        time = np.broadcast_to(np.asarray(channel(state, TIME, self.name), dtype=float), warm.shape)
        follows = lagged(time, warm, self.time_constant, "linear")
        return follows.value, self.coefficient * follows.by_constant


def _make_lag(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> ThermalLag:
    side, sensor = direction_and_sensor(machine, where, THERMAL_LAG)
    return ThermalLag(side, sensor, *numbers.values())


def _lag_candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    if TIME not in state:
        return [], []
    return [f"{way} by {sensor}" for way in directions(machine) for sensor in varying_sensors(state)], []


def _lag_forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    return linear_forms(
        ThermalLag.units[:1],
        lambda values, fixed: _make_lag(machine, where, {"coefficient": values[0], **fixed}, ()),
        tuple({"time_constant": constant} for constant in drift_time_constants(state[TIME])[::TIME_CONSTANT_STRIDE]),
        tests=3.0,
    )


def _constrain(effect: ThermalLag, values: Sequence[float], longest: float) -> ThermalLag:
    constant = one_step(effect.time_constant, values[1], longest)
    return ThermalLag(effect.side, effect.sensor, values[0], constant)


THERMAL_LAG: Final = replace(
    THERMAL_GROWTH,
    name="thermal_lag",
    title=lambda where: Message(
        "growth along {direction} that lags behind the temperature of {sensor}",
        direction=where[:1].lower(),
        sensor=where.partition(" by ")[2],
    ),
    family="growth that lags behind a temperature",
    advice=Advice(
        "Shop floor and service: heat sources near that sensor, and the heavy parts that they warm slowly.",
        f"Keep the temperature steady, or {EXTENDING} and give the temperature of that sensor over time.",
        "Do not correct it with the present temperature alone: the structure follows later.",
    ),
    evidence=lambda fit: Message(
        "the tool side moves by {measure} and follows the temperature of that sensor with a time constant of "
        "{time_constant:.3g} s",
        where=fit.where,
        measure=fit.measure,
        time_constant=fit.numbers["time_constant"],
    ),
    parameters=("coefficient", "time_constant"),
    limits={"um/K": 500.0, "s": LONGEST_S},
    least={"s": SHORTEST_S},
    channels=lambda where: (f"T_{where.partition(' by ')[2]}_degC", TIME),
    make=_make_lag,
    forms=_lag_forms,
    candidates=_lag_candidates,
    nonlinear=("time_constant",),
    constrain=_constrain,
    variant_of="thermal_growth",
    drawing=Drawing(columns=lambda where: (TIME, f"T_{where.split(' by ')[1]}_degC"), of_base=True),
)


# --- Tilt of the structure with a temperature: an axis, and all that it carries, turns ------------

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


def _make_tilt(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> ThermalTilt:
    name, _, sensor = where.partition(" by ")
    if name not in _angles(machine) or not sensor:
        raise THERMAL_TILT.no_place(machine, where)
    return ThermalTilt(name, sensor, numbers["coefficient"])


def _tilt_title(where: str) -> str:
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
    title=_tilt_title,
    family="tilts with temperature",
    advice=Advice(
        "Shop floor and service: a heat source on one side of the part that tilts: coolant, drives, sunlight, a warm "
        "spindle.",
        f"Keep the temperature steady, or {EXTENDING} and give the temperature of that sensor.",
        "Do not correct it with a zero offset or a tool offset: it depends on the position and on the length of the "
        "tool.",
    ),
    evidence=lambda fit: Message(
        "the axis tilts by {measure} with the temperature of that sensor", measure=fit.measure
    ),
    parameters=("coefficient",),
    limits={"urad/K": 500.0},
    places=lambda machine: tuple(f"{name} by" for name in _angles(machine)),
    open_places=True,
    channels=lambda where: (f"T_{where.partition(' by ')[2]}_degC",),
    expected=lambda machine: (
        "an angular error motion of a linear axis, or an orientation of a rotary one, and a sensor: E_AZ by bed"
    ),
    make=_make_tilt,
    candidates=lambda machine, state: (
        [f"{name} by {sensor}" for name in _angles(machine) for sensor in varying_sensors(state)],
        [],
    ),
    varies="with time",
    rare=True,
    drawing=Drawing(columns=lambda where: (f"T_{where.split(' by ')[1]}_degC",), spread=True),
)
