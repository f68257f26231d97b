"""Growth of an axis's scale with time, as of a ball screw that warms up, where no temperature was read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import AlongAxis, Payload, along, channel
from twin.model.effects.specification import (
    EXTENDING,
    Advice,
    Drawing,
    FittedCause,
    Forms,
    Specification,
    State,
    linear_axes,
    linear_forms,
)
from twin.model.effects.thermal_drift import LARGEST_DRIFT_UM, LONGEST_S, SHORTEST_S, drift_time_constants, one_step
from twin.numerics.functions import exp

STEADY_PARAMETERS: Final = ("rate", "offset_rate")
"""Parameters of a growth at a constant rate, µm/(m·h) and µm/h: its time constant is longer than the record in which it was found."""
PARAMETERS: Final = ("amplitude", "offset", "time_constant")
FEWEST_POSITIONS: Final = 12
"""Fewest positions: at fewer, those that were left out do not show whether the scale or the whole set-up drifts."""
REVISITED: Final = 0.75
"""Share of an axis's measured span that each half of the record must cover: a single run looks like a curve of the axis."""


@final
class ScaleDrift(AlongAxis):
    """The scale of a linear axis grows as it warms up: E_aa += (A·q + g)·(1 − exp(−t/τ)), fixed at q = −g/A."""

    units = (("amplitude", "um/m"), ("offset", "um"), ("time_constant", "s"))

    def __init__(self, axis: Axis, amplitude: float, offset: float, time_constant: float) -> None:
        super().__init__("scale_drift", axis)
        self.amplitude = amplitude
        self.offset = offset
        self.time_constant = time_constant

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        warm = 1.0 - exp(-channel(positions, "time_s", self.name) / self.time_constant)
        return along(self.axis, self._size(positions) * warm)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        time = channel(positions, "time_s", self.name)
        decay = exp(-time / self.time_constant)
        by_constant = -self._size(positions) * decay * time / self.time_constant**2
        return (
            along(self.axis, 1e-3 * positions[self.axis.name] * (1.0 - decay)),
            along(self.axis, 1.0 - decay),
            along(self.axis, by_constant),
        )

    def _size(self, positions: Mapping[str, Any]) -> Any:
        return 1e-3 * self.amplitude * positions[self.axis.name] + self.offset


@final
class SteadyScaleDrift(AlongAxis):
    """The scale of a linear axis grows at a constant rate: E_aa += (r·q + s)·t, the limit of `ScaleDrift` for t ≪ τ."""

    units = (("rate", "um/(m.h)"), ("offset_rate", "um/h"))
    linear = 2

    def __init__(self, axis: Axis, rate: float, offset_rate: float) -> None:
        super().__init__("scale_drift", axis)
        self.rate = rate
        self.offset_rate = offset_rate

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        hours = channel(positions, "time_s", self.name) / 3600.0
        return along(self.axis, 1e-3 * positions[self.axis.name] * hours), along(self.axis, hours)


def _make(
    machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]
) -> ScaleDrift | SteadyScaleDrift:
    axis, values = machine.by_name[where], numbers.values()
    return SteadyScaleDrift(axis, *values) if set(numbers) == set(STEADY_PARAMETERS) else ScaleDrift(axis, *values)


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    if "time_s" not in state:
        return [], [(where, "time_s") for where in linear_axes(machine)]
    time = state["time_s"]
    halves = [half for half in (time <= np.median(time), time > np.median(time)) if np.any(half)]

    def missing(where: str) -> str:
        q = state[where]
        if not (len(halves) > 1 and all(np.ptp(q[half]) >= REVISITED * np.ptp(q) > 0.0 for half in halves)):
            return f"{where} measured again later"
        return (
            f"{where} measured at {FEWEST_POSITIONS} positions"
            if len(np.unique(np.round(q, 3))) < FEWEST_POSITIONS
            else ""
        )

    reasons = {where: missing(where) for where in linear_axes(machine)}
    return [where for where, why in reasons.items() if not why], [(where, why) for where, why in reasons.items() if why]


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    axis = machine.by_name[where]
    return linear_forms(
        ScaleDrift.units[:2],
        lambda values, fixed: ScaleDrift(axis, *values, **fixed) if fixed else SteadyScaleDrift(axis, *values),
        ({}, *({"time_constant": constant} for constant in drift_time_constants(state["time_s"]))),
        tests=3.0,
        is_drift=True,
    )


def _constrain(effect: ScaleDrift, values: Sequence[float], longest: float) -> ScaleDrift:
    amplitude, offset, constant = values
    return ScaleDrift(effect.axis, amplitude, offset, one_step(effect.time_constant, constant, longest))


def _evidence(fit: FittedCause) -> str:
    amplitude, offset = fit.numbers.get("amplitude", 0.0), fit.numbers.get("offset", 0.0)
    at = f", fixed at {-1e3 * offset / amplitude:.0f} mm" if amplitude else ""
    if "time_constant" in fit.numbers:
        course = f", slowing down (time constant {fit.numbers['time_constant']:.3g} s)"
    else:
        course = ", at a constant rate (its time constant is longer than the record)"
    return f"the scale of {fit.where} lengthens by {amplitude:.3g} µm/m during the measurement{at}{course}"


SCALE_DRIFT: Final = Specification(
    name="scale_drift",
    kind="machine",
    title=lambda where: Message("growth of the scale of {where} with time", where=where),
    family="growth of scales with time",
    advice=Advice(
        "Service: the ball screw of {axis} (preload, cooling, where it is fixed), and whether a linear scale or the motor's encoder "
        "gives its position.",
        f"Move {{axis}} over its travel until it is warm before precise work, or {EXTENDING} and give the time since start-up.",
        "Do not correct the scale of {axis} while it is cold: it would be wrong once it is warm.",
    ),
    evidence=_evidence,
    parameters=PARAMETERS,
    required=lambda names: STEADY_PARAMETERS if set(names) == set(STEADY_PARAMETERS) else PARAMETERS,
    # A screw (12 µm/(m·K)) that warms by 80 K; its offset is that of a drift.
    limits={"um/m": 1000.0, "um/(m.h)": 1000.0, "um": LARGEST_DRIFT_UM, "um/h": LARGEST_DRIFT_UM, "s": LONGEST_S},
    least={"s": SHORTEST_S},
    places=linear_axes,
    channels=lambda where: ("time_s",),
    make=_make,
    forms=_forms,
    candidates=_candidates,
    nonlinear=("time_constant",),
    constrain=_constrain,
    varies="with time",
    drawing=Drawing(columns=lambda where: ("time_s",), split=lambda where: where, spread=True),
)
