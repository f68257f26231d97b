"""Data of NC programs independent of their language: lines, moves, and the segments that replace a move.

Data flow: text -> `Program` (`Dialect.read`) -> `Move`s (`Dialect.moves`) -> new positions, computed elsewhere -> `Rewrite`s -> text
(`Dialect.rewrite`). A dialect knows words and modality, but no kinematics.

Units: mm and degrees, whatever the units of the program (`G20` programs are converted on reading and writing).

`Move` and `Notice` are tuples because a program has hundreds of thousands of them and a frozen dataclass takes three times as long to
create.

Tilted working planes: the rotation of a program's coordinates, from the angles that each control uses.

Sources: Fanuc Series 30i operator's manual, "Tilted working plane indexing" (G68.2: Euler angles about Z, X', Z''); Heidenhain TNC 640
user's manual, "PLANE function: tilting the working plane" (SPA, SPB, SPC about the fixed X, Y, Z, in this order); SINUMERIK 840D sl
Programming Manual Cycles, CYCLE800 (rotations about the axes in the order that MODE names).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from math import cos, radians, sin
from typing import Final, NamedTuple, final, overload

import numpy as np

from twin._common.arrays import MadeOnAccess
from twin._common.units import count_with_noun
from twin.display.results import Result

Rows = tuple[tuple[float, ...], ...]
_AXES: Final = "XYZ"


@final
@dataclass(frozen=True)
class Plane:
    """A tilted working plane.

    Attributes:
        origin_mm: its zero in the program's coordinates before it.
        rotation: its axes in those coordinates, as the columns of a rotation matrix (rows of three numbers); None: parallel to the
            linear axes of the machine where the rotary axes are at ``at_deg`` (dynamic work offset).
        choice: which of two positions of the rotary axes to take: +1 or −1: that where the axis nearer the tool is positive or
            negative; 0: the nearer one.
        stays: whether the linear axes stay where they are while the rotary axes turn.
        at_deg: words of the rotary axes, where the program positions them itself; None: the control positions them.
        read_deg: words of the rotary axes, as which a control may read the angles of the plane as well: it must be the same plane.
    """

    origin_mm: tuple[float, float, float]
    rotation: Rows | None
    choice: int = 0
    stays: bool = True
    at_deg: tuple[float, ...] | None = None
    read_deg: tuple[float, ...] | None = None


def rotation_about(axes: str, angles_deg: Sequence[float]) -> Rows:
    """Return the matrix of successive rotations, each about an axis (letter X, Y or Z) that the ones before have turned."""
    matrix = np.eye(3)
    for letter, angle in zip(axes, angles_deg, strict=True):
        c, s = _cos_sin(angle)
        i = _AXES.index(letter)
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = np.eye(3)
        turn[j, j], turn[j, k], turn[k, j], turn[k, k] = c, -s, s, c
        matrix = matrix @ turn
    return tuple(tuple(row) for row in matrix.tolist())


def rotation_along(first: Sequence[float], normal: Sequence[float]) -> Rows:
    """Return the rotation matrix whose third column lies along a normal, and whose first column is nearest to another vector.

    It raises `ValueError` for a vector of length zero, and if both are parallel.
    """
    z = np.array(normal, dtype=float)
    x = np.array(first, dtype=float)
    if not (z.any() and x.any()):
        raise ValueError("a vector of length zero")
    z /= np.linalg.norm(z)
    x = x / np.linalg.norm(x) - z * (z @ x) / np.linalg.norm(x)
    if np.linalg.norm(x) < PARALLEL:
        raise ValueError("two parallel vectors")
    x /= np.linalg.norm(x)
    return tuple(tuple(row) for row in np.stack([x, np.cross(z, x), z], axis=1).tolist())


def rotation_through(points: Sequence[Sequence[float]]) -> Rows:
    """Return the rotation matrix of a plane through three points: x towards the second one, the third on the side of positive y.

    It raises `ValueError` for points on one line.
    """
    first, second, third = np.array(points, dtype=float)
    x = second - first
    return rotation_along(x.tolist(), np.cross(x, third - first).tolist())


PARALLEL: Final = 1e-3
"""Sine of the least angle between the two directions that define a plane."""


def _cos_sin(angle_deg: float) -> tuple[float, float]:
    """Return cosine and sine, exact at multiples of 90°."""
    quarter, rest = divmod(angle_deg, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    return cos(radians(angle_deg)), sin(radians(angle_deg))


# --- The lines of a program as bytes: most are processed together and never become text of their own


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
    """The lines of some bytes, as `lines_in`, each decoded when it is asked for."""

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


# --- Data of NC programs independent of their language: lines, moves, and the segments that replace a move


@final
@dataclass(frozen=True)
class AxisWords:
    """The axis words of a machine's programs: names of its linear and rotary axes, and their least increments.

    Attributes:
        linear: names of the three linear axes, in the order x, y, z of the program's coordinates.
        rotary: names of the rotary axes in command order (none, one or two).
        increment: least increment of each axis, mm or degrees.
        tcp_on, tcp_off: words in capitals that switch tool centre point control on and off on this machine (a remapped
            ``M428``, for example), in addition to those of the dialect.
        offsets_known: whether the values of the machine's work offsets are known, so that a program may use several.
        tools_known: whether the lengths of the machine's tools are known.
        one_tool: whether all moves must use a tool of one length, where the lengths are unknown.
        harmless: words in capitals that leave positions, frames, offsets and modes alone on this machine, in addition to those of the
            dialect: auxiliary functions of its builder, for example; and names of subprograms that need not be given (``O9021``).
        auxiliary_axes: names of axes that programs name and the model of the machine does not have: they stand still in every feed.
        references: positions of the axes after a reference return, mm and degrees, by its word (``G28``, ``G30 P3``) and axis.
    """

    linear: tuple[str, ...]
    rotary: tuple[str, ...]
    increment: Mapping[str, float]
    tcp_on: tuple[str, ...] = ()
    tcp_off: tuple[str, ...] = ()
    offsets_known: bool = False
    tools_known: bool = False
    one_tool: bool = True
    harmless: tuple[str, ...] = ()
    references: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    auxiliary_axes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the linear axes, then of the rotary axes."""
        return self.linear + self.rotary


