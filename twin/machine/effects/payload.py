"""A mass that the machine's description does not have: it acts through the compliances of the joints that carry it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.machine import Axis, Machine

Side = Literal["tool", "work"]
SIDES: Final[tuple[Side, ...]] = ("tool", "work")
NUMBERS: Final = ("mass", "centre_x_mm", "centre_y_mm", "centre_z_mm")
"""Parameters of a payload: contract §5."""
MASS: Final = NUMBERS[0]
HEAVIEST_KG: Final = 1e5
FARTHEST_MM: Final = 1e4
"""The largest mass and distance that a calibration file may name."""
SOUGHT_MM: Final = 500.0
"""How far a payload's centre of gravity is sought from the frame that carries it, along each axis."""


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
        mass, x, y, z = (float(numbers[name]) for name in NUMBERS)
        return cls(side, mass, (x, y, z))

    @classmethod
    def of_shares(cls, side: Side, heaviest: float, shares: Sequence[float] | np.ndarray) -> Payload:
        """A payload from its mass as a share of the heaviest, and its centre as a share of the farthest that is sought."""
        share, x, y, z = (float(one) for one in shares)
        return cls(side, heaviest * share, (SOUGHT_MM * x, SOUGHT_MM * y, SOUGHT_MM * z))

    @property
    def numbers(self) -> dict[str, float]:
        """Its parameters by name."""
        return dict(zip(NUMBERS, (self.mass_kg, *self.centre_mm), strict=True))

    @property
    def weights(self) -> np.ndarray:
        """(9,) how much it has of each load of `twin.machine.chain.gravity_load`: kg and kg·m."""
        found, first = np.zeros(9), 1 + 4 * SIDES.index(self.side)
        found[first : first + 4] = self.mass_kg * np.array([1.0, *(1e-3 * one for one in self.centre_mm)])
        return found

    def checked(self) -> Payload:
        """The payload itself.

        Raises:
            InputError: a mass or a centre that no payload can have.
        """
        if not 0.0 <= self.mass_kg <= HEAVIEST_KG:
            raise InputError(f"mass of payload {self.side}", expected=f"0 to {HEAVIEST_KG:g} kg", value=self.mass_kg)
        far = max(self.centre_mm, key=abs)
        if abs(far) > FARTHEST_MM:
            expected = f"within {FARTHEST_MM:g} mm of the frame"
            raise InputError(f"centre of payload {self.side}", expected=expected, value=far)
        return self


def loads(payloads: Sequence[Payload]) -> np.ndarray:
    """(9,) how much there is of each load of `twin.machine.chain.gravity_load`: the machine's own once, and what it carries."""
    return np.asarray(np.eye(9)[0] + sum((payload.weights for payload in payloads), np.zeros(9)))


def side_of(axis: Axis) -> Side:
    """The side whose payload an axis carries."""
    return "tool" if axis.side == "tool" else "work"


def heaviest_kg(machine: Machine) -> float:
    """The largest payload considered: ten times the moving parts' masses in the URDF; robots and tables carry what they weigh."""
    return 10.0 * float(sum(machine.model.inertias[joint].mass for joint in range(1, machine.model.njoints)))
