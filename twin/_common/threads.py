"""Work on a list of items divided over two threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

THREADS: Final = 2
"""Number of threads; fixed, so that no result depends on the computer."""

Piece = TypeVar("Piece")
Part = TypeVar("Part")


def map_chunks(pieces: Sequence[Piece], work: Callable[[Sequence[Piece]], Part]) -> list[Part]:
    """Apply a function to the chunks of a list in parallel threads and return the result of each chunk.

    Args:
        pieces: the items; chunk k holds every `THREADS`-th item from k on.
        work: function of a chunk, called from several threads. It should release the GIL for most of its time.
    """
    shares = [pieces[i::THREADS] for i in range(max(min(THREADS, len(pieces)), 1))]
    if len(shares) == 1:
        return [work(shares[0])]
    with ThreadPoolExecutor(len(shares)) as pool:
        return list(pool.map(work, shares))
