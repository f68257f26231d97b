"""Sample of a program's poses, spread evenly over a program whose length is not known in advance."""

from __future__ import annotations

from collections.abc import Callable
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
    """Simulated points of a program, on straight lines.

    Attributes:
        motion: (lines,) motion each line is on.
        nominal, written: nominal commands and written commands.
        nominal_sides, written_sides: (lines, axes + channels) approach directions and conditions at these commands; None if the machine
            does not depend on them.
    """

    motion: np.ndarray
    nominal: Commands
    written: Commands
    nominal_sides: np.ndarray | None = None
    written_sides: np.ndarray | None = None

    def of(self, lines: np.ndarray) -> SimulatedPoints:
        """Return the points of some lines, given in ascending order, each as a line of its own."""
        if self.nominal.points is None and self.written.points is None and len(lines) == len(self.motion):
            return self  # all of them, single points already
        number = np.repeat(lines, self.nominal.counts[lines])
        nominal, written = (Commands(one.of(lines).as_array()) for one in (self.nominal, self.written))
        before, after = (None if one is None else one[number] for one in (self.nominal_sides, self.written_sides))
        return SimulatedPoints(self.motion[number], nominal, written, before, after)


@final
class Sample:
    """Poses of an evenly spread share of the blocks; the share is halved whenever there are more than `CLASS_POSES`."""

    def __init__(self) -> None:
        self._share = 1.0
        self._parts: list[tuple[np.ndarray, ...]] = []

    def add(self, first: int, points: SimulatedPoints, known: Callable[[SimulatedPoints], np.ndarray]) -> None:
        """Add those points that belong to the sample.

        Args:
            first: number of the first motion within the program.
            points: the points.
            known: which of some points, each a line of its own, count.
        """
        # By motion, of which every one has many points.
        turns = (first + np.arange(points.motion.max(initial=-1) + 1)) * GOLDEN
        place = turns - np.floor(turns)
        of_line, counts = place[points.motion], points.nominal.counts
        share = self._share
        while share > LEAST_SHARE and counts[of_line < share / 2.0].sum() > CLASS_POSES:
            share /= 2.0  # will be the share afterwards, if enough of these points are known
        for trial in (share, self._share):
            some = points.of(np.flatnonzero(of_line < trial))
            keep = known(some)
            if trial == self._share or np.count_nonzero(keep) > CLASS_POSES:
                break
        poses = []
        for commands, sides in ((some.nominal, some.nominal_sides), (some.written, some.written_sides)):
            written = commands.as_array()[keep]
            poses += [written, np.zeros(written.shape) if sides is None else sides[keep]]
        self._parts.append((place[some.motion[keep]], *poses))
        self._thin()

    def _thin(self) -> None:
        """Halve the share as often as necessary, and keep the poses that belong to it."""
        share, places = self._share, np.concatenate([part[0] for part in self._parts])
        while np.count_nonzero(places < share) > CLASS_POSES and share > LEAST_SHARE and np.any(places < share / 2.0):
            share /= 2.0
        self._share = share
        for i, part in enumerate(self._parts):
            keep = np.flatnonzero(part[0] < share)
            if len(keep) < len(part[0]):
                self._parts[i] = tuple(array.take(keep, axis=0) for array in part)

    def poses(self) -> tuple[np.ndarray, ...]:
        """Return four (n, axes) arrays: nominal commands, their approach directions, written commands, their approach directions."""
        return tuple(np.concatenate(arrays) for arrays in list(zip(*self._parts, strict=True))[1:])
