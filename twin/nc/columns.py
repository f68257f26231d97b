"""Moves and their replacements as arrays, with an object made only on access; memory-efficient for programs of a million blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from twin._common.arrays import MadeOnAccess
from twin.nc.blocks import Kind, Move, Rewrite

NO_VECTOR = (np.nan, np.nan, np.nan)
"""In place of a tool vector, in columns."""


@final
@dataclass(frozen=True)
class MoveColumns(MadeOnAccess[Move]):
    """Moves as columns; see `Move`.

    Attributes:
        names: axis names, in the order of the positions.
        line: (n,) index of the line.
        rapid: (n,) whether the move is a rapid.
        tcp: (n,) whether the words are tool-tip coordinates.
        named: (n,) the axes written in the block, as bits.
        position: (n, axes) mm and degrees, NaN where unknown.
        vector: (n, 3) tool vectors, NaN where there is none.
        special: moves that do not fit the columns, by index: arcs, surface normals, moves that pass through unchanged.
    """

    names: tuple[str, ...]
    line: np.ndarray
    rapid: np.ndarray
    tcp: np.ndarray
    named: np.ndarray
    position: np.ndarray
    vector: np.ndarray
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
            np.array([move.vector or NO_VECTOR for move in moves], dtype=float).reshape(-1, 3),
            {i: move for i, move in enumerate(moves) if move.kind is Kind.ARC or move.passes or move.normal},
        )

    def __len__(self) -> int:
        return len(self.line)

    def item(self, index: int) -> Move:
        """Return one move."""
        move = self.special.get(index)
        if move is not None:
            return move
        x, y, z = self.vector[index].tolist()
        return Move(
            line=int(self.line[index]),
            kind=Kind.RAPID if self.rapid[index] else Kind.LINEAR,
            tcp=bool(self.tcp[index]),
            position=tuple(self.position[index].tolist()),
            named=self._names(int(self.named[index])),
            vector=(x, y, z) if x == x else None,
        )

    def __iter__(self) -> Iterator[Move]:
        named: dict[int, frozenset[str]] = {}
        kinds = (Kind.LINEAR, Kind.RAPID)
        columns = (self.line.tolist(), self.rapid.tolist(), self.tcp.tolist(), self.named.tolist())
        rows = map(tuple, self.position.tolist())
        vectors = (tuple(row) if row[0] == row[0] else None for row in self.vector.tolist())
        for index, (line, rapid, tcp, bits, position, vector) in enumerate(zip(*columns, rows, vectors, strict=True)):
            move = self.special.get(index)
            if move is None:
                if bits not in named:
                    named[bits] = self._names(bits)
                move = Move(line, kinds[rapid], tcp, position, named[bits], vector=vector)
            yield move

    @property
    def by_vector(self) -> np.ndarray:
        """(n,) whether the move has a tool vector."""
        return np.isfinite(self.vector[:, 0])

    def _names(self, bits: int) -> frozenset[str]:
        return frozenset(name for i, name in enumerate(self.names) if bits >> i & 1)

    @property
    def passes(self) -> np.ndarray:
        """(n,) whether the move passes through unchanged: machine coordinates, or words of unknown meaning."""
        found = np.zeros(len(self), dtype=bool)
        found[[index for index, move in self.special.items() if move.passes]] = True
        return found

    def part(self, first: int, last: int) -> MoveColumns:
        """Return the moves from one index up to, but excluding, another."""
        cut = slice(first, last)
        special = {index - first: move for index, move in self.special.items() if first <= index < last}
        return MoveColumns(
            self.names,
            self.line[cut],
            self.rapid[cut],
            self.tcp[cut],
            self.named[cut],
            self.position[cut],
            self.vector[cut],
            special,
        )

    def turns(self, rotary: Sequence[str]) -> bool:
        """Return whether any move changes the tool orientation: writes one of these rotary axes or has a tool vector."""
        bits = sum(1 << self.names.index(name) for name in rotary)
        return bool(np.any(self.named & bits) or np.any(self.by_vector))


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

    def extend(self, moves: MoveColumns) -> None:
        """Add many moves, in columns."""
        self._parts += [self._loose, moves] if self._loose else [moves]
        self._loose = []

    def moves(self) -> MoveColumns:
        """Return all moves in columns."""
        parts = [part if isinstance(part, MoveColumns) else MoveColumns.of(self._names, part) for part in self._parts]
        if self._loose or not parts:
            parts.append(MoveColumns.of(self._names, self._loose))
        if len(parts) == 1:
            return parts[0]
        first = np.cumsum([0, *map(len, parts)]).tolist()
        special = {at + i: move for at, part in zip(first, parts, strict=False) for i, move in part.special.items()}
        columns = ("line", "rapid", "tcp", "named", "position", "vector")
        joined = {column: np.concatenate([getattr(part, column) for part in parts]) for column in columns}
        return MoveColumns(names=self._names, special=special, **joined)


def as_columns(names: tuple[str, ...], moves: Sequence[Move]) -> MoveColumns:
    """Return moves in columns; ``names``: the axes."""
    return moves if isinstance(moves, MoveColumns) else MoveColumns.of(names, moves)


@final
@dataclass(frozen=True)
class NewPositions:
    """Replacements for the moves of a program, or of a chunk of one.

    Attributes:
        first: (moves,) the first row of each move's segments.
        count: (moves,) number of segments; 0 for a move that is unchanged.
        positions: (rows, axes) as in `twin.nc.blocks.Rewrite`.
        vectors: (rows, 3) tool vectors, NaN where there is none.
        shares: (rows,) shares of the moves' time, as in `twin.nc.blocks.Rewrite`; NaN for equal fractions, None if all are equal.
    """

    first: np.ndarray
    count: np.ndarray
    positions: np.ndarray
    vectors: np.ndarray
    shares: np.ndarray | None = None

    @classmethod
    def of(cls, moves: int, axes: int, new: Mapping[int, tuple[np.ndarray, np.ndarray | None]]) -> NewPositions:
        """Return the replacements of single moves.

        Args:
            moves: number of moves of the program.
            axes: number of words per position.
            new: by the index of the move, ascending, (segments, axes) positions and (segments, 3) vectors or None.
        """
        count = np.zeros(moves, dtype=int)
        count[list(new)] = [len(positions) for positions, _ in new.values()]
        vectors = [np.full((len(rows), 3), np.nan) if tool is None else tool for rows, tool in new.values()]
        return cls(
            np.cumsum(count) - count,
            count,
            np.concatenate([np.zeros((0, axes)), *(positions for positions, _ in new.values())]),
            np.concatenate([np.zeros((0, 3)), *vectors]),
        )

    def part(self, first: int, last: int) -> NewPositions:
        """Return the replacements of the moves from one index up to, but excluding, another."""
        return replace(self, first=self.first[first:last], count=self.count[first:last])

    def rows(self, which: np.ndarray) -> np.ndarray:
        """Return the rows of some moves, move by move."""
        first, count = self.first[which], self.count[which]
        return np.asarray(np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum()))

    def of_move(self, index: int, move: Move) -> Rewrite | None:
        """Return the replacement of one move, with its index; None if it is unchanged."""
        if not self.count[index]:
            return None
        part = slice(self.first[index], self.first[index] + self.count[index])
        vectors, shares = self.vectors[part], None if self.shares is None else self.shares[part]
        return Rewrite(
            move,
            self.positions[part],
            vectors if np.isfinite(vectors).all() else None,
            None if shares is None or np.isnan(shares).any() else shares,
        )


def fill_forward(values: np.ndarray, said: np.ndarray, before: Sequence[float]) -> None:
    """Fill the gaps in every column of an array with the last value before them; ``before``: the values before its first row."""
    if said.all():
        return
    values[0] = np.where(said[0], values[0], before)
    at = np.where(said, np.arange(len(values))[:, None], 0)
    np.maximum.accumulate(at, axis=0, out=at)
    values[:] = np.take_along_axis(values, at, axis=0)
