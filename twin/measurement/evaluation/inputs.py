"""Checks that every evaluation makes of the arrays it is given."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import locked
from twin._common.errors import InputError


def numbers(name: str, values: ArrayLike, *dimensions: int) -> np.ndarray:
    """A read-only copy, as floats.

    Args:
        name: what they are, for the message.
        values: what was given.
        dimensions: how many axes the array may have.

    Raises:
        InputError: no numbers, another shape, or one that is missing (NaN) or infinite: standards know no gaps.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} are no numbers", expected="an array of numbers", value=values) from None
    if array.ndim not in dimensions or array.size == 0:
        raise InputError(
            f"{name} have the wrong shape",
            expected=f"{' or '.join(map(str, dimensions))} dimension(s), none empty",
            value=array.shape,
        )
    missing = np.argwhere(~np.isfinite(array))
    if len(missing):
        place = ", ".join(str(int(i)) for i in missing[0])
        raise InputError(
            f"{name} lack {len(missing)} of {array.size} values, the first at [{place}]",
            expected="every value: measure it again, or leave out its whole row",
            value=float(array[tuple(missing[0])]),
        )
    return locked(array)


def same_length(name: str, values: np.ndarray, other_name: str, other: np.ndarray) -> None:
    """Refuses arrays that do not belong together.

    Raises:
        InputError: their first dimensions differ.
    """
    if len(values) != len(other):
        raise InputError(
            f"{name} do not fit {other_name}",
            expected=f"{len(other)} rows, one for each of {other_name}",
            value=len(values),
        )
