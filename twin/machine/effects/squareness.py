"""Squareness: an axis's mean direction turned out of square with the datum (ISO 230-1, 3.6; contract §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np

from twin.machine.effects.base import Effect, Frame, Parameter, split_name
from twin.machine.machine import Axis


@final
class Squareness(Effect):
    """``E_C0Y``, ``E_A0Z``, ``E_B0Z``: the axis's direction n turns right-handed by the angle, e = q · (ω × n).

    With n = y: E_XY −= y·E_C0Y; with n = z: E_XZ += z·E_B0Z and E_YZ −= z·E_A0Z. The angle turns about x, y or z of the machine frame,
    also where the axis's error frame leans against it.

    Args:
        name: ISO 230-1 name.
        angle_urad: the angle.
        axis: the axis that turns.
    """

    def __init__(self, name: str, angle_urad: float, axis: Axis) -> None:
        self.name = name
        self.angle_urad = angle_urad
        component, _, self._axis = split_name(name)
        self._lever = np.cross(axis.machine_axes[component - 3], axis.direction)

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self._axis, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {i: self.angle_urad * shape for i, shape in self._shape(positions).items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The angle."""
        return (Parameter(self.name, "urad", self.angle_urad),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (self._shape(positions),)

    def _shape(self, positions: Mapping[str, Any]) -> dict[int, Any]:
        # An angle in µrad over a distance in mm gives 1e-3 µm.
        q = positions[self._axis]
        return {i: q * (1e-3 * self._lever[i]) for i in range(3) if self._lever[i] != 0.0}
