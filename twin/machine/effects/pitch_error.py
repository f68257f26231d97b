"""A periodic error of a linear axis, as of a ball screw or a scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any, Final, final

import numpy as np

from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Frame, Parameter, along
from twin.machine.effects.payload import Payload
from twin.machine.effects.specification import (
    EXTENDED,
    NOT_TWICE,
    Advice,
    Drawing,
    Forms,
    Specification,
    State,
    Together,
)
from twin.machine.machine import Axis, Machine
from twin.numerics.elementary import cos, sin
from twin.numerics.functions import once
from twin.numerics.waves import highest_frequency, waves

LONGEST_PERIOD: Final = 0.5
"""Share of the travel measured beyond which a wave is no pitch error: fewer than two periods are a curve, whatever its cause."""
SHORTER: Final = 0.3
"""Share of a period by which one step of a fit may shorten it."""


@final
class PitchError(AlongAxis):
    """A periodic error of a linear axis: E_aa += A·sin(2πq/p + φ), q in mm.

    Args:
        axis: the axis.
        amplitude: A, µm.
        period: p, mm.
        phase: φ, rad.
    """

    def __init__(self, axis: Axis, amplitude: float, period: float, phase: float) -> None:
        super().__init__("pitch_error", axis)
        self.amplitude = amplitude
        self.period = period
        self.phase = phase

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude, period, phase."""
        return (
            self._number("amplitude", "um", self.amplitude),
            self._number("period", "mm", self.period),
            self._number("phase", "rad", self.phase),
        )

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

    def _angle(self, positions: Mapping[str, Any]) -> Any:
        return (2.0 * pi / self.period) * positions[self.axis.name] + self.phase


def _frequencies(q: np.ndarray) -> np.ndarray:
    """Of the periods that are tried, a mm: half the resolution of the span a step; the best is refined afterwards."""
    span = max(float(np.ptp(q)), 1e-9)
    lowest = 1.0 / (LONGEST_PERIOD * span)
    # Of an axis that did not move one is enough to say so.
    highest = highest_frequency(q, span) if np.ptp(q) > 0.0 else lowest
    return np.arange(lowest, highest + 1e-9 / span, 0.5 / span)


def _tried(state: State, where: str) -> np.ndarray:
    return once(state, ("frequencies", where), lambda: _frequencies(state[where]))


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    told = {where: len(_tried(state, where)) > 0 for where in places.linear(machine)}
    missing = [(where, f"positions of {where} closer together") for where, some in told.items() if not some]
    return [where for where, some in told.items() if some], missing


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    axis, q = machine.by_name[where], state[where]
    span = max(float(np.ptp(q)), 1e-9)
    frequencies = _tried(state, where)
    count = len(frequencies)
    # As `PitchError` has it, for all periods at once.
    functions = waves(q, 2.0 * np.pi / (LONGEST_PERIOD * span), np.pi / span, count)

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[PitchError, ...]:
        return (PitchError(axis, float(np.hypot(*values)), fixed["period"], float(np.arctan2(values[1], values[0]))),)

    def units(fixed: Mapping[str, float]) -> tuple[PitchError, ...]:
        return tuple(PitchError(axis, 1.0, fixed["period"], phase) for phase in (0.0, np.pi / 2.0))

    return Forms(
        (("sin", "um"), ("cos", "um")),
        build,
        units,
        tuple({"period": float(1.0 / f)} for f in frequencies),
        together=Together(
            functions,
            [(k, count + k) for k in range(count)],
            Frame(where, "motion"),
            tuple(along(axis, 1.0).items()),
        ),
    )


def _kept(effect: PitchError, values: Sequence[float], longest: float) -> PitchError:
    """A positive amplitude, a period not far from the one before, a phase within half a turn."""
    amplitude, period, phase = values
    if amplitude < 0.0:
        amplitude, phase = -amplitude, phase + np.pi
    period = min(max(period, SHORTER * effect.period), longest)
    return PitchError(effect.axis, amplitude, period, float(np.mod(phase + np.pi, 2.0 * np.pi) - np.pi))


PITCH_ERROR: Final = Specification(
    name="pitch_error",
    kind="machine",
    title=lambda where: f"periodic positioning error of {where}",
    family="periodic positioning errors",
    advice=Advice(
        "Service: what of {axis} has this period: screw (its lead), coupling, gear, or the grating of the scale.",
        f"{EXTENDED}.",
        "Do not check it in steps of its period or a multiple: it would not show. " + NOT_TWICE,
    ),
    evidence=lambda of: f"{of.where} errs periodically along its travel",
    parameters=("amplitude", "period", "phase"),
    largest={"um": 500.0},
    places=places.linear,
    make=lambda machine, where, numbers, payloads: PitchError(machine.by_name[where], *numbers.values()),
    forms=_forms,
    candidates=_candidates,
    bent=("period", "phase"),
    kept=_kept,
    curve=True,
    plain_forms=0,
    drawn=Drawing(period=lambda numbers: numbers["period"]),
)
