"""One block of an ISO program, understood: its words with their places in the text, and what it does."""

from __future__ import annotations

from typing import NamedTuple, final

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
class Block:
    """One block: words, modal state in force, and the moves it makes.

    Attributes:
        text: the line's text.
        head: end of the block's skip mark and number; new words may go here.
        skip: the skip mark (``/``) and its digit, or nothing.
        words: axis words, in their order.
        motion_word: the G word of the motion group, if the block has one.
        arc_words: centre, radius and turns words.
        vector_words: places of the tool vector's components by index 0, 1, 2 (value stretches).
        feed: the value of the F word.
        last_m: M words that act at the end of the block.
        motion: motion code in force (0 to 3), None before the first.
        incremental, inch, inverse_time: modal state in force.
        vector_names: names of the vector's words here, with their ``=``, or None where there is no vector.
        moves: what it makes: none, one, or one and the strokes of a drilling cycle.
        forgets: indices of the axes nobody knows the position of afterwards.
        switched: whether the control's kinematics were switched.
        cycle_word: where a drilling cycle is called or ended.
        dwell: text of the dwell at depth.
    """

    __slots__ = (
        "arc_words",
        "cycle_word",
        "dwell",
        "feed",
        "forgets",
        "head",
        "inch",
        "incremental",
        "inverse_time",
        "last_m",
        "motion",
        "motion_word",
        "moves",
        "skip",
        "switched",
        "text",
        "vector_names",
        "vector_words",
        "words",
    )

    def __init__(self, text: str) -> None:
        self.text = text
        self.head = 0
        self.skip = ""
        self.words: list[AxisWord] = []
        self.motion_word: Span | None = None
        self.arc_words: list[Span] = []
        self.vector_words: dict[int, Span] = {}
        self.feed: Span | None = None
        self.last_m: list[Span] = []
        self.motion: int | None = None
        self.incremental = False
        self.inch = False
        self.inverse_time = False
        self.vector_names: tuple[str, str, str] | None = None
        self.moves: list[Move] = []
        self.forgets: tuple[int, ...] = ()
        self.switched = False
        self.cycle_word: Span | None = None
        self.dwell = ""
