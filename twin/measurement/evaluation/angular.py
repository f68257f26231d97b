"""Angular error of a linear axis from readings of a level or an autocollimator, after ISO 230-1:2012, 3.4.16 and 8.4.

The angular error is the range of the angular deviations over the travel: the largest minus the smallest. The zero of the instrument
has no influence, and no slope is removed: an angle that changes steadily along the travel is an error motion. Deviations are the means
of the readings at a position in one direction of approach, so that the range contains the reversal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.counts import count_with_noun
from twin._common.errors import InputError
from twin.measurement.evaluation.inputs import check_same_length, finite_array

FEWEST_POSITIONS: Final = 5
"""Number of positions along the travel below which the test is not a full one (tests of ISO 10791-1)."""


@final
@dataclass(frozen=True)
class AngularError:
    """Angular error of a linear axis about one direction; m positions, angles in µrad from the first deviation.

    Attributes:
        name: ISO 230-1 name of the error motion: ``E_AX``.
        position_mm: (m,) positions, ascending.
        forward_urad, backward_urad: (m,) mean angular deviation of each direction of approach; NaN where it was not read.
        value_urad: range of all deviations: the angular error.
        forward_value_urad, backward_value_urad: range in one direction; None if it was not read at two positions.
        reversal_urad: largest difference of the two directions at a position, forward minus backward; None if there is none.
        shortfalls: what a full test has and this one lacks.
    """

    name: str
    position_mm: np.ndarray
    forward_urad: np.ndarray
    backward_urad: np.ndarray
    value_urad: float
    forward_value_urad: float | None
    backward_value_urad: float | None
    reversal_urad: float | None
    shortfalls: tuple[str, ...]


def angular_error(position_mm: ArrayLike, angle_urad: ArrayLike, approach: ArrayLike, *, name: str) -> AngularError:
    """Evaluate the angular error of a linear axis.

    Args:
        position_mm: (n,) commanded positions; equal ones are repeats.
        angle_urad: (n,) readings.
        approach: (n,) direction of approach, +1 or −1.
        name: ISO 230-1 name of the error motion.

    Raises:
        InputError: values that are missing or not finite, a direction that is neither +1 nor −1, or fewer than two positions.
    """
    position, angle = finite_array("positions", position_mm, 1), finite_array("angles", angle_urad, 1)
    side = finite_array("directions of approach", approach, 1)
    check_same_length("angles", angle, "positions", position)
    check_same_length("directions of approach", side, "positions", position)
    if not np.isin(side, (-1.0, 1.0)).all():
        raise InputError("unknown direction of approach", expected="+1 or -1", value=side[~np.isin(side, (-1, 1))][0])
    targets, which = np.unique(position, return_inverse=True)
    if len(targets) < 2:
        raise InputError("angles at one position", expected="two positions or more", value=float(targets[0]))
    means = []
    for direction in (1.0, -1.0):
        rows = side == direction
        count = np.bincount(which[rows], minlength=len(targets)).astype(float)
        total = np.bincount(which[rows], angle[rows], minlength=len(targets))
        means.append(np.divide(total, count, out=np.full(len(targets), np.nan), where=count > 0.0))
    both = np.array(means)
    both = both - both[np.isfinite(both[:, 0]), 0][0]
    ranges = [float(np.nanmax(one) - np.nanmin(one)) if np.isfinite(one).sum() > 1 else None for one in both]
    shortfalls = []
    if len(targets) < FEWEST_POSITIONS:
        shortfalls.append(f"{count_with_noun(len(targets), 'position')}, fewer than {FEWEST_POSITIONS}")
    if None in ranges:
        shortfalls.append("one direction of motion only")
    difference = (both[0] - both[1])[np.isfinite(both).all(axis=0)]
    return AngularError(
        name,
        read_only(targets),
        read_only(both[0]),
        read_only(both[1]),
        float(np.nanmax(both) - np.nanmin(both)),
        ranges[0],
        ranges[1],
        float(difference[np.argmax(np.abs(difference))]) if len(difference) else None,
        tuple(shortfalls),
    )
