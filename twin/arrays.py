"""Arrays that leave a room do so read-only."""

from __future__ import annotations

import numpy as np


def locked(array: np.ndarray) -> np.ndarray:
    """The same array, no longer writeable."""
    array.flags.writeable = False
    return array
