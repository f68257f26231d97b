"""One interpreted block of an ISO program."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, final

from twin.nc.block import Block, Span
from twin.nc.iso.cycles import Drilling


class Item(NamedTuple):
    """A word to be interpreted with the rest of its block: its name, its range, the range of its value, and the text of the value."""

    name: str
    start: int
    end: int
    value_start: int
    value_end: int
    value: str


@final
@dataclass(slots=True)
class IsoBlock(Block):
    """One block: `twin.nc.block.Block` with the attributes of ISO blocks.

    Attributes:
        skip: the skip mark (``/``) and its digit, or empty.
        codes: G words, named by their code.
        items: axis words, before their values are known.
        others: words that are not axis words.
        m_words: M words.
        names: statements and their arguments.
        motion_word: the G word of the motion group, if the block has one.
        feed: the value of the F word.
        motion: motion code in force (0 to 3), None before the first.
        inverse_time: whether the feed is an inverse time.
        vector_names: names of the tool vector's words here, with their ``=``, or None if there is no vector.
        cycle_word: the range of a call or the end of a drilling cycle of SINUMERIK.
        cycle_words: words of a drilling cycle of Fanuc, which are not needed once it is expanded.
        drilling: the cycle that the block executes.
        calls: whether the block executes a cycle of SINUMERIK at the present position.
        positions: whether the block moves the axes to the place of the hole before.
    """

    skip: str = ""
    codes: list[Span] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    others: list[Item] = field(default_factory=list)
    m_words: list[str] = field(default_factory=list)
    names: list[Item] = field(default_factory=list)
    motion_word: Span | None = None
    feed: Span | None = None
    motion: int | None = None
    inverse_time: bool = False
    vector_names: tuple[str, str, str] | None = None
    cycle_word: Span | None = None
    cycle_words: list[Span] = field(default_factory=list)
    drilling: Drilling | None = None
    calls: bool = False
    positions: bool = True
