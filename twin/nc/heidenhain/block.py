"""One interpreted block of a Heidenhain program."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

from twin.nc.block import Block


@final
@dataclass(slots=True)
class PathBlock(Block):
    """One block: `twin.nc.block.Block` with the attributes of Heidenhain blocks.

    Attributes:
        numbered: whether it has a number.
        keyword: ``L``, ``LN``, ``C``, ``CR``, or ``""`` for a paraxial block.
        keyword_end: end of the keyword.
        rapid_text: ``FMAX`` as written, or empty.
        normal_text: the words ``NX NY NZ`` as written.
        normal: their components, or None.
        tool: the components of ``TX TY TZ``, or None.
        clockwise: the sense of an arc, or None.
        radius: mm, or None.
        machine: whether its words are machine coordinates.
        elsewhere: whether these count from a point of the machine's builder (M92).
        retracts: whether it retracts along the tool axis.
    """

    numbered: bool = False
    keyword: str = ""
    keyword_end: int = 0
    rapid_text: str = ""
    normal_text: list[str] = field(default_factory=list)
    normal: list[float] | None = None
    tool: list[float] | None = None
    clockwise: bool | None = None
    radius: float | None = None
    machine: bool = False
    elsewhere: bool = False
    retracts: bool = False
