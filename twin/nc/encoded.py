"""The lines of a program as bytes: most are processed together and never become text of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import final, overload

import numpy as np


def lines_in(data: bytes) -> Iterator[str]:
    """Return the lines of some bytes, each with its own ending."""
    # Not `str.splitlines`, which ends a line at other characters too.
    return (line.decode("latin-1") for line in data.splitlines(keepends=True))


def line_ends(text: np.ndarray, data: bytes) -> np.ndarray:
    """Return the index of the last character of every terminated line; CR at the very end counts as an ending."""
    ends = text == 10
    if b"\r" in data:
        returns = text == 13
        returns[:-1] &= ~ends[1:]
        ends |= returns
    return np.flatnonzero(ends)


@final
class Lines(Sequence[str]):
    """The lines of some bytes, as `lines_in`, each decoded when it is asked for.

    Args:
        data: the bytes.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        behind = line_ends(np.frombuffer(data, dtype=np.uint8), data) + 1
        last = [len(data)] if len(data) > behind.max(initial=0) else []
        self._cuts = np.concatenate([[0], behind, last]).astype(int)

    def __len__(self) -> int:
        return len(self._cuts) - 1

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[str]: ...
    def __getitem__(self, index: int | slice) -> str | Sequence[str]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(len(self))[index])
        at = range(len(self))[index]
        return self._data[self._cuts[at] : self._cuts[at + 1]].decode("latin-1")

    def __iter__(self) -> Iterator[str]:
        return lines_in(self._data)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Lines):
            return self._data == other._data
        return isinstance(other, tuple) and tuple(self) == other

    def __hash__(self) -> int:
        return hash(tuple(self))

    def encoded(self, first: int, last: int) -> bytes:
        """Return the bytes of the lines ``first`` to before ``last``."""
        return self._data[self._cuts[first] : self._cuts[min(last, len(self))]]


def encoded(texts: Sequence[str], first: int, last: int, empty: str = "") -> bytes:
    """Return the bytes of the lines ``first`` to before ``last``, with the text ``empty`` in place of empty ones."""
    if isinstance(texts, Lines):
        return texts.encoded(first, last)
    return "".join([text or empty for text in texts[first:last]]).encode("latin-1")
