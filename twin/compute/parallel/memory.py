"""Memory that a worker of a cluster keeps between arrays."""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache
from typing import Final

NANNY_LIMIT: Final = "65536"
"""The limit that Dask's nanny sets (``distributed.nanny.pre-spawn-environ``), bytes."""
LARGEST_PIECE: Final = 32 << 20
"""Largest limit that glibc sets itself for a single piece of memory; that of all free memory is twice this (mallopt(3))."""
M_TRIM_THRESHOLD: Final = -1
M_MMAP_THRESHOLD: Final = -3


@cache
def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next array, as it does by default.

    With the limit of Dask's nanny, the memory of every larger array goes back to the system when it is freed, and that of the next one
    is cleared again: half of the processor time of a worker that compensates programs. A limit that the user has chosen is left.
    """
    if sys.platform != "linux" or os.environ.get("MALLOC_TRIM_THRESHOLD_") != NANNY_LIMIT:
        return
    adjust = getattr(ctypes.CDLL(None), "mallopt", None)
    if adjust is not None:  # else not the GNU C library, to which the limit means nothing
        adjust(M_MMAP_THRESHOLD, LARGEST_PIECE)
        adjust(M_TRIM_THRESHOLD, 2 * LARGEST_PIECE)
