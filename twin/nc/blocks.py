"""Data of NC programs independent of their language: lines, moves, and the segments that replace a move.

Data flow: text -> `Program` (`Dialect.read`) -> `Move`s (`Dialect.moves`) -> new positions, computed elsewhere -> `Rewrite`s -> text
(`Dialect.rewrite`). A dialect knows words and modality, but no kinematics.

Units: mm and degrees, whatever the units of the program (`G20` programs are converted on reading and writing).

`Move` and `Notice` are tuples because a program has hundreds of thousands of them and a frozen dataclass takes three times as long to
create.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from twin.nc.encoded import encoded
from twin.nc.planes import Plane


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
            dialect: auxiliary functions of its builder, for example.
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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the linear axes, then of the rotary axes."""
        return self.linear + self.rotary


@final
@dataclass(frozen=True)
class Origin:
    """Origin of a line of a program whose subprograms are written out.

    Attributes:
        file: its file.
        line: its number there.
        main: the number in the main program, of the line itself or of the call that leads to it.
    """

    file: str
    line: int
    main: int


@final
@dataclass(frozen=True)
class Program:
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


@final
class Move(NamedTuple):
    """One block that moves axes, with all modal state made explicit.

    Attributes:
        line: index into ``Program.texts``.
        kind: rapid, linear feed or arc.
        tcp: whether tool centre point control is on (the words are tool-tip coordinates).
        machine: whether the words are machine coordinates (``G53``, ``SUPA``, ``M91``). Such a block passes through unchanged;
            ``position`` holds its words, NaN for the other axes.
        position: absolute end position of every axis, mm and degrees, in the order ``AxisWords.names``, in the program's
            coordinates (without work offset); NaN where still unknown. Rotary entries are NaN in a block with a tool vector.
        named: names of the axes written in this block.
        vector: tool vector (i, j, k), unit length, from tip to spindle in the work frame, or None.
        normal: surface normal of an ``LN`` block, unit length, or None (kept as written).
        arc: for ``Kind.ARC``.
        unknown: why nothing is known of where the block goes (`twin.nc.modal.Interpreter.unknown`); empty if that is known. Such a
            block passes through unchanged; ``position`` is NaN and ``arc`` None.
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
    """

    line: int
    axes: tuple[int, ...]
    moved: bool


@final
@dataclass(frozen=True)
class WordFrame:
    """The coordinates in which a program's words are given, from a line on.

    Attributes:
        offset: name of the work offset in force (``G54``, ``G54.1 P3``, ``G505``, a preset's number); empty before the first.
        tool: number or name of the tool in the spindle; empty before the first.
        length: number or name of the tool whose length the control adds; empty if it adds none.
        delta_mm: a further length stated by the program (``DL``).
        plane: the tilted plane in force, None for the coordinates of the work offset.
    """

    offset: str = ""
    tool: str = ""
    length: str = ""
    delta_mm: float = 0.0
    plane: Plane | None = None


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
        moves: its moves in order.
        notices: remarks for the report.
        lost_positions: the lines after which axis positions are unknown.
        frames: the lines that change the frame; none if the values of offsets and tools are unknown (`AxisWords`).
        drilled: ranges of lines that execute a drilling cycle; all their moves belong to it.
    """

    moves: Sequence[Move]
    notices: tuple[Notice, ...] = ()
    lost_positions: tuple[LostPositions, ...] = ()
    frames: tuple[FrameChange, ...] = ()
    drilled: tuple[range, ...] = ()


@final
@dataclass(frozen=True)
class Rewrite:
    """New end positions for one move: one row per segment; the last row is the end of the move.

    Attributes:
        move: the move it replaces.
        positions: (segments, axes) absolute, mm and degrees, in the order ``AxisWords.names``, rounded to the least increment;
            NaN for a word that is not to be written (rotary axes of a move with a tool vector, or of a program without them).
        vectors: (segments, 3) unit tool vectors, or None.
        shares: (segments,) fraction of the move's time for each segment, for inverse time feed; None: equal fractions.
    """

    move: Move
    positions: np.ndarray
    vectors: np.ndarray | None = field(default=None)
    shares: np.ndarray | None = field(default=None)
