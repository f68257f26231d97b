"""How large a cause can be: magnitudes beyond which no machine and no instrument has it, whatever a fit says.

Of a stiffness the softest there is: 5 kN·m/rad is that of the gear in a small robot's wrist, 1 N/µm that of a weak slide. Of the
refractive index 20 ppm: air 20 K from the temperature set on the instrument. The others are some ten times what workshops see.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

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


def largest(effect: str, names: Sequence[tuple[str, str]]) -> float:
    """Of the linear parameters of an effect; infinite where nothing is known.

    Args:
        effect: contract §5.
        names: (name, unit) of its parameters; those that can be bounded have one unit.
    """
    return min((POSSIBLE.get((effect, unit), np.inf) for _, unit in names[:1]), default=np.inf)
