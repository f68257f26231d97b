"""Effects that act along an axis's own command: a lost motion, a zero that is off, a pitch, a joint that gives way."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, Final, final

import numpy as np

from twin.machine.effects.base import Effect, Frame, Parameter, channel
from twin.machine.machine import Axis
from twin.numerics.curves import POWER
from twin.numerics.elementary import cos, sin

PLACES: Final = 201
"""Positions at which the extremes of a curve are looked for."""


def along(axis: Axis, value: Any) -> dict[int, Any]:
    """A motion of ``value`` (µm or µrad) along the axis's command, as components of its error frame."""
    start = 0 if axis.linear else 3
    return {start + i: value * part for i, part in enumerate(axis.direction) if part != 0.0}


def unit_of(axis: Axis) -> str:
    """``um`` for a linear axis, ``urad`` for a rotary one."""
    return "um" if axis.linear else "urad"


@final
class Reversal(Effect):
    """Lost motion: where the axis really is depends on the side it came from (ISO 230-1, 3.4.16; ISO 230-2, 2.15).

    Args:
        axis: the axis.
        size: actual position coming from below (+) less that coming from above (−), µm or µrad, along the command.
    """

    def __init__(self, axis: Axis, size: float) -> None:
        self.name = f"reversal:{axis.name}"
        self.axis = axis
        self.size = size

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self.axis.name, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs ``approach_<axis>``."""
        return {i: self.size * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The size."""
        return (Parameter(f"{self.name}.size", unit_of(self.axis), self.size),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)),)


@final
class ReversalCurve(Effect):
    """Lost motion that changes along the travel: the curve measured upwards less the one measured downwards, Σ c_k u^k.

    u = (2q − lo − hi)/(hi − lo) over the axis's range.

    Args:
        axis: the axis; its range is limited.
        coefficients: c_0, c_1, … µm or µrad, along the command.
    """

    def __init__(self, axis: Axis, coefficients: tuple[float, ...]) -> None:
        self.name = f"reversal_curve:{axis.name}"
        self.axis = axis
        self.coefficients = coefficients

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self.axis.name, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs ``approach_<axis>``."""
        side = 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)
        return along(self.axis, side * POWER.value(positions[self.axis.name], self.axis.domain, self.coefficients))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficients."""
        unit = unit_of(self.axis)
        return tuple(Parameter(f"{self.name}.c{k}", unit, value) for k, value in enumerate(self.coefficients))

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        side = 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)
        functions = POWER.functions(positions[self.axis.name], self.axis.domain, len(self.coefficients))
        return tuple(along(self.axis, side * function) for function in functions)

    def lost_motion(self) -> tuple[float, float]:
        """Smallest and largest reversal over the axis's range, µm or µrad."""
        q = np.linspace(*self.axis.domain, PLACES)
        sizes = np.broadcast_to(POWER.value(q, self.axis.domain, self.coefficients), PLACES)
        return float(sizes.min()), float(sizes.max())


@final
class ZeroOffset(Effect):
    """The axis's own zero is off by a constant.

    Args:
        axis: the axis.
        offset: actual less commanded, µm or µrad, along the command.
    """

    def __init__(self, axis: Axis, offset: float) -> None:
        self.name = f"zero_offset:{axis.name}"
        self.axis = axis
        self.offset = offset

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self.axis.name, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {i: self.offset * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset."""
        return (Parameter(f"{self.name}.offset", unit_of(self.axis), self.offset),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, 0.0 * positions[self.axis.name] + 1.0),)


@final
class PitchError(Effect):
    """A periodic error of a linear axis, as of a ball screw or a scale: A·sin(2πq/p + φ), q in mm.

    Args:
        axis: the axis.
        amplitude: A, µm.
        period: p, mm.
        phase: φ, rad.
    """

    def __init__(self, axis: Axis, amplitude: float, period: float, phase: float) -> None:
        self.name = f"pitch_error:{axis.name}"
        self.axis = axis
        self.amplitude = amplitude
        self.period = period
        self.phase = phase

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self.axis.name, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return along(self.axis, self.amplitude * sin(self._angle(positions)))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude, period, phase."""
        return (
            Parameter(f"{self.name}.amplitude", "um", self.amplitude),
            Parameter(f"{self.name}.period", "mm", self.period),
            Parameter(f"{self.name}.phase", "rad", self.phase),
        )

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
