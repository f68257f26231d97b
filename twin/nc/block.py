"""One block of a language of words, understood: its words with their places in the text, and what it does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from twin.nc.blocks import Move


class AxisWord(NamedTuple):
    """One axis word of a block.

    Attributes:
        axis: index of the axis.
        start: where the word begins in the line's text, and
        end: where it ends.
        value_start: where its value begins, and
        value_end: where that ends (inside ``AC( )`` and its like).
        form: ``""`` or ``AC``, ``IC``, ``DC``, ``ACP``, ``ACN``.
        incremental: whether the value counts from the last position.
        value: as written, in mm or degrees (NaN: not a number we know).
    """

    axis: int
    start: int
    end: int
    value_start: int
    value_end: int
    form: str
    incremental: bool
    value: float


class Span(NamedTuple):
    """A stretch of the line's text, and the name of the word in it."""

    start: int
    end: int
    name: str = ""


@dataclass(slots=True)
class Block:
    """One block: its words, the modal state in force, and the moves it makes.

    Attributes:
        text: the line's text.
        head: end of what stands before the block: skip mark and number.
        inch: whether the program is in inches here.
        incremental: whether words without a form count from the last position here.
        words: axis words, in their order.
        seen: the axes of those, as bits.
        vector_words: places of the tool vector's components by index 0, 1, 2 (value stretches).
        arc_words: centre, radius, sense and turns of an arc.
        last_m: M words that act at the end of the block.
        moves: what it makes: none, one, or one and the strokes of a drilling cycle.
        forgets: indices of the axes nobody knows the position of afterwards.
        switched: whether the control's kinematics were switched.
    """

    text: str
    head: int = 0
    inch: bool = False
    incremental: bool = False
    words: list[AxisWord] = field(default_factory=list)
    seen: int = 0
    vector_words: dict[int, Span] = field(default_factory=dict)
    arc_words: list[Span] = field(default_factory=list)
    last_m: list[Span] = field(default_factory=list)
    moves: tuple[Move, ...] = ()
    forgets: tuple[int, ...] = ()
    switched: bool = False
