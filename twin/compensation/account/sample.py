"""Sample of a program's poses, spread evenly over a program whose length is not known in advance."""

from __future__ import annotations

from typing import Final, NamedTuple, final

import numpy as np

from twin.compensation.comparison import Commands

CLASS_POSES: Final = 5000
"""Poses at which the shares of the classes are evaluated: enough for a share. Totals are taken over all poses."""
LEAST_SHARE: Final = 1e-9
"""Smallest share of the blocks. If a single block has more than `CLASS_POSES` poses, all of them are kept."""
GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0
"""A block is in a sample of share s if the fractional part of its number times this is below s. Such a sample is spread as evenly as
possible and is not in step with anything a program repeats (H. Weyl, Math. Ann. 77, 1916; V. Sós, 1958).
"""


class SimulatedPoints(NamedTuple):
    """Simulated points of a program.

    Attributes:
        motion: (n,) motion each point is on.
        nominal, written: nominal commands and written commands.
        nominal_sides, written_sides: (n, axes + channels) approach directions and conditions at these commands; None if the machine
            does not depend on them.
        valid: (n,) whether the point counts as a nominal position; None for all.
    """

    motion: np.ndarray
    nominal: Commands
    written: Commands
    nominal_sides: np.ndarray | None = None
    written_sides: np.ndarray | None = None
    valid: np.ndarray | None = None


@final
class Sample:
    """Poses of an evenly spread share of the blocks; the share is halved whenever there are more than `CLASS_POSES`."""

    def __init__(self) -> None:
        self._share = 1.0
        self._parts: list[tuple[np.ndarray, ...]] = []
        self._count = 0

    def add(self, first: int, points: SimulatedPoints, keep: np.ndarray) -> None:
        """Add those points that belong to the sample.

        Args:
            first: number of the first motion within the program.
            points: the points.
            keep: (n,) which of them are valid.
        """
        # By motion, of which every one has many points.
        place = np.mod((first + np.arange(points.motion.max(initial=-1) + 1)) * GOLDEN, 1.0)
        which = np.flatnonzero((place < self._share)[points.motion] & keep)
        poses = []
        for commands, sides in ((points.nominal, points.nominal_sides), (points.written, points.written_sides)):
            written = commands.as_array(which)
            poses += [written, np.zeros(written.shape) if sides is None else sides[which]]
        self._take((place[points.motion[which]], *poses))
        while (
            self._count > CLASS_POSES
            and self._share > LEAST_SHARE
            and any(np.any(part[0] < self._share / 2.0) for part in self._parts)
        ):
            self._share /= 2.0
            parts, self._parts, self._count = self._parts, [], 0
            for part in parts:
                self._take(part)

    def _take(self, part: tuple[np.ndarray, ...]) -> None:
        keep = np.flatnonzero(part[0] < self._share)
        self._parts.append(tuple(array[keep] for array in part))
        self._count += len(keep)

    def poses(self) -> tuple[np.ndarray, ...]:
        """Return four (n, axes) arrays: nominal commands, their approach directions, written commands, their approach directions."""
        return tuple(np.concatenate(arrays) for arrays in list(zip(*self._parts, strict=True))[1:])
