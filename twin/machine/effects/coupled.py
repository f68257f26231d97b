"""Errors of one axis that another position decides: a neighbour's travel, the weight of a cradle, a harmonic of its own angle."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, final

from twin.machine.effects.base import Effect, Frame, Parameter, split_name
from twin.numerics.elementary import cos, sin


@final
class CrossAxis(Effect):
    """An error motion that grows with another linear axis: e = c·q_axis·q_by (translation), e = c·q_by (rotation), q in m.

    Args:
        name: the error motion, ``E_ZY``.
        by: the other axis.
        coefficient: c, µm/m² for a translation, µrad/m for a rotation.
    """

    def __init__(self, name: str, by: str, coefficient: float) -> None:
        self.name = f"cross_axis:{name} by {by}"
        self.by = by
        self.coefficient = coefficient
        self._component, _, self._axis = split_name(name)

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self._axis, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {i: self.coefficient * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficient."""
        unit = "um/m2" if self._component < 3 else "urad/m"
        return (Parameter(f"{self.name}.coefficient", unit, self.coefficient),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        other = 1e-3 * positions[self.by]
        return ({self._component: other * 1e-3 * positions[self._axis] if self._component < 3 else other},)


@final
class TableLoad(Effect):
    """A tilted cradle droops about the base's x as it turns: a rotation of tilt·sin of its angle (contract §5).

    Args:
        axis: name of the rotary axis.
        vector: the base's x in its error frame.
        tilt: µrad.
    """

    def __init__(self, axis: str, vector: tuple[float, float, float], tilt: float) -> None:
        self.name = f"table_load:{axis}"
        self.tilt = tilt
        self._axis = axis
        self._vector = vector

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self._axis, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {i: self.tilt * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The tilt."""
        return (Parameter(f"{self.name}.tilt", "urad", self.tilt),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        wave = sin(positions[self._axis] * (pi / 180.0))
        return ({3 + i: part * wave for i, part in enumerate(self._vector) if part != 0.0},)


@final
class Harmonic(Effect):
    """One harmonic of an error motion of a rotary axis: a·cos(nθ) + b·sin(nθ).

    Args:
        name: the error motion, ``E_XB``.
        order: n.
        cosine: a, µm or µrad.
        sine: b, µm or µrad.
    """

    def __init__(self, name: str, order: int, cosine: float, sine: float) -> None:
        self.name = f"harmonic:{name}[{order}]"
        self.order = order
        self.cosine = cosine
        self.sine = sine
        self._component, _, self._axis = split_name(name)

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self._axis, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        angle = positions[self._axis] * (self.order * pi / 180.0)
        return {self._component: self.cosine * cos(angle) + self.sine * sin(angle)}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Cosine and sine part."""
        unit = "um" if self._component < 3 else "urad"
        return (Parameter(f"{self.name}.cos", unit, self.cosine), Parameter(f"{self.name}.sin", unit, self.sine))

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        angle = positions[self._axis] * (self.order * pi / 180.0)
        return ({self._component: cos(angle)}, {self._component: sin(angle)})
