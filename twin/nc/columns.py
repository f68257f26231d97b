"""Moves stored as arrays, with a `Move` object made only on access; memory-efficient for programs of a million blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import final, overload

import numpy as np

from twin.nc.blocks import Kind, Move


@final
@dataclass(frozen=True)
class MoveColumns(Sequence[Move]):
    """Moves as columns; see `Move`.

    Attributes:
        names: axis names, in the order of the positions.
        line: (n,) index of the line.
        rapid: (n,) whether the move is a rapid.
        tcp: (n,) whether the words are tool-tip coordinates.
        named: (n,) the axes written in the block, as bits.
        position: (n, axes) mm and degrees, NaN where unknown.
        special: moves that do not fit the columns, by index: arcs, tool vectors, machine coordinates.
    """

    names: tuple[str, ...]
    line: np.ndarray
    rapid: np.ndarray
    tcp: np.ndarray
    named: np.ndarray
    position: np.ndarray
    special: Mapping[int, Move]

    @classmethod
    def of(cls, names: tuple[str, ...], moves: Sequence[Move]) -> MoveColumns:
        """Convert `Move` objects to columns."""
        bit = {name: 1 << i for i, name in enumerate(names)}
        bits = {named: sum(bit[name] for name in named) for named in {move.named for move in moves}}
        return cls(
            names,
            np.array([move.line for move in moves], dtype=int),
            np.array([move.kind is Kind.RAPID for move in moves], dtype=bool),
            np.array([move.tcp for move in moves], dtype=bool),
            np.array([bits[move.named] for move in moves], dtype=int),
            np.array([move.position for move in moves], dtype=float).reshape(-1, len(names)),
            {
                i: move
                for i, move in enumerate(moves)
                if move.kind is Kind.ARC or move.machine or move.vector or move.normal
            },
        )

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
        """Return the moves from one index up to, but excluding, another."""
        cut = slice(first, last)
        special = {index - first: move for index, move in self.special.items() if first <= index < last}
        return MoveColumns(
            self.names, self.line[cut], self.rapid[cut], self.tcp[cut], self.named[cut], self.position[cut], special
        )

    def turns(self, rotary: Sequence[str]) -> bool:
        """Return whether any move changes the tool orientation: writes one of these rotary axes or has a tool vector."""
        bits = sum(1 << self.names.index(name) for name in rotary)
        return bool(np.any(self.named & bits)) or any(move.vector is not None for move in self.special.values())


@final
class MoveBuilder:
    """Collector of moves, added one by one or in columns.

    Args:
        names: axis names.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._parts: list[Sequence[Move]] = []
        self._loose: list[Move] = []

    def add(self, move: Move) -> None:
        """Add one move."""
        self._loose.append(move)

    def extend(self, line: np.ndarray, rapid: np.ndarray, tcp: bool, named: np.ndarray, position: np.ndarray) -> None:
        """Add many moves, in columns."""
        columns = MoveColumns(self._names, line, rapid, np.full(len(line), tcp), named, position, {})
        self._parts += [self._loose, columns] if self._loose else [columns]
        self._loose = []

    def objects(self) -> tuple[Move, ...]:
        """Return all moves as objects."""
        return tuple(chain(*self._parts, self._loose))

    def moves(self) -> MoveColumns:
        """Return all moves in columns."""
        parts = [part if isinstance(part, MoveColumns) else MoveColumns.of(self._names, part) for part in self._parts]
        if self._loose or not parts:
            parts.append(MoveColumns.of(self._names, self._loose))
        if len(parts) == 1:
            return parts[0]
        first = np.cumsum([0, *map(len, parts)]).tolist()
        special = {at + i: move for at, part in zip(first, parts, strict=False) for i, move in part.special.items()}
        columns = ("line", "rapid", "tcp", "named", "position")
        joined = {column: np.concatenate([getattr(part, column) for part in parts]) for column in columns}
        return MoveColumns(names=self._names, special=special, **joined)
