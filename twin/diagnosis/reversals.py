"""Reversals that change along an axis's travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from twin.diagnosis.functions import Functions, Rows
from twin.diagnosis.signatures import Column, along_command, of_components
from twin.identification.unknowns import CurveSpace
from twin.machine.machine import Axis, Machine
from twin.numerics.curves import POWER

VARYING: Final = "reversal_curve"
DEGREES: Final = 4
"""Largest degree that is tried."""


def told_with_more(key: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    """The same cause with more numbers: a plain reversal is one that changes along the travel by nothing."""
    return ((VARYING, key[1]),) if key[0] == "reversal" else ()


def lost_motion(machine: Machine, axis: Axis, state: Mapping[str, Any]) -> tuple[CurveSpace, list[Column]] | None:
    """Half the side of approach times each orthonormal function of the position, along an axis.

    Args:
        machine: the machine.
        axis: the axis.
        state: positions and channels of all points.

    Returns:
        The functions and their columns; None if the side or the range is not known, or too few positions have both sides.
    """
    side, q = state.get(f"approach_{axis.name}"), state[axis.name]
    if side is None or axis.lower is None or axis.upper is None:
        return None
    places = [np.unique(np.round(q[side == sign], 3)) for sign in (1.0, -1.0)]
    # A curve through every position would foretell none.
    degrees = min(DEGREES, min(len(one) for one in places) - 2)
    if degrees < 1:
        return None
    space = CurveSpace(VARYING, POWER, axis.domain, 0, degrees + 1)

    def values(rows: Rows) -> np.ndarray:
        return np.asarray(0.5 * side[rows, None] * space.functions(np.clip(q[rows], *axis.domain)))

    functions = Functions(len(q), space.count, values)
    along = along_command(machine, axis)
    return space, [of_components([(i, functions, k, part) for i, part in along]) for k in range(space.count)]
