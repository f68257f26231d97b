"""How large a cause can be: magnitudes beyond which no machine and no instrument has it, whatever a fit says.

Of a stiffness the softest there is: 5 kN·m/rad is that of the gear in a small robot's wrist, 1 N/µm that of a weak slide. Of the
refractive index 20 ppm: air 20 K from the temperature set on the instrument. The others are some ten times what workshops see.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.machine.machine import Machine

LONGEST_PERIOD: Final = 0.5
"""Share of the travel measured beyond which a wave is no pitch error: fewer than two periods are a curve, whatever its cause."""
POSSIBLE: Final[Mapping[tuple[str, str], float]] = {
    ("reversal", "um"): 1000.0,
    ("reversal", "urad"): 5000.0,
    ("reversal_curve", "um"): 1000.0,
    ("reversal_curve", "urad"): 5000.0,
    ("pitch_error", "um"): 500.0,
    ("squareness", "urad"): 10_000.0,
    ("axis_location", "um"): 20_000.0,
    ("axis_location", "urad"): 20_000.0,
    ("zero_offset", "um"): 20_000.0,
    ("zero_offset", "urad"): 50_000.0,
    ("thermal_expansion", "um/(m.K)"): 100.0,
    ("thermal_growth", "um/K"): 500.0,
    ("table_load", "urad"): 2000.0,
    ("gravity_compliance", "urad/(N.m)"): 200.0,
    ("gravity_compliance", "um/N"): 1.0,
    ("refraction_scale", "ppm"): 20.0,
    ("affine_scale", "ppm"): 200.0,
    ("time_skew", "s"): 1.0,
}
"""Effect and unit → magnitude beyond which no machine or instrument has it."""


YIELDING: Final = ("gravity_compliance",)
"""Effects whose size is a stiffness: a joint moves with its load, never against it."""
FARTHEST_MM: Final = 500.0
"""How far a payload's centre of gravity can be from the frame that carries it, along each axis."""


def heaviest_kg(machine: Machine) -> float:
    """The largest payload considered: ten times the moving parts' masses in the URDF; robots and tables carry what they weigh."""
    return 10.0 * float(sum(machine.model.inertias[joint].mass for joint in range(1, machine.model.njoints)))


def largest(effect: str, names: Sequence[tuple[str, str]]) -> float:
    """Of the linear parameters of an effect; infinite where nothing is known.

    Args:
        effect: contract §5.
        names: (name, unit) of its parameters; those that can be bounded have one unit.
    """
    return min((POSSIBLE.get((effect, unit), np.inf) for _, unit in names[:1]), default=np.inf)
