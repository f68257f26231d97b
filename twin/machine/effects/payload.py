"""Masses that are missing from the machine description; they act through the compliances of the joints that carry them.

A payload has a constant mass. A carried load has the mass of the channel ``load_kg``, which is known for every reading or program.
"""

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
LOAD: Final = "load_kg"
"""Channel with the mass of a carried load, kg."""
LOAD_NUMBERS: Final = ("mass_ratio", *NUMBERS[1:])
"""Parameters of a carried load; ``mass_ratio`` is the mass that acts per kg of ``load_kg``, 1 if that mass is right."""
HEAVIEST_KG: Final = 1e5
FARTHEST_MM: Final = 1e4
"""Largest mass and distance accepted in a calibration file."""
LARGEST_RATIO: Final = 10.0
"""Largest mass that acts per kg of a carried load accepted in a calibration file."""
CENTRE_RANGE_MM: Final = 500.0
"""Search range of a payload's centre of gravity along each axis of the frame that carries it, ± mm."""


@final
@dataclass(frozen=True)
class Payload:
    """A mass that is missing from the URDF, fixed to the tool frame (spindle nose, flange) or to the work frame.

    Attributes:
        side: ``tool`` or ``work``.
        mass_kg: mass; of a carried load the mass that acts per kg of the channel ``load_kg``.
        centre_mm: centre of gravity in that frame.
        carried: whether it is a carried load.
    """

    side: Side
    mass_kg: float
    centre_mm: tuple[float, float, float]
    carried: bool = False

    @classmethod
    def of(cls, side: Side, numbers: Mapping[str, float], *, carried: bool = False) -> Payload:
        """Create a payload from its `numbers`; the ``mass_ratio`` of a carried load is 1 if it is not given."""
        mass = numbers.get(LOAD_NUMBERS[0], 1.0) if carried else numbers[MASS]
        x, y, z = (float(numbers[name]) for name in NUMBERS[1:])
        return cls(side, float(mass), (x, y, z), carried)

    @classmethod
    def of_shares(cls, side: Side, heaviest: float, shares: Sequence[float] | np.ndarray) -> Payload:
        """Create a payload from its mass as a fraction of ``heaviest`` and its centre as fractions of the search range."""
        share, x, y, z = (float(value) for value in shares)
        return cls(side, heaviest * share, (CENTRE_RANGE_MM * x, CENTRE_RANGE_MM * y, CENTRE_RANGE_MM * z))

    @property
    def plausible(self) -> bool:
        """Whether the mass is positive and the centre within the search range."""
        return self.mass_kg > 0.0 and max(map(abs, self.centre_mm)) <= CENTRE_RANGE_MM * (1.0 + 1e-9)

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(LOAD_NUMBERS if self.carried else NUMBERS, (self.mass_kg, *self.centre_mm), strict=True))

    @property
    def weights(self) -> np.ndarray:
        """Factors (9,) of the loads of `twin.machine.chain.gravity_load`, kg and kg·m."""
        found, first = np.zeros(9), 1 + 4 * SIDES.index(self.side)
        found[first : first + 4] = self.mass_kg * np.array([1.0, *(1e-3 * value for value in self.centre_mm)])
        return found

    def checked(self) -> Payload:
        """Return the payload itself if its values are within their limits.

        Raises:
            InputError: the mass or the centre is outside its limits.
        """
        if self.carried and not 0.0 <= self.mass_kg <= LARGEST_RATIO:
            raise InputError(
                f"mass_ratio of the load on the {self.side} side",
                expected=f"0 to {LARGEST_RATIO:g}, 1 if {LOAD} is right",
                value=self.mass_kg,
            )
        if not 0.0 <= self.mass_kg <= HEAVIEST_KG:
            raise InputError(f"mass of payload {self.side}", expected=f"0 to {HEAVIEST_KG:g} kg", value=self.mass_kg)
        far = max(self.centre_mm, key=abs)
        if abs(far) > FARTHEST_MM:
            expected = f"within {FARTHEST_MM:g} mm of the frame"
            raise InputError(f"centre of payload {self.side}", expected=expected, value=far)
        return self


def loads(payloads: Sequence[Payload]) -> np.ndarray:
    """Return the factors (9,) of the loads of `twin.machine.chain.gravity_load`: 1 for the machine's own weight, and the payloads'."""
    constant = (payload.weights for payload in payloads if not payload.carried)
    return np.asarray(np.eye(9)[0] + sum(constant, np.zeros(9)))


def loads_per_kg(payloads: Sequence[Payload], side: Side) -> np.ndarray:
    """Return the factors (9,) of the loads of `twin.machine.chain.gravity_load` per kg of the load carried on one side."""
    return np.asarray(sum((one.weights for one in payloads if one.carried and one.side == side), np.zeros(9)))


def is_carrying(state: Mapping[str, np.ndarray]) -> bool:
    """Return whether the readings have a carried load, in any row."""
    return LOAD in state and bool(np.any(state[LOAD]))


def sum_of(payloads: Sequence[Payload]) -> Payload:
    """Return one payload with the mass and the first moments of several of one kind on one side."""
    mass = sum(one.mass_kg for one in payloads)
    x, y, z = (sum(one.mass_kg * one.centre_mm[i] for one in payloads) / mass for i in range(3))
    return Payload(payloads[0].side, mass, (x, y, z), payloads[0].carried)


def side_of(axis: Axis) -> Side:
    """Return the side whose payload an axis carries."""
    return "tool" if axis.side == "tool" else "work"


def max_payload_kg(machine: Machine) -> float:
    """Return the largest payload considered, kg: ten times the mass of the moving parts in the URDF.

    Robots and tables carry about their own weight.
    """
    return 10.0 * float(sum(machine.model.inertias[joint].mass for joint in range(1, machine.model.njoints)))
