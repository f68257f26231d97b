"""Moves in columns: a program of a million blocks is arrays, and an object of each move only where somebody asks for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import final, overload

import numpy as np

from twin.nc.blocks import Kind, Move


@final
@dataclass(frozen=True)
class MoveColumns(Sequence[Move]):
    """Moves, as `Move` has them.

    Attributes:
        names: axis names, in the order of the positions.
        line: (n,) index of each one's line.
        rapid: (n,) whether it is a rapid.
        tcp: (n,) whether the words are tool-tip coordinates.
        named: (n,) the set of axes it wrote, as bits.
        position: (n, axes) mm and degrees, NaN where the program has not said it.
        special: by index, those with more to them than columns hold: arcs, tool vectors, machine coordinates.
    """

    names: tuple[str, ...]
    line: np.ndarray
    rapid: np.ndarray
    tcp: np.ndarray
    named: np.ndarray
    position: np.ndarray
    special: Mapping[int, Move]

    def __len__(self) -> int:
        return len(self.line)

    @overload
    def __getitem__(self, index: int) -> Move: ...
    @overload
    def __getitem__(self, index: slice) -> list[Move]: ...
    def __getitem__(self, index: int | slice) -> Move | list[Move]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        move = self.special.get(index)
        if move is not None:
            return move
        return Move(
            line=int(self.line[index]),
            kind=Kind.RAPID if self.rapid[index] else Kind.LINEAR,
            tcp=bool(self.tcp[index]),
            position=tuple(self.position[index].tolist()),
            named=self._names(int(self.named[index])),
        )

    def __iter__(self) -> Iterator[Move]:
        named: dict[int, frozenset[str]] = {}
        kinds = (Kind.LINEAR, Kind.RAPID)
        columns = (self.line.tolist(), self.rapid.tolist(), self.tcp.tolist(), self.named.tolist())
        rows = map(tuple, self.position.tolist())
        for index, (line, rapid, tcp, bits, position) in enumerate(zip(*columns, rows, strict=True)):
            move = self.special.get(index)
            if move is None:
                if bits not in named:
                    named[bits] = self._names(bits)
                move = Move(line, kinds[rapid], tcp, position, named[bits])
            yield move

    def _names(self, bits: int) -> frozenset[str]:
        return frozenset(name for i, name in enumerate(self.names) if bits >> i & 1)

    def part(self, first: int, last: int) -> MoveColumns:
        """Some of them, one behind the other."""
        cut = slice(first, last)
        special = {index - first: move for index, move in self.special.items() if first <= index < last}
        return MoveColumns(
            self.names, self.line[cut], self.rapid[cut], self.tcp[cut], self.named[cut], self.position[cut], special
        )

    def turns(self, rotary: Sequence[str]) -> bool:
        """Whether any move turns the tool: names one of these axes or gives a vector."""
        bits = sum(1 << self.names.index(name) for name in rotary)
        return bool(np.any(self.named & bits)) or any(move.vector is not None for move in self.special.values())


@final
class MoveBuilder:
    """Collects moves, one by one and in bulk.

    Args:
        names: axis names.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._parts: list[tuple[np.ndarray, ...]] = []
        self._loose: list[Move] = []
        self._special: dict[int, Move] = {}
        self._count = 0

    def add(self, move: Move) -> None:
        """One move."""
        if move.kind is Kind.ARC or move.machine or move.vector is not None or move.normal is not None:
            self._special[self._count] = move
        self._loose.append(move)
        self._count += 1

    def extend(self, line: np.ndarray, rapid: np.ndarray, tcp: bool, named: np.ndarray, position: np.ndarray) -> None:
        """Many, in columns."""
        self._settle()
        self._parts.append((line, rapid, np.full(len(line), tcp), named, position))
        self._count += len(line)

    def moves(self) -> MoveColumns:
        """All of them."""
        self._settle()
        if not self._parts:
            empty = np.zeros(0, dtype=int)
            return MoveColumns(
                self._names, empty, empty > 0, empty > 0, empty, np.zeros((0, len(self._names))), self._special
            )
        parts = self._parts if len(self._parts) == 1 else [tuple(map(np.concatenate, zip(*self._parts, strict=True)))]
        line, rapid, tcp, named, position = parts[0]
        return MoveColumns(self._names, line, rapid, tcp, named, position, self._special)

    def _settle(self) -> None:
        if not self._loose:
            return
        moves, self._loose = self._loose, []
        bit = {name: 1 << i for i, name in enumerate(self._names)}
        self._parts.append(
            (
                np.array([move.line for move in moves]),
                np.array([move.kind is Kind.RAPID for move in moves]),
                np.array([move.tcp for move in moves]),
                np.array([sum(bit[name] for name in move.named) for move in moves]),
                np.array([move.position for move in moves]),
            )
        )


@final
class MoveList:
    """Collects moves as `MoveBuilder` does, each as an object.

    Args:
        names: axis names.

    Attributes:
        moves: all of them.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self.moves: list[Move] = []

    def add(self, move: Move) -> None:
        """One move."""
        self.moves.append(move)

    def extend(self, line: np.ndarray, rapid: np.ndarray, tcp: bool, named: np.ndarray, position: np.ndarray) -> None:
        """Many, in columns."""
        self.moves += MoveColumns(self._names, line, rapid, np.full(len(line), tcp), named, position, {})
