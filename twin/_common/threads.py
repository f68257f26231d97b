"""Threads: linear algebra on one, and work on a list of items divided over two."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import cache
from importlib import import_module
from typing import Final, TypeVar

from threadpoolctl import ThreadpoolController

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


def one_blas_thread(*, scipy: bool = True) -> AbstractContextManager[object]:
    """Limit linear algebra to one thread from now on, or inside the context if the result is used as a context manager.

    Results then do not depend on the number of cores, and many small factorisations do not wait for threads.

    Args:
        scipy: whether scipy's library is limited, too. It is not NumPy's, and takes 0.15 s to load where nothing else needs it.
    """
    if scipy:
        import_module("scipy.linalg")  # Only libraries that are loaded are limited.
    limiter: AbstractContextManager[object] = _libraries("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas")
    return limiter


@cache
def _libraries(scipy: bool) -> ThreadpoolController:
    """Return the loaded libraries, with that of scipy or before it is loaded.

    They are found once: that takes a millisecond, as long as to compensate five hundred blocks.
    """
    return ThreadpoolController()
