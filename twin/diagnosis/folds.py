"""Parts of the data that are held out in turn."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.measurement import Measurements

FOLDS: Final = 8
"""Parts at most."""
SEED: Final = 2001


def folds(data: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """(n,) the round of each row, or its pose where there is but one round, and (n,) the part it is in: whole rounds, drawn at random.

    One part only where there is but one pose.
    """
    names, group = np.unique(data.round.astype(str), return_inverse=True)
    if len(names) < 2:
        names, group = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    fold = np.random.default_rng(SEED).permutation(len(names)) % min(len(names), FOLDS)
    return group, fold[group]
