"""Location: where a rotary axis's average line really lies (ISO 230-1, 3.5; contract §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

from twin.machine.effects.base import Effect, Frame, Parameter, split_name


@final
class AxisLocation(Effect):
    """``E_X0C``, ``E_Y0C`` (µm), ``E_A0C``, ``E_B0C`` (µrad): constant, in the frame before the axis's error motions.

    Args:
        name: ISO 230-1 name.
        offset: µm or µrad.
    """

    def __init__(self, name: str, offset: float) -> None:
        self.name = name
        self.offset = offset
        self._component, _, self._axis = split_name(name)

    @property
    def frame(self) -> Frame:
        """The location frame of its axis."""
        return Frame(self._axis, "location")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {self._component: 0.0 * positions[self._axis] + self.offset}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset."""
        return (Parameter(self.name, "um" if self._component < 3 else "urad", self.offset),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return ({self._component: 0.0 * positions[self._axis] + 1.0},)
