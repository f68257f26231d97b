"""A joint that gives way under the load gravity puts on it: the machine's own weight, and what it carries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from twin.machine.effects.along import along
from twin.machine.effects.base import Effect, Frame, Parameter
from twin.machine.machine import Axis

Side = Literal["tool", "work"]
SIDES: Final[tuple[Side, ...]] = ("tool", "work")
PAYLOAD_NUMBERS: Final = ("mass", "centre_x_mm", "centre_y_mm", "centre_z_mm")
"""Parameters of a payload: contract §5."""


@final
@dataclass(frozen=True)
class Payload:
    """A mass that the URDF does not have, fixed to the tool frame (spindle nose, flange) or to the work frame.

    Attributes:
        side: ``tool`` or ``work``.
        mass_kg: of it.
        centre_mm: of gravity, in that frame.
    """

    side: Side
    mass_kg: float
    centre_mm: tuple[float, float, float]

    @classmethod
    def of(cls, side: Side, numbers: Mapping[str, float]) -> Payload:
        """A payload from its `numbers`."""
        mass, x, y, z = (float(numbers[name]) for name in PAYLOAD_NUMBERS)
        return cls(side, mass, (x, y, z))

    @property
    def numbers(self) -> dict[str, float]:
        """Its parameters by name."""
        return dict(zip(PAYLOAD_NUMBERS, (self.mass_kg, *self.centre_mm), strict=True))

    @property
    def weights(self) -> np.ndarray:
        """(9,) how much it has of each load of `twin.machine.chain.gravity_load`: kg and kg·m."""
        found, first = np.zeros(9), 1 + 4 * SIDES.index(self.side)
        found[first : first + 4] = self.mass_kg * np.array([1.0, *(1e-3 * one for one in self.centre_mm)])
        return found


def loads(payloads: Sequence[Payload]) -> np.ndarray:
    """(9,) how much there is of each load of `twin.machine.chain.gravity_load`: the machine's own once, and what it carries."""
    return np.asarray(np.eye(9)[0] + sum((payload.weights for payload in payloads), np.zeros(9)))


@final
class GravityCompliance(Effect):
    """The axis moves by compliance times the force or torque gravity exerts along it.

    Args:
        axis: the axis.
        load: N or N·m along the axis at given positions (`twin.machine.chain.gravity_load`), of own weight and payloads.
        compliance: µm/N or µrad/(N·m).
        payloads: what the machine carries beside what the URDF says.
    """

    def __init__(
        self,
        axis: Axis,
        load: Callable[[Mapping[str, Any]], Any],
        compliance: float,
        payloads: tuple[Payload, ...] = (),
    ) -> None:
        self.name = f"gravity_compliance:{axis.name}"
        self.axis = axis
        self.compliance = compliance
        self.payloads = payloads
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
        """The compliance; a payload is given, no estimate."""
        return (Parameter(f"{self.name}.compliance", "um/N" if self.axis.linear else "urad/(N.m)", self.compliance),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, self._load(positions)),)
