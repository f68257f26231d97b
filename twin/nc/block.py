"""One interpreted block of an ISO or Heidenhain program: its words with their positions in the text, and its effect."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from twin.nc.blocks import Move


class AxisWord(NamedTuple):
    """One axis word of a block.

    Attributes:
        axis: index of the axis.
        start, end: range of the word in the line's text.
        value_start, value_end: range of its value, inside ``AC( )`` and similar forms.
        form: ``""`` or ``AC``, ``IC``, ``DC``, ``ACP``, ``ACN``.
        incremental: whether the value is relative to the last position.
        value: as written, in mm or degrees; NaN if it is not a known number.
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
    """A range of the line's text, and the name of the word in it."""

    start: int
    end: int
    name: str = ""


@dataclass(slots=True)
class Block:
    """One block: its words, the modal state in force, and its moves.

    Attributes:
        text: the line's text.
        head_end: end of the skip mark and block number.
        inch: whether the program is in inches here.
        incremental: whether words without a form are incremental here.
        words: axis words, in their order.
        axis_bits: the axes of these words, as bits.
        vector_words: ranges of the tool vector's values, by component 0, 1, 2.
        arc_words: centre, radius, sense and turns of an arc.
        end_m_words: M words that take effect at the end of the block.
        moves: none, one, or one move followed by the strokes of a drilling cycle.
        unknown_axes: indices of the axes whose position is unknown after the block.
        tcp_switched: whether the block switches tool centre point control.
    """

    text: str
    head_end: int = 0
    inch: bool = False
    incremental: bool = False
    words: list[AxisWord] = field(default_factory=list)
    axis_bits: int = 0
    vector_words: dict[int, Span] = field(default_factory=dict)
    arc_words: list[Span] = field(default_factory=list)
    end_m_words: list[Span] = field(default_factory=list)
    moves: tuple[Move, ...] = ()
    unknown_axes: tuple[int, ...] = ()
    tcp_switched: bool = False
