"""What a program says, once its dialect is out of the way: lines, moves, and the pieces that replace a move.

Data flows one way: text -> `Program` (a dialect's `read`) -> `Move`s (`moves`) -> somebody decides new
positions -> `Rewrite`s -> text (`rewrite`). The dialect knows words and modality; it knows no kinematics.

Units: mm and degrees, whatever the program's own (`G20` programs are converted on the way in and out).

`Move` and `Notice` are tuples because a program has hundreds of thousands of them: a frozen dataclass takes
three times as long to make.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, final

import numpy as np


@final
@dataclass(frozen=True)
class AxisWords:
    """The axis words a machine's programs use: names of its linear and rotary axes, and their least increments.

    Attributes:
        linear: names of the three linear axes, in the order x, y, z of the program's coordinates.
        rotary: names of the rotary axes in command order (none, one or two).
        increment: least increment of each axis, mm or degrees.
        tcp_on, tcp_off: further words that switch the control's own kinematics on and off on this machine
            (a remapped ``M428``, say), in capitals, beside those of the dialect.
    """

    linear: tuple[str, ...]
    rotary: tuple[str, ...]
    increment: Mapping[str, float]
    tcp_on: tuple[str, ...] = ()
    tcp_off: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Linear, then rotary axis names."""
        return self.linear + self.rotary


@final
@dataclass(frozen=True)
class Program:
    """A program as read: its lines hold every byte (decoded as latin-1, so that any byte survives).

    Attributes:
        source: its name.
        dialect: the name of its language.
        texts: its lines' texts, each with its own line ending.
    """

    source: str
    dialect: str
    texts: tuple[str, ...]

    @property
    def text(self) -> str:
        """The whole text."""
        return "".join(self.texts)


@final
class Kind(Enum):
    """How a move gets to its end."""

    RAPID = "rapid"
    LINEAR = "linear"
    ARC = "arc"


@final
@dataclass(frozen=True)
class Arc:
    """A circular (helical) move in a principal plane of the program's linear coordinates.

    Attributes:
        plane: indices (a, b, c) of the two in-plane coordinates, right-handed about the third: G17 (0, 1, 2),
            G18 (2, 0, 1), G19 (1, 2, 0).
        centre_mm: centre in the plane (coordinates a and b), absolute.
        angle_rad: signed sweep from start to end, counter-clockwise positive, full turns included.
    """

    plane: tuple[int, int, int]
    centre_mm: tuple[float, float]
    angle_rad: float


@final
class Move(NamedTuple):
    """One block that moves axes, with everything modal made explicit.

    Attributes:
        line: index into ``Program.texts``.
        kind: rapid, linear feed or arc.
        tcp: whether the control does the kinematics here (the words are tool-tip coordinates).
        machine: whether the words are machine coordinates (``G53``, ``SUPA``, ``M91``): such a block passes through
            unchanged, ``position`` holds what it names and NaN elsewhere.
        position: absolute end position of every axis, mm and degrees, in the order ``AxisWords.names``, in the
            program's own coordinates (no work offset); NaN where the program has not said it yet.
            Rotary entries are NaN in a block that gives a tool vector.
        named: axis names this block wrote.
        vector: tool vector (i, j, k), unit length, from tip to spindle in the work frame, or None.
        normal: surface normal of an ``LN`` block, unit length, or None (kept as written).
        arc: for ``Kind.ARC``.
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


@final
class Notice(NamedTuple):
    """Something in the program a reader of the report must know: a line passed through, a word not understood."""

    line: int
    text: str


@final
class Left(NamedTuple):
    """Axes that a line, behind its own moves, leaves in a place the program does not say.

    Attributes:
        line: index into ``Program.texts``.
        axes: indices into ``AxisWords.names``.
        moved: whether it moves them for certain (a reference return, a retraction), or perhaps (a word not understood).
    """

    line: int
    axes: tuple[int, ...]
    moved: bool


@final
@dataclass(frozen=True)
class Reading:
    """What interpreting a program gave: its moves, in order, notices, and what it leaves in a place unknown."""

    moves: tuple[Move, ...]
    notices: tuple[Notice, ...] = ()
    left: tuple[Left, ...] = ()


@final
@dataclass(frozen=True)
class Rewrite:
    """New end positions for one move: one row a piece, the last row being the move's own end.

    Attributes:
        move: the move it replaces.
        positions: (pieces, axes) absolute, mm and degrees, order ``AxisWords.names``, already at the least
            increment; NaN for a word that is not to be written (rotary axes of a move that gives a tool vector, or of
            a program that never names them).
        vectors: (pieces, 3) unit tool vectors, or None.
        shares: (pieces,) of the move's time that each piece takes, where the feed is an inverse time; None: equal ones.
    """

    move: Move
    positions: np.ndarray
    vectors: np.ndarray | None = field(default=None)
    shares: np.ndarray | None = field(default=None)
