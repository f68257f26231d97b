"""Warm-up drift: the tool side moves, or the scale of an axis grows, with time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import AlongAxis, Payload, ToolSide, ToolSideShift, along, along_scale, channel, directions
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
        return Message(
            ", slowing down (time constant {time_constant:.3g} s)", time_constant=fit.numbers["time_constant"]
        )
    if "rate" in fit.numbers:
        return Message(
            ", at {rate:.3g} µm/h throughout (its time constant is longer than the record)", rate=fit.numbers["rate"]
        )
    return Message(", at a constant rate")


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
    evidence=lambda fit: Message(
        "the tool side drifts along {where} as the machine warms up{course}", where=fit.where, course=drift_course(fit)
    ),
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


# --- Growth of an axis's scale with time, as of a ball screw that warms up, where no temperature was read

STEADY_SCALE: Final = ("rate", "offset_rate")
"""Parameters of a growth at a constant rate, µm/(m·h) and µm/h: its time constant is longer than the record in which it was found."""
SCALE_PARAMETERS: Final = ("amplitude", "offset", "time_constant")
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
        return *along_scale(self.axis, positions, 1.0 - decay), along(self.axis, by_constant)

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
        return along_scale(self.axis, positions, channel(positions, "time_s", self.name) / 3600.0)


def _make_scale_drift(
    machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]
) -> ScaleDrift | SteadyScaleDrift:
    axis, values = machine.by_name[where], numbers.values()
    return SteadyScaleDrift(axis, *values) if set(numbers) == set(STEADY_SCALE) else ScaleDrift(axis, *values)


def _scale_candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
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


def _scale_forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    axis = machine.by_name[where]
    return linear_forms(
        ScaleDrift.units[:2],
        lambda values, fixed: ScaleDrift(axis, *values, **fixed) if fixed else SteadyScaleDrift(axis, *values),
        ({}, *({"time_constant": constant} for constant in drift_time_constants(state["time_s"]))),
        tests=3.0,
        is_drift=True,
    )


def _constrain_scale(effect: ScaleDrift, values: Sequence[float], longest: float) -> ScaleDrift:
    amplitude, offset, constant = values
    return ScaleDrift(effect.axis, amplitude, offset, one_step(effect.time_constant, constant, longest))


def _scale_evidence(fit: FittedCause) -> str:
    amplitude, offset = fit.numbers.get("amplitude", 0.0), fit.numbers.get("offset", 0.0)
    at = Message(", fixed at {at:.0f} mm", at=-1000.0 * offset / amplitude) if amplitude else ""
    if "time_constant" in fit.numbers:
        course = Message(
            ", slowing down (time constant {time_constant:.3g} s)", time_constant=fit.numbers["time_constant"]
        )
    else:
        course = Message(", at a constant rate (its time constant is longer than the record)")
    return Message(
        "the scale of {where} lengthens by {amplitude:.3g} µm/m during the measurement{at}{course}",
        where=fit.where,
        amplitude=amplitude,
        at=at,
        course=course,
    )


SCALE_DRIFT: Final = Specification(
    name="scale_drift",
    kind="machine",
    title=lambda where: Message("growth of the scale of {where} with time", where=where),
    family="growth of scales with time",
    advice=Advice(
        "Service: the ball screw of {axis} (preload, cooling, where it is fixed), and whether a linear scale or the "
        "motor's encoder "
        "gives its position.",
        f"Move {{axis}} over its travel until it is warm before precise work, or {EXTENDING} and give the time since start-up.",
        "Do not correct the scale of {axis} while it is cold: it would be wrong once it is warm.",
    ),
    evidence=_scale_evidence,
    parameters=SCALE_PARAMETERS,
    required=lambda names: STEADY_SCALE if set(names) == set(STEADY_SCALE) else SCALE_PARAMETERS,
    # A screw (12 µm/(m·K)) that warms by 80 K; its offset is that of a drift.
    limits={"um/m": 1000.0, "um/(m.h)": 1000.0, "um": LARGEST_DRIFT_UM, "um/h": LARGEST_DRIFT_UM, "s": LONGEST_S},
    least={"s": SHORTEST_S},
    places=linear_axes,
    channels=lambda where: ("time_s",),
    make=_make_scale_drift,
    forms=_scale_forms,
    candidates=_scale_candidates,
    nonlinear=("time_constant",),
    constrain=_constrain_scale,
    varies="with time",
    drawing=Drawing(columns=lambda where: ("time_s",), split=lambda where: where, spread=True),
)
