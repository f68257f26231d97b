"""Thermal growth of the structure that lags behind its sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin._common.records import TIME
from twin.machine.effects.base import Parameter, channel
from twin.machine.effects.payload import Payload
from twin.machine.effects.specification import EXTENDING, Advice, Drawing, Forms, Specification, State
from twin.machine.effects.thermal_drift import drift_time_constants, one_step
from twin.machine.effects.thermal_expansion import REFERENCE_DEGC
from twin.machine.effects.thermal_growth import direction_and_sensor, varying_sensors
from twin.machine.effects.tool_side import HistoryShift, ToolSide, directions
from twin.machine.machine import Machine
from twin.numerics.first_order_lag import lagged

TIME_CONSTANT_STRIDE: Final = 7
"""Every n-th of the time constants of a drift is tried."""


@final
class ThermalLag(HistoryShift):
    """The tool side moves along a direction of the base frame by c·L, L the first-order lag of T − 20 °C with time constant τ.

    L is equal to T − 20 °C at the first reading. A single temperature given for a program is taken to have been constant.

    Args:
        side: tool side and direction.
        sensor: name of the sensor, from column ``T_<sensor>_degC``.
        coefficient: c, µm/K.
        time_constant: τ, s.
    """

    def __init__(self, side: ToolSide, sensor: str, coefficient: float, time_constant: float) -> None:
        super().__init__(f"thermal_lag:{side.direction} by {sensor}", side)
        self.sensor = sensor
        self.coefficient = coefficient
        self.time_constant = time_constant

    def changed(self, coefficient: float, time_constant: float) -> ThermalLag:
        """Return the same effect with other parameters."""
        return ThermalLag(self._side, self.sensor, coefficient, time_constant)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficient and time constant."""
        return (
            self._number("coefficient", "um/K", self.coefficient),
            self._number("time_constant", "s", self.time_constant),
        )

    def factors(self, state: Mapping[str, Any]) -> Sequence[np.ndarray]:
        """See `HistoryShift.factors`; needs ``T_<sensor>_degC``, and ``time_s`` if there is more than one reading."""
        warm = np.asarray(channel(state, f"T_{self.sensor}_degC", self.name), dtype=float) - REFERENCE_DEGC
        if warm.size == 1:
            return warm, np.zeros_like(warm)
        time = np.broadcast_to(np.asarray(channel(state, TIME, self.name), dtype=float), warm.shape)
        follows = lagged(time, warm, self.time_constant, "linear")
        return follows.value, self.coefficient * follows.by_constant


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> ThermalLag:
    side, sensor = direction_and_sensor(machine, where, THERMAL_LAG)
    return ThermalLag(side, sensor, *numbers.values())


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    if TIME not in state:
        return [], []
    return [f"{way} by {sensor}" for way in directions(machine) for sensor in varying_sensors(state)], []


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    def effects(value: float, fixed: Mapping[str, float]) -> tuple[ThermalLag, ...]:
        return (_make(machine, where, {"coefficient": value, **fixed}, ()),)

    constants = drift_time_constants(state[TIME])[::TIME_CONSTANT_STRIDE]
    return Forms(
        (("coefficient", "um/K"),),
        lambda values, fixed: effects(float(values[0]), fixed),
        lambda fixed: effects(1.0, fixed),
        tuple({"time_constant": constant} for constant in constants),
        tests=3.0,
    )


def _constrain(effect: ThermalLag, values: Sequence[float], longest: float) -> ThermalLag:
    return effect.changed(values[0], one_step(effect.time_constant, values[1], longest))


THERMAL_LAG: Final = Specification(
    name="thermal_lag",
    kind="machine",
    title=lambda where: (
        f"growth along {where[:1].lower()} that lags behind the temperature of {where.partition(' by ')[2]}"
    ),
    family="growth that lags behind a temperature",
    advice=Advice(
        "Shop floor and service: heat sources near that sensor, and the heavy parts that they warm slowly.",
        f"Keep the temperature steady, or {EXTENDING} and give the temperature of that sensor over time.",
        "Do not correct it with the present temperature alone: the structure follows later.",
    ),
    evidence=lambda fit: (
        f"{fit.where}: the tool side moves by {fit.measure} and follows the temperature of that sensor with a time constant of "
        f"{fit.numbers['time_constant']:.3g} s"
    ),
    parameters=("coefficient", "time_constant"),
    limits={"um/K": 500.0},
    places=lambda machine: tuple(f"{way} by" for way in directions(machine)),
    open_places=True,
    channels=lambda where: (f"T_{where.partition(' by ')[2]}_degC", TIME),
    expected=lambda machine: "X, Y or Z of the base frame and a sensor, such as Z by bed",
    make=_make,
    forms=_forms,
    candidates=_candidates,
    nonlinear=("time_constant",),
    constrain=_constrain,
    varies="with time",
    variant_of="thermal_growth",
    drawing=Drawing(columns=lambda where: (TIME, f"T_{where.split(' by ')[1]}_degC"), of_base=True),
)
