"""Warm-up drift: the tool side moves with time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.model.effects.base import Payload, ToolSide, ToolSideShift, channel, directions
from twin.model.effects.specification import (
    EXTENDING,
    Advice,
    Drawing,
    FittedCause,
    Forms,
    Specification,
    State,
    linear_forms,
)
from twin.numerics.functions import exp

STEADY_PARAMETERS: Final = ("rate",)
"""Parameter of a linear drift, µm/h: its time constant is longer than the record in which it was found."""
TIME_CONSTANTS: Final = 36
"""Number of time constants tried."""
SHORTEST: Final = 1.0 / 40.0
"""Shortest time constant tried, as a fraction of the record."""
LARGEST_DRIFT_UM: Final = 2000.0
"""10 m of cast iron (12 µm/(m·K)) warmed by 17 K; most machine tools drift by less than a tenth of this."""
SHORTEST_S: Final = 1.0
"""Shortest plausible time constant: no part of a machine warms up in less than a second."""
LONGEST_S: Final = 1e6
"""Longest plausible time constant, 12 days: castings take hours, a foundation or a hall days."""
STEP_FACTORS: Final = (0.3, 3.0)
"""Smallest and largest factor by which one step of a fit may change a time constant."""


@final
class ThermalDrift(ToolSideShift):
    """The tool side drifts along a direction of the base frame as the machine warms up: A·(1 − exp(−t/τ))."""

    units = (("amplitude", "um"), ("time_constant", "s"))

    def __init__(self, side: ToolSide, amplitude: float, time_constant: float) -> None:
        super().__init__(f"thermal_drift:{side.direction}", side)
        self.amplitude = amplitude
        self.time_constant = time_constant

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        time = channel(positions, "time_s", self.name)
        decay = exp(-time / self.time_constant)
        by_constant = -self.amplitude * decay * time / self.time_constant**2
        return self._shifted(1.0 - decay), self._shifted(by_constant)


@final
class SteadyDrift(ToolSideShift):
    """The tool side drifts along a direction of the base frame at a constant rate: r·t.

    It is the limit of `ThermalDrift` for t ≪ τ, r = A/τ.
    """

    units = (("rate", "um/h"),)

    def __init__(self, side: ToolSide, rate: float) -> None:
        super().__init__(f"thermal_drift:{side.direction}", side)
        self.rate = rate

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        hours = channel(positions, "time_s", self.name) / 3600.0
        return (self._shifted(hours),)


def drift_time_constants(time_s: np.ndarray) -> tuple[float, ...]:
    """Return the time constants tried, s; none is longer than the record."""
    span = max(float(np.ptp(time_s)), 1.0)
    return tuple(np.geomspace(SHORTEST * span, span, TIME_CONSTANTS).tolist())


def one_step(constant: float, wanted: float, longest: float) -> float:
    """Return a time constant after one step of a fit, s: changed by no more than `STEP_FACTORS`, and no longer than ``longest``."""
    least, most = (share * constant for share in STEP_FACTORS)
    return min(max(wanted, least), most, longest)


def drift_course(fit: FittedCause) -> str:
    """Describe the course of a drift in time, as the end of a sentence."""
    if "time_constant" in fit.numbers:
        return f", slowing down (time constant {fit.numbers['time_constant']:.3g} s)"
    if "rate" in fit.numbers:
        return f", at {fit.numbers['rate']:.3g} µm/h throughout (its time constant is longer than the record)"
    return ", at a constant rate"


def _make(
    machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]
) -> ThermalDrift | SteadyDrift:
    side, values = THERMAL_DRIFT.tool_side(machine, where, where), numbers.values()
    return SteadyDrift(side, *values) if set(numbers) == set(STEADY_PARAMETERS) else ThermalDrift(side, *values)


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    side = THERMAL_DRIFT.tool_side(machine, where, where)
    return linear_forms(
        ThermalDrift.units[:1],
        lambda values, fixed: ThermalDrift(side, *values, **fixed) if fixed else SteadyDrift(side, *values),
        ({}, *({"time_constant": constant} for constant in drift_time_constants(state["time_s"]))),
        tests=3.0,
        is_drift=True,
    )


def _constrain(effect: ThermalDrift, values: Sequence[float], longest: float) -> ThermalDrift:
    return ThermalDrift(effect.side, values[0], one_step(effect.time_constant, values[1], longest))


THERMAL_DRIFT: Final = Specification(
    name="thermal_drift",
    kind="machine",
    title=lambda where: Message("warm-up drift along {direction}", direction=where.lower()),
    family="warm-up drift",
    advice=Advice(
        "Shop floor: how long the machine had run before work and before the measurement. Service: spindle cooling.",
        f"Warm the machine up before precise work, or {EXTENDING} and give the time since start-up.",
        "Do not set zero points in the first hours: they would be wrong once the machine is warm.",
    ),
    evidence=lambda fit: f"the tool side drifts along {fit.where} as the machine warms up{drift_course(fit)}",
    parameters=("amplitude", "time_constant"),
    required=lambda names: (
        STEADY_PARAMETERS if set(names) == set(STEADY_PARAMETERS) else ("amplitude", "time_constant")
    ),
    limits={"um": LARGEST_DRIFT_UM, "um/h": LARGEST_DRIFT_UM, "s": LONGEST_S},
    least={"s": SHORTEST_S},
    places=directions,
    expected=lambda machine: "X, Y or Z of the base frame",
    channels=lambda where: ("time_s",),
    make=_make,
    forms=_forms,
    nonlinear=("time_constant",),
    constrain=_constrain,
    varies="with time",
    drawing=Drawing(columns=lambda where: ("time_s",), of_base=True),
)
