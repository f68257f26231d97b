"""Reversals that change along an axis's travel."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.curves import POWER
from twin.diagnosis.functions import Functions, Rows
from twin.identification.unknowns import CurveSpace
from twin.machine import Axis

VARYING: Final = "reversal_curve"
DEGREES: Final = 4
"""Largest degree that is tried."""


def told_with_more(key: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    """The same cause with more numbers: a plain reversal is one that changes along the travel by nothing."""
    return ((VARYING, key[1]),) if key[0] == "reversal" else ()


def lost_motion(axis: Axis, q: np.ndarray, side: np.ndarray) -> tuple[CurveSpace, Functions] | None:
    """Half the side of approach times each orthonormal function of the position; None if too few positions have both sides.

    Args:
        axis: of limited range.
        q: (n,) positions.
        side: (n,) +1, −1, or 0 where the side is not known.
    """
    places = [np.unique(np.round(q[side == sign], 3)) for sign in (1.0, -1.0)]
    # A curve through every position would foretell none.
    degrees = min(DEGREES, min(len(one) for one in places) - 2)
    if degrees < 1:
        return None
    space = CurveSpace(VARYING, POWER, axis.domain, 0, degrees + 1)

    def values(rows: Rows) -> np.ndarray:
        return 0.5 * side[rows, None] * space.functions(np.clip(q[rows], *axis.domain))

    return space, Functions(len(q), space.count, values)
