"""Some of the poses of a program, spread over all of it though its end is not in sight."""

from __future__ import annotations

from typing import Final, NamedTuple, final

import numpy as np

from twin.compensation.comparison import Commands

CLASS_POSES: Final = 5000
"""Poses at which the shares of the classes are taken: a share needs no more, the total is over all."""
LEAST_SHARE: Final = 1e-9
"""Of the blocks: where one block alone has more poses than that, it has them."""
GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0
"""Blocks whose number times this has a fraction below a share are that share of all blocks, spread as evenly as can be, and in step
with nothing that a program repeats (H. Weyl, Math. Ann. 77, 1916; V. Sós, 1958)."""


class Seen(NamedTuple):
    """Places on the way.

    Attributes:
        motion: (n,) which motion each is on.
        meant, given: commands as meant and as given.
        meant_from, given_from: (n, axes) sides axes come from there, where the machine makes one of it.
        counts: (n,) whether it is a place to be at; None: all.
    """

    motion: np.ndarray
    meant: Commands
    given: Commands
    meant_from: np.ndarray | None = None
    given_from: np.ndarray | None = None
    counts: np.ndarray | None = None


@final
class Sample:
    """The poses of a share of the blocks."""

    def __init__(self) -> None:
        self._share = 1.0
        self._parts: list[tuple[np.ndarray, ...]] = []
        self._count = 0

    def add(self, first: int, seen: Seen, keep: np.ndarray) -> None:
        """Take what falls to the share of some places.

        Args:
            first: the number of the first motion among those of the program.
            seen: the places.
            keep: (n,) which of them count.
        """
        place = np.mod((first + seen.motion) * GOLDEN, 1.0)
        which = np.flatnonzero((place < self._share) & keep)
        poses = []
        for commands, sides in ((seen.meant, seen.meant_from), (seen.given, seen.given_from)):
            written = commands.written(which)
            poses += [written, np.zeros(written.shape) if sides is None else sides[which]]
        self._take((place[which], *poses))
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
        """(n, axes) each: commands as meant, sides axes come from, commands as given, sides."""
        return tuple(np.concatenate(arrays) for arrays in list(zip(*self._parts, strict=True))[1:])
