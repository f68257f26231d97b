"""Work on a list of items divided over two threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

WORKERS: Final = 2
"""Number of threads; fixed, so that no result depends on the computer."""

Piece = TypeVar("Piece")
Part = TypeVar("Part")


def side_by_side(pieces: Sequence[Piece], work: Callable[[Sequence[Piece]], Part]) -> list[Part]:
    """Apply a function to the chunks of a list in parallel threads and return the result of each chunk.

    Args:
        pieces: the items; chunk k holds every `WORKERS`-th item from k on.
        work: function of a chunk, called from several threads. It should release the GIL for most of its time.
    """
    shares = [pieces[i::WORKERS] for i in range(max(min(WORKERS, len(pieces)), 1))]
    if len(shares) == 1:
        return [work(shares[0])]
    with ThreadPoolExecutor(len(shares)) as pool:
        return list(pool.map(work, shares))
