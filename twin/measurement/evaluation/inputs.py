"""Checks of the arrays given to an evaluation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError


def finite_array(name: str, values: ArrayLike, *dimensions: int) -> np.ndarray:
    """Return a read-only copy as floats.

    Args:
        name: name of the values, for the message.
        values: the values.
        dimensions: numbers of dimensions that are allowed.

    Raises:
        InputError: values that are not numbers, another shape, or a missing (NaN) or infinite value; the standards allow no gaps.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} are not numbers", expected="an array of numbers", value=values) from None
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
    return read_only(array)


def check_same_length(name: str, values: np.ndarray, other_name: str, other: np.ndarray) -> None:
    """Raise `InputError` if the first dimensions of two arrays differ."""
    if len(values) != len(other):
        raise InputError(
            f"{name} do not fit {other_name}",
            expected=f"{len(other)} rows, one for each of {other_name}",
            value=len(values),
        )
