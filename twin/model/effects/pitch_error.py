"""Periodic positioning error of a linear axis, for example of a ball screw or a scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import AlongAxis, Frame, Payload, along
from twin.model.effects.specification import (
    EXTENDED,
    NOT_TWICE,
    Advice,
    Drawing,
    Forms,
    SharedColumns,
    Specification,
    State,
    linear_axes,
    linear_forms,
)
from twin.numerics.functions import SHORTEST_PERIOD, cached_in_state, cos, highest_frequency, sin, waves

LONGEST_PERIOD: Final = 0.5
"""Longest period tried, as a fraction of the measured travel: fewer than two periods cannot be distinguished from a smooth curve."""
MIN_PERIOD_RATIO: Final = 0.3
"""Smallest fraction to which one step of a fit may shorten a period."""


@final
class PitchError(AlongAxis):
    """Periodic positioning error of a linear axis: E_aa += A·sin(2πq/p + φ), q in mm."""

    units = (("amplitude", "um"), ("period", "mm"), ("phase", "rad"))

    repeats = True

    def __init__(self, axis: Axis, amplitude: float, period: float, phase: float) -> None:
        super().__init__("pitch_error", axis)
        self.amplitude = amplitude
        self.period = period
        self.phase = phase

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return along(self.axis, self.amplitude * sin(self._angle(positions)))

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        angle = self._angle(positions)
        slope = self.amplitude * cos(angle)
        q = positions[self.axis.name]
        return (
            along(self.axis, sin(angle)),
            along(self.axis, slope * (-2.0 * pi / self.period**2) * q),
            along(self.axis, slope),
        )

    @property
    def normal_form(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """See `Effect.normal_form`: −A sin φ = A sin(φ + π)."""
        return ((-1.0, 1.0, 1.0), (0.0, 0.0, pi)) if self.amplitude < 0.0 else super().normal_form

    def _angle(self, positions: Mapping[str, Any]) -> Any:
        return (2.0 * pi / self.period) * positions[self.axis.name] + self.phase


def _frequencies(q: np.ndarray) -> np.ndarray:
    """Return the frequencies tried, 1/mm, in steps of half the resolution of the measured span; the best one is refined later."""
    span = max(float(np.ptp(q)), 1e-9)
    lowest = 1.0 / (LONGEST_PERIOD * span)
    # For an axis that did not move, one frequency is enough to report it.
    highest = highest_frequency(q, span) if np.ptp(q) > 0.0 else lowest
    return np.arange(lowest, highest + 1e-9 / span, 0.5 / span)


def _tried(state: State, where: str) -> np.ndarray:
    return cached_in_state(state, ("frequencies", where), lambda: _frequencies(state[where]))


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    resolved = {where: len(_tried(state, where)) > 0 for where in linear_axes(machine)}
    missing = [(where, f"positions of {where} closer together") for where, usable in resolved.items() if not usable]
    return [where for where, usable in resolved.items() if usable], missing


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    axis, q = machine.by_name[where], state[where]
    span = max(float(np.ptp(q)), 1e-9)
    frequencies = _tried(state, where)
    count = len(frequencies)
    # The functions of `PitchError` for all periods at once.
    functions = waves(q, 2.0 * np.pi / (LONGEST_PERIOD * span), np.pi / span, count)

    return linear_forms(
        (("sin", "um"), ("cos", "um")),
        lambda values, fixed: PitchError(
            axis, float(np.hypot(values[0], values[1])), fixed["period"], float(np.arctan2(values[1], values[0]))
        ),
        tuple({"period": float(1.0 / f)} for f in frequencies),
        together=SharedColumns(
            functions, [(k, count + k) for k in range(count)], Frame(where, "motion"), tuple(along(axis, 1.0).items())
        ),
    )


def _constrain(effect: PitchError, values: Sequence[float], longest: float) -> PitchError:
    """Return the effect with a positive amplitude, a period close to the previous one and a phase within ±π."""
    amplitude, period, phase = values
    if amplitude < 0.0:
        amplitude, phase = -amplitude, phase + np.pi
    period = min(max(period, MIN_PERIOD_RATIO * effect.period), longest)
    return PitchError(effect.axis, amplitude, period, float(np.mod(phase + np.pi, 2.0 * np.pi) - np.pi))


PITCH_ERROR: Final = Specification(
    name="pitch_error",
    kind="machine",
    title=lambda where: Message("periodic positioning error of {where}", where=where),
    family="periodic positioning errors",
    advice=Advice(
        "Service: the part of {axis} that has this period: screw (its lead), coupling, gear, or grating of the scale.",
        f"{EXTENDED}.",
        "Do not check {axis} in steps of this period or a multiple of it: the error would not show. " + NOT_TWICE,
    ),
    evidence=lambda fit: Message("{where} has a periodic positioning error along its travel", where=fit.where),
    parameters=("amplitude", "period", "phase"),
    # 10 m is half the travel of the longest gantry. A fit below half the shortest period sought has left the period that was found.
    limits={"um": 500.0, "mm": 10_000.0, "rad": pi},
    least={"mm": 0.5 * SHORTEST_PERIOD},
    places=linear_axes,
    make=lambda machine, where, numbers, payloads: PitchError(machine.by_name[where], *numbers.values()),
    forms=_forms,
    candidates=_candidates,
    nonlinear=("period", "phase"),
    period="period",
    constrain=_constrain,
    curve=True,
    most=2,
    plain_forms=0,
    drawing=Drawing(period=lambda numbers: numbers["period"]),
)
