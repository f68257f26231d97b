"""Work that falls into pieces, two shares of it side by side in threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

WORKERS: Final = 2
"""Shares side by side; a fixed number, so that no result depends on the machine."""

Piece = TypeVar("Piece")
Part = TypeVar("Part")


def side_by_side(pieces: Sequence[Piece], work: Callable[[Sequence[Piece]], Part]) -> list[Part]:
    """What each share gave.

    Args:
        pieces: every other one is a share.
        work: a share → what it gives; called from several threads. It should be mostly such work as lets other threads run.
    """
    shares = [pieces[i::WORKERS] for i in range(max(min(WORKERS, len(pieces)), 1))]
    if len(shares) == 1:
        return [work(shares[0])]
    with ThreadPoolExecutor(len(shares)) as pool:
        return list(pool.map(work, shares))
