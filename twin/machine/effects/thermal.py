"""Temperature and time: scales that lengthen, structures that grow, a warm-up that creeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects.along import along
from twin.machine.effects.base import Effect, Frame, Parameter, channel
from twin.machine.machine import Axis
from twin.numerics.elementary import exp

REFERENCE_DEGC: Final = 20.0
"""ISO 1."""


@final
class ThermalExpansion(Effect):
    """The scale of a linear axis lengthens: E_aa += c·(T_a − 20 °C)·q.

    Args:
        axis: the axis.
        coefficient: c, µm/(m·K).
    """

    def __init__(self, axis: Axis, coefficient: float) -> None:
        self.name = f"thermal_expansion:{axis.name}"
        self.axis = axis
        self.coefficient = coefficient

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self.axis.name, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs ``T_<axis>_degC``."""
        return {i: self.coefficient * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient."""
        return (Parameter(f"{self.name}.coefficient", "um/(m.K)", self.coefficient),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        warm = channel(positions, f"T_{self.axis.name}_degC", self.name) - REFERENCE_DEGC
        return (along(self.axis, 1e-3 * positions[self.axis.name] * warm),)


class _Shift(Effect):
    """The tool side moves along a direction of the base, in proportion to the first parameter.

    Args:
        name: of the effect.
        frame: the frame nearest the base on the tool side.
        vector: the direction in that frame.
    """

    def __init__(self, name: str, frame: Frame, vector: tuple[float, float, float]) -> None:
        self.name = name
        self._frame = frame
        self._vector = vector

    @property
    def frame(self) -> Frame:
        """The frame nearest the base."""
        return self._frame

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        size = self.parameters[0].value
        return {i: size * shape for i, shape in self.derivatives(positions)[0].items()}

    def _shifted(self, shape: Any) -> dict[int, Any]:
        """A shift of ``shape`` along the direction, by component."""
        return {i: part * shape for i, part in enumerate(self._vector) if part != 0.0}


@final
class ThermalGrowth(_Shift):
    """The tool side moves along a direction of the base with a sensor: c·(T − 20 °C).

    Args:
        frame: the frame nearest the base on the tool side.
        direction: ``X``, ``Y`` or ``Z`` of the base.
        vector: that direction in the frame.
        sensor: of column ``T_<sensor>_degC``.
        coefficient: c, µm/K.
    """

    def __init__(
        self, frame: Frame, direction: str, vector: tuple[float, float, float], sensor: str, coefficient: float
    ) -> None:
        super().__init__(f"thermal_growth:{direction} by {sensor}", frame, vector)
        self.direction = direction
        self.sensor = sensor
        self.coefficient = coefficient

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient."""
        return (Parameter(f"{self.name}.coefficient", "um/K", self.coefficient),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``T_<sensor>_degC``."""
        warm = channel(positions, f"T_{self.sensor}_degC", self.name) - REFERENCE_DEGC
        return (self._shifted(warm),)


@final
class ThermalDrift(_Shift):
    """The tool side creeps along a direction of the base as the machine warms up: A·(1 − exp(−t/τ)).

    Args:
        frame: the frame nearest the base on the tool side.
        direction: ``X``, ``Y`` or ``Z`` of the base.
        vector: that direction in the frame.
        amplitude: A, µm.
        time_constant: τ, s.
    """

    def __init__(
        self, frame: Frame, direction: str, vector: tuple[float, float, float], amplitude: float, time_constant: float
    ) -> None:
        super().__init__(f"thermal_drift:{direction}", frame, vector)
        self.direction = direction
        self.amplitude = amplitude
        self.time_constant = time_constant

    def changed(self, amplitude: float, time_constant: float) -> ThermalDrift:
        """The same with other numbers."""
        return ThermalDrift(self._frame, self.direction, self._vector, amplitude, time_constant)

    def steady(self, rate: float) -> SteadyDrift:
        """The limit of a time constant far beyond the record.

        Args:
            rate: µm/h.
        """
        return SteadyDrift(self._frame, self.direction, self._vector, rate)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude and time constant."""
        return (
            Parameter(f"{self.name}.amplitude", "um", self.amplitude),
            Parameter(f"{self.name}.time_constant", "s", self.time_constant),
        )

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        time = channel(positions, "time_s", self.name)
        left = exp(-time / self.time_constant)
        by_constant = -self.amplitude * left * time / self.time_constant**2
        return self._shifted(1.0 - left), self._shifted(by_constant)


@final
class SteadyDrift(_Shift):
    """The tool side creeps along a direction of the base in a straight line: r·t, the limit A/τ of `ThermalDrift` for t ≪ τ.

    Args:
        frame: the frame nearest the base on the tool side.
        direction: ``X``, ``Y`` or ``Z`` of the base.
        vector: that direction in the frame.
        rate: r, µm/h.
    """

    def __init__(self, frame: Frame, direction: str, vector: tuple[float, float, float], rate: float) -> None:
        super().__init__(f"thermal_drift:{direction}", frame, vector)
        self.rate = rate

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The rate."""
        return (Parameter(f"{self.name}.rate", "um/h", self.rate),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``time_s``."""
        hours = channel(positions, "time_s", self.name) / 3600.0
        return (self._shifted(hours),)
