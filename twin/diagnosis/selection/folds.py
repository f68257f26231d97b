"""Parts of the data that are held out in turn: what is held out is what the claim is about.

A function of position is foretold at positions, or poses, that it has not seen; a change in time in rounds, or blocks of time, that it
has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

FOLDS: Final = 8
"""Parts at most."""
SEED: Final = 2001
BLOCKS: Final = 8
"""Parts of one long round, in time."""
HeldOutOf = Literal["rounds", "positions", "poses", "blocks"]


@final
@dataclass(frozen=True)
class Parts:
    """What is held out together.

    Attributes:
        of: ``rounds``, ``positions`` of the one axis that moved, ``poses``, or ``blocks`` of time.
        group: (n,) the independent group of each reading.
        part: (n,) the part it is held out with: whole groups, drawn at random.
    """

    of: HeldOutOf
    group: np.ndarray
    part: np.ndarray


def parts(data: Measurements, machine: Machine, causes: Sequence[Candidate]) -> Parts | None:
    """By what the causes claim; None where nothing can be held out.

    Args:
        data: the measurements.
        machine: the machine.
        causes: that were found.
    """
    changing = bool(causes) and all(cause.specification.varies == "with time" for cause in causes)
    if not changing:
        moved = [i for i in range(len(machine.axes)) if np.ptp(data.positions[:, i]) > 0.0]
        if moved:
            found = at_positions(data, moved)
            if found is not None:
                return found
    return in_time(data)


def in_time(data: Measurements) -> Parts | None:
    """Rounds, or blocks of time where there is but one round; None for too few readings.

    Args:
        data: the measurements.
    """
    _, group = np.unique(data.round.astype(str), return_inverse=True)
    if group.max() > 0:
        return _drawn("rounds", group.reshape(-1))
    if len(data) < 2 * BLOCKS:
        return None
    order = np.argsort(data.time_s, kind="stable") if np.all(np.isfinite(data.time_s)) else np.arange(len(data))
    group = np.empty(len(data), dtype=int)
    group[order] = np.arange(len(data)) * BLOCKS // len(data)
    return Parts("blocks", group, group)


def at_positions(data: Measurements, axes: Sequence[int]) -> Parts | None:
    """Positions of one axis, or poses of several; None where there is but one.

    Args:
        data: the measurements.
        axes: numbers of those that moved.
    """
    _, group = np.unique(np.round(data.positions[:, list(axes)], 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    return _drawn("positions" if len(axes) == 1 else "poses", group) if group.max() > 0 else None


def _drawn(of: HeldOutOf, group: np.ndarray) -> Parts:
    count = int(group.max()) + 1
    return Parts(of, group, (np.random.default_rng(SEED).permutation(count) % min(count, FOLDS))[group])