@final
@dataclass(frozen=True)
class Origin:
    """Origin of a line of a program whose subprograms are written out: file, line, and line of the main program or of its call."""

    file: str
    line: int
    main: int


@final
@dataclass(frozen=True, repr=False)
class Program(Result):
    """A program as read: its lines hold every byte, decoded as latin-1 so that any byte is preserved.

    Attributes:
        source: file name for messages.
        dialect: the name of its language.
        texts: the lines, each with its own line ending.
        origins: where each line is from; empty if all are those of the file, in order.
    """

    source: str
    dialect: str
    texts: Sequence[str]
    origins: tuple[Origin, ...] = ()

    @property
    def brief(self) -> str:
        """File, dialect and number of lines."""
        return f"{self.source}: {self.dialect}, {count_with_noun(len(self.texts), 'line')}"

    @cached_property
    def numbers(self) -> np.ndarray:
        """(lines,) number of each line in the file."""
        if not self.origins:
            return np.arange(1, len(self.texts) + 1)
        return np.array([origin.main for origin in self.origins])

    @property
    def text(self) -> str:
        """The whole text."""
        return encoded(self.texts, 0, len(self.texts)).decode("latin-1")


@final
class Kind(Enum):
    """The type of motion of a move."""

    RAPID = "rapid"
    LINEAR = "linear"
    ARC = "arc"


