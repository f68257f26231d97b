"""A warm-up that creeps: the tool side moves with time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin.machine.effects.base import Parameter, channel
from twin.machine.effects.payload import Payload
from twin.machine.effects.specification import EXTENDING, Advice, Drawing, Forms, Found, Specification, State
from twin.machine.effects.tool_side import ToolSide, ToolSideShift, directions, tool_side
from twin.machine.machine import Machine
from twin.numerics.elementary import exp

STEADY: Final = ("rate",)
"""Parameters of a drift in a straight line, µm/h: its time constant is longer than the record it was found in."""
TIME_CONSTANTS: Final = 36
"""Time constants that are tried."""
SHORTEST: Final = 1.0 / 40.0
"""Smallest of them, as a share of the record."""
REACH: Final = (0.3, 3.0)
"""Shares of a time constant within which one step of a fit may change it."""


@final
class ThermalDrift(ToolSideShift):
    """The tool side creeps along a direction of the base as the machine warms up: A·(1 − exp(−t/τ)).

    Args:
        side: which way.
        amplitude: A, µm.
        time_constant: τ, s.
    """

    def __init__(self, side: ToolSide, amplitude: float, time_constant: float) -> None:
        super().__init__(f"thermal_drift:{side.direction}", side)
        self.amplitude = amplitude
        self.time_constant = time_constant

    def changed(self, amplitude: float, time_constant: float) -> ThermalDrift:
        """The same with other numbers."""
        return ThermalDrift(self._side, amplitude, time_constant)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude and time constant."""
        return (
            self._number("amplitude", "um", self.amplitude),
            self._number("time_constant", "s", self.time_constant),
        )

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        time = channel(positions, "time_s", self.name)
        left = exp(-time / self.time_constant)
        by_constant = -self.amplitude * left * time / self.time_constant**2
        return self._shifted(1.0 - left), self._shifted(by_constant)


@final
class SteadyDrift(ToolSideShift):
    """The tool side creeps along a direction of the base in a straight line: r·t, the limit A/τ of `ThermalDrift` for t ≪ τ.

    Args:
        side: which way.
        rate: r, µm/h.
    """

    def __init__(self, side: ToolSide, rate: float) -> None:
        super().__init__(f"thermal_drift:{side.direction}", side)
        self.rate = rate

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The rate."""
        return (self._number("rate", "um/h", self.rate),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        hours = channel(positions, "time_s", self.name) / 3600.0
        return (self._shifted(hours),)


def constants(time_s: np.ndarray) -> tuple[float, ...]:
    """Time constants that are tried: none longer than the record."""
    span = max(float(np.ptp(time_s)), 1.0)
    return tuple(np.geomspace(SHORTEST * span, span, TIME_CONSTANTS).tolist())


def course(of: Found) -> str:
    """How a drift runs in time."""
    if "time_constant" in of.numbers:
        return f", and slows down (time constant {of.numbers['time_constant']:.3g} s)"
    if "rate" in of.numbers:
        return f", at {of.numbers['rate']:.3g} µm/h throughout: its time constant is longer than the record"
    return ", at the same rate throughout"


def _side(machine: Machine, where: str) -> ToolSide:
    side = tool_side(machine, where)
    if side is None:
        raise THERMAL_DRIFT.no_place(machine, where)
    return side


def _made(
    machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]
) -> ThermalDrift | SteadyDrift:
    side, values = _side(machine, where), numbers.values()
    return SteadyDrift(side, *values) if set(numbers) == set(STEADY) else ThermalDrift(side, *values)


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    side = _side(machine, where)

    def of(value: float, fixed: Mapping[str, float]) -> tuple[ThermalDrift | SteadyDrift, ...]:
        if "time_constant" in fixed:
            return (ThermalDrift(side, value, fixed["time_constant"]),)
        return (SteadyDrift(side, value),)

    return Forms(
        (("amplitude", "um"),),
        lambda values, fixed: of(float(values[0]), fixed),
        lambda fixed: of(1.0, fixed),
        ({}, *({"time_constant": constant} for constant in constants(state["time_s"]))),
        tests=3.0,
        drifts=True,
    )


def _kept(effect: ThermalDrift, values: Sequence[float], longest: float) -> ThermalDrift:
    least, most = (share * effect.time_constant for share in REACH)
    return effect.changed(values[0], min(max(values[1], least), most, longest))


THERMAL_DRIFT: Final = Specification(
    name="thermal_drift",
    kind="machine",
    title=lambda where: f"warm-up drift along {where.lower()}",
    family="warm-up drift",
    advice=Advice(
        "Shop: how long the machine ran before work and before it was measured. Service: spindle cooling.",
        f"Warm the machine up before precise work, or {EXTENDING} and say the time (--time).",
        "Do not set zero in the first hours: it will be wrong when the machine is warm.",
    ),
    evidence=lambda of: f"the tool side creeps along {of.where} as the machine warms up{course(of)}",
    parameters=("amplitude", "time_constant"),
    wanted=lambda names: STEADY if set(names) == set(STEADY) else ("amplitude", "time_constant"),
    places=directions,
    expected=lambda machine: "X, Y or Z of the base",
    channels=lambda where: ("time_s",),
    make=_made,
    forms=_forms,
    bent=("time_constant",),
    kept=_kept,
    varies="with time",
    drawn=Drawing(columns=lambda where: ("time_s",), of_base=True),
)
