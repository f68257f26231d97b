"""A joint that gives way under the load gravity puts on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

from twin.effects.along import along
from twin.effects.base import Effect, Frame, Parameter
from twin.machine import Axis


@final
class GravityCompliance(Effect):
    """The axis moves by compliance times the force or torque gravity exerts along it.

    Args:
        axis: the axis.
        load: N or N·m along the axis at given positions (`twin.symbolic.gravity_load`).
        compliance: µm/N or µrad/(N·m).
    """

    def __init__(self, axis: Axis, load: Callable[[Mapping[str, Any]], Any], compliance: float) -> None:
        self.name = f"gravity_compliance:{axis.name}"
        self.axis = axis
        self.compliance = compliance
        self._load = load

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self.axis.name, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {i: self.compliance * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The compliance."""
        return (Parameter(f"{self.name}.compliance", "um/N" if self.axis.linear else "urad/(N.m)", self.compliance),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, self._load(positions)),)