@final
@dataclass(frozen=True)
class Arc:
    """A circular (helical) move in a principal plane of the program's linear coordinates.

    Attributes:
        plane: indices (a, b, c): in-plane coordinates a and b, right-handed about c: G17 (0, 1, 2),
            G18 (2, 0, 1), G19 (1, 2, 0).
        centre_mm: centre in the plane (coordinates a and b), absolute.
        angle_rad: signed sweep from start to end, counter-clockwise positive, full turns included.
    """

    plane: tuple[int, int, int]
    centre_mm: tuple[float, float]
    angle_rad: float


NO_POSITION: Final = "the program has not given a position of"
"""Beginning of the reason why nothing is known of where a block goes, or of where an arc begins."""


@final
class Move(NamedTuple):
    """One block that moves axes, with all modal state made explicit.

    Attributes:
        line: index into ``Program.texts``.
        kind: rapid, linear feed or arc.
        tcp: whether tool centre point control is on (the words are tool-tip coordinates).
        machine: whether the words are machine coordinates (``G53``, ``SUPA``, ``M91``). Such a block passes through unchanged;
            ``position`` holds its words, NaN for the other axes. With ``unknown``: those of a work offset of unknown values, all NaN.
        position: absolute end position of every axis, mm and degrees, in the order ``AxisWords.names``, in the program's
            coordinates (without work offset); NaN where still unknown. Rotary entries are NaN in a block with a tool vector.
        vector: tool vector (i, j, k), unit length, from tip to spindle in the work frame, or None.
        normal: surface normal of an ``LN`` block, unit length, or None (kept as written).
        unknown: why nothing is known of where the block goes (`twin.nc.modal.Interpreter.unknown`); empty if that is known. Such a
            block passes through unchanged; ``position`` is NaN, except behind an arc from an unknown start, and ``arc`` None.
        whole: whether the block stays one block, an arc an arc: under cutter radius compensation.
    """

    line: int
    kind: Kind
    tcp: bool
    position: tuple[float, ...]
    named: frozenset[str]
    machine: bool = False
    vector: tuple[float, float, float] | None = None
    normal: tuple[float, float, float] | None = None
    arc: Arc | None = None
    unknown: str = ""
    whole: bool = False

    @property
    def passes(self) -> bool:
        """Whether the block is not in program coordinates that are known, and so passes through unchanged."""
        return self.machine or bool(self.unknown)


@final
class Notice(NamedTuple):
    """A remark on a line for the report: passed through unchanged, or a word that is not understood."""

    line: int
    text: str


@final
class LostPositions(NamedTuple):
    """Axes whose position is unknown after a line, beyond its own moves.

    Attributes:
        line: index into ``Program.texts``.
        axes: indices into ``AxisWords.names``.
        moved: whether the line certainly moves them (reference return, retraction) or possibly does (an unknown word).
        reference: the word of a reference return; empty for anything else.
    """

    line: int
    axes: tuple[int, ...]
    moved: bool
    reference: str = ""


STATED_LENGTH: Final = "="
"""Beginning of a tool length that a program states itself (LinuxCNC: ``G43.1 Z50``)."""


