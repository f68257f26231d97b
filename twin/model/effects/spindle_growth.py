"""Spindle growth: the tool side moves with the spindle speed, with a first-order lag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin._common.records import SPEED, TIME
from twin.machine.machine import Machine
from twin.model.effects.base import HistoryShift, Payload, ToolSide, channel, directions
from twin.model.effects.specification import EXTENDING, Advice, Drawing, Forms, Specification, State, linear_forms
from twin.model.effects.thermal_drift import LONGEST_S, SHORTEST_S, drift_time_constants, one_step
from twin.numerics.functions import lagged

EXPONENTS: Final = (1.0, 1.5, 2.0)
"""Exponents tried: the friction of a greased bearing grows with the speed, churning losses with its square."""
LEAST_EXPONENT: Final = 0.5
LARGEST_EXPONENT: Final = 3.0
TIME_CONSTANT_STRIDE: Final = 3
"""Every n-th of the time constants of a drift is tried."""


@final
class SpindleGrowth(HistoryShift):
    """The tool side moves along a direction of the base frame: A times the first-order lag of (n/n_max)^p with time constant τ.

    The lag is that of `twin.numerics.functions`. In a measured table, the speed of a reading applies from the previous
    reading in time on, that of the first from time zero on. A single speed given for a program applies from time zero on; the speeds of
    its blocks, and of a log before it, each apply for their time. The amplitude is the growth in steady state at n_max.
    """

    units = (("amplitude", "um"), ("exponent", "1"), ("time_constant", "s"))

    starts_settled = False

    def __init__(
        self, side: ToolSide, amplitude: float, exponent: float, time_constant: float, highest_rpm: float
    ) -> None:
        super().__init__(f"spindle_growth:{side.direction}", side)
        self.amplitude = amplitude
        self.exponent = exponent
        self.time_constant = time_constant
        self.highest_rpm = highest_rpm

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters and the speed to which the amplitude refers."""
        return {**super().numbers, "highest_rpm": self.highest_rpm}

    def driven(self, positions: Mapping[str, Any]) -> tuple[Any, ...]:
        """See `HistoryShift.driven`; needs ``spindle_rpm``."""
        return ((channel(positions, SPEED, self.name) / self.highest_rpm) ** self.exponent,)

    def factors(self, state: Mapping[str, Any]) -> Sequence[np.ndarray]:
        """See `HistoryShift.factors`; needs ``spindle_rpm`` and ``time_s``."""
        share = np.asarray(channel(state, SPEED, self.name), dtype=float) / self.highest_rpm
        time = np.asarray(channel(state, TIME, self.name), dtype=float)
        driven = np.asarray(self.driven(state)[0], dtype=float)
        by_exponent = driven * np.log(np.where(share > 0.0, share, 1.0))
        shape = np.broadcast_shapes(share.shape, time.shape)
        at = np.broadcast_to(time, shape).reshape(-1)
        follows = [
            lagged(at, np.broadcast_to(source, shape).reshape(-1), self.time_constant, "held")
            for source in (driven, by_exponent)
        ]
        return (
            follows[0].value.reshape(shape),
            self.amplitude * follows[1].value.reshape(shape),
            self.amplitude * follows[0].by_constant.reshape(shape),
        )


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> SpindleGrowth:
    return SpindleGrowth(SPINDLE_GROWTH.tool_side(machine, where, where), *numbers.values())


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    ways = directions(machine)
    missing = [name for name in (SPEED, TIME) if name not in state]
    if not missing and np.ptp(state[SPEED]) > 0.0:
        return list(ways), []
    what = ", ".join(missing) or f"readings at different {SPEED}"
    return [], [(way, what) for way in ways]


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    highest = float(state[SPEED].max())

    tried = product(EXPONENTS, drift_time_constants(state[TIME])[::TIME_CONSTANT_STRIDE])
    return linear_forms(
        SpindleGrowth.units[:1],
        lambda values, fixed: _make(machine, where, {"amplitude": values[0], **fixed, "highest_rpm": highest}, ()),
        tuple({"exponent": exponent, "time_constant": constant} for exponent, constant in tried),
        tests=3.0,
    )


def _constrain(effect: SpindleGrowth, values: Sequence[float], longest: float) -> SpindleGrowth:
    exponent = min(max(values[1], LEAST_EXPONENT), LARGEST_EXPONENT)
    constant = one_step(effect.time_constant, values[2], longest)
    return SpindleGrowth(effect.side, values[0], exponent, constant, effect.highest_rpm)


SPINDLE_GROWTH: Final = Specification(
    name="spindle_growth",
    kind="machine",
    title=lambda where: Message("growth along {direction} with spindle speed", direction=where.lower()),
    family="growth with spindle speed",
    advice=Advice(
        "Shop floor: spindle speeds during the measurement, and how long each was held. "
        "Service: preload, grease and cooling of the spindle bearings.",
        f"Run the spindle at cutting speed until it has settled, or {EXTENDING} and give speed and time.",
        "Do not touch off the tool at a speed other than cutting speed.",
    ),
    evidence=lambda fit: Message(
        "the tool side moves along {where} by {measure} at the highest speed and follows the speed with a time "
        "constant of {time_constant:.3g} s",
        where=fit.where,
        measure=fit.measure,
        time_constant=fit.numbers["time_constant"],
    ),
    parameters=("amplitude", "exponent", "time_constant", "highest_rpm"),
    fixed={"highest_rpm": "rpm"},
    limits={"um": 500.0, "1": LARGEST_EXPONENT, "s": LONGEST_S},
    least={"1": LEAST_EXPONENT, "s": SHORTEST_S},
    places=directions,
    expected=lambda machine: "X, Y or Z of the base frame",
    channels=lambda where: (SPEED, TIME),
    make=_make,
    forms=_forms,
    candidates=_candidates,
    nonlinear=("exponent", "time_constant"),
    constrain=_constrain,
    varies="with time",
    drawing=Drawing(columns=lambda where: (SPEED, TIME), of_base=True),
)
