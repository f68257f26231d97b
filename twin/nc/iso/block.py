"""One block of an ISO program, understood."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, final

from twin.nc.block import Block, Span


class Item(NamedTuple):
    """A word whose meaning waits for the rest of its block: its name, its place, that of its value, and the value's text."""

    name: str
    start: int
    end: int
    value_start: int
    value_end: int
    value: str


class Drilling(NamedTuple):
    """A drilling cycle called at every position that follows (heights in mm, program coordinates).

    Attributes:
        approach: rapid down to here,
        depth: then feed to here,
        dwell: text of the dwell there (``""``: none),
        retract: then rapid up to here.
    """

    approach: float
    depth: float
    dwell: str
    retract: float


@final
@dataclass(slots=True)
class IsoBlock(Block):
    """One block: as `twin.nc.block.Block`, and what only ISO blocks have.

    Attributes:
        skip: the skip mark (``/``) and its digit, or nothing.
        codes: G words, named by their code.
        items: axis words, before they have values.
        others: words that are no axis words.
        names: statements and their arguments.
        motion_word: the G word of the motion group, if the block has one.
        feed: the value of the F word.
        motion: motion code in force (0 to 3), None before the first.
        inverse_time: whether the feed is an inverse time.
        vector_names: names of the vector's words here, with their ``=``, or None where there is no vector.
        cycle_word: where a drilling cycle is called or ended.
        dwell: text of the dwell at depth.
    """

    skip: str = ""
    codes: list[Span] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    others: list[Item] = field(default_factory=list)
    names: list[Item] = field(default_factory=list)
    motion_word: Span | None = None
    feed: Span | None = None
    motion: int | None = None
    inverse_time: bool = False
    vector_names: tuple[str, str, str] | None = None
    cycle_word: Span | None = None
    dwell: str = ""