@final
@dataclass(frozen=True)
class WordFrame:
    """The coordinates in which a program's words are given, from a line on.

    Attributes:
        offset: name of the work offset in force (``G54``, ``G54.1 P3``, ``G505``, a preset's number); empty before the first.
        tool: number or name of the tool in the spindle; empty before the first.
        length: number or name of the tool whose length the control adds, or behind `STATED_LENGTH` the length itself in mm; empty if
            it adds none.
        delta_mm: a further length stated by the program (``DL``).
        plane: the tilted plane in force, None for the coordinates of the work offset.
        stated: values of the work offset that the program itself has set, by axis; None for those of the set-up; empty if it sets none.
        shift: what is added to the words of each axis, before the plane and the work offset; empty for nothing.
        turn: axes of the words x, y, z as columns of a rotation matrix (rows of three numbers), None if they are not turned. The words
            are turned first, then shifted.
        inclined: whether the rotary axes may turn within the plane, by tool centre point control.
    """

    offset: str = ""
    tool: str = ""
    length: str = ""
    delta_mm: float = 0.0
    plane: Plane | None = None
    stated: tuple[float | None, ...] = ()
    shift: tuple[float, ...] = ()
    turn: Rows | None = None
    inclined: bool = False

    def converted(self, words: Sequence[float], into: WordFrame) -> list[float]:
        """Return the words of the same axis positions in another frame of the same work offset and plane; NaN where unknown."""
        axes = range(len(words))
        moved = _turned(words, self.turn)
        for frame, sign in ((self, 1.0), (into, -1.0)):
            moved = [moved[i] + sign * frame.shift[i] for i in axes] if frame.shift else moved
        if self.stated != into.stated:
            here, there = (np.array(frame.stated or (None,) * len(words), dtype=float) for frame in (self, into))
            change = np.where(np.isnan(here) & np.isnan(there), 0.0, here - there).tolist()
            moved = [moved[i] + change[i] for i in axes]
        return moved if into.turn is None else _turned(moved, tuple(zip(*into.turn, strict=True)))


def _turned(words: Sequence[float], turn: Rows | None) -> list[float]:
    """Return words with the first three turned; one that is unknown leaves only those unknown that depend on it."""
    if turn is None:
        return list(words)
    linear = [sum(part * words[i] for i, part in enumerate(row) if part) for row in turn]
    return [*linear, *words[3:]]


def product(first: Rows | None, second: Rows | None) -> Rows | None:
    """Return the rotation by ``second``, then by ``first``; None for none."""
    if first is None or second is None:
        return first or second
    return tuple(tuple(row) for row in (np.array(first) @ np.array(second)).tolist())


@final
class FrameChange(NamedTuple):
    """A line that changes the frame, for its own move and all later ones."""

    line: int
    frame: WordFrame


@final
@dataclass(frozen=True)
class Interpretation:
    """The result of interpreting a program.

    Attributes:
        lost_positions: the lines after which axis positions are unknown.
        frames: the lines that change the frame: by known values of offsets and tools (`AxisWords`), or of the program.
        drilled: ranges of lines that execute a drilling cycle; all their moves belong to it.
        control: the control whose words the program has; empty if its words are those of several.
    """

    moves: Sequence[Move]
    notices: tuple[Notice, ...] = ()
    lost_positions: tuple[LostPositions, ...] = ()
    frames: tuple[FrameChange, ...] = ()
    drilled: tuple[range, ...] = ()
    control: str = ""


@final
@dataclass(frozen=True)
class Rewrite:
    """New end positions for one move: one row per segment; the last row is the end of the move.

    Attributes:
        positions: (segments, axes) absolute, mm and degrees, in the order ``AxisWords.names``, rounded to the least increment;
            NaN for a word that is not to be written (rotary axes of a move with a tool vector, or of a program without them).
        vectors: (segments, 3) unit tool vectors, or None.
        shares: (segments,) fraction of the move's time for each segment, for inverse time feed; None: equal fractions.
    """

    move: Move
    positions: np.ndarray
    vectors: np.ndarray | None = field(default=None)
    shares: np.ndarray | None = field(default=None)


# --- Moves and their replacements as arrays, with an object made only on access; memory-efficient for programs of a million b

NO_VECTOR = (np.nan, np.nan, np.nan)
"""In place of a tool vector, in columns."""


@final
@dataclass(frozen=True)
class MoveColumns(MadeOnAccess[Move]):
    """Moves as columns; see `Move`.

    Attributes:
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
            {
                i: move
                for i, move in enumerate(moves)
                if move.kind is Kind.ARC or move.passes or move.normal or move.whole
            },
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
        passes = np.zeros(len(self), dtype=bool)
        passes[[index for index, move in self.special.items() if move.passes]] = True
        return passes

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
    """Collector of moves, added one by one or in columns."""

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
        """Return the replacements of moves by index, ascending: (segments, axes) positions and (segments, 3) vectors or None."""
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
